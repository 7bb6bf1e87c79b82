"""Rolling, held, sliding and pivoting phases with events: one program for all.

This module does not import `rattlesweep`; the mechanics are `contact_mechanics`.  A
held spin is released, to the side to which the torque gives way, where ``|T|`` reaches
``l N``.  Otherwise a spin at zero goes on to the side to which it is led by the full
torque against that side.  The law of a foot that slides is smooth where ``n`` passes
zero at ``v > 0``.  So no spin is held in a slide, and every zero of ``n`` in a slide is
a crossing.  Where ``v`` and ``n`` vanish together the torque depends on the way there:

- A slide that ends with ``n`` different from zero ends in rolling with the full torque,
  as ``y`` becomes infinite.  That both vanish at one time is an exception.
- A slide that begins from a held spin begins at ``v = n = 0``.  From
  ``v dy/dt = e dn/dt - y dv/dt`` the ratio ``y`` settles at once where ``e dn/dt = y
  dv/dt``.  As ``dv/dt`` grows from zero this is ``dn/dt = 0``: the torque is the one
  that held the spin, ``q(y) = -T / (l N)``, which has a solution for ``|T| < l N``.
  The spin leaves zero together with the foot, to the side of ``y``.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from contact_mechanics import (
    COUPLE,
    DIRECTION,
    FRICTION,
    HELD,
    LOG_SPEED,
    N_ROLLING,
    N_SLIDING,
    PIVOT,
    SPIN,
    Stone,
    contact_of,
    cross,
    dot,
    energy,
    forces_on_side,
    grip,
    parts,
    rates_in_time,
    rolling_rates,
    sliding_forces,
    sliding_in_place,
    sliding_rates,
    slip,
    spin,
    stone_of,
    times,
    with_spin,
)
from hertz_patch import ratio_of
from scipy.integrate import DOP853, Radau
from scipy.optimize import brentq, minimize_scalar

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
FAR = 0.25  # a tap's spin counts from this share of the largest spin it could have


@dataclass
class Slide:
    """One slide, from the moment at which the foot leaves to the one at which it holds.

    ``work`` is the energy that it took, positive; `held` says that it began from a held
    spin.
    """

    begin: float
    held: bool = False
    end: float = math.nan
    work: float = 0.0
    steps: int = 0
    fastest: float = 0.0
    pauses: int = 0  # moments of rest from which it slid on


@dataclass
class Snapshot:
    """What a run has become by a time."""

    t: float
    y: np.ndarray  # u and omega
    n: float  # spin, as it was integrated in a slide
    works: tuple  # of friction, of couples, of rubbing
    energy: float
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
    energy_at_launch: float
    turns: list[float]  # all times at which the spin left zero to the other side
    holds: list[tuple[float, float]]
    slides: list[Slide]
    at_reversal: Snapshot | None
    at_end: Snapshot

    @property
    def t_r(self):
        """The first reversal, or None."""
        return self.turns[0] if self.turns else None


class Follower:
    """Integrates one phase from event to event."""

    def __init__(self, equations, method, rtol, n_state=N_SLIDING):
        self.method = method
        self.options = {"rtol": rtol, "atol": 1e-3 * rtol}
        if method is Radau:
            self.options["jac"] = lambda t, y: complex_jacobian(equations, y)
            # Radau judges its steps by a formula of order 3; errors of direction and
            # ln |v| count only times the speed.
            self.options["rtol"] = 30 * rtol
            tolerances = np.full(n_state, 0.1 * rtol)
            tolerances[DIRECTION] = 300 * rtol
            tolerances[LOG_SPEED] = 300 * rtol
            self.options["atol"] = tolerances
        # Python's own floats are faster than NumPy's.
        self.rates = lambda t, y: equations(y.tolist())
        self.steps = 0
        self.highest = -math.inf  # ln |v| in a slide

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
            if len(solver.y) > N_ROLLING:
                self.highest = max(self.highest, solver.y[LOG_SPEED])
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


def leaving_forces(stone, y, side, s):
    """Return `sliding_forces` of a foot that leaves rest towards ``s``."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    if side == HELD:
        return sliding_in_place(stone, u, omega, s)
    contact = contact_of(stone, u, omega)
    return sliding_forces(stone, contact, u, omega, s, -stone.pivot * side)


def outgoing(stone, y, side):
    """Return the ways in which a foot at rest may begin to slide, with its pulls.

    They are the directions in which the pull is along the slide and positive, where
    a slide that strays from the direction returns to it.
    """
    u = np.array(y[:3])
    first = np.cross(u, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(u, first)

    def slipping(angle):
        s = tuple(math.cos(angle) * first + math.sin(angle) * second)
        return s, leaving_forces(stone, y, side, s)

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


@dataclass
class Oracle:
    """Follows one body to its horizon, or only to its first reversal."""

    stone: Stone
    t_end: float
    rtol: float = 1e-12
    through: bool = True
    first_time: float = FIRST_TIME
    status: str = "ok"
    turns: list = field(default_factory=list)
    holds: list = field(default_factory=list)
    slides: list = field(default_factory=list)

    def run(self, u, omega, v=None):
        """Follow a body whose foot rests or has a velocity ``v``."""
        y = np.array([*u, *omega, 0.0, 0.0, 0.0])
        y[:3] /= np.linalg.norm(y[:3])
        if v is not None:
            speed = math.sqrt(dot(v, v))
            y = np.array([*y, spin(y), *times(1 / speed, v), math.log(speed)])
            self.slides.append(Slide(0.0))
        self.at_launch = energy(self.stone, y)
        self.at_reversal = None
        self.long_side = float(np.sign(spin(y)))
        # A tap has no side before its spin has been far.
        self.far = FAR * math.sqrt(2 * self.at_launch / self.stone.inertia[2])
        t = 0.0
        self.side = self.long_side
        if v is None and spin(y) == 0:
            self.side = self.side_at_zero(y)
        is_over = False
        while not (is_over or self.has_turned):
            if len(y) > N_ROLLING:
                t, y, is_over = self.slide(t, y)
            elif self.side == HELD and not self.is_held:
                self.holds.append([t, math.nan])
            elif self.holds_foot(y):
                t, y, is_over = self.roll(t, y)
            else:
                t, y, is_over = self.leave(t, y)
        self.release(t)
        self.close_slide(t, y)
        at_end = self.snapshot(t, y)
        return Run(
            self.status,
            self.at_launch,
            self.turns,
            self.holds,
            self.slides,
            self.at_reversal,
            at_end,
        )

    @property
    def has_turned(self):
        return bool(self.turns) and not self.through

    @property
    def slides_on(self):
        return bool(self.slides) and math.isnan(self.slides[-1].end)

    def close_slide(self, t, y):
        """Note that a slide goes on no longer."""
        if self.slides_on:
            self.slides[-1].end = t
            self.slides[-1].work -= float(y[FRICTION])

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
            float(spin(y)),
            (float(y[FRICTION]), float(y[COUPLE]), float(y[PIVOT])),
            now,
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
        self.close_slide(t, y)
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
        ways = outgoing(stone, later, self.side)
        if not ways:
            self.status = "lifts_off" if normal <= 0 else "jammed"
            return t, y, True
        gain, s, forces = min(ways, key=lambda way: dot(way[1], along))
        was_held = self.is_held
        self.release(t)
        if self.slides_on:
            self.slides[-1].pauses += 1
        else:
            self.slides.append(Slide(t, was_held, work=float(y[FRICTION])))
        # The gain has grown from zero, or was there from the start.
        _, pull, _ = leaving_forces(stone, y, self.side, s)
        speed = (max(0.0, dot(pull, s)) + gain) / 2 * self.first_time
        n = float(spin(y))
        if was_held:
            share = -forces.torque / (stone.pivot * forces.normal)
            n = ratio_of(max(-0.999999, min(0.999999, share))) * speed / stone.patch
        y = np.array([*y, n, *s, math.log(speed)])
        count = N_ROLLING if was_held else N_ROLLING + 1
        y[:count] += self.first_time * np.array(rates_in_time(stone, y))[:count]
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
        watched, gain = self.watched(y)
        if watched["jammed"] <= 0:
            self.status = "jammed"
            return t, y, True
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
                return t, self.stood(t, y), False
            if name == "zero":
                self.set_side(t, y, -self.side)
                if self.has_turned:
                    return t, y, True
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
        follower = Follower(rates, method, self.rtol)
        t, y, name = follower.follow(t, y, self.t_end, events)
        slide = self.slides[-1]
        slide.steps += follower.steps
        slide.fastest = max(slide.fastest, math.exp(follower.highest))
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
            follower = Follower(rates, DOP853, self.rtol, N_SLIDING + 1)
            _, y, name = follower.follow(0.0, y, HUGE, events_without_creep)
            self.slides[-1].steps += follower.steps
        if name == "creeps":
            follower = Follower(rates, Radau, self.rtol, N_SLIDING + 1)
            _, y, name = follower.follow(0.0, y, HUGE, events_of_end)
            self.slides[-1].steps += follower.steps
        t = float(y[N_SLIDING])
        y = y[:N_SLIDING]
        if name != "stands":
            return t, y, name
        # The rest is so short that its course is a straight line.
        slow, speed = sliding_rates(self.stone, y)
        rest = -speed / slow[LOG_SPEED]
        y = y + rest / speed * np.array(slow)
        return t + rest, y, name


def run(
    body, u, omega, t_end, pivot=0.0, mu=math.inf, sigma=0.0, rolling=0.0, **options
):
    """Return the `Run` of a body, such as an `rs.Rattleback`, from a state that rolls.

    It goes on to the horizon, beyond reversals unless ``through`` is false.
    """
    stone = stone_of(body, mu, sigma, pivot, rolling)
    return Oracle(stone, t_end, **options).run(u, omega)
