"""Surfaces and laws of friction: what a model of a rattleback is made of.

A further surface or law is a record here and the functions that it names.  Its name,
and what users give, are in :mod:`rattlesweep.quantities`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics import full, pivoting, stone

Formula = Callable[..., Any]  # compiled by `full.scalar`


def in_python(formula: Formula, results: int) -> Callable[..., Any]:
    """Return a formula of numbers for arrays, not compiled, as that would take long."""
    plain = formula.py_func  # type: ignore[attr-defined]
    return np.vectorize(plain, otypes=[float] * results)


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
    model: str  # name of the model of bodies that roll on it without friction
    contact: Formula  # contact(p, q, a, b, c, dp, dq, m, *shape): see full.paraboloid
    energy: Formula  # energy(p, q, a, b, c, ix, iy, iz, *shape)
    # k of the constant that users give, which is NaN for a paraboloid
    constant: Callable[[Floats], Floats] = np.nan_to_num
    # Whether `physics.vectors` knows the surface: paraboloids and ellipsoids.
    quadric: bool = False
    # Whether the slope diverges where the body rolls onto its side.  Such a run goes on
    # in the variables of `physics.vectors`.
    closed: bool = False
    carried: Carried | None = None


@dataclass(frozen=True)
class Friction:
    """A law of friction: couples on a body that rolls, and their work."""

    name: str
    # couples(u, omega, loss, creep): a couple, and one that is multiplied by the normal
    # force; creep is mu times the speed of sliding, 0 where the body rolls
    couples: Formula
    # The constants ``loss``: what users give, by name, and fixed numbers.
    loss: tuple[str | float, ...]
    # (constant, law): the name of the law where this constant is zero
    without: tuple[tuple[str, str], ...] = ()
    # Whether `physics.vectors` knows the law.
    in_vectors: bool = False
    # rhs(contact, y, inertia, shape, loss): derivative of y, with work, if there is a
    # cheaper form than `stone.rhs_of_couples`
    rhs: Formula | None = None
    # parts(contact, y, inertia, shape, loss): as in `pivoting.pivoting_parts`; of a law
    # with a torque against pivoting, whose sense is a last constant
    pivot: Formula | None = None

    @property
    def constants(self) -> tuple[str, ...]:
        """The names of the constants; a number that is fixed is a smoothing."""
        names = tuple(
            each if isinstance(each, str) else "smoothing" for each in self.loss
        )
        return names if self.pivot is None else (*names, "sense")


PARABOLOID = Surface(
    "paraboloid",
    model="full",
    contact=full.paraboloid,
    energy=full.energy,
    quadric=True,
)
ELLIPSOID = Surface(
    "ellipsoid",
    model="ellipsoid",
    contact=stone.ellipsoid,
    energy=stone.energy,
    constant=stone.inverse_semi_axis,
    quadric=True,
    closed=True,
    carried=Carried(stone.rise_at, stone.rise_rate, stone.carried_ellipsoid),
)
FURTHER = (ELLIPSOID,)
"""The surfaces that have a further constant."""

SURFACES = {surface.name: surface for surface in (PARABOLOID, *FURTHER)}

# All laws have the constants of `physics.vectors`.
COUPLES = ("sigma", "rolling", stone.SMOOTHING)
VISCOUS = Friction(
    "viscous",
    stone.viscous_couples,
    COUPLES,
    in_vectors=True,
    rhs=stone.viscous_rhs,
)
ROLLING = Friction(
    "rolling",
    stone.rolling_couples,
    COUPLES,
    without=(("rolling", "viscous"),),
    in_vectors=True,
    rhs=stone.rolling_rhs,
)
PIVOTING = Friction(
    "pivoting",
    pivoting.pivoting_couples,
    (*COUPLES, "pivot"),
    without=(("pivot", "viscous"),),
    in_vectors=True,
    rhs=pivoting.rhs_of(pivoting.pivoting_parts),
    pivot=pivoting.pivoting_parts,
)
ROLLING_PIVOTING = Friction(
    "rolling_pivoting",
    pivoting.rolling_pivoting_couples,
    (*COUPLES, "pivot"),
    without=(("rolling", "pivoting"), ("pivot", "rolling")),
    in_vectors=True,
    rhs=pivoting.rhs_of(pivoting.rolling_parts),
    pivot=pivoting.rolling_parts,
)
LAWS = {law.name: law for law in (VISCOUS, ROLLING, PIVOTING, ROLLING_PIVOTING)}
