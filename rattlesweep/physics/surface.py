"""Surfaces and laws of friction: what a model of a rattleback is made of.

A further surface or law is a record here and the functions that it names.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rattlesweep.physics import full, stone

Formula = Callable[..., Any]  # compiled by `full.scalar`


@dataclass(frozen=True)
class Carried:
    """A function ``x`` of the slope that steps carry beside the state.

    That is cheaper than to compute it in each stage.
    """

    start: Formula  # start(p, q, *shape)
    rate: Formula  # rate(p, q, dp, dq, *shape, x)
    contact: Formula  # contact(p, q, a, b, c, dp, dq, m, *shape, x)


@dataclass(frozen=True)
class Surface:
    """The lower surface of a body, given by functions of the slope ``p, q``.

    ``shape`` are the constants of the surface: its curvature ``cxx, cxy, cyy``, and one
    more constant ``k`` if it has one; for a surface without it, ``k`` is optional.
    """

    name: str
    contact: Formula  # contact(p, q, a, b, c, dp, dq, m, *shape): see full.paraboloid
    energy: Formula  # energy(p, q, a, b, c, ix, iy, iz, *shape)
    # Whether `physics.vectors` knows the surface: paraboloids and ellipsoids.
    quadric: bool = False
    # Whether the slope diverges where the body rolls onto its side.  Such a run goes on
    # in the variables of `physics.vectors`.
    closed: bool = False
    carried: Carried | None = None


@dataclass(frozen=True)
class Friction:
    """A law of friction: couples on a body that rolls, and their work.

    ``loss`` are its constants ``sigma, lever, eps``.
    """

    name: str
    rhs: Formula  # rhs(contact, y, inertia, shape, loss): derivative of y, with work
    # couples(u, omega, loss): the torque, and the torque per unit of normal force
    couples: Formula


PARABOLOID = Surface("full", contact=full.paraboloid, energy=full.energy, quadric=True)
ELLIPSOID = Surface(
    "ellipsoid",
    contact=stone.ellipsoid,
    energy=stone.energy,
    quadric=True,
    closed=True,
    carried=Carried(stone.rise_at, stone.rise_rate, stone.carried_ellipsoid),
)
FURTHER = (ELLIPSOID,)
"""The surfaces that have a further constant."""

VISCOUS = Friction("viscous", stone.viscous_rhs, stone.viscous_couples)
ROLLING = Friction("rolling", stone.rolling_rhs, stone.rolling_couples)
LAWS = VISCOUS, ROLLING
