"""Shares of counts, and their confidence intervals."""

import numpy as np
from numpy.typing import ArrayLike

from rattlesweep.arrays import Floats

Z95 = 1.959963984540054  # quantile of the normal distribution for two-sided 95 %


def share(count: ArrayLike, whole: ArrayLike) -> Floats:
    """Return ``count / whole``, NaN where `whole` is zero."""
    count = np.asarray(count, float)
    whole = np.asarray(whole, float)
    result = np.full(count.shape, np.nan)
    with np.errstate(over="ignore"):
        np.divide(count, whole, out=result, where=whole > 0)
    return result


def wilson(count: ArrayLike, whole: ArrayLike, z: float = Z95) -> tuple[Floats, Floats]:
    """Return the ends of the confidence interval of a share.

    By Wilson, J. Am. Stat. Assoc. 22, 209 (1927).

    Stability: stable.
    """
    p = share(count, whole)
    weight = share(np.full(p.shape, z * z), whole)
    centre = (p + weight / 2) / (1 + weight)
    half = np.sqrt(weight * (p * (1 - p) + weight / 4)) / (1 + weight)
    # Shares of 0 and 1 have exact ends, which rounding could move out of the interval.
    low = np.where(p == 0, 0.0, centre - half)
    high = np.where(p == 1, 1.0, centre + half)
    return low, high
