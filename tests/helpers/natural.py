"""Launches of bodies with a size, in units of the body."""

from typing import Any

from rattlesweep.words.quantities import QUANTITIES
from rattlesweep.words.units import NATURAL


def natural(**values: Any) -> dict[str, Any]:
    """Return numbers as texts with the units of the body, such as ``0.1 sqrt(g/a)``."""
    kinds = {name: QUANTITIES[name].kind for name in values if name in QUANTITIES}
    return {
        name: f"{float(value)!r} {NATURAL[kinds[name]]}"
        if kinds.get(name) in NATURAL and not isinstance(value, str)
        else value
        for name, value in values.items()
    }
