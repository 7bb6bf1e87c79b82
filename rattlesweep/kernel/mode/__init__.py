"""Modes: the ways in which a body moves."""
