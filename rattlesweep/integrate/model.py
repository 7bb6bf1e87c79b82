"""Sets of equations, as the kernels need them."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from rattlesweep.physics import full, reduced, stone, tangent, vectors

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True)
class Model:
    """Equations of motion and what is watched, as compiled functions of single components.

    Those of the state are ``y``, the body's constants are ``q``.
    """

    name: str
    n_state: int
    n_constants: int
    n_probe: int
    rhs: Callable[..., Any]  # rhs(*y, *q), a tuple of derivatives
    spin: Callable[..., Any]  # spin(*y)
    spin_rate: Callable[..., Any]  # spin_rate(*y, *dy)
    amplitude: Callable[..., Any]  # amplitude(*y, *probe), of the relevant oscillation, squared
    # error(*e, *y, *q): square of the step error e, and of the oscillation it is compared with.
    error: Callable[..., Any]
    energy: Callable[..., Any]  # energy(*y, *q), which is conserved: with friction, less its work
    contact: Callable[..., Any]  # contact(*y, *q), normal and tangential force
    touch: Callable[..., Any] | None = None  # how it touches the plane, as physics.full.paraboloid
    volume: Callable[..., Any] | None = None  # volume(*y, *q), the rate of phase volume
    anywhere: Model | None = None  # the same equations for runs that these variables cannot follow
    n_beside: int = 0  # last components of the state that the states of a run do not have
    # Functions x of the state that the stages of a step integrate, as that costs less than they do:
    # carried_start(*y, *q), their values, with which each step begins; carried_rhs(*y, *x, *q),
    # derivatives of the state and, behind, of them.
    n_carried: int = 0
    carried_start: Callable[..., Any] | None = None
    carried_rhs: Callable[..., Any] | None = None
    # For runs that carry a tangent, a small difference v: rate(*y, *dy, *v, *q), its derivative;
    # seed(*y, *q), the first one; transverse(*y, *dy, *v, *q), the part that is measured;
    # square(*v, *q), its squared norm.
    rate: Callable[..., Any] | None = None
    seed: Callable[..., Any] | None = None
    transverse: Callable[..., Any] | None = None
    square: Callable[..., Any] | None = None


def _compiled(model: str, **functions: Callable[..., Any]) -> dict[str, Any]:
    """Return compiled functions of a model, named after it: Numba makes symbols of names."""
    for name, function in functions.items():
        function.__name__ = function.__qualname__ = f"{name}_{model}"
    return {name: full.scalar(function) for name, function in functions.items()}


@full.scalar
def _amplitude(p, q, a, b, c, p0, q0, a0, b0, p1, q1, a1, b1):
    real = p0 * p + q0 * q + a0 * a + b0 * b
    imag = p1 * p + q1 * q + a1 * a + b1 * b
    return real * real + imag * imag


@full.scalar
def _error(ep, eq, ea, eb, ec, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy):
    step = full.oscillation(ep, eq, ea, eb, ix, iy, cxx, cxy, cyy) + iz * ec * ec
    return step, full.oscillation(p, q, a, b, ix, iy, cxx, cxy, cyy) + 1e-290


@full.scalar
def _volume(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):
    return vectors.smooth_volume(-p, -q, -1.0, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, 0.0)


FULL = Model(
    "full", full.N_STATE, full.N_CONSTANTS, 8,
    rhs=full.rhs, spin=full.spin, amplitude=_amplitude, error=_error, energy=full.energy,
    contact=full.contact_force, touch=full.paraboloid,
    **_compiled(
        "full",
        spin_rate=lambda *v: full.spin_rate(*(v[:2] + v[7:])),
        volume=lambda *v: _volume(*v, 0.0),
    ),
)  # fmt: skip

# An ellipsoid's ``rise`` is integrated along, as all else in a stage waits for the root in it.


@full.scalar
def _rise(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):
    _, rise = stone.shape_at(p, q, cxx, cxy, cyy, k)
    return (rise,)


@full.scalar
def _rise_rhs(p, q, a, b, c, rise, ix, iy, iz, cxx, cxy, cyy, k):
    on = stone.carried_ellipsoid
    f = stone.frictionless_rhs(on, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, (k, rise))
    return f + (stone.rise_rate(p, q, f[0], f[1], cxx, cxy, cyy, k, rise),)  # noqa: RUF005


# An oscillation with less than this share of the spin's energy counts as one with so much where the
# error of the spin is judged.
SPIN_KNOWN = 1e-14


@full.scalar
def _friction_error(
    ep, eq, ea, eb, ec, ework, p, q, a, b, c, work,
    ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps,
):  # fmt: skip
    # The spin, which falls by itself, has errors of rounding: no step is judged by them alone.
    size = full.oscillation(p, q, a, b, ix, iy, cxx, cxy, cyy) + 1e-290
    known = min(1.0, size / (SPIN_KNOWN * iz * c * c + 1e-290))
    return full.oscillation(ep, eq, ea, eb, ix, iy, cxx, cxy, cyy) + known * iz * ec * ec, size


@full.scalar
def _vectors_error(eu, ev, ew, ea, eb, ec, ework, u, v, w, a, *rest):
    step, size = _friction_error(eu, ev, ea, eb, ec, ework, u, v, a, *rest)
    return step + ew * ew, size


VECTORS = Model(
    "vectors", vectors.N_STATE, stone.N_FRICTION_CONSTANTS, FULL.n_probe,
    rhs=vectors.rhs, spin=vectors.spin, spin_rate=vectors.spin_rate, error=_vectors_error,
    energy=vectors.energy, contact=vectors.contact_force, volume=vectors.volume,
    # Upright, minus u_x and u_y are the slopes.
    **_compiled(
        "vectors",
        amplitude=lambda u, v, w, a, b, c, work, *probe: _amplitude(-u, -v, a, b, c, *probe),
    ),
)  # fmt: skip

ELLIPSOID = replace(
    FULL, name="ellipsoid", n_constants=stone.N_CONSTANTS, rhs=stone.rhs, energy=stone.energy,
    contact=stone.contact_force, touch=stone.ellipsoid, volume=_volume, anywhere=VECTORS,
    n_carried=1, carried_start=_rise, carried_rhs=_rise_rhs,
    **_compiled("ellipsoid", error=lambda *v: _error(*v[:-1])),
)  # fmt: skip


def _with_friction(plain: Model, kind: str, rhs_on: Callable[..., Any]) -> Model:
    """Return the model of the same body with friction, of the rates on its surface."""
    surface = stone.ellipsoid if plain is ELLIPSOID else stone.flat
    energy_on = stone.energy if plain is ELLIPSOID else stone.flat_energy

    def rhs(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
        return rhs_on(surface, p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps)

    def contact(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
        dp, dq, da, db, dc, _ = rhs_on(
            surface, p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps
        )
        return stone.force_on(surface, p, q, a, b, c, dp, dq, da, db, dc, cxx, cxy, cyy, k)

    def rise_rhs(p, q, a, b, c, work, rise, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
        f = rhs_on(
            stone.carried_ellipsoid, p, q, a, b, c, work,
            ix, iy, iz, cxx, cxy, cyy, (k, rise), sigma, lever, eps,
        )  # fmt: skip
        return f + (stone.rise_rate(p, q, f[0], f[1], cxx, cxy, cyy, k, rise),)  # noqa: RUF005

    name = f"{plain.name}_{kind}"
    functions = _compiled(
        name,
        rhs=rhs,
        spin=lambda *v: full.spin(*v[:5]),
        spin_rate=lambda *v: full.spin_rate(*(v[:2] + v[8:11])),
        amplitude=lambda *v: _amplitude(*(v[:5] + v[6:])),
        energy=lambda *v: energy_on(*(v[:5] + v[6:13])) - v[5],
        contact=contact,
        volume=lambda p, q, *rest: vectors.volume(-p, -q, -1.0, *rest),
        carried_start=lambda *v: _rise(*(v[:5] + v[6:13])),
        carried_rhs=rise_rhs,
    )
    functions |= {"n_state": stone.N_FRICTION_STATE, "n_constants": stone.N_FRICTION_CONSTANTS}
    return replace(plain, name=name, error=_friction_error, touch=surface, **functions)


FRICTION = {
    (plain.name, name): _with_friction(plain, name, rhs)
    for plain in (FULL, ELLIPSOID)
    for name, rhs in (("viscous", stone.viscous_rhs), ("rolling", stone.rolling_rhs))
}
"""Models with friction, by the surface's model and the kind: viscous alone, or rolling too."""


@full.scalar
def _reduced_error(dn, de_p, de_r, n, e_p, e_r, k_p, k_r, inertia):
    # Each energy relative to itself: the one that decays decides what happens much later.
    spin = inertia * dn * dn / (inertia * n * n + 2.0 * (e_p + e_r) + 1e-290)
    pitch = de_p * de_p / (e_p * e_p + 1e-290)
    roll = de_r * de_r / (e_r * e_r + 1e-290)
    return spin + pitch + roll, 1.0


REDUCED = Model(
    "reduced", reduced.N_STATE, reduced.N_CONSTANTS, 2,
    rhs=reduced.rhs, error=_reduced_error, energy=reduced.energy,
    **_compiled(
        "reduced",
        spin=lambda n, e_p, e_r: n,
        spin_rate=lambda n, e_p, e_r, dn, de_p, de_r: dn,
        amplitude=lambda n, e_p, e_r, w_p, w_r: w_p * e_p + w_r * e_r,
        contact=lambda *v: (1.0, 0.0),
    ),
)  # fmt: skip


def _with_attitude(plain: Model) -> Model:
    """Return a model with heading and contact point, for single steps."""
    n, own_rhs, touch = plain.n_state, plain.rhs, plain.touch
    behind = n + full.N_EXTRA

    def rhs(*v: float) -> Any:
        y, constants = v[:n], v[behind:]
        p, q, a, b, c = y[:5]
        f = own_rhs(*(y + constants))
        m = p * b - q * a
        # Constants of the surface stand behind those of inertia.
        contact = touch(p, q, a, b, c, f[0], f[1], m, *constants[3:7])  # type: ignore[misc]
        return f + full.track(p, q, a, b, c, v[n], *contact)

    name = f"{plain.name}_attitude"
    nothing = {word: lambda *v: 0.0 for word in ("spin", "spin_rate", "amplitude")}
    functions = _compiled(name, rhs=rhs, error=lambda *v: (0.0, 1.0), **nothing)
    functions |= {"n_state": behind, "n_probe": 0, "n_beside": full.N_EXTRA, "n_carried": 0}
    return replace(plain, name=name, **functions)


TANGENT = replace(
    FULL, name="full_tangent", rate=tangent.rate, seed=tangent.seed, transverse=tangent.transverse,
    square=tangent.square,
)  # fmt: skip
"""The full model with the largest Lyapunov exponent's tangent."""

ATTITUDES = {plain.name: _with_attitude(plain) for plain in (FULL, ELLIPSOID, *FRICTION.values())}
"""Models with heading and contact point, by the names of those without."""

PLAIN = FULL, ELLIPSOID, VECTORS, *FRICTION.values(), REDUCED
MODELS: dict[str, Model] = {model.name: model for model in (*PLAIN, TANGENT)}


def find_model(name: str) -> Model:
    """Return a model of :data:`MODELS` or of :data:`ATTITUDES` by its own name."""
    return MODELS.get(name) or ATTITUDES[name.removesuffix("_attitude")]
