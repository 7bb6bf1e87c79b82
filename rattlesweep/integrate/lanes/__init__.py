"""The lane kernel: many runs at once, each with its own step."""
