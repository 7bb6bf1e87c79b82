"""Extremes: functions of the state whose largest value is kept, between steps too.

An extreme is a record; a further one is an entry of :data:`EXTREMES`, and an observer
in `lanes.runs` that says which steps may hold it.  Its place within an accepted step is
found with shorter steps of the method (`lanes.events`), and changes nothing else of the
run.
"""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Callable
from typing import Any, NamedTuple

from rattlesweep.integrate.lanes.lane import NEVER, Point, choice
from rattlesweep.physics.full import scalar

# Share of its height above the ends by which the cubic may be wrong in a whole step.
SLACK = 0.2
FINE = 1e-5  # smallest relative excess over the largest value so far that counts


# A function between two points.


@scalar
def height(start, end):
    """Return the largest value between two points, first rising, then falling."""
    length = end.h - start.h
    rise = length * start.rate
    fall = length * end.rate
    step = end.value - start.value
    # The cubic through both ends, at the place where the secant of the rates is zero.
    share = rise / (rise - fall)
    cubic = rise + fall - 2.0 * step
    return start.value + share * (rise + share * (step - rise - cubic + share * cubic))


@scalar
def may_peak(start, end, largest):
    """Return whether a function may exceed its largest value between two points."""
    top = height(start, end)
    ends = end.value if end.value > start.value else start.value
    peak = (start.rate > 0.0) & (end.rate < 0.0)
    return peak & (top + SLACK * (top - ends) > largest + FINE * abs(largest))


@scalar
def may_dip(start, end):
    """Return whether a function may fall below zero between two points."""
    below = Point(start.h, -start.value, -start.rate)
    return may_peak(below, Point(end.h, -end.value, -end.rate), 0.0)


@scalar
def may_fall(start, end):
    """Return whether a positive function may fall to zero between two points."""
    return (end.value <= 0.0) | may_dip(start, end)


# The extremes.


class Extreme(NamedTuple):
    """A function of the state, as compiled functions of a lane."""

    # points(lane): the function at both ends of the step just tried
    points: Callable[..., Any]
    # may_exceed(lane): whether the step may hold a value that is larger than those kept
    may_exceed: Callable[..., Any]
    # keep(lane, value): keep a largest value within the step
    keep: Callable[..., None]


@scalar
def ratio_points(lane):
    """Return the ratio of the contact forces."""
    return lane.ratio0, lane.ratio1


@scalar
def may_exceed_ratio(lane):
    """Return whether the ratio may be a new largest one in the step."""
    # Where the normal force is negative, the ratio has poles and no largest value.
    has_ratio = (lane.lift0.value < 0.0) & (lane.lift1.value < 0.0)
    return has_ratio & may_peak(lane.ratio0, lane.ratio1, lane.ratio_max)


@scalar
def keep_ratio(lane, value):
    """Keep a largest ratio."""
    lane.ratio_max = max(lane.ratio_max, value)


@scalar
def lift_points(lane):
    """Return the normal force with a minus sign."""
    return lane.lift0, lane.lift1


@scalar
def may_exceed_lift(lane):
    """Return whether the normal force may be a new least one in the step."""
    return may_peak(lane.lift0, lane.lift1, -lane.normal_min)


@scalar
def keep_lift(lane, value):
    """Keep a least normal force."""
    lane.normal_min = min(lane.normal_min, -value)


@scalar
def turn_points(lane):
    """Return the spin at both ends of the step, positive at the second."""
    side = 1.0 if lane.n1 > 0.0 else -1.0
    start = Point(0.0, side * lane.n0, side * lane.rate0)
    return start, Point(lane.h, side * lane.n1, side * lane.rate1)


@scalar
def least_turn(lane):
    """Return the modulus that the spin must exceed to be the largest of its turn."""
    after = lane.n_after
    # Before the first turn and between a zero and the next turn there is none.
    in_turn = (lane.reversals > 0.0) & (lane.t_pending < 0.0)
    return after if in_turn else NEVER


@scalar
def may_exceed_turn(lane):
    """Return whether the spin may be a new largest one of its turn in the step."""
    start, end = turn_points(lane)
    return (start.value > 0.0) & may_peak(start, end, least_turn(lane))


@scalar
def keep_turn(lane, value):
    """Keep a largest modulus of the spin."""
    lane.n_peak = max(lane.n_peak, value)


EXTREMES = (
    Extreme(ratio_points, may_exceed_ratio, keep_ratio),
    Extreme(lift_points, may_exceed_lift, keep_lift),
    Extreme(turn_points, may_exceed_turn, keep_turn),
)
"""The extremes, in the order in which they are searched."""

points_of = choice({k: each.points for k, each in enumerate(EXTREMES)}, inline=True)
may_exceed_of = choice(
    {k: each.may_exceed for k, each in enumerate(EXTREMES)}, inline=True
)
keep_of = choice({k: each.keep for k, each in enumerate(EXTREMES)}, inline=True)
