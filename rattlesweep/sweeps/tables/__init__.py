"""Columns, Arrow tables and types of runs."""
