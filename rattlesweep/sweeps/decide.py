"""Sweeps that leave runs out: `stop` and `bodies.refine`.

Both decide in waves, each from the rows of the waves before it, so that what is wanted is a
function of the config and of the rows: the same whoever asks, in whatever order the runs were done.
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
from rattlesweep.sweeps.columns import runs_schema
from rattlesweep.sweeps.config.schema import Config, GridSource, Stop
from rattlesweep.sweeps.counts import codes, floats, wilson
from rattlesweep.sweeps.types import TYPES, R

if TYPE_CHECKING:
    from rattlesweep.sweeps.cases import Case
    from rattlesweep.sweeps.stored import Stored

FIRST = 400
"""Samples of each case in the first wave: with fewer the intervals are too uncertain to stop on."""
MORE = 0.1
"""Samples of the next wave, as a share of those so far."""
Z = 2.1700903775845606
"""Quantile of the normal distribution for 97 %.  A sweep that stops as soon as an interval of 95 %
is narrow enough stops too early now and then; the margin makes up for it
(`benchmarks/stopping.py`)."""
MOST_POINTS = 10**8
FEWEST = 5
"""Values along an axis from which on some may be left out."""
FAILED = len(TYPES)
"""Code of a run whose status is not ``ok``."""


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
    """What is known of the runs: arrays of the shape (cases, samples).

    Attributes
    ----------
    code : ndarray of int8
        Place of the type in :data:`TYPES`, :data:`FAILED` where a run is not ok, -1 for no run.
    value : ndarray
        The column that is asked for, if one is.
    """

    def __init__(self, shape: tuple[int, int], column: str | None) -> None:
        self.code = np.full(shape, -1, np.int8)
        self.value = np.full(shape if column else (0, 0), np.nan)
        self._column = column
        names = ("case", "sample", "type", "status", *((column,) if column else ()))
        self.columns = tuple(dict.fromkeys(names))

    def read(self, stored: Stored) -> None:
        """Take all rows of a directory."""
        for rows in stored.batches(self.columns):
            self.add(rows)

    def add(self, rows: pa.RecordBatch | pa.Table) -> None:
        """Take rows."""
        at = tuple(rows.column(name).to_numpy() for name in ("case", "sample"))
        ok = codes(rows.column("status"), ("ok",)) == 0
        self.code[at] = np.where(ok, codes(rows.column("type"), TYPES), FAILED)
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
        code, stop = self.code[cases, :samples], self._stop
        ok = (code < FAILED).sum(axis=1)
        known = np.ones(len(cases), dtype=bool)
        if stop.fraction is not None:
            for number in range(len(TYPES)):
                low, high = wilson((code == number).sum(axis=1), ok, Z)
                known &= (high - low) / 2 <= stop.fraction
        if stop.t_r is not None:
            reverses = code == R
            count = reverses.sum(axis=1)
            value = np.where(reverses, self.value[cases, :samples], 0.0)
            with np.errstate(divide="ignore", invalid="ignore"):
                mean = value.sum(axis=1) / count
                off = np.where(reverses, value - mean[:, None], 0.0)
                error = np.sqrt((off**2).sum(axis=1) / (count - 1) / count)
                known &= Z * error <= stop.t_r * mean
        return known


class Refining(_Known):
    """A grid of every 2^levels-th value, halved where the runs in and around a cell differ.

    A cell is halved if the runs known of it, its border included, are not of one type, or if the
    column that is asked for bends there: what is found on the border of a cell halves its
    neighbour, so that boundaries are followed to their ends.  Axes of few values are done whole.
    """

    def __init__(self, config: Config, cases: Sequence[Case], samples: int) -> None:
        bodies, spin, losses = config.bodies, config.spin, config.dissipation
        assert isinstance(bodies, GridSource)
        assert bodies.refine is not None
        refine = bodies.refine
        launches: dict[str, Sequence[float | None]] = {}
        if spin is not None:
            launches |= {"n_i": spin.n_i, "omega_xy0": spin.omega_xy0}
        if losses:
            launches |= {name: losses.values(name) for name in ("sigma", "rolling")}
        self.shape = tuple(len(values) for values in (launches | bodies.varying).values())
        if (points := math.prod(self.shape)) > MOST_POINTS:
            raise ConfigError(
                f"bodies.refine: the finest grid has {points} points; at most {MOST_POINTS} are "
                "possible"
            )
        self.strides = strides(self.shape, refine.levels)
        if max(self.strides) == 1:
            raise ConfigError(
                f"bodies.refine: no axis has {FEWEST} values or more, so there is nothing to leave "
                "out; the axes are those of the finest grid"
            )
        if refine.by not in runs_schema(config.parts, config.model).names:
            raise ConfigError(
                f"bodies.refine.by: there is no column {refine.by} in these runs; have it "
                "recorded, or take another"
            )
        self._tol = refine.tol
        super().__init__((len(cases), samples), None if refine.by == "type" else refine.by)
        # A directory may number its cases in another order than the axes.
        numbers = {tuple(getattr(case, name) for name in launches): case.index for case in cases}
        self._order = np.array([numbers[values] for values in product(*launches.values())])

    def _grid(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values by (case, sample) as an array along the axes."""
        grid: NDArray[Any] = values[self._order].reshape(self.shape)
        return grid

    def _runs(self, grid: NDArray[Any]) -> NDArray[Any]:
        """Return values along the axes by (case, sample)."""
        values = np.empty(self.code.shape, grid.dtype)
        values[self._order] = grid.reshape(len(self._order), -1)
        return values

    def wanted(self) -> Flags:
        """Return which runs are wanted, as far as the rows so far tell.  Shape (cases, samples)."""
        code, value = self._grid(self.code), self._grid(self.value) if self._column else None
        wanted = np.zeros(self.shape, dtype=bool)
        wanted[np.ix_(*map(ticks, self.shape, self.strides))] = True
        while not (code[wanted] < 0).any():
            before = wanted.copy()
            # Only what this wave and those before it have found counts.
            seen = np.where(before, code, np.int8(-1))
            seen_value = None if value is None else np.where(before, value, np.nan)
            stride = self.strides
            while max(stride) > 1:
                self._halve(stride, wanted, seen, seen_value)
                stride = tuple(max(1, s // 2) if s == max(stride) else s for s in stride)
            if (wanted == before).all():
                break
        return self._runs(wanted)

    def nearest(self, there: Flags) -> tuple[Integers, Integers]:
        """Return case and sample of the run nearest to each among those that are `there`."""
        index = nearest(self._grid(there), [stride > 1 for stride in self.strides])
        number = self._grid(np.arange(there.size).reshape(there.shape))
        case, sample = np.divmod(self._runs(number[tuple(index)]), there.shape[1])
        return case, sample

    def _halve(
        self, stride: tuple[int, ...], wanted: Flags, code: NDArray[np.int8], value: Floats | None
    ) -> None:
        """Mark the points of the cells of these sides that are to be halved."""
        at = [ticks(n, s) for n, s in zip(self.shape, stride, strict=True)]
        refined = [axis for axis, s in enumerate(self.strides) if s > 1]
        most, least = code, np.where(code >= 0, code, np.int8(127))
        corners = code[np.ix_(*at)] >= 0
        for axis in refined:
            most = _over(np.maximum, most, at[axis], axis)
            least = _over(np.minimum, least, at[axis], axis)
            corners = _ends(np.logical_and, corners, axis)
        differs = most != least
        if value is not None:
            differs |= self._bends(at, refined, value)
        sides: list[tuple[Integers, ...]] = []
        for axis, cell in enumerate(np.nonzero(corners & differs)):
            low = at[axis][cell]
            if axis not in refined:
                sides.append((low,))
                continue
            high = at[axis][cell + 1]
            half = max(1, stride[axis] // 2) if stride[axis] == max(stride) else stride[axis]
            sides.append((low, np.minimum(low + half, high), high))
        for point in product(*sides):
            wanted[point] = True

    def _bends(self, at: list[Integers], refined: list[int], values: Floats) -> Flags:
        """Return which cells have a corner that lies off the line through its neighbours."""
        value = values[np.ix_(*at)]
        bends = np.zeros(value.shape, dtype=bool)
        for axis in refined:
            if len(at[axis]) < 3:
                continue
            v, gaps = np.moveaxis(value, axis, -1), np.diff(at[axis])
            left, right = gaps[:-1], gaps[1:]
            line = (v[..., :-2] * right + v[..., 2:] * left) / (left + right)
            middle = v[..., 1:-1]
            off = np.abs(middle - line) > self._tol * np.maximum(np.abs(middle), np.abs(line))
            np.moveaxis(bends, axis, -1)[..., 1:-1] |= off
        for axis in refined:
            bends = _ends(np.logical_or, bends, axis)
        return bends


def strides(shape: Sequence[int], levels: int) -> tuple[int, ...]:
    """Return the steps of the coarse grid along axes of so many values: two at least, or 1."""
    return tuple(1 if n < FEWEST else min(1 << levels, 1 << ((n - 1) // 2).bit_length() - 1)
                 for n in shape)  # fmt: skip


def ticks(length: int, stride: int) -> Integers:
    """Return every so many-th place along an axis, and the last."""
    return np.unique(np.append(np.arange(0, length, stride), length - 1))


def _over(
    function: np.ufunc, values: NDArray[np.int8], at: Integers, axis: int
) -> NDArray[np.int8]:
    """Return the most or the least of each cell along an axis, both ends included."""
    inner = function.reduceat(values, at[:-1], axis=axis)
    ends: NDArray[np.int8] = function(inner, np.take(values, at[1:], axis=axis))
    return ends


def _ends(function: np.ufunc, values: Flags, axis: int) -> Flags:
    """Return both ends of each cell along an axis together."""
    v = np.moveaxis(values, axis, 0)
    both: Flags = np.moveaxis(function(v[:-1], v[1:]), 0, axis)
    return both


def nearest(known: Flags, refined: Sequence[bool]) -> Integers:
    """Return the indices of the nearest known point of each point of a grid, shape (axes, ...).

    Planes across axes that are not `refined` are apart: the points of one without any known point
    have their own indices.
    """
    from scipy.ndimage import distance_transform_edt

    index = np.indices(known.shape)
    axes = np.flatnonzero(refined)
    others = (1 if own else n for own, n in zip(refined, known.shape, strict=True))
    for place in np.ndindex(*others):
        here = tuple(slice(None) if own else k for own, k in zip(refined, place, strict=True))
        if known[here].any() and not known[here].all():
            index[(axes, *here)] = distance_transform_edt(
                ~known[here], return_distances=False, return_indices=True
            )
    return index


def nearest_rows(stored: Stored) -> Iterator[tuple[int, Integers]]:
    """Yield each case of a refined sweep, with the row of the run nearest to each of its samples.

    Rows are counted in the order of their keys; -1 where there is no run yet.
    """
    refining = Refining(stored.config, stored.cases, stored.samples)
    refining.read(stored)
    there = refining.code >= 0
    row = np.where(there, np.cumsum(there).reshape(there.shape) - 1, -1)
    for number, (case, sample) in enumerate(zip(*refining.nearest(there), strict=True)):
        yield number, row[case, sample]
