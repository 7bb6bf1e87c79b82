"""Extremes that are searched later, since a later step may hold a larger one.

Oscillations grow, so most steps that hold a new extreme are followed by one that holds
a larger one.  A glance tells between which values an extreme is.  The step with the
best one so far is kept, and searched once the run has ended.  It is dropped if a later
step, or the end of one, is surely beyond it.  A step whose extreme may be larger or
smaller than that of the step kept is searched at once.

Bodies that slide or pivot search all steps at once: a step that is kept would have to
be tried again in the mode that the lane had there.
"""

# mypy: disable-error-code="no-untyped-def"
from numba import njit

from rattlesweep.compiling.intrinsics import INNER, apart, lowest_bit, widest_vectors
from rattlesweep.kernel.state.fields import NEVER, Number, OfEnd, Peak, State
from rattlesweep.kernel.state.lane import lane_of
from rattlesweep.physics.full import scalar

# By how many times the doubt of a glance an extreme may be off its top.
DOUBTS = 3.0
# The longest step that is kept, in radians of the fastest swing.
LONGEST_KEPT = 3.0
# Where the normal force falls below this share of its value at an end, the ratio has
# sharp peaks, of which little is sure.
LEAST_NORMAL = 0.2


class PutOffFields:
    """The steps that are kept for a later search, one for each extreme."""

    # Of the step tried: the highest value that the extreme may have in it, if it is to
    # be kept, and the lowest one.
    ratio_later: OfEnd[Peak]
    lift_later: OfEnd[Peak]
    ratio_low1: OfEnd[Number]
    lift_low1: OfEnd[Number]
    # The same of the step kept, and its size.
    ratio_kept: Peak
    lift_kept: Peak
    ratio_low: Number
    lift_low: Number
    ratio_step: Number
    lift_step: Number
    # A run that ends once the steps kept are searched, and its status.
    ends: Number
    end_status: Number


class KeptStartFields:
    """The starts of the steps kept."""

    y_of_ratio: State
    f_of_ratio: State
    y_of_lift: State
    f_of_lift: State


@scalar
def sure_of(kept, low):
    """Return what an extreme surely reaches by the step kept, if there is one."""
    return low if kept.h > 0.0 else -NEVER


@scalar
def is_later(kept, low, most):
    """Return whether a step may be kept whose extreme is at least ``low``.

    ``most`` is the largest value so far.
    """
    return (kept.h == 0.0) | (kept.value <= most) | (low > kept.value)


@scalar
def ratios_of(excess, doubt, largest, least_normal, most_normal):
    """Return bounds of a ratio of forces from how much the tangential one exceeds.

    ``excess`` bounds what it exceeds ``largest`` times the normal force by.
    """
    low = excess - (DOUBTS + 1.0) * doubt
    high = excess + (DOUBTS - 1.0) * doubt
    normal = most_normal if low > 0.0 else least_normal
    return largest + low / normal, largest + high / least_normal


@njit(**INNER)
def keep_steps(problem, traits, w):
    """Keep steps that are taken and are to be searched later."""
    widest_vectors()
    bits = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        moves = lane.accept > 0.0
        ratio = lane.ratio_later
        lift = lane.lift_later
        is_kept = moves & ((ratio.h > 0.0) | (lift.h > 0.0))
        bits |= (1 if is_kept else 0) << l
    while bits != 0:
        l = lowest_bit(bits)
        bits &= bits - 1
        keep_step(problem, traits, w, l)


@njit(**INNER)
def keep_step(problem, traits, w, l):
    """Keep the step tried on a lane if it is to be searched later."""
    apart()
    lane = lane_of(problem, w, l)
    if lane.ratio_later.h > 0.0:
        lane.ratio_kept = lane.ratio_later
        lane.ratio_low = lane.ratio_low1
        lane.ratio_step = lane.h
        copy_start(problem, traits, w, l, 0, True)
    if lane.lift_later.h > 0.0:
        lane.lift_kept = lane.lift_later
        lane.lift_low = lane.lift_low1
        lane.lift_step = lane.h
        copy_start(problem, traits, w, l, 1, True)


@njit(**INNER)
def copy_start(problem, traits, w, l, k, keeps):
    """Copy the start of a step to that kept for an extreme, or back."""
    count = 2 * traits.n_state
    start = problem.first * problem.lanes + l
    kept = (traits.starts_kept + k * count) * problem.lanes + l
    for _ in range(count):
        if keeps:
            w[kept] = w[start]
        else:
            w[start] = w[kept]
        start += problem.lanes
        kept += problem.lanes


@njit(**INNER)
def has_kept(lane):
    """Return whether steps are kept."""
    return lane.ratio_kept.h > 0.0 or lane.lift_kept.h > 0.0


@njit(**INNER)
def kept_of(lane, k):
    """Return the peak kept for an extreme, if it may still be the largest value."""
    if k == 0:
        kept = lane.ratio_kept
        most = lane.ratio_max
    else:
        kept = lane.lift_kept
        most = -lane.normal_min
    may_exceed = kept.value > most
    return Peak(kept.h if may_exceed else 0.0, kept.value, kept.bend)
