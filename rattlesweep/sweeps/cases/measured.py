"""What a table of bodies has beside the numbers of the equations: SI units, and columns of its own.

Bodies in SI units have the columns of :data:`BODY`, launches those of :data:`LAUNCH`; a table of
dimensionless bodies may have ``height_m`` alone, for the unit of time.  What is neither input nor
result, such as the name of a stone, is carried through to the runs.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.physics import si
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.sweeps.tables import columns
from rattlesweep.sweeps.tables.columns import F64, I64, MEASURED, RUNS, STATE, TEXT

BODY = ("mass_kg", "height_m", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2", "r1_m", "r2_m")
"""Mass, height of the centre of mass, inertia about it, radii of curvature at the bottom."""
OPTIONAL = {"ixy_kg_m2": 0.0, "axes_angle_deg": 0.0, "gravity_m_s2": si.GRAVITY}
"""And the product of inertia, the angle from the x axis to the direction of r1, and gravity."""
LAUNCH = {"n_i_rpm": "n_i", "omega_xy0_rpm": "omega_xy0", "t_end_s": "t_end"}
"""Launch and horizon, and the columns without units that they stand for."""
MORE = {"c_m": "c", "sigma_N_m_s": "sigma", "rolling_m": "rolling"}
"""Vertical semi-axis and dissipation, likewise."""
INPUT = ("xi_deg", *BODY, *OPTIONAL, *LAUNCH, *MORE)
# What the runs keep of these.
KEPT = {"mass_kg": "kg", "height_m": "m", "gravity_m_s2": "m/s^2"}
RPM = np.pi / 30
# How far a spin may differ from the same in turns a minute, as an output table has both.
SLACK = 1e-9

OURS = {column.name for part in RUNS.values() for column in part} | {c.name for c in STATE}
# Results whose names nobody else may have: those that are no input and follow from no input alone.
TAKEN = {c.name for part in ("keys", "result", "observation") for c in RUNS[part]}


@dataclass(frozen=True)
class Measured:
    """What belongs to the rows of a table beside bodies and launches.

    Attributes
    ----------
    second : ndarray or None
        ``sqrt(a/g)`` in seconds, where it is known.
    carried : dict of ndarray
        Values of the columns that the runs get too.
    fields : tuple of pyarrow.Field
        These columns, and those of :data:`rattlesweep.sweeps.tables.columns.MEASURED` where the
        unit of time is known.
    """

    second: Floats | None = None
    carried: dict[str, NDArray[Any]] = field(default_factory=dict)
    fields: tuple[pa.Field, ...] = ()


def require(names: Iterable[str], there: Container[str], where: str, wanted: str) -> None:
    """Refuse a table in which a column is missing."""
    for name in names:
        if name not in there:
            raise ConfigError(f"{where}: the column {name} is missing; {wanted}")


def without_units(
    frame: pd.DataFrame, numbers: Callable[[str], Floats], where: str
) -> tuple[pd.DataFrame, Floats | None]:
    """The table in the body's own units, and these in seconds; `numbers` reads a column.

    What is missing, there in two ways, or out of range is refused in a line that begins with
    `where`.
    """
    given = {name: numbers(name) for name in INPUT if name in frame.columns}
    made: dict[str, Floats] = {}

    def made_once(name: str, of: str, values: Floats) -> None:
        if name in frame.columns:
            raise ConfigError(f"{where}: the columns {name} and {of} say the same; keep one")
        made[name] = values

    for name in given:
        if name in (*BODY, "gravity_m_s2"):
            wrong = given[name] <= 0
            if wrong.any():
                row = int(np.argmax(wrong))
                raise ConfigError(
                    f"{where}: row {row + 1}: {name} is {given[name][row]:g}; it must be positive"
                )
    if "xi_deg" in given:
        made_once("xi", "xi_deg", np.radians(given["xi_deg"]))
    second = None
    if "height_m" in given:
        gravity = given.get("gravity_m_s2", np.full(len(frame), si.GRAVITY))
        second = np.sqrt(given["height_m"] / gravity)
    inertia = [name for name in (*BODY[2:], "ixy_kg_m2", "axes_angle_deg") if name in given]
    if inertia:
        require(BODY, given, where, f"a body in SI units has {' '.join(BODY)}")
        full = {name: np.full(len(frame), value) for name, value in OPTIONAL.items()} | given
        tensor = np.stack([full[f"i{x}_kg_m2"] for x in ("xx", "yy", "zz", "xy")], axis=1)
        radii = np.stack([full["r1_m"], full["r2_m"]], axis=1)
        angle = np.radians(full["axes_angle_deg"])
        found = si.parameters(full["mass_kg"], tensor, full["height_m"], radii, angle)
        for name in PARAMETERS:
            made_once(name, inertia[0], found[name])
    for name, plain in LAUNCH.items():
        if name not in given:
            continue
        if second is None:
            raise ConfigError(f"{where}: {name} needs the unit of time; add the column height_m")
        values = given[name] / second if plain == "t_end" else given[name] * RPM * second
        if plain in frame.columns and plain != "t_end":
            other = numbers(plain)
            wrong = np.abs(other - values) > SLACK * np.abs(other)
            if wrong.any():
                row = int(np.argmax(wrong))
                raise ConfigError(
                    f"{where}: row {row + 1}: {plain} is {other[row]:g}, and {name} comes to "
                    f"{values[row]:g}; keep one of the columns"
                )
        else:
            made_once(plain, name, values)
    for name, plain in MORE.items():
        if name not in given:
            continue
        needed = ("mass_kg", "height_m") if plain == "sigma" else ("height_m",)
        if absent := [other for other in needed if other not in frame.columns]:
            raise ConfigError(
                f"{where}: {name} needs the body's units; add the column {' and '.join(absent)}"
            )
        unit = given["height_m"]
        if plain == "sigma":
            assert second is not None
            unit = given["mass_kg"] * given["height_m"] ** 2 / second
        made_once(plain, name, given[name] / unit)
    return frame.assign(**made) if made else frame, second


def own_columns(frame: pd.DataFrame, known: tuple[str, ...], where: str) -> Measured:
    """What the runs get of a table beside what is known: words, whole numbers, numbers.

    Names of results are refused, unless the table is one of results.
    """
    carried: dict[str, NDArray[Any]] = {}
    fields: list[pa.Field] = []
    output = {"case", "sample"} <= set(frame.columns)
    ours = OURS | {column.name for column in MEASURED}
    for name in map(str, frame.columns):
        if name in KEPT:
            carried[name] = pd.to_numeric(frame[name]).to_numpy(dtype=float)
            words = "of the table of bodies"
            fields.append(columns.required(name, F64, KEPT[name], words))
        elif name in known or name in ours:
            if name in TAKEN and name not in known and not output:
                raise ConfigError(
                    f"{where}: the column {one_line(name)} has the name of a result; rename it"
                )
        elif (found := _kind(frame[name])) is not None:
            kind, carried[name] = found
            fields.append(columns.field(name, kind, "1", "column of the table of bodies"))
    return Measured(None, carried, tuple(fields))


def _kind(series: pd.Series[Any]) -> tuple[pa.DataType, NDArray[Any]] | None:
    """What a column holds, as the runs store it, None for null; None for what they do not."""
    empty = series.isna().to_numpy()
    if series.dtype.kind in "iuf":
        whole = series.dtype.kind in "iu"
        return (I64, series.to_numpy(dtype=np.int64)) if whole else (F64, series.to_numpy(float))
    if not all(isinstance(value, str) for value in series[~empty]):
        return None
    # A CSV is text.
    numbers = pd.to_numeric(series, errors="coerce").to_numpy(dtype=float)
    words = series.to_numpy(dtype=object, copy=True)
    words[empty] = None
    text = empty.all() or bool(np.isnan(numbers[~empty]).any())
    if text or not series[~empty].str.fullmatch(r"[+-]?\d{1,18}").all():
        return (TEXT, words) if text else (F64, numbers)
    # Leading zeros belong to a name.
    if series[~empty].str.fullmatch(r"[+-]?0\d+").any():
        return TEXT, words
    return I64, np.array([None if word is None else int(word) for word in words], object)
