"""Quantities with units, such as "12 mm" or "2.1 kg cm^2", in SI units; pint knows the units."""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pint import UnitRegistry

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
"""Kinds of quantities: the SI unit, and an example."""

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_FACTOR = r"[*/·]?\s*[A-Za-zµμ°]+\s*(?:(?:\^|\*\*)?\s*(?:-?\d|[²³]))?\s*"


class SI(float):
    """A number in SI units, where a plain one is in the units of a body."""


class Quantity(SI):
    """A number in SI units that remembers the text it was given as, such as ``60 rpm``."""

    text: str
    kind: str

    def __new__(cls, text: str, kind: str) -> Quantity:
        """Read a text; raise a ValueError if it is no quantity of this kind."""
        self = super().__new__(cls, quantity(text, kind))
        self.text, self.kind = " ".join(text.split()), kind
        return self

    def __reduce__(self) -> tuple[type[Quantity], tuple[str, str]]:
        return Quantity, (self.text, self.kind)


def quantity(text: str, kind: str) -> float:
    """Return a number with a unit, in SI units.

    Parameters
    ----------
    text : str
        Such as ``12 mm``, ``2.1 kg cm^2``, ``2.1e-4 kg*m**2`` or ``9.81 m/s^2``.
    kind : str
        One of :data:`KINDS`.

    Raises
    ------
    ValueError
        If it is no quantity, or one of another kind; the message has an example.
    """
    return quantities(text, kind, 1)[0]


def quantities(text: str, kind: str, *counts: int) -> list[float]:
    """Return numbers with commas between them and one unit behind, such as ``2,16,17 kg cm^2``.

    Each may have a unit of its own, as in ``12cm,3cm``. `counts` are the numbers of values that are
    allowed.
    """
    needed = f"{_article(kind)} is needed, such as {KINDS[kind][1]}"
    found = [split(part) for part in text.split(",")]
    values = [value for value, _ in found if value is not None]
    if len(values) < len(found):
        raise ValueError(f"is not a number with a unit; {needed}")
    if len(values) not in counts:
        have = f"has {len(values)} number{'' if len(values) == 1 else 's'}"
        wanted = " or ".join(", ".join(map(str, counts)).rsplit(", ", 1))
        be = "is" if counts == (1,) else "are"
        raise ValueError(f"{have}; {wanted} {be} needed, with one unit behind")
    sizes = []
    for unit in (own or found[-1][1] for _, own in found):
        if not unit:
            raise ValueError(f"has no unit; {needed}")
        if not re.fullmatch(f"({_FACTOR})+", unit):
            raise ValueError(f"has the unit {unit}, which is not a product of units; {needed}")
        size, base = _base(unit)
        if base != _base(KINDS[kind][0])[1]:
            others = (_article(name) for name, (si, _) in KINDS.items() if _base(si)[1] == base)
            raise ValueError(f"is {next(others, 'another quantity')}; {needed}")
        sizes.append(size)
    return [value * size for value, size in zip(values, sizes, strict=True)]


def split(text: str) -> tuple[float | None, str]:
    """Return the number at the beginning of a text, None if there is none, and what is behind."""
    found = re.fullmatch(rf"\s*({_NUMBER})\s*(.*?)\s*", text)
    return (float(found[1]), found[2]) if found else (None, "")


def _article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


@cache
def _registry() -> UnitRegistry[Any]:
    import pint  # takes as long to import as all the rest of the command line

    return pint.UnitRegistry()


@cache
def _base(text: str) -> tuple[float, str]:
    """Return the size of a unit in SI base units, and these."""
    import pint

    # "mm2" is "mm^2" to people, and the name of a unit to pint.
    spelled = re.sub(r"(?<=[A-Za-zµμ°])\s*(?=-?\d)", "^", text.replace("°", "deg"))
    try:
        base = _registry().Quantity(1.0, spelled).to_base_units()
    except (pint.PintError, ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"has the unit {text}: {' '.join(str(error).split())}") from None
    return float(base.magnitude), str(base.units)
