"""Sweeps that skip some runs: `stop` and `bodies.refine`.

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
from rattlesweep.config.body_sources import GridSource
from rattlesweep.config.schema import Stop
from rattlesweep.design.cases import Design
from rattlesweep.rows.types import CODE_R, TYPES
from rattlesweep.statistics.intervals import wilson
from rattlesweep.statistics.tails import LEAST_INDEX, median_error, tail_index
from rattlesweep.store.rows import CODE_FAILED, CODE_MISSING, Found, Stored
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.units import Setting

FIRST_WAVE = 400  # samples of each case in the first wave of `stop`
NEXT_WAVE = 0.1  # size of each later wave as a share of the samples so far
# Quantile of the normal distribution for 97 %; with that of 95 %, some cases stop too
# early.
Z = 2.1700903775845606
FEWEST = 5  # values that an axis needs before some are left out
Codes = NDArray[np.int8]
Array = NDArray[Any]


def wanted_runs(design: Design, rows: Found) -> Flags:
    """Return which runs are wanted by the rows so far; shape (cases, samples)."""
    if design.config.stop is not None:
        return _wanted_samples(design.config.stop, rows)
    if design.config.deciding_key:
        return Refining(design).wanted(rows)
    return np.ones(design.shape, dtype=bool)


def _wanted_samples(stop: Stop, rows: Found) -> Flags:
    """Add samples to each case until its statistics are precise enough."""
    cases, samples = rows.code.shape
    wanted = np.zeros((cases, samples), dtype=bool)
    active = np.arange(cases)
    end = 0
    while len(active) and end < samples:
        first = end
        end = max(FIRST_WAVE, first + math.ceil(NEXT_WAVE * first))
        end = min(end, samples)
        wanted[active, first:end] = True
        if (rows.code[active, first:end] == CODE_MISSING).any():
            break
        active = active[~_is_precise(stop, rows, active, end)]
    return wanted


def _is_precise(stop: Stop, rows: Found, cases: Integers, samples: int) -> Flags:
    """Return the cases for which this number of samples is enough."""
    code = rows.code[cases, :samples]
    precise = np.ones(len(cases), bool)
    if stop.fraction is not None:
        typed_runs = (code < CODE_FAILED).sum(axis=1)
        for number in range(len(TYPES)):
            low, high = wilson((code == number).sum(axis=1), typed_runs, Z)
            precise &= (high - low) / 2 <= stop.fraction
    if stop.t_r is not None:
        times = np.ma.masked_where(code != CODE_R, rows.value[cases, :samples])
        error = times.std(axis=1, ddof=1) / np.sqrt(times.count(axis=1))
        # Without two reversals there is no error, so the case goes on.
        precise &= (error * Z <= stop.t_r * times.mean(axis=1)).filled(False)
    if stop.watches_times:
        for place in np.flatnonzero(precise):
            is_reversal = code[place] == CODE_R
            times_of_case = rows.value[cases[place], :samples][is_reversal]
            precise[place] = _has_precise_times(stop, times_of_case)
    return precise


def _has_precise_times(stop: Stop, times: Floats) -> bool:
    """Return whether the reversal times of a case have a mean, and a known median."""
    is_precise = True
    if stop.t_r is not None:
        # Where the mean may not exist, its standard error says nothing.
        is_precise = not tail_index(times) < LEAST_INDEX
    if stop.t_r_median is not None:
        is_precise &= median_error(times, Z) <= stop.t_r_median
    return is_precise


class Refining:
    """Starts from every 2^levels-th value of a grid, and halves cells that differ."""

    def __init__(self, design: Design) -> None:
        config = design.config
        bodies = config.bodies
        assert isinstance(bodies, GridSource) and bodies.refine is not None  # noqa: PT018
        names = ["n_i", "omega_xy0"] if config.spin else []
        names += list(config.acting.values) if config.acting else []
        held = {name: {case.value(name) for case in design.cases} for name in names}
        launches = {
            name: _in_units_of_bodies(config.settings[name], held[name])
            for name in names
        }
        axes = launches | bodies.varying
        self.shape = tuple(len(values) for values in axes.values())
        self.strides = [_first_stride(n, bodies.refine.levels) for n in self.shape]
        self._refined = [axis for axis, stride in enumerate(self.strides) if stride > 1]
        if not self._refined:
            raise ConfigError(
                f"bodies.refine: no axis has {FEWEST} values or more to leave out"
            )
        column = bodies.refine.by
        if column not in design.schema.names:
            raise ConfigError(
                f"bodies.refine.by: there is no column {column} in these runs"
            )
        self._by_regime = column == "regime"
        self._tol = bodies.refine.tol
        # A directory that has grown may number its cases in another order than the
        # axes.
        case_numbers = {
            tuple(case.value(name) for name in names): case.index
            for case in design.cases
        }
        self._order = np.array(
            [case_numbers[values] for values in product(*launches.values())]
        )

    def grid(self, values: Array) -> Array:
        """Return values by (case, sample) as an array along the axes."""
        return values[self._order].reshape(self.shape)

    def runs(self, grid: Array) -> Array:
        """Return values along the axes by (case, sample)."""
        by_launch = grid.reshape(len(self._order), -1)
        values = np.empty_like(by_launch)
        values[self._order] = by_launch
        return values

    def wanted(self, rows: Found) -> Flags:
        """Return which runs are wanted by the rows so far; shape (cases, samples)."""
        code = self.grid(rows.code)
        compared = code
        if self._by_regime:
            regime = self.grid(rows.value)
            compared = np.where(regime >= 0, regime, CODE_FAILED).astype(np.int8)
        wanted = np.zeros(self.shape, dtype=bool)
        wanted[np.ix_(*map(ticks_of, self.shape, self.strides))] = True
        # Each turn of the loop is a wave, as far as all runs of those before are there.
        while not (code[wanted] == CODE_MISSING).any():
            before = wanted.copy()
            # Rows beyond this wave must not count.
            wave_code = np.where(before, compared, np.int8(CODE_MISSING))
            wave_value = None
            if rows.column and not self._by_regime:
                wave_value = np.where(before, self.grid(rows.value), np.nan)
            stride = self.strides
            while max(stride) > 1:
                longest = max(stride)
                half = [max(1, s // 2) if s == longest else s for s in stride]
                for point in self._halved(stride, half, wave_code, wave_value):
                    wanted[point] = True
                stride = half
            if (wanted == before).all():
                break
        return self.runs(wanted)

    def _halved(
        self, stride: list[int], half: list[int], code: Codes, value: Floats | None
    ) -> Iterator[tuple[Integers, ...]]:
        """Yield the points that halve the cells whose runs differ."""
        ticks = [ticks_of(n, s) for n, s in zip(self.shape, stride, strict=True)]
        corners = np.ix_(*ticks)
        # By cell: largest and smallest type, and whether all corners have a row.
        largest: Array = code
        smallest: Array = np.where(code != CODE_MISSING, code, np.int8(127))
        is_known: Array = code[corners] != CODE_MISSING
        for axis in self._refined:
            largest = _over(np.maximum, largest, ticks[axis], axis)
            smallest = _over(np.minimum, smallest, ticks[axis], axis)
            neighbours = np.arange(len(ticks[axis]))
            is_known = _over(np.logical_and, is_known, neighbours, axis)
        differs = largest != smallest
        if value is not None:
            differs |= self._bends(ticks, value[corners])
        # Along each axis, both sides of these cells and the point between them.
        sides: list[tuple[Integers, ...]] = []
        for axis, cell in enumerate(np.nonzero(is_known & differs)):
            low = ticks[axis][cell]
            if axis in self._refined:
                high = ticks[axis][cell + 1]
                sides.append((low, np.minimum(low + half[axis], high), high))
            else:
                sides.append((low,))
        return product(*sides)

    def _bends(self, ticks: list[Integers], value: Floats) -> Flags:
        """Return the cells with a corner off the line through its neighbours."""
        bends = np.zeros(value.shape, dtype=bool)
        for axis in self._refined:
            along = np.moveaxis(value, axis, -1)
            middle = along[..., 1:-1]
            gaps = np.diff(ticks[axis])
            left = gaps[:-1]
            right = gaps[1:]
            line = (along[..., :-2] * right + along[..., 2:] * left) / (left + right)
            scale = np.maximum(np.abs(middle), np.abs(line))
            is_off = np.abs(middle - line) > self._tol * scale
            np.moveaxis(bends, axis, -1)[..., 1:-1] |= is_off
        # A cell bends if one of its corners does.
        for axis in self._refined:
            bends = _over(np.logical_or, bends, np.arange(len(ticks[axis])), axis)
        return bends


def nearest_rows(stored: Stored) -> Iterator[tuple[int, Integers]]:
    """Yield each case of a refined sweep with the rows nearest to its samples.

    A row is -1 where there is none yet.
    """
    refining = Refining(stored)
    is_stored = stored.find().done
    row = np.cumsum(is_stored).reshape(is_stored.shape) - 1
    row = np.where(is_stored, row, -1)
    is_refined = [stride > 1 for stride in refining.strides]
    index = nearest(refining.grid(is_stored), is_refined)
    yield from enumerate(refining.runs(refining.grid(row)[tuple(index)]))


def nearest(known: Flags, refined: Sequence[bool]) -> Integers:
    """Return the nearest known point of each point of a grid.

    Only points along the `refined` axes count.
    """
    from scipy.ndimage import distance_transform_edt

    distances = np.where(refined, 1.0, 1e6)
    index = distance_transform_edt(
        ~known, distances, return_distances=False, return_indices=True
    )
    any_known = known.any(axis=tuple(np.flatnonzero(refined)), keepdims=True)
    return np.where(any_known, index, np.indices(known.shape))


def _in_units_of_bodies(
    values: Sequence[Setting], held: set[float | None]
) -> list[float | None]:
    """Return values of a config, some of which have units, as the cases hold them."""
    in_si = sorted(value.si for value in values if value.si is not None)
    converted = held.difference(value.natural for value in values if value.si is None)
    # Bodies of one size convert all by one factor, so the order stays.
    in_order = sorted(converted, key=lambda x: x or 0.0)
    natural = dict(zip(in_si, in_order, strict=True))
    return [
        value.natural if value.si is None else natural[value.si] for value in values
    ]


def _first_stride(length: int, levels: int) -> int:
    """Return the coarsest stride along an axis: a power of two, at most 2^levels."""
    if length < FEWEST:
        return 1
    # The coarse grid has at least two steps along an axis.
    half = (length - 1) // 2
    return int(min(1 << levels, 1 << (half.bit_length() - 1)))


def ticks_of(length: int, stride: int) -> Integers:
    """Return every `stride`-th index along an axis, and the last."""
    return np.unique(np.append(np.arange(0, length, stride), length - 1))


def _over(function: np.ufunc, values: Array, at: Integers, axis: int) -> Array:
    """Reduce the values of each cell along an axis, both ends included."""
    inner = function.reduceat(values, at[:-1], axis=axis)
    return function(inner, np.take(values, at[1:], axis=axis))
