"""Compiled code: operations that Numba lacks, and the cache of kernels."""
