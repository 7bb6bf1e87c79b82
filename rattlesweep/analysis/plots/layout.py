"""What varies in a sweep: the axes that its runs lie along, and the runs that are chosen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.analysis.where import Where, parse_where
from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.config.schema import Config, GridSource
from rattlesweep.sweeps.counts import Counts, Moments, columns_for, floats
from rattlesweep.sweeps.stored import Stored, open_stored

# A value that is asked for in decimal means the nearest one there is.
NEAR = 1e-6
TARGETS = ("K_p", "K_r")


@dataclass(frozen=True)
class Axis:
    """One thing that varies."""

    name: str  # K_p, K_r, n_i, omega_xy0, sigma, rolling or a body parameter
    values: Floats  # those that are shown, ascending
    rank: Integers
    """Place in `values` of each case, or of each value of a grid's axis; -1: not shown."""

    @classmethod
    def of(cls, name: str, given: Sequence[float]) -> Axis:
        """Make an axis of the value of each case, or of those that a grid lists."""
        values, rank = np.unique(np.asarray(given, float), return_inverse=True)
        return cls(name, values, rank)

    def only(self, places: Integers) -> Axis:
        """Keep some of the values, given by their places in ascending order."""
        place = np.full(len(self.values), -1)
        place[places] = np.arange(len(places))
        return Axis(self.name, self.values[places], place[self.rank])

    @property
    def pinned(self) -> bool:
        """Whether one of several values was chosen."""
        return len(self.values) == 1 and bool((self.rank < 0).any())

    def logarithmic(self, log: bool | None = None) -> bool:
        """Return `log`, or whether the values are more evenly spread over their logarithms."""
        if log is not None:
            return log
        v = self.values
        if len(v) < 3 or v[0] <= 0 or v[-1] < 3 * v[0]:
            return False
        uneven, uneven_log = (np.std(s) / np.mean(s) for s in (np.diff(v), np.diff(np.log(v))))
        return bool(uneven_log < uneven)


@dataclass(frozen=True)
class Layout:
    """The axes of a sweep, as far as they are shown, and a condition on its runs."""

    stored: Stored
    cases: tuple[Axis, ...]
    """Targets, ``n_i``, ``omega_xy0``, ``sigma``, ``rolling``, as far as there are any."""
    grid: tuple[Axis, ...]
    """Axes of a grid of bodies; empty where a case's samples are a population."""
    where: Where | None = None
    held: pa.Table | None = None
    """Columns that are in memory already."""
    _counted: dict[Any, Any] = field(default_factory=dict, compare=False)

    @property
    def config(self) -> Config:
        """Config of the sweep."""
        return self.stored.config

    @cached_property
    def axes(self) -> dict[str, Axis]:
        """All axes by name."""
        return {axis.name: axis for axis in (*self.cases, *self.grid)}

    @cached_property
    def lengths(self) -> dict[str, int]:
        """Number of values of each axis."""
        return {name: len(axis.values) for name, axis in self.axes.items()}

    @property
    def targets(self) -> list[str]:
        """The coefficient that bodies are drawn for, if there is one."""
        return [axis.name for axis in self.cases if axis.name in TARGETS]

    @property
    def bodies(self) -> list[str]:
        """Axes of the grid."""
        return [axis.name for axis in self.grid]

    @property
    def launch(self) -> list[str]:
        """Spin, oscillation and dissipation, where they are axes."""
        return [axis.name for axis in self.cases if axis.name not in TARGETS]

    @property
    def population(self) -> bool:
        """Whether a case has many bodies that no axis tells apart."""
        return not self.grid and self.stored.samples > 1

    @property
    def refined(self) -> bool:
        """Whether only some points of the grid are integrated and the others filled."""
        return isinstance(self.config.bodies, GridSource) and self.config.bodies.refine is not None

    def cells(self, rows: pa.RecordBatch, axes: Iterable[Axis]) -> Integers:
        """Return the cell of each row among some axes, the last varying fastest; -1: not shown."""
        case = rows.column("case").to_numpy()
        at: dict[str, Integers] = {axis.name: axis.rank[case] for axis in self.cases}
        if self.grid:
            shape = tuple(len(axis.rank) for axis in self.grid)
            places = np.unravel_index(rows.column("sample").to_numpy(), shape)
            at |= {a.name: a.rank[place] for a, place in zip(self.grid, places, strict=True)}
        cell = np.zeros(rows.num_rows, np.int64)
        for axis in axes:
            cell = cell * len(axis.values) + at[axis.name]
        for place in at.values():
            cell[place < 0] = -1
        return cell

    def rows(self, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
        """Read columns of the runs for which the condition is true, file by file."""
        needed = list(dict.fromkeys((*columns, *(self.where.columns if self.where else ()))))
        if self.held is not None and set(needed) <= set(self.held.column_names):
            batches: Iterable[pa.RecordBatch] = self.held.select(needed).to_batches()
        else:
            batches = self.stored.batches(needed)
        for rows in batches:
            yield rows if self.where is None else self.where.filter(rows)

    def count(
        self, axes: Sequence[Axis], more: Sequence[str] = ()
    ) -> tuple[Counts, dict[str, Moments]]:
        """Count the runs by cell of some axes, with moments of more columns, in one pass."""
        key = tuple(axis.name for axis in axes), tuple(more)
        if key not in self._counted:
            cells = int(np.prod([len(axis.values) for axis in axes]))
            counts, means = Counts(cells), {name: Moments(cells) for name in more}
            for rows in self.rows(("case", "sample", *columns_for(self.config), *more)):
                cell = self.cells(rows, axes)
                counts.add(rows, cell)
                for name, moments in means.items():
                    values = floats(rows.column(name))
                    kept = (cell >= 0) & np.isfinite(values)
                    moments.add(cell[kept], values[kept])
            self._counted[key] = counts, means
        found: tuple[Counts, dict[str, Moments]] = self._counted[key]
        return found

    def named(self, name: str, option: str) -> Axis:
        """Return an axis by its name; raise a ConfigError if there is none."""
        if name not in self.axes:
            known = not_one_of(name, self.axes) if self.axes else f"{name}: nothing varies by case"
            raise ConfigError(f"{option}: {known}")
        return self.axes[name]

    def chosen(self, where: str | None) -> Layout:
        """Keep the runs for which a condition is true; None: all."""
        if where is None:
            return self
        return replace(self, where=parse_where(where, self.stored.schema), _counted={})

    def select(self, texts: Sequence[str]) -> Layout:
        """Keep what ``NAME=VALUE,VALUE`` or ``NAME=LOW:HIGH`` texts say."""
        if not texts:
            return self
        axes = dict(self.axes)
        for text in texts:
            name, _, wanted = text.partition("=")
            option = f"--select {text}"
            if not wanted:
                raise ConfigError(
                    f"{option}: is not NAME=VALUES; write it as in n_i=-0.3,-0.5 or theta=0.6:0.7"
                )
            axis = self.named(name.strip(), option)
            axes[axis.name] = axis.only(_places(axis, wanted, option))
        cases, grid = (tuple(axes[axis.name] for axis in kind) for kind in (self.cases, self.grid))
        return replace(self, cases=cases, grid=grid, _counted={})


def _places(axis: Axis, wanted: str, option: str) -> Integers:
    """Return the places of the values that a text chooses, ascending."""
    between = ":" in wanted
    try:
        numbers = np.array([float(word) for word in wanted.split(":" if between else ",")])
        if np.isnan(numbers).any() or (between and len(numbers) != 2):
            raise ValueError
    except ValueError:
        raise ConfigError(
            f"{option}: {wanted} are not numbers; write -0.3,-0.5 or 0.6:0.7"
        ) from None
    values = [f"{value:.6g}" for value in axis.values]
    there = ", ".join(values[:3] + ["..."] * (len(values) > 9) + values[3:][-6:])
    if between:
        chosen = (axis.values >= numbers[0]) & (axis.values <= numbers[1])
        if not chosen.any():
            raise ConfigError(f"{option}: no value lies there; there are {there}")
        return np.flatnonzero(chosen)
    zero = NEAR**2 * float(np.abs(axis.values).max())
    alike = np.isclose(axis.values[:, None], numbers, rtol=NEAR, atol=zero)
    for number in numbers[~alike.any(axis=0)]:
        raise ConfigError(f"{option}: {axis.name} has no value {number:g}; there are {there}")
    return np.flatnonzero(alike.any(axis=1))


def read_layout(directory: Path) -> Layout:
    """Read from its manifest what varies in a sweep that has runs already."""
    stored = open_stored(directory)
    if not stored.files():
        raise OutputError(f"{directory} holds no runs yet")
    config, cases = stored.config, stored.cases
    given: dict[str, list[Any]] = {}
    if cases[0].target_name is not None:
        given[cases[0].target_name] = [case.target for case in cases]
    if config.spin is not None and cases[0].n_i is not None:
        given |= {"n_i": [case.n_i for case in cases]}
    if config.spin is not None and cases[0].omega_xy0 is not None:
        given |= {"omega_xy0": [case.omega_xy0 for case in cases]}
    for name in ("sigma", "rolling"):
        if isinstance(getattr(config.dissipation, name), list):
            given[name] = [getattr(case, name) for case in cases]
    grid = config.bodies.varying if isinstance(config.bodies, GridSource) else {}
    case_axes, grid_axes = (tuple(Axis.of(*i) for i in own.items()) for own in (given, grid))
    return Layout(stored, case_axes, grid_axes)
