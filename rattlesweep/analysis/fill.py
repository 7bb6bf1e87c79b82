"""Fill the points of a refined grid that were not run from those that were."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Flags
from rattlesweep.sweeps.decide import nearest


def fill(values: NDArray[Any], known: Flags, along: Sequence[bool] | None = None) -> NDArray[Any]:
    """Return an array in which points that were not run have a value too.

    A point takes the value of the nearest run, counted in steps of the grid. Between runs that have
    a finite number it takes the linear interpolation instead; where the nearest run has none (NaN),
    as ``t_r`` without a reversal, it has none either.

    Parameters
    ----------
    values : ndarray
        One value for each point of the grid: codes, words, or floating numbers, which are
        interpolated.
    known : ndarray of bool
        Points that were run, of the same shape.
    along : sequence of bool, optional
        Axes that are refined, by default all; planes across the others are filled apart.

    Returns
    -------
    ndarray
        Of the same shape and type; unchanged where nothing is known or nothing is missing.
    """
    from scipy.interpolate import LinearNDInterpolator

    along = [True] * values.ndim if along is None else along
    filled: NDArray[Any] = values[tuple(nearest(known, along))]
    if not np.issubdtype(values.dtype, np.floating):
        return filled
    others = (1 if own else n for own, n in zip(along, values.shape, strict=True))
    for place in np.ndindex(*others):
        here = tuple(slice(None) if own else k for own, k in zip(along, place, strict=True))
        own, new = values[here], filled[here]
        wanted, source = ~known[here] & np.isfinite(new), known[here] & np.isfinite(own)
        spread = all(len(np.unique(axis)) > 1 for axis in np.nonzero(source))
        if wanted.any() and spread and new.ndim > 1 and source.sum() > new.ndim + 1:
            interpolate = LinearNDInterpolator(np.argwhere(source), own[source])
            between = interpolate(np.argwhere(wanted))
            new[wanted] = np.where(np.isfinite(between), between, new[wanted])
    return filled
