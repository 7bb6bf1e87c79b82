"""What a row is: columns, results, types, regimes."""
