"""The config: read, checked, explained."""
