"""Sweeps: from a config to rows on disk."""
