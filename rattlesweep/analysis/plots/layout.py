"""What varies in a sweep: the axes that its runs lie along, and the runs that are chosen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.analysis.where import Where, parse_where
from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.columns import floats
from rattlesweep.sweeps.config import not_one_of
from rattlesweep.sweeps.config.schema import GridSource
from rattlesweep.sweeps.decide import FEWEST as FEWEST_REFINED
from rattlesweep.sweeps.decide import nearest
from rattlesweep.sweeps.stored import Stored, open_stored
from rattlesweep.sweeps.summary import Counts, Moments, columns_for

MOST_CELLS = 4_000_000
# A value that is asked for in decimal means the nearest one there is.
NEAR = 1e-6
TARGETS = ("K_p", "K_r")
LAUNCH = ("n_i", "omega_xy0", "sigma", "rolling")


@dataclass(frozen=True)
class Axis:
    """One thing that varies: a target, the launch, dissipation or a parameter of the body."""

    name: str
    values: Floats  # those that are shown, ascending
    rank: Integers  # place among them of each case, or of each value of a grid's axis; -1: hidden

    @property
    def edges(self) -> Floats:
        """Borders of cells around the values."""
        if len(self.values) == 1:
            return np.array([self.values[0] - 0.5, self.values[0] + 0.5])
        values = np.log(self.values) if self.logarithmic() else self.values
        middle = (values[1:] + values[:-1]) / 2
        edges = np.array([2 * values[0] - middle[0], *middle, 2 * values[-1] - middle[-1]])
        return np.exp(edges) if self.logarithmic() else edges

    def logarithmic(self, log: bool | None = None) -> bool:
        """Return `log`, or whether the values are more evenly spread over their logarithms."""
        v = self.values
        if log is not None or len(v) < 3 or v[0] <= 0 or v[-1] < 3 * v[0]:
            return bool(log)
        uneven, uneven_log = (np.std(s) / np.mean(s) for s in (np.diff(v), np.diff(np.log(v))))
        return bool(uneven_log < uneven)

    def only(self, wanted: str, option: str) -> Axis:
        """Keep the values that ``VALUE,VALUE`` or ``LOW:HIGH`` says."""
        v, between = self.values, ":" in wanted
        try:
            numbers = np.array([float(x) for x in wanted.split(":" if between else ",")])[:, None]
        except ValueError:
            raise ConfigError(
                f"{option}: is not NAME=VALUES, as in n_i=-0.3,-0.5 or theta=0.6:0.7"
            ) from None
        # One row for each value that must be there.
        zero = NEAR**2 * float(np.abs(v).max())
        found = np.isclose(v, numbers, rtol=NEAR, atol=zero)
        if between:
            found = (v >= numbers[:1]) & (v <= numbers[-1:])
        if not found.any(axis=1).all():
            texts = [f"{value:.6g}" for value in v]
            there = ", ".join(texts if len(v) < 10 else [*texts[:3], "...", *texts[-6:]])
            raise ConfigError(f"{option}: {self.name} has no value {wanted}; there are {there}")
        kept = found.any(axis=0)
        place = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
        return Axis(self.name, v[kept], place[self.rank])


@dataclass(frozen=True)
class Layout:
    """The axes of a sweep, as far as they are shown, and a condition on its runs."""

    stored: Stored
    axes: dict[str, Axis]  # target, launch and dissipation, body, as far as there are any
    bodies: list[str]  # axes of a grid; none where the samples of a case are a population
    where: Where | None = None
    _counted: dict[Any, Any] = field(default_factory=dict, init=False, compare=False)

    @cached_property
    def lengths(self) -> dict[str, int]:
        """Number of values of each axis."""
        return {name: len(axis.values) for name, axis in self.axes.items()}

    @property
    def several(self) -> list[str]:
        """Axes of several values, those of the launch first."""
        names = sorted(self.axes, key=lambda name: name not in LAUNCH)
        return [name for name in names if self.lengths[name] > 1]

    @property
    def refined(self) -> bool:
        """Whether only some points of the grid are integrated and the others filled."""
        bodies = self.stored.config.bodies
        return isinstance(bodies, GridSource) and bodies.refine is not None

    def cells(self, rows: pa.RecordBatch) -> Integers:
        """Return the cell of each row along all axes, the last varying fastest; -1: hidden."""
        case, sample = (rows.column(name).to_numpy() for name in ("case", "sample"))
        grid = [len(self.axes[name].rank) for name in self.bodies]
        at = dict(zip(self.bodies, np.unravel_index(sample, grid) if grid else (), strict=True))
        cell, shown = np.zeros(len(case), np.int64), np.ones(len(case), bool)
        for name, axis in self.axes.items():
            place = axis.rank[at.get(name, case)]
            cell = cell * len(axis.values) + place
            shown &= place >= 0
        return np.where(shown, cell, -1)

    def rows(self, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
        """Read columns of the runs for which the condition is true, file by file."""
        needed = dict.fromkeys((*columns, *(self.where.columns if self.where else ())))
        for rows in self.stored.batches(list(needed)):
            yield rows if self.where is None else self.where.filter(rows)

    def count(self, more: tuple[str, ...] = ()) -> tuple[Counts, dict[str, Floats]]:
        """Count the runs by cell, with the means of more columns, in one pass."""
        if more not in self._counted:
            size = int(np.prod([*self.lengths.values()]))
            if size > MOST_CELLS:
                raise ConfigError(f"{size:,} cells are too many; choose some with --select")
            counts, moments = Counts(size), {name: Moments(size) for name in more}
            for rows in self.rows(("case", "sample", *columns_for(self.stored.config), *more)):
                cell = self.cells(rows)
                counts.add(rows, cell)
                for name, own in moments.items():
                    values = floats(rows.column(name))
                    kept = (cell >= 0) & np.isfinite(values)
                    own.add(cell[kept], values[kept])
            self._counted[more] = counts, {name: own.means() for name, own in moments.items()}
        found: tuple[Counts, dict[str, Floats]] = self._counted[more]
        return found

    def named(self, name: str, option: str) -> Axis:
        """Return an axis by its name; raise a ConfigError if there is none."""
        if name not in self.axes:
            raise ConfigError(f"{option}: {not_one_of(name, self.axes)}")
        return self.axes[name]

    def column(self, name: str, option: str) -> tuple[str, str]:
        """Return unit and description of a numeric column; raise a ConfigError if it is none."""
        schema = self.stored.schema
        numbers = [f.name for f in schema if str(f.type) in ("double", "int32", "int64")]
        if name not in numbers:
            raise ConfigError(f"{option}: {not_one_of(name, numbers)}")
        metadata = schema.field(name).metadata
        return metadata[b"unit"].decode(), metadata[b"description"].decode()

    def chosen(self, where: str | None) -> Layout:
        """Keep the runs for which a condition is true; None: all."""
        new = None if where is None else parse_where(where, self.stored.schema)
        return self if new == self.where else replace(self, where=new)

    def select(self, texts: Sequence[str]) -> Layout:
        """Keep what ``NAME=VALUE,VALUE`` or ``NAME=LOW:HIGH`` texts say."""
        axes = dict(self.axes)
        for text in texts:
            name, _, wanted = text.partition("=")
            axis = self.named(name.strip(), f"--select {text}")
            axes[axis.name] = axes[axis.name].only(wanted, f"--select {text}")
        return replace(self, axes=axes) if texts else self


def read_layout(directory: Path) -> Layout:
    """Read from its manifest what varies in a sweep that has runs already."""
    stored = open_stored(directory)
    if not stored.files():
        raise OutputError(f"{directory} holds no runs yet")
    config, cases = stored.config, stored.cases
    given: dict[str, Sequence[Any]] = {}
    if cases[0].target_name is not None:
        given[cases[0].target_name] = [case.target for case in cases]
    launch = ["n_i", "omega_xy0"] if config.spin is not None else []
    losses = (n for n in ("sigma", "rolling") if len(config.dissipation.values(n)) > 1)
    given |= {name: [getattr(case, name) for case in cases] for name in (*launch, *losses)}
    given = {name: values for name, values in given.items() if values[0] is not None}
    grid = config.bodies.varying if isinstance(config.bodies, GridSource) else {}
    axes = {name: Axis(name, *np.unique(np.asarray(values, float), return_inverse=True))
            for name, values in (given | grid).items()}  # fmt: skip
    return Layout(stored, axes, list(grid))


def fill(values: NDArray[Any], known: Flags) -> NDArray[Any]:
    """Return an array in which the points that were not run, not `known`, have a value too.

    A point takes the value of the nearest run, in steps of the grid, or between runs with a finite
    number the linear interpolation; where the nearest run has none (NaN) it has none either. Axes
    of few values are not refined; planes across them are filled apart.
    """
    from scipy.interpolate import LinearNDInterpolator

    along = [n >= FEWEST_REFINED for n in values.shape]
    filled: NDArray[Any] = values[tuple(nearest(known, along))]
    if not np.issubdtype(values.dtype, np.floating):
        return filled
    others = (1 if own else n for own, n in zip(along, values.shape, strict=True))
    for place in np.ndindex(*others):
        here = tuple(slice(None) if own else k for own, k in zip(along, place, strict=True))
        new, wanted = filled[here], ~known[here] & np.isfinite(filled[here])
        source = known[here] & np.isfinite(values[here])
        spread = all(len(np.unique(axis)) > 1 for axis in np.nonzero(source))
        if wanted.any() and spread and new.ndim > 1 and source.sum() > new.ndim + 1:
            interpolate = LinearNDInterpolator(np.argwhere(source), values[here][source])
            between = interpolate(np.argwhere(wanted))
            new[wanted] = np.where(np.isfinite(between), between, new[wanted])
    return filled
