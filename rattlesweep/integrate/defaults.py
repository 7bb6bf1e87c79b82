"""What methods take unless told otherwise; apart, as the config tells of it without NumPy."""

TOL = 1e-9
"""Error of a step relative to the oscillation, of adaptive methods."""

DT = 0.002
"""Step of methods of fixed step, in ``sqrt(a/g)``: the paper's own."""

MAX_STEPS = 100_000_000
"""Steps after which a run is given up."""
