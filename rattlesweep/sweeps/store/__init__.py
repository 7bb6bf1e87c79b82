"""The output directory."""
