"""Who computes it: blocks, jobs, executors, verification."""
