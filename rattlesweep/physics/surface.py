"""Surfaces: the lower side of a body, which touches the plane.

A further surface is a record here and the functions that it names.  Its name, and what
users give, are in :mod:`rattlesweep.words.quantities`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics import full, stone

Formula = Callable[..., Any]  # compiled by `full.scalar`


@dataclass(frozen=True)
class Carried:
    """A function ``x`` of the slope that steps carry beside the state.

    That is cheaper than to compute it in each stage.
    """

    start: Formula  # start(y, shape)
    rate: Formula  # rate(y, dy, shape + (x,))
    contact: Formula  # contact(y, slope_rates, shape + (x,))


@dataclass(frozen=True)
class Surface:
    """The lower surface of a body, given by functions of the slope ``p, q``.

    ``shape`` are the constants of the surface: its curvature ``cxx, cxy, cyy``, and one
    more constant ``k`` if it has one; for a surface without it, ``k`` is optional.
    """

    name: str
    model: str  # name of the model of bodies that roll on it without friction
    contact: Formula  # contact(y, slope_rates, shape): see full.paraboloid
    energy: Formula  # energy(y, constants)
    # force(y, dy, constants): as `stone.surface_force`, if there is a shorter form
    force: Formula | None = None
    # k of the constant that users give, which is NaN for a paraboloid
    constant: Callable[[Floats], Floats] = np.nan_to_num
    # Whether the slope diverges where the body rolls onto its side.  Such a run goes on
    # in the variables of `physics.vectors`.
    closed: bool = False
    carried: Carried | None = None


PARABOLOID = Surface(
    "paraboloid",
    model="full",
    contact=full.paraboloid,
    energy=full.energy,
    force=full.contact_force,
)
ELLIPSOID = Surface(
    "ellipsoid",
    model="ellipsoid",
    contact=stone.ellipsoid,
    energy=stone.energy,
    constant=stone.inverse_semi_axis,
    closed=True,
    carried=Carried(stone.rise_at, stone.rise_rate, stone.carried_ellipsoid),
)
FURTHER = (ELLIPSOID,)
"""The surfaces that have a further constant."""

SURFACES = {surface.name: surface for surface in (PARABOLOID, *FURTHER)}
