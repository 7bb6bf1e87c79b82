"""Quantities as people write them, such as "12 mm" or "2.1 kg cm^2", in SI units.

A table of a few units and not a library of all: a body has a mass, lengths, moments of inertia, an
angle, a spin and a time, and a library would be one more dependency for these.
"""

from __future__ import annotations

import math
import re

# Powers of kilogram, metre, second, radian.
Dimension = tuple[int, int, int, int]

_UNITS: dict[str, tuple[float, Dimension]] = {
    **{name: (size, (1, 0, 0, 0)) for name, size in {
        "kg": 1.0, "g": 1e-3, "mg": 1e-6, "lb": 0.45359237, "oz": 0.028349523125,
    }.items()},
    **{name: (size, (0, 1, 0, 0)) for name, size in {
        "m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048,
    }.items()},
    **{name: (size, (0, 0, 1, 0)) for name, size in {
        "s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0,
    }.items()},
    "rad": (1.0, (0, 0, 0, 1)),
    "deg": (math.pi / 180, (0, 0, 0, 1)),
    "turn": (2 * math.pi, (0, 0, 0, 1)),
    "rpm": (math.pi / 30, (0, 0, -1, 1)),
    "N": (1.0, (1, 1, -2, 0)),
}  # fmt: skip

KINDS: dict[str, tuple[Dimension, str]] = {
    "mass": ((1, 0, 0, 0), "85 g"),
    "length": ((0, 1, 0, 0), "12 mm"),
    "moment of inertia": ((1, 2, 0, 0), "2.1 kg cm^2"),
    "angle": ((0, 0, 0, 1), "1.5 deg"),
    "spin": ((0, 0, -1, 1), "60 rpm"),
    "time": ((0, 0, 1, 0), "2.5 s"),
    "acceleration": ((0, 1, -2, 0), "9.81 m/s^2"),
    "torque per spin": ((1, 2, -1, 0), "1e-4 N m s"),
}
"""What is asked for: its dimension, and an example."""


class SI(float):
    """A number in SI units, where one without is in a body's own."""


_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_FACTOR = re.compile(r"([*/·]?)\s*([A-Za-zµμ°]+)\s*(?:(?:\^|\*\*)?\s*(-?\d|[²³]))?\s*")
_SPELLINGS = {"µm": "um", "μm": "um", "°": "deg", "inch": "in", '"': "in"}
_POWERS = {"²": 2, "³": 3}


def quantity(text: str, kind: str) -> float:
    """A number with a unit, in SI units.

    Parameters
    ----------
    text : str
        Such as ``12 mm``, ``2.1 kg cm^2``, ``2.1e-4 kg*m**2`` or ``9.81 m/s^2``.
    kind : str
        One of :data:`KINDS`.

    Raises
    ------
    ValueError
        It is none, or of another kind; says so and gives an example.
    """
    return quantities(text, kind, 1)[0]


def quantities(text: str, kind: str, *counts: int) -> list[float]:
    """Numbers with commas in between and one unit behind, such as ``2,16,17 kg cm^2``.

    `counts` are how many there may be.
    """
    dimension, example = KINDS[kind]
    found = re.fullmatch(rf"\s*({_NUMBER}(?:\s*,\s*{_NUMBER})*)\s*(.*?)\s*", text)
    article = "an" if kind[0] in "aeiou" else "a"
    if found is None:
        raise ValueError(f"is no number with a unit; {article} {kind} is needed, such as {example}")
    values = [float(value) for value in found[1].split(",")]
    if len(values) not in counts:
        *more, last = map(str, counts)
        wanted = f"{', '.join(more)} or {last}" if more else last
        verb, plural = ("is" if wanted == "1" else "are"), ("" if len(values) == 1 else "s")
        raise ValueError(
            f"has {len(values)} number{plural}; {wanted} {verb} needed, with one unit behind"
        )
    if not found[2]:
        raise ValueError(f"has no unit; {article} {kind} is needed, such as {example}")
    size, powers = _unit(found[2])
    if powers != dimension:
        other = next((name for name, (d, _) in KINDS.items() if d == powers), "something else")
        which = "an" if other[0] in "aeiou" else "a"
        is_ = other if other == "something else" else f"{which} {other}"
        raise ValueError(f"is {is_}; {article} {kind} is needed, such as {example}")
    return [value * size for value in values]


def _unit(text: str) -> tuple[float, Dimension]:
    """Size and dimension of a product of units."""
    size, powers, place = 1.0, (0, 0, 0, 0), 0
    while place < len(text):
        factor = _FACTOR.match(text, place)
        name = "" if factor is None else _SPELLINGS.get(factor[2], factor[2])
        if factor is None or name not in _UNITS:
            raise ValueError(
                f"has the unit {text}, which is none of {', '.join(_UNITS)} or a product of these"
            )
        power = _POWERS.get(factor[3]) or int(factor[3] or 1)
        power = -power if factor[1] == "/" else power
        one, dimension = _UNITS[name]
        size *= one**power
        a, b, c, d = (x + power * y for x, y in zip(powers, dimension, strict=True))
        powers = a, b, c, d
        place = factor.end()
    return size, powers
