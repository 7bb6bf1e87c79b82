"""Models: the equations of motion and observed quantities that kernels are made for.

The models of rolling bodies are made of a :class:`~rattlesweep.physics.surface.Surface`
and, with friction, a law (:class:`~rattlesweep.physics.surface.Friction`).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

from rattlesweep.arrays import Floats
from rattlesweep.physics import (
    frame,
    full,
    reduced,
    sliding,
    stone,
    surface,
    tangent,
    vectors,
)
from rattlesweep.physics.full import scalar
from rattlesweep.physics.surface import Formula, Friction, Surface


@dataclass(frozen=True)
class Slide:
    """What a model needs for sliding, with states ``y`` and constants ``q`` as tuples.

    The coefficient of friction is a further constant of the body, after ``q``.
    """

    # place(y, q): rates of the position, u, omega, r, w, inertia, and the torques of
    # friction as `physics.surface.Friction.couples` returns them
    place: Formula
    # derivative(y, slip, what `place` returns, domega/dt, power of friction): dy
    derivative: Formula
    has_work: bool  # whether the state has the work of friction
    # Slope beyond which the state says too little about the contact for a slide to
    # begin; such a run is integrated again in the variables of `Model.anywhere`.
    steepest: float = inf


@dataclass(frozen=True)
class Model:
    """Equations of motion and observed quantities, as compiled functions of scalars.

    ``y`` are the components of the state, ``dy`` its derivative, ``q`` the constants of
    the body.  In the formulas below, ``p, q`` are slopes and ``a, b, c`` the components
    of the angular velocity; a probe is the real and the imaginary part of the left
    eigenvector of the relevant mode.  A term 1e-290 prevents a division by zero.
    """

    name: str
    n_state: int
    constants: tuple[str, ...]  # names of ``q``
    n_probe: int  # coefficients of the relevant amplitude
    rhs: Formula  # rhs(*y, *q): dy
    spin: Formula  # spin(*y)
    spin_rate: Formula  # spin_rate(*y, *dy)
    # amplitude(*y, *probe): square of the amplitude of the relevant oscillation
    amplitude: Formula
    # error(*e, *y, *q): squares of the error e of a step and of the oscillation to
    # compare it with
    error: Formula
    energy: Formula  # energy(*y, *q): conserved; with friction, the energy minus work
    contact: Formula  # contact(*y, *q): normal force, then tangential force
    # limit(*y, *q): positive where the model holds; a run ends where it is zero
    limit: Formula | None = None
    # rise(*y, *q): height of the contact over the lowest point of the body, along its z
    # axis; None for models without a contact point
    rise: Formula | None = None
    # without it the plane holds the body whatever the force
    slide: Slide | None = None
    surface: Surface | None = None
    law: Friction | None = None  # of a model with friction
    volume: Formula | None = None  # volume(*y, *q): rate of phase volume
    # The same equations in variables that exist in any position.
    anywhere: Model | None = None
    # The same equations for the constant ``k = 0``, where the surface is a paraboloid.
    flat: Model | None = None
    # Number of components, the last ones, that the state of a sweep lacks.
    n_extra: int = 0
    # Functions x of the state that are cheaper to integrate beside it than to compute
    # in each stage.  carried_start(*y, *q): x at the start of a step.  carried_rhs(*y,
    # *x, *q): dy and dx.
    n_carried: int = 0
    carried_start: Formula | None = None
    carried_rhs: Formula | None = None
    # For runs with tangents, small differences, whose components follow each other in
    # ``v``.  The arguments are tuples.  rate(y, dy, v, q): dv.  seed(y, q): the first
    # v.  transverse(y, dy, v, q): the part that is measured.
    n_tangents: int = 0
    rate: Formula | None = None
    seed: Formula | None = None
    transverse: Formula | None = None
    square: Formula | None = None  # square(*v, *q): |v|^2 of one tangent
    # Of a frame of several tangents: factor(v, q): the triangle R of its factors QR.
    # solve(v, R): the tangents Q.  trivial(y, dy, q): squared norms of the flow and of
    # the gradient of the energy.
    factor: Formula | None = None
    solve: Formula | None = None
    trivial: Formula | None = None

    @property
    def n_constants(self) -> int:
        """The number of constants ``q``."""
        return len(self.constants)

    @property
    def of_runs(self) -> tuple[str, ...]:
        """The names of all constants of a run: ``q``, and what slides need."""
        if self.slide is None:
            return self.constants
        return *self.constants, "mu"

    def named(self, values: Floats) -> dict[str, Floats]:
        """Return constants of runs, one in each row of `values`, by their names."""
        return dict(zip(self.of_runs, values, strict=True))


# Bodies that roll without friction: slopes and angular velocity.


@scalar
def _spin_rate(p, q, a, b, c, dp, dq, da, db, dc):
    return full.spin_rate(p, q, da, db, dc)


@scalar
def _amplitude(p, q, a, b, c, p0, q0, a0, b0, p1, q1, a1, b1):
    real = p0 * p + q0 * q + a0 * a + b0 * b
    imag = p1 * p + q1 * q + a1 * a + b1 * b
    return real * real + imag * imag


@scalar
def _error(ep, eq, ea, eb, ec, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k=0.0):
    step = full.oscillation(ep, eq, ea, eb, ix, iy, cxx, cxy, cyy) + iz * ec * ec
    return step, full.oscillation(p, q, a, b, ix, iy, cxx, cxy, cyy) + 1e-290


@scalar
def _volume(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k=0.0):
    return vectors.smooth_volume(
        -p, -q, -1.0, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, 0.0
    )


def _rise(touch: Formula, *, has_work: bool) -> Formula:
    """Return the height of a surface's contact, as `Model.rise`."""

    @scalar
    def rise(p, q, a, b, c, ix, iy, iz, *shape):
        _, _, height, _, _, _, _ = touch(p, q, a, b, c, 0.0, 0.0, 0.0, *shape)
        return height

    @scalar
    def rise_with_work(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, *loss):
        return rise(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k)

    formula: Formula = rise_with_work if has_work else rise
    return formula


FULL = Model(
    "full",
    full.N_STATE,
    full.CONSTANTS,
    n_probe=8,
    rhs=full.rhs,
    spin=full.spin,
    spin_rate=_spin_rate,
    amplitude=_amplitude,
    error=_error,
    energy=full.energy,
    contact=full.contact_force,
    rise=_rise(full.paraboloid, has_work=False),
    surface=surface.PARABOLOID,
    volume=_volume,
)


@scalar
def _tangent_rate(y, dy, v, q):
    return tangent.rate(*(y + dy + v + q))


@scalar
def _tangent_seed(y, q):
    return tangent.seed(*(y + q))


@scalar
def _tangent_transverse(y, dy, v, q):
    return tangent.transverse(*(y + dy + v + q))


TANGENT = replace(
    FULL,
    name="full_tangent",
    n_tangents=1,
    rate=_tangent_rate,
    seed=_tangent_seed,
    transverse=_tangent_transverse,
    square=tangent.square,
)
"""The full model with a tangent, for the largest Lyapunov exponent."""

FRAME = replace(
    FULL,
    name="full_frame",
    n_tangents=frame.N_TANGENTS,
    rate=frame.rate,
    seed=frame.seed,
    transverse=frame.transverse,
    factor=frame.factor,
    solve=frame.solve,
    trivial=frame.trivial,
)
"""The full model with three tangents, for all Lyapunov exponents."""


# Bodies that roll with friction: the state has the work as its sixth component.


# The error of the spin is scaled as if the oscillation held at least this fraction of
# the spin's energy.
SPIN_KNOWN = 1e-14


@scalar
def _weighted_error(ep, eq, ea, eb, ec, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy):
    """Return the squares of the error and of the oscillation.

    Friction changes the spin in every step; rounding errors of the spin must not reject
    a step.
    """
    size = full.oscillation(p, q, a, b, ix, iy, cxx, cxy, cyy) + 1e-290
    weight = min(1.0, size / (SPIN_KNOWN * iz * c * c + 1e-290))
    step = full.oscillation(ep, eq, ea, eb, ix, iy, cxx, cxy, cyy)
    return step + weight * iz * ec * ec, size


@scalar
def _error_with_friction(
    ep, eq, ea, eb, ec, ework, p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, *loss
):
    return _weighted_error(ep, eq, ea, eb, ec, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy)


@scalar
def _spin_with_work(p, q, a, b, c, work):
    return full.spin(p, q, a, b, c)


@scalar
def _spin_rate_with_work(p, q, a, b, c, work, dp, dq, da, db, dc, power):
    return full.spin_rate(p, q, da, db, dc)


@scalar
def _amplitude_with_work(p, q, a, b, c, work, p0, q0, a0, b0, p1, q1, a1, b1):
    return _amplitude(p, q, a, b, c, p0, q0, a0, b0, p1, q1, a1, b1)


@scalar
def _volume_with_friction(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, *loss):
    return vectors.volume(
        -p, -q, -1.0, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, *loss
    )


# Bodies in any position, with or without friction.


@scalar
def _vectors_spin_rate(vx, vy, vz, a, b, c, work, dvx, dvy, dvz, da, db, dc, power):
    return vectors.spin(vx, vy, vz, da, db, dc, work)


@scalar
def _vectors_amplitude(vx, vy, vz, a, b, c, work, p0, q0, a0, b0, p1, q1, a1, b1):
    # Near the upright position the slopes are -u_x and -u_y.
    return _amplitude(-vx, -vy, a, b, c, p0, q0, a0, b0, p1, q1, a1, b1)


@scalar
def _vectors_error(
    ex,
    ey,
    ez,
    ea,
    eb,
    ec,
    ework,
    vx,
    vy,
    vz,
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
    *loss,
):
    step, size = _weighted_error(
        ex, ey, ea, eb, ec, vx, vy, a, b, c, ix, iy, iz, cxx, cxy, cyy
    )
    return step + ez * ez, size


@scalar
def _vectors_rise(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, *loss):
    u = vectors.unit(vx, vy, vz)
    (_, _, z), _ = vectors.contact(*u, cxx, cxy, cyy, k)
    return 1.0 - z


VECTORS = Model(
    "vectors",
    vectors.N_STATE,
    vectors.CONSTANTS,
    FULL.n_probe,
    rhs=vectors.rhs,
    spin=vectors.spin,
    spin_rate=_vectors_spin_rate,
    amplitude=_vectors_amplitude,
    error=_vectors_error,
    energy=vectors.energy,
    contact=vectors.contact_force,
    rise=_vectors_rise,
    volume=vectors.volume,
)


# Other surfaces and friction, from the records of `physics.surface`.


def _frictionless(on: Surface) -> Model:
    """Return the model of a surface with a further constant ``k``, without friction."""
    touch = on.contact

    @scalar
    def rhs(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):
        shape = cxx, cxy, cyy, k
        return stone.frictionless_rhs(touch, p, q, a, b, c, (ix, iy, iz), shape)

    @scalar
    def contact(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):
        dp, dq, da, db, dc = rhs(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k)
        shape = cxx, cxy, cyy, k
        return stone.surface_force(touch, p, q, a, b, c, dp, dq, da, db, dc, shape)

    model = replace(
        FULL,
        name=on.model,
        constants=stone.CONSTANTS,
        rhs=rhs,
        energy=on.energy,
        contact=contact,
        rise=_rise(touch, has_work=False),
        surface=on,
        volume=_volume if on.quadric else None,
        anywhere=VECTORS if on.closed else None,
        flat=FULL,
    )
    if on.carried is None:
        return model
    start_at = on.carried.start
    rate_at = on.carried.rate
    carried_touch = on.carried.contact

    @scalar
    def start(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):
        return (start_at(p, q, cxx, cxy, cyy, k),)

    @scalar
    def carried_rhs(p, q, a, b, c, x, ix, iy, iz, cxx, cxy, cyy, k):
        shape = cxx, cxy, cyy, k, x
        f = stone.frictionless_rhs(carried_touch, p, q, a, b, c, (ix, iy, iz), shape)
        dp, dq, _, _, _ = f
        return f + (rate_at(p, q, dp, dq, *shape),)  # noqa: RUF005

    return replace(model, n_carried=1, carried_start=start, carried_rhs=carried_rhs)


def _rhs_of(law: Friction) -> Formula:
    """Return the equations of a law that has no form of its own."""
    couples = law.couples

    @scalar
    def rhs(touch, y, inertia, shape, loss):
        return stone.rhs_of_couples(couples, touch, y, inertia, shape, loss)

    formula: Formula = rhs
    return formula


def _with_friction(rolling: Model, law: Friction) -> Model:
    """Return the model of the same surface with a law of friction."""
    on = rolling.surface
    assert on is not None
    touch = on.contact
    surface_energy = on.energy
    law_rhs = law.rhs or _rhs_of(law)

    @scalar
    def rhs(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, *loss):
        y = p, q, a, b, c, work
        shape = cxx, cxy, cyy, k
        return law_rhs(touch, y, (ix, iy, iz), shape, loss)

    @scalar
    def contact(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, *loss):
        y = p, q, a, b, c, work
        shape = cxx, cxy, cyy, k
        f = law_rhs(touch, y, (ix, iy, iz), shape, loss)
        dp, dq, da, db, dc, _ = f
        return stone.surface_force(touch, p, q, a, b, c, dp, dq, da, db, dc, shape)

    @scalar
    def energy(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, *loss):
        return surface_energy(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k) - work

    model = replace(
        rolling,
        name=f"{rolling.name}_{law.name}",
        n_state=stone.N_FRICTION_STATE,
        constants=(*stone.CONSTANTS, *law.constants),
        rhs=rhs,
        spin=_spin_with_work,
        spin_rate=_spin_rate_with_work,
        amplitude=_amplitude_with_work,
        error=_error_with_friction,
        energy=energy,
        contact=contact,
        rise=_rise(touch, has_work=True),
        volume=_volume_with_friction if on.quadric and law.in_vectors else None,
        law=law,
        anywhere=rolling.anywhere if law.in_vectors else None,
    )
    if on.carried is None:
        return model
    start_at = on.carried.start
    rate_at = on.carried.rate
    carried_touch = on.carried.contact

    @scalar
    def start(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, *loss):
        return (start_at(p, q, cxx, cxy, cyy, k),)

    @scalar
    def carried_rhs(p, q, a, b, c, work, x, ix, iy, iz, cxx, cxy, cyy, k, *loss):
        y = p, q, a, b, c, work
        shape = cxx, cxy, cyy, k, x
        f = law_rhs(carried_touch, y, (ix, iy, iz), shape, loss)
        dp, dq, _, _, _, _ = f
        return f + (rate_at(p, q, dp, dq, *shape),)  # noqa: RUF005

    return replace(model, carried_start=start, carried_rhs=carried_rhs)


FRICTIONLESS = {FULL.name: FULL}
FRICTIONLESS |= {each.model: _frictionless(each) for each in surface.FURTHER}
"""Models of the surfaces without friction, by their names."""

ELLIPSOID = FRICTIONLESS[surface.ELLIPSOID.model]


def _all_with_friction() -> dict[tuple[str, str], Model]:
    """Return the models with friction by those without and the law."""
    models = {}
    for law in surface.LAWS.values():
        flat = _with_friction(FULL, law)
        models[FULL.name, law.name] = flat
        for rolling in FRICTIONLESS.values():
            if rolling is not FULL:
                model = replace(_with_friction(rolling, law), flat=flat)
                models[rolling.name, law.name] = model
    return models


FRICTION = _all_with_friction()
"""Models with friction, by the names of the model without it and of the law."""


# Sliding, where friction cannot hold the contact point.


@scalar
def _without_work(y, slip, placed, omega_rate, power):
    return placed[0] + omega_rate


@scalar
def _with_work(y, slip, placed, omega_rate, power):
    return placed[0] + omega_rate + (power,)


@scalar
def _contact_of_slope(touch, p, q, a, b, c, shape):
    dp, dq, m = full.slope_rate(p, q, a, b, c)
    fx, fy, rise, wx, wy, wz, uz = touch(p, q, a, b, c, dp, dq, m, *shape)
    u = p * uz, q * uz, uz
    r = p + fx, q + fy, 1.0 - rise
    return (dp, dq), u, (a, b, c), r, (wx, wy, wz)


@scalar
def _inertia_and_shape(ix, iy, iz, *shape):
    return (ix, iy, iz), shape


@scalar
def _inertia_shape_and_loss(ix, iy, iz, cxx, cxy, cyy, k, *loss):
    return (ix, iy, iz), (cxx, cxy, cyy, k), loss


_NONE = 0.0, 0.0, 0.0


def _sliding(rolling: Model, law: Friction | None) -> Model:
    """Return a model of slopes whose bodies slide where friction cannot hold them."""
    on = rolling.surface
    assert on is not None
    touch = on.contact

    @scalar
    def place(y, constants):
        p, q, a, b, c = y
        inertia, shape = _inertia_and_shape(*constants)
        rates, u, omega, r, w = _contact_of_slope(touch, p, q, a, b, c, shape)
        return rates, u, omega, r, w, inertia, _NONE, _NONE

    if law is None:
        slide = Slide(place, _without_work, has_work=False)
        return replace(rolling, name=f"{rolling.name}_sliding", slide=slide)
    couples = law.couples

    @scalar
    def place_with_friction(y, constants):
        p, q, a, b, c, _ = y
        inertia, shape, loss = _inertia_shape_and_loss(*constants)
        rates, u, omega, r, w = _contact_of_slope(touch, p, q, a, b, c, shape)
        torque, drag = couples(u, omega, loss)
        return rates, u, omega, r, w, inertia, torque, drag

    slide = Slide(place_with_friction, _with_work, has_work=True)
    return replace(rolling, name=f"{rolling.name}_sliding", slide=slide)


@scalar
def _place_in_any_position(y, constants):
    vx, vy, vz, a, b, c, _ = y
    inertia, shape, loss = _inertia_shape_and_loss(*constants)
    u = vectors.unit(vx, vy, vz)
    omega = a, b, c
    r, rho = vectors.contact(*u, *shape)
    w = vectors.moving(u, omega, r, rho, *shape)
    torque, drag = stone.rolling_couples(u, omega, loss)
    rates = vy * c - vz * b, vz * a - vx * c, vx * b - vy * a
    return rates, u, omega, r, w, inertia, torque, drag


VECTORS_SLIDING = replace(
    VECTORS,
    name="vectors_sliding",
    slide=Slide(_place_in_any_position, _with_work, has_work=True),
)


STEEPEST = 100.0


def _all_sliding() -> dict[str, Model]:
    """Return the sliding models by the names of the models without sliding."""
    models = {}
    for rolling in FRICTIONLESS.values():
        models[rolling.name] = _sliding(rolling, None)
        for law in surface.LAWS.values():
            damped = FRICTION[rolling.name, law.name]
            models[damped.name] = _sliding(damped, law)
    for name, model in models.items():
        if model.anywhere is not None and model.slide is not None:
            slide = replace(model.slide, steepest=STEEPEST)
            model = replace(model, slide=slide, anywhere=VECTORS_SLIDING)
        if model.flat is not None:
            model = replace(model, flat=models[model.flat.name])
        models[name] = model
    return models


SLIDING = _all_sliding()
"""Models of bodies that slide, by the name of the model that always rolls."""


# The reduced model.


@scalar
def _reduced_spin(n, e_p, e_r):
    return n


@scalar
def _reduced_spin_rate(n, e_p, e_r, dn, de_p, de_r):
    return dn


@scalar
def _reduced_amplitude(n, e_p, e_r, w_p, w_r):
    return w_p * e_p + w_r * e_r


@scalar
def _reduced_contact(n, e_p, e_r, k_p, k_r, inertia):
    return 1.0, 0.0


@scalar
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
    reduced.CONSTANTS,
    n_probe=2,
    rhs=reduced.rhs,
    spin=_reduced_spin,
    spin_rate=_reduced_spin_rate,
    amplitude=_reduced_amplitude,
    error=_reduced_error,
    energy=reduced.energy,
    contact=_reduced_contact,
)


# Heading and contact point on the plane, which single steps add to the state.


@scalar
def _zero(*y):
    return 0.0


@scalar
def _no_error(*values):
    return 0.0, 1.0


@scalar
def _sliding_track(placed, slip, heading):
    _, u, omega, r, w, _, _, _ = placed
    return sliding.track(u, omega, r, w, slip.speed, slip.angle, heading)


def _slide_with_attitude(plain: Slide) -> Slide:
    """Return what a model with heading and contact point needs for sliding."""
    plain_place = plain.place

    @scalar
    def place(y, constants):
        p, q, a, b, c, _, _, _ = y
        return plain_place((p, q, a, b, c), constants)

    @scalar
    def place_with_work(y, constants):
        p, q, a, b, c, work, _, _, _ = y
        return plain_place((p, q, a, b, c, work), constants)

    @scalar
    def derivative(y, slip, placed, omega_rate, power):
        _, _, _, _, _, heading, _, _ = y
        return placed[0] + omega_rate + _sliding_track(placed, slip, heading)

    @scalar
    def derivative_with_work(y, slip, placed, omega_rate, power):
        _, _, _, _, _, _, heading, _, _ = y
        track = _sliding_track(placed, slip, heading)
        return placed[0] + omega_rate + (power,) + track

    if plain.has_work:
        return Slide(place_with_work, derivative_with_work, has_work=True)
    return Slide(place, derivative, has_work=False)


def _with_attitude(plain: Model) -> Model:
    """Return a model with heading and contact point on the plane, for single steps."""
    assert plain.surface is not None
    touch = plain.surface.contact
    plain_rhs = plain.rhs

    @scalar
    def rhs(p, q, a, b, c, heading, x, y, ix, iy, iz, *shape):
        f = plain_rhs(p, q, a, b, c, ix, iy, iz, *shape)
        contact = touch(p, q, a, b, c, f[0], f[1], p * b - q * a, *shape)
        return f + full.track(p, q, a, b, c, heading, *contact)

    @scalar
    def rhs_with_work(
        p, q, a, b, c, work, heading, x, y, ix, iy, iz, cxx, cxy, cyy, k, *loss
    ):
        f = plain_rhs(p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, *loss)
        m = p * b - q * a
        contact = touch(p, q, a, b, c, f[0], f[1], m, cxx, cxy, cyy, k)
        return f + full.track(p, q, a, b, c, heading, *contact)

    has_work = plain.n_state == stone.N_FRICTION_STATE
    slide = None
    if plain.slide is not None:
        slide = _slide_with_attitude(plain.slide)
    return replace(
        plain,
        name=f"{plain.name}_attitude",
        n_state=plain.n_state + full.N_EXTRA,
        n_probe=0,
        n_extra=full.N_EXTRA,
        n_carried=0,
        rhs=rhs_with_work if has_work else rhs,
        slide=slide,
        spin=_zero,
        spin_rate=_zero,
        amplitude=_zero,
        error=_no_error,
    )


# In any position no heading is defined, so single steps add the rotation and the path
# since their start.


@scalar
def _position(vx, vy, vz, a, b, c, work, turned, qx, qy, qz, x, y, z):
    return (vx, vy, vz, a, b, c, work), (turned, qx, qy, qz)


@scalar
def _rotating_rhs(
    vx,
    vy,
    vz,
    a,
    b,
    c,
    work,
    turned,
    qx,
    qy,
    qz,
    x,
    y,
    z,
    ix,
    iy,
    iz,
    cxx,
    cxy,
    cyy,
    k,
    *loss,
):
    f = vectors.rhs(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, *loss)
    omega = a, b, c
    velocity = vectors.rolled(vectors.unit(vx, vy, vz), omega, (cxx, cxy, cyy, k))
    return f + vectors.carried_on((turned, qx, qy, qz), omega, velocity)


@scalar
def _rotating_place(y, constants):
    state, _ = _position(*y)
    return _place_in_any_position(state, constants)


@scalar
def _rotating_derivative(y, slip, placed, omega_rate, power):
    rates, u, omega, r, w, _, _, _ = placed
    _, rotation = _position(*y)
    x, y, z = sliding.cross(r, omega)
    wx, wy, wz = w
    ex, ey, ez = sliding.direction(u, slip.angle)
    velocity = (
        x - wx + slip.speed * ex,
        y - wy + slip.speed * ey,
        z - wz + slip.speed * ez,
    )
    moved = vectors.carried_on(rotation, omega, velocity)
    return rates + omega_rate + (power,) + moved


def _with_rotation(plain: Model) -> Model:
    """Return a model in any position with rotation and path, for single steps."""
    slide = None
    if plain.slide is not None:
        slide = Slide(_rotating_place, _rotating_derivative, has_work=True)
    return replace(
        plain,
        name=f"{plain.name}_attitude",
        n_state=plain.n_state + vectors.N_EXTRA,
        n_probe=0,
        n_extra=vectors.N_EXTRA,
        rhs=_rotating_rhs,
        slide=slide,
        spin=_zero,
        spin_rate=_zero,
        amplitude=_zero,
        error=_no_error,
    )


ATTITUDES = {
    plain.name: _with_attitude(plain)
    for plain in (*FRICTIONLESS.values(), *FRICTION.values(), *SLIDING.values())
}
ATTITUDES |= {plain.name: _with_rotation(plain) for plain in (VECTORS, VECTORS_SLIDING)}
"""Models of single steps that add the attitude, by the name of the model without it."""

PLAIN = *FRICTIONLESS.values(), VECTORS, *FRICTION.values(), REDUCED
SLIDING_MODELS = *SLIDING.values(), VECTORS_SLIDING
MODELS: dict[str, Model] = {
    model.name: model for model in (*PLAIN, TANGENT, FRAME, *SLIDING_MODELS)
}


def find_model(name: str) -> Model:
    """Return a model of :data:`MODELS` or :data:`ATTITUDES` by its own name."""
    return MODELS.get(name) or ATTITUDES[name.removesuffix("_attitude")]
