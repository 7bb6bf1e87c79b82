"""Zeros of the spin at which pivoting friction changes its sense, and spins held there.

A body that rolls with pivoting friction (`physics.pivoting`) moves in one of three
ways: with a positive or a negative spin, each until a zero of the spin, or with the
spin held at zero, until the torque that this takes exceeds ``l F_n``.  These are limits
of the motion, whose zeros the lanes find as they find others (`lanes.events`).  The
sense of the spin, 0 while it is held, is the last constant of a lane.

A reversal is a zero at which the spin goes over to the other side, or the end of a rest
from which it does.
"""

# mypy: ignore-errors
from dataclasses import replace
from math import nan

from numba import njit

from rattlesweep.integrate.lanes import runs
from rattlesweep.integrate.lanes.events import REVERSED, may_fall
from rattlesweep.integrate.lanes.lane import (
    HELD,
    INNER,
    SMOOTH,
    TURNS,
    Hooks,
    Point,
    lane_of,
    moved,
    widest_vectors,
)
from rattlesweep.integrate.status import Status
from rattlesweep.physics.full import FASTMATH, scalar

OK = int(Status.OK)
LIMIT = int(Status.LIMIT)
# Columns of the results of a run, after its state.
T_HELD, HELD_TIME, PIVOT_WORK, N_COLUMNS = range(4)
TINY = 1e-290
# By what share of the lever the limit of a rest is passed before it counts, so that
# rounding errors do not end it at once.
PASSED = 1e-13
# Rounding errors of the spin, as a share of its scale.
LEAST_SPIN = 1e-14


@njit(**INNER)
def set_sense(lane, sense):
    """Let the torque act against a spin of this sign, or hold the spin for 0."""
    lane.constants = lane.constants[:-1] + (sense,)  # noqa: RUF005
    lane.spin_ends = HELD if sense == 0.0 else TURNS


@njit(**INNER)
def give_slack(lane, y):
    """Let the spin begin on its side of zero, although it is a rounding error."""
    n = lane.constants[-1] * lane.problem.model.spin(y)
    # After a tap the bound of the rate is unknown until the spin has been far.
    rate = lane.arm_rate if lane.arm > 0.0 else lane.rate_max
    scale = abs(lane.n_launch) + rate / lane.swing
    lane.slack = max(0.0, -n) + LEAST_SPIN * scale


@scalar
def lever_of(lane):
    """Return the lever of the torque."""
    return lane.constants[-2]


@scalar
def margin(lane, y):
    """Return the torque that the plane can still give to hold the spin."""
    torque, normal = lane.problem.model.pivot(y, lane.constants)
    return lever_of(lane) * (normal + PASSED) - abs(torque)


@scalar
def hold_point(lane, h, y, f):
    """Return the limit of a spin that is held, positive while it is."""
    ahead = runs.DIFFERENCE / lane.swing
    now = margin(lane, y)
    later = margin(lane, moved(y, f, ahead))
    return Point(h, now, (later - now) / ahead)


@scalar
def turn_point(lane, h, y, f):
    """Return the limit of a spin with a sign; nothing for one that is held."""
    sense = lane.constants[-1]
    model = lane.problem.model
    value = sense * model.spin(y) + lane.slack
    rate = sense * model.spin_rate(y, f)
    return Point(h, 1.0 if sense == 0.0 else value, rate)


@scalar
def product(first, second):
    """Return the product of two functions of the state, zero where one of them is."""
    value = first.value * second.value
    rate = first.value * second.rate + first.rate * second.value
    return Point(first.h, value, rate)


@njit(fastmath=FASTMATH, **INNER)
def observe_held(problem, w):
    """Compute the limit at the end of the step tried on every lane that is held."""
    widest_vectors()
    held = 0.0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        held += 1.0 if lane.spin_ends == HELD else 0.0
    if held == 0.0:
        return
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        end = hold_point(lane, lane.h, lane.y1, lane.f1)
        limit = lane.limit1
        both = product(limit, end)
        is_held = lane.spin_ends == HELD
        leaves = 1.0 if is_held & may_fall(lane.limit0, both) else 0.0
        value = both.value if is_held else limit.value
        rate = both.rate if is_held else limit.rate
        lane.limit1 = Point(lane.h, value, rate)
        lane.leaves = max(lane.leaves, leaves)
        lane.watched += leaves


@njit(**INNER)
def distance_from_zero(lane):
    """Return how far a lane is from the limit of the spin, as a share of its scale."""
    if lane.spin_ends == HELD:
        return abs(margin(lane, lane.y1)) / (lever_of(lane) + TINY)
    scale = abs(lane.n_launch) + abs(lane.rate1) / lane.swing
    return abs(lane.n1) / (scale + TINY)


@njit(fastmath=FASTMATH, **INNER)
def sense_from_zero(lane, y):
    """Return the sense with which a spin leaves zero, 0 if the plane holds it."""
    set_sense(lane, 0.0)
    torque, normal = lane.problem.model.pivot(y, lane.constants)
    if abs(torque) <= lever_of(lane) * normal:
        return 0.0
    return -1.0 if torque > 0.0 else 1.0


@njit(**INNER)
def hold(lane, t):
    """Note that the spin is held from the time ``t`` on."""
    lane.t_hold = t
    lane.rate_held = lane.rate_max
    if lane.t_held < 0.0:
        lane.t_held = t


@njit(**INNER)
def release(lane, t):
    """Note that the spin is held until the time ``t``."""
    lane.held_time += t - lane.t_hold
    lane.rate_max = max(lane.rate_max, lane.rate_held)


@njit(**INNER)
def slide_off(lane, t):
    """Let zeros of the spin be points of a slide, which begins at the time ``t``."""
    if lane.spin_ends == HELD:
        release(lane, t)
    lane.spin_ends = SMOOTH


@njit(**INNER)
def settle(lane, y, t):
    """Let the torque act on a body that rolls from the state ``y`` on."""
    n = lane.problem.model.spin(y)
    sense = 1.0 if n > 0.0 else -1.0
    if n == 0.0:
        sense = sense_from_zero(lane, y)
    set_sense(lane, sense)
    if sense == 0.0:
        hold(lane, t)


@njit(**INNER)
def prepare(lane, rate):
    """Let the torque act from the launch on; ``rate`` bounds the rate of the spin."""
    lane.t_held = -1.0
    lane.rate_max = rate
    settle(lane, lane.y, 0.0)


@njit(**INNER)
def add_hold(lane, y, f, h):
    """Multiply the limit by that of a spin that is held."""
    if lane.spin_ends == HELD:
        lane.limit1 = product(lane.limit1, hold_point(lane, h, y, f))


@njit(fastmath=FASTMATH, **INNER)
def leave_zero(lane, t):
    """Let the spin go on from zero at the end of the step; return its sense."""
    was_held = lane.spin_ends == HELD
    if was_held:
        torque, _ = lane.problem.model.pivot(lane.y1, lane.constants)
        sense = -1.0 if torque > 0.0 else 1.0
        release(lane, t)
    else:
        sense = sense_from_zero(lane, lane.y1)
    set_sense(lane, sense)
    give_slack(lane, lane.y1)
    if sense == 0.0:
        hold(lane, t)
    # The force jumps here, and both its values count.
    runs.note_contact(lane)
    model = lane.problem.model
    y = lane.y1
    f = model.rhs(y, lane.constants)
    lane.f1 = f
    lane.rate1 = model.spin_rate(y, f)
    lane.limit1 = lane.problem.hooks.limit(lane, lane.h, y, f)
    add_hold(lane, y, f, lane.h)
    lane.ratio1, lane.lift1 = runs.contact_points(lane, lane.h, y, f)
    begin = lane.limit1
    # At the end of a rest the rate of the spin is a rounding error, too.
    lane.limit1 = Point(begin.h, begin.value, max(begin.rate, 0.0))
    lane.h_next = lane.full_next
    lane.root = 1.0
    lane.last = 0.0
    return sense


def pivoting_hooks(base: Hooks) -> Hooks:
    """Return the functions of a model with pivoting friction, from those without."""
    base_start = base.start
    base_limit = base.limit
    base_observe_limit = base.observe_limit
    base_change = base.change
    base_finish = base.finish

    @njit(**INNER)
    def start(lane, run, y0, constants, probe, plan):
        base_start(lane, run, y0, constants, probe, plan)
        add_hold(lane, lane.y, lane.f, 0.0)
        runs.start_points(lane)
        if lane.slip1.speed > 0.0:
            slide_off(lane, 0.0)

    @scalar
    def limit(lane, h, y, f):
        return product(base_limit(lane, h, y, f), turn_point(lane, h, y, f))

    @njit(**INNER)
    def observe_limit(problem, w):
        base_observe_limit(problem, w)
        observe_held(problem, w)

    @njit(**INNER)
    def change(lane, status, move, recording):
        t = lane.t + (lane.h - lane.t_low)
        slid = lane.slip.speed > 0.0
        is_at_zero = False
        if status == LIMIT and not slid:
            other = base_limit(lane, lane.h, lane.y1, lane.f1)
            is_at_zero = distance_from_zero(lane) <= abs(other.value)
        if not is_at_zero:
            if slid and lane.slip1.speed == 0.0:
                settle(lane, lane.y1, t)
            status, move = base_change(lane, status, move, recording)
            slides = lane.slip1.speed > 0.0
            if slides and lane.spin_ends != SMOOTH:
                slide_off(lane, t)
            if slid and not slides:
                lane.limit1 = lane.problem.hooks.limit(lane, lane.h, lane.y1, lane.f1)
                add_hold(lane, lane.y1, lane.f1, lane.h)
            return status, move
        sense = leave_zero(lane, t)
        # A spin that returns to its side has not reversed.
        if sense * lane.sign >= 0.0 or lane.arm > 0.0:
            return OK, move
        if not runs.goes_on(lane.problem, recording):
            return OK, REVERSED
        lane.sign = sense
        runs.note_zero(lane, t, recording.reversals)
        return OK, move

    @njit(**INNER)
    def finish(lane, status, reversal, t, run, result, counts, recording):
        base_finish(lane, status, reversal, t, run, result, counts, recording)
        if lane.spin_ends == HELD:
            lane.held_time += t - lane.t_hold
            # Without the rounding errors of the state, so that rows tell it is held.
            result[run, runs.N_END] = 0.0
        model = lane.problem.model
        first = runs.FIRST_STATE + model.n_state
        result[run, first + T_HELD] = lane.t_held if lane.t_held >= 0.0 else nan
        result[run, first + HELD_TIME] = lane.held_time
        # Zero and not -0 for a run without a torque.
        result[run, first + PIVOT_WORK] = 0.0 - model.pivot_work(lane.y1) / lane.energy0

    return replace(
        base,
        start=start,
        prepare=prepare,
        limit=limit,
        observe_limit=observe_limit,
        change=change,
        finish=finish,
    )
