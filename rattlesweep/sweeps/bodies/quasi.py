"""Scrambled Sobol' sequences, which fill the ranges of bodies more evenly than random points.

Sample ``k`` is the ``k``-th point of a sequence that the seed scrambles (Owen, J. Complexity 14,
466, 1998), and so a function of the seed and its own number.
"""

from __future__ import annotations

from threading import Lock

import numpy as np
from scipy.stats import qmc

from rattlesweep.arrays import Floats


class Sequence:
    """Points of the unit cube, taken by their numbers.

    Parameters
    ----------
    dimensions : int
        Coordinates of a point.
    seed : int
        Seed of the scrambling.
    group : int
        1 for the plain sequence.  Otherwise samples come in groups of `group` about two points, for
        indices of sensitivity: the first sample of a group is the one point, the second the other,
        and each of the rest is the first point with one coordinate of the second.
    """

    def __init__(self, dimensions: int, seed: int, group: int = 1) -> None:
        self._group = group
        size = dimensions if group == 1 else 2 * dimensions
        self._sobol = qmc.Sobol(size, rng=np.random.default_rng((seed, 0)))
        self._lock = Lock()

    def points(self, first: int, stop: int) -> Floats:
        """Return the points with numbers from `first` up to `stop`, shape (dimensions, points)."""
        if self._group == 1:
            return self._sobol_points(first, stop)
        group, place = np.divmod(np.arange(first, stop), self._group)
        pairs = self._sobol_points(int(group[0]), int(group[-1]) + 1)[:, group - group[0]]
        one, other = np.split(pairs, 2)
        swapped = (place == 1) | (place == 2 + np.arange(len(one))[:, None])
        return np.where(swapped, other, one)

    def _sobol_points(self, first: int, stop: int) -> Floats:
        count = stop - first
        with self._lock:
            if first < self._sobol.num_generated:
                self._sobol.reset()
            if first > self._sobol.num_generated:
                self._sobol.fast_forward(first - self._sobol.num_generated)
            # SciPy warns if the first points it is asked for are not a power of two.
            asked = count if first else 1 << (count - 1).bit_length()
            points: Floats = self._sobol.random(asked)[:count].T
        return points
