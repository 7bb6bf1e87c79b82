"""Whether a config makes physical sense."""
