"""Bodies from the rows of a table: a CSV file, Parquet or a DataFrame.

A row has a body, by its parameters or by the columns of :data:`SI_BODY`, and optionally
a launch, a horizon and dissipation.  Columns of other names are copied to the runs.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from dataclasses import field as default
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import EXACT_WHOLE, Flags, Floats, Integers, take
from rattlesweep.config.body_sources import TableSource
from rattlesweep.config.keys import FROM_TABLE
from rattlesweep.config.values import AT_REST, NO_UNIT_VECTOR, normalised
from rattlesweep.design.tables import read_table, unreadable
from rattlesweep.physics import si
from rattlesweep.physics.body import PARAMETERS, shell_dumbbell, violations
from rattlesweep.physics.si import Units
from rattlesweep.physics.theory import spin_and_oscillation
from rattlesweep.rows.arrow import F64, I64, TEXT, field
from rattlesweep.rows.columns import MEASURED, RUN_FIELDS, STATE_FIELDS
from rattlesweep.rows.prepared import Bodies
from rattlesweep.system.files import as_path
from rattlesweep.words.errors import ConfigError, one_line
from rattlesweep.words.quantities import (
    ACTING,
    CONSTANT_OF_SURFACE,
    INITIAL_RATES,
    MEASURES,
    QUANTITIES,
    SURFACE_CONSTANTS,
)
from rattlesweep.words.units import NATURAL

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

Frame: TypeAlias = "pd.DataFrame | pl.DataFrame | pa.Table"
"""A table in memory."""
SHELL_DUMBBELL = ("gamma", "f_sd", "theta", "phi", "xi")
OMEGA = ("omega_x", "omega_y", "omega_z")
U = ("u_x", "u_y", "u_z")
_COLUMNS = (
    *PARAMETERS,
    *INITIAL_RATES,
    *OMEGA,
    *U,
    "t_end",
    "psi",
    "f_sd",
    *SURFACE_CONSTANTS,
    *ACTING,
)
"""Columns that determine a run, in units of the body."""
SI_BODY = ("mass_kg", "height_m", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2", "r1_m", "r2_m")
"""Mass, height of the centre of mass, inertia about it, radii of curvature at the
bottom.
"""
BODY_DEFAULTS = {
    "mass_kg": np.nan,
    "ixy_kg_m2": 0.0,
    "axes_angle_deg": 0.0,
    "gravity_m_s2": si.GRAVITY,
}
"""Mass, product of inertia, angle from the x axis to the direction of r1, and gravity.
"""
# Columns in other units: the column in units of the body, the size of the unit in SI
# units, and the kind of quantity.
WITH_UNITS = {"minus_xi_deg": ("xi", -np.pi / 180, "angle")} | {
    name: (quantity.name, measure.size, quantity.kind)
    for name, (quantity, measure) in MEASURES.items()
    if quantity.name in _COLUMNS
}
INPUT = (*_COLUMNS, "t_r", "rim", *SI_BODY, *BODY_DEFAULTS, *WITH_UNITS)
NULLABLE = {
    "t_end",
    "rim",
    "psi",
    "psi_deg",
    "f_sd",
    "t_r",
    "t_end_s",
    *SURFACE_CONSTANTS,
}
NULLABLE |= {name for name in WITH_UNITS if WITH_UNITS[name][0] in SURFACE_CONSTANTS}
NEEDED = {*INPUT} - NULLABLE
"""Inputs in which each row needs a number, if the table has them."""
_KEPT = ("mass_kg", "height_m", "gravity_m_s2", "rim")
"""Inputs that are also copied to the runs."""
_RESULTS = {
    column.name
    for part in (*RUN_FIELDS.values(), STATE_FIELDS, MEASURED)
    for column in part
}
TAKEN = {
    column.name
    for part in RUN_FIELDS
    for column in RUN_FIELDS[part]
    if part != "theory"
}
TAKEN |= {"t_r_s"}
TAKEN -= {*INPUT} - {"t_r"}
"""Names of results, which only tables of runs may have, as their values are replaced.
"""
KEYS = ("case", "sample")
USED = {"", *INPUT, *_RESULTS}
"""Columns that are read, or replaced; those of other names are copied to the runs."""
BOUNDED = {name for name, quantity in QUANTITIES.items() if not quantity.is_open}
BOUNDED |= ACTING.keys() | SURFACE_CONSTANTS.keys() - {"c"} | {"rim"}
"""Columns with limits of their own; `physics.body` checks the parameters and ``c``."""
RowProblem = tuple[int, str]  # number of a row, from 0, and message


@dataclass
class TableBodies:
    """Bodies from the rows of a table."""

    columns: dict[str, Floats]  # the parameters, and perhaps others of `_COLUMNS`
    units: Units | None = None
    carried: dict[str, NDArray[Any]] = default(default_factory=dict)

    @property
    def fields(self) -> tuple[pa.Field, ...]:
        """Columns that the bodies add to the runs."""
        return run_fields(self.units, self.carried)

    @property
    def samples(self) -> int:
        """Number of rows."""
        return len(self.columns["alpha"])

    @property
    def as_table(self) -> pa.Table:
        """All columns, as a table from which these bodies can be read again."""
        carried = {}
        for name, values in self.carried.items():
            carried[name] = pa.array(values, _type_of(values))
        return pa.table(self.columns | carried)

    @property
    def losses(self) -> dict[str, list[float | str]]:
        """What acts by the table: a number that all rows share, or "table"."""
        losses: dict[str, list[float | str]] = {}
        for name in ACTING:
            if name in self.columns:
                values = np.unique(self.columns[name])
                losses[name] = [FROM_TABLE] if len(values) > 1 else [float(values[0])]
        # The keys of angles are in degrees.
        for name in ("base_phase", "base_azimuth"):
            if losses.get(name, [0.0]) != [0.0]:
                losses[name] = [FROM_TABLE]
        return losses

    @property
    def surface(self) -> str | None:
        """The surface of the bodies if some have its further constant, else None."""
        for name, constant in CONSTANT_OF_SURFACE.items():
            if constant and np.isfinite(self.columns.get(constant, np.nan)).any():
                return name
        return None

    @cached_property
    def content_hash(self) -> str:
        """Hash of the contents of all columns."""
        digest = hashlib.sha256()
        for name, values in sorted((self.columns | self.carried).items()):
            digest.update(f"{name}\0{values.dtype.kind}\0{len(values)}\0".encode())
            if values.dtype.kind == "O":  # texts
                digest.update(repr(values.tolist()).encode())
            else:
                digest.update(values.tobytes())
        return digest.hexdigest()

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some samples, which are the same in all cases."""
        columns = take(self.columns, sample)
        columns.setdefault("f_sd", np.full(len(sample), np.nan))
        if "u_x" in columns:
            omega = [columns.pop(name) for name in OMEGA]
            u = [columns.pop(name) for name in U]
            columns["omega"] = np.stack(omega, axis=1)
            columns["u"] = np.stack(u, axis=1)
        return Bodies.of(
            columns,
            units=take(self.units, sample),
            carried=take(self.carried, sample),
        )

    def with_surface(self, source: TableSource) -> TableBodies:
        """Return these bodies with the surface that a config gives them."""
        columns = {
            name: values
            for name, values in self.columns.items()
            if name not in SURFACE_CONSTANTS
        }
        if source.surface is None and not source.constants and self.surface:
            raise ConfigError(
                "bodies.surface: the key is missing; as the table has a column "
                f"{CONSTANT_OF_SURFACE[self.surface]}, give {self.surface} "
                "or paraboloid"
            )
        constant = CONSTANT_OF_SURFACE[source.bottom]
        if constant is None:
            return TableBodies(columns, self.units, self.carried)
        values = self.columns.get(constant, np.full(self.samples, np.nan))
        if source.constant(constant) is not None:
            values = np.where(np.isnan(values), source.constant(constant), values)
        if np.isnan(values).all():
            raise ConfigError(
                f"bodies.{constant}: the key is missing, and the table has no column "
                f"{constant}"
            )
        columns[constant] = values
        parameters = {name: columns[name] for name in PARAMETERS}
        _refuse("bodies", violations(**parameters, c=columns.get("c")))
        return TableBodies(columns, self.units, self.carried)


def run_fields(
    units: Units | None, carried: Mapping[str, NDArray[Any]]
) -> tuple[pa.Field, ...]:
    """Return the columns of runs for carried values, and for bodies with a size."""
    fields = []
    for name, values in carried.items():
        unit, description = about(name)
        fields.append(field(name, _type_of(values), unit, description))
    if units is not None:
        fields += MEASURED
    return tuple(fields)


def unknown_columns(names: Iterable[str]) -> list[str]:
    """Return the names of columns that no run depends on, which may be misspelt."""
    known = {"", "case", "sample", "mesh", *INPUT, *_RESULTS, *_KEPT}
    return [name for name in names if name not in known and about(name)[0] == "1"]


def about(name: str) -> tuple[str, str]:
    """Return unit and description of a column that the runs copy from the bodies."""
    drawn = re.fullmatch(r"shape_(\w+)_(m|kg|rad)", name)
    if drawn is not None:
        size, unit = drawn.groups()
        return unit, f"{size} of the shape"
    if name == "mesh":
        return "1", "file of the body"
    if name in _KEPT:
        return QUANTITIES[name].unit, QUANTITIES[name].meaning
    return "1", "copied from the bodies"


def read_bodies(path: str, base: Path | None = None) -> TableBodies:
    """Read bodies from CSV, Parquet or a folder of Parquet files, here or in `base`."""
    file = as_path(path, "bodies.path")
    if base is not None and not os.path.exists(file):
        file = base / file
    where = f"bodies.path: {one_line(path, 200)}"
    # Those that a run depends on are numbers, if they look so.
    table = read_table(file, where, USED.__contains__, NEEDED.__contains__)
    if {*KEYS} <= {*table.column_names}:
        table = table.sort_by([(name, "ascending") for name in KEYS])
    return _bodies(table, where)


def is_output(names: Iterable[str]) -> bool:
    """Return whether columns are those of runs, so that results may be among them."""
    return {"case", "sample"} <= {*names} or {"type", "status", "n_steps"} <= {*names}


def frame_bodies(frame: Frame) -> TableBodies:
    """Return the bodies of a table in memory, such as a DataFrame."""
    try:
        if hasattr(frame, "index"):  # pandas, whose index would become a column
            table = pa.Table.from_pandas(frame, preserve_index=False)
        else:
            table = pa.table(frame)
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise unreadable("bodies", error) from None
    except OverflowError:
        large = " and ".join(_beyond_64_bits(frame)) or "a column"
        raise ConfigError(
            f"bodies: {large} has a whole number of more than 64 bits; give it as texts"
        ) from None
    return _bodies(table, "bodies")


def _beyond_64_bits(frame: Any) -> Iterator[str]:
    """Yield the names of columns of a DataFrame with numbers that Arrow cannot hold."""
    for name in frame.columns:
        try:
            pa.array(frame[name], from_pandas=True)
        except OverflowError:
            yield str(name)


def _bodies(table: pa.Table, where: str) -> TableBodies:
    """Return the bodies of a table; messages of errors begin with `where`."""
    _check_names(table.column_names, where)
    if not table.num_rows:
        raise ConfigError(f"{where}: the table has no rows; give at least one body")
    cells = dict(zip(table.column_names, table.columns, strict=True))
    columns = {name: _numbers(cells[name]) for name in INPUT if name in cells}
    missing = list(_missing_numbers(columns, cells))
    _refuse(where, [*missing, *_out_of_bounds(columns)])
    units = _without_units(columns, where)
    if "f_sd" in columns and not {"alpha", "beta"} & columns.keys():
        _add_shell_dumbbells(columns, where)
    wanted = f"a body has {' '.join(PARAMETERS)}"
    if "mass_kg" in columns:
        wanted += f", or in SI units {' '.join(SI_BODY)}"
    _require(PARAMETERS, columns, where, wanted)
    full_state = (*OMEGA, *U)
    has_state = bool(columns.keys() & {*full_state})
    if has_state:
        _require(full_state, columns, where, f"a full state has {' '.join(full_state)}")
    elif columns.keys() & {*INITIAL_RATES}:
        _require(INITIAL_RATES, columns, where, "a launch has n_i and omega_xy0")
    impossible = violations(**{name: columns[name] for name in PARAMETERS})
    # The columns that follow from those with units have limits, too.
    _refuse(where, [*_out_of_bounds(columns), *impossible])
    if "t_end" in columns:
        # A run that reversed or failed ended there, before its horizon.
        ended_early = np.isfinite(columns.get("t_r", np.nan))
        if "status" in cells:
            ended_early = ended_early | (cells["status"].to_numpy() != "ok")
        columns["t_end"] = np.where(ended_early, np.nan, columns["t_end"])
    copied = [name for name in cells if name not in USED or name in _KEPT]
    carried = {name: _carried(name, cells[name]) for name in copied}
    columns = {name: columns[name] for name in _COLUMNS if name in columns}
    if has_state:
        launch = launched_from(columns, where)
        for name in INITIAL_RATES:
            if name in columns:
                state = "omega and u", launch[name]
                _require_equal(where, (name, columns[name]), state, {})
        columns |= launch
    return TableBodies(columns, units, carried)


def _check_names(names: list[str], where: str) -> None:
    """Raise a ConfigError if a column is repeated, or has the name of a result."""
    for name, times in Counter(names).items():
        if times > 1:
            raise ConfigError(
                f"{where}: the column {one_line(name)} is repeated; keep one"
            )
    for name in names:
        if name in TAKEN and not is_output(names):
            raise ConfigError(
                f"{where}: the column {name} has the name of a result, which the runs "
                "will have; rename or drop it"
            )


def _missing_numbers(
    columns: Mapping[str, Floats], cells: Mapping[str, pa.ChunkedArray]
) -> Iterator[RowProblem]:
    """Yield the first cell of each column that should be a finite number and is not."""
    for name, values in columns.items():
        bad = ~np.isfinite(values)
        if name in NULLABLE:
            bad &= ~cells[name].is_null(nan_is_null=True).to_numpy()
        for row in _first(bad):
            cell = cells[name][row].as_py()
            shown = "empty" if cell is None else repr(str(cell)[:40])
            yield row, f"{name} is {shown}; a finite number is needed"


def _add_shell_dumbbells(columns: dict[str, Floats], where: str) -> None:
    """Add the inertia of bodies that are given by the paper's parameters."""
    _require(SHELL_DUMBBELL, columns, where, f"a body has {' '.join(SHELL_DUMBBELL)}")
    f_sd = columns["f_sd"]
    quantity = QUANTITIES["f_sd"]
    wanted = f"above {quantity.low:g} and below {quantity.high:g} is needed"
    outside = ~((quantity.low < f_sd) & (f_sd < quantity.high))
    _refuse(
        where,
        ((row, f"f_sd is {f_sd[row]:g}; {wanted}") for row in _first(outside)),
    )
    columns["alpha"], columns["beta"] = shell_dumbbell(columns["gamma"], f_sd)


def _numbers(column: pa.ChunkedArray) -> Floats:
    """Return a column as numbers; NaN for cells that are not numbers."""
    import pandas as pd

    if pa.types.is_temporal(column.type) or pa.types.is_boolean(column.type):
        return np.full(len(column), np.nan)
    if pa.types.is_floating(
        column.type
    ):  # avoids pandas, which is slow for many columns
        return np.array(column, float)
    return np.array(pd.to_numeric(column.to_pandas(), errors="coerce"), float)


def _carried(name: str, column: pa.ChunkedArray) -> NDArray[Any]:
    """Return a carried column as it is: numbers, or texts of what is none.

    Floats are NaN for empty cells, and objects None.
    """
    kind = column.type
    if name in _KEPT:
        return _numbers(column)
    if pa.types.is_integer(kind):
        if not column.null_count:
            wide = np.uint64 if kind == pa.uint64() else np.int64
            return np.asarray(column).astype(wide)
        numbers = column.drop_null().to_pylist()
        if max(map(abs, numbers), default=0) <= EXACT_WHOLE:
            return _numbers(column)
        # As objects, since floats would round them.
        return np.array(column.to_pylist(), dtype=object)
    if pa.types.is_floating(kind):
        values = _numbers(column)
        # The runs have no infinity.
        if not np.isinf(values).any():
            return values
    cells = [_text(cell) for cell in column.to_pylist()]
    return np.array(cells, dtype=object)


def _text(cell: object) -> str | None:
    """Return a carried cell as a text; bytes are in UTF-8, or else Latin-1."""
    if cell is None:
        return None
    if isinstance(cell, bytes):
        try:
            return cell.decode()
        except UnicodeDecodeError:
            return cell.decode("latin-1")
    return str(cell)


def _type_of(values: NDArray[Any]) -> pa.DataType:
    """Return the type of a carried column in the runs."""
    if values.dtype.kind != "O":
        return {"i": I64, "u": pa.uint64(), "f": F64}[values.dtype.kind]
    whole = [value for value in values if isinstance(value, int)]
    if not whole:
        return TEXT
    return I64 if max(whole) < 2**63 else pa.uint64()


def _without_units(columns: dict[str, Floats], where: str) -> Units | None:
    """Add the columns that those with units determine.

    Return the size of the bodies if it is known.
    """
    rows = max(map(len, columns.values()), default=0)
    full = {name: np.full(rows, x) for name, x in BODY_DEFAULTS.items()} | columns
    units: Units | None = None
    if "height_m" in columns:
        units = Units(full["mass_kg"], full["height_m"], full["gravity_m_s2"])
    given = {*columns}
    # What other columns say of a quantity, with the words for them.
    sayings: list[tuple[str, str, Floats]] = []
    if columns.keys() & {*SI_BODY[2:], "ixy_kg_m2", "axes_angle_deg"}:
        _require(SI_BODY, columns, where, f"a body in SI units has {' '.join(SI_BODY)}")
        moments = [full[f"i{axes}_kg_m2"] for axes in ("xx", "yy", "zz", "xy")]
        body = si.parameters(
            full["mass_kg"],
            np.stack(moments, axis=1),
            full["height_m"],
            np.stack([full["r1_m"], full["r2_m"]], axis=1),
            np.radians(full["axes_angle_deg"]),
        )
        if "f_sd" in columns:
            body["f_sd"] = (body["beta"] - 1) / body["gamma"]
        sayings += [(name, "the tensor and the radii", x) for name, x in body.items()]
    for name, (plain, size, kind) in WITH_UNITS.items():
        if name not in columns:
            continue
        sizes: tuple[str, ...] = ()
        if "M" in NATURAL.get(kind, ""):
            sizes = ("mass_kg", "height_m")
        elif kind != "angle":
            sizes = ("height_m",)
        _require(sizes, columns, where, f"{name} needs it")
        values = columns[name] * size
        if units is not None and kind != "angle":
            values = units.natural(values, kind)
        if kind == "angle" and plain in given:
            raise ConfigError(f"{where}: {plain} and {name} are one quantity; keep one")
        sayings.append((plain, name, values))
    known: dict[str, str] = {}
    for plain, source, values in sayings:
        if plain in columns:
            # The runs of a sweep have both n_i and n_i_rpm.  What is there stays, so
            # that they are repeated exactly.
            there = columns[plain]
            _require_equal(where, (plain, there), (source, values), known)
            columns[plain] = np.where(np.isnan(there), values, there)
        else:
            columns[plain] = values
            known[plain] = source
    return units


def _require_equal(
    where: str,
    given: tuple[str, Floats],
    other: tuple[str, Floats],
    known: Mapping[str, str],
) -> None:
    """Raise a ConfigError if two columns of one quantity contradict each other.

    Each has a name; `known` tells from which columns that of `given` was computed.
    """
    name, values = given
    source, others = other
    differ = ~np.isclose(values, others, 1e-9, 0.0)
    # An empty cell says nothing.
    differ &= ~(np.isnan(values) | np.isnan(others))
    if differ.any():
        row = int(np.argmax(differ))
        first = name
        if name in known:
            first = f"{name} by {known[name]}"
        raise ConfigError(
            f"{where}: row {row + 1}: {first} is {values[row]:.6g}, and by {source} "
            f"{others[row]:.6g}; keep one of them"
        )


def launched_from(
    columns: dict[str, Floats], table: str | None = None
) -> dict[str, Floats]:
    """Return spin, oscillation and u of full states.

    Messages of errors name the row of a `table`, or of several launches.
    """
    omega = np.stack([columns[name] for name in OMEGA], axis=1)
    u = normalised(np.stack([columns[name] for name in U], axis=1))
    at_rest = ~omega.any(axis=1) & (u[:, 2] == -1)
    problems = [(row, NO_UNIT_VECTOR) for row in _first(np.isnan(u[:, 0]))]
    problems += [(row, AT_REST) for row in _first(at_rest)]
    if problems and table is None and len(u) == 1:
        raise ConfigError(f"launch: {problems[0][1]}")
    _refuse(table or "launch", problems)
    n_i, omega_xy0, psi = spin_and_oscillation(omega, u)
    launch = {"n_i": n_i, "omega_xy0": omega_xy0, "psi": psi}
    for axis, name in enumerate(U):
        launch[name] = u[:, axis]
    return launch


def check_value(name: str, values: Floats) -> RowProblem | None:
    """Return the first place out of bounds and a message; NaN is in bounds."""
    if name not in BOUNDED:
        return None
    quantity = QUANTITIES[name]
    bad = (values < quantity.low) | (values > quantity.high)
    if quantity.is_open:
        bad |= (values == quantity.low) | (values == quantity.high)
    for place in _first(bad):
        if values[place] <= 0 and (quantity.low > 0 or quantity.is_open):
            return place, "it must be positive"
        return place, f"{quantity.limits} is allowed"
    return None


def _out_of_bounds(columns: dict[str, Floats]) -> Iterator[RowProblem]:
    """Yield the first value out of bounds of each column."""
    for name, values in columns.items():
        if name == "omega_xy0" and "u_x" in columns:
            continue  # full states may have no oscillation
        problem = check_value(name, values)
        if problem is not None:
            row, message = problem
            yield row, f"{name} is {values[row]:g}; {message}"


def _first(bad: Flags) -> list[int]:
    """Return the first place that is bad, if there is one."""
    return [int(place) for place in np.flatnonzero(bad)[:1]]


def _refuse(where: str, problems: Iterable[RowProblem]) -> None:
    """Raise a ConfigError with the first problem of each of up to five rows."""
    first: dict[int, str] = {}
    for row, message in problems:
        first.setdefault(row, message)
    if first:
        rows = sorted(first)[:5]
        raise ConfigError(f"{where}: row {row + 1}: {first[row]}" for row in rows)


def _require(
    names: Iterable[str], columns: Iterable[str], where: str, reason: str
) -> None:
    """Raise a ConfigError if a column is missing."""
    for name in names:
        if name not in columns:
            raise ConfigError(f"{where}: the column {name} is missing; {reason}")
