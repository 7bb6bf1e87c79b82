"""Extremes: functions of the state whose largest value is kept, between steps too.

An extreme is a record.  All of it is here: its fields, its table, when it counts at the
ends of steps, which steps may hold it, and its entry in :data:`EXTREMES`.  Its word of
`record`, its column and its meaning are in `words.watched`.  Its place within an
accepted step is found with shorter steps of the method (`event.peaks`).  The search
changes nothing else of the run.
"""

# mypy: disable-error-code="no-untyped-def, union-attr"
from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, Any, NamedTuple

from numba import njit

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import FUSED, INNER, choice, moved, widest_vectors
from rattlesweep.kernel.look import inside, put_off
from rattlesweep.kernel.state.fields import (
    DIFFERENCE,
    NEVER,
    PEAK,
    PUT_OFF,
    Number,
    OfEnd,
    Peak,
    Point,
)
from rattlesweep.kernel.state.lane import lane_of, recorded
from rattlesweep.kernel.state.ways import steps_in_rack
from rattlesweep.physics.full import TINY, scalar
from rattlesweep.words.watched import ExtremeName

# When lanes are looked at: before lanes that slide replace what was tried on them, and
# after it.
ROLLED, STEPPED = 0, 1


class ExtremeFields:
    """The functions that are searched for extremes, and their extremes so far."""

    # The contact forces.
    ratio0: Point  # tangential over normal force, at the start of the step
    ratio1: OfEnd[Point]  # the same at its end
    lift0: Point  # normal force with a minus sign
    lift1: OfEnd[Point]
    ratio_peak: OfEnd[Peak]  # of the step tried, as interpolated (`look.inside`)
    lift_peak: OfEnd[Peak]
    ratio_max: Number  # largest ratio so far
    normal_min: Number  # least normal force so far

    # The spin since the last reversal.
    turn_peak: OfEnd[Peak]  # of the step tried, as interpolated
    n_after: Number  # largest modulus of the spin since the last reversal
    n_peak: Number  # largest modulus found within the step


@dataclass(frozen=True)
class ExtremeRecord:
    """Extremes, over runs.  Those of the spin are in `runs.RunRecord.reversals`."""

    # Largest ratio of the contact forces, least normal force.
    contact: Annotated[Floats, (1, 2)]

    def extreme(self, name: ExtremeName) -> Floats:
        """Return the values of an extreme."""
        return PLACES_OF_EXTREMES[name](self)


PLACES_OF_EXTREMES: dict[ExtremeName, Callable[[ExtremeRecord], Floats]] = {
    "contact_ratio_max": lambda record: record.contact[:, 0, 0],
    "contact_normal_min": lambda record: record.contact[:, 0, 1],
}
"""Where the values of extremes are."""


class Extreme(NamedTuple):
    """A function of the state, as compiled functions of a lane."""

    # tried(lane): a Point of the function at the end of the step just tried
    tried: Callable[..., Any]
    # peak(lane): what may be its highest Peak within the step, if that may exceed the
    # largest value so far; else a Peak with h = 0
    peak: Callable[..., Any]
    # scale(lane): what the bend of this peak is divided by at the first point tried, to
    # be one of the function.  (That of the ratio is a bend of what the tangential force
    # exceeds, see `observe_contact`.)
    scale: Callable[..., Any]
    # keep(lane, value): keep a largest value within the step
    keep: Callable[..., None]


# When extremes count.


@njit(**INNER)
def start_extremes(lane):
    """Let the extremes of a run begin with its launch."""
    lane.ratio1, lane.lift1 = contact_points(lane, 0.0, lane.y, lane.f)
    lane.normal_min = NEVER
    note_contact(lane)
    start_points(lane)


@njit(**INNER)
def advance(problem, w, recording):
    """Let the ends of the steps that are taken count, and be the starts of the next.

    The spin of a turn is noted by `runs.note_turn`.
    """
    if recorded(recording.contact):
        _advance_contact(problem, w)


@njit(**INNER)
def store(lane, run, recording):
    """Store the extremes of a run that has ended."""
    if recorded(recording.contact):
        note_contact(lane)
        recording.contact[run, 0, 0] = lane.ratio_max
        recording.contact[run, 0, 1] = lane.normal_min


# The contact forces at the ends of steps.


@scalar
def contact_points(lane, h, y, f):
    """Return the ratio of the contact forces and the negative normal force.

    ``f`` is the derivative in the state ``y``.
    """
    # The rates are differences along the flow; an error of them only moves the place
    # at which an extreme is evaluated.
    ahead = DIFFERENCE / lane.swing
    model = lane.problem.model
    normal, square = model.force(y, f, lane.constants)
    ratio = sqrt(square) / abs(normal)
    later_normal, tangential = model.contact(moved(y, f, ahead), lane.constants)
    rate = (tangential / abs(later_normal) - ratio) / ahead
    lift_rate = (normal - later_normal) / ahead
    return Point(h, ratio, rate), Point(h, -normal, lift_rate)


@njit(**INNER)
def note_contact(lane):
    """Let the end of the step just tried count in the extremes of the contact."""
    lane.ratio_max = max(lane.ratio_max, lane.ratio1.value)
    lane.normal_min = min(lane.normal_min, -lane.lift1.value)


@njit(**INNER)
def start_points(lane):
    """Let the ratio and the lift at the end of the step be those at the next start."""
    ratio = lane.ratio1
    lift = lane.lift1
    lane.ratio0 = Point(0.0, ratio.value, ratio.rate)
    lane.lift0 = Point(0.0, lift.value, lift.rate)


@njit(**INNER)
def _advance_contact(problem, w):
    """Do what :func:`note_contact` and :func:`start_points` do, on lanes that move."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        # All are read before any is chosen, as in `turn.commit`.
        moves = lane.accept > 0.0
        most = lane.ratio_max
        least = lane.normal_min
        before = lane.ratio0
        lift_before = lane.lift0
        after = lane.ratio1
        lift_after = lane.lift1
        force_after = -lift_after.value
        rises = moves & (after.value > most)
        falls = moves & (force_after < least)
        lane.ratio_max = after.value if rises else most
        lane.normal_min = force_after if falls else least
        lane.ratio0 = Point(
            0.0,
            after.value if moves else before.value,
            after.rate if moves else before.rate,
        )
        lane.lift0 = Point(
            0.0,
            lift_after.value if moves else lift_before.value,
            lift_after.rate if moves else lift_before.rate,
        )


# The contact forces within steps.


@njit(**FUSED)
def observe_contact(problem, w, may_put_off):
    """Compute the contact forces at the end of the step tried on every lane.

    The forces follow from the state and its derivative, which are known at the end.  In
    the middle both are those of the cubic through the ends.  A search that may be put
    off is not due (`look.put_off`).
    """
    widest_vectors()
    may_put_off = may_put_off and not problem.modes.limited
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        ratio, lift = contact_points(lane, lane.h, lane.y1, lane.f1)
        normal, square = lane.problem.model.force(
            inside.middle(lane), inside.middle_rate(lane), lane.constants
        )
        tangential = sqrt(square)
        angle = lane.h * lane.swing
        # Where the normal force is negative, the ratio has poles.  What the tangential
        # force exceeds has none; its peak is that of the ratio if no end is higher.
        is_long = inside.is_long(lane)
        can_wait = may_put_off & (angle < put_off.LONGEST_KEPT)
        # The normal force.
        before = lane.lift0
        recorded_least = -lane.normal_min
        at_end = lift.value
        most = at_end if at_end > recorded_least else recorded_least
        kept = lane.lift_kept
        low = lane.lift_low
        sure = put_off.sure_of(kept, low)
        least = sure if sure > recorded_least else recorded_least
        seen, doubt = inside.glance_and_doubt(before, -normal, lift, angle)
        bound = seen.value
        lifts = (bound > least + inside.least_above(least)) & (lane.h > 0.0)
        low = bound - (put_off.DOUBTS + 1.0) * doubt
        high = bound + (put_off.DOUBTS - 1.0) * doubt
        later = lifts & can_wait & put_off.is_later(kept, low, most)
        lifts &= not later
        # The highest and the lowest normal force, for the ratio.
        highest = -before.value if before.value < at_end else -at_end
        highest = normal if normal > highest else highest
        lowest = -before.value if before.value > at_end else -at_end
        lowest = normal if normal < lowest else lowest
        lowest = -bound if -bound < lowest else lowest
        is_flat = lowest > put_off.LEAST_NORMAL * highest
        lowest = lowest if is_flat else highest
        # The ratio.
        ratio_before = lane.ratio0
        recorded_most = lane.ratio_max
        at_end = ratio.value
        most_ratio = at_end if at_end > recorded_most else recorded_most
        kept_ratio = lane.ratio_kept
        low_ratio = lane.ratio_low
        sure = put_off.sure_of(kept_ratio, low_ratio)
        largest = sure if sure > most_ratio else most_ratio
        start = excess_of(ratio_before, before, largest)
        end = excess_of(ratio, lift, largest)
        glanced, doubt = inside.glance_and_doubt(
            start, tangential - largest * abs(normal), end, angle
        )
        is_pressed = (before.value < 0.0) & (lift.value < 0.0) & (lane.h > 0.0)
        rubs = is_pressed & (glanced.value > inside.least_above(largest))
        low_ratio, high_ratio = put_off.ratios_of(
            glanced.value, doubt, largest, lowest, highest
        )
        ratio_later = put_off.is_later(kept_ratio, low_ratio, most_ratio)
        ratio_later &= rubs & can_wait & is_flat
        rubs &= not ratio_later
        lane.ratio_peak = inside.peak_if(rubs, glanced)
        lane.lift_peak = inside.peak_if(lifts, seen)
        lane.ratio_later = Peak(
            glanced.h if ratio_later else 0.0, high_ratio, glanced.bend
        )
        lane.lift_later = Peak(seen.h if later else 0.0, high, seen.bend)
        lane.ratio_low1 = low_ratio
        lane.lift_low1 = low
        lane.ratio1 = ratio
        lane.lift1 = lift
        lane.inside = 1.0 if is_long else 0.0
        lane.watched += 1.0 if (rubs | lifts) & (not is_long) else 0.0


@scalar
def excess_of(ratio, lift, largest):
    """Return by how much the tangential force exceeds a share of the normal force."""
    normal = abs(lift.value)
    rate = lift.rate if lift.value > 0.0 else -lift.rate
    excess = ratio.value - largest
    return Point(ratio.h, excess * normal, ratio.rate * normal + excess * rate)


@njit(**FUSED)
def follow_contact(problem, w):
    """Find the peaks of the contact in long steps."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        if not is_followed(lane) or steps_in_rack(lane):
            continue
        largest = max(lane.ratio_max, lane.ratio1.value)
        ratio, lift = inside.follow_forces(problem, w, l, largest, -lane.normal_min)
        is_pressed = lane.lift0.value < 0.0 and lane.lift1.value < 0.0
        lane.ratio_peak = inside.peak_if(is_pressed, ratio)
        lane.lift_peak = lift
        if lane.ratio_peak.h > 0.0 or lane.lift_peak.h > 0.0:
            lane.watched += 1.0


def look_at_contact(problem, w, stage, may_put_off, marks):
    """Look at the contact in the steps tried on all lanes, at a stage of the turn."""
    if stage == ROLLED:
        observe_contact(problem, w, may_put_off)
        return
    follow_contact(problem, w)


@njit(**INNER)
def is_followed(lane):
    """Return whether the step tried is long, and not one of a search for peaks."""
    is_sought = lane.search == PEAK or lane.search == PUT_OFF
    is_taken = lane.error <= 1.0 and not is_sought
    return lane.inside > 0.0 and is_taken and lane.run >= 0.0


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


# The spin of a turn.


@scalar
def may_be_far(lane):
    """Return whether the spin may reach the awaited modulus in the step tried."""
    # As in `zeros.may_reverse`, for the path to that modulus and back.
    before = lane.far_rate
    latest = lane.rate_max
    recent = 0.9 * (before if lane.arm > 0.0 else latest)
    now = abs(lane.rate1)
    recent = now if now > recent else recent
    n1 = abs(lane.n1)
    awaited = lane.awaited
    path = abs(lane.n0) + n1 + 2.0 * lane.h * recent
    return (n1 > awaited) | (path > 2.0 * awaited)


@njit(**INNER)
def observe_spin(problem, w):
    """Compute which steps tried may hold the largest spin of a turn."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        start, end = turn_points(lane)
        n = lane.problem.model.spin(inside.middle(lane))
        half = n if lane.n1 > 0.0 else -n
        most = least_turn(lane)
        seen = inside.glance(start, half, end, lane.h * lane.swing)
        may_turn = (start.value > 0.0) & (most < NEVER)
        rises = may_turn & (seen.value > most + inside.least_above(most))
        is_long = inside.is_long(lane)
        lane.turn_peak = inside.peak_if(rises, seen)
        lane.inside = 1.0 if may_turn & is_long else 0.0
        lane.watched += 1.0 if rises & (not is_long) else 0.0


@njit(**FUSED)
def follow_spin(problem, w):
    """Find the largest spin of a turn in long steps."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        if not is_followed(lane):
            continue
        beyond = inside.rates_beyond(lane)
        most = least_turn(lane)
        lane.turn_peak = inside.follow(lane, beyond, inside.TURN, most)
        if lane.turn_peak.h > 0.0:
            lane.watched += 1.0


def look_at_turns(problem, w, stage, may_put_off, marks):
    """Look at the spin between reversals in the steps tried on all lanes."""
    if stage == STEPPED:
        observe_spin(problem, w)
        follow_spin(problem, w)


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

# What looks at them, by the word of `record`.
LOOKS_AT_EXTREMES = {"contact": look_at_contact, "reversals": look_at_turns}

tried_of, peak_of, scale_of, keep_of = (
    choice(dict(enumerate(functions)), inline=True)
    for functions in zip(*EXTREMES, strict=True)
)
