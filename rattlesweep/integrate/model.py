"""Models: the equations of motion and observed quantities that kernels are made for.

The models of rolling bodies are made of a :class:`~rattlesweep.physics.surface.Surface`
and, with friction, a law (:class:`~rattlesweep.physics.surface.Friction`).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, sqrt

from rattlesweep.arrays import Floats
from rattlesweep.physics import (
    frame,
    full,
    pivoting,
    reduced,
    sliding,
    stone,
    surface,
    tangent,
    vectors,
)
from rattlesweep.physics.full import TINY, scalar
from rattlesweep.physics.surface import Formula, Friction, Surface


@dataclass(frozen=True)
class Slide:
    """What a model needs for sliding.

    Formulas take tuples as those of :class:`Model` do.  The coefficient of friction is
    a further constant of a run, after ``constants``.
    """

    # place(y, creep, constants): rates of the position, u, omega, r, w, inertia, and
    # torques of friction as `physics.surface.Friction.couples` returns them
    place: Formula
    # derivative(y, slip, what `place` returns, domega/dt, normal force): dy
    derivative: Formula
    # turned(y, u, rate): y with the angular velocity changed by rate u
    turned: Formula
    # Slope beyond which the state says too little about the contact for a slide to
    # begin; such a run is integrated again in the variables of `Model.anywhere`.
    steepest: float = inf


@dataclass(frozen=True)
class Model:
    """Equations of motion and observed quantities, as compiled functions of numbers.

    The formulas take tuples of numbers: the state ``y``, its derivative ``dy`` and the
    ``constants`` of the body.  What a model does not have is None.
    """

    name: str
    n_state: int
    constants: tuple[str, ...]  # their names
    # Numbers in a ``probe``, which tells the relevant mode: for bodies its left
    # eigenvector, first the real part.
    n_probe: int
    rhs: Formula  # rhs(y, constants): dy
    spin: Formula  # spin(y)
    spin_rate: Formula  # spin_rate(y, dy)
    # amplitude(y, probe): square of the amplitude of the relevant oscillation
    amplitude: Formula
    # error(e, y, constants): two squares that a step control compares: that of the
    # error e of a step, and that of the oscillation
    error: Formula
    # energy(y, constants): conserved; with friction, the energy minus work
    energy: Formula
    # force(y, dy, constants): normal force, then the square of the tangential force
    force: Formula
    work: Formula  # work(y): work of friction since the launch, negative

    # Where a run ends or changes.
    # limit(y, constants): positive where the model holds; a run ends where it is zero
    limit: Formula | None = None
    # rise(y, constants): height of the contact over the lowest point of the body, along
    # its z axis; None for models without a contact point
    rise: Formula | None = None
    slide: Slide | None = None  # None: the plane holds the body whatever the force

    # What the model is made of.
    surface: Surface | None = None
    law: Friction | None = None  # of a model with friction
    # Of a law with a torque against pivoting.  pivot(y, constants): the torque along
    # the vertical and the normal force.  pivot_work(y): its work, negative.
    pivot: Formula | None = None
    pivot_work: Formula | None = None
    volume: Formula | None = None  # volume(y, constants): rate of phase volume

    # The same body in other models.
    # In variables that exist in any position.
    anywhere: Model | None = None
    # (constant, model): for bodies whose constant of this name is zero.
    without: tuple[tuple[str, Model], ...] = ()
    # Number of components, the last ones, that the state of a sweep lacks.
    n_extra: int = 0

    # Functions x of the state that are cheaper to integrate beside it than to compute
    # in each stage.  carried_start(y, constants): x at the start of a step.
    # carried_rhs(y, x, constants): dy and dx.
    n_carried: int = 0
    carried_start: Formula | None = None
    carried_rhs: Formula | None = None

    # For runs with tangents, small differences, whose components follow each other in
    # ``v``.  rate(y, dy, v, constants): dv.  seed(y, constants): the first v.
    # transverse(y, dy, v, constants): the part that is measured.
    n_tangents: int = 0
    rate: Formula | None = None
    seed: Formula | None = None
    transverse: Formula | None = None
    square: Formula | None = None  # square(v, constants): |v|^2 of one tangent
    # Of a frame of several tangents: factor(v, constants): the triangle R of its
    # factors QR.  solve(v, R): the tangents Q.  trivial(y, dy, constants): squared
    # norms of the flow and of the gradient of the energy.
    factor: Formula | None = None
    solve: Formula | None = None
    trivial: Formula | None = None

    @cached_property
    def contact(self) -> Formula:
        """The formula ``contact(y, constants)``: normal and tangential force."""
        rhs = self.rhs
        force = self.force

        @scalar
        def contact(y, constants):
            normal, square = force(y, rhs(y, constants), constants)
            return normal, sqrt(square)

        formula: Formula = contact
        return formula

    @property
    def n_constants(self) -> int:
        """The number of ``constants``."""
        return len(self.constants)

    @property
    def surface_constants(self) -> tuple[str, ...]:
        """The names of the constants of the surface, which follow the moments."""
        return tuple(name for name in self.constants if name in stone.CONSTANTS[3:])

    @property
    def of_runs(self) -> tuple[str, ...]:
        """The names of all constants of a run: the body's, and what slides need."""
        if self.slide is None:
            return self.constants
        return *self.constants, "mu"

    def named(self, values: Floats) -> dict[str, Floats]:
        """Return constants of runs, one in each row of `values`, by their names."""
        return dict(zip(self.of_runs, values, strict=True))


# Bodies in slopes and angular velocity.  The state may have further components.


@scalar
def _rhs(y, constants):
    return full.rhs(*(y + constants))


@scalar
def _spin(y):
    p, q, a, b, c = y[:5]
    return full.spin(p, q, a, b, c)


@scalar
def _spin_rate(y, dy):
    p, q, _, _, _ = y[:5]
    _, _, da, db, dc = dy[:5]
    return full.spin_rate(p, q, da, db, dc)


@scalar
def _amplitude(y, probe):
    p, q, a, b, _ = y[:5]
    return _squared_amplitude(p, q, a, b, probe)


@scalar
def _squared_amplitude(p, q, a, b, probe):
    p0, q0, a0, b0, p1, q1, a1, b1 = probe
    real = p0 * p + q0 * q + a0 * a + b0 * b
    imag = p1 * p + q1 * q + a1 * a + b1 * b
    return real * real + imag * imag


@scalar
def _error(e, y, constants):
    ep, eq, ea, eb, ec = e
    p, q, a, b, _ = y
    ix, iy, iz, cxx, cxy, cyy = constants[:6]
    step = full.oscillation(ep, eq, ea, eb, ix, iy, cxx, cxy, cyy) + iz * ec * ec
    return step, full.oscillation(p, q, a, b, ix, iy, cxx, cxy, cyy) + TINY


@scalar
def _energy(y, constants):
    return full.energy(*(y + constants))


@scalar
def _force(y, dy, constants):
    return full.contact_force(*(y + dy + constants[3:]))


@scalar
def _no_work(y):
    return 0.0


@scalar
def _volume(y, constants):
    p, q, a, b, c = y
    ix, iy, iz, cxx, cxy, cyy = constants[:6]
    k = constants[6] if len(constants) > 6 else 0.0
    return vectors.smooth_volume(
        -p, -q, -1.0, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, 0.0
    )


def _rise(touch: Formula, *, further: int) -> Formula:
    """Return the height of a surface's contact, as `Model.rise`.

    ``further`` is the number of its further constants.
    """
    last = 6 + further

    @scalar
    def rise(y, constants):
        p, q, a, b, c = y[:5]
        shape = constants[3:last]
        _, _, height, _, _, _, _ = touch(p, q, a, b, c, 0.0, 0.0, 0.0, *shape)
        return height

    formula: Formula = rise
    return formula


FULL = Model(
    "full",
    full.N_STATE,
    full.CONSTANTS,
    n_probe=8,
    rhs=_rhs,
    spin=_spin,
    spin_rate=_spin_rate,
    amplitude=_amplitude,
    error=_error,
    energy=_energy,
    force=_force,
    work=_no_work,
    rise=_rise(full.paraboloid, further=0),
    surface=surface.PARABOLOID,
    volume=_volume,
)


@scalar
def _tangent_rate(y, dy, v, constants):
    return tangent.rate(*(y + dy + v + constants))


@scalar
def _tangent_seed(y, constants):
    return tangent.seed(*(y + constants))


@scalar
def _tangent_transverse(y, dy, v, constants):
    return tangent.transverse(*(y + dy + v + constants))


@scalar
def _tangent_square(v, constants):
    return tangent.square(*(v + constants))


TANGENT = replace(
    FULL,
    name="full_tangent",
    n_tangents=1,
    rate=_tangent_rate,
    seed=_tangent_seed,
    transverse=_tangent_transverse,
    square=_tangent_square,
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


def _surface_force(touch: Formula) -> Formula:
    """Return the contact force of a surface, as `Model.force`."""

    @scalar
    def force(y, dy, constants):
        p, q, a, b, c = y[:5]
        dp, dq, da, db, dc = dy[:5]
        return stone.surface_force(
            touch, p, q, a, b, c, dp, dq, da, db, dc, constants[3:7]
        )

    formula: Formula = force
    return formula


# Bodies that roll with friction: the state has the work as its sixth component.


# The error of the spin is scaled as if the oscillation held at least this fraction of
# the spin's energy.
SPIN_KNOWN = 1e-14


@scalar
def _weighted_error(ep, eq, ea, eb, ec, p, q, a, b, c, constants):
    """Return the squares of the error and of the oscillation.

    Friction changes the spin in every step; rounding errors of the spin must not reject
    a step.
    """
    ix, iy, iz, cxx, cxy, cyy = constants[:6]
    size = full.oscillation(p, q, a, b, ix, iy, cxx, cxy, cyy) + TINY
    weight = min(1.0, size / (SPIN_KNOWN * iz * c * c + TINY))
    step = full.oscillation(ep, eq, ea, eb, ix, iy, cxx, cxy, cyy)
    return step + weight * iz * ec * ec, size


@scalar
def _error_with_friction(e, y, constants):
    ep, eq, ea, eb, ec = e[:5]
    p, q, a, b, c = y[:5]
    return _weighted_error(ep, eq, ea, eb, ec, p, q, a, b, c, constants)


@scalar
def _work(y):
    return y[5]


@scalar
def _pivot_work(y):
    return y[6]


@scalar
def _volume_with_friction(y, constants):
    p, q, a, b, c = y[:5]
    return vectors.volume(-p, -q, -1.0, a, b, c, 0.0, *constants)


# Bodies in any position, with or without friction.


@scalar
def _vectors_rhs(y, constants):
    return vectors.rhs(*(y + constants))


@scalar
def _vectors_spin(y):
    vx, vy, vz, a, b, c = y[:6]
    return vectors.spin(vx, vy, vz, a, b, c)


@scalar
def _vectors_spin_rate(y, dy):
    vx, vy, vz, _, _, _ = y[:6]
    _, _, _, da, db, dc = dy[:6]
    return vectors.spin(vx, vy, vz, da, db, dc)


@scalar
def _vectors_amplitude(y, probe):
    # Near the upright position the slopes are -u_x and -u_y.
    vx, vy, _, a, b, _ = y[:6]
    return _squared_amplitude(-vx, -vy, a, b, probe)


@scalar
def _vectors_error(e, y, constants):
    ex, ey, ez, ea, eb, ec = e[:6]
    vx, vy, _, a, b, c = y[:6]
    step, size = _weighted_error(ex, ey, ea, eb, ec, vx, vy, a, b, c, constants)
    return step + ez * ez, size


@scalar
def _vectors_energy(y, constants):
    return vectors.energy(*(y[:7] + constants[:10]))


@scalar
def _vectors_force(y, dy, constants):
    return vectors.contact_force(*(y[:6] + dy[3:6] + constants[3:7]))


@scalar
def _vectors_work(y):
    return y[6]


@scalar
def _vectors_volume(y, constants):
    return vectors.volume(*(y[:7] + constants))


@scalar
def _vectors_rise(y, constants):
    vx, vy, vz = y[:3]
    u = vectors.unit(vx, vy, vz)
    (_, _, z), _ = vectors.contact_under(*u, *constants[3:7])
    return 1.0 - z


VECTORS = Model(
    "vectors",
    vectors.N_STATE,
    vectors.CONSTANTS,
    FULL.n_probe,
    rhs=_vectors_rhs,
    spin=_vectors_spin,
    spin_rate=_vectors_spin_rate,
    amplitude=_vectors_amplitude,
    error=_vectors_error,
    energy=_vectors_energy,
    force=_vectors_force,
    work=_vectors_work,
    rise=_vectors_rise,
    volume=_vectors_volume,
)


@scalar
def _vectors_parts(y, constants):
    """Return what `pivoting.pivoting_parts` does, and where the body is."""
    vx, vy, vz, a, b, c = y[:6]
    shape = constants[3:7]
    sigma = constants[7]
    u = vectors.unit(vx, vy, vz)
    omega = a, b, c
    r, rho = vectors.contact_under(*u, *shape)
    rates, _, w, solved = vectors.smooth_rates(
        u, omega, r, rho, shape, constants[:3], sigma
    )
    changed, torque, normal, rolled = pivoting.rolling_and_pivoting(
        u, omega, r, w, rates, solved, constants[7:]
    )
    power = rolled - sigma * stone.dot(omega, omega)
    return changed, torque, normal, power, (u, omega, r, w)


@scalar
def _vectors_pivoting_rhs(y, constants):
    vx, vy, vz, a, b, c = y[:6]
    changed, torque, _, power, (u, omega, _, _) = _vectors_parts(y, constants)
    rates = vy * c - vz * b, vz * a - vx * c, vx * b - vy * a
    taken = torque * stone.dot(u, omega)
    return rates + changed + (power + taken, taken)


@scalar
def _vectors_pivot(y, constants):
    _, torque, normal, _, _ = _vectors_parts(y, constants)
    return torque, normal


@scalar
def _vectors_pivot_work(y):
    return y[7]


VECTORS_PIVOTING = replace(
    VECTORS,
    name="vectors_pivoting",
    n_state=vectors.N_STATE + 1,
    constants=(*vectors.CONSTANTS, "pivot", "sense"),
    rhs=_vectors_pivoting_rhs,
    volume=None,
    pivot=_vectors_pivot,
    pivot_work=_vectors_pivot_work,
)


# Other surfaces and friction, from the records of `physics.surface`.


def _frictionless(on: Surface) -> Model:
    """Return the model of a surface with a further constant ``k``, without friction."""
    touch = on.contact
    surface_energy = on.energy

    @scalar
    def rhs(y, constants):
        p, q, a, b, c = y
        return stone.frictionless_rhs(
            touch, p, q, a, b, c, constants[:3], constants[3:]
        )

    @scalar
    def energy(y, constants):
        return surface_energy(*(y + constants))

    model = replace(
        FULL,
        name=on.model,
        constants=stone.CONSTANTS,
        rhs=rhs,
        energy=energy,
        force=_surface_force(touch),
        rise=_rise(touch, further=1),
        surface=on,
        volume=_volume if on.quadric else None,
        anywhere=VECTORS if on.closed else None,
        without=(("k", FULL),),
    )
    if on.carried is None:
        return model
    start_at = on.carried.start
    rate_at = on.carried.rate
    carried_touch = on.carried.contact

    @scalar
    def start(y, constants):
        p, q, _, _, _ = y
        return (start_at(p, q, *constants[3:]),)

    @scalar
    def carried_rhs(y, x, constants):
        p, q, a, b, c = y
        shape = constants[3:] + x
        f = stone.frictionless_rhs(carried_touch, p, q, a, b, c, constants[:3], shape)
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
    def rhs(y, constants):
        return law_rhs(touch, y, constants[:3], constants[3:7], constants[7:])

    @scalar
    def energy(y, constants):
        return surface_energy(*(y[:5] + constants[:7])) - y[5]

    model = replace(
        rolling,
        name=f"{rolling.name}_{law.name}",
        n_state=stone.N_FRICTION_STATE,
        constants=(*stone.CONSTANTS, *law.constants),
        rhs=rhs,
        error=_error_with_friction,
        energy=energy,
        force=_surface_force(touch),
        work=_work,
        rise=_rise(touch, further=1),
        volume=_volume_with_friction if on.quadric and law.in_vectors else None,
        law=law,
        anywhere=rolling.anywhere if law.in_vectors else None,
    )
    if law.pivot is not None:
        model = _with_pivot(model, touch, law.pivot)
    if on.carried is None:
        return model
    start_at = on.carried.start
    rate_at = on.carried.rate
    carried_touch = on.carried.contact

    @scalar
    def start(y, constants):
        p, q, _, _, _ = y[:5]
        return (start_at(p, q, *constants[3:7]),)

    @scalar
    def carried_rhs(y, x, constants):
        p, q, _, _, _ = y[:5]
        shape = constants[3:7] + x
        f = law_rhs(carried_touch, y, constants[:3], shape, constants[7:])
        dp, dq, _, _, _ = f[:5]
        return f + (rate_at(p, q, dp, dq, *shape),)  # noqa: RUF005

    return replace(model, carried_start=start, carried_rhs=carried_rhs)


def _with_pivot(model: Model, touch: Formula, parts: Formula) -> Model:
    """Return a model whose law has a torque against pivoting."""

    @scalar
    def pivot(y, constants):
        _, _, torque, normal, _, _ = parts(
            touch, y, constants[:3], constants[3:7], constants[7:]
        )
        return torque, normal

    return replace(
        model,
        n_state=pivoting.N_STATE,
        pivot=pivot,
        pivot_work=_pivot_work,
        volume=None,
        anywhere=None if model.anywhere is None else VECTORS_PIVOTING,
    )


FRICTIONLESS = {FULL.name: FULL}
FRICTIONLESS |= {each.model: _frictionless(each) for each in surface.FURTHER}
"""Models of the surfaces without friction, by their names."""

FULL_ELLIPSOID = FRICTIONLESS[surface.ELLIPSOID.model]


def _all_with_friction() -> dict[tuple[str, str], Model]:
    """Return the models with friction by those without and the law."""
    models: dict[tuple[str, str], Model] = {}
    for rolling in FRICTIONLESS.values():
        for law in surface.LAWS.values():
            without = [(name, models[rolling.name, own]) for name, own in law.without]
            if rolling is not FULL:
                without.append(("k", models[FULL.name, law.name]))
            model = replace(_with_friction(rolling, law), without=tuple(without))
            models[rolling.name, law.name] = model
    return models


FRICTION = _all_with_friction()
"""Models with friction, by the names of the model without it and of the law."""


# Sliding, where friction cannot hold the contact point.


@scalar
def _without_work(y, slip, placed, omega_rate, normal):
    return placed[0] + omega_rate


@scalar
def _with_work(y, slip, placed, omega_rate, normal):
    rates, _, omega, _, _, _, torque, drag = placed
    power = stone.dot(torque, omega) + normal * stone.dot(drag, omega)
    return rates + omega_rate + (power,)


@scalar
def _with_works(y, slip, placed, omega_rate, normal):
    rates, u, omega, _, _, _, torque, drag = placed
    power = stone.dot(torque, omega) + normal * stone.dot(drag, omega)
    # The part of the drag along the vertical is that of pivoting.
    pivoted = normal * stone.dot(drag, u) * stone.dot(u, omega)
    return rates + omega_rate + (power, pivoted)


@scalar
def _contact_of_slope(touch, p, q, a, b, c, shape):
    dp, dq, m = full.slope_rate(p, q, a, b, c)
    fx, fy, rise, wx, wy, wz, uz = touch(p, q, a, b, c, dp, dq, m, *shape)
    u = p * uz, q * uz, uz
    r = p + fx, q + fy, 1.0 - rise
    return (dp, dq), u, (a, b, c), r, (wx, wy, wz)


@scalar
def _turned(y, u, rate):
    p, q, a, b, c = y[:5]
    x, y_, z = u
    return (p, q, a + rate * x, b + rate * y_, c + rate * z) + y[5:]  # noqa: RUF005


_NONE = 0.0, 0.0, 0.0


def _sliding(rolling: Model, law: Friction | None) -> Model:
    """Return a model of slopes whose bodies slide where friction cannot hold them."""
    on = rolling.surface
    assert on is not None
    touch = on.contact

    @scalar
    def place(y, creep, constants):
        p, q, a, b, c = y[:5]
        shape = constants[3:]
        rates, u, omega, r, w = _contact_of_slope(touch, p, q, a, b, c, shape)
        return rates, u, omega, r, w, constants[:3], _NONE, _NONE

    if law is None:
        slide = Slide(place, _without_work, _turned)
        return replace(rolling, name=f"{rolling.name}_sliding", slide=slide)
    couples = law.couples

    @scalar
    def place_with_friction(y, creep, constants):
        p, q, a, b, c = y[:5]
        shape = constants[3:7]
        rates, u, omega, r, w = _contact_of_slope(touch, p, q, a, b, c, shape)
        torque, drag = couples(u, omega, constants[7:], creep)
        return rates, u, omega, r, w, constants[:3], torque, drag

    derivative = _with_work if law.pivot is None else _with_works
    slide = Slide(place_with_friction, derivative, _turned)
    return replace(rolling, name=f"{rolling.name}_sliding", slide=slide)


@scalar
def _place_in_any_position(y, creep, constants):
    vx, vy, vz, a, b, c = y[:6]
    shape = constants[3:7]
    u = vectors.unit(vx, vy, vz)
    omega = a, b, c
    r, rho = vectors.contact_under(*u, *shape)
    w = vectors.moving(u, omega, r, rho, *shape)
    torque, drag = stone.rolling_couples(u, omega, constants[7:], 0.0)
    rates = vy * c - vz * b, vz * a - vx * c, vx * b - vy * a
    return rates, u, omega, r, w, constants[:3], torque, drag


@scalar
def _turned_in_any_position(y, u, rate):
    vx, vy, vz, a, b, c = y[:6]
    x, y_, z = u
    turned = a + rate * x, b + rate * y_, c + rate * z
    return (vx, vy, vz) + turned + y[6:]  # noqa: RUF005


VECTORS_SLIDING = replace(
    VECTORS,
    name="vectors_sliding",
    slide=Slide(_place_in_any_position, _with_work, _turned_in_any_position),
)


@scalar
def _place_with_pivoting(y, creep, constants):
    rates, u, omega, r, w, inertia, torque, (x, y_, z) = _place_in_any_position(
        y, creep, constants[:10]
    )
    _, _, _, _, _, _, _, _, _, _, lever, least = constants
    px, py, pz = pivoting.sliding_drag(u, stone.dot(u, omega), lever, creep, least)
    return rates, u, omega, r, w, inertia, torque, (x + px, y_ + py, z + pz)


VECTORS_PIVOTING_SLIDING = replace(
    VECTORS_PIVOTING,
    name="vectors_pivoting_sliding",
    slide=Slide(_place_with_pivoting, _with_works, _turned_in_any_position),
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
            anywhere = VECTORS_SLIDING
            if model.pivot is not None:
                anywhere = VECTORS_PIVOTING_SLIDING
            model = replace(model, slide=slide, anywhere=anywhere)
        without = ((zero, models[own.name]) for zero, own in model.without)
        models[name] = replace(model, without=tuple(without))
    return models


SLIDING = _all_sliding()
"""Models of bodies that slide, by the name of the model that always rolls."""


# The reduced model.


@scalar
def _reduced_rhs(y, constants):
    return reduced.rhs(*(y + constants))


@scalar
def _reduced_spin(y):
    return y[0]


@scalar
def _reduced_spin_rate(y, dy):
    return dy[0]


@scalar
def _reduced_amplitude(y, probe):
    _, e_p, e_r = y
    w_p, w_r = probe
    return w_p * e_p + w_r * e_r


@scalar
def _reduced_energy(y, constants):
    return reduced.energy(*(y + constants))


@scalar
def _no_force(y, dy, constants):
    return 1.0, 0.0


@scalar
def _reduced_error(e, y, constants):
    # Each energy is compared with itself: the decaying one determines what happens much
    # later.
    dn, de_p, de_r = e
    n, e_p, e_r = y
    _, _, inertia = constants
    spin = inertia * dn * dn / (inertia * n * n + 2.0 * (e_p + e_r) + TINY)
    pitch = de_p * de_p / (e_p * e_p + TINY)
    roll = de_r * de_r / (e_r * e_r + TINY)
    return spin + pitch + roll, 1.0


REDUCED = Model(
    "reduced",
    reduced.N_STATE,
    reduced.CONSTANTS,
    n_probe=2,
    rhs=_reduced_rhs,
    spin=_reduced_spin,
    spin_rate=_reduced_spin_rate,
    amplitude=_reduced_amplitude,
    error=_reduced_error,
    energy=_reduced_energy,
    force=_no_force,
    work=_no_work,
)


# Heading and contact point on the plane, which single steps add to the state.


@scalar
def _zero(y):
    return 0.0


@scalar
def _no_rate(y, dy):
    return 0.0


@scalar
def _no_amplitude(y, probe):
    return 0.0


@scalar
def _no_error(e, y, constants):
    return 0.0, 1.0


UNSEEN = {
    "spin": _zero,
    "spin_rate": _no_rate,
    "amplitude": _no_amplitude,
    "error": _no_error,
}
"""Formulas of models whose single steps nobody looks at."""


def _with_extra(plain: Model, n_extra: int, rhs: Formula, slid_extra: Formula) -> Model:
    """Return a model with further components of the state, for single steps.

    ``slid_extra(y, slip, placed)`` are their rates while the body slides.
    """
    n = plain.n_state
    slide = plain.slide
    if slide is not None:
        plain_place = slide.place
        plain_derivative = slide.derivative

        @scalar
        def place(y, creep, constants):
            return plain_place(y[:n], creep, constants)

        @scalar
        def derivative(y, slip, placed, omega_rate, normal):
            f = plain_derivative(y[:n], slip, placed, omega_rate, normal)
            return f + slid_extra(y, slip, placed)

        slide = replace(slide, place=place, derivative=derivative)
    return replace(
        plain,
        name=f"{plain.name}_attitude",
        n_state=n + n_extra,
        n_probe=0,
        n_extra=n_extra,
        n_carried=0,
        rhs=rhs,
        slide=slide,
        **UNSEEN,
    )


def _with_attitude(plain: Model) -> Model:
    """Return a model with heading and contact point on the plane, for single steps."""
    assert plain.surface is not None
    touch = plain.surface.contact
    plain_rhs = plain.rhs
    n = plain.n_state
    last = 3 + len(plain.surface_constants)

    @scalar
    def rhs(y, constants):
        p, q, a, b, c = y[:5]
        f = plain_rhs(y[:n], constants)
        m = p * b - q * a
        contact = touch(p, q, a, b, c, f[0], f[1], m, *constants[3:last])
        return f + full.track(p, q, a, b, c, y[n], *contact)

    @scalar
    def slid_track(y, slip, placed):
        _, u, omega, r, w, _, _, _ = placed
        return sliding.track(u, omega, r, w, slip.speed, slip.angle, y[n])

    return _with_extra(plain, full.N_EXTRA, rhs, slid_track)


# In any position no heading is defined, so single steps add the rotation and the path
# since their start.


def _with_rotation(plain: Model) -> Model:
    """Return a model in any position with rotation and path, for single steps."""
    plain_rhs = plain.rhs
    n = plain.n_state
    after_rotation = n + vectors.N_EXTRA - 3

    @scalar
    def rhs(y, constants):
        vx, vy, vz, a, b, c = y[:6]
        f = plain_rhs(y[:n], constants)
        omega = a, b, c
        velocity = vectors.rolled(vectors.unit(vx, vy, vz), omega, constants[3:7])
        return f + vectors.carried_on(y[n:after_rotation], omega, velocity)

    @scalar
    def slid_path(y, slip, placed):
        _, u, omega, r, w, _, _, _ = placed
        x, y_, z = sliding.cross(r, omega)
        wx, wy, wz = w
        ex, ey, ez = sliding.slip_direction(u, slip.angle)
        velocity = (
            x - wx + slip.speed * ex,
            y_ - wy + slip.speed * ey,
            z - wz + slip.speed * ez,
        )
        return vectors.carried_on(y[n:after_rotation], omega, velocity)

    return _with_extra(plain, vectors.N_EXTRA, rhs, slid_path)


ATTITUDES = {
    plain.name: _with_attitude(plain)
    for plain in (*FRICTIONLESS.values(), *FRICTION.values(), *SLIDING.values())
}
ANYWHERE = VECTORS, VECTORS_SLIDING, VECTORS_PIVOTING, VECTORS_PIVOTING_SLIDING
ATTITUDES |= {plain.name: _with_rotation(plain) for plain in ANYWHERE}
"""Models of single steps that add the attitude, by the name of the model without it."""

ROLLING_MODELS = *FRICTIONLESS.values(), *FRICTION.values(), REDUCED, TANGENT, FRAME
MODELS: dict[str, Model] = {
    model.name: model for model in (*ROLLING_MODELS, *SLIDING.values(), *ANYWHERE)
}


def find_model(name: str) -> Model:
    """Return a model of :data:`MODELS` or :data:`ATTITUDES` by its own name."""
    return MODELS.get(name) or ATTITUDES[name.removesuffix("_attitude")]
