"""What a table of bodies has beside the numbers of the equations: SI units, and columns of its own.

Bodies in SI units have the columns of :data:`BODY`; a table of dimensionless bodies may have
``height_m`` alone, for the unit of time.  What is neither input nor result, such as the name of a
stone, is carried through to the runs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.physics import si
from rattlesweep.sweeps import columns
from rattlesweep.sweeps.columns import F64, I64, MEASURED, RUNS, STATE, TEXT

BODY = ("mass_kg", "height_m", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2", "r1_m", "r2_m")
"""Mass, height of the centre of mass, inertia about it, radii of curvature at the bottom."""
OPTIONAL = {"ixy_kg_m2": 0.0, "axes_angle_deg": 0.0, "gravity_m_s2": si.GRAVITY}
"""And the product of inertia, the angle from the x axis to the direction of r1, and gravity."""
RPM = np.pi / 30
UNITS: dict[str, tuple[str, tuple[str, ...], Callable[[Floats, Mapping[str, Floats]], Floats]]] = {
    "xi_deg": ("xi", (), lambda x, of: np.radians(x)),
    "n_i_rpm": ("n_i", ("height_m",), lambda x, of: x * RPM * of["second"]),
    "omega_xy0_rpm": ("omega_xy0", ("height_m",), lambda x, of: x * RPM * of["second"]),
    "t_end_s": ("t_end", ("height_m",), lambda x, of: x / of["second"]),
    "c_m": ("c", ("height_m",), lambda x, of: x / of["height_m"]),
    "sigma_N_m_s": ("sigma", ("mass_kg", "height_m"),
                    lambda x, of: x / (of["mass_kg"] * of["height_m"] ** 2 / of["second"])),
    "rolling_m": ("rolling", ("height_m",), lambda x, of: x / of["height_m"]),
}  # fmt: skip
"""Columns with units: what each stands for, what else it needs, and how it loses its unit."""
INPUT = (*BODY, *OPTIONAL, *UNITS)
# What the runs keep of these.
KEPT = {"mass_kg": "kg", "height_m": "m", "gravity_m_s2": "m/s^2"}
# How far a column may differ from the same in units, as an output table has both of spins.
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
        These columns, and those of :data:`rattlesweep.sweeps.columns.MEASURED` where the
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


def refuse_row(where: str, bad: Flags, sentence: str, *of: Any) -> None:
    """Refuse a table for the first of its bad rows, whose values of `of` the sentence takes."""
    for row in np.flatnonzero(bad)[:1]:
        told = sentence.format(*(values[row] for values in of))
        raise ConfigError(f"{where}: row {row + 1}: {told}")


def without_units(
    columns: dict[str, Floats], where: str
) -> tuple[dict[str, Floats], Floats | None]:
    """Columns in the bodies' own units, and their unit of time in seconds where it is known."""
    of, made = dict(columns), dict[str, tuple[str, Floats]]()
    if "height_m" in of:
        of["second"] = np.sqrt(of["height_m"] / of.get("gravity_m_s2", si.GRAVITY))
    if of.keys() & {*BODY[2:], "ixy_kg_m2", "axes_angle_deg"}:
        require(BODY, of, where, f"a body in SI units has {' '.join(BODY)}")
        full = {name: np.full(len(of["mass_kg"]), value) for name, value in OPTIONAL.items()} | of
        tensor = np.stack([full[f"i{x}_kg_m2"] for x in ("xx", "yy", "zz", "xy")], axis=1)
        radii = np.stack([full["r1_m"], full["r2_m"]], axis=1)
        angle = np.radians(full["axes_angle_deg"])
        found = si.parameters(full["mass_kg"], tensor, full["height_m"], radii, angle)
        made |= {name: ("the body in SI units", values) for name, values in found.items()}
    for name in (name for name in UNITS if name in of):
        plain, needed, convert = UNITS[name]
        require(needed, of, where, f"{name} needs it")
        made[plain] = name, convert(of[name], of)
    for plain, (name, values) in made.items():
        # The one without units counts, so that an output table gives the same runs again.
        own = columns.setdefault(plain, values)
        wrong = ~np.isclose(values, own, rtol=SLACK, atol=0, equal_nan=True)
        told = f"{plain} is {{:g}}, and {name} comes to {{:g}}; keep one of the two"
        refuse_row(where, wrong, told, own, values)
    return columns, of.get("second")


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
    if series.dtype.kind in "iuf":
        whole = series.dtype.kind in "iu"
        return (I64, series.to_numpy(dtype=np.int64)) if whole else (F64, series.to_numpy(float))
    words = series.astype(object).where(series.notna(), None).to_numpy()
    given = [word for word in words if word is not None]
    if not all(isinstance(word, str) for word in given):
        return None
    # A CSV is text.  Leading zeros belong to a name.
    whole = all(re.fullmatch(r"[+-]?\d{1,18}", word) for word in given)
    named = whole and any(re.fullmatch(r"[+-]?0\d+", word) for word in given)
    numbers = pd.to_numeric(series, errors="coerce").to_numpy(dtype=float)
    if not given or named or np.isnan(numbers[series.notna().to_numpy()]).any():
        return TEXT, words
    if whole:
        return I64, np.array([None if word is None else int(word) for word in words], object)
    return F64, numbers
