"""Step size control of the methods with an error estimate: one rule for every kernel."""

from __future__ import annotations

from math import sqrt

from rattlesweep.physics.full import scalar

# First step and the least one before a run is given up, in radians of the spin's fastest swing.
FIRST_STEP = 0.1
LEAST_STEP = 1e-9
SAFETY = 0.85
# Bounds of the ratio of two steps.
SHRINK, GROW = 0.2, 4.0


@scalar
def step_factor(error, accept, held):  # type: ignore[no-untyped-def]
    """Ratio of the next step to the one just tried.

    Parameters
    ----------
    error : float
        Its squared error in units of the tolerance.
    accept : bool
        Whether that was small enough.
    held : bool
        Whether the step tried before it was rejected: then the next one is not longer.
    """
    # err^(1/8) from its square: four square roots vectorise, a power does not.
    factor = SAFETY / sqrt(sqrt(sqrt(sqrt(error + 1e-30))))
    largest = 1.0 if held or not accept else GROW
    # An error that is not a number compares as false.
    factor = factor if factor > SHRINK else SHRINK
    return factor if factor < largest else largest
