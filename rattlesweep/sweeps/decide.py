"""Sweeps that decide what to run next: a stage at a time, each from the runs of those before.

A sweep with `stop` or `bodies.refine` has the cases, samples and run numbers of the one without
it, but does some of these runs only. What a stage asks for follows from the config and from the
rows of the stages before it, so it is the same whoever asks, in whatever order blocks were done.
The runs of a sweep have places, stage by stage and in the order of their numbers; its blocks are
slices of these and do not cross stages.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.config.bodies import GridSource, Refine
from rattlesweep.sweeps.config.schema import Config, Stop
from rattlesweep.sweeps.counts import COLUMNS, Cells, codes, floats, wilson
from rattlesweep.sweeps.columns import runs_schema
from rattlesweep.sweeps.types import TYPES

FIRST = 400
"""Samples of a case before which it is not stopped: fewer tell too little of how few they are."""
MORE = 0.1
"""Share of its samples that a case is given more of, in whole blocks."""
Z = 2.1700903775845606
"""Quantile of the normal distribution for 97 %: who stops as soon as an interval of 95 % is narrow
enough stops too soon now and then, and the margin makes up for it (`benchmarks/stopping.py`)."""
MOST_POINTS = 10**8
FEWEST = 5
"""Values along an axis of which some may be left out."""


def make_stages(config: Config, cases: int, samples: int) -> Stopping | Refining | None:
    """What a sweep of so many cases and samples decides by; None if it does all runs."""
    if config.stop is not None:
        return Stopping(config.stop, cases, samples, config.block_size)
    if isinstance(config.bodies, GridSource) and config.bodies.refine is not None:
        return Refining(config, config.bodies.refine)
    return None


def n_blocks(stages: Sequence[int], size: int) -> int:
    """Blocks of stages with so many runs."""
    return sum(-(-runs // size) for runs in stages)


def borders(stages: Sequence[int], size: int, index: int) -> tuple[int, int]:
    """Places of the runs of a block, from and up to, in a sweep of stages with so many runs."""
    first = 0
    for runs in stages:
        if index < (blocks := -(-runs // size)):
            return first + index * size, min(first + (index + 1) * size, first + runs)
        index -= blocks
        first += runs
    raise IndexError(index)


class Stopping:
    """Samples case by case, in whole blocks, until each case is known well enough."""

    columns = ("case", *COLUMNS)

    def __init__(self, stop: Stop, cases: int, samples: int, size: int) -> None:
        self._stop, self._samples, self._size = stop, samples, size
        self._cells = Cells(cases)
        self._done = 0

    def first(self) -> Integers:
        """Numbers of the runs of the first stage: the same number of samples of every case."""
        return self._more(np.arange(len(self._cells.runs)), FIRST)

    def add(self, rows: pa.RecordBatch) -> None:
        """Count runs: all of one stage before those of the next, in their order."""
        self._cells.add(rows, rows.column("case").to_numpy().astype(np.int64))

    def next(self) -> Integers:
        """Those of the next: more samples of the cases that are not known well enough."""
        return self._more(np.flatnonzero(~self.known()), int(np.ceil(MORE * self._done)))

    def known(self) -> Flags:
        """Whether each case is."""
        cells, stop = self._cells, self._stop
        known = np.ones(len(cells.runs), dtype=bool)
        if stop.fraction is not None:
            for part in cells.types.values():
                low, high = wilson(part, cells.ok, Z)
                known &= (high - low) / 2 <= stop.fraction
        if stop.t_r is not None:
            known &= Z * cells.t_r.errors() <= stop.t_r * cells.t_r.means()
        return known

    def _more(self, cases: Integers, samples: int) -> Integers:
        first, size = self._done, self._size
        self._done = min(self._samples, first + max(1, -(-samples // size)) * size)
        numbers: Integers = np.add.outer(
            cases * self._samples, np.arange(first, self._done)
        ).ravel()
        return numbers


class Refining:
    """A grid of every 2^levels-th value, halved where the runs in and around a cell differ.

    A cell is refined if the runs known of it, its border included, are not of one type, or if the
    column that is asked for bends there: what is found on the border of a cell refines its
    neighbour, so that boundaries are followed to their ends. Axes of few values are done whole,
    each of these a picture of its own.
    """

    def __init__(self, config: Config, refine: Refine) -> None:
        bodies, spin = config.bodies, config.spin
        assert isinstance(bodies, GridSource)
        launches: dict[str, Any] = {}
        if spin is not None:
            launches |= {"n_i": spin.n_i, "omega_xy0": spin.omega_xy0}
        if losses := config.dissipation:
            launches |= {name: losses.values(name) for name in ("sigma", "rolling")}
        axes = bodies.axes.values()
        lengths = {name: len(values) for name, values in (launches | axes).items()}
        self.names = tuple(lengths)
        self.shape = tuple(lengths.values())
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
        if (points := math.prod(self.shape)) > MOST_POINTS:
            raise ConfigError(
                f"bodies.refine: the finest grid has {points} points; at most {MOST_POINTS} are "
                "possible"
            )
        self._samples = math.prod(map(len, axes.values()))
        self._by, self._tol = refine.by, refine.tol
        self.columns = tuple(dict.fromkeys(("case", "sample", "type", "status", refine.by)))
        # -1: not known.
        self.code = np.full(self.shape, -1, np.int8)
        self.value = np.full(self.shape if refine.by != "type" else (0,), np.nan)

    def first(self) -> Integers:
        """Numbers of the runs of the first stage: the coarse grid."""
        coarse = np.zeros(self.shape, dtype=bool)
        coarse[np.ix_(*(ticks(n, s) for n, s in zip(self.shape, self.strides, strict=True)))] = True
        numbers: Integers = np.flatnonzero(coarse)
        return numbers

    def add(self, rows: pa.RecordBatch) -> None:
        """Take what runs came to, stage by stage."""
        case, sample = (rows.column(n).to_numpy().astype(np.int64) for n in ("case", "sample"))
        number = case * self._samples + sample
        ok = codes(rows.column("status"), ("ok",)) == 0
        self.code.ravel()[number] = np.where(ok, codes(rows.column("type"), TYPES), len(TYPES))
        if self._by != "type":
            self.value.ravel()[number] = floats(rows.column(self._by))

    def next(self) -> Integers:
        """Those of the next: points between those of the cells, of any size, to be halved."""
        wanted = np.zeros(self.shape, dtype=bool)
        stride = self.strides
        while max(stride) > 1:
            self._halve(stride, wanted)
            stride = tuple(max(1, s // 2) if s == max(stride) else s for s in stride)
        numbers: Integers = np.flatnonzero(wanted & (self.code < 0))
        return numbers

    def _halve(self, stride: tuple[int, ...], wanted: Flags) -> None:
        """Mark the points of the cells of these sides that are to be halved."""
        axes = range(len(self.shape))
        at = [ticks(n, s) for n, s in zip(self.shape, stride, strict=True)]
        known = self.code >= 0
        most = np.where(known, self.code, -1)
        least = np.where(known, self.code, 127).astype(np.int8)
        corners = self.code[np.ix_(*at)] >= 0
        for axis in axes:
            if self.strides[axis] == 1:
                continue  # of few values, each apart from the others
            most = _over(np.maximum, most, at[axis], axis)
            least = _over(np.minimum, least, at[axis], axis)
            corners = _ends(np.logical_and, corners, axis)
        differs = corners & (most != least)
        if self._by != "type":
            differs |= corners & self._bends(at, stride)
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

    def _bends(self, at: list[Integers], stride: tuple[int, ...]) -> Flags:
        """Cells with a corner that lies off the line through its neighbours."""
        value = self.value[np.ix_(*at)]
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
    """Steps of the coarse grid along axes of so many values: two of them at least, or 1."""
    return tuple(1 if n < FEWEST else min(1 << levels, 1 << ((n - 1) // 2).bit_length() - 1)
                 for n in shape)  # fmt: skip


def ticks(length: int, stride: int) -> Integers:
    """Every so many-th place along an axis, and the last."""
    return np.unique(np.append(np.arange(0, length, stride), length - 1))


def _over(
    function: np.ufunc, values: NDArray[np.int8], at: Integers, axis: int
) -> NDArray[np.int8]:
    """Of the cells along an axis, the most or the least, both ends included."""
    inner = function.reduceat(values, at[:-1], axis=axis)
    ends: NDArray[np.int8] = function(inner, np.take(values, at[1:], axis=axis))
    return ends


def _ends(function: np.ufunc, values: Flags, axis: int) -> Flags:
    """Of the cells along an axis, both ends together."""
    v = np.moveaxis(values, axis, 0)
    both: Flags = np.moveaxis(function(v[:-1], v[1:]), 0, axis)
    return both
