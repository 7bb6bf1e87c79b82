"""Who computes it: blocks, jobs, engines, verification."""
