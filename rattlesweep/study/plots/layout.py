"""What varies in a sweep: the axes that its runs lie along, told from the manifest alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.bodies import SdSource
from rattlesweep.sweeps.config.grid import GridSource
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.store.manifest import Manifest
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.store.stored import open_stored

if TYPE_CHECKING:
    import pyarrow as pa
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

# A value that is asked for in decimal is meant to be the nearest one there is.
NEAR = 1e-6


@dataclass(frozen=True)
class Axis:
    """One thing that varies.

    Attributes
    ----------
    name : str
        ``K_p``, ``K_r``, ``n_i``, ``omega_xy0`` or a body parameter.
    values : array
        Ascending.
    rank : array
        Place in `values` of each value of the config, in the config's order.
    """

    name: str
    values: Floats
    rank: Integers

    @classmethod
    def of(cls, name: str, given: Sequence[float]) -> Axis:
        """From the values as the config lists them."""
        array = np.asarray(given, float)
        order = np.argsort(array, kind="stable")
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        return cls(name, array[order], rank)

    @property
    def logarithmic(self) -> bool:
        """Whether its values are spread over their logarithms more evenly than over themselves."""
        if len(self.values) < 3 or self.values[0] <= 0 or self.values[-1] < 3 * self.values[0]:
            return False
        return _unevenness(np.log(self.values)) < _unevenness(self.values)


def _unevenness(values: Floats) -> float:
    steps = np.diff(values)
    return float(np.std(steps) / np.mean(steps))


@dataclass(frozen=True)
class Layout:
    """The axes of a sweep.

    Attributes
    ----------
    store : Store
    manifest : Manifest
    config : Config
    cases : tuple of Axis
        Targets, ``n_i``, ``omega_xy0``, as far as there are any, the first varying slowest.
    grid : tuple of Axis
        Axes of a grid of bodies; empty where a case's samples are a population.
    """

    store: Store
    manifest: Manifest
    config: Config
    cases: tuple[Axis, ...]
    grid: tuple[Axis, ...]

    @cached_property
    def axes(self) -> dict[str, Axis]:
        """All axes by name."""
        return {axis.name: axis for axis in (*self.cases, *self.grid)}

    @property
    def lengths(self) -> dict[str, int]:
        """Number of values of each axis."""
        return {name: len(axis.values) for name, axis in self.axes.items()}

    @property
    def targets(self) -> list[str]:
        """The coefficient that bodies are drawn for, if there is one."""
        return [axis.name for axis in self.cases if axis.name in ("K_p", "K_r")]

    @property
    def bodies(self) -> list[str]:
        """Axes of the grid."""
        return [axis.name for axis in self.grid]

    @property
    def launch(self) -> list[str]:
        """Spin and oscillation, where the config has them."""
        return [axis.name for axis in self.cases if axis.name not in ("K_p", "K_r")]

    @property
    def population(self) -> bool:
        """Whether a case has many bodies that no axis tells apart."""
        return not self.grid and self.manifest.samples > 1

    def ranks(self, case: Integers, sample: Integers) -> dict[str, Integers]:
        """Place of some runs along each axis."""
        found: dict[str, Integers] = {}
        for numbers, axes in ((case, self.cases), (sample, self.grid)):
            places = np.unravel_index(numbers, tuple(len(a.values) for a in axes)) if axes else ()
            found |= {a.name: a.rank[place] for a, place in zip(axes, places, strict=True)}
        return found

    def named(self, name: str, option: str) -> Axis:
        """An axis by its name.

        Raises
        ------
        ConfigError
            There is none of this name.
        """
        if name not in self.axes:
            if not self.axes:
                raise ConfigError(f"{option}: {name} cannot be chosen; nothing varies by case here")
            raise ConfigError(f"{option}: {not_one_of(name, self.axes)}")
        return self.axes[name]


class Reader(Protocol):
    """What is made of the rows of a sweep as they go by."""

    @property
    def columns(self) -> Sequence[str] | None:
        """Columns of `runs` that are read; None: all."""

    def add(self, rows: pa.RecordBatch) -> None:
        """Take more rows."""


def read_layout(directory: Path) -> Layout:
    """Read from its manifest what varies in a sweep.

    Raises
    ------
    ConfigError
        The directory is not there, or is none of a sweep.
    OutputError
        It is damaged, or holds no runs yet.
    """
    if not directory.exists():
        raise ConfigError(f"{directory}: there is no such directory")
    stored = open_stored(directory)
    store, manifest, config = stored.store, stored.manifest, stored.config
    if not store.block_indices():
        raise OutputError(f"{directory} holds no runs yet")
    cases: list[Axis] = []
    if isinstance(config.bodies, SdSource) and config.bodies.target is not None:
        cases.append(Axis.of(config.bodies.target.name, config.bodies.target.values))
    if config.spin is not None and manifest.cases[0].n_i is not None:
        cases.append(Axis.of("n_i", config.spin.n_i))
        cases.append(Axis.of("omega_xy0", config.spin.omega_xy0))
    grid: list[Axis] = []
    if isinstance(config.bodies, GridSource):
        grid = [Axis.of(name, given) for name, given in config.bodies.axes.values().items()]
    return Layout(store, manifest, config, tuple(cases), tuple(grid))


class Places:
    """Cells of a picture: which of them each run is in.

    Parameters
    ----------
    layout
    names
        Axes that tell the cells apart.
    chosen
        Places along any axes of the layout that are taken; runs elsewhere are in no cell.

    Attributes
    ----------
    axes : tuple of Axis
        Those of `names`, with what is chosen of their values.
    """

    def __init__(
        self, layout: Layout, names: Sequence[str], chosen: Mapping[str, Integers]
    ) -> None:
        self._layout = layout
        kept = {name: chosen.get(name, np.arange(len(a.values))) for name, a in layout.axes.items()}
        self._place = {name: np.full(len(a.values), -1) for name, a in layout.axes.items()}
        for name, places in kept.items():
            self._place[name][places] = np.arange(len(places))
        self.axes = tuple(
            Axis.of(name, layout.axes[name].values[np.sort(kept[name])].tolist()) for name in names
        )

    def cells(self, rows: pa.RecordBatch) -> Integers:
        """Number of the cell of each row, the last axis varying fastest; -1 where there is none."""
        case, sample = (rows.column(n).to_numpy().astype(np.int64) for n in ("case", "sample"))
        at = {n: self._place[n][rank] for n, rank in self._layout.ranks(case, sample).items()}
        cell = np.zeros(len(case), np.int64)
        for axis in self.axes:
            cell = cell * len(axis.values) + at[axis.name]
        for places in at.values():
            cell[places < 0] = -1
        return cell


def read_rows(layout: Layout, *readers: Reader) -> None:
    """Give all rows of complete blocks to some readers, in one pass over the files.

    Raises
    ------
    OutputError
        A block is unreadable.
    """
    names = [reader.columns for reader in readers]
    columns = None if None in names else list(dict.fromkeys(n for own in names for n in own or ()))
    for rows in layout.store.iter_batches(columns, complete=True):
        for reader in readers:
            reader.add(rows)


def selection(layout: Layout, texts: Sequence[str]) -> dict[str, Integers]:
    """Places along the axes that ``NAME=VALUE,VALUE`` or ``NAME=LOW:HIGH`` texts choose.

    Raises
    ------
    ConfigError
        A text is none of these, or chooses nothing.
    """
    chosen: dict[str, Integers] = {}
    for text in texts:
        name, equals, wanted = text.partition("=")
        option = f"--select {text}"
        if not equals or not wanted:
            raise ConfigError(
                f"{option}: is not NAME=VALUES; write it as in n_i=-0.3,-0.5 or theta=0.6:0.7"
            )
        axis = layout.named(name.strip(), option)
        if ":" in wanted:
            low, high = _numbers(wanted.split(":"), option, 2)
            places = np.flatnonzero((axis.values >= low) & (axis.values <= high))
            if not len(places):
                raise ConfigError(f"{option}: no value lies there; there are {_listed(axis)}")
        else:
            numbers = _numbers(wanted.split(","), option)
            places = np.array(sorted({_place(axis, number, option) for number in numbers}))
        chosen[axis.name] = places
    return chosen


def _numbers(words: list[str], option: str, count: int | None = None) -> list[float]:
    try:
        numbers = [float(word) for word in words]
        if count in (None, len(numbers)) and not any(math.isnan(number) for number in numbers):
            return numbers
    except ValueError:
        pass
    raise ConfigError(f"{option}: {','.join(words)} are not numbers; write -0.3,-0.5 or 0.6:0.7")


def _place(axis: Axis, number: float, option: str) -> int:
    place = int(np.argmin(np.abs(axis.values - number)))
    scale = max(abs(number), float(np.abs(axis.values).max()) * NEAR)
    if abs(axis.values[place] - number) > NEAR * scale:
        raise ConfigError(
            f"{option}: {axis.name} has no value {number:g}; there are {_listed(axis)}"
        )
    return place


def _listed(axis: Axis) -> str:
    values = [f"{value:.6g}" for value in axis.values]
    if len(values) > 9:
        return f"{', '.join(values[:3])} ... {values[-1]}, {len(values)} in all"
    return ", ".join(values)
