"""Periodic orbits: motions that return, their multipliers and their families."""
