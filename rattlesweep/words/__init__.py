"""Words that users read and write: quantities, units, names, defaults, messages."""
