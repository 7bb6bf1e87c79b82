"""Modules that are about to go."""
