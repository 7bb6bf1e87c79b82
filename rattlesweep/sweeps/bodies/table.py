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

from rattlesweep.arrays import Flags, Floats, Integers, take
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.physics import si
from rattlesweep.physics.body import PARAMETERS, shell_dumbbell, violations
from rattlesweep.physics.si import Units
from rattlesweep.physics.theory import spin_and_oscillation
from rattlesweep.quantities import QUANTITIES
from rattlesweep.sweeps.bodies import Bodies
from rattlesweep.sweeps.columns import F64, I64, MEASURED, RUNS, STATE, TEXT, field
from rattlesweep.sweeps.config.schema import TABLE, TableSource
from rattlesweep.sweeps.config.values import AT_REST, NO_UNIT_VECTOR, normalised
from rattlesweep.sweeps.tables import read_table, unreadable

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

Frame: TypeAlias = "pd.DataFrame | pl.DataFrame | pa.Table"
"""A table in memory."""
SHELL_DUMBBELL = ("gamma", "f_sd", "theta", "phi", "xi")
LAUNCH = ("n_i", "omega_xy0")
LOSSES = ("sigma", "rolling")
OMEGA, U = ("omega_x", "omega_y", "omega_z"), ("u_x", "u_y", "u_z")
COLUMNS = (*PARAMETERS, *LAUNCH, *OMEGA, *U, "t_end", "psi", "f_sd", "c", *LOSSES)
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
# the column in units of the body, the size of the unit, and the kind of quantity
WITH_UNITS = {
    "xi_deg": ("xi", np.pi / 180, ""),
    "minus_xi_deg": ("xi", -np.pi / 180, ""),
    "psi_deg": ("psi", np.pi / 180, ""),
    "n_i_rpm": ("n_i", np.pi / 30, "spin"),
    "omega_xy0_rpm": ("omega_xy0", np.pi / 30, "spin"),
    "t_end_s": ("t_end", 1.0, "time"),
    "c_m": ("c", 1.0, "length"),
    "rolling_m": ("rolling", 1.0, "length"),
    "sigma_N_m_s": ("sigma", 1.0, "torque per spin"),
}
INPUT = (*COLUMNS, "t_r", *SI_BODY, *BODY_DEFAULTS, *WITH_UNITS)
NULLABLE = ("t_end", "psi", "psi_deg", "f_sd", "t_r", "c", "t_end_s", "c_m")
KEPT = {  # also copied to the runs: unit and description
    "mass_kg": ("kg", "mass M"),
    "height_m": ("m", "height a of the centre of mass above the contact"),
    "gravity_m_s2": ("m/s^2", "gravity g"),
}
RESULTS = {column.name for part in (*RUNS.values(), STATE, MEASURED) for column in part}
TAKEN = {column.name for part in RUNS for column in RUNS[part] if part != "theory"}
TAKEN |= {"t_r_s"}
TAKEN -= {*INPUT} - {"t_r"}
"""Names of results, which only tables of runs may have, as their values are replaced.
"""
KEYS = ("case", "sample")
BOUNDED = (
    *LAUNCH,
    *OMEGA,
    *LOSSES,
    "t_end",
    "dt",
    "e_p0",
    "e_r0",
    "psi",
    "psi_deg",
    "mass_kg",
    "height_m",
    "r1_m",
    "r2_m",
    "gravity_m_s2",
)
"""Columns with limits of their own; `physics.body` checks the parameters of bodies."""
RowProblem = tuple[int, str]  # number of a row, from 0, and message


@dataclass
class TableBodies:
    """Bodies from the rows of a table."""

    columns: dict[str, Floats]  # the parameters, and perhaps others of `COLUMNS`
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
    def losses(self) -> dict[str, list[float | str]]:
        """Dissipation columns of the table: their number if all rows share it, else
        "table".
        """
        own = {
            name: np.unique(self.columns[name])
            for name in LOSSES
            if name in self.columns
        }
        return {
            name: [float(v[0]) if len(v) == 1 else TABLE] for name, v in own.items()
        }

    @property
    def surface(self) -> str | None:
        """The surface of bodies of which some have a semi-axis c; None if there are
        none.
        """
        return "ellipsoid" if np.isfinite(self.columns.get("c", np.nan)).any() else None

    @cached_property
    def content_hash(self) -> str:
        """Hash of the contents of all columns."""
        digest = hashlib.sha256()
        for name, values in sorted((self.columns | self.carried).items()):
            digest.update(f"{name}\0{values.dtype.kind}\0{len(values)}\0".encode())
            is_text = values.dtype.kind == "O"
            digest.update(
                repr(values.tolist()).encode() if is_text else values.tobytes()
            )
        return digest.hexdigest()

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some samples, which are the same in all cases."""
        columns = take(self.columns, sample)
        columns.setdefault("f_sd", np.full(len(sample), np.nan))
        for name, parts in (("omega", OMEGA), ("u", U)) if "u_x" in columns else ():
            columns[name] = np.stack([columns.pop(part) for part in parts], axis=1)
        return Bodies(
            **columns,
            units=take(self.units, sample),
            carried=take(self.carried, sample),
        )

    def with_surface(self, source: TableSource) -> TableBodies:
        """Return these bodies with the surface that a config gives them."""
        columns = dict(self.columns)
        c = columns.pop("c", np.full(self.samples, np.nan))
        if source.surface is None and source.c is None and self.surface:
            advice = "as the table has a column c, give ellipsoid or paraboloid"
            raise ConfigError(f"bodies.surface: the key is missing; {advice}")
        if source.ellipsoidal:
            columns["c"] = c if source.c is None else np.where(np.isnan(c), source.c, c)
            if np.isnan(columns["c"]).all():
                raise ConfigError(
                    "bodies.c: the key is missing, and the table has no column c"
                )
            _refuse(
                "bodies",
                violations(**{name: columns[name] for name in (*PARAMETERS, "c")}),
            )
        return TableBodies(columns, self.units, self.carried)


def run_fields(
    units: Units | None, carried: Mapping[str, NDArray[Any]]
) -> tuple[pa.Field, ...]:
    """Return the columns of runs for carried values, and those of bodies of a known
    size.
    """
    kinds = {"i": I64, "f": F64, "O": TEXT}
    own = (
        field(name, kinds[x.dtype.kind], *about(name)) for name, x in carried.items()
    )
    return (*own, *(MEASURED if units else ()))


def unknown_columns(names: Iterable[str]) -> list[str]:
    """Return the names of columns that no run depends on, which may be misspelt."""
    known = {"", "case", "sample", *INPUT, *RESULTS, *KEPT}
    return [name for name in names if name not in known and about(name)[0] == "1"]


def about(name: str) -> tuple[str, str]:
    """Return unit and description of a column that is copied from the bodies to the
    runs.
    """
    if shape := re.fullmatch(r"shape_(\w+)_(m|kg|rad)", name):
        return shape[2], f"{shape[1]} of the shape"
    return KEPT.get(name, ("1", "copied from the bodies"))


def read_bodies(path: str, base: Path | None = None) -> TableBodies:
    """Read bodies from CSV, Parquet or a folder of Parquet files, here or in `base`."""
    file = Path(path)
    if base is not None and not os.path.exists(file):
        file = base / path
    where = f"bodies.path: {one_line(path, 200)}"
    table = read_table(file, where)
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
    return _bodies(table, "bodies")


def _bodies(table: pa.Table, where: str) -> TableBodies:
    """Return the bodies of a table; messages of errors begin with `where`."""
    if repeated := [
        name for name, times in Counter(table.column_names).items() if times > 1
    ]:
        raise ConfigError(
            f"{where}: the column {one_line(repeated[0])} is repeated; keep one"
        )
    if not table.num_rows:
        raise ConfigError(f"{where}: the table has no rows; give at least one body")
    if not is_output(table.column_names):
        for name in table.column_names:
            if name in TAKEN:
                raise ConfigError(
                    f"{where}: the column {name} has the name of a result, which the "
                    "runs will have; rename or drop it"
                )
    given = dict(zip(table.column_names, table.columns, strict=True))
    columns = {name: _numbers(given[name]) for name in INPUT if name in given}
    problems: list[RowProblem] = []
    for name, values in columns.items():
        bad = ~np.isfinite(values)
        if name in NULLABLE:
            bad &= ~given[name].is_null(nan_is_null=True).to_numpy()
        for row in _first(bad):
            cell = given[name][row].as_py()
            shown = "empty" if cell is None else repr(str(cell)[:40])
            problems.append((row, f"{name} is {shown}; a finite number is needed"))
    _refuse(where, [*problems, *_out_of_bounds(columns)])
    units = _without_units(columns, where)
    if "f_sd" in columns and not {"alpha", "beta"} & columns.keys():
        _add_shell_dumbbells(columns, where)
    _require(PARAMETERS, columns, where, f"a body has {' '.join(PARAMETERS)}")
    if state := columns.keys() & {*OMEGA, *U}:
        _require(
            (*OMEGA, *U), columns, where, f"a full state has {' '.join((*OMEGA, *U))}"
        )
    elif columns.keys() & {*LAUNCH}:
        _require(LAUNCH, columns, where, "a launch has n_i and omega_xy0")
    impossible = violations(**{name: columns[name] for name in PARAMETERS})
    _refuse(where, [*_out_of_bounds(columns), *impossible])
    if "t_r" in columns and "t_end" in columns:
        # The t_end of a run that reversed is its reversal time, not its horizon.
        columns["t_end"] = np.where(
            np.isfinite(columns["t_r"]), np.nan, columns["t_end"]
        )
    used = {"", *INPUT, *RESULTS} - KEPT.keys()
    carried = {name: _own(name, x) for name, x in given.items() if name not in used}
    columns = {name: columns[name] for name in COLUMNS if name in columns}
    if state:
        columns |= launched_from(columns, where)
    return TableBodies(columns, units, carried)


def _add_shell_dumbbells(columns: dict[str, Floats], where: str) -> None:
    """Add the inertia of bodies that are given by the paper's parameters."""
    _require(SHELL_DUMBBELL, columns, where, f"a body has {' '.join(SHELL_DUMBBELL)}")
    f_sd, quantity = columns["f_sd"], QUANTITIES["f_sd"]
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


def _own(name: str, column: pa.ChunkedArray) -> NDArray[Any]:
    """Return a carried column as integers, numbers (NaN for empty cells) or texts."""
    kind, types = column.type, pa.types
    whole = types.is_integer(kind) and kind != pa.uint64() and name not in KEPT
    if whole and not column.null_count:
        return np.asarray(column).astype(np.int64)
    if (
        name in KEPT
        or types.is_integer(kind)
        or types.is_floating(kind)
        or types.is_decimal(kind)
    ):
        return _numbers(column)
    return np.array(
        [x if x is None else str(x) for x in column.to_pylist()], dtype=object
    )


def _without_units(columns: dict[str, Floats], where: str) -> Units | None:
    """Add the columns that those with units determine; return the bodies' units if
    known.
    """
    made: dict[str, Floats] = {}
    units: Units | None = None
    rows = max(map(len, columns.values()), default=0)
    full = {name: np.full(rows, x) for name, x in BODY_DEFAULTS.items()} | columns
    if "height_m" in columns:
        units = Units(full["mass_kg"], full["height_m"], full["gravity_m_s2"])
    if columns.keys() & {*SI_BODY[2:], "ixy_kg_m2", "axes_angle_deg"}:
        _require(SI_BODY, columns, where, f"a body in SI units has {' '.join(SI_BODY)}")
        tensor = np.stack(
            [full[f"i{x}_kg_m2"] for x in ("xx", "yy", "zz", "xy")], axis=1
        )
        radii = np.stack([full["r1_m"], full["r2_m"]], axis=1)
        angle = np.radians(full["axes_angle_deg"])
        made = si.parameters(full["mass_kg"], tensor, full["height_m"], radii, angle)
    for name, (plain, size, kind) in WITH_UNITS.items():
        if name in columns:
            sizes = {"": (), "torque per spin": ("mass_kg", "height_m")}.get(
                kind, ("height_m",)
            )
            _require(sizes, columns, where, f"{name} needs it")
            value = columns[name] * size
            made[plain] = value = (
                units.natural(value, kind) if units and kind else value
            )
            # The runs of a sweep have both n_i and n_i_rpm.
            if plain in columns and not (
                kind and np.allclose(columns[plain], value, 1e-9, 0.0)
            ):
                raise ConfigError(
                    f"{where}: {plain} and {name} are one quantity; keep one"
                )
    # Columns without units take precedence, so that the runs of a sweep are repeated
    # exactly.
    columns |= made | columns
    return units


def launched_from(columns: dict[str, Floats], where: str) -> dict[str, Floats]:
    """Return spin, oscillation and u of full states; messages of errors begin with
    `where`.
    """
    omega, u = (np.stack([columns[x] for x in names], axis=1) for names in (OMEGA, U))
    u = normalised(u)
    at_rest = ~omega.any(axis=1) & (u[:, 2] == -1)
    rules = {NO_UNIT_VECTOR: np.isnan(u[:, 0]), AT_REST: at_rest}
    _refuse(
        where, ((row, message) for message, bad in rules.items() for row in _first(bad))
    )
    n_i, omega_xy0, psi = spin_and_oscillation(omega, u)
    return {"n_i": n_i, "omega_xy0": omega_xy0, "psi": psi} | dict(
        zip(U, u.T, strict=True)
    )


def check_value(name: str, values: Floats) -> RowProblem | None:
    """Return the place of the first value out of bounds and a message; NaN is in
    bounds.
    """
    if name not in BOUNDED:
        return None
    quantity = QUANTITIES[name]
    for place in _first((values < quantity.low) | (values > quantity.high)):
        if values[place] <= 0 < quantity.low:
            return place, "it must be positive"
        return place, f"{quantity.limits} is allowed"
    return None


def _out_of_bounds(columns: dict[str, Floats]) -> Iterator[RowProblem]:
    for name, values in columns.items():
        # Full states may have no oscillation.
        broken = (
            None
            if name == "omega_xy0" and "u_x" in columns
            else check_value(name, values)
        )
        if broken:
            yield broken[0], f"{name} is {values[broken[0]]:g}; {broken[1]}"


def _first(bad: Flags) -> list[int]:
    return [int(np.argmax(bad))] if bad.any() else []


def _refuse(where: str, problems: Iterable[RowProblem]) -> None:
    """Raise a ConfigError with the first problem of each of up to five rows, if there
    are any.
    """
    first: dict[int, str] = {}
    for row, message in problems:
        first.setdefault(row, message)
    if first:
        raise ConfigError(
            f"{where}: row {row + 1}: {first[row]}" for row in sorted(first)[:5]
        )


def _require(
    names: Iterable[str], columns: Iterable[str], where: str, wanted: str
) -> None:
    if missing := [name for name in names if name not in columns]:
        raise ConfigError(f"{where}: the column {missing[0]} is missing; {wanted}")
