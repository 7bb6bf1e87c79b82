"""Tables as programs export them: marks and angles of a film, the gyroscope of a phone.

:data:`FORMATS` is the table of the formats: which columns tell a program, what they
mean, and in which unit.  An export becomes the columns that a film is read from:
``t_s`` and one of ``angle_deg`` and ``gyro_rad_s``.  What it leaves open is a
ConfigError that asks for it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rattlesweep.analysis.fit.spreadsheets import FrameSheet, Sheet
from rattlesweep.arrays import Floats
from rattlesweep.words.errors import ConfigError, one_line

# Units of rates in rad/s, and of times in s.
_RATES = {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180, "dps": math.pi / 180}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
# A time without a unit is in the first one by which rows are not further apart.
FURTHEST = 0.5  # seconds
# A mark's angle is in radians if it agrees with x and y within so much, in radians.
AGREEING = 0.05
FOLDED = 0.8 * math.tau  # a step of radians that is a full turn
# The spin of an angle may be off that of the launch by this factor.
ABOUT = 3.0
STANDARD_GRAVITY = 9.81
# x, y and z of an acceleration at rest are as long as this share of gravity, or less.
NEAR_GRAVITY = 0.1
UNCLEAR = re.compile(r"acc|grav|magn|orient", re.IGNORECASE)


@dataclass(frozen=True)
class Format:
    """How the table of a program is recognised, and what its columns mean.

    `time` and `values` match the names of columns, whatever their case.  Groups of them
    are `unit`, of what the name itself says, and `axis`; a mark has a `mark` or a
    `number`.
    """

    program: str
    read: Callable[[_Found, float | None], FrameSheet]
    time: str
    values: str
    unit: str | None = None
    """Unit of the values where their names have none; without one, it is asked for."""


@dataclass(frozen=True)
class _Found:
    """A table, and those of its columns that a format has recognised."""

    format: Format
    sheet: Sheet
    times: dict[int, re.Match[str]]
    values: dict[int, re.Match[str]]

    @property
    def listed(self) -> str:
        """The names of all columns, for messages."""
        return one_line(", ".join(self.sheet.names), 100)

    def error(self, sentence: str) -> ConfigError:
        """Return the error about the table."""
        return ConfigError(f"{self.sheet.place}: {sentence}")

    def read(self, columns: list[int]) -> tuple[Floats, list[Floats]]:
        """Return the times in s, from the first one on, and some columns."""
        column, match = next(iter(self.times.items()))
        times, *values = self.sheet.read([column, *columns])
        # The first time may be that since 1970.
        times = times - times[:1]
        unit = (match.groupdict().get("unit") or "").lower().replace("sec", "s")
        if unit:
            return _TIMES[unit] * times, values
        steps = np.diff(times)
        step = float(np.median(steps)) if len(steps) else 0.0
        if self.format.read is not _rates and len(steps) and (steps == 1.0).all():
            raise self.error(
                f"does {self.sheet.names[column]} count frames or milliseconds? Name "
                "it t_ms, or give the times in seconds as t_s"
            )
        size = next((size for size in _TIMES.values() if step * size <= FURTHEST), 1.0)
        return size * times, values

    def table(self, times: Floats, name: str, values: Floats) -> FrameSheet:
        """Return a table of times in seconds and one column of values."""
        import pandas as pd

        return FrameSheet(self.sheet.place, pd.DataFrame({"t_s": times, name: values}))


def from_export(sheet: Sheet, n_i: float | None = None) -> Sheet:
    """Return the table that a film is read from; a table of other names as it is.

    `n_i` is the spin of the launch in rad/s, None if it is not known.
    """
    if any(_OWN.fullmatch(name) for name in sheet.names):
        return sheet
    for each in FORMATS:
        values = _matches(each.values, sheet.names)
        times = _matches(each.time, sheet.names)
        if not values or not (times or each.program == _ANY):
            continue
        found = _Found(each, sheet, times, values)
        if not sheet.has_rows:
            raise found.error("it has a header and no rows; export it with its rows")
        if not times:
            raise found.error(
                f'a gyroscope needs a column "Time (s)", and the columns are '
                f"{found.listed}"
            )
        return each.read(found, n_i)
    return sheet


def _matches(pattern: str, names: list[str]) -> dict[int, re.Match[str]]:
    """Return the columns whose names match a pattern."""
    compiled = re.compile(pattern, re.IGNORECASE)
    return {
        column: match
        for column, name in enumerate(names)
        if (match := compiled.fullmatch(name))
    }


def _rates(found: _Found, n_i: float | None) -> FrameSheet:
    """Return the table of a phone that turns with the stone, its screen up."""
    names = found.sheet.names
    columns: dict[str, int] = {}
    for column, match in found.values.items():
        axis = match["axis"].lower()
        if axis in columns:
            raise found.error(
                f"{names[columns[axis]]} and {names[column]} are rates about one axis; "
                "keep the one of the gyroscope on the stone"
            )
        columns[axis] = column
    times, rates = found.read([*columns.values()])
    if found.format.program == "Sensor Logger":
        _refuse_accelerations(found, rates)
    sizes = {}
    for (axis, column), rate in zip(columns.items(), rates, strict=True):
        unit = found.values[column].groupdict().get("unit") or found.format.unit
        if unit is None:
            raise found.error(
                f"is {names[column]} in rad/s or in degrees a second? Name the column "
                f'"Gyroscope {axis} (rad/s)" or "Gyroscope {axis} (deg/s)"'
            )
        sizes[axis] = _RATES[unit.lower()] * rate
    means = {axis: float(np.nanmean(np.abs(rate))) for axis, rate in sizes.items()}
    largest = max(means, key=lambda axis: means[axis])
    if largest != "z":
        raise found.error(
            f"the phone turned mostly about its {largest} axis, and its z axis, across "
            "the screen, has to be that of the spin; lay the phone flat on the stone"
        )
    return found.table(times, "gyro_rad_s", sizes["z"])


def _refuse_accelerations(found: _Found, columns: list[Floats]) -> None:
    """Raise if x, y and z of a table are no rates by its name or by their length."""
    length = np.sqrt(np.sum(np.square(columns), axis=0))
    off = float(np.nanmax(np.abs(length - STANDARD_GRAVITY)))
    name = found.sheet.place.replace("\\", "/").rpartition("/")[2]
    if UNCLEAR.search(name) or off < NEAR_GRAVITY * STANDARD_GRAVITY:
        raise found.error(
            "x, y and z look like an acceleration or a magnetic field; give "
            "Gyroscope.csv"
        )


def _unclear(found: _Found, n_i: float | None) -> FrameSheet:
    """Raise the question what x, y and z are."""
    raise found.error(
        f"are {found.listed} the rates of a gyroscope? If so, name them as in "
        '"Time (s)" and "Gyroscope z (rad/s)"'
    )


def _angle_of_mark(found: _Found, n_i: float | None) -> FrameSheet:
    """Return the table of the angle of a mark, seen from the origin."""
    names = found.sheet.names
    if len(found.values) > 1:
        listed = one_line(", ".join(names[column] for column in found.values), 80)
        raise found.error(
            f"it has {len(found.values)} angles ({listed}), and one is needed; export "
            "the mark at an end of the long axis alone"
        )
    (column,) = found.values
    places = [names.index(axis) for axis in ("x", "y") if names.count(axis) == 1]
    times, (angle, *place) = found.read([column, *places])
    return found.table(
        times, "angle_deg", np.degrees(_in_radians(found, times, angle, place, n_i))
    )


def _in_radians(
    found: _Found, times: Floats, angle: Floats, place: list[Floats], n_i: float | None
) -> Floats:
    """Return an angle in radians, from whichever of two units it is in.

    `place` are x and y of the mark, if they are known.
    """
    known = angle[np.isfinite(angle)]
    degrees = np.radians(angle)
    if len(place) == 2:
        x, y = place
        # Of the two units, the one that agrees with the place of the mark.
        for candidate in (degrees, angle):
            off = np.remainder(candidate - np.arctan2(y, x) + math.pi, math.tau)
            if np.nanmedian(np.abs(off - math.pi)) < AGREEING:
                return candidate
    largest = float(np.abs(known).max()) if len(known) else 0.0
    step = float(np.abs(np.diff(known)).max()) if len(known) > 1 else 0.0
    if step > FOLDED and largest < 1.01 * math.tau:
        return angle
    if step > math.degrees(FOLDED) and largest < 1.01 * 360:
        return degrees
    rates = np.diff(angle) / np.diff(times)
    first = float(np.nanmedian(np.abs(rates[:10]))) if len(rates) else 0.0
    if n_i:
        # The spin of the launch is far nearer to one of the two.
        for candidate, size in ((degrees, math.pi / 180), (angle, 1.0)):
            if 1 / ABOUT < size * first / abs(n_i) < ABOUT:
                return candidate
    (column,) = found.values
    raise found.error(
        f"is {found.sheet.names[column]} in degrees or in radians? Name the column "
        "angle_deg or angle_rad, and t t_s, or give n_i, whose size tells"
    )


def _angle_of_marks(found: _Found, n_i: float | None) -> FrameSheet:
    """Return the table of the direction from the first mark to the second one."""
    columns: dict[str, list[int]] = {"x": [], "y": []}
    in_pixels = False
    points_up = False
    groups = {column: match.groupdict() for column, match in found.values.items()}
    # Beside coordinates of Tracker's axes, those in the image say nothing new.
    has_axes = any(group.get("image") is None for group in groups.values())
    for column, group in groups.items():
        if has_axes and group.get("image") is not None:
            continue
        columns[group["axis"].lower()].append(column)
        unit = (group.get("unit") or group.get("image") or "").lower()
        in_pixels = in_pixels or unit.startswith("p")
        points_up = points_up or (unit != "" and not unit.startswith("p"))
    counts = len(columns["x"]), len(columns["y"])
    if counts == (1, 1):
        raise found.error(
            "x and y of one mark are no angle of the long axis; export a second mark "
            "at its other end too, or θr with the origin of the axes on the middle of "
            "the stone"
        )
    if counts != (2, 2):
        raise found.error(
            f"the angle needs x and y of two marks, and the columns are "
            f"{found.listed}; name them x1, y1, x2, y2"
        )
    # Tracker's own columns have no numbers, and its y axis points up.
    is_numbered = any(group.get("number") for group in groups.values())
    if is_numbered and not in_pixels and not points_up and not n_i:
        raise found.error(
            f"does {found.sheet.names[columns['y'][0]]} count up or down? Name the "
            "columns x1_px, y1_px, ... if they are pixels of an image, which count "
            "down, or x1_mm, y1_mm, ..., or give n_i, whose sign tells"
        )
    times, (x1, x2, y1, y2) = found.read([*columns["x"], *columns["y"]])
    angle = np.arctan2(y2 - y1, x2 - x1)
    if in_pixels:
        # Rows of an image count downward.
        angle = -angle
    return found.table(times, "angle_deg", np.degrees(angle))


# Names that are read as they are, of which gyro_z is none.
_OWN = re.compile(r"(?:angle|spin|reversal).*|n(?:_.*)?|gyro_(?![xyz](?:_.*)?$).*")
_UNIT = (
    r"[ _]?[(\[]?(?P<unit>rad(?=[/_]s)|deg(?=[/_]s)|°(?=/s)|dps)(?:[/_]s(?:ec)?)?[)\]]?"
)
_TIME_UNIT = r"(?P<unit>s|sec|ms|us|µs|μs|ns)"
_ANY = "any gyroscope"
_UNKNOWN = "x, y and z"
_ANY_TIME = (
    rf"(?:time|zeit|temps|tiempo|tempo|t|timestamp)(?: ?[(\[]{_TIME_UNIT}[)\]]"
    rf"|_{_TIME_UNIT.replace('?P<unit>', '')})?"
)
_GYROSCOPE = (
    r"(?:gyro\w*?|giro\w*?|rotation rate|rotationrate|drehrate|angular velocity)"
)
_PHYPHOX_TIME = r"(?:time|zeit|temps|tiempo|tempo|t)(?: \((?P<unit>s|ms)\))?"
_TRACKER_TIME = "t(?:_s)?"
# The angle of a mark; a system without Greek letters writes a question mark.
_ANGLE = r"(?:[θϑΘ?]|theta)(?:_?\{?r\}?)?"
# A coordinate of a mark, with its number if there are several, and its unit.
_PLACE = (
    r"(?P<image>pixel)?(?P<axis>[xy])_?(?P<number>[12]?)"
    r"(?:_(?P<unit>px|pixels?|mm|cm|m))?"
)

FORMATS = (
    Format("phyphox", _rates, _PHYPHOX_TIME, rf"{_GYROSCOPE} (?P<axis>[xyz]){_UNIT}"),
    # Experiments of one's own, and the first versions, which wrote no unit of rad/s.
    Format("phyphox", _rates, _PHYPHOX_TIME, rf"(?P<axis>[xyz]){_UNIT}"),
    Format("phyphox", _rates, _PHYPHOX_TIME, r"gyroscope (?P<axis>[xyz])", "rad"),
    Format("Sensor Logger", _rates, "seconds_elapsed", r"(?P<axis>[xyz])", "rad"),
    Format(
        "Sensor Logger",
        _rates,
        "seconds_elapsed",
        r"rotationRate(?P<axis>[xyz])",
        "rad",
    ),
    Format("Physics Toolbox", _rates, "time", r"w(?P<axis>[xyz])", "rad"),
    Format(
        "AndroSensor",
        _rates,
        r"time since start in (?P<unit>ms)",
        rf"gyroscope (?P<axis>[xyz]){_UNIT}",
    ),
    Format(
        "SensorLog",
        _rates,
        r"gyroTimestamp_sinceReboot\((?P<unit>s)\)",
        rf"gyroRotation(?P<axis>[xyz]){_UNIT}",
    ),
    Format(
        "SensorLog",
        _rates,
        r"motionTimestamp_sinceReboot\((?P<unit>s)\)",
        rf"motionRotationRate(?P<axis>[xyz]){_UNIT}",
    ),
    Format(_ANY, _rates, _ANY_TIME, rf"{_GYROSCOPE}[ _.]?(?P<axis>[xyz])(?:{_UNIT})?"),
    Format("Kinovea", _angle_of_marks, "time", r"(?P<mark>.+)/(?P<axis>[xy])"),
    Format("Tracker", _angle_of_mark, _TRACKER_TIME, _ANGLE),
    Format(_UNKNOWN, _unclear, _ANY_TIME, r"(?P<axis>z)"),
    Format("Tracker", _angle_of_marks, _TRACKER_TIME, _PLACE),
)
"""The formats, in the order in which they are tried."""
PROGRAMS = sorted({each.program for each in FORMATS} - {_ANY, _UNKNOWN}, key=str.lower)
"""The programs whose files are read as they are."""
