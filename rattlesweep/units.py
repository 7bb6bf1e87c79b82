"""Quantities with units as text: "12 mm", "2.1 kg cm^2" (by pint), and durations:
"3h50m".
"""

from __future__ import annotations

import math
import re
from functools import cache
from numbers import Real
from typing import NamedTuple

from rattlesweep.errors import ConfigError

# Kinds of quantities: the SI unit, and an example.
KINDS = {
    "mass": ("kg", "85 g"),
    "length": ("m", "12 mm"),
    "moment of inertia": ("kg m^2", "2.1 kg cm^2"),
    "angle": ("rad", "1.5 deg"),
    "spin": ("rad/s", "60 rpm"),
    "time": ("s", "2.5 s"),
    "acceleration": ("m/s^2", "9.81 m/s^2"),
    "torque per spin": ("N m s", "1e-4 N m s"),
    "energy": ("J", "0.5 mJ"),
}

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_FACTOR = r"[*/·]?\s*[A-Za-zµμ°]+\s*(?:(?:\^|\*\*)?\s*(?:-?\d|[²³]))?\s*"
_SECONDS = {"d": 86400.0, "h": 3600.0, "m": 60.0, "min": 60.0, "s": 1.0}
_SPAN = r"(\d+(?:\.\d+)?)\s*(d|h|min|m|s)"


class Quantity(float):
    """A number in SI units that keeps the text it was read from, such as ``60 rpm``."""

    text: str
    kind: str

    def __new__(cls, text: str, kind: str) -> Quantity:  # noqa: D102
        self = super().__new__(cls, quantity(text, kind))
        self.text = " ".join(text.split())
        self.kind = kind
        return self

    def __reduce__(self) -> tuple[type[Quantity], tuple[str, str]]:
        return Quantity, (self.text, self.kind)


class Setting(NamedTuple):
    """A number of a config: in units of the bodies, in SI units, or both if known."""

    natural: float | None = None
    si: Quantity | None = None


def quantity(text: str, kind: str) -> float:
    """Return a text such as ``12 mm`` in SI units, or raise a ValueError with an
    example.
    """
    return quantities(text, kind, 1)[0]


def quantities(text: str, kind: str, *counts: int) -> list[float]:
    """Return the numbers of a list such as ``2,16,17 kg cm^2``, of one of the lengths
    `counts`.
    """
    needed = f"{with_article(kind)} is needed, such as {KINDS[kind][1]}"
    if counts == (1,) and with_point(text):
        raise ValueError(f"has a decimal comma; write {with_point(text)}")
    values, units = zip(*map(split, text.split(",")), strict=True)
    if None in values:
        raise ValueError(f"is not a number with a unit; {needed}")
    if len(values) not in counts:
        raise ValueError(
            f"has {len(values)} numbers, not {' or '.join(map(str, counts))}"
        )
    found = []
    for value, unit in zip(values, units, strict=True):
        size, base = _base(unit or units[-1], needed)
        if base != _base(KINDS[kind][0])[1]:
            others = (
                with_article(name)
                for name, (si, _) in KINDS.items()
                if _base(si)[1] == base
            )
            raise ValueError(f"is {next(others, 'another quantity')}; {needed}")
        found.append(value * size)
    return found


def with_point(text: str) -> str | None:
    """Return a number with a decimal comma, and its unit, with a point; else None."""
    match = re.fullmatch(
        r"\s*([+-]?\d*),(\d+(?:[eE][+-]?\d+)?(?:\s*[^\s\d,].*)?)", text
    )
    if match is None:
        return None
    return f"{match[1] or 0}.{match[2]}"


def separate_error(text: str) -> tuple[str, str] | None:
    """Return the value and the standard error in a text such as ``60 +- 1 g``.

    Each gets its unit, and the unit of one is that of the other.  None if the text has
    no error; raises a ValueError if value or error cannot be read.
    """
    halves = re.split(r"\+-|\+/-|±", text)
    if len(halves) == 1:
        return None
    for half in halves:
        if with_point(half):
            raise ValueError(f"has a decimal comma; write {with_point(half)}")
    value, unit = split(halves[0])
    error, unit_of_error = split(halves[1])
    if len(halves) > 2 or value is None or error is None:
        raise ValueError("is not a value with its error; write it as in 60 +- 1 g")
    if not 0 < error < math.inf:
        raise ValueError(f"has the error {error:g}; a standard error is above zero")
    unit = unit or unit_of_error
    unit_of_error = unit_of_error or unit
    return f"{value!r} {unit}".strip(), f"{error!r} {unit_of_error}".strip()


def split(text: str) -> tuple[float | None, str]:
    """Return the number that a text begins with, None if there is none, and the
    rest.
    """
    found = re.fullmatch(rf"\s*({_NUMBER})\s*(.*?)\s*", text)
    return (float(found[1]), found[2]) if found else (None, "")


def seconds_of(text: str) -> float:
    """Return the seconds of ``3h50m``, ``90s``, ``1.5h`` or ``2d 4h``; else raise a
    ValueError.
    """
    if not re.fullmatch(rf"\s*(?:{_SPAN}\s*)+", text):
        raise ValueError(
            "is not a duration; write it with units, as in 3h50m, 90s or 2d"
        )
    seconds = sum(
        float(number) * _SECONDS[unit] for number, unit in re.findall(_SPAN, text)
    )
    if not 0 < seconds < 1e10:
        raise ValueError("is out of range; give a time above zero and below 1e10 s")
    return seconds


def require_unit(name: str, value: object, kind: str) -> None:
    """Raise a ConfigError if a value is a number without a unit, or has such numbers.

    Zero is the same in all units.
    """
    if isinstance(value, list | tuple):
        for item in value:
            require_unit(name, item, kind)
    elif isinstance(value, Real) and value != 0:
        raise ConfigError(
            f"{name}: {value:g} has no unit, and the body has a size; give "
            f"{with_article(kind)} with its unit, such as {KINDS[kind][1]}"
        )


def with_article(noun: str) -> str:
    """Return a noun with "a" or "an"."""
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


@cache
def _base(unit: str, needed: str = "") -> tuple[float, str]:
    """Return the size of a unit in SI base units, and these units."""
    if not re.fullmatch(f"({_FACTOR})+", unit):
        what = (
            f"the unit {unit}, which is not a product of units" if unit else "no unit"
        )
        raise ValueError(f"has {what}; {needed}")
    import pint  # as slow to import as the rest of the command line together

    # "mm2" means "mm^2", but pint reads it as the name of a unit.
    spelled = re.sub(r"(?<=[A-Za-zµμ°])\s*(?=-?\d)", "^", unit.replace("°", "deg"))
    try:
        base = pint.application_registry.Quantity(1.0, spelled).to_base_units()
    except (pint.PintError, ValueError, TypeError, AttributeError) as error:
        raise ValueError(
            f"has the unit {unit}: {' '.join(str(error).split())}; {needed}"
        ) from None
    return float(base.magnitude), str(base.units)
