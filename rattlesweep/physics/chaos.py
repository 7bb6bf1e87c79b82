"""Chaos in a run of finite length, told from its largest Lyapunov exponent."""

import numpy as np
from numpy.typing import ArrayLike

from rattlesweep.arrays import Flags

LEAST_GROWTH = 10.0  # logarithm of the growth that chaos exceeds; see docs/dynamics.md


def is_chaotic(lyapunov_late: ArrayLike, t_end: ArrayLike) -> Flags:
    """Return whether differences grow by more than e^10 in the second half of a run.

    Stability: stable.
    """
    growth = np.asarray(lyapunov_late, dtype=float) * np.asarray(t_end, dtype=float) / 2
    return np.asarray(growth > LEAST_GROWTH)
