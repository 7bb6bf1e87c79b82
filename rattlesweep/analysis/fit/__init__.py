"""Fits of one run to a measured angle or spin, or to the times of reversals."""
