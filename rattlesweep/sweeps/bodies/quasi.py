"""Points that fill the ranges of bodies more evenly than random ones: scrambled Sobol' sequences.

A point is a function of the seed and the sample: sample ``k`` is the ``k``-th point of a sequence
that is scrambled (Owen, J. Complexity 14, 466, 1998) by the seed.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy.stats import qmc

from rattlesweep.arrays import Floats, Integers

# Points that nobody asks for are made up to so long a gap, and skipped beyond.
APART = 4096


class Sequence:
    """A scrambled Sobol' sequence, from which points are taken by their numbers."""

    def __init__(self, dimensions: int, seed: int) -> None:
        self._dimensions = dimensions
        self._sequence = qmc.Sobol(dimensions, rng=np.random.default_rng((seed, 0)))

    def points(self, numbers: Integers) -> Floats:
        """Points of the unit cube, shape (dimensions, numbers); spans that follow are cheap."""
        points = np.empty((self._dimensions, len(numbers)))
        # A block may hold the end of one case and the start of the next.
        step = np.diff(numbers)
        edges = np.flatnonzero((step < 0) | (step > APART)) + 1
        for place in np.split(np.arange(len(numbers)), edges):
            if len(place):
                first, last = int(numbers[place[0]]), int(numbers[place[-1]])
                points[:, place] = self._span(first, last + 1)[:, numbers[place] - first]
        return points

    def _span(self, first: int, stop: int) -> Floats:
        if first < self._sequence.num_generated:
            self._sequence.reset()
        if first > self._sequence.num_generated:
            self._sequence.fast_forward(first - self._sequence.num_generated)
        with warnings.catch_warnings():
            # Of a first span whose length is no power of 2: all spans together are the sweep.
            warnings.simplefilter("ignore", UserWarning)
            span: Floats = self._sequence.random(stop - first).T
        return span


class Design(Sequence):
    """Samples in groups about two points, for indices of sensitivity.

    The first sample of a group is the one point, the second the other, and each of the rest the
    first with one coordinate of the second.
    """

    def __init__(self, dimensions: int, seed: int, group: int) -> None:
        super().__init__(2 * dimensions, seed)
        self._group = group

    def points(self, numbers: Integers) -> Floats:
        """Points of the unit cube, shape (dimensions, numbers)."""
        first, second = np.split(super().points(numbers // self._group), 2)
        which = numbers % self._group
        swapped = (which == 1) | (which == 2 + np.arange(len(first))[:, None])
        return np.where(swapped, second, first)
