"""Slides of a run in a lane: their steps, their begin and their end.

A body rolls until the force that keeps its contact point at rest exceeds ``mu`` times
the normal force; this is the limit of the model, whose zero the lanes find as they find
others (`lanes.events`).  From there the lane slides: its steps are those of
:func:`try_slide` and not of ``attempt``, in the same turns as those of the other lanes,
and everything that is observed at steps is observed as before.  It rolls again once
the speed is zero and friction can hold the contact point, and otherwise slides on.

The angle of sliding is stiff near the begin and the end of a slide (`physics.sliding`),
and nothing else is.  So a step of a Radau IIA method solves its equations for the
angle by Newton's method, which needs one derivative a stage, and for the rest by
iteration.  Near the end of a slide steps become shorter with the speed, since the
equations have no sense beyond its zero.
"""

# mypy: ignore-errors
from math import floor, isfinite, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from rattlesweep.integrate.collocation import radau
from rattlesweep.integrate.lanes import runs
from rattlesweep.integrate.lanes.events import STEP
from rattlesweep.integrate.lanes.extremes import may_dip, may_peak
from rattlesweep.integrate.lanes.lane import (
    INNER,
    N_SLIP,
    NEVER,
    ROLLING,
    SLIDING,
    SLIP_ANGLE,
    SLIP_SPEED,
    SLIP_WORK,
    TINY,
    Mode,
    Point,
    Slip,
    first_of,
    lane_of,
    moved,
)
from rattlesweep.integrate.status import Status
from rattlesweep.physics.full import FASTMATH, scalar
from rattlesweep.physics.pivoting import LEAST_SPEED
from rattlesweep.physics.sliding import (
    TWO_PI,
    contact_at,
    meets_singularity,
    outgoing,
    push,
    settled_direction,
    slip_energy,
    spun,
)
from rattlesweep.physics.stone import dot

OK = int(Status.OK)
AT_LIMIT = int(Status.LIMIT)
STEP_TOO_SMALL = int(Status.STEP_TOO_SMALL)
LIFTS_OFF = int(Status.LIFTS_OFF)
JAMMED = int(Status.JAMMED)
RIM = int(Status.RIM)

STAGES = 5
METHOD = radau(STAGES)
POINTS = METHOD.points
INTEGRALS = METHOD.integrals
# Legendre coefficients of the derivative, from whose decay the error is estimated.
THIRD = METHOD.spectrum[2]
FIFTH = METHOD.spectrum[4]
MAX_SWEEPS = 25  # iterations of the equations of a step
SOLVED = 1e-2  # share of the tolerance to which the equations are solved
# Rounding errors of a state over its size: no step is more exact.
ROUNDING = 1e-15
LARGEST_TURN = 0.5  # of the angle in an iteration
FAILED = 1e30  # squared error of a step whose equations were not solved

BEGINNING = 1e-290  # speed at the begin of a slide
# A slide whose rest is this short, in radians of the fastest swing, ends with a step
# along the derivative.
LAST_ANGLE = 1e-8
# If the deceleration changes by more than this share until then, the direction turns,
# and it may meet the singularity.
STEADY = 0.1
# Fraction of the time to rest that a step leaves: at least, and at most.
LEAST_LEFT = 0.1
MOST_LEFT = 0.3
FIRST_ANGLE = 0.1  # first step of a slide, in radians of the fastest swing
LEAST_MOBILITY = 1e-3  # below it the normal force grows without bound
# Height left below the rim, in a, at which a zero of the limit is that of the rim.
AT_RIM = 1e-9
# A slide is jammed where steps become too small this short before the mobility is zero,
# in radians of the fastest swing: it falls as the root of the time that is left.
JAMMING_ANGLE = 1e-6
TURN_AHEAD = 1e-6  # of differences with respect to the angle
RESULTS = (
    ("t_slide", float),
    ("n_slides", np.int32),
    ("slide_time", float),
    ("slide_work", float),
)


@njit(fastmath=FASTMATH, **INNER)
def contact_of(model, y, slip, mu, constants):
    """Return the contact of a body, ``I^-1 g``, and what `Slide.place` returns."""
    placed = model.slide.place(y, mu * (slip.speed + LEAST_SPEED), constants)
    _, u, omega, r, w, inertia, torque, drag = placed
    contact, own = contact_at(u, omega, r, w, inertia, torque, drag)
    return contact, own, placed


@njit(fastmath=FASTMATH, **INNER)
def contact_at_slip(lane, y, slip):
    """Return what :func:`contact_of` does for a lane's body."""
    return contact_of(lane.problem.model, y, slip, lane.mu, lane.constants)


class Motion(NamedTuple):
    """What a step needs of a sliding body in one state."""

    f: tuple[float, ...]  # derivative of the state
    slip: Slip  # derivative of the slip
    stiffness: float  # derivative of the angle's rate with respect to the angle
    normal: float  # normal force
    mobility: float  # of the contact along the force
    margin: float  # positive where the body can go on sliding


@njit(fastmath=FASTMATH, **INNER)
def motion_of(lane, y, slip):
    """Return the :class:`Motion` of a lane's body in a state."""
    model = lane.problem.model
    mu = lane.mu
    contact, own, placed = contact_of(model, y, slip, mu, lane.constants)
    _, u, _, r, _, inertia, _, drag = placed
    normal, mobility, along, across, slope = push(contact, mu, slip.angle)
    turned = spun(own, u, r, inertia, drag, mu, slip.angle, normal)
    f = model.slide.derivative(y, slip, placed, turned, normal)
    turning = across / slip.speed - contact.turn
    slip_rate = Slip(along, turning, -mu * normal * slip.speed)
    margin = min(contact.need, mobility - LEAST_MOBILITY)
    return Motion(f, slip_rate, slope / slip.speed, normal, mobility, margin)


@njit(**INNER)
def stage_of(lane, numbers):
    """Return state and slip in a row of numbers, the slip after the state."""
    n = len(lane.y)
    slip = Slip(
        numbers[n + SLIP_SPEED], numbers[n + SLIP_ANGLE], numbers[n + SLIP_WORK]
    )
    return first_of(numbers, lane.problem.model.n_state), slip


@njit(**INNER)
def solve_angles(matrix, turns):
    """Solve linear equations for the angles at the stages, in place."""
    for k in range(STAGES):
        pivot = k
        for i in range(k + 1, STAGES):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(STAGES):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            turns[k], turns[pivot] = turns[pivot], turns[k]
        for i in range(k + 1, STAGES):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, STAGES):
                matrix[i, j] -= factor * matrix[k, j]
            turns[i] -= factor * turns[k]
    for k in range(STAGES - 1, -1, -1):
        for j in range(k + 1, STAGES):
            turns[k] -= matrix[k, j] * turns[j]
        turns[k] /= matrix[k, k]


@njit(fastmath=FASTMATH, **INNER)
def time_to_rest(lane, now):
    """Return the time in which the speed falls to zero, or infinity.

    The speed is taken as a parabola in time, from its rates at two points; ``now`` is
    the motion at the start of the step.
    """
    slip = lane.slip
    rate = now.slip
    if slip.speed <= BEGINNING or rate.speed >= 0.0:
        return np.inf
    ahead = min(runs.DIFFERENCE / lane.swing, -0.1 * slip.speed / rate.speed)
    next_slip = Slip(
        slip.speed + ahead * rate.speed, slip.angle + ahead * rate.angle, slip.work
    )
    later = motion_of(lane, moved(lane.y, now.f, ahead), next_slip)
    bend = (later.slip.speed - rate.speed) / ahead
    square = rate.speed * rate.speed - 2.0 * slip.speed * bend
    if square <= 0.0:
        return np.inf
    return 2.0 * slip.speed / (sqrt(square) - rate.speed)


@njit(fastmath=FASTMATH, **INNER)
def predict(lane, now, stages):
    """Write a first guess of state and slip at the stages.

    ``now`` is the motion at the start of the step.
    """
    y = lane.y
    slip = lane.slip
    h = lane.h
    n = len(y)
    rate = now.slip
    begins = slip.speed <= BEGINNING
    # Where the angle is stiff, its rate at the start says nothing about the step.
    turning = 0.0 if begins or abs(h * now.stiffness) >= 1.0 else rate.angle
    for i in range(STAGES):
        ahead = h * POINTS[i]
        for c in range(n):
            stages[i, c] = y[c] + ahead * now.f[c]
        stages[i, n + SLIP_SPEED] = slip.speed + ahead * rate.speed
        stages[i, n + SLIP_ANGLE] = slip.angle + ahead * turning
        stages[i, n + SLIP_WORK] = slip.work
    if not begins:
        return
    # The direction follows the force, and the speed is the integral of its rate.
    growths = np.empty(STAGES)
    for i in range(STAGES):
        state, here = stage_of(lane, stages[i])
        contact, _, _ = contact_at_slip(lane, state, here)
        before = stages[max(i - 1, 0), n + SLIP_ANGLE]
        angle, _ = settled_direction(contact, lane.mu, before)
        _, _, along, _, _ = push(contact, lane.mu, angle)
        stages[i, n + SLIP_ANGLE] = angle
        growths[i] = along
    for i in range(STAGES):
        speed = 0.0
        for j in range(STAGES):
            speed += h * INTEGRALS[i, j] * growths[j]
        stages[i, n + SLIP_SPEED] = speed


@njit(fastmath=FASTMATH, **INNER)
def sweep(lane, stages, rates, stiffness):
    """Improve state and slip at the stages; return the square of the largest change.

    The change is that of velocities and slopes; it is infinite where a speed or a
    mobility is not positive or a number not finite.
    """
    y = lane.y
    slip = lane.slip
    h = lane.h
    n = len(y)
    for i in range(STAGES):
        if not stages[i, n + SLIP_SPEED] > 0.0:
            return np.inf
        state, here = stage_of(lane, stages[i])
        motion = motion_of(lane, state, here)
        # The motion ends before the mobility is zero, so beyond there is no solution.
        if not motion.mobility > 0.0:
            return np.inf
        for c in range(n):
            rates[i, c] = motion.f[c]
        rates[i, n + SLIP_SPEED] = motion.slip.speed
        rates[i, n + SLIP_ANGLE] = motion.slip.angle
        rates[i, n + SLIP_WORK] = motion.slip.work
        stiffness[i] = motion.stiffness
    matrix = np.empty((STAGES, STAGES))
    turns = np.empty(STAGES)
    for i in range(STAGES):
        turns[i] = slip.angle - stages[i, n + SLIP_ANGLE]
        for j in range(STAGES):
            share = h * INTEGRALS[i, j]
            turns[i] += share * rates[j, n + SLIP_ANGLE]
            matrix[i, j] = (1.0 if i == j else 0.0) - share * stiffness[j]
    solve_angles(matrix, turns)
    largest = 0.0
    for i in range(STAGES):
        change = 0.0
        for c in range(n + N_SLIP):
            if c == n + SLIP_ANGLE:
                turn = min(LARGEST_TURN, max(-LARGEST_TURN, turns[i]))
                stages[i, c] += turn
                difference = turn * stages[i, n + SLIP_SPEED]
            else:
                value = slip[c - n] if c >= n else y[c]
                for j in range(STAGES):
                    value += h * INTEGRALS[i, j] * rates[j, c]
                difference = value - stages[i, c]
                stages[i, c] = value
            change += difference * difference
        if not isfinite(change):
            return np.inf
        largest = max(largest, change)
    return largest


@njit(**INNER)
def squared_slip(error, speed):
    """Return the square of the error of the velocity in the plane."""
    across = speed * error.angle
    return error.speed * error.speed + across * across


@njit(**INNER)
def squared_rounding(lane):
    """Return the square of the rounding errors of a lane's state."""
    speed = lane.slip.speed
    size = 1.0 + speed * speed
    for component in lane.y:
        size += component * component
    return ROUNDING * ROUNDING * size


@njit(fastmath=FASTMATH, **INNER)
def squared_error(lane, rates, scale):
    """Return the squared error of the step just tried, in units of the tolerance.

    The tolerance is not smaller than rounding errors.  If the coefficients of the
    derivative fall by ``rho`` from one degree to the next, the error at the end of a
    step falls as ``rho^9``; this returns ``rho^8``.
    """
    n = len(lane.y)
    fifth = np.zeros(n + N_SLIP)
    third = np.zeros(n + N_SLIP)
    for i in range(STAGES):
        for c in range(n + N_SLIP):
            fifth[c] += lane.h * FIFTH[i] * rates[i, c]
            third[c] += lane.h * THIRD[i] * rates[i, c]
    error = lane.problem.model.error
    state_error, slip_error = stage_of(lane, fifth)
    high, size = error(state_error, lane.y1, lane.constants)
    high += squared_slip(slip_error, lane.slip1.speed)
    state_error, slip_error = stage_of(lane, third)
    low, _ = error(state_error, lane.y1, lane.constants)
    low += squared_slip(slip_error, lane.slip1.speed)
    fall = high / (low + TINY)
    return high * fall * fall / max(size / scale, squared_rounding(lane))


@njit(fastmath=FASTMATH, **INNER)
def observe(lane, contact_recorded):
    """Compute spin, amplitude, force and limit at the end of the step just tried."""
    model = lane.problem.model
    y = lane.y1
    f = lane.f1
    slip = lane.slip1
    lane.n1 = model.spin(y)
    lane.rate1 = model.spin_rate(y, f)
    lane.amplitude = model.amplitude(y, lane.probe)
    set_limit(lane)
    limit = lane.limit1
    dips = may_dip(lane.limit0, limit)
    lane.leaves = 1.0 if dips or not limit.value > 0.0 else 0.0
    lane.watched = lane.leaves
    if contact_recorded and may_peak(lane.lift0, lane.lift1, -lane.normal_min):
        lane.watched += 1.0
    if slip.speed == 0.0:
        lane.watched += 1.0


@njit(fastmath=FASTMATH, **INNER)
def set_limit(lane):
    """Set the limit and the forces of a lane that slides at the end of the step."""
    ahead = runs.DIFFERENCE / lane.swing
    slip = lane.slip1
    now = motion_of(lane, lane.y1, slip)
    state = moved(lane.y1, now.f, ahead)
    speed = max(BEGINNING, slip.speed + ahead * now.slip.speed)
    later = motion_of(lane, state, Slip(speed, slip.angle, slip.work))
    # Where the angle is stiff, it follows the force at once, as in an implicit step.
    turn = ahead * later.slip.angle / (1.0 + ahead * abs(later.stiffness))
    later = motion_of(lane, state, Slip(speed, slip.angle + turn, slip.work))
    left = lane.problem.modes.left
    limit = now.margin * left(lane, lane.y1)
    later_limit = later.margin * left(lane, state)
    lane.limit1 = Point(lane.h, limit, (later_limit - limit) / ahead)
    lane.lift1 = Point(lane.h, -now.normal, (now.normal - later.normal) / ahead)
    lane.ratio1 = Point(lane.h, lane.mu, 0.0)


@njit(fastmath=FASTMATH, **INNER)
def step_to_rest(lane, now, rest):
    """Step along the derivative, to rest if the step is as long as that takes."""
    h = lane.h
    slip = lane.slip
    lane.slip1 = Slip(
        slip.speed * (1.0 - h / rest) if h < rest else 0.0,
        slip.angle + h * now.slip.angle,
        slip.work + h * now.slip.work,
    )
    lane.y1 = moved(lane.y, now.f, h)
    lane.f1 = now.f
    lane.error = 0.0


@njit(fastmath=FASTMATH, **INNER)
def is_steady(lane, now, rest):
    """Return whether the deceleration stays the same until rest."""
    slip = lane.slip
    state = moved(lane.y, now.f, rest)
    contact, _, _ = contact_at_slip(lane, state, slip)
    _, mobility, along, _, _ = push(
        contact, lane.mu, slip.angle + rest * now.slip.angle
    )
    change = abs(along - now.slip.speed)
    return mobility > 0.0 and change <= STEADY * abs(now.slip.speed)


@njit(**INNER)
def hold_back(lane):
    """Copy the start of a step that is not taken to its end, with its forces."""
    runs.hold_back(lane)
    lane.limit1 = lane.limit0
    lane.ratio1 = lane.ratio0
    lane.lift1 = lane.lift0


@njit(**INNER)
def stay(lane):
    """Take a step of size zero, so that the run ends where it is."""
    hold_back(lane)
    lane.h = 0.0
    lane.error = 0.0
    lane.last = 0.0
    lane.leaves = 0.0
    lane.watched = 1.0


@njit(fastmath=FASTMATH, **INNER)
def try_slide(lane, scale, contact_recorded):
    """Try a step of a lane that slides."""
    model = lane.problem.model
    n = model.n_state
    now = motion_of(lane, lane.y, lane.slip)
    rest = time_to_rest(lane, now)
    angle = rest * lane.swing
    ends = angle < LAST_ANGLE
    if lane.search == STEP:
        # The cubic term of the speed may bring the rest nearer.
        left = 0.0 if ends else min(MOST_LEFT, max(LEAST_LEFT, angle * angle))
        if rest * (1.0 - left) < lane.h:
            lane.h = rest * (1.0 - left)
            lane.last = 0.0
    if ends and lane.search == STEP and not is_steady(lane, now, rest):
        contact, _, _ = contact_at_slip(lane, lane.y, lane.slip)
        if meets_singularity(contact, lane.mu, lane.slip.angle):
            lane.refused = JAMMED
            stay(lane)
            return
    if ends:
        step_to_rest(lane, now, rest)
        observe(lane, contact_recorded)
        return
    stages = np.empty((STAGES, n + N_SLIP))
    rates = np.empty((STAGES, n + N_SLIP))
    stiffness = np.empty(STAGES)
    solved = False
    predict(lane, now, stages)
    _, size = model.error(lane.y, lane.y, lane.constants)
    enough = max(SOLVED * SOLVED * size / scale, squared_rounding(lane))
    for _ in range(MAX_SWEEPS):
        change = sweep(lane, stages, rates, stiffness)
        solved = change <= enough
        if solved or change == np.inf:
            break
    lane.y1, lane.slip1 = stage_of(lane, stages[STAGES - 1])
    lane.f1, _ = stage_of(lane, rates[STAGES - 1])
    if not (solved and lane.slip1.speed > 0.0):
        # Nothing is observed at the end of a step that is not taken.
        hold_back(lane)
        lane.leaves = lane.watched = 0.0
        lane.error = FAILED
        return
    lane.error = squared_error(lane, rates, scale)
    observe(lane, contact_recorded)


def slide_lanes(problem, w, scale, contact_recorded):
    """Try a step on every lane that slides."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        if lane.refused > 0.0:
            stay(lane)
        elif lane.slip.speed > 0.0:
            try_slide(lane, scale, contact_recorded)


# From rolling to sliding and back.


@scalar
def hold_point(lane, h, y, f):
    """Return the friction that is left: positive while the plane holds the body.

    Of a body with a rim it is multiplied by the height that is left below the rim, so
    that one search finds the first zero of both.
    """
    ahead = runs.DIFFERENCE / lane.swing
    contact = lane.problem.model.contact
    left = lane.problem.modes.left
    normal, tangential = contact(y, lane.constants)
    now = (lane.mu * normal - tangential) * left(lane, y)
    y_later = moved(y, f, ahead)
    normal, tangential = contact(y_later, lane.constants)
    later = (lane.mu * normal - tangential) * left(lane, y_later)
    return Point(h, now, (later - now) / ahead)


@njit(fastmath=FASTMATH, **INNER)
def jams(lane):
    """Return whether the mobility is about to vanish at the start of the step.

    It falls with the angle, whose rate has no bound.
    """
    slip = lane.slip
    contact, _, _ = contact_at_slip(lane, lane.y, slip)
    _, mobility, _, across, _ = push(contact, lane.mu, slip.angle)
    turning = across / slip.speed - contact.turn
    ahead = TURN_AHEAD if turning > 0.0 else -TURN_AHEAD
    _, later, _, _, _ = push(contact, lane.mu, slip.angle + ahead)
    fall = (mobility - later) / ahead * turning
    soon = JAMMING_ANGLE / lane.swing
    if mobility > max(LEAST_MOBILITY, 2.0 * soon * fall):
        return False
    return meets_singularity(contact, lane.mu, slip.angle)


@njit(**INNER)
def why_not(contact):
    """Return the status of a body that can neither roll nor slide."""
    return LIFTS_OFF if contact.need < LEAST_MOBILITY else JAMMED


@njit(fastmath=FASTMATH, **INNER)
def slide_from_rest(lane):
    """Let a lane slide from rest at the end of the step; return a status."""
    rest = Slip(0.0, 0.0, 0.0)
    contact, _, _ = contact_at_slip(lane, lane.y1, rest)
    angle, found = outgoing(contact, lane.mu)
    slip = Slip(BEGINNING, angle, lane.slip.work)
    motion = motion_of(lane, lane.y1, slip)
    # Without a margin the plane would have to pull, in any direction of sliding.
    if not (found and motion.margin > 0.0):
        return why_not(contact)
    lane.slip1 = slip
    lane.f1 = motion.f
    lane.rate1 = lane.problem.model.spin_rate(lane.y1, motion.f)
    set_limit(lane)
    lane.h_next = FIRST_ANGLE / lane.swing
    lane.root = 1.0
    lane.last = 0.0
    return OK


@njit(fastmath=FASTMATH, **INNER)
def begin(lane, t):
    """Begin a slide at the end of the step, at time ``t``; return a status."""
    p = lane.y1[0]
    q = lane.y1[1]
    steepest = lane.problem.model.slide.steepest
    if p * p + q * q > steepest * steepest:
        return STEP_TOO_SMALL
    longest = max(lane.h, lane.h_next)
    status = slide_from_rest(lane)
    if status == OK:
        lane.mode = SLIDING
        lane.h_rolling = longest
        lane.t_begin = t
        if lane.slides == 0.0:
            lane.t_slide = t
        lane.slides += 1.0
    return status


@njit(fastmath=FASTMATH, **INNER)
def end(lane, t):
    """End a slide at the end of the step, at time ``t``, or let it go on."""
    y = lane.y1
    lane.problem.modes.settle(lane, y, t)
    f = lane.problem.model.rhs(y, lane.constants)
    if hold_point(lane, lane.h, y, f).value <= 0.0:
        # It slides on in another direction, in which the force is another, too.
        lane.mode = SLIDING
        runs.note_contact(lane)
        return slide_from_rest(lane)
    runs.jump(lane)
    lane.h_next = lane.h_rolling
    lane.slide_time += t - lane.t_begin
    return OK


@njit(**INNER)
def change_rolling(lane, status, move, recording):
    """Begin a slide after a step that ends at the limit of friction."""
    if lane.refused > 0.0:
        return int(lane.refused), move
    if status == AT_LIMIT and lane.problem.modes.left(lane, lane.y1) < AT_RIM:
        return RIM, move
    if status == AT_LIMIT:
        status = begin(lane, lane.t + (lane.h - lane.t_low))
    return status, move


@njit(**INNER)
def change_sliding(lane, status, move, recording):
    """End a slide after a step that ends at rest, or say why it cannot go on."""
    if lane.refused > 0.0:
        return int(lane.refused), move
    if status == AT_LIMIT and lane.problem.modes.left(lane, lane.y1) < AT_RIM:
        return RIM, move
    if status == AT_LIMIT:
        contact, _, _ = contact_at_slip(lane, lane.y1, lane.slip1)
        status = why_not(contact)
    elif status == STEP_TOO_SMALL and jams(lane):
        status = JAMMED
    elif status == OK and lane.slip1.speed == 0.0:
        status = end(lane, lane.t + (lane.h - lane.t_low))
    return status, move


@scalar
def slide_point(lane, h, y, f):
    """Return the limit of a slide, which its steps compute with the forces."""
    return lane.limit1


# What differs from bodies that always roll: see `lane.Modes`.


@njit(**INNER)
def prepare(lane, constants, rate):
    """Set what the equations need: the coefficient of friction."""
    lane.t_slide = -1.0
    lane.mu = constants[lane.problem.model.n_constants]


@njit(**INNER)
def launch(lane):
    """Slide from the launch on where the plane cannot hold the body."""
    if lane.limit0.value >= 0.0:
        return
    lane.y1 = lane.y
    lane.f1 = lane.f
    lane.refused = begin(lane, 0.0)
    lane.slip = lane.slip1
    lane.f = lane.f1
    lane.rate0 = lane.rate1
    lane.h = min(lane.h, lane.h_next)
    runs.start_points(lane)
    # The force that would hold the body never acts.
    lane.ratio_max = 0.0
    lane.normal_min = NEVER
    runs.note_contact(lane)


@njit(**INNER)
def advance(problem, w):
    """Move the slip of all lanes to the end of their step."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        slip = lane.slip1
        # Rounding errors of a direction that turns on and on would grow.
        turns = floor(slip.angle / TWO_PI + 0.5)
        lane.slip = Slip(slip.speed, slip.angle - turns * TWO_PI, slip.work)


@njit(fastmath=FASTMATH, **INNER)
def energy_of(model, y, slip, constants):
    """Return the energy minus the work of friction of a body that may slide."""
    _, u, omega, r, _, _, _, _ = model.slide.place(y, 0.0, constants)
    moving = slip_energy(u, omega, r, slip.speed, slip.angle)
    return model.energy(y, constants) + moving - slip.work


@njit(fastmath=FASTMATH, **INNER)
def force_of(model, y, slip, constants, mu):
    """Return the forces on a body that slides, and the torque along the vertical.

    The forces are the normal and the tangential one.
    """
    contact, _, placed = contact_of(model, y, slip, mu, constants)
    _, u, _, _, _, _, _, drag = placed
    normal, _, _, _, _ = push(contact, mu, slip.angle)
    return normal, mu * normal, normal * dot(drag, u)


@njit(**INNER)
def energy(lane):
    """Return the energy minus the work of friction at the end of the step."""
    return energy_of(lane.problem.model, lane.y1, lane.slip1, lane.constants)


@njit(**INNER)
def work(lane):
    """Return the work of friction until the end of the step, which is negative."""
    return lane.problem.model.work(lane.y1) + lane.slip1.work


@njit(**INNER)
def store(lane, t, result):
    """Store the results of slides."""
    if lane.slip1.speed > 0.0:
        lane.slide_time += t - lane.t_begin
    result["t_slide"] = lane.t_slide if lane.t_slide >= 0.0 else np.nan
    result["n_slides"] = int(lane.slides)
    result["slide_time"] = lane.slide_time
    # Zero and not -0 for a run that never slides.
    result["slide_work"] = 0.0 - lane.slip1.work / lane.energy0


@njit(fastmath=FASTMATH, **INNER)
def observe_body(model, y, slip, constants, mu):
    """Return what `Modes.observe` does."""
    torque = 0.0
    if slip.speed > 0.0:
        normal, tangential, torque = force_of(model, y, slip, constants, mu)
    else:
        normal, tangential = model.contact(y, constants)
    return energy_of(model, y, slip, constants), normal, tangential, torque


ROLLING_MODE = Mode(ROLLING, hold_point, change_rolling)
SLIDING_MODE = Mode(SLIDING, slide_point, change_sliding, results=RESULTS, store=store)
