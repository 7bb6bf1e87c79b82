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
    """What is known of the runs.

    Attributes
    ----------
    code : ndarray of int8, shape (cases, samples)
        Place of the type in :data:`TYPES`, :data:`FAILED` where a run is not ok, -1 where there is
        none.
    value : ndarray, shape (cases, samples) or (0, 0)
        The column that is asked for.
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

    A cell is refined if the runs known of it, its border included, are not of one type, or if the
    column that is asked for bends there: what is found on the border of a cell refines its
    neighbour, so that boundaries are followed to their ends.  Axes of few values are done whole.

    Parameters
    ----------
    config : Config
    cases : sequence of Case
    samples : int
    """

    def __init__(self, config: Config, cases: Sequence[Case], samples: int) -> None:
        bodies, spin = config.bodies, config.spin
        assert isinstance(bodies, GridSource)
        assert bodies.refine is not None
        refine = bodies.refine
        launches: dict[str, Sequence[float | None]] = {}
        if spin is not None:
            launches |= {"n_i": spin.n_i, "omega_xy0": spin.omega_xy0}
        if losses := config.dissipation:
            launches |= {name: losses.values(name) for name in ("sigma", "rolling")}
        axes = bodies.varying
        lengths = {name: len(values) for name, values in (launches | axes).items()}
        self.names, self.shape = tuple(lengths), tuple(lengths.values())
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
        code = self._grid(self.code)
        value = self._grid(self.value) if self.value.size else None
        wanted = np.zeros(self.shape, dtype=bool)
        wanted[np.ix_(*(ticks(n, s) for n, s in zip(self.shape, self.strides, strict=True)))] = True
        while not (code[wanted] < 0).any():
            more = np.zeros(self.shape, dtype=bool)
            # Only what this wave and those before it have found counts.
            seen = np.where(wanted, code, np.int8(-1))
            seen_value = None if value is None else np.where(wanted, value, np.nan)
            stride = self.strides
            while max(stride) > 1:
                self._halve(stride, more, seen, seen_value)
                stride = tuple(max(1, s // 2) if s == max(stride) else s for s in stride)
            more &= ~wanted
            if not more.any():
                break
            wanted |= more
        return self._runs(wanted)

    def nearest(self, there: Flags) -> tuple[Integers, Integers]:
        """Return for each run, by (case, sample), which of those that are `there` is nearest on the
        grid.

        Axes of few values, which are done whole, are no way to a neighbour.  Two arrays of the
        shape (cases, samples): case and sample of that run.
        """
        from scipy.ndimage import distance_transform_edt

        missing, numbers = ~self._grid(there), np.arange(there.size).reshape(there.shape)
        number = self._grid(numbers)
        whole = [axis for axis, stride in enumerate(self.strides) if stride == 1]
        filled = np.empty(self.shape, dtype=np.int64)
        for place in product(*(range(self.shape[axis]) for axis in whole)):
            here: list[Any] = [slice(None)] * len(self.shape)
            for axis, k in zip(whole, place, strict=True):
                here[axis] = k
            at = tuple(here)
            if missing[at].all():
                filled[at] = number[at]  # nothing there yet, so each is its own
                continue
            index = distance_transform_edt(missing[at], return_distances=False, return_indices=True)
            filled[at] = number[at][tuple(index)]
        case, sample = np.divmod(self._runs(filled), there.shape[1])
        return case, sample

    def _halve(
        self, stride: tuple[int, ...], wanted: Flags, code: NDArray[np.int8], value: Floats | None
    ) -> None:
        """Mark the points of the cells of these sides that are to be halved."""
        axes = range(len(self.shape))
        at = [ticks(n, s) for n, s in zip(self.shape, stride, strict=True)]
        known = code >= 0
        most = np.where(known, code, np.int8(-1))
        least = np.where(known, code, np.int8(127))
        corners = code[np.ix_(*at)] >= 0
        for axis in axes:
            if self.strides[axis] == 1:
                continue  # of few values, each apart from the others
            most = _over(np.maximum, most, at[axis], axis)
            least = _over(np.minimum, least, at[axis], axis)
            corners = _ends(np.logical_and, corners, axis)
        differs = corners & (most != least)
        if value is not None:
            differs |= corners & self._bends(at, value)
        cells = np.nonzero(differs)
        sides: list[tuple[Integers, ...]] = []
        for axis, cell in zip(axes, cells, strict=True):
            low = at[axis][cell]
            if self.strides[axis] == 1:
                sides.append((low,))
                continue
            high = at[axis][cell + 1]
            half = max(1, stride[axis] // 2) if stride[axis] == max(stride) else stride[axis]
            sides.append((low, np.minimum(low + half, high), high))
        for point in product(*sides):
            wanted[point] = True

    def _bends(self, at: list[Integers], values: Floats) -> Flags:
        """Return which cells have a corner that lies off the line through its neighbours."""
        value = values[np.ix_(*at)]
        bends = np.zeros(value.shape, dtype=bool)
        for axis, place in enumerate(at):
            if len(place) < 3 or self.strides[axis] == 1:
                continue
            v = np.moveaxis(value, axis, -1)
            left, right = np.diff(place)[:-1], np.diff(place)[1:]
            line = (v[..., :-2] * right + v[..., 2:] * left) / (left + right)
            size = np.abs(v[..., 1:-1])
            off = np.abs(v[..., 1:-1] - line) > self._tol * np.maximum(size, np.abs(line))
            np.moveaxis(bends, axis, -1)[..., 1:-1] |= off
        for axis in range(len(at)):
            if self.strides[axis] > 1:
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


def filled(stored: Stored, names: Sequence[str]) -> Iterator[pa.Table]:
    """Yield a row for every run of a refined sweep, whether it was done or left out, case by case.

    A run that was left out has the columns of the nearest one on the grid that was done, under its
    own case and sample.
    """
    refining = Refining(stored.config, stored.cases, stored.samples)
    rows = stored.read(list(dict.fromkeys(["case", "sample", *names])))
    shape = refining.code.shape
    place = np.full(shape, -1, dtype=np.int64)
    place[rows["case"].to_numpy(), rows["sample"].to_numpy()] = np.arange(len(rows))
    if not len(rows):
        return
    case, sample = refining.nearest(place >= 0)
    for number in range(shape[0]):
        nearest = place[case[number], sample[number]]
        points = np.flatnonzero(nearest >= 0)  # of a sweep that has just begun, there may be none
        found = rows.take(pa.array(nearest[points]))
        for name, values in (("case", np.full(len(points), number)), ("sample", points)):
            at = found.schema.get_field_index(name)
            found = found.set_column(
                at, rows.schema.field(at), pa.array(values, rows.schema.field(at).type)
            )
        yield found.select(list(names)) if set(names) >= {"case", "sample"} else found
