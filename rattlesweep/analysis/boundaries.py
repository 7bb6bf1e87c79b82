"""How ragged the boundaries between types are on a map: what is expected of maps of basins.

The measures are those of Attractors.jl, of the same names and by boxes as there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rattlesweep.arrays import Floats, Integers

BOX = 5
"""Points along a side of the boxes whose entropy is taken, as Daza et al. have it."""

FEWEST = 40
"""Points along a side below which no exponent can be told."""


class Boundaries(NamedTuple):
    """What the boundaries on a map are like; NaN where there are none.

    Basin entropy ``S_b`` and boundary basin entropy ``S_bb`` in nats: the mean entropy of the types
    in boxes of `BOX` x `BOX` points, of all boxes and of those with more types than one.
    ``S_bb > ln 2`` is fractal for sure (Daza et al., Sci. Rep. 6, 31416, 2016).

    Uncertainty exponent ``alpha``: the share of boxes of side ``e`` with more types than one goes
    as ``e^alpha``. 1 for smooth lines, less for fractal ones: their dimension is ``2 - alpha``
    (Grebogi et al., Phys. Lett. A 99, 415, 1983).
    """

    entropy: float
    boundary_entropy: float
    exponent: float

    @property
    def symbols(self) -> str:
        """The same in symbols, for figures."""
        return (
            rf"$S_b$ {self.entropy:.3f}, $S_{{bb}}$ {self.boundary_entropy:.3f}, "
            rf"$\alpha$ {self.exponent:.2f}"
        )

    @property
    def words(self) -> str:
        """The same for people."""
        return (
            f"basin entropy {self.entropy:.3f}, at boundaries {self.boundary_entropy:.3f}; "
            f"uncertainty exponent {self.exponent:.2f}"
        )


def boundaries(code: Integers) -> Boundaries:
    """Measures of a map, shape (x, y), of types as numbers from 0."""
    found, parts = _counts(code, BOX)
    with np.errstate(divide="ignore", invalid="ignore"):
        entropy = -np.nansum(parts * np.log(parts), axis=0)
    mixed = found > 1
    at = float(entropy[mixed].mean()) if mixed.any() else np.nan
    mean = float(entropy.mean()) if entropy.size else np.nan
    return Boundaries(mean, at, exponent(code))


def exponent(code: Integers) -> float:
    """The uncertainty exponent, by a straight line through boxes of 2 points to a 20th of a side.

    The points of a box lie one less than their number apart. NaN where there are too few points or
    no boundary.
    """
    if min(code.shape) < FEWEST:
        return np.nan
    sides = np.unique(np.geomspace(2, max(5, max(code.shape) // 20), 12).astype(int))
    uncertain = [float((_counts(code, side)[0] > 1).mean()) for side in sides]
    if min(uncertain) == 0:
        return np.nan
    return float(np.polyfit(np.log(sides - 1), np.log(uncertain), 1)[0])


def _counts(code: Integers, side: int) -> tuple[Integers, Floats]:
    """Of boxes side by side: how many types each has, and the shares of all types."""
    rows, columns = (length // side for length in code.shape)
    boxes = code[: rows * side, : columns * side].reshape(rows, side, columns, side)
    kinds = np.unique(code)
    parts = np.array([(boxes == kind).mean(axis=(1, 3)) for kind in kinds])
    return (parts > 0).sum(axis=0), parts
