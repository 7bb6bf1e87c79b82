"""Extremes: functions of the state whose largest value is kept, between steps too.

An extreme is a record; a further one is an entry of :data:`EXTREMES`, and an observer
in `kernel.runs` that says which steps may hold it.  Its place within an accepted
step is found with shorter steps of the method (`event.zeros`), and changes nothing
else of the run.
"""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Callable
from typing import Any, NamedTuple

from rattlesweep.compiling.intrinsics import choice
from rattlesweep.kernel.state.fields import NEVER, Peak, Point
from rattlesweep.physics.full import TINY, scalar


class Extreme(NamedTuple):
    """A function of the state, as compiled functions of a lane."""

    # tried(lane): the function at the end of the step just tried
    tried: Callable[..., Any]
    # peak(lane): what may be its highest peak within the step, if that may exceed the
    # largest value so far
    peak: Callable[..., Any]
    # scale(lane): what a bend of the peak is divided by at the point tried
    scale: Callable[..., Any]
    # keep(lane, value): keep a largest value within the step
    keep: Callable[..., None]


@scalar
def ratio_tried(lane):
    """Return the ratio of the contact forces."""
    return lane.ratio1


@scalar
def ratio_peak(lane):
    """Return the highest ratio within the step."""
    return lane.ratio_peak


@scalar
def by_normal_force(lane):
    """Return the modulus of the normal force at the point tried."""
    return abs(lane.lift1.value) + TINY


@scalar
def by_one(lane):
    """Return 1."""
    return 1.0


@scalar
def keep_ratio(lane, value):
    """Keep a largest ratio."""
    lane.ratio_max = max(lane.ratio_max, value)


@scalar
def lift_tried(lane):
    """Return the normal force with a minus sign."""
    return lane.lift1


@scalar
def lift_peak(lane):
    """Return the least normal force within the step, with a minus sign."""
    return lane.lift_peak


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
def turn_tried(lane):
    """Return the modulus of the spin."""
    _, end = turn_points(lane)
    return end


@scalar
def least_turn(lane):
    """Return the modulus that the spin must exceed to be the largest of its turn."""
    # All are read before any is chosen: a load under a condition would be masked, which
    # is slow with AVX2.
    pending = lane.t_pending
    reversals = lane.reversals
    far = lane.far
    after = lane.n_after
    # Between a zero and the next turn, only what is far can be of a turn.
    after = far if pending >= 0.0 else after
    may_turn = (reversals > 0.0) | (pending >= 0.0)
    return after if may_turn else NEVER


@scalar
def turn_peak(lane):
    """Return the largest spin within the step, if it is one of a turn."""
    in_turn = (lane.reversals > 0.0) & (lane.t_pending < 0.0)
    peak = lane.turn_peak
    return Peak(peak.h if in_turn else 0.0, peak.value, peak.bend)


@scalar
def keep_turn(lane, value):
    """Keep a largest modulus of the spin."""
    lane.n_peak = max(lane.n_peak, value)


EXTREMES = (
    Extreme(ratio_tried, ratio_peak, by_normal_force, keep_ratio),
    Extreme(lift_tried, lift_peak, by_one, keep_lift),
    Extreme(turn_tried, turn_peak, by_one, keep_turn),
)
"""The extremes, in the order in which they are searched."""

tried_of = choice({k: each.tried for k, each in enumerate(EXTREMES)}, inline=True)
peak_of = choice({k: each.peak for k, each in enumerate(EXTREMES)}, inline=True)
scale_of = choice({k: each.scale for k, each in enumerate(EXTREMES)}, inline=True)
keep_of = choice({k: each.keep for k, each in enumerate(EXTREMES)}, inline=True)
