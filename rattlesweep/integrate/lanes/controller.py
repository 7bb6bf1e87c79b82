"""Step size control of the methods with an error estimate: one rule for every kernel.

The errors here are squared and in units of the tolerance.  Docs/design.md has the figures behind
the constants.
"""

from __future__ import annotations

from math import sqrt

from rattlesweep.integrate.lanes.intrinsics import rough_root
from rattlesweep.physics.full import scalar

# In radians of the spin's fastest swing: the first step, for a tolerance of 1, and the least one
# before a run is given up.
FIRST_STEP = 6.0
LEAST_STEP = 1e-9
SAFETY, SAFETY_REJECTED = 0.95, 0.85
# Least ratio of two steps; the largest is 7.3, by the root of the least error.
SHRINK = 0.2
LEAST_ERROR = 1e-30


@scalar
def error_root(error):  # type: ignore[no-untyped-def]
    """Return what :func:`step_ratio` takes of an error."""
    return rough_root(error + LEAST_ERROR)


@scalar
def step_ratio(root, last, held):  # type: ignore[no-untyped-def]
    """Ratio of the next step to one that is accepted: a PI control of low gain.

    Parameters
    ----------
    root, last : float
        :func:`error_root` of the step and of the accepted one before it.
    held : bool
        Whether a step tried in between was rejected: then the next one is not longer.
    """
    ratio = SAFETY * last / (root * root)
    return 1.0 if held & (ratio > 1.0) else ratio


@scalar
def retry_ratio(error):  # type: ignore[no-untyped-def]
    """Ratio of the next step to one that was rejected; an error that is no number is large."""
    ratio = SAFETY_REJECTED / sqrt(sqrt(sqrt(sqrt(error + LEAST_ERROR))))
    return ratio if ratio > SHRINK else SHRINK
