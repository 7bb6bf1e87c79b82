"""Who works the blocks off: this machine, a Dask cluster, a Slurm array."""
