"""Where bodies come from."""
