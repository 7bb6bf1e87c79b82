"""Bodies from the rows of a table: which columns count, which values are possible, what is carried.

A row gives a body, by the parameters of the equations or in SI units by the columns of
:data:`BODY`; perhaps a launch, as a spin and an oscillation or as a full state, a horizon, and its
dissipation.  Other columns, such as the name of a stone, are carried along to the runs.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats, Integers, take
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.physics import si
from rattlesweep.physics.body import PARAMETERS, violations
from rattlesweep.physics.launch import spin_and_oscillation
from rattlesweep.sweeps import columns as known
from rattlesweep.sweeps.arrow import write_parquet
from rattlesweep.sweeps.bodies.protocol import Bodies, Scale
from rattlesweep.sweeps.bodies.tablefile import read_table, table_of
from rattlesweep.sweeps.columns import F64, I64, MEASURED, RUNS, STATE, TEXT
from rattlesweep.sweeps.config.schema import (
    MAX_SIGMA,
    MAX_SPEED,
    MAX_TIME,
    MIN_OSCILLATION,
    TABLE,
    TableSource,
    unit,
)
from rattlesweep.sweeps.files import explained
from rattlesweep.units import Quantity

if TYPE_CHECKING:
    import pandas as pd

LAUNCH = ("n_i", "omega_xy0")
OMEGA, U = ("omega_x", "omega_y", "omega_z"), ("u_x", "u_y", "u_z")
LOSSES = ("sigma", "rolling")
COLUMNS = (*PARAMETERS, *LAUNCH, *OMEGA, *U, "t_end", "psi", "f_sd", "c", *LOSSES)
"""Columns that say what is run, without SI units."""

BODY = ("mass_kg", "height_m", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2", "r1_m", "r2_m")
"""Mass, height of the centre of mass, inertia about it, radii of curvature at the bottom."""
BODY_DEFAULTS = {"ixy_kg_m2": 0.0, "axes_angle_deg": 0.0, "gravity_m_s2": si.GRAVITY}
"""Product of inertia, angle from the x axis to the direction of r1, and gravity."""
WITH_UNITS = {
    "xi_deg": ("xi", np.pi / 180, ""),
    "psi_deg": ("psi", np.pi / 180, ""),
    "n_i_rpm": ("n_i", np.pi / 30, "spin"),
    "omega_xy0_rpm": ("omega_xy0", np.pi / 30, "spin"),
    "t_end_s": ("t_end", 1.0, "time"),
    "c_m": ("c", 1.0, "length"),
    "rolling_m": ("rolling", 1.0, "length"),
    "sigma_N_m_s": ("sigma", 1.0, "torque per spin"),
}
"""Columns with units: what each stands for, its size in SI units, and its kind."""
KEYS = {"n_i": "spin.n_i", "omega_xy0": "spin.omega_xy0", "t_end": "horizon.t",
        "sigma": "dissipation.sigma", "rolling": "dissipation.rolling"}  # fmt: skip
"""Keys of the config that may have SI units, by the columns that they stand for."""
INPUT = (*COLUMNS, "t_r", *BODY, *BODY_DEFAULTS, *WITH_UNITS)
NULLABLE = ("t_end", "psi", "psi_deg", "f_sd", "t_r", "c", "t_end_s", "c_m")
KEPT = {"mass_kg": "kg", "height_m": "m", "gravity_m_s2": "m/s^2"}
"""Input columns that the runs keep, and their units."""

RESULTS = {column.name for part in (*RUNS.values(), STATE, MEASURED) for column in part}
TAKEN = {column.name for part in ("keys", "result", "observation") for column in RUNS[part]}
"""Names of results that no input column may have."""

# How far a column may differ from the same one with units, as an output table has both of spins.
SLACK = 1e-9
MOST_TOLD = 5
NUMBER = r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*$"
WHOLE, PADDED = r"^\s*[+-]?\d{1,18}\s*$", r"^\s*[+-]?0\d"

POSITIVE = np.nextafter(0.0, 1.0)
SIZES = {"mass_kg": "mass", "height_m": "length", "r1_m": "length", "r2_m": "length",
         "gravity_m_s2": "acceleration"}  # fmt: skip
RULES: tuple[tuple[tuple[str, ...], float, float, str], ...] = (
    # This one is for launches by a spin; full states may have no oscillation.
    (("omega_xy0",), MIN_OSCILLATION, np.inf, f"it must be positive, from {MIN_OSCILLATION:g}"),
    ((*LAUNCH, *OMEGA), -MAX_SPEED, MAX_SPEED,
     f"from {-MAX_SPEED:g} to {MAX_SPEED:g} sqrt(g/a) is allowed"),
    (("sigma",), 0, MAX_SIGMA, f"from 0 to {MAX_SIGMA:g} is allowed"),
    (("rolling",), 0, 1, "from 0 to at most 1 is allowed"),
    (("t_end", *BODY, "gravity_m_s2"), POSITIVE, np.inf, "it must be positive"),
    (("t_end",), -np.inf, MAX_TIME, f"at most {MAX_TIME:g} is allowed"),
    (("psi",), -2 * np.pi, 2 * np.pi,
     "an angle from -2 pi to 2 pi in radians is allowed; a column in degrees is called psi_deg"),
    (("psi_deg",), -360, 360, "an angle from -360 to 360 degrees is allowed"),
    *(((name,), low, high, f"from {low:g} to {high:g} {unit} is allowed")
      for name, kind in SIZES.items() for low, high, unit in [si.LIMITS[kind]]),
)  # fmt: skip
"""Columns that are no parameters of bodies: the smallest and the largest value, and a sentence."""
Problem = tuple[int, str]
"""Number of a row from 0, and what is wrong with it."""


class TableBodies:
    """Bodies from the rows of a table.

    Parameters
    ----------
    columns : dict of ndarray
        Columns by the names of :data:`COLUMNS`, all of one length: those of the parameters, and
        perhaps others.
    scale, carried : Scale and dict of ndarray, optional
        As for :class:`rattlesweep.sweeps.bodies.protocol.Bodies`.
    fields : tuple of pyarrow.Field
        Fields of the columns that the runs have because of these two.
    """

    def __init__(
        self,
        columns: dict[str, Floats],
        scale: Scale | None = None,
        carried: dict[str, NDArray[Any]] | None = None,
        fields: tuple[pa.Field, ...] = (),
    ) -> None:
        self.columns, self.scale = columns, scale
        self.carried, self.fields = carried or {}, fields
        self.samples = len(columns["alpha"])
        self.has_launch = "n_i" in columns
        self.has_state = "u_x" in columns

    @property
    def losses(self) -> dict[str, float | str]:
        """Dissipation that the table gives: a number if all rows share it, else "table"."""
        own = {name: np.unique(self.columns[name]) for name in LOSSES if name in self.columns}
        return {name: float(v[0]) if len(v) == 1 else TABLE for name, v in own.items()}

    @property
    def has_semi_axes(self) -> bool:
        """Whether some of the bodies are ellipsoids."""
        return "c" in self.columns and bool(np.isfinite(self.columns["c"]).any())

    @property
    def config(self) -> dict[str, str]:
        """The part `bodies` of the config of a sweep that keeps these bodies beside its runs."""
        surface = {"surface": "ellipsoid"} if self.has_semi_axes else {}
        # By its content: no other table is taken for it.
        return {"source": "table", "path": f"bodies-{self.content_hash[:16]}.parquet"} | surface

    @cached_property
    def content_hash(self) -> str:
        """Hash of all columns: other bodies, launches or carried values have another one."""
        digest = hashlib.sha256()
        for name, values in sorted((self.columns | self.carried).items()):
            digest.update(f"{name}\0{values.dtype.kind}\0{len(values)}\0".encode())
            if values.dtype.kind == "f":
                # One NaN is as good as another.
                values = np.where(np.isnan(values), np.nan, values)
            text = values.dtype.kind == "O"
            digest.update(repr(values.tolist()).encode() if text else values.tobytes())
        return digest.hexdigest()

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs; all cases have the same."""
        columns = take(self.columns, sample)
        columns.setdefault("f_sd", np.full(len(sample), np.nan))
        for name, parts in (("omega", OMEGA), ("u", U)) if self.has_state else ():
            columns[name] = np.stack([columns.pop(part) for part in parts], axis=1)
        return Bodies(**columns, scale=take(self.scale, sample), carried=take(self.carried, sample))

    def with_surface(self, source: TableSource) -> TableBodies:
        """Return these bodies with the surface that a config gives them.

        Raises
        ------
        ConfigError
            If the config and the column ``c`` do not go together, or an ellipsoid cannot stand.
        """
        columns = dict(self.columns)
        c = columns.pop("c", np.full(self.samples, np.nan))
        if source.surface is None and source.c is None and self.has_semi_axes:
            told = "missing; the table has a column c, so say ellipsoid, or paraboloid"
            raise ConfigError(f"bodies.surface: {told} to leave it out")
        if source.ellipsoidal:
            if source.c is not None:
                c = np.where(np.isnan(c), source.c, c)
            if np.isnan(c).all():
                told = "missing; the table has no column c, so the config must give one"
                raise ConfigError(f"bodies.c: {told}")
            columns["c"] = c
            refuse("bodies.path", _impossible(columns, (*PARAMETERS, "c")))
        return TableBodies(columns, self.scale, self.carried, self.fields)


def read_bodies(path: str, base: Path | None = None) -> TableBodies:
    """Read bodies from a CSV or Parquet file, or a directory of such, here or under `base`.

    Raises
    ------
    ConfigError
        If it is no such table, with a line for each of the first bad rows.
    """
    where = f"bodies.path: {one_line(path, 200)}"
    table = read_table(path, base, where)
    if not {"case", "sample"} <= {*table.column_names}:  # an output table has results too
        for name in table.column_names:
            if name in TAKEN and name not in INPUT:
                raise ConfigError(f"{where}: the column {name} has the name of a result; rename it")
    return _bodies(table, where)


def frame_bodies(frame: pd.DataFrame, where: str = "bodies") -> TableBodies:
    """Return the bodies of a DataFrame; `where` is what a ConfigError begins with."""
    bodies = _bodies(table_of(frame, where), where)
    if bodies.has_semi_axes:
        refuse(where, _impossible(bodies.columns, (*PARAMETERS, "c")))
    return bodies


def keep_bodies(source: TableBodies, directory: Path) -> None:
    """Keep bodies from memory in the directory of their sweep, where their config looks for them.

    The table that is read from there has the same content.
    """
    if (path := directory / source.config["path"]).exists():
        return
    with explained(f"cannot write in {directory}"):
        directory.mkdir(parents=True, exist_ok=True)
    # A directory with nothing else in it is known by the mark to be that of a sweep.
    mark = {"rattlesweep.bodies": source.content_hash}
    write_parquet(pa.table(source.columns | source.carried), path, mark)


# -- from columns to bodies --------------------------------------------------------------------


def _bodies(table: pa.Table, where: str) -> TableBodies:
    if not table.num_rows:
        raise ConfigError(f"{where}: the table has no rows; give at least one body")
    columns: dict[str, Floats] = {}
    problems: list[Problem] = []
    for name in (name for name in INPUT if name in table.column_names):
        columns[name], bad = _numbers(table.column(name), name, where)
        problems += bad
    with np.errstate(all="ignore"):  # of bad rows, which are refused below
        scale, differing = _lose_units(columns, where)
    _require(PARAMETERS, columns, where, f"{' '.join(PARAMETERS)} are wanted")
    state = [name for name in (*OMEGA, *U) if name in columns]
    if state:
        _require((*OMEGA, *U), state, where, f"a full state has {' '.join((*OMEGA, *U))}")
    lone = [name for name in LAUNCH if name in columns]
    if len(lone) == 1 and not state:
        told = "stands alone; give both n_i and omega_xy0, or neither"
        raise ConfigError(f"{where}: {lone[0]} {told}")
    problems += _out_of_range(columns) + differing + _impossible(columns, PARAMETERS)
    refuse(where, problems)
    if "t_r" in columns and "t_end" in columns:
        # In an output table the t_end of a run that reversed is its result, and not its horizon.
        columns["t_end"] = np.where(np.isfinite(columns["t_r"]), np.nan, columns["t_end"])
    carried, fields = _carried(table, columns)
    columns = {name: columns[name] for name in COLUMNS if name in columns}
    if state:
        columns |= launched_from(columns, where)
    if "n_i" not in columns or not np.isfinite(columns.get("psi", np.nan)).all():
        columns.pop("psi", None)
    return TableBodies(columns, scale, carried, fields if scale is None else fields + MEASURED)


def _numbers(column: pa.ChunkedArray, name: str, where: str) -> tuple[Floats, list[Problem]]:
    """Return a column as numbers, NaN where it has none, and the cells that are wrong."""
    if not (_is_text(column) or _is_number(column)):
        told = f"the column {name} is of type {column.type}; numbers are wanted"
        raise ConfigError(f"{where}: {told}")
    try:
        found = column.cast(F64, safe=False)
    except pa.ArrowInvalid:  # spaces, or text that is no number
        right = pc.match_substring_regex(column, NUMBER)
        found = pc.if_else(right, pc.utf8_trim_whitespace(column), None).cast(F64)
    values: Floats = found.to_numpy().astype(float, copy=False)
    bad = ~np.isfinite(values)
    if not bad.any():
        return values, []
    empty = column.is_null(nan_is_null=True).to_numpy()
    if name in NULLABLE:
        bad &= ~empty
    cells = [(k, "empty" if empty[k] else repr(str(column[k].as_py())[:40])) for k in _first(bad)]
    return values, [(k, f"{name} is {cell}; a finite number is needed") for k, cell in cells]


def _is_text(column: pa.ChunkedArray) -> bool:
    return bool(pa.types.is_string(column.type) or pa.types.is_large_string(column.type))


def _is_number(column: pa.ChunkedArray) -> bool:
    kind, types = column.type, pa.types
    plain = types.is_integer(kind) or types.is_floating(kind)
    return bool(plain or types.is_decimal(kind) or types.is_null(kind))


def _lose_units(columns: dict[str, Floats], where: str) -> tuple[Scale | None, list[Problem]]:
    """Add the columns without units that follow from those with units.

    Returns the units of the bodies, where they are known, and where two columns disagree.
    """
    made: dict[str, tuple[str, Floats]] = {}
    scale: Scale | None = None
    if (height := columns.get("height_m")) is not None:
        gravity = columns.get("gravity_m_s2", np.full(len(height), si.GRAVITY))
        scale = Scale(columns.get("mass_kg", np.full(len(height), np.nan)), height, gravity)
    if columns.keys() & {*BODY[2:], "ixy_kg_m2", "axes_angle_deg"}:
        _require(BODY, columns, where, f"a body in SI units has {' '.join(BODY)}")
        rows = len(columns["mass_kg"])
        full = {name: np.full(rows, x) for name, x in BODY_DEFAULTS.items()} | columns
        tensor = np.stack([full[f"i{x}_kg_m2"] for x in ("xx", "yy", "zz", "xy")], axis=1)
        radii = np.stack([full["r1_m"], full["r2_m"]], axis=1)
        angle = np.radians(full["axes_angle_deg"])
        found = si.parameters(full["mass_kg"], tensor, full["height_m"], radii, angle)
        made |= {name: ("the body in SI units", values) for name, values in found.items()}
    for name, (plain, size, kind) in WITH_UNITS.items():
        if name in columns:
            needed = {"": (), "torque per spin": ("mass_kg", "height_m")}.get(kind, ("height_m",))
            _require(needed, columns, where, f"{name} needs it")
            value = columns[name] * size
            made[plain] = name, scale.natural(value, kind) if scale and kind else value
    problems: list[Problem] = []
    for plain, (name, values) in made.items():
        # The one without units counts, so that an output table gives the same runs again.
        own = columns.setdefault(plain, values)
        for k in _first(~np.isclose(values, own, rtol=SLACK, atol=0, equal_nan=True)):
            told = f"{plain} is {own[k]:g}, and {name} comes to {values[k]:g}"
            problems.append((k, f"{told}; keep one of the two"))
    return scale, problems


def launched_from(columns: dict[str, Floats], where: str) -> dict[str, Floats]:
    """Return the launches that full states come to, with ``u`` of length 1.

    Raises
    ------
    ConfigError
        If a row is no state, or gives another spin beside it; begins with `where`.
    """
    omega, u = (np.stack([columns[x] for x in names], axis=1) for names in (OMEGA, U))
    problems: list[Problem] = []
    length = np.fromiter(map(math.hypot, *u.T.tolist()), float, len(u))
    for row in np.flatnonzero(~(np.abs(length - 1) < 1e-15) | ~(u[:, 2] < 0)).tolist():
        try:
            u[row] = unit(u[row].tolist())
        except ValueError as error:
            problems.append((row, f"u: {error}"))
    n_i, omega_xy0, psi = spin_and_oscillation(omega, u)
    told = "the body stands upright and at rest; give it an angular velocity"
    problems += [(row, told) for row in _first((omega == 0).all(axis=1) & (u[:, 2] == -1))]
    given = columns.get("n_i", n_i)
    for row in _first(np.abs(given - n_i) > SLACK * np.linalg.norm(omega, axis=1)):
        told = f"n_i is {given[row]:g}, and the spin of the full state {n_i[row]:g}"
        problems.append((row, f"{told}; leave n_i and omega_xy0 out"))
    refuse(where, problems)
    lengths = {name: u[:, k] for k, name in enumerate(U)}
    return {"n_i": n_i, "omega_xy0": omega_xy0, "psi": psi} | lengths


def _carried(
    table: pa.Table, numbers: dict[str, Floats]
) -> tuple[dict[str, NDArray[Any]], tuple[pa.Field, ...]]:
    """Return the columns that the runs keep of a table: words, whole numbers and other numbers.

    `numbers` are the columns of input.
    """
    carried: dict[str, NDArray[Any]] = {}
    fields: list[pa.Field] = []
    for name, column in zip(table.column_names, table.columns, strict=True):
        if name in KEPT:
            carried[name] = numbers[name]
            fields.append(known.required(name, F64, KEPT[name], "of the table of bodies"))
        elif name not in INPUT and name not in RESULTS and (_is_text(column) or _is_number(column)):
            kind = _kind(column)
            if kind == F64:
                carried[name] = _numbers(column, name, "")[0]
            elif kind == TEXT or column.null_count:
                whole = int if kind == I64 else str
                values = [None if x is None else whole(x) for x in column.to_pylist()]
                carried[name] = np.array(values, dtype=object)
            else:
                carried[name] = np.asarray(column).astype(np.int64)
            fields.append(known.field(name, kind, "1", "column of the table of bodies"))
    return carried, tuple(fields)


def _kind(column: pa.ChunkedArray) -> pa.DataType:
    """Return what the runs keep a column as; numbers with leading zeros are names, and so text."""
    if not _is_text(column):
        whole = pa.types.is_integer(column.type) and not pa.types.is_uint64(column.type)
        return I64 if whole else F64
    given = column.drop_null()
    number, whole, padded = (pc.match_substring_regex(given, p) for p in (NUMBER, WHOLE, PADDED))
    if not len(given) or not pc.all(number).as_py() or pc.any(padded).as_py():
        return TEXT
    return I64 if pc.all(whole).as_py() else F64


# -- bad rows ----------------------------------------------------------------------------------


def check_value(name: str, values: Floats) -> tuple[int, str] | None:
    """Return the place of the first value that breaks a rule, and what is wanted."""
    for names, low, high, wanted in RULES:
        if name in names and (bad := (values < low) | (values > high)).any():
            return int(np.argmax(bad)), wanted
    return None


def check_quantity(name: str, value: Quantity, natural: Floats) -> None:
    """Raise a ConfigError if a value with a unit is out of range in the units of the bodies."""
    if broken := check_value(name, natural):
        place, wanted = broken
        told = f"{value.text} comes to {natural[place]:g} in units of the body"
        raise ConfigError(f"{KEYS[name]}: {told}; {wanted}")


def refuse(where: str, problems: list[Problem]) -> None:
    """Raise a ConfigError with a sentence for each of the first bad rows."""
    first: dict[int, str] = {}
    for row, sentence in problems:
        first.setdefault(row, sentence)
    lines = [f"{where}: row {row + 1}: {first[row]}" for row in sorted(first)]
    if len(lines) > MOST_TOLD:
        lines[MOST_TOLD:] = [f"{where}: there are more bad rows"]
    if lines:
        raise ConfigError(lines)


def _first(bad: Flags) -> list[int]:
    """Return the first bad rows, one more than are told."""
    rows: list[int] = np.flatnonzero(bad)[: MOST_TOLD + 1].tolist()
    return rows


def _impossible(columns: dict[str, Floats], names: Iterable[str]) -> list[Problem]:
    """Return the bodies that cannot exist, judged by some of their parameters, and why."""
    bodies = {name: columns[name] for name in names}
    rows, problems = np.arange(len(bodies["alpha"])), list[Problem]()
    # Each time the first offender of each rule is found.
    for _ in range(MOST_TOLD + 1):
        found = list(violations(**take(bodies, rows)))
        problems += [(int(rows[place]), sentence) for place, sentence in found]
        rows = np.delete(rows, [place for place, _ in found])
        if not found or not rows.size:
            break
    return problems


def _out_of_range(columns: dict[str, Floats]) -> list[Problem]:
    """Return the values that break a rule of their column; NaN, where it may stand, breaks none."""
    return [
        (row, f"{name} is {columns[name][row]:g}; {wanted}")
        for names, low, high, wanted in (RULES[1:] if "u_x" in columns else RULES)
        for name in names
        if name in columns
        for row in _first((columns[name] < low) | (columns[name] > high))
    ]


def _require(names: Iterable[str], there: Iterable[str], where: str, wanted: str) -> None:
    for name in names:
        if name not in there:
            raise ConfigError(f"{where}: the column {name} is missing; {wanted}")
