"""Lengths of time as people write them."""

from __future__ import annotations

import re

_UNITS = {"d": 86400.0, "h": 3600.0, "m": 60.0, "min": 60.0, "s": 1.0}
_PART = r"(\d+(?:\.\d+)?)\s*(d|h|min|m|s)"


def seconds_of(text: str) -> float:
    """Return the seconds of ``3h50m``, ``90s``, ``1.5h`` or ``2d 4h``; else raise a ValueError."""
    if not re.fullmatch(rf"\s*(?:{_PART}\s*)+", text):
        raise ValueError("is no length of time; write it with units, as in 3h50m, 90s or 2d")
    seconds = sum(float(number) * _UNITS[unit] for number, unit in re.findall(_PART, text))
    if not 0 < seconds < 1e10:
        raise ValueError("is out of range; give more than nothing")
    return seconds


def clock(seconds: float) -> str:
    """Return seconds as m:ss or h:mm:ss."""
    hours, rest = divmod(round(seconds), 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}" if hours else f"{rest // 60}:{rest % 60:02d}"
