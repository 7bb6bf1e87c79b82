"""Rolling and sliding after Coulomb from the laws of mechanics, in Python and SciPy.

This module does not import `rattlesweep`.  With the contact point ``r`` from the centre
of mass, the velocity ``V`` of the centre of mass and the velocity ``v = V + omega x r``
of the body's material at the contact point, all in the body frame (M = a = g = 1),

    dV/dt + omega x V = F - u,
    I domega/dt + omega x I omega = r x F - sigma omega,
    du/dt = u x omega,

so that ``dv/dt + omega x v = W F + K``, where ``W`` is the inverse of the mass that the
contact point feels and ``K`` its acceleration without a force.  A body that rolls has
``v = 0`` and ``W F = -K``; a body that slides has ``F = N (u - mu v/|v|)`` with ``N``
from ``u . (W F + K) = 0``.

The functions of the equations take any numbers: floats, complex numbers, arrays, mpf.
A state that rolls is ``(u, omega, friction, couple)``, two vectors and two works; one
that slides is ``(u, omega, friction, couple, s, ln |v|)`` with ``v = |v| s``.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import DOP853, Radau
from scipy.optimize import brentq, minimize_scalar

N_ROLLING = 8
SAMPLES = 16  # places inside a step at which the events are looked for
# A slide begins this much later than the force leaves the cone, with half the
# acceleration of that moment times this as its speed.
FIRST_TIME = 1e-7
# The direction of a slide is stiff until it has the speed QUICK.  Below the speed SLOW
# a slide that slows down is followed in the time t' with dt = |v| dt', in which it
# takes forever to end and nothing is stiff.
QUICK = 3e-3
SLOW = 1e-3
# With less deceleration the foot creeps: t' runs so fast that its direction is stiff.
CREEP = 1e-3
LAST_SPEED = 1e-11
HUGE = 1e12


@dataclass(frozen=True)
class Body:
    """The parameters of a body, as `rs.Rattleback` has them."""

    alpha: float
    beta: float
    gamma: float
    theta: float
    phi: float
    xi: float
    c: float | None = None


@dataclass(frozen=True)
class Stone:
    """A body: its moments of inertia, surface, and friction.

    The matrix ``B`` of the principal radii at the bottom is ``(bxx, bxy, byy)``; ``c``
    is the vertical semi-axis of an ellipsoid, or None for a paraboloid.
    """

    inertia: tuple
    radii: tuple
    c: float | None = None
    mu: float = math.inf
    sigma: float = 0.0


def stone_of(body, mu, sigma=0.0):
    """Return the stone with the parameters of an object such as `rs.Rattleback`."""
    cosine = math.cos(body.xi)
    sine = math.sin(body.xi)
    long = 1 / body.theta
    short = 1 / body.phi
    radii = (
        cosine**2 * long + sine**2 * short,
        sine * cosine * (long - short),
        sine**2 * long + cosine**2 * short,
    )
    inertia = (body.alpha - 1, body.beta - 1, body.gamma)
    return Stone(inertia, radii, getattr(body, "c", None), mu, sigma)


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def times(k, a):
    return k * a[0], k * a[1], k * a[2]


def root(x):
    return x**0.5


def contact_point(stone, u, du):
    """Return the lowest point of the surface and its rate in the body frame."""
    bxx, bxy, byy = stone.radii
    ux, uy, uz = u
    dx, dy, dz = du
    if stone.c is None:
        # The paraboloid z = 1 - (x, y).B^-1 (x, y) / 2, whose normal is along u.
        p = ux / uz
        q = uy / uz
        dp = (dx - p * dz) / uz
        dq = (dy - q * dz) / uz
        x = bxx * p + bxy * q
        y = bxy * p + byy * q
        rate = bxx * dp + bxy * dq, bxy * dp + byy * dq, -(x * dp + y * dq)
        return (x, y, 1 - (x * p + y * q) / 2), rate
    # The ellipsoid x.E^-1 x = 1 about the point (0, 0, 1 - c); its lowest point is -E u
    # / sqrt(u.E u) from there.
    c = stone.c
    e = c * (bxx * ux + bxy * uy), c * (bxy * ux + byy * uy), c * c * uz
    de = c * (bxx * dx + bxy * dy), c * (bxy * dx + byy * dy), c * c * dz
    length = root(dot(u, e))
    fall = dot(u, de) / length**2
    r = -e[0] / length, -e[1] / length, 1 - c - e[2] / length
    rate = tuple((fall * e[i] - de[i]) / length for i in range(3))
    return r, rate


@dataclass(frozen=True)
class Contact:
    """What Newton and Euler say about the contact point, before the force is known."""

    r: tuple
    du: tuple
    free_turn: tuple  # domega/dt without a contact force
    free: tuple  # K
    inverse_mass: tuple  # W: xx, yy, zz, xy, xz, yz
    inertia: tuple

    def applied(self, f):
        """Return ``W f``."""
        wxx, wyy, wzz, wxy, wxz, wyz = self.inverse_mass
        return (
            wxx * f[0] + wxy * f[1] + wxz * f[2],
            wxy * f[0] + wyy * f[1] + wyz * f[2],
            wxz * f[0] + wyz * f[1] + wzz * f[2],
        )

    def turn(self, f):
        """Return ``domega/dt`` under a contact force."""
        torque = cross(self.r, f)
        return tuple(self.free_turn[i] + torque[i] / self.inertia[i] for i in range(3))


def contact_of(stone, u, omega):
    """Return the `Contact` of a state."""
    du = cross(u, omega)
    r, rate = contact_point(stone, u, du)
    ix, iy, iz = stone.inertia
    spun = cross((ix * omega[0], iy * omega[1], iz * omega[2]), omega)
    free_turn = tuple(
        (spun[i] - stone.sigma * omega[i]) / stone.inertia[i] for i in range(3)
    )
    moving = plus(rate, cross(omega, r))
    free = plus(plus(cross(free_turn, r), cross(omega, moving)), times(-1, u))
    x, y, z = r
    inverse_mass = (
        1 + z * z / iy + y * y / iz,
        1 + z * z / ix + x * x / iz,
        1 + y * y / ix + x * x / iy,
        -x * y / iz,
        -x * z / iy,
        -y * z / ix,
    )
    return Contact(r, du, free_turn, free, inverse_mass, stone.inertia)


def holding_force(contact):
    """Return the force under which the contact point keeps its velocity (rolling)."""
    wxx, wyy, wzz, wxy, wxz, wyz = contact.inverse_mass
    kx, ky, kz = contact.free
    axx = wyy * wzz - wyz * wyz
    axy = wxz * wyz - wxy * wzz
    axz = wxy * wyz - wxz * wyy
    ayy = wxx * wzz - wxz * wxz
    ayz = wxy * wxz - wxx * wyz
    azz = wxx * wyy - wxy * wxy
    det = wxx * axx + wxy * axy + wxz * axz
    return (
        -(axx * kx + axy * ky + axz * kz) / det,
        -(axy * kx + ayy * ky + ayz * kz) / det,
        -(axz * kx + ayz * ky + azz * kz) / det,
    )


def parts(u, force):
    """Return ``F . u`` and the part of ``F`` in the plane."""
    normal = dot(force, u)
    return normal, plus(force, times(-normal, u))


def sliding_force(stone, contact, u, s):
    """Return the normal force and the whole force of a slide towards the unit vector s.

    The third value is the denominator, which must be positive.
    """
    leaning = plus(u, times(-stone.mu, s))
    below = dot(u, contact.applied(leaning))
    normal = -dot(u, contact.free) / below
    return normal, times(normal, leaning), below


def rolling_rates(stone, y):
    """Return the rates of a state that rolls."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    contact = contact_of(stone, u, omega)
    turn = contact.turn(holding_force(contact))
    return [*contact.du, *turn, 0 * y[0], -stone.sigma * dot(omega, omega)]


def sliding_rates(stone, y, exp=math.exp):
    """Return the rates of a state that slides, times the speed, and the speed.

    So they stay finite where the speed vanishes.
    """
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    s = tuple(y[8:11])
    speed = exp(y[11])
    contact = contact_of(stone, u, omega)
    normal, force, _ = sliding_force(stone, contact, u, s)
    pull = plus(contact.applied(force), contact.free)
    rates = [*times(speed, contact.du), *times(speed, contact.turn(force))]
    rates += [-stone.mu * normal * speed * speed]
    rates += [-stone.sigma * dot(omega, omega) * speed]
    # The direction turns with the pull across it and, seen from the body, with it.
    # Written so, errors of |s| = 1 and s.u = 0 do not grow.
    across = cross(u, s)
    rates += plus(times(dot(pull, across), across), times(speed, cross(s, omega)))
    rates += [dot(pull, s)]
    return rates, speed


def rates_in_time(stone, y, exp=math.exp):
    """Return the rates of a state that slides."""
    rates, speed = sliding_rates(stone, y, exp)
    return [rate / speed for rate in rates]


def velocity(y):
    """Return the velocity of the foot."""
    if len(y) == N_ROLLING:
        return 0.0, 0.0, 0.0
    return times(np.exp(y[11]), tuple(y[8:11]))


def energy(stone, y):
    """Return the energy, which is zero upright at rest."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    contact = contact_of(stone, u, omega)
    drift = plus(velocity(y), cross(contact.r, omega))
    ix, iy, iz = stone.inertia
    turning = ix * omega[0] ** 2 + iy * omega[1] ** 2 + iz * omega[2] ** 2
    return (turning + dot(drift, drift)) / 2 - dot(contact.r, u) - 1


def spin(y):
    """Return ``n = u . omega``."""
    return dot(y[:3], y[3:6])


def rolling_force(stone, y):
    """Return the normal force and the force in the plane of a body that rolls."""
    u = tuple(y[:3])
    return parts(u, holding_force(contact_of(stone, u, tuple(y[3:6]))))


def grip(stone, y):
    """Return ``N - |F_t|/mu`` of a body that rolls; below zero it slides."""
    normal, along = rolling_force(stone, y)
    return normal - root(dot(along, along)) / stone.mu


def slip(stone, y, s):
    """Return the normal force, the pull on a foot that slides, and the denominator."""
    u = tuple(y[:3])
    contact = contact_of(stone, u, tuple(y[3:6]))
    normal, force, below = sliding_force(stone, contact, u, s)
    return normal, plus(contact.applied(force), contact.free), below


def outgoing(stone, y):
    """Return the ways in which a foot at rest may begin to slide.

    They are the directions in which the pull is along the slide and positive, where a
    slide that strays from the direction returns to it.  Each comes with its pull.
    """
    u = np.array(y[:3])
    first = np.cross(u, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(u, first)

    def across(angle):
        s = math.cos(angle) * first + math.sin(angle) * second
        _, pull, _ = slip(stone, y, s)
        return dot(pull, np.cross(u, s))

    angles = np.linspace(0, 2 * math.pi, 361)
    values = [across(angle) for angle in angles]
    ways = []
    for k in range(360):
        if values[k] > 0 >= values[k + 1]:
            angle = brentq(across, angles[k], angles[k + 1], xtol=1e-15)
            s = math.cos(angle) * first + math.sin(angle) * second
            along = dot(slip(stone, y, s)[1], s)
            if along > 0:
                ways.append((float(along), tuple(s)))
    return ways


@dataclass
class Slide:
    """One slide, from the moment at which the foot leaves to the one at which it holds.

    ``work`` is the energy that it took, positive.
    """

    begin: float
    end: float = math.nan
    work: float = 0.0
    steps: int = 0
    fastest: float = 0.0
    pauses: int = 0  # moments of rest from which it slid on


@dataclass
class Run:
    """What became of a run."""

    status: str  # ok, lifts_off, jammed
    t: float
    y: np.ndarray
    t_r: float | None
    slides: list[Slide]
    energy_at_launch: float
    energy: float
    least_denominator: float

    @property
    def slide_time(self):
        return sum(slide.end - slide.begin for slide in self.slides)

    @property
    def slide_work(self):
        """Energy lost by sliding over the energy at launch."""
        return -self.y[6] / self.energy_at_launch

    @property
    def energy_error(self):
        return (self.energy - self.y[6] - self.y[7]) / self.energy_at_launch - 1


class Follower:
    """Integrates one phase from event to event."""

    def __init__(self, equations, method, rtol, n_state=12):
        self.method = method
        self.options = {"rtol": rtol, "atol": 1e-3 * rtol}
        if method is Radau:
            self.options["jac"] = lambda t, y: complex_jacobian(equations, y)
            # Radau judges its steps by a formula of order 3; errors of direction and
            # ln |v| count only times the speed.
            self.options["rtol"] = 30 * rtol
            self.options["atol"] = np.full(n_state, 0.1 * rtol)
            self.options["atol"][N_ROLLING:12] = 300 * rtol
        # Python's own floats are faster than NumPy's.
        self.rates = lambda t, y: equations(y.tolist())
        self.steps = 0
        self.highest = -math.inf  # the last component, ln |v| in a slide

    def solver(self, t, y, bound):
        return self.method(self.rates, t, y, bound, **self.options)

    def advanced(self, solver):
        message = solver.step()
        if solver.status == "failed":
            raise ArithmeticError(message)
        return solver

    def again(self, t, y, bound):
        """Return the state at a time inside a step, from the step's own start."""
        solver = self.solver(t, y, bound)
        while solver.status == "running":
            self.advanced(solver)
        return solver.y

    def follow(self, t, y, bound, events):
        """Return the time, the state and the name of the first event, or None.

        `events` returns, by their names, functions of the state that fall through zero
        at an event; it takes one state or an array of them.
        """
        solver = self.solver(t, y, bound)
        while solver.status == "running":
            before = solver.y.copy()
            self.advanced(solver)
            self.steps += 1
            self.highest = max(self.highest, solver.y[-1])
            dense = solver.dense_output()
            moments = np.linspace(solver.t_old, solver.t, SAMPLES + 1)
            states = dense(moments)
            states[:, 0] = before
            states[:, -1] = solver.y
            hits = []
            for name, values in events(states).items():

                def event(t, name=name, dense=dense):
                    return events(dense(t))[name]

                bracket = falls(event, moments, values)
                if bracket is not None:
                    hits.append((brentq(event, *bracket, xtol=1e-15), name))
            if hits:
                moment, name = min(hits)
                return *self.settle(solver, before, dense, moment, events, name), name
        return solver.t, solver.y, None

    def settle(self, solver, before, dense, moment, events, name):
        """Return time and state of an event, corrected on states that were integrated.

        Dense output is of a lower order than the steps.
        """
        width = 1e-3 * (solver.t - solver.t_old)
        after = events(dense(moment + width))[name]
        slope = (after - events(dense(moment - width))[name]) / (2 * width)
        for _ in range(4):
            if not solver.t_old < moment:
                break
            shift = events(self.again(solver.t_old, before, moment))[name] / slope
            if not abs(shift) < 10 * width:
                break
            moment -= shift
            if abs(shift) < 1e-15 * max(1.0, abs(moment)):
                break
        if not solver.t_old < moment:
            return solver.t_old, before
        return moment, self.again(solver.t_old, before, moment)


def falls(event, moments, values):
    """Return a bracket of the first fall of an event's samples, or None."""
    for k in range(len(moments) - 1):
        if values[k] > 0 >= values[k + 1]:
            return moments[k], moments[k + 1]
        if k == 0 or not values[k - 1] >= values[k] <= values[k + 1]:
            continue
        bend = values[k - 1] + values[k + 1] - 2 * values[k]
        if 0 < values[k] < 3 * bend:
            # The event dips here and may be below zero between the samples.
            lowest = minimize_scalar(
                event,
                bounds=(moments[k - 1], moments[k + 1]),
                method="bounded",
                options={"xatol": 1e-12},
            )
            if lowest.fun <= 0:
                return moments[k - 1], lowest.x
    return None


def complex_jacobian(equations, y):
    """Return the derivative of the rates by a complex step."""
    step = 1e-40
    columns = y[:, None] + 1j * step * np.eye(len(y))
    rows = [np.broadcast_to(row, len(y)) for row in equations(columns, np.exp)]
    return np.array(rows).imag / step


class Oracle:
    """Follows one body."""

    def __init__(self, stone, t_end, rtol=1e-12, through=False, first_time=FIRST_TIME):
        self.stone = stone
        self.t_end = t_end
        self.rtol = rtol
        self.through = through
        self.first_time = first_time
        self.status = "ok"
        self.t_r = None
        self.slides = []
        self.least_denominator = math.inf

    def run(self, u, omega, v=None):
        """Follow a body whose foot rests or has a velocity ``v``."""
        y = np.array([*u, *omega, 0.0, 0.0])
        self.sign = math.copysign(1.0, spin(y))
        t = 0.0
        if v is not None:
            speed = math.sqrt(dot(v, v))
            y = np.array([*y, *times(1 / speed, v), math.log(speed)])
            self.slides.append(Slide(0.0))
        at_launch = energy(self.stone, y)
        is_over = False
        while not is_over:
            if len(y) > N_ROLLING:
                t, y, is_over = self.slide(t, y)
            elif grip(self.stone, y) > 1e-13 * self.stone.mu:
                t, y, is_over = self.roll(t, y)
            else:
                t, y, is_over = self.leave(t, y)
        if self.slides and math.isnan(self.slides[-1].end):
            self.close_slide(t, y)
        return Run(
            self.status,
            float(t),
            y,
            self.t_r,
            self.slides,
            float(at_launch),
            float(energy(self.stone, y)),
            self.least_denominator,
        )

    def is_over(self, t, name):
        """Note a reversal; return whether the run is over."""
        if name == "reversal":
            if self.t_r is None:
                self.t_r = float(t)
            self.sign = -self.sign
            return not self.through
        if name in ("lifts_off", "jammed"):
            self.status = name
            return True
        return name in (None, "horizon")

    def close_slide(self, t, y):
        slide = self.slides[-1]
        slide.end = float(t)
        slide.work -= float(y[6])

    def roll(self, t, y):
        """Roll until the foot slips or the run is over."""
        if self.slides and math.isnan(self.slides[-1].end):
            self.close_slide(t, y)
        follower = Follower(lambda y: rolling_rates(self.stone, y), DOP853, self.rtol)

        def events(y):
            return {"slip": grip(self.stone, y), "reversal": self.sign * spin(y)}

        while True:
            t, y, name = follower.follow(t, y, self.t_end, events)
            if name == "slip":
                return t, y, False
            if self.is_over(t, name):
                return t, y, True

    def leave(self, t, y):
        """Begin a slide, or go on with one, where rolling needs more than mu.

        The foot leaves in the time `first_time`, in which it rolls on: the force then
        lies outside of the cone by more than rounding errors.
        """
        later = y + self.first_time * np.array(rolling_rates(self.stone, y))
        normal, along = rolling_force(self.stone, later)
        ways = outgoing(self.stone, later)
        if not ways:
            return t, y, self.is_over(t, "lifts_off" if normal <= 0 else "jammed")
        gain, s = min(ways, key=lambda way: dot(way[1], along))
        if not self.slides or not math.isnan(self.slides[-1].end):
            self.slides.append(Slide(float(t), work=float(y[6])))
        else:
            self.slides[-1].pauses += 1
        # The gain has grown from zero, or was there from the start.
        _, pull, _ = slip(self.stone, y, s)
        speed = (max(0.0, dot(pull, s)) + gain) / 2 * self.first_time
        y = np.array([*y, *s, math.log(speed)])
        y[:N_ROLLING] += self.first_time * np.array(rates_in_time(self.stone, y))[:8]
        return t + self.first_time, y, False

    def watched(self, y):
        """Return the events of every slide, and the gain of speed a unit of time."""
        s = tuple(y[8:11])
        normal, pull, below = slip(self.stone, y, s)
        self.least_denominator = min(self.least_denominator, float(np.min(below)))
        events = {
            "lifts_off": normal,
            "jammed": below,
            "reversal": self.sign * spin(y),
        }
        return events, dot(pull, s)

    def slide(self, t, y):
        """Slide until the foot stands still or the run is over."""
        events, gain = self.watched(y)
        if events["jammed"] <= 0:
            return t, y, self.is_over(t, "jammed")
        if y[11] >= math.log(QUICK):
            name = "is_quick"
        elif gain > 0:
            name = "quickens"
        else:
            name = "slows"
        while True:
            if name == "slows":
                t, y, name = self.slow(t, y)
            else:
                t, y, name = self.go_on(t, y, name)
            if name == "stands":
                return t, y, False
            if name not in ("slows", "quickens", "is_quick"):
                return t, y, self.is_over(t, name)

    def go_on(self, t, y, phase):
        """Slide on in time."""

        def events_while_quick(y):
            events, _ = self.watched(y)
            return events | {"slows": y[11] - math.log(SLOW)}

        def events_of_start(y):
            events, gain = self.watched(y)
            return events | {"slows": gain, "is_quick": math.log(QUICK) - y[11]}

        def rates(y, exp=math.exp):
            return rates_in_time(self.stone, y, exp)

        if phase == "is_quick":
            follower = Follower(rates, DOP853, self.rtol)
            t, y, name = follower.follow(t, y, self.t_end, events_while_quick)
        else:
            follower = Follower(rates, Radau, self.rtol)
            t, y, name = follower.follow(t, y, self.t_end, events_of_start)
        slide = self.slides[-1]
        slide.steps += follower.steps
        slide.fastest = max(slide.fastest, math.exp(follower.highest))
        return t, y, name

    def slow(self, t, y):
        """Follow a slide that slows down to its end or until it quickens again."""

        def events_of_end(y):
            events, gain = self.watched(y)
            return events | {
                "quickens": -gain,
                "stands": y[11] - math.log(LAST_SPEED),
                "horizon": self.t_end - y[12],
            }

        def events_of_end_without_creep(y):
            events = events_of_end(y)
            return events | {"creeps": events["quickens"] - CREEP}

        _, gain = self.watched(y)
        y = np.array([*y, t])
        name = "creeps"
        if gain < -CREEP:
            follower = Follower(self.slow_rates, DOP853, self.rtol)
            _, y, name = follower.follow(0.0, y, HUGE, events_of_end_without_creep)
            self.slides[-1].steps += follower.steps
        if name == "creeps":
            follower = Follower(self.slow_rates, Radau, self.rtol, 13)
            _, y, name = follower.follow(0.0, y, HUGE, events_of_end)
            self.slides[-1].steps += follower.steps
        t = float(y[12])
        y = y[:12]
        if name != "stands":
            return t, y, name
        # The rest is so short that its course is a straight line.
        rates, speed = sliding_rates(self.stone, y)
        rest = -speed / rates[11]
        y = y + rest / speed * np.array(rates)
        return t + rest, y[:N_ROLLING], name

    def slow_rates(self, y, exp=math.exp):
        """Return the rates of a state that slides, and of the time, times the speed."""
        rates, speed = sliding_rates(self.stone, y[:12], exp)
        return [*rates, speed]


def run(body, u, omega, t_end, mu, sigma=0.0, through=False, **options):
    """Return the `Run` of a body, such as an `rs.Rattleback`, from a state that rolls.

    It ends at the first reversal unless `through` is true.
    """
    stone = stone_of(body, mu, sigma)
    return Oracle(stone, t_end, through=through, **options).run(u, omega)
