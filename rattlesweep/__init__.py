"""rattlesweep."""
