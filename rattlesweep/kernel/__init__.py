"""How runs are integrated: lanes, steps, searches, modes, batches."""
