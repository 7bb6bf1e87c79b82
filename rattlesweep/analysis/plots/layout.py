"""What varies in a sweep: the axes that its runs lie along, told from the manifest alone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.analysis.where import Condition, parse_condition
from rattlesweep.sweeps.config.schema import GridSource, SdSource
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.old.manifest import Manifest
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.old.stored import open_stored

# A value that is asked for in decimal is meant to be the nearest one there is.
NEAR = 1e-6
TARGETS = ("K_p", "K_r")


@dataclass(frozen=True)
class Axis:
    """One thing that varies."""

    name: str  # K_p, K_r, n_i, omega_xy0, sigma, rolling or a body parameter
    values: Floats  # those that are shown, ascending
    rank: Integers
    """Place in `values` of each value of the config, in the config's order; -1: not shown."""

    @classmethod
    def of(cls, name: str, given: Sequence[float]) -> Axis:
        """From the values as the config lists them."""
        array = np.asarray(given, float)
        order = np.argsort(array, kind="stable")
        return cls(name, array[order], np.argsort(order))

    def only(self, places: Integers) -> Axis:
        """With some of its values, given by their places in ascending order."""
        place = np.full(len(self.values), -1)
        place[places] = np.arange(len(places))
        return Axis(self.name, self.values[places], place[self.rank])

    @property
    def pinned(self) -> bool:
        """Whether one of several values was chosen."""
        return len(self.values) == 1 < len(self.rank)

    def logarithmic(self, log: bool | None = None) -> bool:
        """As asked, else whether its values are more evenly spread over their logarithms."""
        if log is not None:
            return log
        if len(self.values) < 3 or self.values[0] <= 0 or self.values[-1] < 3 * self.values[0]:
            return False
        return _unevenness(np.log(self.values)) < _unevenness(self.values)


def _unevenness(values: Floats) -> float:
    steps = np.diff(values)
    return float(np.std(steps) / np.mean(steps))


@dataclass(frozen=True)
class Layout:
    """The axes of a sweep, as far as they are shown."""

    store: Store
    manifest: Manifest
    config: Config
    cases: tuple[Axis, ...]
    """Targets, ``n_i``, ``omega_xy0``, as far as there are any, the first varying slowest."""
    grid: tuple[Axis, ...]
    """Axes of a grid of bodies; empty where a case's samples are a population."""
    where: Condition | None = None  # what the runs that are shown are to be like

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
        """Spin and oscillation, where the config has them, and dissipation of several values."""
        return [axis.name for axis in self.cases if axis.name not in TARGETS]

    @property
    def population(self) -> bool:
        """Whether a case has many bodies that no axis tells apart."""
        return not self.grid and self.manifest.samples > 1

    def cells(self, rows: pa.RecordBatch, axes: Iterable[Axis]) -> Integers:
        """Cell of each row among some axes, the last varying fastest; -1: it is not shown."""
        at: dict[str, Integers] = {}
        for column, own in (("case", self.cases), ("sample", self.grid)):
            if own:
                shape = tuple(len(axis.rank) for axis in own)
                places = np.unravel_index(rows.column(column).to_numpy(), shape)
                at |= {a.name: a.rank[place] for a, place in zip(own, places, strict=True)}
        cell = np.zeros(rows.num_rows, np.int64)
        for axis in axes:
            cell = cell * len(axis.values) + at[axis.name]
        for place in at.values():
            cell[place < 0] = -1
        return cell

    def named(self, name: str, option: str) -> Axis:
        """An axis by its name; a ConfigError if there is none."""
        if name not in self.axes:
            if not self.axes:
                raise ConfigError(f"{option}: {name} cannot be chosen; nothing varies by case here")
            raise ConfigError(f"{option}: {not_one_of(name, self.axes)}")
        return self.axes[name]

    def chosen(self, where: str | None) -> Layout:
        """Of the runs for which a condition is true; None: of all."""
        if where is None:
            return self
        return replace(self, where=parse_condition(where, self.manifest.schema))

    def select(self, texts: Sequence[str]) -> Layout:
        """What ``NAME=VALUE,VALUE`` or ``NAME=LOW:HIGH`` texts leave of it."""
        chosen: dict[str, Axis] = {}
        for text in texts:
            name, equals, wanted = text.partition("=")
            option = f"--select {text}"
            if not equals or not wanted:
                raise ConfigError(
                    f"{option}: is not NAME=VALUES; write it as in n_i=-0.3,-0.5 or theta=0.6:0.7"
                )
            axis = self.named(name.strip(), option)
            chosen[axis.name] = axis.only(_places(axis, wanted, option))
        cases, grid = (
            tuple(chosen.get(axis.name, axis) for axis in axes) for axes in (self.cases, self.grid)
        )
        return replace(self, cases=cases, grid=grid)


def _places(axis: Axis, wanted: str, option: str) -> Integers:
    """Places of the values that a text chooses, ascending."""
    between = ":" in wanted
    try:
        numbers = np.array([float(word) for word in wanted.split(":" if between else ",")])
    except ValueError:
        numbers = np.full(1, np.nan)
    if np.isnan(numbers).any() or (between and len(numbers) != 2):
        raise ConfigError(f"{option}: {wanted} are not numbers; write -0.3,-0.5 or 0.6:0.7")
    if between:
        found = (axis.values >= numbers[0]) & (axis.values <= numbers[1])
        if not found.any():
            raise ConfigError(f"{option}: no value lies there; there are {_listed(axis)}")
        return np.flatnonzero(found)
    nought = NEAR**2 * float(np.abs(axis.values).max())
    alike = np.isclose(axis.values[:, None], numbers, rtol=NEAR, atol=nought)
    for number in numbers[~alike.any(axis=0)]:
        raise ConfigError(
            f"{option}: {axis.name} has no value {number:g}; there are {_listed(axis)}"
        )
    return np.flatnonzero(alike.any(axis=1))


def _listed(axis: Axis) -> str:
    values = [f"{value:.6g}" for value in axis.values]
    if len(values) > 9:
        return f"{', '.join(values[:3])} ... {values[-1]}, {len(values)} in all"
    return ", ".join(values)


def read_layout(directory: Path) -> Layout:
    """Read from its manifest what varies in a sweep that has runs already."""
    if not directory.exists():
        raise ConfigError(f"{directory}: there is no such directory")
    stored = open_stored(directory)
    store, manifest, config = stored.store, stored.manifest, stored.config
    if not store.block_indices():
        raise OutputError(f"{directory} holds no runs yet")
    cases: dict[str, Sequence[float]] = {}
    if isinstance(config.bodies, SdSource) and config.bodies.target is not None:
        cases[config.bodies.target.name] = config.bodies.target.values
    if config.spin is not None and manifest.cases[0].n_i is not None:
        cases |= {"n_i": config.spin.n_i, "omega_xy0": config.spin.omega_xy0}
    for name in ("sigma", "rolling"):
        if isinstance(values := getattr(config.dissipation, name), list):
            cases[name] = values
    bodies = config.bodies
    grid = bodies.varying if isinstance(bodies, GridSource) else {}
    return Layout(store, manifest, config, _axes(cases), _axes(grid))


def _axes(given: Mapping[str, Sequence[float]]) -> tuple[Axis, ...]:
    return tuple(Axis.of(name, values) for name, values in given.items())


class Reader(Protocol):
    """What is made of the rows of a sweep as they go by."""

    @property
    def columns(self) -> Sequence[str] | None:
        """Columns of `runs` that are read; None: all."""

    def add(self, rows: pa.RecordBatch) -> None:
        """Take more rows."""


def read_rows(layout: Layout, *readers: Reader) -> None:
    """Give the rows of :func:`iter_rows` to some readers, in one pass over the files."""
    names = [reader.columns for reader in readers]
    every = None in names
    for rows in iter_rows(layout, None if every else [n for own in names for n in own or ()]):
        for reader in readers:
            reader.add(rows)


def iter_rows(layout: Layout, columns: Sequence[str] | None) -> Iterator[pa.RecordBatch]:
    """Columns of the rows of complete blocks, of those that the layout's condition chooses."""
    where = layout.where
    if columns is not None:
        columns = list(dict.fromkeys((*columns, *(where.columns if where else ()))))
    for rows in layout.store.iter_batches(columns, complete=True):
        if where is None:
            yield rows
        else:
            yield from pa.Table.from_batches([rows]).filter(where.expression).to_batches()
