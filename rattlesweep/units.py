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

    `counts` are the numbers of values that are allowed.
    """
    needed = f"{_article(kind)} is needed, such as {KINDS[kind][1]}"
    found = re.fullmatch(rf"\s*({_NUMBER}(?:\s*,\s*{_NUMBER})*)\s*(.*?)\s*", text)
    if found is None:
        raise ValueError(f"is not a number with a unit; {needed}")
    values = [float(value) for value in found[1].split(",")]
    if len(values) not in counts:
        plural, (*more, last) = "" if len(values) == 1 else "s", map(str, counts)
        wanted = (
            f"{', '.join(more)} or {last} are"
            if more
            else f"{last} {'is' if last == '1' else 'are'}"
        )
        raise ValueError(f"has {len(values)} number{plural}; {wanted} needed, with one unit behind")
    if not found[2]:
        raise ValueError(f"has no unit; {needed}")
    if not re.fullmatch(f"({_FACTOR})+", found[2]):
        raise ValueError(f"has the unit {found[2]}, which is not a product of units; {needed}")
    size, unit = _base(found[2])
    if unit != _base(KINDS[kind][0])[1]:
        others = (_article(name) for name, (base, _) in KINDS.items() if _base(base)[1] == unit)
        raise ValueError(f"is {next(others, 'another quantity')}; {needed}")
    return [value * size for value in values]


def _article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


@cache
def _registry() -> UnitRegistry[Any]:
    import pint  # takes as long to import as all the rest of the command line

    return pint.UnitRegistry()


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
