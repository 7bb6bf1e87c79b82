"""The axes along which a sweep varies, and selections of its runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.analysis.where import Where, parse_where
from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.config.body_sources import GridSource
from rattlesweep.design.cases import VARIES
from rattlesweep.rows.arrow import floats, unit_and_meaning
from rattlesweep.store.decide import FEWEST, nearest
from rattlesweep.store.rows import Stored, open_stored
from rattlesweep.store.summary import SI, Counts, Moments, columns_for
from rattlesweep.words.errors import ConfigError, OutputError, not_one_of
from rattlesweep.words.quantities import TIME

# Relative difference up to which a value typed in decimals means a stored one.
_NEAR = 1e-6
SKEW = "minus_xi_deg"  # the config's name for -xi, which has no column of its own
TARGETS = ("K_p", "K_r")
LAUNCH_COLUMNS = (*VARIES, *(name for name, _ in SI.values()))


@dataclass(frozen=True)
class Axis:
    """A quantity that varies: of the target, launch, dissipation or body."""

    name: str
    values: Floats  # the selected ones, ascending
    # index among them of each case or of each value of a grid; -1: not selected
    rank: Integers
    every: Floats | None = None  # the values of the sweep, if some are not selected

    @property
    def places(self) -> Integers:
        """Place of each value among those of the sweep, the smallest sizes first.

        It gives a value one colour in all figures, whatever is selected; and -0.1 that
        of 0.1 in a sweep of the other direction.
        """
        every = self.values if self.every is None else self.every
        order = np.lexsort((every, np.abs(every)))
        place = np.empty(len(every), np.int64)
        place[order] = np.arange(len(every))
        return place[np.searchsorted(every, self.values)]

    @property
    def edges(self) -> Floats:
        """Edges of cells around the values."""
        if len(self.values) == 1:
            return np.array([self.values[0] - 0.5, self.values[0] + 0.5])
        log = self.logarithmic()
        places = np.log(self.values) if log else self.values
        middle = (places[1:] + places[:-1]) / 2
        # The outer cells reach as far outward as inward.
        first = 2 * places[0] - middle[0]
        last = 2 * places[-1] - middle[-1]
        edges = np.array([first, *middle, last])
        return np.exp(edges) if log else edges

    @property
    def stretches(self) -> list[tuple[Integers, Floats]]:
        """Places and edges of the values of each direction of spin.

        Between the slowest spins of the two directions nothing was sampled, so cells
        there reach no farther inward than outward.  Other axes are one stretch.
        """
        places = np.arange(len(self.values))
        border = int(np.searchsorted(self.values, 0.0))
        if not self.name.startswith("n_i") or border in (0, len(places)):
            return [(places, self.edges)]
        halves = []
        for half in (places[:border], places[border:]):
            edges = Axis(self.name, self.values[half], half).edges
            if len(half) == 1:
                # A lone spin is as wide as the cell that all spins leave it.
                around = np.abs(self.edges[half[0] + np.array([0, 1])] - edges.mean())
                edges = edges.mean() + around.min() * np.array([-1, 1])
            halves.append((half, edges))
        gap = halves[1][1][0] - halves[0][1][-1]
        if gap <= 0:
            return [(places, self.edges)]
        return halves

    def logarithmic(self, log: bool | None = None) -> bool:
        """Return `log`; with None, whether the logarithms are spaced more evenly."""
        v = self.values
        if log is not None:
            return log
        if len(v) < 3 or v[0] <= 0 or v[-1] < 3 * v[0]:
            return False
        steps = np.diff(v)
        log_steps = np.diff(np.log(v))
        uneven = np.std(steps) / np.mean(steps)
        uneven_log = np.std(log_steps) / np.mean(log_steps)
        return bool(uneven_log < uneven)

    def only(self, wanted: str, option: str) -> Axis:
        """Return the axis with the values of ``VALUE,VALUE`` or ``LOW:HIGH``."""
        v = self.values
        between = ":" in wanted
        try:
            texts = wanted.split(":" if between else ",")
            numbers = np.array([float(text) for text in texts])[:, None]
        except ValueError:
            raise ConfigError(
                f"{option}: is not NAME=VALUES, as in n_i=-0.3,-0.5 or theta=0.6:0.7"
            ) from None
        # One row for each requested value, which must exist.
        if between:
            matches = (v >= numbers[:1]) & (v <= numbers[-1:])
        else:
            least = _NEAR**2 * float(np.abs(v).max())
            matches = np.isclose(v, numbers, rtol=_NEAR, atol=least)
        if not matches.any(axis=1).all():
            known = np.array2string(v, precision=6, separator=", ", threshold=9)[1:-1]
            raise ConfigError(
                f"{option}: {self.name} has no value {wanted}; there are {known}"
            )
        selected = matches.any(axis=0)
        new_rank = np.where(selected, np.cumsum(selected) - 1, -1)
        # A rank of -1, not selected before, stays so.
        new_rank = np.append(new_rank, -1)
        every = v if self.every is None else self.every
        return Axis(self.name, v[selected], new_rank[self.rank], every)


@dataclass(frozen=True)
class SweepLayout:
    """The axes of a sweep, a selection of their values, and a condition on its runs."""

    stored: Stored
    axes: dict[str, Axis]  # by name, in the order target, launch, dissipation, body
    # Axes of a grid of bodies; empty if the samples of a case are a population.
    bodies: list[str]
    where: Where | None = None
    si: bool = False  # whether times are in seconds

    @cached_property
    def lengths(self) -> dict[str, int]:
        """Number of values of each axis."""
        return {name: len(axis.values) for name, axis in self.axes.items()}

    @property
    def several(self) -> list[str]:
        """Names of the axes with several values, those of the launch first."""
        names = sorted(self.axes, key=lambda name: name not in LAUNCH_COLUMNS)
        return [name for name in names if self.lengths[name] > 1]

    @property
    def refined(self) -> bool:
        """Whether only some points of the grid are integrated."""
        bodies = self.stored.config.bodies
        return isinstance(bodies, GridSource) and bodies.refine is not None

    def cells(self, rows: pa.RecordBatch | pa.Table) -> Integers:
        """Return the flat index of each row's cell, in C order; -1 if not selected."""
        case = rows.column("case").to_numpy()
        if not self.axes:
            return np.zeros(len(case), np.int64)
        # The axes of a grid of bodies go by sample, the others by case.
        keys = dict.fromkeys(self.axes, case)
        if self.bodies:
            grid = [len(self.axes[name].rank) for name in self.bodies]
            samples = np.unravel_index(rows.column("sample").to_numpy(), grid)
            keys |= zip(self.bodies, samples, strict=True)
        places = [axis.rank[keys[name]] for name, axis in self.axes.items()]
        cell = np.ravel_multi_index(places, list(self.lengths.values()), mode="clip")
        return np.where(np.min(places, axis=0) >= 0, cell, -1)

    def rows(self, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
        """Yield columns of the runs that meet the condition, file by file."""
        needed = dict.fromkeys(columns)
        if SKEW in needed:
            del needed[SKEW]
            needed["xi"] = None
        if self.si:
            needed |= dict.fromkeys(("n_i", "n_i_rpm", "t_r", "t_r_s"))
        if self.where is not None:
            needed |= dict.fromkeys(self.where.columns)
        for rows in self.stored.batches(list(needed)):
            if self.where is not None:
                rows = self.where.filter(rows)
            if self.si:
                rows = in_seconds(rows, self.stored.schema)
            if SKEW in columns:
                skew = -np.degrees(floats(rows.column("xi")))
                rows = rows.add_column(rows.num_columns, SKEW, pa.array(skew))
            yield rows

    def count(self, more: tuple[str, ...] = ()) -> tuple[Counts, dict[str, Floats]]:
        """Count the runs by cell, with the means of more columns, in one pass."""
        size = int(np.prod(list(self.lengths.values())))
        counts = Counts(size)
        moments = {name: Moments(size) for name in more}
        columns = ("case", "sample", *columns_for(self.stored.schema), *more)
        for rows in self.rows(columns):
            cell = self.cells(rows)
            counts.add(rows, cell)
            for name, of_column in moments.items():
                values = floats(rows.column(name))
                counted = (cell >= 0) & np.isfinite(values)
                of_column.add(cell[counted], values[counted])
        return counts, {name: each.means() for name, each in moments.items()}

    def key(self, name: str, option: str) -> str:
        """Return the key of an axis by its key or its name, which may end in a unit."""
        known = {key: key for key in self.axes}
        known |= {axis.name: key for key, axis in self.axes.items()}
        if name not in known:
            raise ConfigError(f"{option}: {not_one_of(name, known)}")
        return known[name]

    @property
    def lists(self) -> list[str]:
        """The columns that have a list for each run."""
        schema = self.stored.schema
        return [column.name for column in schema if pa.types.is_list(column.type)]

    def column(self, name: str, option: str) -> tuple[str, str]:
        """Return unit and description of a column of numbers; raise for others.

        Of the description only the first clause, as for the caption of a picture.
        """
        numbers = {
            column.name: unit_and_meaning(column)
            for column in self.stored.schema
            if str(column.type) in ("double", "int32", "int64", "uint64")
        }
        numbers[SKEW] = ("deg", "skew angle, -xi")
        if name not in numbers:
            raise ConfigError(f"{option}: {not_one_of(name, numbers)}")
        unit, meaning = numbers[name]
        meaning = meaning.partition(";")[0]
        if self.si and unit == TIME:
            unit = "s"
        return unit, meaning

    def name(self, column: str) -> str:
        """Return the name of a column in tables, which ends in ``_s`` for seconds."""
        unit, _ = self.column(column, "")
        if unit == "s":
            return f"{column}_s"
        return column

    def chosen(self, where: str | None) -> SweepLayout:
        """Return the layout of the runs that meet a condition; None selects all."""
        if where is None:
            return replace(self, where=None)
        return replace(self, where=parse_where(where, self.stored.schema))

    def select(self, texts: Sequence[str]) -> SweepLayout:
        """Return the layout of the values that ``NAME=VALUES`` selects."""
        axes = dict(self.axes)
        for text in texts:
            name, _, wanted = text.partition("=")
            key = self.key(name.strip(), f"select {text}")
            axes[key] = axes[key].only(wanted, f"select {text}")
        return replace(self, axes=axes)

    def in_si(self) -> SweepLayout:
        """Return the layout with times in seconds and, for one size, spins in rpm."""
        if "t_r_s" not in self.stored.schema.names:
            return self
        axes = dict(self.axes)
        sizes: dict[str, float] = {}
        spins = self.stored.read(["n_i", "n_i_rpm"]).to_pandas().query("n_i != 0")
        factor = (spins["n_i_rpm"] / spins["n_i"]).to_numpy()
        if len(factor) and np.ptp(factor) < _NEAR * factor[0]:
            sizes["n_i"] = factor[0]
        for name, values in self.stored.config.settings.items():
            in_si = [value.si for value in values if value.si is not None]
            if name not in axes or len(in_si) < len(values):
                continue
            # The largest value in both units.
            largest = max(map(abs, in_si), default=0.0)
            if largest:
                of_cases = [case.value(name) or 0.0 for case in self.stored.cases]
                natural = max(map(abs, of_cases))
                sizes.setdefault(name, largest / SI[name][1] / natural)
        for name in sizes.keys() & axes.keys():
            axis = axes[name]
            every = axis.every
            if every is not None:
                every = np.round(every * sizes[name], 12)
            si_values = np.round(axis.values * sizes[name], 12)
            axes[name] = replace(axis, name=SI[name][0], values=si_values, every=every)
        return replace(self, axes=axes, si=True)


def in_seconds(rows: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    """Return runs of bodies of known size with their times converted to seconds."""
    n_i = floats(rows.column("n_i"))
    rpm = floats(rows.column("n_i_rpm"))
    t_r = floats(rows.column("t_r"))
    t_r_s = floats(rows.column("t_r_s"))
    with np.errstate(divide="ignore", invalid="ignore"):
        # A tap has no spin, from which the unit of time follows.
        second = np.where(n_i == 0, t_r_s / t_r, n_i / rpm * 30 / np.pi)
    for place, name in enumerate(rows.schema.names):
        unit, _ = unit_and_meaning(schema.field(name))
        if unit == TIME and pa.types.is_floating(rows[name].type):
            values = pa.array(floats(rows[name]) * second, from_pandas=True)
            rows = rows.set_column(place, rows.schema.field(name), values)
    return rows


def read_layout(directory: Path) -> SweepLayout:
    """Read the axes of a sweep from its manifest; raise if it has no runs."""
    stored = open_stored(directory)
    if not stored.files():
        raise OutputError(f"{directory} holds no runs yet")
    config = stored.config
    cases = stored.cases
    values: dict[str, Sequence[float | None]] = {}
    if cases[0].target_name is not None:
        values[cases[0].target_name] = [case.target for case in cases]
    names = []
    if config.spin is not None:
        names = ["n_i", "omega_xy0"]
    losses = config.acting.values
    names += [name for name, several in losses.items() if len(several) > 1]
    for name in names:
        settings = [case.setting(name) for case in cases]
        in_si = [setting.si for setting in settings if setting.si is not None]
        if in_si:
            si_name, size = SI[name]
            values[si_name] = [value / size for value in in_si]
        elif settings[0].natural is not None:
            values[name] = [setting.natural for setting in settings]
    grid: dict[str, list[float]] = {}
    if isinstance(config.bodies, GridSource):
        grid = config.bodies.varying
    axes = {}
    for name, numbers in (values | grid).items():
        distinct, rank = np.unique(np.asarray(numbers, float), return_inverse=True)
        axes[name] = Axis(name, distinct, rank)
    return SweepLayout(stored, axes, list(grid))


def fill(values: NDArray[Any], known: Flags) -> NDArray[Any]:
    """Fill unknown points: numbers linearly, others from the nearest run."""
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import QhullError

    along = [n >= FEWEST for n in values.shape]
    filled: NDArray[Any] = values[tuple(nearest(known, along))]
    if not np.issubdtype(values.dtype, np.floating):
        return filled
    # Along short axes, such as a few spins, nothing is interpolated.
    short = [1 if long else n for long, n in zip(along, values.shape, strict=True)]
    for place in np.ndindex(*short):
        plane = tuple(
            slice(None) if long else k for long, k in zip(along, place, strict=True)
        )
        numbers = filled[plane]  # a view
        missing = ~known[plane] & np.isfinite(numbers)
        source = known[plane] & np.isfinite(values[plane])
        with suppress(QhullError, ValueError):  # too few runs, or all on a line
            interpolate = LinearNDInterpolator(
                np.argwhere(source), values[plane][source]
            )
            between = interpolate(np.argwhere(missing))
            numbers[missing] = np.where(np.isfinite(between), between, numbers[missing])
    return filled
