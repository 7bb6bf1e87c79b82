"""What functions of the state do within a step, told from both of its ends.

A step may be longer than a swing, so a function may rise and fall within it although
its values and rates at both ends say nothing of it.  The state within a step is
interpolated.  A glance at its middle, on all lanes at once, tells which steps may hold
an extreme or a zero.  In a longer step the function is followed (:func:`follow`).  What
is found is a place at which a shorter step of the method is then tried
(`event.zeros`): nothing is recorded that was interpolated.
"""

# mypy: ignore-errors
from collections.abc import Callable
from math import ceil
from typing import NamedTuple

from numba import njit

from rattlesweep.compiling.intrinsics import FUSED, apart, moved, widest_vectors
from rattlesweep.kernel.look.marks import value_of
from rattlesweep.kernel.state.fields import DIFFERENCE, GROUP, NEVER, Peak, Point
from rattlesweep.kernel.state.lane import lane_of
from rattlesweep.physics.full import TINY, scalar

# The longest step of which a glance at the middle tells enough, in radians of the
# fastest swing.
GLANCED = 5.0
# Errors of a glance at a step of 1 rad, as shares of the spread of the values: that of
# the state in the middle grows with the square of the step, that of the quartic with
# the fourth power.
SLACK_OF_STATE = 5e-3
SLACK_OF_QUARTIC = 5e-4
OF_BUMP = 0.5 / 16.0
# What a function may fall below three of its values, as a share of their spread and
# their second difference: in short steps, and what is added at a step of 1 rad, which
# grows with the fourth power.  For a harmonic with the frequency of the swing this is
# enough in all steps that are glanced at; with twice that frequency, up to 2.7 rad.
ROUGH_SHARE = 0.25
ROUGH_GROWTH = 1.0 / 100.0
NEAR_END = 1e-3  # a peak nearer to an end of the step is first sought there
FINE = 1e-8  # smallest relative excess over the largest value so far that counts
LEAST = 1e-15  # the same, absolute: a rounding error
# The cubic through both ends of a step of no great length is right to such a share of
# what it rises above them.
CUBIC_SLACK = 0.2
# A function that is followed is looked at in such distances, in radians of the swing.
SPACING = 0.5
MOST_PIECES = 64.0
# Error of a followed function between two looks, as a share of the spread.
FOLLOWED = 0.01
# Error of the interpolated state at a step of 1 rad, as a share of the spread: that of
# Hermite's quintic with half the frequency of the spin, times five.
INTERPOLATED = 5.0 / 46080.0 / 64.0


# The state within a step.


@scalar
def middle(lane):
    """Return the state in the middle of the step, by a cubic."""
    start = moved(lane.y, lane.y, -0.5)
    ends = moved(start, lane.y1, 0.5)
    eighth = 0.125 * lane.h
    return moved(moved(ends, lane.f, eighth), lane.f1, -eighth)


@njit(**FUSED)
def rates_beyond(lane):
    """Return the derivatives a little after the start and the end of the step."""
    ahead = DIFFERENCE / lane.swing
    rhs = lane.problem.model.rhs
    first = rhs(moved(lane.y, lane.f, ahead), lane.constants)
    return first, rhs(moved(lane.y1, lane.f1, ahead), lane.constants)


@njit(**FUSED)
def state_at(lane, beyond, share):
    """Return the state at a share of the step, by Hermite's quintic.

    ``beyond`` is what :func:`rates_beyond` returns.
    """
    return between(ends_of(lane), beyond, share)


@scalar
def ends_of(lane):
    """Return what :func:`between` needs of a step: its ends, its size, the swing."""
    return lane.y, lane.f, lane.y1, lane.f1, lane.h, lane.swing


@scalar
def between(ends, beyond, share):
    """Return what :func:`state_at` does, for a step whose ends have been read.

    So a loop over places side by side vectorises, although it writes to the workspace.
    """
    start, rate_at_start, stop, rate_at_stop, h, swing = ends
    first, last = beyond
    scale = h * h * swing / DIFFERENCE
    t = share
    cube = t * t * t
    rest = 1.0 - t
    rest_cube = rest * rest * rest
    end = cube * (10.0 - 15.0 * t + 6.0 * t * t)
    bend0 = 0.5 * scale * t * t * rest_cube
    bend1 = 0.5 * scale * cube * rest * rest
    rate0 = h * t * rest_cube * (1.0 + 3.0 * t)
    rate1 = -h * cube * rest * (1.0 + 3.0 * rest)
    y = moved(moved(start, start, -end), stop, end)
    y = moved(moved(y, rate_at_start, rate0 - bend0), rate_at_stop, rate1 - bend1)
    return moved(moved(y, first, bend0), last, bend1)


@scalar
def middle_rate(lane):
    """Return the derivative in the middle of the step, by the same cubic."""
    slope = 1.5 / (lane.h + TINY)
    rise = moved(lane.y1, lane.y, -1.0)
    ends = moved(lane.f, lane.f1, 1.0)
    none = moved(rise, rise, -1.0)
    return moved(moved(none, rise, slope), ends, -0.25)


# A rough look.


@scalar
def may_dip(start, half, end, angle):
    """Return whether a positive function may fall to zero, from three of its values.

    ``half`` is its value in the middle, ``angle`` the length of the step in radians of
    the fastest swing; steps longer than :data:`GLANCED` are too long for it.  How far
    the function may fall below the least of its values is told from their spread and
    from their second difference.
    """
    low = start if start < end else end
    top = start if start > end else end
    low = half if half < low else low
    top = half if half > top else top
    square = angle * angle
    share = ROUGH_SHARE + ROUGH_GROWTH * square * square
    unsure = share * (abs(start + end - 2.0 * half) + (top - low))
    return low - unsure <= 0.0


# A glance.


@scalar
def glance(start, half, end, angle):
    """Return a bound of a function in a step, the place of its top, and the bend there.

    See :func:`glance_and_doubt`.
    """
    seen, _ = glance_and_doubt(start, half, end, angle)
    return seen


@scalar
def glance_and_doubt(start, half, end, angle):
    """Return a bound of a function in a step, the place of its top, and the bend there.

    ``half`` is its value in the middle, ``angle`` the length of the step in radians of
    the fastest swing.  The quartic through values and rates is looked at in eighths,
    and its top is found from the highest of these.  The bound is -NEVER if the top is
    an end of the step.  The second result is by how much the bound is above the top.
    """
    length = end.h - start.h
    rise = length * start.rate
    fall = length * end.rate
    step = end.value - start.value
    cubic = rise + fall - 2.0 * step
    square = step - rise - cubic
    bump = half - 0.5 * (start.value + end.value) - 0.125 * (rise - fall)
    bump *= 16.0
    # Coefficients of the quartic.
    square += bump
    cubic -= 2.0 * bump
    at_end = end.value > start.value
    top = end.value if at_end else start.value
    low = start.value if at_end else end.value
    share = 1.0 if at_end else 0.0
    for k in range(1, 8):
        t = 0.125 * k
        value = start.value + t * (rise + t * (square + t * (cubic + t * bump)))
        low = value if value < low else low
        share = t if value > top else share
        top = value if value > top else top
    for _ in range(2):
        t = share
        slope = rise + t * (2.0 * square + t * (3.0 * cubic + t * 4.0 * bump))
        bend = 2.0 * square + t * (6.0 * cubic + t * 12.0 * bump)
        bend = bend if bend < -TINY else -TINY
        move = -slope / bend
        move = move if move < 0.125 else 0.125
        move = move if move > -0.125 else -0.125
        top += 0.5 * slope * move
        share = t + move
    peaks = (share > 0.0) | (rise > 0.0)
    peaks &= (share < 1.0) | (fall < 0.0)
    share = share if share > NEAR_END else NEAR_END
    latest = 1.0 - NEAR_END
    share = share if share < latest else latest
    square_angle = angle * angle
    slack = square_angle * (SLACK_OF_STATE + SLACK_OF_QUARTIC * square_angle)
    doubt = slack * (top - low) + OF_BUMP * abs(bump)
    bound = top + slack * (top - low) + OF_BUMP * abs(bump)
    bend /= length * length + TINY
    return Peak(share * length, bound if peaks else -NEVER, bend), doubt


@scalar
def least_above(most):
    """Return by how much a function must exceed its largest value so far to count."""
    return FINE * abs(most) + LEAST


@scalar
def peak_if(is_due, seen):
    """Return a peak that was seen, or none."""
    return Peak(seen.h if is_due else 0.0, seen.value, seen.bend)


@scalar
def is_long(lane):
    """Return whether a glance tells too little of the step tried."""
    return lane.h * lane.swing > GLANCED


# Functions that are followed through a long step.

RATIO, LIFT, TURN, MARK = range(4)


@njit(**FUSED)
def excess_at(lane, beyond, share, kind, most):
    """Return by how much a function exceeds a value at a share of the step.

    The functions are the tangential force less a multiple of the normal force, the
    normal force with a minus sign, the spin with the sign that it has at the end, and
    with a minus sign the mark of a number.
    """
    model = lane.problem.model
    y = state_at(lane, beyond, share)
    if kind == MARK:
        value, _ = value_of(int(most), model.spin(y), 0.0, lane.n_launch)
        return -value
    if kind == TURN:
        n = model.spin(y)
        if lane.n1 > 0.0:
            return n - most
        return -n - most
    normal, tangential = model.contact(y, lane.constants)
    if kind == LIFT:
        return -normal - most
    return tangential - most * abs(normal)


class Seen(NamedTuple):
    """What has been seen of a function that is followed in equal pieces of a step."""

    best: float  # number of the look with the largest value
    top: float  # this value
    at_left: float  # the values beside it
    at_right: float
    low: float  # the least value
    before: float  # the last one


NOTHING_SEEN = Seen(0.0, -NEVER, -NEVER, -NEVER, NEVER, -NEVER)


@scalar
def seen_next(seen, k, excess):
    """Return what is seen with the look number ``k``."""
    at_right = excess if k == seen.best + 1.0 else seen.at_right
    low = min(seen.low, excess)
    if excess > seen.top:
        return Seen(k, excess, seen.before, -NEVER, low, excess)
    return Seen(seen.best, seen.top, seen.at_left, at_right, low, excess)


@njit(**FUSED)
def pieces_of(lane):
    """Return the number of pieces in which a long step is followed."""
    return min(MOST_PIECES, ceil(lane.h * lane.swing / SPACING))


@njit(**FUSED)
def follow(lane, beyond, kind, most):
    """Return the highest peak within a long step if it may exceed a value, or none."""
    pieces = pieces_of(lane)
    seen = NOTHING_SEEN
    k = 0.0
    while k <= pieces:
        seen = seen_next(seen, k, excess_at(lane, beyond, k / pieces, kind, most))
        k += 1.0
    return peak_seen(lane, beyond, kind, most, seen)


@njit(**FUSED)
def follow_forces(problem, w, l, ratio_most, lift_most):
    """Return what :func:`follow` does for the ratio of the forces and for the lift."""
    apart()
    widest_vectors()
    lane = lane_of(problem, w, l)
    beyond = rates_beyond(lane)
    ends = ends_of(lane)
    constants = lane.constants
    pieces = pieces_of(lane)
    ratio_seen = lift_seen = NOTHING_SEEN
    looks = int(pieces) + 1
    for first in range(0, looks, GROUP):
        # Several looks side by side, in the columns of the first lanes.
        for k in range(GROUP):
            y = between(ends, beyond, (first + k) / pieces)
            normal, tangential = problem.model.contact(y, constants)
            place = lane_of(problem, w, k)
            place.seen_first = tangential - ratio_most * abs(normal)
            place.seen_second = -normal - lift_most
        for k in range(min(GROUP, looks - first)):
            place = lane_of(problem, w, k)
            number = float(first + k)
            ratio_seen = seen_next(ratio_seen, number, place.seen_first)
            lift_seen = seen_next(lift_seen, number, place.seen_second)
    ratio = peak_seen(lane, beyond, RATIO, ratio_most, ratio_seen)
    return ratio, peak_seen(lane, beyond, LIFT, lift_most, lift_seen)


@njit(**FUSED)
def peak_seen(lane, beyond, kind, most, seen):
    """Return the highest peak of a function that was followed, if it may exceed 0."""
    pieces = pieces_of(lane)
    best, top, at_left, at_right, low, _ = seen
    best = min(max(best, 0.5), pieces - 0.5)
    if best % 1.0 == 0.5:
        # The highest is an end of the step: the peak may be next to it.
        at_left = excess_at(lane, beyond, (best - 0.5) / pieces, kind, most)
        top = excess_at(lane, beyond, best / pieces, kind, most)
        at_right = excess_at(lane, beyond, (best + 0.5) / pieces, kind, most)
    distance = 0.5 if best % 1.0 == 0.5 else 1.0
    bend = at_left + at_right - 2.0 * top
    if not bend < 0.0:
        return Peak(0.0, 0.0, 0.0)
    slope = 0.5 * (at_right - at_left)
    move = min(1.0, max(-1.0, -slope / bend))
    spread = top - low
    angle = lane.h * lane.swing
    square = angle * angle
    sixth = square * (square * square)
    unsure = spread * min(1.0, FOLLOWED + INTERPOLATED * sixth)
    unit = distance * lane.h / pieces
    seen = Peak(
        (best + distance * move) * lane.h / pieces,
        top + 0.5 * slope * move + unsure,
        bend / (unit * unit),
    )
    enough = 0.0
    if kind != MARK:
        enough = least_above(most)
    return peak_if(seen.value > enough, seen)


@scalar
def turned_over(point):
    """Return a function with the other sign."""
    return Point(point.h, -point.value, -point.rate)


@scalar
def at_zero(limit):
    """Return a limit where the spin leaves zero, as not falling.

    At the end of a rest, both the spin and its rate are rounding errors.
    """
    return Point(limit.h, limit.value, max(limit.rate, 0.0))


def along_flow(value: Callable[..., float]) -> Callable[..., Point]:
    """Return the limit that a function of a lane and a state is, with its rate."""

    @scalar
    def limit(lane, h, y, f):
        ahead = DIFFERENCE / lane.swing
        now = value(lane, y)
        later = value(lane, moved(y, f, ahead))
        return Point(h, now, (later - now) / ahead)

    return limit


@scalar
def both(first, second):
    """Return a number that is positive where two numbers are.

    There it is their product.  It is zero nowhere but at the border of this region.
    """
    below1 = min(first, 0.0)
    below2 = min(second, 0.0)
    return first * second - below1 * below1 - below2 * below2


@scalar
def both_of(first, second):
    """Return a function of the state that is positive where two functions are."""
    rate = first.value * second.rate + first.rate * second.value
    rate -= 2.0 * (min(first.value, 0.0) * first.rate)
    rate -= 2.0 * (min(second.value, 0.0) * second.rate)
    return Point(first.h, both(first.value, second.value), rate)


@scalar
def halfway(start, end):
    """Return the value of the cubic through both ends in the middle."""
    slopes = 0.125 * (end.h - start.h) * (start.rate - end.rate)
    return 0.5 * (start.value + end.value) + slopes


@scalar
def falls(start, half, end, angle):
    """Return whether a positive function may fall to zero, with a glance at the middle.

    The arguments are those of :func:`glance`.
    """
    seen = glance(turned_over(start), -half, turned_over(end), angle)
    return (seen.value > 0.0) | may_fall(start, end) | (angle > GLANCED)


@scalar
def may_fall(start, end):
    """Return whether a positive function may fall to zero in a step of no great length.

    It is taken as the cubic through both ends, at the place where the secant of the
    rates is zero.
    """
    length = end.h - start.h
    fall = length * start.rate
    rise = length * end.rate
    step = end.value - start.value
    share = fall / (fall - rise)
    cubic = fall + rise - 2.0 * step
    least = share * (fall + share * (step - fall - cubic + share * cubic))
    least += start.value
    ends = end.value if end.value < start.value else start.value
    dips = (fall < 0.0) & (rise > 0.0)
    return (end.value <= 0.0) | (dips & (least - CUBIC_SLACK * (ends - least) < 0.0))
