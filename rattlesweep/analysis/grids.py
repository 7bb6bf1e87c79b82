"""Maps as arrays: fill what a refined grid has left out, measure how ragged boundaries are.

The measures are those of Attractors.jl, by boxes as there. For the entropy at boundaries only boxes
with two types count: where three meet it says nothing about a line.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.sweeps.decide import FEWEST as FEWEST_REFINED
from rattlesweep.sweeps.decide import nearest

BOX = 5
"""Points along a side of the boxes whose entropy is taken, as in Daza et al."""
FEWEST = 40
"""Points along a side below which there is no exponent."""


class Boundaries(NamedTuple):
    """What the boundaries on a map are like; NaN where there are none, errors are standard ones.

    Basin entropy ``S_b`` and boundary basin entropy ``S_bb`` in nats: the mean entropy of the types
    in boxes of `BOX` x `BOX` points, of all boxes and of those with two types (Daza et al., Sci.
    Rep. 6, 31416, 2016). With two types ``S_bb`` is at most ln 2, which it comes near where they
    are mixed point by point.

    Uncertainty exponent: the share of boxes of side ``e`` with several types goes as ``e`` to
    this power. It is 1 for smooth lines, less for fractal ones: their dimension is 2 less the
    exponent (Grebogi et al., Phys. Lett. A 99, 415, 1983).
    """

    entropy: float
    boundary_entropy: float
    boundary_entropy_error: float  # as if boxes were independent
    exponent: float
    exponent_error: float  # of the straight line

    @property
    def words(self) -> str:
        """The same for people."""
        return (
            f"basin entropy {self.entropy:.3f}, at boundaries {self.boundary_entropy:.3f} ± "
            f"{self.boundary_entropy_error:.3f}; uncertainty exponent {self.exponent:.2f} ± "
            f"{self.exponent_error:.2f}"
        )


def boundaries(code: Integers) -> Boundaries:
    """Measure a map, shape (x, y), of types as numbers from 0."""
    types, parts = _boxes(code, BOX)
    with np.errstate(divide="ignore", invalid="ignore"):
        entropy = -np.nansum(parts * np.log(parts), axis=0)
    at = entropy[types == 2]
    mean = float(entropy.mean()) if entropy.size else np.nan
    error = float(at.std(ddof=1) / np.sqrt(at.size)) if at.size > 1 else np.nan
    return Boundaries(mean, float(at.mean()) if at.size else np.nan, error, *_exponent(code))


def _exponent(code: Integers) -> tuple[float, float]:
    """Fit the uncertainty exponent, with its error, to boxes of 2 points to a 20th of a side.

    The points of a box lie one less than their number apart.
    """
    if min(code.shape) < FEWEST:
        return np.nan, np.nan
    sides = np.unique(np.geomspace(2, max(5, max(code.shape) // 20), 12).astype(int))
    uncertain = [float((_boxes(code, side)[0] > 1).mean()) for side in sides]
    if min(uncertain) == 0 or len(sides) < 3:
        return np.nan, np.nan
    x, y = np.log(sides - 1), np.log(uncertain)
    slope, offset = np.polyfit(x, y, 1)
    left = y - slope * x - offset
    error = np.sqrt((left**2).sum() / (len(x) - 2) / ((x - x.mean()) ** 2).sum())
    return float(slope), float(error)


def _boxes(code: Integers, side: int) -> tuple[Integers, Floats]:
    """Return how many types each of the boxes side by side has, and the shares of all types."""
    rows, columns = (length // side for length in code.shape)
    boxes = code[: rows * side, : columns * side].reshape(rows, side, columns, side)
    parts = np.array([(boxes == kind).mean(axis=(1, 3)) for kind in np.unique(code)])
    return (parts > 0).sum(axis=0), parts


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
    """
    from scipy.interpolate import LinearNDInterpolator

    along = [n >= FEWEST_REFINED for n in values.shape]
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
