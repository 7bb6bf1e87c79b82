"""Methods as tables of numbers: explicit tableaus, collocation."""
