"""Measured data: the angle or spin of a stone over time, or the times of reversals."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rattlesweep.analysis.fit.programs import PROGRAMS, from_export
from rattlesweep.analysis.fit.spreadsheets import Sheet, open_sheet
from rattlesweep.arrays import Flags, Floats, Places
from rattlesweep.words.errors import ConfigError, one_line
from rattlesweep.words.units import quantity, split

if TYPE_CHECKING:
    import pandas as pd

    from rattlesweep.physics.si import Units

# Measured quantities by the beginning of their columns' names; "spin" is the rate of
# the angle, "n" the spin u . omega, "gyro" the rate about the body's own upward axis.
_KINDS = {
    "angle": "angle",
    "spin": "spin",
    "n": "spin",
    "gyro": "spin",
    "reversal": "time",
}
# Columns without a unit in their names, as `rattlesweep trajectory` writes them.
BARE = {"t": "sqrt(a/g)", "n": "sqrt(g/a)"}
_NEEDED = "t_s and one of angle_deg, spin_rpm, n_rpm, or reversal_s alone"
# Half turns are removed by extrapolating the next angle: with the spin over this many
# rows before it, from each of the last few of them.
MEMORY = 20
NEAR = 3
# The launch is judged by the first rows: one in 50 of all, and at least 10.
FIRST_SHARE = 50
FEWEST_FIRST = 10
# A film of a tap begins with less than this share of its largest spin.
STILL_SHARE = 0.3
# Angle between rows, above which half turns are counted by the spin of the launch.
# Above a quarter turn, the nearest angle of the axis is the wrong one.
FAST = 0.4 * math.pi
ROUGH_NOISE = 0.01  # of the largest time of a reversal, before the first search


class Unit(NamedTuple):
    """A unit of a measured column, and its size in the units of the body."""

    name: str
    size: float


class FilmColumn(NamedTuple):
    """A column of a table that is a measured quantity."""

    name: str
    kind: str  # "t" or one of `_KINDS`
    unit: Unit


@dataclass(frozen=True)
class Film:
    """Measured data in the units of the body, NaN where a value is missing."""

    source: str  # begins the messages about the data
    kind: str  # one of `_KINDS`
    t: Floats  # since the first row; of reversals: since the launch
    value: Floats
    t_column: FilmColumn  # of reversals: the same as the next
    value_column: FilmColumn
    # Standard errors of the values, None if they are not known.
    error: Floats | None = None
    # What of the data was left out, in sentences.
    notes: tuple[str, ...] = ()

    @property
    def known(self) -> Flags:
        """The rows that have a value."""
        return np.isfinite(self.value)

    def until(self, share: float) -> Film:
        """Return the data up to a share of their time."""
        early = self.t <= share * self.t[-1]
        error = self.error
        if error is not None:
            error = error[early]
        return replace(self, t=self.t[early], value=self.value[early], error=error)

    @property
    def size(self) -> float:
        """The largest modulus of a value."""
        return float(np.nanmax(np.abs(self.value)))

    @property
    def largest_spin(self) -> float:
        """Modulus of the largest spin; of reversals, which have none, the last time."""
        if self.kind != "angle":
            return self.size
        value = self.value[self.known]
        t = self.t[self.known]
        # Over several rows, noise counts less.
        apart = min(FEWEST_FIRST, len(t) - 1)
        return float(
            np.max(np.abs(value[apart:] - value[:-apart]) / (t[apart:] - t[:-apart]))
        )

    @property
    def spin_size(self) -> float:
        """The size of the spin, also of a film that begins without spin."""
        return max(abs(self.first_spin), STILL_SHARE * self.largest_spin)

    @property
    def turn_a_row(self) -> float:
        """The angle by which the first rows are usually apart."""
        return abs(self.first_spin) * float(np.median(np.diff(self.t)))

    @property
    def rough_noise(self) -> float:
        """Size of noise from neighbouring rows, or a first guess for reversals."""
        if self.kind == "reversal" or self.known.sum() < FEWEST_FIRST:
            return ROUGH_NOISE * self.size
        sizes = []
        for order in (2, 3, 4):
            bends = np.abs(np.diff(self.value[self.known], order))
            # The median of |x| of a normal variable, and the variance of a difference.
            variance = math.comb(2 * order, order)
            sizes.append(float(np.median(bends)) / 0.6745 / math.sqrt(variance))
        # Motion only adds to a difference, so the least of them has the least of it.
        return max(min(sizes), 1e-6 * self.size)

    @property
    def first_rows(self) -> Places:
        """The rows from which the launch is judged."""
        rows = np.flatnonzero(self.known)
        return rows[: max(FEWEST_FIRST, len(rows) // FIRST_SHARE)]

    @property
    def first_spin(self) -> float:
        """The spin of the first rows.  Reversals have none."""
        rows = self.first_rows
        if self.kind == "angle":
            return float(np.polyfit(self.t[rows], self.value[rows], 1)[0])
        return float(self.value[rows].mean())


def read_film(
    source: str | os.PathLike[str] | pd.DataFrame | Mapping[str, Sequence[float]],
    units: Units | None,
    error: float | str | None = None,
    n_i: float | None = None,
) -> Film:
    """Return measured data from a CSV or Parquet file, a table or columns by name.

    `units` are those of the body, None if its size is not known, and `error` is the
    standard error of all values, by default that of a column such as
    ``angle_error_deg``.  A spin `n_i` of the launch tells which half turns were lost if
    it turns the axis by more than `FAST` from row to row.  Raises a ConfigError if
    columns are missing, or if a time is no number or out of order.

    Exports of the programs of :data:`programs.FORMATS` are read as they are.
    """
    spin = None
    if n_i is not None and units is not None:
        spin = n_i / units.time
    sheet = from_export(open_sheet(source), spin)
    place = sheet.place
    columns = _measured_columns(sheet, units)
    values = dict(zip(columns, _numbers(sheet, [*columns.values()]), strict=True))
    kind = next(name for name in _KINDS if name in columns)
    value = values[kind]
    if not np.isfinite(value).any():
        problem = f"no row has a value of {columns[kind].name}"
        if not sheet.has_rows:
            problem += ", as it has a header and no rows"
        raise ConfigError(f"{place}: {problem}")
    errors = _errors(sheet, columns[kind], value, units, error)
    if kind == "reversal":
        # In the order of time, without the missing ones, which come last.
        order = np.argsort(value)[: np.isfinite(value).sum()]
        value = value[order]
        if errors is not None:
            errors = errors[order]
        if value[0] <= 0:
            first = f"{value[0] / columns[kind].unit.size:g}"
            raise ConfigError(
                f"{place}: {columns[kind].name} is {first}; the launch is at 0"
            )
        return Film(place, kind, value, value, columns[kind], columns[kind], errors)
    t = values["t"]
    _check_increasing(place, t, columns["t"])
    if len(t) < 2:
        raise ConfigError(f"{place}: it has one row; a fit needs more rows")
    t = t - t[0]
    if kind == "angle":
        spin = 0.0
        if n_i is not None and abs(n_i) * float(np.median(np.diff(t))) > FAST:
            spin = n_i
        value = unwrapped(t, value, spin)
    return Film(place, kind, t, value, columns["t"], columns[kind], errors)


def _measured_columns(sheet: Sheet, units: Units | None) -> dict[str, FilmColumn]:
    """Return the first column of each quantity; raise if some are missing."""
    columns: dict[str, FilmColumn] = {}
    for name in sheet.names:
        column = _measured_column(name, units)
        if column is not None:
            columns.setdefault(column.kind, column)
    kind = next((name for name in _KINDS if name in columns), None)
    if kind is None or (kind != "reversal" and "t" not in columns):
        names = one_line(", ".join(sheet.names), 100)
        advice = f"; exports of {', '.join(PROGRAMS)} are read as they are"
        if units is None:
            advice = "; the body has no size, so only t and n, or give it in SI units"
        raise ConfigError(
            f"{sheet.place}: {_NEEDED} are needed, and the columns are {names}{advice}"
        )
    return columns


def _measured_column(name: str, units: Units | None) -> FilmColumn | None:
    """Return the quantity and unit of a column, None if it is not a measured one."""
    if name in BARE:
        return FilmColumn(name, name, Unit(BARE[name], 1.0))
    # Without the size of a body, only angles can be told in its units.
    match = re.fullmatch(rf"(t|{'|'.join(_KINDS)})_(.+)", name)
    if match is None or (units is None and match[1] != "angle"):
        return None
    dimension = _KINDS.get(match[1], "time")
    unit = match[2].replace("_", "/")
    with suppress(ValueError):  # the end of the name is no unit
        size = quantity(f"1 {unit}", dimension)
        if units is not None and dimension == "spin":
            size *= units.time
        if units is not None and dimension == "time":
            size *= units.time**-1
        return FilmColumn(name, match[1], Unit(unit, size))
    return None


def _errors(
    sheet: Sheet,
    measured: FilmColumn,
    value: Floats,
    units: Units | None,
    error: float | str | None,
) -> Floats | None:
    """Return the standard errors of the values of a column, None if not known."""
    place = sheet.place
    prefix = f"{measured.kind}_error"
    names = [name for name in sheet.names if name.startswith(prefix)]
    if error is not None:
        if names:
            raise ConfigError(f"error: {place} has the column {names[0]}; keep one")
        return np.full(len(value), _error_of_all(error, measured, units))
    if not names:
        return None
    # The unit is at the end of both names: angle_error_deg has the unit of angle_deg.
    like = _measured_column(names[0].replace("_error", "", 1), units)
    if like is None or (like.name in BARE) != (measured.name in BARE):
        raise ConfigError(
            f"{place}: {names[0]} does not end in a unit; name the column "
            f"{measured.name.replace(measured.kind, prefix, 1)}"
        )
    (errors,) = _numbers(sheet, [like._replace(name=names[0])])
    for row in np.flatnonzero(np.isfinite(value) & ~(errors > 0))[:1]:
        problem = "has no finite value"
        if np.isfinite(errors[row]):
            problem = f"is {errors[row] / like.unit.size:g}"
        raise ConfigError(
            f"{place}: row {row + 1}: {names[0]} {problem}; give a standard error "
            "above zero"
        )
    return errors


def _error_of_all(
    error: float | str, measured: FilmColumn, units: Units | None
) -> float:
    """Return one standard error in units of the body.

    A number has the unit of the column, and a text its own.
    """
    number, unit = split(str(error))
    like: FilmColumn | None = measured
    if unit:
        like = _measured_column(f"{measured.kind}_{unit}", units)
    elif isinstance(error, str) and measured.name not in BARE:
        like = None
    if number is None or like is None or not 0 < number < math.inf:
        example = f"0.5 {measured.unit.name}" if measured.name not in BARE else "0.5"
        problem = f"is no standard error of {measured.name}"
        if number is None:
            problem = "is no number"
        elif not 0 < number < math.inf:
            problem = "is not above zero"
        elif not unit:
            problem = "has no unit"
        raise ConfigError(
            f"error: {one_line(str(error))} {problem}; give a standard error of "
            f"{measured.name}, as in {example}"
        )
    return number * like.unit.size


def _numbers(sheet: Sheet, columns: list[FilmColumn]) -> list[Floats]:
    """Return columns in the units of the body, NaN where one has no finite number."""
    places = []
    for column in columns:
        if sheet.names.count(column.name) > 1:
            raise ConfigError(
                f"{sheet.place}: it has {sheet.names.count(column.name)} columns "
                f"{column.name}; keep the one that is meant, or name the others "
                "differently"
            )
        places.append(sheet.names.index(column.name))
    return [
        np.where(np.isfinite(values), values, np.nan) * column.unit.size
        for values, column in zip(sheet.read(places), columns, strict=True)
    ]


def _check_increasing(place: str, t: Floats, column: FilmColumn) -> None:
    """Raise a ConfigError if a time is missing or does not follow the one before."""
    for row in np.flatnonzero(~np.isfinite(t) | (np.diff(t, prepend=-np.inf) <= 0))[:1]:
        problem = "has no finite value"
        if np.isfinite(t[row]):
            now = t[row] / column.unit.size
            before = t[row - 1] / column.unit.size
            problem = f"is {now:g} after {before:g}; times must increase"
        raise ConfigError(f"{place}: row {row + 1}: {column.name} {problem}")


def unwrapped(t: Floats, angle: Floats, spin: float = 0.0) -> Floats:
    """Remove jumps by half turns from the angle of an axis, which has no front.

    `spin` is a first guess of the rate, by which the second row is judged.
    """
    rows = np.flatnonzero(np.isfinite(angle))
    # Lists, since single numbers of an array are slow.
    times = t[rows].tolist()
    angles = angle[rows].tolist()
    for i in range(1, len(angles)):
        first = max(0, i - 1 - MEMORY)
        if i - 1 > first:
            spin = (angles[i - 1] - angles[first]) / (times[i - 1] - times[first])
        # The median of the last rows, of which one may be far off.
        expected = median(
            angles[near] + spin * (times[i] - times[near])
            for near in range(max(0, i - NEAR), i)
        )
        half_turns = round((expected - angles[i]) / math.pi)
        angles[i] += math.pi * half_turns
    continuous = angle.copy()
    continuous[rows] = angles
    return continuous
