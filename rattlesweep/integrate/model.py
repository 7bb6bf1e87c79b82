"""Sets of equations, as the kernels need them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from rattlesweep.physics import attitude, full, reduced, stone, tangent, vectors, volume

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True)
class Tangent:
    """Motion of a small difference ``v`` along a run, as compiled scalar functions.

    With ``f`` the derivative of the state, and ``y`` and ``q`` as for :class:`Model`:

    Attributes
    ----------
    rate : callable
        ``rate(*y, *f, *v, *q)``, the derivative of ``v``.
    seed : callable
        ``seed(*y, *q)``, the tangent to begin with.
    transverse : callable
        ``transverse(*y, *f, *v, *q)``: the part of ``v`` that is measured.
    square : callable
        ``square(*v, *q)``: squared norm.
    """

    rate: Callable[..., Any]
    seed: Callable[..., Any]
    transverse: Callable[..., Any]
    square: Callable[..., Any]


@dataclass(frozen=True)
class Carried:
    """Functions of the state that the stages of a step integrate, which costs less than they do.

    Each step begins with their own values and ends without them, so that it is one of the method
    for the state alone, of the same order.  With ``x`` for what is carried, and ``y`` and ``q`` as
    for :class:`Model`:

    Attributes
    ----------
    n : int
        How many they are.
    start : callable
        ``start(*y, *q)``, their values.
    rhs : callable
        ``rhs(*y, *x, *q)``, derivatives of the state and, behind, of them.
    """

    n: int
    start: Callable[..., Any]
    rhs: Callable[..., Any]


@dataclass(frozen=True)
class Model:
    """Equations of motion and what is watched on the way, as compiled scalar functions.

    With ``y`` the state's components and ``q`` the body's constants as separate arguments:

    Attributes
    ----------
    rhs : callable
        ``rhs(*y, *q)``, a tuple of derivatives.
    spin, spin_rate : callable
        ``spin(*y)`` and ``spin_rate(*y, *dy)``.
    amplitude : callable
        ``amplitude(*y, *probe)``: squared amplitude of the relevant oscillation.
    error : callable
        ``error(*e, *y, *q)``: square of the step error ``e``, and of the oscillation that it is
        compared with.
    energy, contact : callable
        ``energy(*y, *q)``, which is conserved: with friction, less its work;
        ``contact(*y, *q)``, normal and tangential force.
    touch : callable, optional
        How the body touches the plane, as :func:`rattlesweep.physics.full.paraboloid`.
    tangent : Tangent, optional
        The tangent that a run carries with it; by default it carries none.
    carried : Carried, optional
        What the stages of a step carry, for models without tangent.
    n_given : int, optional
        Components that the states of a run have, where they are not all of them.
    volume : callable, optional
        ``volume(*y, *q)``, the rate of phase volume.
    anywhere : Model, optional
        The same equations for runs that these variables cannot follow.
    """

    name: str
    n_state: int
    n_constants: int
    n_probe: int
    rhs: Callable[..., Any]
    spin: Callable[..., Any]
    spin_rate: Callable[..., Any]
    amplitude: Callable[..., Any]
    error: Callable[..., Any]
    energy: Callable[..., Any]
    contact: Callable[..., Any]
    touch: Callable[..., Any] | None = None
    tangent: Tangent | None = None
    carried: Carried | None = None
    n_given: int | None = None
    volume: Callable[..., Any] | None = None
    anywhere: Model | None = None


@full.scalar
def _full_spin_rate(p, q, a, b, c, dp, dq, da, db, dc):  # type: ignore[no-untyped-def]
    return full.spin_rate(p, q, da, db, dc)


@full.scalar
def _full_amplitude(p, q, a, b, c, p0, q0, a0, b0, p1, q1, a1, b1):  # type: ignore[no-untyped-def]
    real = p0 * p + q0 * q + a0 * a + b0 * b
    imag = p1 * p + q1 * q + a1 * a + b1 * b
    return real * real + imag * imag


@full.scalar
def _full_error(ep, eq, ea, eb, ec, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy):  # type: ignore[no-untyped-def]
    step = full.oscillation(ep, eq, ea, eb, ix, iy, cxx, cxy, cyy) + iz * ec * ec
    return step, full.oscillation(p, q, a, b, ix, iy, cxx, cxy, cyy) + 1e-290


FULL = Model(
    name="full",
    n_state=full.N_STATE,
    n_constants=full.N_CONSTANTS,
    n_probe=8,
    rhs=full.rhs,
    spin=full.spin,
    spin_rate=_full_spin_rate,
    amplitude=_full_amplitude,
    error=_full_error,
    energy=full.energy,
    contact=full.contact_force,
    touch=full.paraboloid,
    volume=volume.paraboloid_volume,
)


@full.scalar
def _ellipsoid_error(ep, eq, ea, eb, ec, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):  # type: ignore[no-untyped-def]
    return _full_error(ep, eq, ea, eb, ec, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy)


def _compile(model: str, *functions: Callable[..., Any]) -> list[Any]:
    """Return compiled functions of a model, under names of its own.

    Numba makes symbols of names, so functions of two models may not share one.
    """
    for function in functions:
        function.__name__ = function.__qualname__ = f"{function.__name__}_{model}"
    return [full.scalar(function) for function in functions]


# An ellipsoid's ``rise`` is integrated along, since it is what the second root is for, and since
# everything else in a stage waits for that root.


@full.scalar
def _rise(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):  # type: ignore[no-untyped-def]
    _, rise = stone.shape_at(p, q, cxx, cxy, cyy, k)
    return (rise,)


@full.scalar
def _rise_rhs(p, q, a, b, c, rise, ix, iy, iz, cxx, cxy, cyy, k):  # type: ignore[no-untyped-def]
    f = stone.frictionless_rhs(
        stone.carried_ellipsoid, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, (k, rise)
    )
    return f + (stone.rise_rate(p, q, f[0], f[1], cxx, cxy, cyy, k, rise),)  # noqa: RUF005


@full.scalar
def _friction_rise(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
    return _rise(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k)


@full.scalar
def _friction_error(  # type: ignore[no-untyped-def]
    ep, eq, ea, eb, ec, ework, p, q, a, b, c, work,
    ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps,
):  # fmt: skip
    # The work is a quadrature beside, as accurate as what it is of.  The spin, which falls by
    # itself, has errors of rounding: where the oscillation has died, no step is judged by them.
    size = full.oscillation(p, q, a, b, ix, iy, cxx, cxy, cyy) + 1e-290
    known = min(1.0, size / (SPIN_KNOWN * iz * c * c + 1e-290))
    return full.oscillation(ep, eq, ea, eb, ix, iy, cxx, cxy, cyy) + known * iz * ec * ec, size


SPIN_KNOWN = 1e-14
"""Of an oscillation with less than this share of the spin's energy the error of the spin counts as
of one with so much: it is then 1e-7 of the tolerance, and no less than rounding."""


@full.scalar
def _vectors_amplitude(u, v, w, a, b, c, work, p0, q0, a0, b0, p1, q1, a1, b1):  # type: ignore[no-untyped-def]
    # Upright, minus u_x and u_y are the slopes.
    return _full_amplitude(-u, -v, a, b, c, p0, q0, a0, b0, p1, q1, a1, b1)


@full.scalar
def _vectors_error(  # type: ignore[no-untyped-def]
    eu, ev, ew, ea, eb, ec, ework, u, v, w, a, b, c, work,
    ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps,
):  # fmt: skip
    step, size = _friction_error(
        eu, ev, ea, eb, ec, ework, u, v, a, b, c, work,
        ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps,
    )  # fmt: skip
    return step + ew * ew, size


VECTORS = Model(
    name="vectors",
    n_state=vectors.N_STATE,
    n_constants=stone.N_FRICTION_CONSTANTS,
    n_probe=FULL.n_probe,
    rhs=vectors.rhs,
    spin=vectors.spin,
    spin_rate=vectors.spin_rate,
    amplitude=_vectors_amplitude,
    error=_vectors_error,
    energy=vectors.energy,
    contact=vectors.contact_force,
    volume=volume.vectors_volume,
)

ELLIPSOID = replace(
    FULL,
    name="ellipsoid",
    n_constants=stone.N_CONSTANTS,
    rhs=stone.rhs,
    error=_ellipsoid_error,
    energy=stone.energy,
    contact=stone.contact_force,
    touch=stone.ellipsoid,
    carried=Carried(1, _rise, _rise_rhs),
    volume=volume.ellipsoid_volume,
    anywhere=VECTORS,
)


@full.scalar
def _friction_spin(p, q, a, b, c, work):  # type: ignore[no-untyped-def]
    return full.spin(p, q, a, b, c)


@full.scalar
def _friction_spin_rate(p, q, a, b, c, work, dp, dq, da, db, dc, power):  # type: ignore[no-untyped-def]
    return full.spin_rate(p, q, da, db, dc)


@full.scalar
def _friction_amplitude(p, q, a, b, c, work, p0, q0, a0, b0, p1, q1, a1, b1):  # type: ignore[no-untyped-def]
    return _full_amplitude(p, q, a, b, c, p0, q0, a0, b0, p1, q1, a1, b1)


def _with_friction(
    plain: Model, kind: str, rhs_on: Callable[..., Any], volume_on: Callable[..., Any]
) -> Model:
    """Return the model of the same body with friction, of the rates on its surface."""
    surface = stone.ellipsoid if plain is ELLIPSOID else stone.flat
    energy_on = stone.energy if plain is ELLIPSOID else stone.flat_energy

    def rhs(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
        return rhs_on(surface, p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps)

    def energy(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
        return energy_on(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k) - work

    def contact(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
        return stone.friction_force(
            rhs_on, surface, p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps
        )

    def rise_rhs(p, q, a, b, c, work, rise, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
        f = rhs_on(
            stone.carried_ellipsoid, p, q, a, b, c, work,
            ix, iy, iz, cxx, cxy, cyy, (k, rise), sigma, lever, eps,
        )  # fmt: skip
        return f + (stone.rise_rate(p, q, f[0], f[1], cxx, cxy, cyy, k, rise),)  # noqa: RUF005

    def volume_rate(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
        return volume_on(
            surface, p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps
        )

    name = f"{plain.name}_{kind}"
    functions = rhs, energy, contact, rise_rhs, volume_rate
    rhs, energy, contact, rise_rhs, volume_rate = _compile(name, *functions)
    return Model(
        name=name,
        n_state=stone.N_FRICTION_STATE,
        n_constants=stone.N_FRICTION_CONSTANTS,
        n_probe=plain.n_probe,
        rhs=rhs,
        spin=_friction_spin,
        spin_rate=_friction_spin_rate,
        amplitude=_friction_amplitude,
        error=_friction_error,
        energy=energy,
        contact=contact,
        touch=surface,
        carried=Carried(1, _friction_rise, rise_rhs) if plain is ELLIPSOID else None,
        volume=volume_rate,
        anywhere=plain.anywhere,
    )


FRICTION = {
    (plain.name, name): _with_friction(plain, name, *rates)
    for plain in (FULL, ELLIPSOID)
    for name, *rates in (
        ("viscous", stone.viscous_rhs, volume.viscous_volume),
        ("rolling", stone.rolling_rhs, volume.rolling_volume),
    )
}
"""Models with friction, by the surface's model and the kind: viscous alone, or rolling too."""


@full.scalar
def _reduced_spin(n, e_p, e_r):  # type: ignore[no-untyped-def]
    return n


@full.scalar
def _reduced_spin_rate(n, e_p, e_r, dn, de_p, de_r):  # type: ignore[no-untyped-def]
    return dn


@full.scalar
def _reduced_amplitude(n, e_p, e_r, w_p, w_r):  # type: ignore[no-untyped-def]
    return w_p * e_p + w_r * e_r


@full.scalar
def _reduced_error(dn, de_p, de_r, n, e_p, e_r, k_p, k_r, inertia):  # type: ignore[no-untyped-def]
    # Each energy relative to itself: the one that decays decides what happens much later.
    spin = inertia * dn * dn / (inertia * n * n + 2.0 * (e_p + e_r) + 1e-290)
    pitch = de_p * de_p / (e_p * e_p + 1e-290)
    roll = de_r * de_r / (e_r * e_r + 1e-290)
    return spin + pitch + roll, 1.0


@full.scalar
def _no_contact(n, e_p, e_r, k_p, k_r, inertia):  # type: ignore[no-untyped-def]
    return 1.0, 0.0


REDUCED = Model(
    name="reduced",
    n_state=reduced.N_STATE,
    n_constants=reduced.N_CONSTANTS,
    n_probe=2,
    rhs=reduced.rhs,
    spin=_reduced_spin,
    spin_rate=_reduced_spin_rate,
    amplitude=_reduced_amplitude,
    error=_reduced_error,
    energy=reduced.energy,
    contact=_no_contact,
)

FULL_TANGENT = replace(
    FULL,
    name="full_tangent",
    tangent=Tangent(
        tangent.full_rate, tangent.full_seed, tangent.full_transverse, tangent.full_square
    ),
)
REDUCED_TANGENT = replace(
    REDUCED,
    name="reduced_tangent",
    tangent=Tangent(
        tangent.reduced_rate,
        tangent.reduced_seed,
        tangent.reduced_transverse,
        tangent.reduced_square,
    ),
)

WITH_TANGENT: dict[str, Model] = {FULL.name: FULL_TANGENT, REDUCED.name: REDUCED_TANGENT}
"""The same equations with a tangent, by the name of the model without."""


@full.scalar
def _nothing(*v):  # type: ignore[no-untyped-def]
    return 0.0


@full.scalar
def _no_error(*v):  # type: ignore[no-untyped-def]
    return 0.0, 1.0


def _with_attitude(plain: Model) -> Model:
    """Return a model with heading and contact point (:mod:`rattlesweep.physics.attitude`).

    It makes single steps from states of the plain model, so no error and no amplitude are needed.
    """
    n, own_rhs, touch = plain.n_state, plain.rhs, plain.touch
    own_spin, own_spin_rate = plain.spin, plain.spin_rate
    behind = n + attitude.N_EXTRA
    end = behind + n

    def rhs(*v: float) -> Any:
        y, constants = v[:n], v[behind:]
        p, q, a, b, c = y[:5]
        f = own_rhs(*(y + constants))
        m = p * b - q * a
        # Constants of the surface stand behind those of inertia.
        contact = touch(p, q, a, b, c, f[0], f[1], m, *constants[3:7])  # type: ignore[misc]
        return f + attitude.track(p, q, a, b, c, v[n], *contact)

    def spin(*v: float) -> Any:
        return own_spin(*v[:n])

    def spin_rate(*v: float) -> Any:
        return own_spin_rate(*(v[:n] + v[behind:end]))

    name = f"{plain.name}_attitude"
    rhs, spin, spin_rate = _compile(name, rhs, spin, spin_rate)
    return replace(
        plain,
        name=name,
        n_state=behind,
        n_probe=0,
        n_given=n,
        rhs=rhs,
        spin=spin,
        spin_rate=spin_rate,
        amplitude=_nothing,
        error=_no_error,
        carried=None,
    )


ATTITUDES: dict[str, Model] = {
    plain.name: _with_attitude(plain) for plain in (FULL, ELLIPSOID, *FRICTION.values())
}
"""Models with heading and contact point, by the names of those without."""

PLAIN = FULL, ELLIPSOID, VECTORS, *FRICTION.values(), REDUCED
MODELS: dict[str, Model] = {model.name: model for model in (*PLAIN, FULL_TANGENT, REDUCED_TANGENT)}


def find_model(name: str) -> Model:
    """Return a model of :data:`MODELS` or of :data:`ATTITUDES` by its own name."""
    moving = {model.name: model for model in ATTITUDES.values()}
    return MODELS.get(name) or moving[name]
