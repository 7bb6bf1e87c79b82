"""Looks into steps: may a step tried hold an extreme or a mark that is recorded?

Every turn looks at all lanes at once, by a glance at the middle of their steps, and
follows functions through long ones (`look.inside`).  A lane whose step may hold
something new is watched: the step is then searched (`event.zeros`).

:func:`look_within` is a part that is compiled for each model and called by its address
(`kernel.turn`), and only loaded where a contact, reversals or marks are recorded.
"""

# mypy: ignore-errors
from math import sqrt

from numba import njit

from rattlesweep.compiling.intrinsics import INNER, widest_vectors
from rattlesweep.kernel.answer import contact_points
from rattlesweep.kernel.event.peaks import mark_points
from rattlesweep.kernel.event.zeros import may_be_far
from rattlesweep.kernel.look import inside
from rattlesweep.kernel.look.extremes import CONTACT, REVERSALS, least_turn, turn_points
from rattlesweep.kernel.look.marks import MARKS, value_of
from rattlesweep.kernel.state.fields import NEVER, PEAK, Flag, Number, Peak, Point
from rattlesweep.kernel.state.lane import lane_of
from rattlesweep.kernel.state.ways import steps_in_rack
from rattlesweep.physics.full import FASTMATH, scalar

# When lanes are looked at: before lanes that slide replace what was tried on them, and
# after it.
ROLLED, STEPPED = 0, 1


class LookFields:
    """What a look tells of the step tried."""

    inside: Flag  # whether it is long, and may hold a peak
    # Of no lane: what is seen of a long step at places side by side (`look.inside`).
    seen_first: Number
    seen_second: Number


def look_within(problem, w, stage, wanted, marks):
    """Look into the steps tried on all lanes, at a stage of the turn.

    ``wanted`` has the bits of extremes that are recorded, and ``marks`` the times of
    marks; without runs, none are looked for.
    """
    if stage == ROLLED:
        observe_contact(problem, w)
        return
    if wanted & CONTACT != 0:
        follow_contact(problem, w)
    if wanted & REVERSALS != 0:
        observe_spin(problem, w)
        follow_spin(problem, w)
    if marks.shape[0] > 0:
        observe_marks(problem, w, marks)


@njit(fastmath=FASTMATH, **INNER)
def observe_contact(problem, w):
    """Compute the contact forces at the end of the step tried on every lane.

    The forces follow from the state and its derivative, which are known at the end.  In
    the middle both are those of the cubic through the ends.
    """
    widest_vectors()
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
        recorded_most = lane.ratio_max
        at_end = ratio.value
        largest = at_end if at_end > recorded_most else recorded_most
        start = excess_of(lane.ratio0, lane.lift0, largest)
        end = excess_of(ratio, lift, largest)
        seen = inside.glance(start, tangential - largest * abs(normal), end, angle)
        is_pressed = (lane.lift0.value < 0.0) & (lift.value < 0.0) & (lane.h > 0.0)
        rubs = is_pressed & (seen.value > inside.least_above(largest))
        lane.ratio_peak = inside.peak_if(rubs, seen)
        most = -lane.normal_min
        seen = inside.glance(lane.lift0, -normal, lift, angle)
        lifts = (seen.value > most + inside.least_above(most)) & (lane.h > 0.0)
        lane.lift_peak = inside.peak_if(lifts, seen)
        is_long = inside.is_long(lane)
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


@njit(fastmath=FASTMATH, **INNER)
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


@njit(**INNER)
def observe_spin(problem, w):
    """Compute which steps tried may complete a turn or hold its largest spin."""
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
        is_due = may_be_far(lane) | (rises & (not is_long))
        lane.watched += 1.0 if is_due else 0.0


@njit(fastmath=FASTMATH, **INNER)
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


@njit(**INNER)
def is_followed(lane):
    """Return whether the step tried is long, and not one of a search for peaks."""
    is_taken = lane.error <= 1.0 and lane.search != PEAK
    return lane.inside > 0.0 and is_taken and lane.run >= 0.0


@njit(fastmath=FASTMATH, **INNER)
def dip_of_mark(lane, k, start, end):
    """Return where a mark may fall to zero within the step tried, as a peak."""
    if inside.is_long(lane):
        if not lane.error <= 1.0:
            return Peak(0.0, 0.0, 0.0)
        return inside.follow(lane, inside.rates_beyond(lane), inside.MARK, k)
    n = lane.problem.model.spin(inside.middle(lane))
    half, _ = value_of(k, n, 0.0, lane.n_launch)
    seen = inside.glance(
        inside.turned_over(start), -half, inside.turned_over(end), lane.h * lane.swing
    )
    return inside.peak_if(seen.value > 0.0, seen)


@njit(**INNER)
def observe_marks(problem, w, marks):
    """Compute which steps tried may hold a mark that has not been reached."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        run = int(lane.run)
        due = 0
        # As in `may_reverse`: what the spin may come down and back up in the step.
        path = 2.0 * lane.h * max(0.9 * lane.rate_max, abs(lane.rate1))
        if run >= 0 and lane.n_launch != 0.0:
            for k in range(len(MARKS)):
                if marks[run, 0, k] >= 0.0:
                    continue
                start, end = mark_points(lane, k)
                if start.value + end.value > path:
                    continue
                seen = dip_of_mark(lane, k, start, end)
                if end.value <= 0.0 or seen.h > 0.0:
                    if due == 0:
                        lane.mark_peak = seen
                    due += 1 << k
        lane.marks_due = due
        lane.watched += due
