"""Maps as arrays: fill what a refined grid has left out, measure how ragged boundaries are."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.sweeps.decide import FEWEST as FEWEST_REFINED
from rattlesweep.sweeps.decide import nearest

# Points along a side of the boxes whose entropy is taken, as in Daza et al.
BOX = 5
# Points along a side below which there is no exponent.
FEWEST = 40


class Boundaries(NamedTuple):
    """What the boundaries on a map are like; NaN where there are none, errors are standard ones.

    `entropy` and `boundary_entropy`, in nats, are the mean entropies of the types in boxes of `BOX`
    x `BOX` points, of all boxes and of those with two types; the latter is ln 2 where types are
    mixed point by point (Daza et al., Sci. Rep. 6, 31416, 2016). The share of boxes of side ``e``
    with several types goes as ``e`` to the power `exponent`, which is 1 for smooth lines and less
    for fractal ones (Grebogi et al., Phys. Lett. A 99, 415, 1983).
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
    own = (float(at.mean()) if at.size else np.nan,
           float(at.std(ddof=1) / np.sqrt(at.size)) if at.size > 1 else np.nan)  # fmt: skip
    # From 2 points to a 20th of a side; the points of a box lie one less than their number apart.
    sides = np.unique(np.geomspace(2, max(5, max(code.shape) // 20), 12).astype(int))
    uncertain = [float((_boxes(code, side)[0] > 1).mean()) for side in sides if min(code.shape) > 5]
    if min(code.shape) < FEWEST or min(uncertain) == 0:
        return Boundaries(mean, *own, np.nan, np.nan)
    (slope, _), variance = np.polyfit(np.log(sides - 1), np.log(uncertain), 1, cov=True)
    return Boundaries(mean, *own, float(slope), float(np.sqrt(variance[0, 0])))


def _boxes(code: Integers, side: int) -> tuple[Integers, Floats]:
    """Return how many types each of the boxes side by side has, and the shares of all types."""
    rows, columns = (length // side for length in code.shape)
    boxes = code[: rows * side, : columns * side].reshape(rows, side, columns, side)
    parts = np.array([(boxes == kind).mean(axis=(1, 3)) for kind in np.unique(code)])
    return (parts > 0).sum(axis=0), parts


def fill(values: NDArray[Any], known: Flags) -> NDArray[Any]:
    """Return an array in which the points that were not run, not `known`, have a value too.

    A point takes the value of the nearest run, in steps of the grid. Between runs that have a
    finite number it takes the linear interpolation instead; where the nearest run has none (NaN),
    as ``t_r`` without a reversal, it has none either. Axes of few values are not refined; planes
    across them are filled apart.
    """
    from scipy.interpolate import LinearNDInterpolator

    along = [n >= FEWEST_REFINED for n in values.shape]
    filled: NDArray[Any] = values[tuple(nearest(known, along))]
    if not np.issubdtype(values.dtype, np.floating):
        return filled
    others = (1 if own else n for own, n in zip(along, values.shape, strict=True))
    for place in np.ndindex(*others):
        here = tuple(slice(None) if own else k for own, k in zip(along, place, strict=True))
        new, wanted = filled[here], ~known[here] & np.isfinite(filled[here])
        source = known[here] & np.isfinite(values[here])
        spread = all(len(np.unique(axis)) > 1 for axis in np.nonzero(source))
        if wanted.any() and spread and new.ndim > 1 and source.sum() > new.ndim + 1:
            interpolate = LinearNDInterpolator(np.argwhere(source), values[here][source])
            between = interpolate(np.argwhere(wanted))
            new[wanted] = np.where(np.isfinite(between), between, new[wanted])
    return filled
