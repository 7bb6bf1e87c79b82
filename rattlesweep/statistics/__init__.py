"""Intervals of shares and means, and tails of distributions."""
