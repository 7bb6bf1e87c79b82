"""A step of a slide in the rack: its start, its error, its limit."""

# mypy: ignore-errors

from math import pi, sqrt

import numpy as np
from numba import njit
from numpy.polynomial import legendre

from rattlesweep.compiling.intrinsics import FUSED, INNER, moved, rough_root
from rattlesweep.kernel import runs
from rattlesweep.kernel.look.inside import (
    both,
    both_of,
    glance,
    least_above,
    middle,
    peak_if,
    turned_over,
)
from rattlesweep.kernel.method.collocation import STAGES
from rattlesweep.kernel.state.fields import (
    DIFFERENCE,
    SLIP_ANGLE,
    SLIP_SPEED,
    STEP,
    Peak,
    Point,
    Slip,
)
from rattlesweep.kernel.step.radau import METHOD
from rattlesweep.kernel.step.sliding_motion import (
    contact_of,
    contact_while_sliding,
    motion_at,
)
from rattlesweep.physics.friction.pivoting import slip_of_patch
from rattlesweep.physics.friction.sliding import (
    push,
    settled_direction,
)
from rattlesweep.physics.full import TINY

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
# A fresh slot: equations that are to be solved, no change and no iteration yet.
NEW = (1.0,) * (1 + STAGES) + (0.0, 0.0)
FAILED = 1e30  # squared error of a step whose equations were not solved
# The ratio of two steps: a share of what would meet the tolerance, and bounds.
SAFE_SHARE = 0.75
LEAST_STRETCH = 0.2
MOST_STRETCH = 3.0
LEAST_SLIDING_ERROR = 1e-16  # squared, of steps that may grow as much as they can

BEGINNING = 1e-290  # speed at the begin of a slide
# Error of a step across the kink of the patch's torque, over this torque and the 2.5th
# power of the step's width, as found for all places of the kink in a step.
KINK = 1e-3
MOST_WIDTH = 6.0
# Least slip of a patch whose spin follows the speed where a slide begins.
LEAST_RATIO = 1e-4
# Errors of other steps are mostly far below the tolerance; so much smaller must be that
# of the spin, for errors to be proportional to the tolerance.
SPIN_WEIGHT = 300.0
SPIN_ROUNDING = 1e-14
# From the start of the last step, in its size: how far its rates say what follows.
MOST_AHEAD = 2.5


@njit(**FUSED)
def contact_at_slip(lane, y, slip):
    """Return what :func:`contact_of` does for a lane's body."""
    return contact_of(lane.problem.model, y, slip, lane.mu, lane.constants)


@njit(**FUSED)
def motion_of(lane, y, slip):
    """Return the motion of a lane's body in a state."""
    return motion_at(lane.problem.model, y, slip, lane.mu, lane.constants)


# A step, in the slot of a lane in a rack.


@njit(**FUSED)
def load_slot(lane, z, slot, scale):
    """Copy the start of a step to a slot, and what the last step tells."""
    slip = lane.slip
    _, size = lane.problem.model.error(lane.y, lane.y, lane.constants)
    begins = slip.speed <= BEGINNING
    # Near rest the direction follows from a speed that may be below the tolerance.
    most = size / scale
    if not begins:
        most = min(most, squared_speed(lane, slip.speed))
    enough = max(SOLVED * SOLVED * most, squared_rounding(lane))
    # All tries from one start are guessed alike, so that a repeated one has its bits.
    if lane.held == 0.0 and lane.search == STEP:
        lane.past = lane.tried
        lane.past_h = lane.tried_h
        lane.past_rise = lane.rise
    numbers = (slip.speed, slip.angle, slip.work)
    settings = (lane.mu, lane.h, enough, lane.past_h, 1.0)
    start = lane.y
    if lane.problem.model.pivot is not None and begins and begins_held(lane):
        # Its spin only tells the torque of the start, where spin and speed are zero.
        start = with_spin(lane, start, 0.0)
    whole = start + numbers + lane.constants + settings + lane.past + NEW
    lane.problem.rack.load(z, slot, whole)
    if begins or lane.past_h == 0.0:
        now = motion_of(lane, lane.y, slip)
        # Where the angle is stiff, its rate at the start says nothing about the step.
        stiff = begins or abs(lane.h * now.stiffness) >= 1.0
        turning = 0.0 if stiff else now.slip.angle
        rates = now.f + (now.slip.speed, turning, 0.0)  # noqa: RUF005
        for c in range(lane.problem.rack.count):
            keep_rate(lane, z, slot, c, rates[c])
        go_straight(lane, z, slot)


@njit(**FUSED)
def squared_speed(lane, speed):
    """Return the square of a speed, or of the spin that a patch has with it if smaller.

    The torque of a patch follows from the ratio of spin and speed.
    """
    if lane.problem.model.pivot is None:
        return speed * speed
    radius = (16.0 / (3.0 * pi)) * lane.constants[-2] / lane.mu
    spin = speed / max(1.0, radius)
    return spin * spin


@njit(**FUSED)
def keep_rate(lane, z, slot, c, rate):
    """Let a number be guessed from its rate at the start of the step alone."""
    rack = lane.problem.rack
    for k in range(STAGES):
        place = (rack.past + k * rack.count + c) * rack.width + slot
        z[place] = rate if k == 0 else 0.0


@njit(**FUSED)
def go_straight(lane, z, slot):
    """Let a step be guessed from its own start, and not from the last step's."""
    rack = lane.problem.rack
    z[rack.past_h * rack.width + slot] = lane.h
    z[rack.offset * rack.width + slot] = 0.0


@njit(**FUSED)
def rates_at_start(problem, z, slot, c):
    """Return the rate of a number at the start of a step, and the rate of this rate."""
    rack = problem.rack
    past_h = z[rack.past_h * rack.width + slot]
    side = 2.0 * z[rack.offset * rack.width + slot] - 1.0
    rate = 0.0
    bend = 0.0
    # Values and derivatives of Legendre's polynomials at 1 or -1.
    sign = 1.0
    for k in range(STAGES):
        coefficient = z[(rack.past + k * rack.count + c) * rack.width + slot]
        rate += sign * coefficient
        bend += sign * side * k * (k + 1) * coefficient
        sign *= side
    return rate, bend / past_h


@njit(**FUSED)
def look_ahead(lane, z, slot):
    """Do not follow the rates of the last step further than they tell."""
    rack = lane.problem.rack
    z[rack.h * rack.width + slot] = lane.h
    past_h = z[rack.past_h * rack.width + slot]
    offset = z[rack.offset * rack.width + slot]
    if offset + lane.h / past_h > MOST_AHEAD:
        for c in range(rack.count):
            rate, _ = rates_at_start(lane.problem, z, slot, c)
            keep_rate(lane, z, slot, c, rate)
        go_straight(lane, z, slot)


@njit(**FUSED)
def time_to_rest(lane, z, slot):
    """Return the time in which the speed falls to zero, or infinity.

    The speed is taken as a parabola in time.
    """
    speed = lane.slip.speed
    rate, bend = rates_at_start(lane.problem, z, slot, len(lane.y) + SLIP_SPEED)
    if speed <= BEGINNING or rate >= 0.0:
        return np.inf
    square = rate * rate - 2.0 * speed * bend
    if square <= 0.0:
        return np.inf
    return 2.0 * speed / (sqrt(square) - rate)


@njit(**FUSED)
def guess_beginning(lane, z, slot):
    """Guess direction and speed at the stages of the first step of a slide.

    The direction follows the force, and the speed is the integral of its rate.
    """
    rack = lane.problem.rack
    model = lane.problem.model
    angle = lane.slip.angle
    n = len(lane.y)
    for i in range(STAGES):
        state = moved(lane.y, lane.f, lane.h * POINTS[i])
        contact, _, at = contact_at_slip(lane, state, lane.slip)
        if model.pivot is not None:
            # The torque is that of the start, although the spin goes on.
            kept = with_spin(lane, state, model.spin(lane.y))
            _, _, rubbed = contact_at_slip(lane, kept, lane.slip)
            contact, _ = contact_while_sliding(at, rubbed.drag)
        angle, _ = settled_direction(contact, lane.mu, angle)
        _, _, along, _, _ = push(contact, lane.mu, angle)
        row = rack.values + (n + SLIP_ANGLE) * STAGES + i
        z[row * rack.width + slot] = angle
        z[(rack.growths + i) * rack.width + slot] = along
    for i in range(STAGES):
        speed = 0.0
        for j in range(STAGES):
            growth = z[(rack.growths + j) * rack.width + slot]
            speed += lane.h * INTEGRALS[i, j] * growth
        row = rack.values + (n + SLIP_SPEED) * STAGES + i
        z[row * rack.width + slot] = speed
        if model.pivot is not None and begins_held(lane):
            # The ratio of spin and speed is that of the start.
            state = moved(lane.y, lane.f, lane.h * POINTS[i])
            ratio = model.spin(lane.y) * lane.mu / lane.constants[-1]
            state = with_spin(lane, state, ratio * speed)
            for c in range(n):
                row = rack.values + c * STAGES + i
                z[row * rack.width + slot] = state[c]
            if i == 0:
                place = rack.enough * rack.width + slot
                most = SOLVED * SOLVED * squared_speed(lane, speed)
                z[place] = max(min(z[place], most), squared_rounding(lane))


@njit(**FUSED)
def with_spin(lane, y, n):
    """Return a state with another spin."""
    model = lane.problem.model
    at = model.slide.place(y, lane.slip, 0.0, lane.constants)
    return model.slide.turned(y, at.u, n - model.spin(y))


@njit(**FUSED)
def begins_held(lane):
    """Return whether a slide begins at a rest of the spin, which follows the speed."""
    n = lane.problem.model.spin(lane.y)
    return slip_of_patch(n, lane.constants[-2], lane.constants[-1]) > LEAST_RATIO


@njit(**FUSED)
def squared_slip(error, speed):
    """Return the square of the error of the velocity in the plane."""
    across = speed * error.angle
    return error.speed * error.speed + across * across


@njit(**FUSED)
def squared_rounding(lane):
    """Return the square of the rounding errors of a lane's state."""
    speed = lane.slip.speed
    size = 1.0 + speed * speed
    for component in lane.y:
        size += component * component
    return ROUNDING * ROUNDING * size


@njit(**FUSED)
def squared_error(lane, z, slot, rates, scale):
    """Return the squared error of the step just tried, in units of the tolerance.

    The tolerance is not smaller than rounding errors.  If the coefficients of the
    derivative fall by ``rho`` from one degree to the next, the error at the end of a
    step falls as ``rho^9``; this returns ``rho^8``.
    """
    rack = lane.problem.rack
    model = lane.problem.model
    speed = lane.slip1.speed
    high, size = model.error(rack.fifth(rates), lane.y1, lane.constants)
    high += squared_slip(Slip(*rack.fifth_slip(rates)), speed)
    low, _ = model.error(rack.third(rates), lane.y1, lane.constants)
    low += squared_slip(Slip(*rack.third_slip(rates)), speed)
    fall = high / (low + TINY)
    error = high * fall * fall
    if model.pivot is not None:
        error += squared_error_of_spin(lane, z, slot, rates)
    return error * lane.h * lane.h / max(size / scale, squared_rounding(lane))


@njit(**FUSED)
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


@njit(**FUSED)
def smooth_creep(lane, speed):
    """Return the creep on which the torque of the patch depends."""
    creep = lane.mu * speed
    least = lane.constants[-1]
    return sqrt(creep * creep + least * least)


@njit(**FUSED)
def squared_rate(lane, change):
    """Return the square of the rate of the spin for a rate of change of the state."""
    rate = lane.problem.model.spin_rate(lane.y1, change)
    return rate * rate


@njit(**FUSED)
def squared_error_of_spin(lane, z, slot, rates):
    """Return the square of the error of the spin in a step of size 1.

    The torque of the patch falls fast as the slide begins, and its coefficients may be
    small by chance.  Where the sliding is as fast as the patch turns at its rim, the
    torque has only two derivatives, so the error is of the order 2.5 there.
    """
    rack = lane.problem.rack
    model = lane.problem.model
    third = squared_rate(lane, rack.third(rates))
    fourth = squared_rate(lane, rack.fourth(rates))
    fifth = squared_rate(lane, rack.fifth(rates))
    fall = fifth / (fourth + TINY)
    fall = min(1.0, max(fifth / (third + TINY), fall * fall))
    error = fifth * fall * fall
    if error * lane.h * lane.h < SPIN_ROUNDING * SPIN_ROUNDING:
        # The weight is not for rounding errors.
        error = 0.0
    lever = lane.constants[-2]
    n0 = model.spin(lane.y)
    n1 = model.spin(lane.y1)
    before = slip_of_patch(n0, lever, smooth_creep(lane, lane.slip.speed))
    after = slip_of_patch(n1, lever, smooth_creep(lane, lane.slip1.speed))
    crosses = (n0 > 0.0) != (n1 > 0.0)
    if (before < 1.0) != (after < 1.0) or (crosses and before < 1.0):
        # The other ratio, spin over speed, is finite where the spin crosses zero.
        width = 1.0 / (after + TINY) + 1.0 / (before + TINY)
        if not crosses:
            width = min(abs(after - before), abs(1.0 / after - 1.0 / before))
        width = min(MOST_WIDTH, width)
        normal = rack.forces(z, slot)[STAGES - 1]
        torque = KINK * width * width * sqrt(width) * lever * normal
        rate = torque / lane.constants[2]
        error += rate * rate
    return SPIN_WEIGHT * SPIN_WEIGHT * error


@njit(**FUSED)
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


@njit(**FUSED)
def note_forces(lane, z, slot):
    """Set the limit and the forces at the end of a step from those at its stages.

    Return the limit and the negative normal force in the middle.
    """
    forces = lane.problem.rack.forces(z, slot)
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


@njit(**FUSED)
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


@njit(**INNER)
def hold_back(lane):
    """Copy the start of a step that is not taken to its end, with its forces."""
    lane.y1 = lane.y
    lane.f1 = lane.f
    runs.hold_values(lane)
    lane.slip1 = lane.slip
    lane.limit1 = lane.limit0
    lane.ratio1 = lane.ratio0
    lane.lift1 = lane.lift0
