"""How ragged the boundaries between types are on a map: what is expected of maps of basins.

The measures are those of Attractors.jl, by boxes as there. For the entropy at boundaries only boxes
with two types count: where three meet it says nothing about a line.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rattlesweep.arrays import Floats, Integers

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
