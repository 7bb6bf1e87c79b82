"""Models: the equations of motion and observed quantities that kernels are compiled
for.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from rattlesweep.physics import full, reduced, stone, tangent, vectors


@dataclass(frozen=True)
class Model:
    """Equations of motion and observed quantities, as compiled functions of scalars.

    ``y`` are the components of the state, ``dy`` its derivative, ``q`` the constants of
    the body.
    """

    name: str
    n_state: int
    n_constants: int
    n_probe: int
    rhs: Callable[..., Any]  # rhs(*y, *q): dy
    spin: Callable[..., Any]  # spin(*y)
    spin_rate: Callable[..., Any]  # spin_rate(*y, *dy)
    amplitude: Callable[
        ..., Any
    ]  # amplitude(*y, *probe): of the relevant oscillation, squared
    # error(*e, *y, *q): squares of the error e of a step and of the oscillation to
    # compare it with
    error: Callable[..., Any]
    energy: Callable[
        ..., Any
    ]  # energy(*y, *q): conserved; with friction, the energy minus work
    contact: Callable[..., Any]  # contact(*y, *q): normal and tangential force
    touch: Callable[..., Any] | None = (
        None  # the contact, as physics.full.paraboloid returns it
    )
    volume: Callable[..., Any] | None = None  # volume(*y, *q): rate of phase volume
    anywhere: Model | None = (
        None  # the same equations in variables that exist in any position
    )
    n_extra: int = (
        0  # number of components, the last ones, that the state of a sweep lacks
    )
    # Functions x of the state that are cheaper to integrate beside it than to compute
    # in each stage.  carried_start(*y, *q): x at the start of a step.  carried_rhs(*y,
    # *x, *q): dy and dx.
    n_carried: int = 0
    carried_start: Callable[..., Any] | None = None
    carried_rhs: Callable[..., Any] | None = None
    # For runs with a tangent v, a small difference.  rate(*y, *dy, *v, *q): dv.
    # seed(*y, *q): the first v.  transverse(*y, *dy, *v, *q): the part that is
    # measured.  square(*v, *q): |v|^2.
    rate: Callable[..., Any] | None = None
    seed: Callable[..., Any] | None = None
    transverse: Callable[..., Any] | None = None
    square: Callable[..., Any] | None = None


def _compiled(model: str, **functions: Callable[..., Any]) -> dict[str, Any]:
    """Return compiled functions; Numba makes symbols of their names, so these name the
    model.
    """
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
    return vectors.smooth_volume(
        -p, -q, -1.0, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, 0.0
    )


FULL = Model(
    "full",
    full.N_STATE,
    full.N_CONSTANTS,
    8,
    rhs=full.rhs,
    spin=full.spin,
    amplitude=_amplitude,
    error=_error,
    energy=full.energy,
    contact=full.contact_force,
    touch=full.paraboloid,
    **_compiled(
        "full",
        spin_rate=lambda *v: full.spin_rate(*(v[:2] + v[7:])),
        volume=lambda *v: _volume(*v, 0.0),
    ),
)


# The rise of an ellipsoid's contact point is integrated beside the state, since a
# square root in each stage would take longer (docs/design.md).


@full.scalar
def _rise(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):
    _, rise = stone.shape_at(p, q, cxx, cxy, cyy, k)
    return (rise,)


@full.scalar
def _rise_rhs(p, q, a, b, c, rise, ix, iy, iz, cxx, cxy, cyy, k):
    surface = stone.carried_ellipsoid
    f = stone.frictionless_rhs(
        surface, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, (k, rise)
    )
    return f + (stone.rise_rate(p, q, f[0], f[1], cxx, cxy, cyy, k, rise),)  # noqa: RUF005


# The error of the spin is judged as if the oscillation had at least this share of its
# energy.
SPIN_KNOWN = 1e-14


@full.scalar
def _friction_error(
    ep,
    eq,
    ea,
    eb,
    ec,
    ework,
    p,
    q,
    a,
    b,
    c,
    work,
    ix,
    iy,
    iz,
    cxx,
    cxy,
    cyy,
    k,
    sigma,
    lever,
    eps,
):
    # Friction changes the spin in every step; rounding errors of the spin must not
    # reject a step.
    size = full.oscillation(p, q, a, b, ix, iy, cxx, cxy, cyy) + 1e-290
    known = min(1.0, size / (SPIN_KNOWN * iz * c * c + 1e-290))
    return full.oscillation(
        ep, eq, ea, eb, ix, iy, cxx, cxy, cyy
    ) + known * iz * ec * ec, size


@full.scalar
def _vectors_error(eu, ev, ew, ea, eb, ec, ework, u, v, w, a, *rest):
    step, size = _friction_error(eu, ev, ea, eb, ec, ework, u, v, a, *rest)
    return step + ew * ew, size


VECTORS = Model(
    "vectors",
    vectors.N_STATE,
    stone.N_FRICTION_CONSTANTS,
    FULL.n_probe,
    rhs=vectors.rhs,
    spin=vectors.spin,
    error=_vectors_error,
    energy=vectors.energy,
    contact=vectors.contact_force,
    volume=vectors.volume,
    **_compiled(
        "vectors",
        spin_rate=lambda *v: vectors.spin(*(v[:3] + v[10:])),
        # Near the upright position the slopes are -u_x and -u_y.
        amplitude=lambda u, v, w, a, b, c, work, *probe: _amplitude(
            -u, -v, a, b, c, *probe
        ),
    ),
)

ELLIPSOID = replace(
    FULL,
    name="ellipsoid",
    n_constants=stone.N_CONSTANTS,
    rhs=stone.rhs,
    energy=stone.energy,
    contact=stone.contact_force,
    touch=stone.ellipsoid,
    volume=_volume,
    anywhere=VECTORS,
    n_carried=1,
    carried_start=_rise,
    carried_rhs=_rise_rhs,
    **_compiled("ellipsoid", error=lambda *v: _error(*v[:-1])),
)


def _with_friction(plain: Model, kind: str, rhs_on: Callable[..., Any]) -> Model:
    """Return the model of the same surface with friction; ``rhs_on`` is a function of
    `stone`.
    """
    surface = stone.ellipsoid if plain is ELLIPSOID else stone.paraboloid_contact
    plain_energy, end = plain.energy, 6 + plain.n_constants

    # A function among starred arguments would be of Numba's experimental first-class
    # type.
    def rhs(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
        return rhs_on(
            surface,
            p,
            q,
            a,
            b,
            c,
            work,
            ix,
            iy,
            iz,
            cxx,
            cxy,
            cyy,
            k,
            sigma,
            lever,
            eps,
        )

    def contact(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
        dp, dq, da, db, dc, _ = rhs_on(
            surface,
            p,
            q,
            a,
            b,
            c,
            work,
            ix,
            iy,
            iz,
            cxx,
            cxy,
            cyy,
            k,
            sigma,
            lever,
            eps,
        )
        return stone.surface_force(
            surface, p, q, a, b, c, dp, dq, da, db, dc, cxx, cxy, cyy, k
        )

    def rise_rhs(
        p, q, a, b, c, work, rise, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps
    ):
        f = rhs_on(
            stone.carried_ellipsoid,
            p,
            q,
            a,
            b,
            c,
            work,
            ix,
            iy,
            iz,
            cxx,
            cxy,
            cyy,
            (k, rise),
            sigma,
            lever,
            eps,
        )
        return f + (stone.rise_rate(p, q, f[0], f[1], cxx, cxy, cyy, k, rise),)  # noqa: RUF005

    name = f"{plain.name}_{kind}"
    functions = _compiled(
        name,
        rhs=rhs,
        spin=lambda *v: full.spin(*v[:5]),
        spin_rate=lambda *v: full.spin_rate(*(v[:2] + v[8:11])),
        amplitude=lambda *v: _amplitude(*(v[:5] + v[6:])),
        energy=lambda *v: plain_energy(*(v[:5] + v[6:end])) - v[5],
        contact=contact,
        volume=lambda p, q, *rest: vectors.volume(-p, -q, -1.0, *rest),
        carried_start=lambda *v: _rise(*(v[:5] + v[6:13])),
        carried_rhs=rise_rhs,
    )
    functions |= {
        "n_state": stone.N_FRICTION_STATE,
        "n_constants": stone.N_FRICTION_CONSTANTS,
    }
    return replace(plain, name=name, error=_friction_error, touch=surface, **functions)


FRICTION = {
    (plain.name, name): _with_friction(plain, name, rhs)
    for plain in (FULL, ELLIPSOID)
    for name, rhs in (("viscous", stone.viscous_rhs), ("rolling", stone.rolling_rhs))
}
"""Models with friction, by the name of the model without it and the kind of friction.
"""


@full.scalar
def _reduced_error(dn, de_p, de_r, n, e_p, e_r, k_p, k_r, inertia):
    # Each energy is compared with itself: the decaying one determines what happens much
    # later.
    spin = inertia * dn * dn / (inertia * n * n + 2.0 * (e_p + e_r) + 1e-290)
    pitch = de_p * de_p / (e_p * e_p + 1e-290)
    roll = de_r * de_r / (e_r * e_r + 1e-290)
    return spin + pitch + roll, 1.0


REDUCED = Model(
    "reduced",
    reduced.N_STATE,
    reduced.N_CONSTANTS,
    2,
    rhs=reduced.rhs,
    error=_reduced_error,
    energy=reduced.energy,
    **_compiled(
        "reduced",
        spin=lambda n, e_p, e_r: n,
        spin_rate=lambda n, e_p, e_r, dn, de_p, de_r: dn,
        amplitude=lambda n, e_p, e_r, w_p, w_r: w_p * e_p + w_r * e_r,
        contact=lambda *v: (1.0, 0.0),
    ),
)


def _with_attitude(plain: Model) -> Model:
    """Return a model with heading and contact point on the plane, for single steps."""
    n, own_rhs, touch = plain.n_state, plain.rhs, plain.touch
    n_all = n + full.N_EXTRA

    def rhs(*v: float) -> Any:
        y, constants = v[:n], v[n_all:]
        p, q, a, b, c = y[:5]
        f = own_rhs(*(y + constants))
        m = p * b - q * a
        # The constants of the surface follow those of inertia.
        contact = touch(p, q, a, b, c, f[0], f[1], m, *constants[3:7])  # type: ignore[misc]
        return f + full.track(p, q, a, b, c, v[n], *contact)

    name = f"{plain.name}_attitude"
    nothing = {word: lambda *v: 0.0 for word in ("spin", "spin_rate", "amplitude")}
    functions = _compiled(name, rhs=rhs, error=lambda *v: (0.0, 1.0), **nothing)
    functions |= {
        "n_state": n_all,
        "n_probe": 0,
        "n_extra": full.N_EXTRA,
        "n_carried": 0,
    }
    return replace(plain, name=name, **functions)


TANGENT = replace(
    FULL,
    name="full_tangent",
    rate=tangent.rate,
    seed=tangent.seed,
    transverse=tangent.transverse,
    square=tangent.square,
)
"""The full model with a tangent, for the largest Lyapunov exponent."""

ATTITUDES = {
    plain.name: _with_attitude(plain) for plain in (FULL, ELLIPSOID, *FRICTION.values())
}
"""Models with heading and contact point, by the name of the model without them."""

PLAIN = FULL, ELLIPSOID, VECTORS, *FRICTION.values(), REDUCED
MODELS: dict[str, Model] = {model.name: model for model in (*PLAIN, TANGENT)}


def find_model(name: str) -> Model:
    """Return a model of :data:`MODELS` or :data:`ATTITUDES` by its own name."""
    return MODELS.get(name) or ATTITUDES[name.removesuffix("_attitude")]
