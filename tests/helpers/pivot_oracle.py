"""Rubbing in pivoting, held spins and Hertz's patch, from the laws of mechanics.

This module does not import `rattlesweep`.  It goes on from `slide_oracle`: Newton and
Euler in the body frame (M = a = g = 1) with one torque more, ``T u``, at the contact.
Its size depends on the normal force ``N``:

- A body that rolls and spins has ``T = -l N sign(n)``, with ``n = u . omega``.
- A body that rolls with ``n = 0`` is *held* if the torque that keeps ``n = 0`` has
  ``|T| <= l N``.  It is released, to the side to which the torque gives way, where
  ``|T|`` reaches ``l N``.  Otherwise the spin goes on to the side to which it is led
  by the full torque against that side.
- A foot that slides at the speed ``v`` has ``T = -l N q(y)`` with ``y = e n / v`` and
  ``q = sign(n) M(|1/y|) / M(0)``; ``e = 16 l / (3 pi mu)`` is the radius of a circular
  patch of Hertz's with the lever ``l``.  The sliding force keeps the size ``mu N``.

The last law is smooth where ``n`` passes zero at ``v > 0``.  So no spin is held in a
slide, and every zero of ``n`` in a slide is a crossing.  Where ``v`` and ``n`` vanish
together the torque depends on the way there:

- A slide that ends with ``n`` different from zero ends in rolling with the full torque,
  as ``y`` becomes infinite.  That both vanish at one time is an exception.
- A slide that begins from a held spin begins at ``v = n = 0``.  From
  ``v dy/dt = e dn/dt - y dv/dt`` the ratio ``y`` settles at once where ``e dn/dt = y
  dv/dt``.  As ``dv/dt`` grows from zero this is ``dn/dt = 0``: the torque is the one
  that held the spin, ``q(y) = -T / (l N)``, which has a solution for ``|T| < l N``.
  The spin leaves zero together with the foot, to the side of ``y``.

A state that rolls is ``(u, omega, friction, couple, pivot)``, two vectors and three
works; one that slides is ``(u, omega, friction, couple, pivot, n, s, ln |v|)``.  It has
``n`` by itself, since ``n`` and ``v`` may be far below the rounding errors of
``omega``.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.integrate import DOP853, Radau, solve_ivp
from scipy.optimize import brentq
from slide_oracle import (
    CREEP,
    FIRST_TIME,
    HUGE,
    LAST_SPEED,
    QUICK,
    SLOW,
    Contact,
    Follower,
    Stone,
    contact_of,
    cross,
    dot,
    holding_force,
    parts,
    plus,
    root,
    stone_of,
    times,
)

SMOOTHING = 1e-4  # of rolling resistance
FRICTION, COUPLE, PIVOT, SPIN = range(6, 10)
N_ROLLING = 9
DIRECTION = slice(10, 13)
LOG_SPEED = 13
N_SLIDING = 14
# With |n| < SERIES v/e the closed form loses digits.
SERIES = 0.5
TERMS = 40
SLOWEST = -200.0  # ln |v| in trial steps that fail
HELD = 0  # a side of zero, beside 1 and -1
FAR = 0.25  # a tap's spin counts from this share of the largest spin it could have


@dataclass(frozen=True)
class RubbedStone(Stone):
    """A `Stone` with the levers of rubbing and of rolling resistance."""

    pivot: float = 0.0
    rolling: float = 0.0

    @property
    def patch(self):
        """The radius of the patch."""
        return 16 * self.pivot / (3 * math.pi * self.mu)


def rubbed_stone(body, pivot, mu=math.inf, sigma=0.0, rolling=0.0):
    """Return the stone with the parameters of an object such as `rs.Rattleback`."""
    return RubbedStone(**vars(stone_of(body, mu, sigma)), pivot=pivot, rolling=rolling)


def sliding_share(x):
    """Return ``F / (mu N)`` of Hertz's patch at ``x = v / (e |n|)``."""
    if x <= 1:
        return 3 * math.pi / 32 * (4 * x - x**3)
    if x >= 1 / SERIES:
        return 3 / 16 * series(FORCE_TERMS, 1 / x)
    s = math.asin(1 / x)
    w = math.sqrt(x * x - 1)
    return 3 / (16 * x) * ((4 * x**2 - x**4) * s + w * (x**2 + 2))


def turning_share(x):
    """Return ``M / (mu N e)`` of Hertz's patch at ``x = v / (e |n|)``."""
    if x <= 1:
        return 3 * math.pi / 16 * (1 - x**2 + 3 * x**4 / 8)
    if x >= 1 / SERIES:
        return 3 / 16 * series(MOMENT_TERMS, 1 / x) / x
    s = math.asin(1 / x)
    w = math.sqrt(x * x - 1)
    return 3 / 16 * ((2 - 2 * x**2 + 3 * x**4 / 4) * s + w * (6 - 3 * x**2) / 4)


def expansions():
    """Return the coefficients of both closed forms in ``1 / x^2``.

    ``asin z`` is the sum of ``a_k z^(2k+1)`` and ``sqrt(1 - z^2)`` that of
    ``b_k z^2k``.
    """
    a = []
    b = []
    central = 1.0  # (2k)! / (4^k k!^2)
    for k in range(TERMS + 2):
        a.append(central / (2 * k + 1))
        b.append(-central / (2 * k - 1))
        central *= (2 * k + 1) / (2 * k + 2)
    force = []
    moment = []
    for k in range(TERMS):
        force.append(4 * a[k] - a[k + 1] + b[k + 1] + 2 * b[k])
        turning = 2 * a[k] - 2 * a[k + 1] + 3 * a[k + 2] / 4
        moment.append(turning + (6 * b[k + 1] - 3 * b[k + 2]) / 4)
    return force, moment


FORCE_TERMS, MOMENT_TERMS = expansions()


def series(terms, z):
    """Return the sum of ``terms[k] z^2k``."""
    total = 0.0
    for term in reversed(terms):
        total = term + z * z * total
    return total


def rubbing(y):
    """Return ``q``, the torque of a foot that slides over ``-l N``, and its slope.

    ``y`` is ``e n / v``.
    """
    size = abs(y)
    if size < SERIES:
        slopes = [(2 * k + 1) * term for k, term in enumerate(MOMENT_TERMS)]
        return y * series(MOMENT_TERMS, y) / math.pi, series(slopes, y) / math.pi
    x = 1 / size
    value = turning_share(x) * 16 / (3 * math.pi)
    if x <= 1:
        slope = -2 * x + 1.5 * x**3
    else:
        s = math.asin(size)
        w = math.sqrt(x * x - 1)
        slope = ((3 * x**3 - 4 * x) * s - w * (3 * x - 2 / x)) / math.pi
    return math.copysign(value, y), -slope * x * x


def rubbing_of(y):
    """Return ``q`` of a number, of an array, or of a complex step."""
    if isinstance(y, float):
        return rubbing(y)[0]
    values, slopes = np.vectorize(rubbing)(np.real(y))
    return values + slopes * (y - np.real(y))


def ratio_of(share):
    """Return the ``y`` with ``q(y) = share``; ``|share| < 1``."""

    def excess(log):
        return rubbing(math.exp(log))[0] - abs(share)

    if share == 0:
        return 0.0
    log = brentq(excess, math.log(abs(share)), 25.0, xtol=1e-14)
    return math.copysign(math.exp(log), share)


@dataclass(frozen=True)
class Held:
    """Forces on a foot: a contact, the force, and the torque about the vertical."""

    contact: Contact
    force: tuple
    normal: tuple
    torque: float
    turn: tuple  # domega/dt
    power: float  # of all couples but the torque


def resistance(stone, u, omega):
    """Return the couple of rolling resistance for a normal force of one."""
    across = plus(omega, times(-dot(u, omega), u))
    size = root(dot(across, across) + SMOOTHING**2)
    return times(-stone.rolling / size, across)


def over(a, inertia):
    """Return ``I^-1 a``."""
    return a[0] / inertia[0], a[1] / inertia[1], a[2] / inertia[2]


def answer(contact, acceleration):
    """Return the force that makes up for an acceleration of the foot."""
    return holding_force(replace(contact, free=acceleration))


def assembled(stone, contact, u, omega, force, normal, torque):
    """Return `Held` with all that follows from the forces."""
    drag = resistance(stone, u, omega)
    couple = plus(times(torque, u), times(normal, drag))
    turn = plus(contact.turn(force), over(couple, stone.inertia))
    power = normal * dot(drag, omega) - stone.sigma * dot(omega, omega)
    return Held(contact, force, normal, torque, turn, power)


def rolling_forces(stone, u, omega, lever):
    """Return the forces of a body that rolls, with the torque ``lever N``."""
    contact = contact_of(stone, u, omega)
    couple = plus(times(lever, u), resistance(stone, u, omega))
    by_none = holding_force(contact)
    by_couple = answer(contact, cross(over(couple, stone.inertia), contact.r))
    normal = dot(u, by_none) / (1 - dot(u, by_couple))
    force = plus(by_none, times(normal, by_couple))
    return assembled(stone, contact, u, omega, force, normal, lever * normal)


def holding_torque(stone, u, omega):
    """Return the forces of a body that rolls while the plane keeps ``dn/dt = 0``.

    Two linear equations for the normal force and the torque: the force's part along
    ``u`` is the normal force, and ``u . domega/dt`` vanishes.
    """
    contact = contact_of(stone, u, omega)
    inertia = stone.inertia
    drag = over(resistance(stone, u, omega), inertia)
    pivoting = over(u, inertia)
    by_none = holding_force(contact)
    by_normal = answer(contact, cross(drag, contact.r))
    by_torque = answer(contact, cross(pivoting, contact.r))

    def spun(force):
        return dot(u, over(cross(contact.r, force), inertia))

    a = 1 - dot(u, by_normal)
    b = -dot(u, by_torque)
    c = spun(by_normal) + dot(u, drag)
    d = spun(by_torque) + dot(u, pivoting)
    e = dot(u, by_none)
    f = -dot(u, contact.free_turn) - spun(by_none)
    normal = (e * d - b * f) / (a * d - b * c)
    torque = (a * f - c * e) / (a * d - b * c)
    force = plus(by_none, plus(times(normal, by_normal), times(torque, by_torque)))
    return assembled(stone, contact, u, omega, force, normal, torque)


def forces_on_side(stone, y, side):
    """Return the forces of a body that rolls with the spin on a side, or held."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    if side == HELD:
        return holding_torque(stone, u, omega)
    return rolling_forces(stone, u, omega, -stone.pivot * side)


def sliding_forces(stone, contact, u, omega, s, lever):
    """Return the forces of a foot that slides towards ``s``, its pull, the denominator.

    The torque is ``lever N``; the denominator must be positive.
    """
    leaning = plus(u, times(-stone.mu, s))
    couple = plus(times(lever, u), resistance(stone, u, omega))
    turned = cross(over(couple, stone.inertia), contact.r)
    answered = plus(contact.applied(leaning), turned)
    below = dot(u, answered)
    normal = -dot(u, contact.free) / below
    force = times(normal, leaning)
    forces = assembled(stone, contact, u, omega, force, normal, lever * normal)
    return forces, plus(times(normal, answered), contact.free), below


def sliding_in_place(stone, u, omega, s):
    """Return `sliding_forces` with the torque that keeps ``dn/dt = 0``."""
    contact = contact_of(stone, u, omega)

    def spun(lever):
        forces, _, _ = sliding_forces(stone, contact, u, omega, s, lever)
        return dot(u, forces.turn) / forces.normal

    # Over N, dn/dt is linear in the lever, as 1/N is.
    at_none = spun(0.0)
    lever = at_none / (at_none - spun(1.0))
    return sliding_forces(stone, contact, u, omega, s, lever)


def rolling_rates(stone, y, forces):
    """Return the rates of a state that rolls under forces."""
    if math.isinf(stone.mu) and np.ndim(forces.normal) == 0 and forces.normal <= 0:
        raise ArithmeticError("a plane cannot pull, and then it does not rub")
    power = forces.torque * dot(y[:3], y[3:6])
    return [*forces.contact.du, *forces.turn, 0 * y[0], forces.power, power]


def slip(stone, y, exp):
    """Return `sliding_forces` of a state that slides, and its speed."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    log = y[LOG_SPEED]
    speed = exp(max(log, SLOWEST) if isinstance(log, float) else log)
    lever = -stone.pivot * rubbing_of(stone.patch * y[SPIN] / speed)
    contact = contact_of(stone, u, omega)
    slipping = sliding_forces(stone, contact, u, omega, tuple(y[DIRECTION]), lever)
    return *slipping, speed


def sliding_rates(stone, y, exp=math.exp):
    """Return the rates of a state that slides, times the speed, and the speed."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    s = tuple(y[DIRECTION])
    forces, pull, _, speed = slip(stone, y, exp)
    rates = [*times(speed, forces.contact.du), *times(speed, forces.turn)]
    rates += [-stone.mu * forces.normal * speed * speed]
    rates += [forces.power * speed, forces.torque * y[SPIN] * speed]
    rates += [dot(u, forces.turn) * speed]
    across = cross(u, s)
    rates += plus(times(dot(pull, across), across), times(speed, cross(s, omega)))
    rates += [dot(pull, s)]
    return rates, speed


def rates_in_time(stone, y, exp=math.exp):
    """Return the rates of a state that slides."""
    rates, speed = sliding_rates(stone, y, exp)
    return [rate / speed for rate in rates]


def energy(stone, y):
    """Return the energy, which is zero upright at rest."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    r = contact_of(stone, u, omega).r
    drift = cross(r, omega)
    if len(y) == N_SLIDING:
        drift = plus(times(math.exp(y[LOG_SPEED]), tuple(y[DIRECTION])), drift)
    turning = sum(stone.inertia[i] * omega[i] ** 2 for i in range(3))
    return float((turning + dot(drift, drift)) / 2 - dot(r, u) - 1)


def spin(y):
    """Return ``n = u . omega``, as it was integrated in a slide."""
    return y[SPIN] if len(y) >= N_SLIDING else dot(y[:3], y[3:6])


def with_spin(y, n):
    """Return a state that rolls, with another spin."""
    u = np.array(y[:3])
    u /= np.linalg.norm(u)
    omega = y[3:6] + (n - u @ y[3:6]) * u
    return np.array([*u, *omega, *y[6:N_ROLLING]])


def grip(stone, y, side):
    """Return ``N - |F_t|/mu`` of a body that rolls; below zero it slides."""
    normal, along = parts(tuple(y[:3]), forces_on_side(stone, y, side).force)
    return normal - root(dot(along, along)) / stone.mu


@dataclass
class Slide:
    """One slide; `held` if it began from a held spin."""

    begin: float
    held: bool
    end: float = math.nan
    pauses: int = 0


@dataclass
class Snapshot:
    """What a run has become by a time."""

    t: float
    y: np.ndarray
    t_held: float | None
    held_time: float
    n_slides: int
    slide_time: float
    slide_work: float  # energy lost over that at launch, as the next
    pivot_work: float
    energy_left: float
    energy_error: float  # of energy less work, over the energy at launch


@dataclass
class Run:
    """What became of a run."""

    status: str  # ok, lifts_off, jammed
    t_r: float | None
    turns: list[float]  # all times at which the spin left zero to the other side
    holds: list[tuple[float, float]]
    slides: list[Slide]
    at_reversal: Snapshot | None
    at_end: Snapshot


class SlidingFollower(Follower):
    """A `Follower` of slides, with the tolerances of their states."""

    def __init__(self, equations, method, rtol, n_state):
        super().__init__(equations, method, rtol, n_state)
        if method is Radau:
            tolerances = np.full(n_state, 0.1 * rtol)
            # Errors of direction and ln |v| count only times the speed.
            tolerances[DIRECTION] = 300 * rtol
            tolerances[LOG_SPEED] = 300 * rtol
            self.options["atol"] = tolerances


@dataclass
class Oracle:
    """Follows one body."""

    stone: RubbedStone
    t_end: float
    rtol: float = 1e-12
    first_time: float = FIRST_TIME
    status: str = "ok"
    turns: list = field(default_factory=list)
    holds: list = field(default_factory=list)
    slides: list = field(default_factory=list)

    def run(self, u, omega):
        """Follow a body that rolls, from its launch to the horizon."""
        y = np.array([*u, *omega, 0.0, 0.0, 0.0])
        y[:3] /= np.linalg.norm(y[:3])
        self.at_launch = energy(self.stone, y)
        self.at_reversal = None
        self.long_side = float(np.sign(spin(y)))
        # A tap has no side before its spin has been far.
        self.far = FAR * math.sqrt(2 * self.at_launch / self.stone.inertia[2])
        t = 0.0
        self.side = self.long_side
        if spin(y) == 0:
            self.side = self.side_at_zero(y)
        is_over = False
        while not is_over:
            if len(y) > N_ROLLING:
                t, y, is_over = self.slide(t, y)
            elif self.side == HELD and not self.is_held:
                self.holds.append([t, math.nan])
            elif self.holds_foot(y):
                t, y, is_over = self.roll(t, y)
            else:
                t, y, is_over = self.leave(t, y)
        self.release(t)
        if self.slides and math.isnan(self.slides[-1].end):
            self.slides[-1].end = t
        t_r = self.turns[0] if self.turns else None
        at_end = self.snapshot(t, y)
        return Run(
            self.status,
            t_r,
            self.turns,
            self.holds,
            self.slides,
            self.at_reversal,
            at_end,
        )

    @property
    def is_held(self):
        return bool(self.holds) and math.isnan(self.holds[-1][1])

    def release(self, t):
        """Note that a held spin is held no longer."""
        if self.is_held:
            self.holds[-1][1] = t

    def snapshot(self, t, y):
        """Return what the run has become."""

        def lasted(end):
            return t if math.isnan(end) else end

        work = y[FRICTION] + y[COUPLE] + y[PIVOT]
        now = energy(self.stone, y)
        return Snapshot(
            t,
            y[:6].copy(),
            self.holds[0][0] if self.holds else None,
            math.fsum(lasted(end) - begin for begin, end in self.holds),
            len(self.slides),
            math.fsum(lasted(slide.end) - slide.begin for slide in self.slides),
            -float(y[FRICTION]) / self.at_launch,
            -float(y[PIVOT]) / self.at_launch,
            now / self.at_launch,
            (now - work) / self.at_launch - 1,
        )

    def side_at_zero(self, y):
        """Return the side to which a spin at zero goes, or `HELD`."""
        forces = forces_on_side(self.stone, y, HELD)
        if abs(forces.torque) <= self.stone.pivot * forces.normal:
            return HELD
        for side in (1.0, -1.0):
            turn = forces_on_side(self.stone, y, side).turn
            if side * dot(y[:3], turn) > 0:
                return side
        raise ArithmeticError("neither held nor led away")

    def set_side(self, t, y, side):
        """Note the side on which the spin is, and a reversal if it is the other."""
        self.side = side
        if side == HELD:
            return
        self.release(t)
        if self.long_side and side != self.long_side:
            self.long_side = side
            self.turns.append(t)
            if self.at_reversal is None:
                self.at_reversal = self.snapshot(t, y)

    def holds_foot(self, y):
        if math.isinf(self.stone.mu):
            return True
        return grip(self.stone, y, self.side) > 1e-13 * self.stone.mu

    def roll(self, t, y):
        """Roll, spinning or held, until a limit or until the run is over."""
        stone = self.stone
        side = self.side

        def rates(y):
            return rolling_rates(stone, y, forces_on_side(stone, y, side))

        def events(y):
            watched = {}
            if side == HELD:
                forces = forces_on_side(stone, y, HELD)
                margin = stone.pivot * forces.normal - np.abs(forces.torque)
                watched["released"] = margin
            else:
                watched["zero"] = side * spin(y)
            if not math.isinf(stone.mu):
                watched["slip"] = grip(stone, y, side)
            if not self.long_side:
                watched["far"] = self.far - np.abs(spin(y))
            return watched

        follower = Follower(rates, DOP853, self.rtol, N_ROLLING)
        t, y, name = follower.follow(t, y, self.t_end, events)
        t = float(t)
        if side == HELD:
            y = with_spin(y, 0.0)
        if name == "released":
            torque = forces_on_side(stone, y, HELD).torque
            self.set_side(t, y, float(-np.sign(torque)))
        elif name == "zero":
            y = with_spin(y, 0.0)
            self.set_side(t, y, self.side_at_zero(y))
        elif name == "far":
            self.long_side = side
        return t, y, name is None

    def outgoing(self, y):
        """Return the ways in which a foot at rest may begin to slide, with its pulls.

        They are the directions in which the pull is along the slide and positive, where
        a slide that strays from the direction returns to it.
        """
        u = np.array(y[:3])
        omega = tuple(y[3:6])
        first = np.cross(u, [0.0, 1.0, 0.0])
        first /= np.linalg.norm(first)
        second = np.cross(u, first)
        contact = contact_of(self.stone, tuple(u), omega)

        def slipping(angle):
            s = tuple(math.cos(angle) * first + math.sin(angle) * second)
            if self.side == HELD:
                return s, sliding_in_place(self.stone, tuple(u), omega, s)
            lever = -self.stone.pivot * self.side
            return s, sliding_forces(self.stone, contact, tuple(u), omega, s, lever)

        def across(angle):
            s, (_, pull, _) = slipping(angle)
            return dot(pull, cross(tuple(u), s))

        angles = np.linspace(0, 2 * math.pi, 361)
        values = [across(angle) for angle in angles]
        ways = []
        for k in range(360):
            if values[k] > 0 >= values[k + 1]:
                angle = brentq(across, angles[k], angles[k + 1], xtol=1e-15)
                s, (forces, pull, _) = slipping(angle)
                if dot(pull, s) > 0:
                    ways.append((float(dot(pull, s)), s, forces))
        return ways

    def leave(self, t, y):
        """Begin a slide, or go on with one, where rolling needs more than mu.

        The foot leaves in the time `first_time`, in which it rolls on: the force then
        lies outside of the cone by more than rounding errors.
        """
        stone = self.stone
        rates = rolling_rates(stone, y, forces_on_side(stone, y, self.side))
        later = y + self.first_time * np.array(rates)
        forces = forces_on_side(stone, later, self.side)
        normal, along = parts(tuple(later[:3]), forces.force)
        ways = self.outgoing(later)
        if not ways:
            self.status = "lifts_off" if normal <= 0 else "jammed"
            return t, y, True
        gain, s, forces = min(ways, key=lambda way: dot(way[1], along))
        was_held = self.is_held
        self.release(t)
        if self.slides and math.isnan(self.slides[-1].end):
            self.slides[-1].pauses += 1
        else:
            self.slides.append(Slide(t, was_held))
        speed = gain / 2 * self.first_time
        n = float(spin(later))
        if was_held:
            share = -forces.torque / (stone.pivot * forces.normal)
            n = ratio_of(max(-0.999999, min(0.999999, share))) * speed / stone.patch
        y = np.array([*later, n, *s, math.log(speed)])
        if was_held:
            self.set_side(t, y, math.copysign(1.0, n))
        return t + self.first_time, y, False

    def watched(self, y):
        """Return the events of every slide, and the gain of speed a unit of time."""
        forces, pull, below, _ = slip(self.stone, y, np.exp)
        watched = {"lifts_off": forces.normal, "jammed": below}
        watched["zero"] = self.side * y[SPIN]
        if not self.long_side:
            watched["far"] = self.far - np.abs(y[SPIN])
        return watched, dot(pull, tuple(y[DIRECTION]))

    def slide(self, t, y):
        """Slide until the foot stands still or the run is over."""
        _, gain = self.watched(y)
        if y[LOG_SPEED] >= math.log(QUICK):
            phase = "is_quick"
        elif gain > 0:
            phase = "quickens"
        else:
            phase = "slows"
        while True:
            if phase == "slows":
                t, y, name = self.slow(t, y)
            else:
                t, y, name = self.go_on(t, y, phase)
            if name == "stands":
                self.slides[-1].end = t
                return t, self.stood(t, y), False
            if name == "zero":
                self.set_side(t, y, -self.side)
            elif name == "far":
                self.long_side = self.side
            elif name in ("lifts_off", "jammed"):
                self.status = name
                return t, y, True
            elif name in ("slows", "quickens", "is_quick"):
                phase = name
            else:
                return t, y, True

    def stood(self, t, y):
        """Return the state that rolls on after a slide, and set its side."""
        n = float(y[SPIN])
        rolling = with_spin(y, n)
        if n == 0:
            self.set_side(t, rolling, self.side_at_zero(rolling))
        return rolling

    def go_on(self, t, y, phase):
        """Slide on in time."""

        def events(y):
            watched, gain = self.watched(y)
            if phase == "is_quick":
                return watched | {"slows": y[LOG_SPEED] - math.log(SLOW)}
            is_quick = math.log(QUICK) - y[LOG_SPEED]
            return watched | {"slows": gain, "is_quick": is_quick}

        def rates(y, exp=math.exp):
            return rates_in_time(self.stone, y, exp)

        method = DOP853 if phase == "is_quick" else Radau
        follower = SlidingFollower(rates, method, self.rtol, N_SLIDING)
        t, y, name = follower.follow(t, y, self.t_end, events)
        return float(t), y, name

    def slow(self, t, y):
        """Follow a slide that slows down to its end or until it quickens again."""

        def rates(y, exp=math.exp):
            rates, speed = sliding_rates(self.stone, y[:N_SLIDING], exp)
            return [*rates, speed]

        def events_of_end(y):
            watched, gain = self.watched(y)
            return watched | {
                "quickens": -gain,
                "stands": y[LOG_SPEED] - math.log(LAST_SPEED),
                "horizon": self.t_end - y[N_SLIDING],
            }

        def events_without_creep(y):
            watched = events_of_end(y)
            return watched | {"creeps": watched["quickens"] - CREEP}

        _, gain = self.watched(y)
        y = np.array([*y, t])
        name = "creeps"
        if gain < -CREEP:
            follower = SlidingFollower(rates, DOP853, self.rtol, N_SLIDING + 1)
            _, y, name = follower.follow(0.0, y, HUGE, events_without_creep)
        if name == "creeps":
            follower = SlidingFollower(rates, Radau, self.rtol, N_SLIDING + 1)
            _, y, name = follower.follow(0.0, y, HUGE, events_of_end)
        t = float(y[N_SLIDING])
        y = y[:N_SLIDING]
        if name != "stands":
            return t, y, name
        # The rest is so short that its course is a straight line.
        slow, speed = sliding_rates(self.stone, y)
        rest = -speed / slow[LOG_SPEED]
        y = y + rest / speed * np.array(slow)
        return t + rest, y, name


def run(body, u, omega, t_end, pivot, mu=math.inf, sigma=0.0, rolling=0.0, **options):
    """Return the `Run` of a body, such as an `rs.Rattleback`, from a state that rolls.

    It goes on to the horizon, beyond reversals.
    """
    stone = rubbed_stone(body, pivot, mu, sigma, rolling)
    return Oracle(stone, t_end, **options).run(u, omega)


def zeros_of_regularised(body, u, omega, t_end, pivot, eps, rtol=1e-11):
    """Return the zeros of a spin under ``-l N n / sqrt(n^2 + eps^2)``, and the end.

    The body rolls; nothing is held.
    """
    stone = rubbed_stone(body, pivot)

    def rates(t, y):
        y = y.tolist()
        n = dot(y[:3], y[3:6])
        lever = -pivot * n / math.sqrt(n * n + eps * eps)
        forces = rolling_forces(stone, tuple(y[:3]), tuple(y[3:6]), lever)
        return rolling_rates(stone, y, forces)

    def zero(t, y):
        return spin(y)

    start = np.array([*u, *omega, 0.0, 0.0, 0.0])
    followed = solve_ivp(
        rates, (0, t_end), start, "DOP853", rtol=rtol, atol=1e-3 * rtol, events=zero
    )
    assert followed.success, followed.message
    return followed.t_events[0], followed.y[:, -1]


@dataclass(frozen=True)
class Crept:
    """A run under the whole law of the patch."""

    t_r: float | None
    fastest: float  # speed of the foot
    energy_error: float


def patch_rates(stone, smoothest=0.0, has_torque=True):
    """Return the rates of ``(u, omega, v, work)`` under the whole law of the patch.

    Coulomb's law holds at each point of the circle.  Force and torque are those of the
    closed form; the foot creeps at the velocity ``v`` and nothing sticks.  A spin ``n``
    counts as the root of its square and that of `smoothest`; a spin that the patch
    holds is then a multiple of it.
    """
    mu = stone.mu

    def rates(t, y):
        u = tuple(y[:3].tolist())
        omega = tuple(y[3:6].tolist())
        v = tuple(y[6:9].tolist())
        contact = contact_of(stone, u, omega)
        n = dot(u, omega)
        size = math.hypot(n, smoothest)
        speed = math.sqrt(dot(v, v))
        reach = stone.patch * size
        if speed <= reach:
            x = speed / reach
            per_speed = 3 * math.pi / 32 * (4 - x * x) / reach  # F / (mu N v)
            turning = turning_share(x)
        elif n == 0:
            per_speed = 1 / speed
            turning = 0.0
        else:
            per_speed = sliding_share(speed / reach) / speed
            turning = turning_share(speed / reach)
        # The sliding force is mu F_hat towards -v; s = F_hat v/|v| is shorter than one.
        s = times(per_speed, v)
        lever = 0.0
        if has_torque and n != 0:
            lever = -mu * stone.patch * turning * n / size
        forces, pull, _ = sliding_forces(stone, contact, u, omega, s, lever)
        work = forces.torque * n - mu * forces.normal * dot(s, v)
        turned = plus(pull, times(-1, cross(omega, v)))
        return [*contact.du, *forces.turn, *turned, work]

    return rates


def growth_under_patch(body, n_i, pivot, mu, has_torque=True):
    """Return the growth rates of roll and pitch about an upright spin.

    They are the real parts of the eigenvalues of what is horizontal, from central
    differences of :func:`patch_rates`, with the spin as it is.
    """
    rates = patch_rates(rubbed_stone(body, pivot, mu), has_torque=has_torque)
    upright = np.array([0.0, 0.0, -1.0, 0.0, 0.0, -n_i, 0.0, 0.0, 0.0, 0.0])
    horizontal = [0, 1, 3, 4, 6, 7]
    columns = []
    for place in horizontal:
        step = np.zeros(10)
        step[place] = 1e-6
        change = np.subtract(rates(0, upright + step), rates(0, upright - step))
        columns.append(change[horizontal] / 2e-6)
    values = np.linalg.eigvals(np.transpose(columns))
    swings = values[values.imag > 0]
    roll, pitch = swings[np.argsort(swings.imag)].real
    return float(roll), float(pitch)


def crept(body, u, omega, t_end, mu, patch, rtol=1e-9, method="Radau"):
    """Return what becomes of a launch under the law of Hertz's patch, radius ``patch``.

    It ends at the first zero of the spin.
    """
    stone = rubbed_stone(body, 3 * math.pi / 16 * mu * patch, mu)
    rates = patch_rates(stone)

    def total(y):
        u = tuple(y[:3])
        omega = tuple(y[3:6])
        r = contact_of(stone, u, omega).r
        drift = plus(tuple(y[6:9]), cross(r, omega))
        turning = sum(stone.inertia[i] * omega[i] ** 2 for i in range(3))
        return (turning + dot(drift, drift)) / 2 - dot(r, u) - 1

    def zero(t, y):
        return dot(y[:3], y[3:6])

    zero.terminal = True
    start = np.array([*u, *omega, 0.0, 0.0, 0.0, 0.0])
    # The rates do not depend on the work, and SciPy widens its differences for it.
    with np.errstate(over="ignore"):
        followed = solve_ivp(
            rates, (0, t_end), start, method, rtol=rtol, atol=1e-3 * rtol, events=zero
        )
    assert followed.success, followed.message
    speeds = np.linalg.norm(followed.y[6:9], axis=0)
    t_r = float(followed.t_events[0][0]) if followed.t_events[0].size else None
    end = followed.y[:, -1]
    error = float((total(end) - end[9]) / total(start) - 1)
    return Crept(t_r, float(speeds.max()), error)
