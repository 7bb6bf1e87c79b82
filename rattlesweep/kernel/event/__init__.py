"""Events: which steps may hold one, and searches for zeros, peaks and marks."""
