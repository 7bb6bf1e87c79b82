"""Fill the points of a refined grid that were not run from those that were."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Flags
from rattlesweep.sweeps.decide import FEWEST, nearest


def fill(values: NDArray[Any], known: Flags) -> NDArray[Any]:
    """Return an array in which points that were not run have a value too.

    A point takes the value of the nearest run, counted in steps of the grid. Between runs that have
    a finite number it takes the linear interpolation instead; where the nearest run has none (NaN),
    as ``t_r`` without a reversal, it has none either. Axes of few values are not refined; planes
    across them are filled apart.

    Parameters
    ----------
    values : ndarray
        One value for each point of the grid: codes, words, or floating numbers, which are
        interpolated.
    known : ndarray of bool
        Points that were run, of the same shape.

    Returns
    -------
    ndarray
        Of the same shape and type; unchanged where nothing is known or nothing is missing.
    """
    from scipy.interpolate import LinearNDInterpolator

    along = [n >= FEWEST for n in values.shape]
    filled: NDArray[Any] = values[tuple(nearest(known, along))]
    if not np.issubdtype(values.dtype, np.floating):
        return filled
    others = (1 if own else n for own, n in zip(along, values.shape, strict=True))
    for place in np.ndindex(*others):
        here = tuple(slice(None) if own else k for own, k in zip(along, place, strict=True))
        if known[here].all() or not known[here].any():
            continue
        own, new = values[here], filled[here]
        wanted, source = ~known[here] & np.isfinite(new), known[here] & np.isfinite(own)
        spread = all(len(np.unique(axis)) > 1 for axis in np.nonzero(source))
        if wanted.any() and spread and new.ndim > 1 and source.sum() > new.ndim + 1:
            interpolate = LinearNDInterpolator(np.argwhere(source), own[source])
            between = interpolate(np.argwhere(wanted))
            new[wanted] = np.where(np.isfinite(between), between, new[wanted])
    return filled
