"""The axes along which a sweep varies, selections of its runs, and its xarray
Dataset.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.analysis.where import Where, parse_where
from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.columns import RUNS, TIME, define, floats
from rattlesweep.sweeps.config import not_one_of
from rattlesweep.sweeps.config.schema import GridSource
from rattlesweep.sweeps.decide import FEWEST, nearest
from rattlesweep.sweeps.stored import VARIES, Stored, open_stored
from rattlesweep.sweeps.summary import SI, Counts, Moments, columns_for

if TYPE_CHECKING:
    import xarray

NEAR = (
    1e-6  # relative difference up to which a value typed in decimals means a stored one
)
TARGETS = ("K_p", "K_r")
LAUNCH = (*VARIES, *(name for name, _ in SI.values()))


@dataclass(frozen=True)
class Axis:
    """A quantity that varies: a target, a launch, a dissipation or a parameter of the
    body.
    """

    name: str
    values: Floats  # the selected ones, ascending
    # index among them of each case or of each value of a grid; -1: not selected
    rank: Integers

    @property
    def edges(self) -> Floats:
        """Edges of cells around the values."""
        log = self.logarithmic()
        v = np.log(self.values) if log else self.values
        middle = (v[1:] + v[:-1]) / 2 if len(v) > 1 else v - 0.5
        edges = np.array([2 * v[0] - middle[0], *middle, 2 * v[-1] - middle[-1]])
        return np.exp(edges) if log else edges if len(v) > 1 else edges[[1, 2]]

    def logarithmic(self, log: bool | None = None) -> bool:
        """Return `log`; with None, whether the logarithms of the values are spaced more
        evenly.
        """
        v = self.values
        if log is not None or len(v) < 3 or v[0] <= 0 or v[-1] < 3 * v[0]:
            return bool(log)
        uneven, uneven_log = (
            np.std(s) / np.mean(s) for s in (np.diff(v), np.diff(np.log(v)))
        )
        return bool(uneven_log < uneven)

    def only(self, wanted: str, option: str) -> Axis:
        """Return the axis with the values that ``VALUE,VALUE`` or ``LOW:HIGH``
        selects.
        """
        v, between = self.values, ":" in wanted
        try:
            numbers = np.array(
                [float(x) for x in wanted.split(":" if between else ",")]
            )[:, None]
        except ValueError:
            form = "is not NAME=VALUES, as in n_i=-0.3,-0.5 or theta=0.6:0.7"
            raise ConfigError(f"{option}: {form}") from None
        # One row for each requested value, which must exist.
        found = np.isclose(v, numbers, rtol=NEAR, atol=NEAR**2 * float(np.abs(v).max()))
        if between:
            found = (v >= numbers[:1]) & (v <= numbers[-1:])
        if not found.any(axis=1).all():
            there = np.array2string(v, precision=6, separator=", ", threshold=9)[1:-1]
            raise ConfigError(
                f"{option}: {self.name} has no value {wanted}; there are {there}"
            )
        kept = found.any(axis=0)
        place = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
        return Axis(self.name, v[kept], place[self.rank])


@dataclass(frozen=True)
class Layout:
    """The axes of a sweep, a selection of their values, and a condition on its runs."""

    stored: Stored
    axes: dict[str, Axis]  # by name, in the order target, launch, dissipation, body
    bodies: list[
        str
    ]  # axes of a grid of bodies; empty if the samples of a case are a population
    where: Where | None = None
    si: bool = False  # whether times are in seconds

    @cached_property
    def lengths(self) -> dict[str, int]:
        """Number of values of each axis."""
        return {name: len(axis.values) for name, axis in self.axes.items()}

    @property
    def several(self) -> list[str]:
        """Names of the axes with several values, those of the launch first."""
        names = sorted(self.axes, key=lambda name: name not in LAUNCH)
        return [name for name in names if self.lengths[name] > 1]

    @property
    def refined(self) -> bool:
        """Whether only some points of the grid are integrated, and the others filled
        in.
        """
        bodies = self.stored.config.bodies
        return isinstance(bodies, GridSource) and bodies.refine is not None

    def cells(self, rows: pa.RecordBatch | pa.Table) -> Integers:
        """Return the flat index of the cell of each row, in C order; -1 if it is not
        selected.
        """
        case, sample = (rows.column(name).to_numpy() for name in ("case", "sample"))
        grid = [len(self.axes[name].rank) for name in self.bodies]
        at = dict(
            zip(
                self.bodies, np.unravel_index(sample, grid) if grid else (), strict=True
            )
        )
        places = [axis.rank[at.get(name, case)] for name, axis in self.axes.items()]
        if not places:
            return np.zeros(len(case), np.int64)
        cell = np.ravel_multi_index(places, [*self.lengths.values()], mode="clip")
        return np.where(np.min(places, axis=0) >= 0, cell, -1)

    def rows(self, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
        """Yield columns of the runs that meet the condition, file by file."""
        size = ("n_i", "n_i_rpm", "t_r", "t_r_s") if self.si else ()
        needed = dict.fromkeys(
            (*columns, *size, *(self.where.columns if self.where else ()))
        )
        for rows in self.stored.batches(list(needed)):
            chosen = rows if self.where is None else self.where.filter(rows)
            yield in_seconds(chosen, self.stored.schema) if self.si else chosen

    def count(self, more: tuple[str, ...] = ()) -> tuple[Counts, dict[str, Floats]]:
        """Count the runs by cell, with the means of more columns, in one pass."""
        size = int(np.prod([*self.lengths.values()]))
        counts, moments = Counts(size), {name: Moments(size) for name in more}
        for rows in self.rows(
            ("case", "sample", *columns_for(self.stored.schema), *more)
        ):
            cell = self.cells(rows)
            counts.add(rows, cell)
            for name, own in moments.items():
                values = floats(rows.column(name))
                kept = (cell >= 0) & np.isfinite(values)
                own.add(cell[kept], values[kept])
        return counts, {name: own.means() for name, own in moments.items()}

    def key(self, name: str, option: str) -> str:
        """Return the key of an axis by its name, which ends in a unit if its values
        have one.
        """
        known = {
            own: key for key, axis in self.axes.items() for own in (key, axis.name)
        }
        if name not in known:
            raise ConfigError(f"{option}: {not_one_of(name, known)}")
        return known[name]

    def column(self, name: str, option: str) -> tuple[str, str]:
        """Return unit and description of a numeric column; raise a ConfigError for
        others.
        """
        numbers = {
            f.name: _about(f)
            for f in self.stored.schema
            if str(f.type) in ("double", "int32", "int64")
        }
        if name not in numbers:
            raise ConfigError(f"{option}: {not_one_of(name, numbers)}")
        unit, words = numbers[name].values()
        return "s" if self.si and unit == TIME else unit, words

    def name(self, column: str) -> str:
        """Return the name of a column in tables; it ends in ``_s`` if times are in
        seconds.
        """
        return f"{column}_s" if self.column(column, "")[0] == "s" else column

    def chosen(self, where: str | None) -> Layout:
        """Return the layout of the runs that meet a condition; None selects all."""
        new = None if where is None else parse_where(where, self.stored.schema)
        return replace(self, where=new)

    def select(self, texts: Sequence[str]) -> Layout:
        """Return the layout of values selected as ``NAME=VALUE,VALUE`` or
        ``NAME=LOW:HIGH``.
        """
        axes = dict(self.axes)
        for text in texts:
            name, _, wanted = text.partition("=")
            key = self.key(name.strip(), f"select {text}")
            axes[key] = axes[key].only(wanted, f"select {text}")
        return replace(self, axes=axes)

    def in_si(self) -> Layout:
        """Return the layout with times in seconds and, if bodies have one size, spins
        in rpm.
        """
        if "t_r_s" not in self.stored.schema.names:
            return self
        spins = self.stored.read(["n_i", "n_i_rpm"]).to_pandas().query("n_i != 0")
        factor, axes = (spins["n_i_rpm"] / spins["n_i"]).to_numpy(), dict(self.axes)
        sizes = (
            {"n_i": factor[0]}
            if len(factor) and np.ptp(factor) < NEAR * factor[0]
            else {}
        )
        for name, settings in self.stored.config.settings.items():
            in_si = [setting.si for setting in settings if setting.si is not None]
            # The largest value in both units.
            largest = max(map(abs, in_si), default=0.0)
            if name in axes and largest and len(in_si) == len(settings):
                natural = max(abs(getattr(case, name)) for case in self.stored.cases)
                sizes.setdefault(name, largest / SI[name][1] / natural)
        for name in sizes.keys() & axes.keys():
            values = np.round(axes[name].values * sizes[name], 12)
            axes[name] = replace(axes[name], name=SI[name][0], values=values)
        return replace(self, axes=axes, si=True)


def in_seconds(rows: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    """Return runs of bodies of known size with their times converted to seconds."""
    n_i, rpm, t_r, t_r_s = (
        floats(rows.column(k)) for k in ("n_i", "n_i_rpm", "t_r", "t_r_s")
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        second = np.where(n_i == 0, t_r_s / t_r, n_i / rpm * 30 / np.pi)
    for place, name in enumerate(rows.schema.names):
        if _about(schema.field(name))["units"] == TIME and pa.types.is_floating(
            rows[name].type
        ):
            values = pa.array(floats(rows[name]) * second, from_pandas=True)
            rows = rows.set_column(place, rows.schema.field(name), values)
    return rows


def read_layout(directory: Path) -> Layout:
    """Read the axes of a sweep from its manifest; raise an OutputError if it has no
    runs.
    """
    stored = open_stored(directory)
    if not stored.files():
        raise OutputError(f"{directory} holds no runs yet")
    config, cases = stored.config, stored.cases
    given: dict[str, Sequence[Any]] = {}
    if cases[0].target_name is not None:
        given[cases[0].target_name] = [case.target for case in cases]
    launch = ["n_i", "omega_xy0"] if config.spin is not None else []
    losses = (n for n in ("sigma", "rolling") if len(config.settings[n]) > 1)
    for name in (*launch, *losses):
        settings = [case.setting(name) for case in cases]
        in_si = [setting.si for setting in settings if setting.si is not None]
        if in_si:
            given[SI[name][0]] = [value / SI[name][1] for value in in_si]
        elif settings[0].natural is not None:
            given[name] = [setting.natural for setting in settings]
    grid = config.bodies.varying if isinstance(config.bodies, GridSource) else {}
    axes = {
        name: Axis(name, *np.unique(np.asarray(values, float), return_inverse=True))
        for name, values in (given | grid).items()
    }
    return Layout(stored, axes, list(grid))


def fill(values: NDArray[Any], known: Flags) -> NDArray[Any]:
    """Fill the points that are not `known`: numbers linearly, others from the nearest
    run.
    """
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import QhullError

    along = [n >= FEWEST for n in values.shape]
    filled: NDArray[Any] = values[tuple(nearest(known, along))]
    if not np.issubdtype(values.dtype, np.floating):
        return filled
    others = (1 if own else n for own, n in zip(along, values.shape, strict=True))
    for place in np.ndindex(*others):
        here = tuple(
            slice(None) if own else k for own, k in zip(along, place, strict=True)
        )
        new, wanted = filled[here], ~known[here] & np.isfinite(filled[here])
        source = known[here] & np.isfinite(values[here])
        with suppress(QhullError, ValueError):  # too few runs, or all on a line
            interpolate = LinearNDInterpolator(
                np.argwhere(source), values[here][source]
            )
            between = interpolate(np.argwhere(wanted))
            new[wanted] = np.where(np.isfinite(between), between, new[wanted])
    return filled


def make_dataset(
    layout: Layout, columns: Sequence[str] | None = None, *, fill_refined: bool = False
) -> xarray.Dataset:
    """Return the runs along the axes of their sweep, as ``Sweep.to_xarray``
    promises.
    """
    schema = layout.stored.schema
    single = [column.name for column in schema if not pa.types.is_list(column.type)]
    for name in columns or ():
        if name not in single:
            raise ConfigError(f"columns: {not_one_of(name, single)}")
    coordinates = {"case", "sample", *layout.axes} - set(TARGETS)
    names = [
        name
        for name in (single if columns is None else columns)
        if name not in coordinates
    ]
    wanted = pa.schema([schema.field(name) for name in ("case", "sample", *names)])
    batches = [
        pa.table(rows.select(wanted.names)) for rows in layout.rows(wanted.names)
    ]
    table = pa.concat_tables([wanted.remove_metadata().empty_table(), *batches])
    axes: dict[str, Any] = {name: axis.values for name, axis in layout.axes.items()}
    place = layout.cells(table)
    shown = place >= 0
    if not layout.bodies:
        axes["sample"] = np.arange(layout.stored.samples)
        place = place * layout.stored.samples + table["sample"].to_numpy()
    index = pd.MultiIndex.from_product([*axes.values()], names=[*axes])
    frame = (
        table.select(names)
        .to_pandas()[shown]
        .set_index(index[place[shown]])
        .reindex(index)
    )
    # The axis of a target holds the requested values, the column those of the bodies.
    frame = frame.rename(columns={name: f"{name}_body" for name in axes})
    try:
        dataset: xarray.Dataset = frame.to_xarray()
    except ImportError:
        raise OutputError(
            "to_xarray needs xarray, which is not installed; run "
            "pip install 'rattlesweep[xarray]'"
        ) from None
    done = np.isin(np.arange(len(index)), place[shown]).reshape(
        [*dataset.sizes.values()]
    )
    for key, variable in dataset.items():
        column = schema.field(str(key).removesuffix("_body"))
        values = variable.to_numpy()
        if pa.types.is_string(column.type):
            values = variable.fillna("").to_numpy().astype(str)
        elif not pa.types.is_integer(column.type):
            values = values.astype(float)
        if fill_refined and layout.refined:
            values = fill(values, done)
        dataset[key] = variable.dims, values, _about(column)
    known = {column.name: _about(column) for part in RUNS.values() for column in part}
    for name in axes:
        degrees = {"units": "degree", "long_name": define(name).meaning}
        dataset[name].attrs = known.get(name, degrees)
    dataset.attrs = {
        "title": layout.stored.config.name,
        "source": f"rattlesweep {version('rattlesweep')}",
        "comment": "units: mass M, height a of the centre of mass at rest, and "
        "gravity g are 1",
        "references": "Kondo and Nakanishi, Phys. Rev. E 95, 062207 (2017)",
        "config_hash": layout.stored.hash,
    }
    return dataset


def _about(column: pa.Field) -> dict[str, str]:
    metadata = column.metadata
    return {
        "units": metadata[b"unit"].decode(),
        "long_name": metadata[b"description"].decode(),
    }
