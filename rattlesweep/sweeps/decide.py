"""Sweeps that leave runs out: `stop` and `bodies.refine`.

Both decide in waves.  Each wave follows from the rows of the waves before it alone, so
the wanted runs do not depend on who computed them, or in which order.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.config.schema import GridSource, Stop
from rattlesweep.sweeps.stored import FAILED, MISSING, Design, Found, Stored
from rattlesweep.sweeps.types import TYPES, R, wilson
from rattlesweep.units import Quantity

FIRST_WAVE = 400  # samples of each case in the first wave of `stop`
NEXT_WAVE = 0.1  # size of each later wave as a share of the samples so far
# Quantile of the normal distribution for 97 %; with that of 95 %, some cases stop too
# early.
Z = 2.1700903775845606
FEWEST = 5  # values that an axis needs before some are left out
Array = NDArray[Any]


def wanted_runs(design: Design, found: Found) -> Flags:
    """Return the wanted runs, as far as the rows so far tell; shape (cases,
    samples).
    """
    if design.config.stop is not None:
        return _wanted_samples(design.config.stop, found)
    if design.config.deciding_key:
        return Refining(design).wanted(found)
    return np.ones(design.shape, dtype=bool)


def _wanted_samples(stop: Stop, found: Found) -> Flags:
    """Add samples to each case until its statistics are precise enough."""
    cases, samples = found.code.shape
    wanted = np.zeros((cases, samples), dtype=bool)
    active, end = np.arange(cases), 0
    while len(active) and end < samples:
        first, end = (
            end,
            min(samples, max(FIRST_WAVE, end + math.ceil(NEXT_WAVE * end))),
        )
        wanted[active, first:end] = True
        if (found.code[active, first:end] == MISSING).any():
            break
        active = active[~_are_known(stop, found, active, end)]
    return wanted


def _are_known(stop: Stop, found: Found, cases: Integers, samples: int) -> Flags:
    """Return the cases for which this number of samples is enough."""
    code, known = found.code[cases, :samples], np.ones(len(cases), bool)
    if stop.fraction is not None:
        for number in range(len(TYPES)):
            low, high = wilson(
                (code == number).sum(axis=1), (code < FAILED).sum(axis=1), Z
            )
            known &= (high - low) / 2 <= stop.fraction
    if stop.t_r is not None:
        times = np.ma.masked_where(code != R, found.value[cases, :samples])
        error = times.std(axis=1, ddof=1) / np.sqrt(times.count(axis=1))
        known &= (error * Z <= stop.t_r * times.mean(axis=1)).filled(False)
    return known


class Refining:
    """Start from every 2^levels-th value of a grid, and halve cells whose runs
    differ.
    """

    def __init__(self, design: Design) -> None:
        config, bodies = design.config, design.config.bodies
        assert isinstance(bodies, GridSource) and bodies.refine is not None  # noqa: PT018
        names = ["n_i", "omega_xy0"] if config.spin else []
        names += ["sigma", "rolling"] if config.dissipation else []
        held = {name: {getattr(case, name) for case in design.cases} for name in names}
        launches = {
            name: _in_units_of_bodies(config.settings[name], held[name])
            for name in names
        }
        self.shape = tuple(
            len(values) for values in (launches | bodies.varying).values()
        )
        # The coarse grid has at least two steps along an axis, unless that has few
        # values.
        most = 1 << bodies.refine.levels
        self.strides = [
            1 if n < FEWEST else min(most, 1 << ((n - 1) // 2).bit_length() - 1)
            for n in self.shape
        ]
        self._refined = [axis for axis, stride in enumerate(self.strides) if stride > 1]
        if not self._refined:
            raise ConfigError(
                f"bodies.refine: no axis has {FEWEST} values or more to leave out"
            )
        by, self._tol = bodies.refine.by, bodies.refine.tol
        if by not in design.schema.names:
            raise ConfigError(
                f"bodies.refine.by: there is no column {by} in these runs"
            )
        # A directory that has grown may number its cases in another order than the
        # axes.
        numbers = {
            tuple(getattr(case, k) for k in names): case.index for case in design.cases
        }
        self._order = np.array(
            [numbers[values] for values in product(*launches.values())]
        )

    def grid(self, values: Array) -> Array:
        """Return values by (case, sample) as an array along the axes."""
        return np.asarray(values[self._order].reshape(self.shape))

    def runs(self, grid: Array) -> Array:
        """Return values along the axes by (case, sample)."""
        by_launch = grid.reshape(len(self._order), -1)
        values = np.empty_like(by_launch)
        values[self._order] = by_launch
        return values

    def wanted(self, found: Found) -> Flags:
        """Return the wanted runs, as far as the rows so far tell; shape (cases,
        samples).
        """
        code, value = (
            self.grid(found.code),
            self.grid(found.value) if found.column else None,
        )
        wanted = np.zeros(self.shape, dtype=bool)
        wanted[np.ix_(*map(ticks_of, self.shape, self.strides))] = True
        while not (code[wanted] == MISSING).any():
            before = wanted.copy()
            # Rows beyond this wave must not count.
            seen = np.where(before, code, np.int8(MISSING))
            seen_value = None if value is None else np.where(before, value, np.nan)
            stride = self.strides
            while max(stride) > 1:
                half = [max(1, s // 2) if s == max(stride) else s for s in stride]
                for point in self._halved(stride, half, seen, seen_value):
                    wanted[point] = True
                stride = half
            if (wanted == before).all():
                break
        return self.runs(wanted)

    def _halved(
        self, stride: list[int], half: list[int], code: Array, value: Floats | None
    ) -> Iterator[tuple[Integers, ...]]:
        """Yield the points that halve those cells, with sides `stride`, whose runs
        differ.
        """
        ticks = [ticks_of(n, s) for n, s in zip(self.shape, stride, strict=True)]
        corners = np.ix_(*ticks)
        # By cell: largest and smallest type, and whether all corners have a row.
        most, least = code, np.where(code != MISSING, code, np.int8(127))
        known = code[corners] != MISSING
        for axis in self._refined:
            most = _over(np.maximum, most, ticks[axis], axis)
            least = _over(np.minimum, least, ticks[axis], axis)
            known = _over(np.logical_and, known, np.arange(len(ticks[axis])), axis)
        differs = most != least
        if value is not None:
            differs |= self._bends(ticks, value[corners])
        sides: list[tuple[Integers, ...]] = []
        for axis, cell in enumerate(np.nonzero(known & differs)):
            low = ticks[axis][cell]
            if axis in self._refined:
                high = ticks[axis][cell + 1]
                sides.append((low, np.minimum(low + half[axis], high), high))
            else:
                sides.append((low,))
        return product(*sides)

    def _bends(self, ticks: list[Integers], value: Floats) -> Flags:
        """Return the cells with a corner that lies off the line through its
        neighbours.
        """
        bends = np.zeros(value.shape, dtype=bool)
        for axis in self._refined:
            v, gaps = np.moveaxis(value, axis, -1), np.diff(ticks[axis])
            left, right, middle = gaps[:-1], gaps[1:], v[..., 1:-1]
            line = (v[..., :-2] * right + v[..., 2:] * left) / (left + right)
            off = np.abs(middle - line) > self._tol * np.maximum(
                np.abs(middle), np.abs(line)
            )
            np.moveaxis(bends, axis, -1)[..., 1:-1] |= off
        for axis in self._refined:
            bends = _over(np.logical_or, bends, np.arange(len(ticks[axis])), axis)
        return bends


def nearest_rows(stored: Stored) -> Iterator[tuple[int, Integers]]:
    """Yield each case of a refined sweep with the row nearest to each sample, -1 for
    none yet.
    """
    refining, is_stored = Refining(stored), stored.find().done
    row = np.where(is_stored, np.cumsum(is_stored).reshape(is_stored.shape) - 1, -1)
    index = nearest(
        refining.grid(is_stored), [stride > 1 for stride in refining.strides]
    )
    yield from enumerate(refining.runs(refining.grid(row)[tuple(index)]))


def nearest(known: Flags, refined: Sequence[bool]) -> Integers:
    """Return the nearest known point of each point of a grid, moving along `refined`
    axes only.
    """
    from scipy.ndimage import distance_transform_edt

    apart = np.where(refined, 1.0, 1e6)
    index = distance_transform_edt(
        ~known, apart, return_distances=False, return_indices=True
    )
    some = known.any(axis=tuple(np.flatnonzero(refined)), keepdims=True)
    return np.where(some, index, np.indices(known.shape))


def _in_units_of_bodies(
    values: Sequence[float | None], held: set[float | None]
) -> list[float | None]:
    """Return values of a config, some of which have units, as the cases hold them."""
    given = sorted(value for value in values if isinstance(value, Quantity))
    others = held.difference(
        value for value in values if not isinstance(value, Quantity)
    )
    # Bodies of one size convert all by one factor, so the order stays.
    natural = dict(zip(given, sorted(others, key=lambda x: x or 0.0), strict=True))
    return [
        natural[value] if isinstance(value, Quantity) else value for value in values
    ]


def ticks_of(length: int, stride: int) -> Integers:
    """Return every `stride`-th index along an axis, and the last."""
    return np.unique(np.append(np.arange(0, length, stride), length - 1))


def _over(function: np.ufunc, values: Array, at: Integers, axis: int) -> Array:
    """Reduce the values of each cell along an axis, both ends included."""
    inner = function.reduceat(values, at[:-1], axis=axis)
    return np.asarray(function(inner, np.take(values, at[1:], axis=axis)))
