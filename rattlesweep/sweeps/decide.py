"""Sweeps that leave runs out: `stop` and `bodies.refine`.

Both decide in waves, each from the rows of the waves before it, so that what is wanted is the same
whoever asks, in whatever order the runs were done.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.columns import floats, runs_schema
from rattlesweep.sweeps.config.schema import Config, GridSource, Stop
from rattlesweep.sweeps.types import TYPES, R, codes, wilson

if TYPE_CHECKING:
    from rattlesweep.sweeps.stored import Case, Stored

# Samples of each case in the first wave, and those of the next one as a share of those so far.
FIRST, MORE = 400, 0.1
# Quantile of the normal distribution for 97 %: at 95 % a sweep stops too early now and then.
Z = 2.1700903775845606
FEWEST = 5  # values along an axis from which on some may be left out
FAILED = len(TYPES)
Array = NDArray[Any]


def decides(config: Config) -> str | None:
    """Return the key of the config by which a sweep leaves runs out; None if it does all runs."""
    if config.stop is not None:
        return "stop"
    bodies = config.bodies
    return "bodies.refine" if isinstance(bodies, GridSource) and bodies.refine else None


def decision(config: Config, cases: Sequence[Case], samples: int) -> Stopping | Refining | None:
    """Return what decides which runs of a sweep are wanted; None if all are."""
    if config.stop is not None:
        return Stopping(config.stop, (len(cases), samples))
    return Refining(config, cases, samples) if decides(config) else None


class _Known:
    """What is known of the runs, in arrays of the shape (cases, samples)."""

    def __init__(self, shape: tuple[int, int], column: str | None) -> None:
        self.code = np.full(shape, -1, np.int8)  # place in TYPES, FAILED, or -1 for no run
        self.value = np.full(shape if column else (0, 0), np.nan)
        self._column = column

    def read(self, stored: Stored) -> None:
        """Take all rows of a directory."""
        own = [self._column] if self._column else []
        for rows in stored.batches(["case", "sample", "type", "status", *own]):
            self.add(rows)

    def add(self, rows: pa.RecordBatch | pa.Table) -> None:
        """Take rows."""
        at = tuple(rows.column(name).to_numpy() for name in ("case", "sample"))
        ok = codes(rows.column("status"), ("ok",)) == 0
        self.code[at] = np.where(ok, codes(rows.column("type")), FAILED)
        if self._column:
            self.value[at] = floats(rows.column(self._column))


class Stopping(_Known):
    """More and more samples of each case until it is known well enough."""

    def __init__(self, stop: Stop, shape: tuple[int, int]) -> None:
        self._stop = stop
        super().__init__(shape, None if stop.t_r is None else "t_r")

    def wanted(self) -> Flags:
        """Return which runs are wanted, as far as the rows so far tell.  Shape (cases, samples)."""
        cases, samples = self.code.shape
        wanted = np.zeros((cases, samples), dtype=bool)
        active, done = np.arange(cases), 0
        while len(active) and done < samples:
            first, done = done, min(samples, max(FIRST, done + math.ceil(MORE * done)))
            wanted[active, first:done] = True
            if (self.code[active, first:done] < 0).any():
                break
            active = active[~self._are_known(active, done)]
        return wanted

    def _are_known(self, cases: Integers, samples: int) -> Flags:
        """Return which cases so many samples tell enough about."""
        code, stop, known = self.code[cases, :samples], self._stop, np.ones(len(cases), bool)
        if stop.fraction is not None:
            for number in range(len(TYPES)):
                low, high = wilson((code == number).sum(axis=1), (code < FAILED).sum(axis=1), Z)
                known &= (high - low) / 2 <= stop.fraction
        if stop.t_r is not None:
            times = np.ma.masked_where(code != R, self.value[cases, :samples])
            error = times.std(axis=1, ddof=1) / np.sqrt(times.count(axis=1))
            known &= (error * Z <= stop.t_r * times.mean(axis=1)).filled(False)
        return known


class Refining(_Known):
    """A grid of every 2^levels-th value, halved where the runs in or around a cell differ."""

    def __init__(self, config: Config, cases: Sequence[Case], samples: int) -> None:
        bodies, spin, losses = config.bodies, config.spin, config.dissipation
        assert isinstance(bodies, GridSource) and bodies.refine is not None  # noqa: PT018
        launches: dict[str, Sequence[float | None]] = {}
        if spin is not None:
            launches |= {"n_i": spin.n_i, "omega_xy0": spin.omega_xy0}
        if losses:
            launches |= {name: losses.values(name) for name in ("sigma", "rolling")}
        self.shape = tuple(len(values) for values in (launches | bodies.varying).values())
        # Steps of the coarse grid: two at least along an axis, unless it has few values.
        most = 1 << bodies.refine.levels
        self.strides = [1 if n < FEWEST else min(most, 1 << ((n - 1) // 2).bit_length() - 1)
                        for n in self.shape]  # fmt: skip
        self._refined = [axis for axis, stride in enumerate(self.strides) if stride > 1]
        if not self._refined:
            raise ConfigError(f"bodies.refine: no axis has {FEWEST} values or more to leave out")
        by, self._tol = bodies.refine.by, bodies.refine.tol
        if by not in runs_schema(config.parts, config.model).names:
            raise ConfigError(f"bodies.refine.by: there is no column {by} in these runs")
        super().__init__((len(cases), samples), None if by == "type" else by)
        # A directory may number its cases in another order than the axes.
        numbers = {tuple(getattr(case, name) for name in launches): case.index for case in cases}
        self._order = np.array([numbers[values] for values in product(*launches.values())])

    def grid(self, values: Array) -> Array:
        """Return values by (case, sample) as an array along the axes."""
        return np.asarray(values[self._order].reshape(self.shape))

    def runs(self, grid: Array) -> Array:
        """Return values along the axes by (case, sample)."""
        values = np.empty(self.code.shape, grid.dtype)
        values[self._order] = grid.reshape(len(self._order), -1)
        return values

    def wanted(self) -> Flags:
        """Return which runs are wanted, as far as the rows so far tell."""
        code, value = self.grid(self.code), self.grid(self.value) if self._column else None
        wanted = np.zeros(self.shape, dtype=bool)
        wanted[np.ix_(*map(_ticks, self.shape, self.strides))] = True
        while not (code[wanted] < 0).any():
            before = wanted.copy()
            # Only what this wave and those before it have found counts.
            seen = np.where(before, code, np.int8(-1))
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
        """Return the points of the cells of these sides that are to be halved."""
        at = [_ticks(n, s) for n, s in zip(self.shape, stride, strict=True)]
        most, least, corners = code, np.where(code >= 0, code, np.int8(127)), code[np.ix_(*at)] >= 0
        for axis in self._refined:
            most = _over(np.maximum, most, at[axis], axis)
            least = _over(np.minimum, least, at[axis], axis)
            corners = _over(np.logical_and, corners, np.arange(len(at[axis])), axis)
        differs = most != least
        if value is not None:
            differs |= self._bends(at, value[np.ix_(*at)])
        sides: list[tuple[Integers, ...]] = []
        for axis, cell in enumerate(np.nonzero(corners & differs)):
            low = at[axis][cell]
            sides.append((low,))
            if axis in self._refined:
                high = at[axis][cell + 1]
                sides[-1] = low, np.minimum(low + half[axis], high), high
        return product(*sides)

    def _bends(self, at: list[Integers], value: Floats) -> Flags:
        """Return which cells have a corner that lies off the line through its neighbours."""
        bends = np.zeros(value.shape, dtype=bool)
        for axis in self._refined:
            v, gaps = np.moveaxis(value, axis, -1), np.diff(at[axis])
            left, right, middle = gaps[:-1], gaps[1:], v[..., 1:-1]
            line = (v[..., :-2] * right + v[..., 2:] * left) / (left + right)
            off = np.abs(middle - line) > self._tol * np.maximum(np.abs(middle), np.abs(line))
            np.moveaxis(bends, axis, -1)[..., 1:-1] |= off
        for axis in self._refined:
            bends = _over(np.logical_or, bends, np.arange(len(at[axis])), axis)
        return bends


def _ticks(length: int, stride: int) -> Integers:
    """Return every so many-th place along an axis, and the last."""
    return np.unique(np.append(np.arange(0, length, stride), length - 1))


def _over(function: np.ufunc, values: Array, at: Integers, axis: int) -> Array:
    """Reduce the values of each cell along an axis, both ends included."""
    inner = function.reduceat(values, at[:-1], axis=axis)
    return np.asarray(function(inner, np.take(values, at[1:], axis=axis)))


def nearest(known: Flags, refined: Sequence[bool]) -> Integers:
    """Return the nearest known point of each point of a grid; other planes are apart."""
    from scipy.ndimage import distance_transform_edt

    apart = np.where(refined, 1.0, 1e6)
    index = distance_transform_edt(~known, apart, return_distances=False, return_indices=True)
    some = known.any(axis=tuple(np.flatnonzero(refined)), keepdims=True)
    return np.where(some, index, np.indices(known.shape))


def nearest_rows(stored: Stored) -> Iterator[tuple[int, Integers]]:
    """Yield each case of a refined sweep, with the nearest row to each sample, -1 for none yet."""
    refining = Refining(stored.config, stored.cases, stored.samples)
    refining.read(stored)
    there = refining.code >= 0
    row = np.where(there, np.cumsum(there).reshape(there.shape) - 1, -1)
    index = nearest(refining.grid(there), [stride > 1 for stride in refining.strides])
    yield from enumerate(refining.runs(refining.grid(row)[tuple(index)]))
