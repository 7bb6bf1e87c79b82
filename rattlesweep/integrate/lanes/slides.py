"""Slides of a run in a lane: their steps, their begin and their end.

A body rolls until the force that keeps its contact point at rest exceeds ``mu`` times
the normal force; this is the limit of the model, whose zero the lanes find as they find
others (`lanes.events`).  From there the lane slides: its steps are those of
:func:`slide_lanes` and not of ``attempt``, in the same turns as those of the other
lanes, and everything that is observed at steps is observed as before.  It rolls again
once the speed is zero and friction can hold the contact point, and otherwise slides on.

The angle of sliding is stiff near the begin and the end of a slide (`physics.sliding`),
and nothing else is.  So a step of a Radau IIA method solves its equations for the
angle by Newton's method, which needs one derivative a stage, and for the rest by
iteration, on several lanes at once (`lanes.block`).  Near the end of a slide steps
become shorter with the speed, since the equations have no sense beyond its zero.  The
last one is of second order, in which the speed falls to zero.
"""

# mypy: ignore-errors
from math import exp, floor, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.polynomial import legendre

from rattlesweep.integrate.collocation import STAGES
from rattlesweep.integrate.lanes import runs
from rattlesweep.integrate.lanes.block import METHOD
from rattlesweep.integrate.lanes.events import STEP
from rattlesweep.integrate.lanes.inside import (
    both,
    both_of,
    glance,
    halfway,
    least_above,
    middle,
    peak_if,
    turned_over,
)
from rattlesweep.integrate.lanes.lane import (
    DIFFERENCE,
    INNER,
    NEVER,
    ROLLING,
    SLIDING,
    SLIP_ANGLE,
    SLIP_SPEED,
    Mode,
    Peak,
    Point,
    Slip,
    lane_of,
    lowest_bit,
    moved,
    rough_root,
    widest_vectors,
)
from rattlesweep.integrate.lanes.motion import (
    LEAST_MOBILITY,
    Motion,
    contact_of,
    motion_at,
)
from rattlesweep.integrate.lanes.statuses import (
    AT_LIMIT,
    JAMMED,
    LIFTS_OFF,
    OK,
    RIM,
    STEP_TOO_SMALL,
)
from rattlesweep.physics.full import FASTMATH, TINY, scalar
from rattlesweep.physics.pivoting import slip_of_patch
from rattlesweep.physics.sliding import (
    TWO_PI,
    meets_singularity,
    outgoing,
    push,
    settled_direction,
    slip_energy,
)
from rattlesweep.physics.stone import dot

POINTS = METHOD.points
INTEGRALS = METHOD.integrals
DEGREES = np.arange(STAGES)
# From values at the stages to the derivative at the end of a step of size 1.
END_RATES = (DEGREES * (DEGREES + 1)) @ METHOD.spectrum
# The same to the value in the middle.
(MIDDLE,) = legendre.legvander(0.0, STAGES - 1) @ METHOD.spectrum
SOLVED = 1e-2  # share of the tolerance to which the equations are solved
# Rounding errors of a state over its size: no step is more exact.
ROUNDING = 1e-15
# A fresh column: equations that are to be solved, no change and no iteration yet.
NEW = (1.0,) * (1 + STAGES) + (0.0, 0.0)
FAILED = 1e30  # squared error of a step whose equations were not solved
# The ratio of two steps: a share of what would meet the tolerance, and bounds.
SAFE_SHARE = 0.75
LEAST_STRETCH = 0.2
MOST_STRETCH = 3.0
LEAST_SLIDING_ERROR = 1e-16  # squared, of steps that may grow as much as they can

# Columns of a block in which a turn goes on, if lanes that roll step in the same turn.
FEWEST_SLIDING = 4
# Columns that are left for the next turn otherwise.
FEWEST_BUSY = 6
# Columns that become free before others take their places.
FEWEST_FREE = 3

BEGINNING = 1e-290  # speed at the begin of a slide
# A slide ends with a step of second order if its rest is as short as this, in radians
# of the fastest swing, and the rates hardly change.
LAST_ANGLE = 1e-4
# Squared error, in units of the tolerance, of a step of first order at that place.
LAST_ERROR = 1e-3
# If the deceleration changes by more than this share until then, the direction turns.
STEADY = 0.1
# A slide that comes to rest within this angle ends with one step in any case, in which
# only the direction changes.
SHORTEST_ANGLE = 1e-8
# Where the direction turns, that step is cut into pieces, in which the speed falls by
# this factor's exponential: it changes by what is left after all of them, 2e-4.
FALL = 0.1
FALLS = 85
# A turn in an e-fold of the speed, times the angle until rest, that does not count.
SETTLED = 1e-15
# Fraction of the time to rest that a step leaves: at least, and at most.
LEAST_LEFT = 0.01
MOST_LEFT = 0.3
FIRST_ANGLE = 0.2  # first step of a slide, in radians of the fastest swing
# Error of a step across the kink of the patch's torque, over this torque and the 2.5th
# power of the step's width, as found for all places of the kink in a step.
KINK = 1e-3
MOST_WIDTH = 6.0
# Errors of other steps are mostly far below the tolerance; so much smaller must be that
# of the spin, for errors to be proportional to the tolerance.
SPIN_WEIGHT = 300.0
# From the start of the last step, in its size: how far its rates say what follows.
MOST_AHEAD = 2.5
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
def contact_at_slip(lane, y, slip):
    """Return what :func:`contact_of` does for a lane's body."""
    return contact_of(lane.problem.model, y, slip, lane.mu, lane.constants)


@njit(fastmath=FASTMATH, **INNER)
def motion_of(lane, y, slip):
    """Return the motion of a lane's body in a state."""
    return motion_at(lane.problem.model, y, slip, lane.mu, lane.constants)


# A step, in the column of a lane in a block.


@njit(**INNER)
def load_column(lane, z, column, scale):
    """Copy the start of a step to a column, and what the last step tells."""
    slip = lane.slip
    _, size = lane.problem.model.error(lane.y, lane.y, lane.constants)
    begins = slip.speed <= BEGINNING
    # Near rest the direction follows from a speed that may be below the tolerance.
    most = size / scale
    if not begins:
        most = min(most, slip.speed * slip.speed)
    enough = max(SOLVED * SOLVED * most, squared_rounding(lane))
    # All tries from one start are guessed alike, so that a repeated one has its bits.
    if lane.held == 0.0 and lane.search == STEP:
        lane.past = lane.tried
        lane.past_h = lane.tried_h
        lane.past_rise = lane.rise
    numbers = (slip.speed, slip.angle, slip.work)
    settings = (lane.mu, lane.h, enough, lane.past_h, 1.0)
    whole = lane.y + numbers + lane.constants + settings + lane.past + NEW
    lane.problem.block.load(z, column, whole)
    if begins or lane.past_h == 0.0:
        now = motion_of(lane, lane.y, slip)
        # Where the angle is stiff, its rate at the start says nothing about the step.
        stiff = begins or abs(lane.h * now.stiffness) >= 1.0
        turning = 0.0 if stiff else now.slip.angle
        rates = now.f + (now.slip.speed, turning, 0.0)  # noqa: RUF005
        for c in range(lane.problem.block.count):
            keep_rate(lane, z, column, c, rates[c])
        go_straight(lane, z, column)


@njit(**INNER)
def keep_rate(lane, z, column, c, rate):
    """Let a number be guessed from its rate at the start of the step alone."""
    block = lane.problem.block
    for k in range(STAGES):
        place = (block.past + k * block.count + c) * block.width + column
        z[place] = rate if k == 0 else 0.0


@njit(**INNER)
def go_straight(lane, z, column):
    """Let a step be guessed from its own start, and not from the last step's."""
    block = lane.problem.block
    z[block.past_h * block.width + column] = lane.h
    z[block.offset * block.width + column] = 0.0


@njit(**INNER)
def rates_at_start(problem, z, column, c):
    """Return the rate of a number at the start of a step, and the rate of this rate."""
    block = problem.block
    past_h = z[block.past_h * block.width + column]
    side = 2.0 * z[block.offset * block.width + column] - 1.0
    rate = 0.0
    bend = 0.0
    # Values and derivatives of Legendre's polynomials at 1 or -1.
    sign = 1.0
    for k in range(STAGES):
        coefficient = z[(block.past + k * block.count + c) * block.width + column]
        rate += sign * coefficient
        bend += sign * side * k * (k + 1) * coefficient
        sign *= side
    return rate, bend / past_h


@njit(**INNER)
def look_ahead(lane, z, column):
    """Do not follow the rates of the last step further than they tell."""
    block = lane.problem.block
    z[block.h * block.width + column] = lane.h
    past_h = z[block.past_h * block.width + column]
    offset = z[block.offset * block.width + column]
    if offset + lane.h / past_h > MOST_AHEAD:
        for c in range(block.count):
            rate, _ = rates_at_start(lane.problem, z, column, c)
            keep_rate(lane, z, column, c, rate)
        go_straight(lane, z, column)


@njit(fastmath=FASTMATH, **INNER)
def time_to_rest(lane, z, column):
    """Return the time in which the speed falls to zero, or infinity.

    The speed is taken as a parabola in time.
    """
    speed = lane.slip.speed
    rate, bend = rates_at_start(lane.problem, z, column, len(lane.y) + SLIP_SPEED)
    if speed <= BEGINNING or rate >= 0.0:
        return np.inf
    square = rate * rate - 2.0 * speed * bend
    if square <= 0.0:
        return np.inf
    return 2.0 * speed / (sqrt(square) - rate)


@njit(fastmath=FASTMATH, **INNER)
def guess_beginning(lane, z, column):
    """Guess direction and speed at the stages of the first step of a slide.

    The direction follows the force, and the speed is the integral of its rate.
    """
    block = lane.problem.block
    angle = lane.slip.angle
    n = len(lane.y)
    for i in range(STAGES):
        state = moved(lane.y, lane.f, lane.h * POINTS[i])
        contact, _, _ = contact_at_slip(lane, state, lane.slip)
        angle, _ = settled_direction(contact, lane.mu, angle)
        _, _, along, _, _ = push(contact, lane.mu, angle)
        row = block.values + (n + SLIP_ANGLE) * STAGES + i
        z[row * block.width + column] = angle
        z[(block.growths + i) * block.width + column] = along
    for i in range(STAGES):
        speed = 0.0
        for j in range(STAGES):
            growth = z[(block.growths + j) * block.width + column]
            speed += lane.h * INTEGRALS[i, j] * growth
        row = block.values + (n + SLIP_SPEED) * STAGES + i
        z[row * block.width + column] = speed


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
def squared_error(lane, z, column, rates, scale):
    """Return the squared error of the step just tried, in units of the tolerance.

    The tolerance is not smaller than rounding errors.  If the coefficients of the
    derivative fall by ``rho`` from one degree to the next, the error at the end of a
    step falls as ``rho^9``; this returns ``rho^8``.
    """
    block = lane.problem.block
    model = lane.problem.model
    speed = lane.slip1.speed
    high, size = model.error(block.fifth(rates), lane.y1, lane.constants)
    high += squared_slip(Slip(*block.fifth_slip(rates)), speed)
    low, _ = model.error(block.third(rates), lane.y1, lane.constants)
    low += squared_slip(Slip(*block.third_slip(rates)), speed)
    fall = high / (low + TINY)
    error = high * fall * fall
    if model.pivot is not None:
        error += squared_error_of_spin(lane, z, column, rates)
    return error * lane.h * lane.h / max(size / scale, squared_rounding(lane))


@njit(**INNER)
def stretch(lane):
    """Return the ratio of the next step to the step just tried.

    If errors rose with respect to the last step, they are expected to go on rising
    (Gustafsson).
    """
    root = rough_root(lane.error + LEAST_SLIDING_ERROR)
    # Squared errors rise as h^18, of which this is about the root.
    rise = root * root * root * sqrt(root)
    lane.rise = rise
    ratio = SAFE_SHARE / rise
    if lane.past_h > 0.0:
        trend = lane.h / lane.past_h * lane.past_rise / rise
        ratio = ratio * trend if trend < 1.0 else ratio
    return min(MOST_STRETCH, max(LEAST_STRETCH, ratio))


@njit(fastmath=FASTMATH, **INNER)
def squared_error_of_spin(lane, z, column, rates):
    """Return the square of the error of the spin in a step of size 1.

    The torque of the patch falls fast as the slide begins, and its coefficients may be
    small by chance.  Where the sliding is as fast as the patch turns at its rim, the
    torque has only two derivatives, so the error is of the order 2.5 there.
    """
    block = lane.problem.block
    model = lane.problem.model
    third = model.spin_rate(lane.y1, block.third(rates)) ** 2
    fourth = model.spin_rate(lane.y1, block.fourth(rates)) ** 2
    fifth = model.spin_rate(lane.y1, block.fifth(rates)) ** 2
    fall = fifth / (fourth + TINY)
    fall = min(1.0, max(fifth / (third + TINY), fall * fall))
    error = fifth * fall * fall
    lever = lane.constants[-2]
    before = slip_of_patch(model.spin(lane.y), lever, lane.mu * lane.slip.speed)
    after = slip_of_patch(model.spin(lane.y1), lever, lane.mu * lane.slip1.speed)
    if (before < 1.0) != (after < 1.0):
        width = min(MOST_WIDTH, abs(after - before))
        normal = block.forces(z, column)[STAGES - 1]
        torque = KINK * width * width * sqrt(width) * lever * normal
        error += (torque / lane.constants[2]) ** 2
    return SPIN_WEIGHT * SPIN_WEIGHT * error


@njit(fastmath=FASTMATH, **INNER)
def observe(lane, contact_recorded, limit_half, lift_half):
    """Compute spin and amplitude at the end of the step just tried, and what is due.

    The limit and the negative normal force in the middle of the step are given.
    """
    model = lane.problem.model
    lane.n1 = model.spin(lane.y1)
    lane.rate1 = model.spin_rate(lane.y1, lane.f1)
    lane.amplitude = model.amplitude(lane.y1, lane.probe)
    angle = lane.h * lane.swing
    start = turned_over(lane.limit0)
    end = turned_over(lane.limit1)
    dips = glance(start, -limit_half, end, angle).value > 0.0
    lane.leaves = 1.0 if dips or not lane.limit1.value > 0.0 else 0.0
    lane.watched = lane.leaves
    seen = glance(lane.lift0, lift_half, lane.lift1, angle)
    most = -lane.normal_min
    lifts = contact_recorded and seen.value > most + least_above(most)
    lane.lift_peak = peak_if(lifts, seen)
    # The ratio is that of friction.
    lane.ratio_peak = Peak(0.0, 0.0, 0.0)
    lane.watched += 1.0 if lifts else 0.0
    if lane.slip1.speed == 0.0:
        lane.watched += 1.0


@njit(fastmath=FASTMATH, **INNER)
def note_forces(lane, z, column):
    """Set the limit and the forces at the end of a step from those at its stages.

    Return the limit and the negative normal force in the middle.
    """
    forces = lane.problem.block.forces(z, column)
    normal = forces[STAGES - 1]
    margin = forces[2 * STAGES - 1]
    normal_rate = 0.0
    margin_rate = 0.0
    normal_half = 0.0
    margin_half = 0.0
    for i in range(STAGES):
        normal_half += MIDDLE[i] * forces[i]
        margin_half += MIDDLE[i] * forces[STAGES + i]
        normal_rate += END_RATES[i] * forces[i]
        margin_rate += END_RATES[i] * forces[STAGES + i]
    normal_rate /= lane.h
    margin_rate /= lane.h
    left = lane.problem.modes.left
    ahead = DIFFERENCE / lane.swing
    height = left(lane, lane.y1)
    later = left(lane, moved(lane.y1, lane.f1, ahead))
    below = Point(lane.h, height, (later - height) / ahead)
    lane.limit1 = both_of(Point(lane.h, margin, margin_rate), below)
    lane.lift1 = Point(lane.h, -normal, -normal_rate)
    lane.ratio1 = Point(lane.h, lane.mu, 0.0)
    return both(margin_half, left(lane, middle(lane))), -normal_half


@njit(fastmath=FASTMATH, **INNER)
def set_limit(lane):
    """Set the limit and the forces where a slide begins or its speed is zero."""
    ahead = DIFFERENCE / lane.swing
    slip = lane.slip1
    now = motion_of(lane, lane.y1, slip)
    state = moved(lane.y1, now.f, ahead)
    speed = max(BEGINNING, slip.speed + ahead * now.slip.speed)
    later = motion_of(lane, state, Slip(speed, slip.angle, slip.work))
    # Where the angle is stiff, it follows the force at once, as in an implicit step.
    turn = ahead * later.slip.angle / (1.0 + ahead * abs(later.stiffness))
    later = motion_of(lane, state, Slip(speed, slip.angle + turn, slip.work))
    left = lane.problem.modes.left
    limit = both(now.margin, left(lane, lane.y1))
    later_limit = both(later.margin, left(lane, state))
    lane.limit1 = Point(lane.h, limit, (later_limit - limit) / ahead)
    lane.lift1 = Point(lane.h, -now.normal, (now.normal - later.normal) / ahead)
    lane.ratio1 = Point(lane.h, lane.mu, 0.0)


class Rest(NamedTuple):
    """The end of a slide whose rates hardly change until it."""

    now: Motion  # at the start of the step
    then: Motion  # at rest
    time: float  # until rest
    steady: bool  # whether the rates hardly change


@njit(fastmath=FASTMATH, **INNER)
def rest_after(lane, time, scale):
    """Return the :class:`Rest` that a slide reaches after about some time."""
    slip = lane.slip
    now = motion_of(lane, lane.y, slip)
    # Where the angle is stiff, it follows the force at once, as in an implicit step.
    turn = time * now.slip.angle / (1.0 + time * abs(now.stiffness))
    state = moved(lane.y, now.f, time)
    then = motion_of(lane, state, Slip(BEGINNING, slip.angle + turn, slip.work))
    bend = then.slip.speed - now.slip.speed
    # A step along the derivative at the start would have this error.
    lacking = moved(then.f, now.f, -1.0)
    error, size = lane.problem.model.error(lacking, state, lane.constants)
    error = 0.25 * time * time * (error + bend * bend)
    # The last step may tell of a fall where the speed rises by now.
    steady = (
        (abs(bend) <= -STEADY * now.slip.speed)
        & (error <= max(LAST_ERROR * size / scale, squared_rounding(lane)))
        & (then.mobility > LEAST_MOBILITY)
    )
    mean = now.slip.speed + 0.5 * bend
    return Rest(now, then, -slip.speed / mean if steady else time, steady)


@njit(fastmath=FASTMATH, **INNER)
def step_to_rest(lane, rest):
    """Step to rest, or towards it if the step is shorter, with the forces there."""
    h = lane.h
    slip = lane.slip
    now = rest.now
    then = rest.then
    share = h / rest.time
    change = moved(then.f, now.f, -1.0)
    bend = then.slip.speed - now.slip.speed
    speed = slip.speed + h * (now.slip.speed + 0.5 * share * bend)
    lane.slip1 = Slip(
        max(speed, BEGINNING) if share < 1.0 else 0.0,
        slip.angle,
        slip.work + h * now.slip.work * (1.0 - 0.5 * share),
    )
    lane.y1 = moved(moved(lane.y, now.f, h), change, 0.5 * h * share)
    lane.f1 = moved(now.f, change, share)
    lane.error = 0.0
    left = lane.problem.modes.left
    start = both(now.margin, left(lane, lane.y))
    margin = now.margin + share * (then.margin - now.margin)
    limit = both(margin, left(lane, lane.y1))
    normal = now.normal + share * (then.normal - now.normal)
    lane.limit1 = Point(h, limit, (limit - start) / h)
    lane.lift1 = Point(h, -normal, (now.normal - then.normal) / rest.time)
    lane.ratio1 = Point(h, lane.mu, 0.0)


@njit(fastmath=FASTMATH, **INNER)
def fall_to_rest(lane):
    """Return how a slide comes to rest, soon.

    The results are the mean derivative of the state until rest, the direction there,
    the time until then, and whether the body can come to rest.  The direction turns by
    ``across / along`` in each e-fold of the speed, and may turn until the end.
    """
    slip = lane.slip
    now = motion_of(lane, lane.y, slip)
    rest = -slip.speed / now.slip.speed
    falls = now.slip.speed < 0.0
    if not falls or abs(now.slip.angle * rest * rest * lane.swing) < SETTLED:
        return now.f, slip.angle + rest * now.slip.angle, rest, falls
    nothing = moved(now.f, now.f, -1.0)
    path = nothing
    time = 0.0
    for _ in range(FALLS):
        rest = -slip.speed / now.slip.speed
        # Linearly implicit: a direction to which slides turn fast is stiff.
        stiffness = min(1.0, 0.5 * FALL * rest * now.stiffness)
        turned = FALL * rest * now.slip.angle / max(0.5, 1.0 - stiffness)
        later = Slip(slip.speed * exp(-FALL), slip.angle + turned, slip.work)
        after = motion_of(lane, lane.y, later)
        falls = after.slip.speed < 0.0 and after.mobility > 0.0
        if not falls:
            break
        half = 0.5 * (slip.speed - later.speed)
        path = moved(path, now.f, -half / now.slip.speed)
        path = moved(path, after.f, -half / after.slip.speed)
        time -= half / now.slip.speed + half / after.slip.speed
        slip = later
        now = after
    rest = -slip.speed / now.slip.speed
    path = moved(path, now.f, rest)
    time += rest
    return moved(nothing, path, 1.0 / time), slip.angle, time, falls


@njit(fastmath=FASTMATH, **INNER)
def turn_to_rest(lane, mean, angle, rest):
    """Step along the mean derivative, to rest if the step is as long as that takes."""
    h = lane.h
    slip = lane.slip
    now = motion_of(lane, lane.y, slip)
    lane.slip1 = Slip(
        slip.speed * (1.0 - h / rest) if h < rest else 0.0,
        slip.angle + h / rest * (angle - slip.angle),
        slip.work + h * now.slip.work,
    )
    lane.y1 = moved(lane.y, mean, h)
    lane.f1 = mean
    lane.error = 0.0


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
def observe_ends(lane, contact_recorded):
    """Observe a step of which the limit and the forces are known at its ends alone."""
    limit_half = halfway(lane.limit0, lane.limit1)
    lift_half = halfway(lane.lift0, lane.lift1)
    observe(lane, contact_recorded, limit_half, lift_half)


@njit(fastmath=FASTMATH, **INNER)
def end_or_load(lane, z, column, scale, contact_recorded):
    """Return whether the step is one of a block, and copy it there.

    Otherwise the slide ends with it, or is jammed.
    """
    load_column(lane, z, column, scale)
    time = time_to_rest(lane, z, column)
    angle = time * lane.swing
    searches = lane.search != STEP
    if angle < LAST_ANGLE:
        rest = rest_after(lane, time, scale)
        if rest.steady:
            if rest.time < lane.h and not searches:
                lane.h = rest.time
                lane.last = 0.0
            step_to_rest(lane, rest)
            observe_ends(lane, contact_recorded)
            return False
    if angle < SHORTEST_ANGLE:
        mean, direction, time, falls = fall_to_rest(lane)
        if not falls and not searches:
            contact, _, _ = contact_at_slip(lane, lane.y, lane.slip)
            if meets_singularity(contact, lane.mu, lane.slip.angle):
                lane.refused = JAMMED
                stay(lane)
                return False
        if time > 0.0:
            # After rejected steps the rest may be further away than the next step goes.
            if not searches and (time < lane.h or lane.last == 0.0):
                lane.h = time
                lane.last = 0.0
            turn_to_rest(lane, mean, direction, time)
            set_limit(lane)
            observe_ends(lane, contact_recorded)
            return False
        # The speed rises by now.
        time = np.inf
    if not searches:
        # The cubic term of the speed may bring the rest nearer, and errors matter the
        # less the shorter the rest is.
        left = min(MOST_LEFT, max(LEAST_LEFT, 0.5 * sqrt(angle)))
        if time * (1.0 - left) < lane.h:
            lane.h = time * (1.0 - left)
            lane.last = 0.0
    look_ahead(lane, z, column)
    return True


@njit(fastmath=FASTMATH, **INNER)
def take_from(lane, z, column, scale, contact_recorded):
    """Copy the end of a step from a block, with its error and what is observed."""
    block = lane.problem.block
    lane.y1 = block.state(z, column)
    lane.slip1 = Slip(*block.slip(z, column))
    lane.f1 = block.rate(z, column)
    solved = z[block.busy * block.width + column] == 0.0
    if not (solved and lane.slip1.speed > 0.0):
        # Nothing is observed at the end of a step that is not taken.
        hold_back(lane)
        lane.leaves = lane.watched = 0.0
        lane.error = FAILED
        lane.tried_h = 0.0
        return
    rates = block.rates(z, column)
    lane.error = squared_error(lane, z, column, rates, scale)
    lane.tried = rates
    lane.tried_h = lane.h
    lane.stretch = stretch(lane)
    limit_half, lift_half = note_forces(lane, z, column)
    observe(lane, contact_recorded, limit_half, lift_half)


@njit(**INNER)
def lane_in(problem, w, z, column):
    """Return the lane whose step is in a column."""
    block = problem.block
    return lane_of(problem, w, int(z[block.lane * block.width + column]) - 1)


@njit(**INNER)
def fill_columns(problem, w, z, waiting, free, scale, contact_recorded):
    """Let lanes take free columns; return those that still wait, and free columns."""
    block = problem.block
    before = free
    while waiting != 0 and free != 0:
        l = lowest_bit(waiting)
        waiting &= waiting - 1
        lane = lane_of(problem, w, l)
        column = lowest_bit(free)
        if end_or_load(lane, z, column, scale, contact_recorded):
            free &= free - 1
            z[block.lane * block.width + column] = l + 1.0
    taken = before & ~free
    if taken != 0:
        block.predict(problem, z)
    while taken != 0:
        column = lowest_bit(taken)
        taken &= taken - 1
        lane = lane_in(problem, w, z, column)
        if lane.slip.speed <= BEGINNING:
            guess_beginning(lane, z, column)
    return waiting, free


@njit(**INNER)
def empty(problem, w, z, free, scale, contact_recorded):
    """Take the steps whose equations are solved, or cannot be; return free columns."""
    block = problem.block
    for column in range(block.width):
        if (free >> column) & 1 == 0 and z[block.busy * block.width + column] <= 0.0:
            lane = lane_in(problem, w, z, column)
            take_from(lane, z, column, scale, contact_recorded)
            z[block.lane * block.width + column] = 0.0
            free |= 1 << column
    return free


@njit(**INNER)
def plan_sliding(problem, w):
    """Return what `ModeSet.plan` does: whether lanes roll, and whether some slide."""
    widest_vectors()
    others = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        others += 1 if (lane.refused > 0.0) | (lane.mode == SLIDING) else 0
    if others == 0:
        return True, False
    return plan_turn(problem, w), True


@njit(**INNER)
def plan_turn(problem, w):
    """Return whether the lanes that roll try a step in this turn, or wait.

    Their step takes as long for one of them as for all, so they wait while most lanes
    slide.  This changes nothing of a run.
    """
    rolling = 0
    sliding = 0
    watched = 0.0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        busy = lane.run >= 0.0
        slides = lane.mode == SLIDING
        sliding += 1 if busy & slides else 0
        rolling += 1 if busy & (not slides) else 0
        watched += lane.watched
    rolls = (rolling >= sliding) | (watched > 0.0)
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        waits = (not rolls) & (lane.mode != SLIDING)
        lane.waits = 1.0 if waits else 0.0
    if not rolls:
        for l in range(problem.lanes):
            lane = lane_of(problem, w, l)
            if lane.waits > 0.0:
                hold_back(lane)
    return rolls


@njit(**INNER)
def sliding_lanes(problem, w):
    """Return which lanes slide, as bits."""
    bits = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        lane.stretch = 0.0
        if lane.refused > 0.0:
            lane.waits = 0.0
            stay(lane)
        bits |= (1 if (lane.refused == 0.0) & (lane.mode == SLIDING) else 0) << l
    return bits


@njit(**INNER)
def decide_sliding(problem, w, due):
    """Decide on lanes that slide or wait, after all others; return which are due.

    A slide has its own ratio of two steps.  A lane that waits tries its step again.
    """
    waiting = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        waits = lane.waits > 0.0
        # Lanes that are due are looked at later.
        moves = (lane.mode == SLIDING) & (lane.accept > 0.0) & ((due >> l) & 1 == 0)
        if moves and runs.stalls(lane, True):
            lane.refused = STEP_TOO_SMALL
        if lane.stretch > 0.0:
            ratio = min(lane.stretch, 1.0) if lane.held > 0.0 else lane.stretch
            lane.h_next = min(lane.h * ratio, lane.h_longest)
        if waits:
            lane.h_next = lane.h
            lane.root = lane.root0
            lane.accept = 0.0
            waiting |= 1 << l
    return due & ~waiting


def slide_lanes(problem, w, scale, contact_recorded, fewest):
    """Try a step on lanes that slide.

    Each column of the block takes the next lane once its own step is solved.  If fewer
    columns than ``fewest`` are left, their lanes wait, and go on in the next turn.

    The block is at the end of the workspace.
    """
    block = problem.block
    z = w[w.size - block.rows * block.width :]
    waiting = sliding_lanes(problem, w)
    free = 0
    for column in range(block.width):
        l = int(z[block.lane * block.width + column]) - 1
        if l < 0:
            free |= 1 << column
        else:
            waiting &= ~(1 << l)
    fewest = min(fewest, FEWEST_BUSY)
    some = False
    while True:
        waiting, free = fill_columns(
            problem, w, z, waiting, free, scale, contact_recorded
        )
        busy = block.width - bits_of(free)
        if busy == 0 or (some and waiting == 0 and busy < fewest):
            break
        # Fewer are left in the end, or before others come.
        few = max(0, busy - FEWEST_FREE) if waiting != 0 else max(0, fewest - 1)
        few = min(few, busy - 1)
        while block.iterate(problem, z) > few:
            pass
        free = empty(problem, w, z, free, scale, contact_recorded)
        some = True
    for column in range(block.width):
        if (free >> column) & 1 == 0:
            lane = lane_in(problem, w, z, column)
            hold_back(lane)
            lane.waits = 1.0


@njit(**INNER)
def bits_of(bits):
    """Return the number of bits that are set."""
    count = 0
    while bits != 0:
        bits &= bits - 1
        count += 1
    return count


# From rolling to sliding and back.


@scalar
def hold_point(lane, h, y, f):
    """Return the friction that is left: positive while the plane holds the body.

    Of a body with a rim it is combined with the height that is left below the rim, so
    that one search finds the first zero of both.
    """
    ahead = DIFFERENCE / lane.swing
    contact = lane.problem.model.contact
    left = lane.problem.modes.left
    normal, tangential = contact(y, lane.constants)
    now = both(lane.mu * normal - tangential, left(lane, y))
    y_later = moved(y, f, ahead)
    normal, tangential = contact(y_later, lane.constants)
    later = both(lane.mu * normal - tangential, left(lane, y_later))
    return Point(h, now, (later - now) / ahead)


@scalar
def hold_margin(lane, y, f):
    """Return a smooth function with the sign of :func:`hold_point`.

    It is ``(mu F_n)^2 - F_t^2``, with the sign of ``F_n`` before the first square, and
    the height that is left.  It has no kink where the tangential force ``F_t`` is zero.
    """
    normal, square = lane.problem.model.force(y, f, lane.constants)
    held = lane.mu * normal
    return both(held * abs(held) - square, lane.problem.modes.left(lane, y))


@scalar
def is_calm(lane):
    """Return whether the oscillation is too small for a slide in the step tried.

    Twice its energy is ``S``, so the speed of the centre of mass is at most the root of
    ``S``, and it turns and swings no faster than ``w``, the sum of the spin and half
    the swing, which is at most that of the slope.  So ``F_t^2`` is at most ``w^2 S``,
    and ``F_n`` differs from 1 by a share of it.  Both are counted more than twice, as
    ``S`` is that to second order.
    """
    error = lane.problem.model.error
    _, before = error(lane.y, lane.y, lane.constants)
    _, after = error(lane.y1, lane.y1, lane.constants)
    fastest = 0.5 * lane.swing + abs(lane.n0) + abs(lane.n1)
    most = fastest * fastest * (before + after)
    held = lane.mu * (1.0 - 2.0 * most)
    return (held > 0.0) & (held * held > 2.0 * most)


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
    lane.problem.modes.free(lane)
    contact, _, _ = contact_at_slip(lane, lane.y1, rest)
    angle, found = outgoing(contact, lane.mu)
    slip = Slip(BEGINNING, angle, lane.slip.work)
    motion = motion_of(lane, lane.y1, slip)
    # Without a margin the plane would have to pull, in any direction of sliding.
    if not (found and motion.margin > 0.0):
        return why_not(contact)
    lane.slip1 = slip
    lane.f1 = motion.f
    lane.tried_h = 0.0
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
    if hold_margin(lane, y, f) <= 0.0:
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


# What differs from bodies that always roll: see `lane.ModeSet`.


@njit(**INNER)
def prepare(lane, constants, rate):
    """Set what the equations need: the coefficient of friction."""
    lane.t_slide = -1.0
    lane.mu = constants[lane.problem.model.n_constants]


@njit(**INNER)
def launch(lane):
    """Slide from the launch on where the plane cannot hold the body."""
    if lane.margin0 >= 0.0:
        return
    lane.y1 = lane.y
    lane.f1 = lane.f
    lane.refused = begin(lane, 0.0)
    lane.slip = lane.slip1
    lane.f = lane.f1
    lane.rate0 = lane.rate1
    lane.h = min(lane.h, lane.h_next)
    limit = lane.limit1
    lane.limit0 = Point(0.0, limit.value, limit.rate)
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
    at = model.slide.place(y, slip, 0.0, constants)
    moving = slip_energy(at.u, at.omega, at.r, slip.speed, slip.angle)
    return model.energy(y, constants) + moving - slip.work


@njit(fastmath=FASTMATH, **INNER)
def force_of(model, y, slip, constants, mu):
    """Return the forces on a body that slides, and the torque along the vertical.

    The forces are the normal and the tangential one.
    """
    contact, _, placed = contact_of(model, y, slip, mu, constants)
    normal, _, _, _, _ = push(contact, mu, slip.angle)
    return normal, mu * normal, normal * dot(placed.drag, placed.u)


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
    if lane.mode == SLIDING:
        lane.slide_time += t - lane.t_begin
    result["t_slide"] = lane.t_slide if lane.t_slide >= 0.0 else np.nan
    result["n_slides"] = int(lane.slides)
    result["slide_time"] = lane.slide_time
    # Zero and not -0 for a run that never slides.
    result["slide_work"] = 0.0 - lane.slip1.work / lane.energy0


@njit(fastmath=FASTMATH, **INNER)
def observe_body(model, y, slip, constants, mu):
    """Return what `ModeSet.observe` does."""
    torque = 0.0
    if slip.speed > 0.0:
        normal, tangential, torque = force_of(model, y, slip, constants, mu)
    else:
        normal, tangential = model.contact(y, constants)
    return energy_of(model, y, slip, constants), normal, tangential, torque


ROLLING_MODE = Mode(ROLLING, hold_point, change_rolling, hold_margin, is_calm)
SLIDING_MODE = Mode(SLIDING, slide_point, change_sliding, results=RESULTS, store=store)
