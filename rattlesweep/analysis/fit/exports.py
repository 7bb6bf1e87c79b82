"""Tables as programs export them: Tracker's marks and angles, a phone's gyroscope.

An export becomes the columns that a film is read from: ``t_s`` and one of ``angle_deg``
and ``gyro_rad_s``.  What it leaves open is a ConfigError that asks for it.

Tracker writes a line with the names of the marks above the columns ``t``, ``x``, ``y``
and, if asked, ``θ_{r}``, the angle of a mark seen from the origin; times are in
seconds.  phyphox writes ``Time (s)`` and ``Gyroscope z (rad/s)``.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, one_line

if TYPE_CHECKING:
    import pandas as pd

# The angle of a mark; a system without Greek letters writes a question mark.
_ANGLE = re.compile(r"(?:[θϑΘ?]|theta)(?:_?\{?r\}?)?", re.IGNORECASE)
# A coordinate of a mark, with its number if there are several, and its unit.
_PLACE = re.compile(r"(pixel)?([xy])_?([12]?)(?:_(px|pixels?|mm|cm|m))?", re.IGNORECASE)
PHONE_TIME = re.compile(r"(?:time|zeit|temps|tiempo|tempo|t) \((s|ms)\)", re.IGNORECASE)
GYROSCOPE = re.compile(
    r"(?:gyro\w*|rotation rate|drehrate|angular velocity) ([xyz]) \((rad|deg|°)/s\)",
    re.IGNORECASE,
)
# A mark's angle is in radians if it agrees with x and y within so much, in radians.
AGREEING = 0.05
FOLDED = 0.8 * math.tau  # a step of radians that is a full turn


def from_export(
    place: str, frame: pd.DataFrame, n_i: float | None = None
) -> pd.DataFrame:
    """Return the table that a film is read from; a table of other names as it is.

    `n_i` is the spin of the launch, None if it is not known; messages begin with
    `place`.
    """
    names = [str(name).strip() for name in frame]
    if any(GYROSCOPE.fullmatch(name) for name in names):
        return _from_phone(place, frame, names)
    marks = [match for name in names if (match := _PLACE.fullmatch(name))]
    angles = [row for row, name in enumerate(names) if _ANGLE.fullmatch(name)]
    if "t" not in names and "t_s" not in names:
        return frame
    if not angles and not marks:
        return frame
    if any(name.startswith(("angle", "spin", "n_")) or name == "n" for name in names):
        return frame
    if len(angles) > 1:
        raise ConfigError(
            f"{place}: it has {len(angles)} angles ({_listed(names, angles)}), and one "
            "is needed; export the mark at an end of the long axis alone"
        )
    if angles:
        angle = _angle_of_mark(place, frame, names, angles[0])
    else:
        angle = _angle_of_marks(place, frame, names, n_i)
    return _table(place, frame, names, "angle_deg", np.degrees(angle))


def _listed(names: list[str], rows: list[int]) -> str:
    return one_line(", ".join(names[row] for row in rows), 80)


def _cells(place: str, frame: pd.DataFrame, names: list[str], column: int) -> Floats:
    """Return a column as numbers, NaN where a cell is empty."""
    import pandas as pd

    cells = frame.iloc[:, column]
    numbers = pd.to_numeric(cells, errors="coerce")
    for row in np.flatnonzero(numbers.isna() & cells.notna())[:1]:
        cell = one_line(str(cells.iloc[row]), 40)
        raise ConfigError(
            f"{place}: row {row + 1}: {names[column]} is {cell}, not a number"
        )
    values: Floats = numbers.to_numpy(float)
    return values


def _table(
    place: str,
    frame: pd.DataFrame,
    names: list[str],
    column: str,
    values: Floats,
) -> pd.DataFrame:
    """Return a table of times in seconds and one column of values."""
    import pandas as pd

    # In the files of these programs, a column t is in seconds.
    times = names.index("t_s" if "t_s" in names else "t")
    return pd.DataFrame({"t_s": _cells(place, frame, names, times), column: values})


def _from_phone(place: str, frame: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """Return the table of a phone that turns with the stone, its screen up."""
    import pandas as pd

    times = [row for row, name in enumerate(names) if PHONE_TIME.fullmatch(name)]
    if not times:
        listed = one_line(", ".join(names), 100)
        raise ConfigError(
            f'{place}: a gyroscope needs a column "Time (s)", and the columns are '
            f"{listed}"
        )
    sizes = {}
    for row, name in enumerate(names):
        match = GYROSCOPE.fullmatch(name)
        if match is not None:
            unit = 1.0
            if match[2].lower() != "rad":
                unit = math.pi / 180
            sizes[match[1].lower()] = unit * _cells(place, frame, names, row)
    means = {axis: float(np.nanmean(np.abs(rates))) for axis, rates in sizes.items()}
    largest = max(means, key=lambda axis: means[axis])
    if largest != "z":
        raise ConfigError(
            f"{place}: the phone turned mostly about its {largest} axis, and its z "
            "axis, across the screen, has to be that of the spin; lay the phone flat "
            "on the stone"
        )
    time_match = PHONE_TIME.fullmatch(names[times[0]])
    assert time_match is not None
    return pd.DataFrame(
        {
            f"t_{time_match[1].lower()}": _cells(place, frame, names, times[0]),
            "gyro_rad_s": sizes["z"],
        }
    )


def _angle_of_mark(
    place: str, frame: pd.DataFrame, names: list[str], column: int
) -> Floats:
    """Return the angle of a mark seen from the origin, in radians."""
    angle = _cells(place, frame, names, column)
    known = angle[np.isfinite(angle)]
    degrees = np.radians(angle)
    if len(known) and np.abs(known).max() > 1.01 * math.tau:
        return degrees
    if names.count("x") == 1 and names.count("y") == 1:
        x = _cells(place, frame, names, names.index("x"))
        y = _cells(place, frame, names, names.index("y"))
        # Of the two units, the one that agrees with the place of the mark.
        for candidate in (degrees, angle):
            off = np.remainder(candidate - np.arctan2(y, x) + math.pi, math.tau)
            if np.nanmedian(np.abs(off - math.pi)) < AGREEING:
                return candidate
    if len(known) > 1 and np.abs(np.diff(known)).max() > FOLDED:
        return angle
    raise ConfigError(
        f"{place}: is {names[column]} in degrees or in radians? Name the column "
        "angle_deg or angle_rad, and t t_s"
    )


def _angle_of_marks(
    place: str, frame: pd.DataFrame, names: list[str], n_i: float | None
) -> Floats:
    """Return the direction from the first mark to the second one, in radians."""
    columns: dict[str, list[int]] = {"x": [], "y": []}
    in_pixels = False
    points_up = False
    matches = [_PLACE.fullmatch(name) for name in names]
    # Beside coordinates of Tracker's axes, those in the image say nothing new.
    has_axes = any(match is not None and match[1] is None for match in matches)
    for row, match in enumerate(matches):
        if match is None or (has_axes and match[1] is not None):
            continue
        columns[match[2].lower()].append(row)
        is_pixel = (match[4] or match[1] or "").lower().startswith("p")
        in_pixels = in_pixels or is_pixel
        points_up = points_up or (match[4] is not None and not is_pixel)
    counts = len(columns["x"]), len(columns["y"])
    if counts == (1, 1):
        raise ConfigError(
            f"{place}: x and y of one mark are no angle of the long axis; export a "
            "second mark at its other end too, or θr with the origin of the axes on "
            "the middle of the stone"
        )
    if counts != (2, 2):
        listed = one_line(", ".join(names), 100)
        raise ConfigError(
            f"{place}: the angle needs x and y of two marks, and the columns are "
            f"{listed}; name them x1, y1, x2, y2"
        )
    x = [_cells(place, frame, names, row) for row in columns["x"]]
    y = [_cells(place, frame, names, row) for row in columns["y"]]
    angle = np.arctan2(y[1] - y[0], x[1] - x[0])
    if in_pixels:
        # Rows of an image count downward.
        return -angle
    # Tracker's own columns have no numbers, and its y axis points up.
    is_numbered = any(match is not None and match[3] for match in matches)
    if is_numbered and not points_up and not n_i:
        raise ConfigError(
            f"{place}: does {names[columns['y'][0]]} count up or down? Name the "
            "columns x1_px, y1_px, ... if they are pixels of an image, which count "
            "down, or x1_mm, y1_mm, ..., or give n_i, whose sign tells"
        )
    return angle
