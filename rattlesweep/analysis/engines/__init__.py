"""Runs as cases that physics engines can repeat, with what they should find."""
