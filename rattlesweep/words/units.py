"""Quantities with units as text: "12 mm", "2.1 kg cm^2" (by pint), and durations:
"3h50m".
"""

from __future__ import annotations

import math
import re
from functools import cache
from numbers import Real
from typing import Any, NamedTuple

from rattlesweep.words.common_units import COMMON
from rattlesweep.words.errors import ConfigError, one_line

# Kinds of quantities: the SI unit, and an example.
KINDS = {
    "mass": ("kg", "85 g"),
    "length": ("m", "12 mm"),
    "density": ("kg/m^3", "1.24 g/cm^3"),
    "moment of inertia": ("kg m^2", "2.1 kg cm^2"),
    "angle": ("rad", "1.5 deg"),
    "spin": ("rad/s", "60 rpm"),
    "frequency": ("rad/s", "25 Hz"),
    "time": ("s", "2.5 s"),
    "acceleration": ("m/s^2", "9.81 m/s^2"),
    "torque per spin": ("N m s", "1e-4 N m s"),
    "force per speed": ("N s/m", "50 N s/m"),
    "energy": ("J", "0.5 mJ"),
    "modulus": ("Pa", "3.5 GPa"),
}

NATURAL = {
    "spin": "sqrt(g/a)",
    "frequency": "sqrt(g/a)",
    "time": "sqrt(a/g)",
    "length": "a",
    "energy": "M g a",
    "moment of inertia": "M a^2",
    "torque per spin": "M a^2 sqrt(g/a)",
    "force per speed": "M sqrt(g/a)",
}
"""Units of the body that kinds of quantities are measured in."""

# Other spellings of the SI unit of a kind: pint counts the radian.
ALSO = {"torque per spin": "N m s/rad", "frequency": "Hz"}
# The units that a body or a launch is measured in, by pint's names; prefixes and
# plurals go with them.  Pint has a thousand more, such as the grain (gr), the pixel
# (px) and the short ton, which are slips of the pen here.
MEANT = (
    *("gram", "metric_ton", "pound", "ounce", "slug", "carat"),
    *("meter", "micron", "angstrom", "inch", "thou", "foot", "yard", "mile"),
    *("radian", "degree", "arcminute", "arcsecond", "turn", "grade"),
    *("second", "minute", "hour", "day", "week", "hertz"),
    *("revolutions_per_minute", "revolutions_per_second"),
    *("newton", "dyne", "force_pound", "force_kilogram", "force_gram"),
    *("joule", "erg", "electron_volt", "calorie", "watt", "pascal"),
    *("standard_gravity", "galileo"),
)

# A unit is not longer than this; pint reads a product of n factors n calls deep.
MOST_CHARACTERS = 100
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
# Letters that follow each other are one name, whatever comes after them.
_FACTOR = r"[*/·]?\s*[A-Za-zµμ°]++\s*(?:(?:\^|\*\*)?\s*(?:-?\d|[²³]))?\s*"
_SECONDS = {"d": 86400.0, "h": 3600.0, "m": 60.0, "min": 60.0, "s": 1.0}
_SPAN = r"(\d+(?:\.\d+)?)\s*(d|h|min|m|s)"


class InSI(float):
    """A number whose unit is known to be the SI unit of its kind."""


class Quantity(InSI):
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


class Natural(float):
    """A number in units of the body that was written with them, as ``0.1 sqrt(g/a)``.

    The text is kept.
    """

    text: str

    def __new__(cls, number: float, text: str) -> Natural:  # noqa: D102
        self = super().__new__(cls, number)
        self.text = " ".join(text.split())
        return self

    def __reduce__(self) -> tuple[type[Natural], tuple[float, str]]:
        return Natural, (float(self), self.text)


def natural_number(text: str, kind: str) -> Natural | None:
    """Return the number of a text such as ``0.1 sqrt(g/a)``, None if its unit differs.

    Raises a ValueError if the text ends in the unit of another kind of the body.
    """
    number, unit = split(text)
    if number is None:
        return None
    spelled = unit.replace(" ", "")
    if kind in NATURAL and spelled == NATURAL[kind].replace(" ", ""):
        return Natural(number, text)
    for other, name in NATURAL.items():
        if spelled == name.replace(" ", ""):
            example = KINDS[kind][1]
            raise ValueError(
                f"is {with_article(other)}; {with_article(kind)} is needed, such as "
                f"{example}"
            )
    return None


def natural(value: float, kind: str) -> float:
    """Return a result in units of the body as a number that says so.

    It is then an argument of a run of a body with a size, as it is.
    """
    if kind not in NATURAL:
        return value
    return Natural(value, f"{float(value)!r} {NATURAL[kind]}")


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
    found: list[float] = []
    for value, unit in zip(values, units, strict=True):
        size, base = _base(unit or units[-1], needed)
        _require_kind(base, kind, needed)
        found.append(InSI(value * (size * _turn(base, kind))))
    return found


def is_measured(value: object) -> bool:
    """Return whether a value is a quantity of Pint: numbers with a unit."""
    return hasattr(value, "to_base_units") and hasattr(value, "magnitude")


def in_si(value: Any, kind: str) -> Any:
    """Return the numbers of a quantity of Pint in SI units, or raise a ValueError.

    Without a kind, they are pure numbers.
    """
    size, base = _base_of(value)
    if kind:
        needed = f"{with_article(kind)} is needed, such as {KINDS[kind][1]}"
        _require_kind(base, kind, needed)
        size *= _turn(base, kind)
    elif base != _base_of_text("")[1]:
        raise ValueError(f"has the unit {value.units:D}; a pure number is needed")
    return value.magnitude * size


def quantity_text(value: Any) -> Any:
    """Return a quantity of Pint as configs have it: texts with units, or numbers."""
    size, base = _base_of(value)
    is_pure = base == _base_of_text("")[1]
    unit = f"{value.units:~D}"
    try:
        size /= _base(unit)[0]
    except ValueError:
        # Only pint can read its unit, so the SI unit of its kind stands for it.
        units = [si for si, _ in KINDS.values() if _base(si)[1] == base]
        if not units and not is_pure:
            problem = f"has the unit {value.units:D}, which no quantity here has"
            raise ValueError(problem) from None
        unit = next(iter(units), "")
    numbers = value.magnitude * size
    if hasattr(numbers, "tolist"):
        numbers = numbers.tolist()
    if is_pure:
        return numbers
    return _with_unit(numbers, unit)


def _with_unit(numbers: Any, unit: str) -> Any:
    if isinstance(numbers, list):
        return [_with_unit(number, unit) for number in numbers]
    return f"{float(numbers)!r} {unit}"


def _turn(base: str, kind: str) -> float:
    """Return the radians in what a unit of a frequency counts a second, 1 for others.

    Hertz are cycles.
    """
    if kind == "frequency" and base == _base("Hz")[1]:
        return 2.0 * math.pi
    return 1.0


def _require_kind(base: str, kind: str, needed: str) -> None:
    """Raise a ValueError if base units are not those of a kind."""
    units = [KINDS[kind][0]]
    if kind in ALSO:
        units.append(ALSO[kind])
    if base in [_base(unit)[1] for unit in units]:
        return
    others = (
        with_article(name) for name, (si, _) in KINDS.items() if _base(si)[1] == base
    )
    raise ValueError(f"is {next(others, 'another quantity')}; {needed}")


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


def require_unit(name: str, value: object, kind: str, of_size: bool = False) -> None:
    """Raise a ConfigError if a value of a body with a size is a number without a unit.

    A person who writes ``n_i: 60`` may mean rpm.  This is the rule of all doors:
    configs, stone files, the command line and Python.  Zero is the same in all units.

    Parameters
    ----------
    name : str
        How the message names the value.
    value : object
        A number, a text, or a list or an array of these.
    kind : str
        A key of `KINDS`.
    of_size : bool
        Whether it is a size of the body itself, which has no other unit than those of
        SI.
    """
    if isinstance(value, InSI | Natural):
        return
    if hasattr(value, "tolist") and not is_measured(value):
        value = value.tolist()
    if isinstance(value, list | tuple):
        for item in value:
            require_unit(name, item, kind, of_size)
    elif isinstance(value, Real) and value != 0:
        wrong = without_unit(float(value), kind, of_size)
        raise ConfigError(f"{name}: {value:g} {wrong}")


def without_unit(value: float, kind: str, of_size: bool = False) -> str:
    """Return what is wrong with a number without a unit, and what would be right."""
    sentence = (
        f"has no unit, and the body has a size; give {with_article(kind)} with its "
        f"unit, such as {KINDS[kind][1]}"
    )
    if kind in NATURAL and not of_size:
        sentence += f", or in units of the body, as in '{value:g} {NATURAL[kind]}'"
    return sentence


def with_article(noun: str) -> str:
    """Return a noun with "a" or "an"."""
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


@cache
def _base(unit: str, needed: str = "") -> tuple[float, str]:
    """Return the size of a unit in SI base units, and these units."""
    if unit in COMMON:
        return COMMON[unit]
    if len(unit) > MOST_CHARACTERS:
        raise ValueError(
            f"has a unit of {len(unit):,} characters, {one_line(unit, 30)}; {needed}"
        )
    if not re.fullmatch(f"({_FACTOR})+", unit):
        what = (
            f"the unit {unit}, which is not a product of units" if unit else "no unit"
        )
        raise ValueError(f"has {what}; {needed}")
    # "mm2" means "mm^2", but pint reads it as the name of a unit.
    spelled = re.sub(r"(?<=[A-Za-zµμ°])\s*(?=-?\d)", "^", unit.replace("°", "deg"))
    try:
        for name in re.findall(r"[^\W\d_]+", spelled):
            _require_meant(name)
        return _base_of_text(spelled)
    except (ValueError, TypeError, AttributeError) as error:
        reason = one_line(" ".join(str(error).split()), 200)
        raise ValueError(f"has the unit {unit}: {reason}; {needed}") from None


def _require_meant(name: str) -> None:
    """Raise a ValueError if pint reads the name of a unit as one that nobody means."""
    import pint  # as slow to import as the rest of the command line together

    readings = pint.application_registry.parse_unit_name(name)
    if readings and readings[0][1] not in MEANT:
        meaning = readings[0][1].replace("_", " ")
        raise ValueError(f"it would be read as {with_article(meaning)}")


def _base_of(value: Any) -> tuple[float, str]:
    """Return the size of the unit of a quantity of Pint, and its base units."""
    try:
        # The registry of the quantity may have another system of units than SI.
        return _base_of_text(f"{value.units:D}")
    except (ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"has the unit {value.units:D}: {error}") from None


def _base_of_text(unit: str) -> tuple[float, str]:
    """Return the size of a unit that pint reads, in SI base units, and these units."""
    import pint

    try:
        one = pint.application_registry.Quantity(1.0, unit).to_base_units()
    except pint.PintError as error:
        raise ValueError(str(error)) from None
    return float(one.magnitude), f"{one.units:D}"


def readable_unit(size: float, unit: str) -> tuple[float, str]:
    """Return the factor to a unit in which people write a quantity in SI units.

    Lengths below 1 mm are in um: 250 um, and not 0.00025 m.
    """
    if unit != "m" or not 0 < abs(size) < 1e-3:
        return 1.0, unit
    if abs(size) < 1e-6:
        return 1e9, "nm"
    return 1e6, "um"
