"""Zeros of the spin at which pivoting friction changes its sense, and spins held there.

A body that rolls with pivoting friction (`physics.friction.pivoting`) is in one of two
modes (`mode.modes`): PIVOTING, with a positive or a negative spin, until a zero of the
spin, or HELD, with the spin held at zero, until the torque that this takes exceeds
``l F_n``.  The sense of the spin, 0 while it is held, is a constant of a lane.  While
the body slides, which needs no sense, its place has the least creep
(`physics.friction.pivoting`).

A reversal is a zero at which the spin goes over to the other side, or the end of a rest
from which it does.
"""

# mypy: ignore-errors
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import copysign, exp, nan, pi
from typing import Any

from numba import njit

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import FUSED, INNER, apart, moved, widest_vectors
from rattlesweep.kernel import runs
from rattlesweep.kernel.answer import jump, note_energies
from rattlesweep.kernel.event.zeros import REVERSED
from rattlesweep.kernel.look.inside import (
    FOLLOWED,
    GLANCED,
    INTERPOLATED,
    along_flow,
    at_zero,
    between,
    both_of,
    ends_of,
    falls,
    may_dip,
    middle,
    pieces_of,
    rates_beyond,
)
from rattlesweep.kernel.state.fields import (
    DIFFERENCE,
    GROUP,
    NEVER,
    Number,
    Point,
    Slip,
)
from rattlesweep.kernel.state.lane import Mode, lane_of
from rattlesweep.kernel.state.statuses import AT_LIMIT, OK
from rattlesweep.kernel.state.ways import HELD, PIVOTING, SLIDING
from rattlesweep.kernel.step.sliding_motion import patch_rates
from rattlesweep.kernel.step.sliding_step import (
    BEGINNING,
    contact_at_slip,
    motion_of,
)
from rattlesweep.physics.friction.pivoting import LEAST_CREEP, least_creep
from rattlesweep.physics.friction.sliding import outgoing
from rattlesweep.physics.full import TINY, scalar


class RestFields:
    """What a lane with pivoting friction knows of rests of its spin."""

    slack: Number  # by how much the spin may be on the wrong side of zero
    t_hold: Number  # begin of the last rest
    rate_held: Number  # `rate_max` at the begin of it
    left_zero: Number  # `steps` when the spin last left zero, -1 for never


class HoldFields:
    """What the torque that holds a spin lacks of its limits, at either end of a step.

    Both are smooth; their minimum has a kink.
    """

    below: Number
    above: Number


@dataclass(frozen=True)
class RestResults:
    """Results of a model with pivoting friction; without rows in others."""

    t_held: Floats  # begin of the first rest of the spin
    held_time: Floats  # time for which the spin is held
    pivot_work: Floats  # energy lost by pivoting, relative to energy_0
    # 1 where a step ended at a state in which the plane would have to pull the body.
    pulled: Floats


# The results of a run whose model has no pivoting friction.
WITHOUT_TORQUE = {"t_held": nan, "held_time": 0.0, "pivot_work": 0.0, "pulled": 0.0}
# By what share of the lever the limit of a rest is passed before it counts, so that
# rounding errors do not end it at once.
PASSED = 1e-13
# Smallest spin, over the lever, with which a slide begins: below it the decay of the
# spin is too stiff.
SMALLEST_SPIN = 1e-7
# Logarithms of the least and largest `slip_of_patch` with which a foot leaves a rest
# of spin and speed.  At the least its torque is 1e-6 below the one without sliding.
SMALLEST_LOG_SLIP = -7.0
LARGEST_LOG_SLIP = 300.0
HALVINGS_OF_RATIO = 60
# By what share of itself a spin that follows the speed to rest may miss it in the last
# step.
FOLLOWING = 0.1
# Rounding errors of the spin, as a share of its scale.
LEAST_SPIN = 1e-14


@njit(**FUSED)
def set_sense(lane, sense):
    """Let the torque act against a spin of this sign, or hold the spin for 0."""
    lane.sense = sense
    lane.mode = HELD if sense == 0.0 else PIVOTING


@njit(**FUSED)
def note_pull(problem, w, used):
    """Note on every lane whether the plane would have to pull at the end of the step.

    There the torque of a spin vanishes, and so does its power.  No step sees where it
    begins to, so the derivative has a kink within a step.
    """
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        has_torque = problem.model.pivot_work(lane.f1) != 0.0
        is_free = (lane.mode != PIVOTING) | (lane.n1 == 0.0) | has_torque
        before = lane.pulled
        lane.pulled = before if is_free else 1.0


@njit(**FUSED)
def give_slack(lane, y):
    """Let the spin begin on its side of zero, although it is a rounding error."""
    n = lane.sense * lane.problem.model.spin(y)
    # After a tap the bound of the rate is unknown until the spin has been far.
    rate = lane.arm_rate if lane.arm > 0.0 else lane.rate_max
    scale = abs(lane.n_launch) + rate / lane.swing
    lane.slack = max(0.0, -n) + LEAST_SPIN * scale


@scalar
def margins(lane, y):
    """Return what the torque that holds the spin lacks of its two limits."""
    return margins_of(lane.problem.model, y, lane.constants, lane.lever)


@scalar
def margins_of(model, y, constants, lever):
    """Return what :func:`margins` does, for a body whose constants have been read."""
    torque, held, _ = model.pivot(y, constants)
    most = lever * (held + PASSED)
    return most + torque, most - torque


@scalar
def margin(lane, y):
    """Return the torque that the plane can still give to hold the spin."""
    below, above = margins(lane, y)
    return below if below < above else above


held_point = along_flow(margin)
"""The limit of a spin that is held, positive while it is."""


@scalar
def turn_point(lane, h, y, f):
    """Return the limit of a spin with a sign; nothing for one that is held."""
    sense = lane.sense
    model = lane.problem.model
    value = sense * model.spin(y) + lane.slack
    rate = sense * model.spin_rate(y, f)
    return Point(h, 1.0 if sense == 0.0 else value, rate)


@scalar
def after_zero(lane, limit):
    """Return the limit at the start of a step, at which the spin may have left zero."""
    leaves = lane.mode == PIVOTING and lane.left_zero == lane.steps
    return at_zero(limit) if leaves else limit


@njit(**INNER)
def distance_from_zero(lane):
    """Return how far a lane is from the limit of the spin, as a share of its scale."""
    apart()
    if lane.mode == HELD:
        return abs(margin(lane, lane.y1)) / (lane.lever + TINY)
    scale = abs(lane.n_launch) + abs(lane.rate1) / lane.swing
    return abs(lane.n1) / (scale + TINY)


@njit(**FUSED)
def sense_from_zero(lane, y):
    """Return the sense with which a spin leaves zero, 0 if the plane holds it."""
    set_sense(lane, 0.0)
    torque, held, _ = lane.problem.model.pivot(y, lane.constants)
    if abs(torque) <= lane.lever * held:
        return 0.0
    return -1.0 if torque > 0.0 else 1.0


@njit(**FUSED)
def hold_spin(lane, y, t):
    """Note that the spin is held from the state ``y`` and the time ``t`` on."""
    lane.below1, lane.above1 = margins(lane, y)
    # A launch has no step before it.
    lane.below = lane.below1
    lane.above = lane.above1
    lane.t_hold = t
    lane.rate_held = lane.rate_max
    if lane.t_held < 0.0:
        lane.t_held = t


@njit(**INNER)
def release(lane, t):
    """Note that the spin is held until the time ``t``."""
    lane.held_time += t - lane.t_hold
    lane.rate_max = max(lane.rate_max, lane.rate_held)


@njit(**FUSED)
def free(lane):
    """Let the foot begin to slide at the end of the step, with the torque it has.

    Where the spin is held, the foot begins to turn, as the torque of a sliding patch
    depends on the ratio of spin and speed.
    """
    lever = lane.lever
    spin = lane.problem.model.spin(lane.y1)
    sense = lane.sense
    # Just after a rest the spin may be too small to be integrated.
    turning = sense * max(sense * spin, SMALLEST_SPIN * lever)
    least = least_creep(turning, lever)
    if sense == 0.0:
        least = LEAST_CREEP
    lane.least_creep = least
    if sense == 0.0:
        turning = spin_at_begin(lane)
    turn_end(lane, turning - spin)
    lane.n1 = turning


@njit(**FUSED)
def spin_at_begin(lane):
    """Return the spin, at the least creep, with which a foot leaves a rest of both.

    Spin and speed grow from zero in proportion, with the torque that follows from
    their ratio.  The ratio at which both rates have it is found by bisection.  Where
    rolling ends at the limit of friction, the speed has no rate at first, so the torque
    is the one that held the spin.
    """
    apart()
    # Without a torque the spin grows to this side.
    sense = 1.0 if lag_of_spin(lane, 0.0) > 0.0 else -1.0
    unit = LEAST_CREEP * (3.0 * pi / 16.0) / (lane.lever + TINY)
    low = SMALLEST_LOG_SLIP
    high = LARGEST_LOG_SLIP
    for _ in range(HALVINGS_OF_RATIO):
        middle = 0.5 * (low + high)
        if sense * lag_of_spin(lane, sense * unit * exp(-middle)) > 0.0:
            high = middle
        else:
            low = middle
    return sense * unit * exp(-low)


@njit(**FUSED)
def lag_of_spin(lane, spin):
    """Return the rate of the spin beyond that which keeps its ratio to the speed.

    The foot leaves rest at the end of the step; ``spin`` is that at the least creep.
    """
    model = lane.problem.model
    rest = Slip(BEGINNING, 0.0, lane.slip.work)
    at = model.slide.place(lane.y1, rest, 0.0, lane.constants)
    y = model.slide.turned(lane.y1, at.u, spin - model.spin(lane.y1))
    contact, _, _ = contact_at_slip(lane, y, rest)
    angle, leaves = outgoing(contact, lane.mu)
    motion = motion_of(lane, y, Slip(BEGINNING, angle, lane.slip.work))
    gain = max(0.0, motion.slip.speed) if leaves else 0.0
    ratio = spin * lane.mu / LEAST_CREEP
    return model.spin_rate(y, motion.f) - ratio * gain


@njit(**FUSED)
def turn_end(lane, rate):
    """Change the spin at the end of the step."""
    slide = lane.problem.model.slide
    at = slide.place(lane.y1, lane.slip1, 0.0, lane.constants)
    lane.y1 = slide.turned(lane.y1, at.u, rate)


@njit(**FUSED)
def slow(lane):
    """Let a spin that follows the speed do so in a step to the end of a slide.

    The torque of the patch depends on their ratio, and may settle it so fast that both
    reach zero together.  The steps at the end of a slide say nothing of that.
    """
    apart()
    model = lane.problem.model
    before = lane.slip.speed
    after = lane.slip1.speed
    if not after < before:
        return
    n = model.spin(lane.y)
    kept = n * (after / before)
    end = model.spin(lane.y1)
    if abs(end - kept) > FOLLOWING * abs(n):
        constants = lane.constants + (lane.mu,)  # noqa: RUF005
        numbers = patch_rates(model, lane.y, lane.slip, constants)
        settling = numbers[-2] - numbers[-3] * numbers[-1]
        if settling * lane.h * before > after - before:
            return
    turn_end(lane, kept - end)
    # It is on its side, even where it is zero.
    lane.n1 = copysign(max(abs(kept), TINY), n)


@njit(**FUSED)
def settle(lane, y, n, t):
    """Let the torque act from the state ``y`` on, in which the body rolls."""
    has_slid = lane.mode == SLIDING
    sense = 1.0 if n > 0.0 else -1.0
    rests = abs(n) <= TINY
    if rests:
        sense = sense_from_zero(lane, y)
    set_sense(lane, sense)
    lane.slack = 0.0
    if sense == 0.0:
        hold_spin(lane, y, t)
    elif rests and has_slid:
        give_slack(lane, y)
        lane.left_zero = lane.steps + 1.0


@njit(**FUSED)
def leave_zero(lane, t):
    """Let the spin go on from zero at the end of the step; return its sense."""
    apart()
    if lane.mode == HELD:
        torque, _, _ = lane.problem.model.pivot(lane.y1, lane.constants)
        sense = -1.0 if torque > 0.0 else 1.0
        release(lane, t)
    else:
        sense = sense_from_zero(lane, lane.y1)
    set_sense(lane, sense)
    give_slack(lane, lane.y1)
    if sense == 0.0:
        hold_spin(lane, lane.y1, t)
    jump(lane)
    lane.limit1 = at_zero(lane.limit1)
    # A body that pivots computes its limit again, in `modes.look_at_limit`.
    lane.left_zero = lane.steps + 1.0
    lane.h_next = lane.full_next
    return sense


@njit(**FUSED)
def any_held(problem, w):
    """Return whether the spin of a lane is held."""
    held = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        held += 1 if lane.mode == HELD else 0
    return held > 0


@njit(**FUSED)
def observe_held(problem, w, used):
    """Look at the torque in the step tried on every lane that is held.

    It is looked at in the middle, too: the plane may give way there and hold again at
    the end.  A step too long for this look is followed.
    """
    widest_vectors()
    if not any_held(problem, w):
        return
    for first in range(0, used, GROUP):
        for l in range(first, first + GROUP):
            lane = lane_of(problem, w, l)
            half_below, half_above = margins(lane, middle(lane))
            end_below, end_above = margins(lane, lane.y1)
            angle = lane.h * lane.swing
            dips = may_dip(lane.below, half_below, end_below, angle)
            dips |= may_dip(lane.above, half_above, end_above, angle)
            is_glanced = (lane.mode == HELD) & (angle <= GLANCED)
            due = 1.0 if is_glanced & dips else 0.0
            leaves = lane.leaves
            watched = lane.watched
            lane.below1 = end_below
            lane.above1 = end_above
            lane.leaves = due if due > leaves else leaves
            lane.watched = watched + due
    for l in range(used):
        lane = lane_of(problem, w, l)
        is_long = lane.mode == HELD and lane.h * lane.swing > GLANCED
        if is_long and may_fall_within(problem, w, l):
            lane.leaves = 1.0
            lane.watched += 1.0


@njit(**FUSED)
def may_fall_within(problem, w, l):
    """Return whether the plane may let the spin go within a long step of lane ``l``.

    What the torque lacks of its limits is followed as `inside.follow` does with forces;
    between two looks it falls by less than an eighth of its largest second difference.
    """
    apart()
    widest_vectors()
    lane = lane_of(problem, w, l)
    beyond = rates_beyond(lane)
    ends = ends_of(lane)
    constants = lane.constants
    lever = lane.lever
    pieces = pieces_of(lane)
    looks = int(pieces) + 1
    seen_below = seen_above = NEVER, -NEVER, 0.0, 0.0, 0.0
    for first in range(0, looks, GROUP):
        # Several looks side by side, in the columns of the first lanes.
        for k in range(GROUP):
            y = between(ends, beyond, (first + k) / pieces)
            below, above = margins_of(problem.model, y, constants, lever)
            place = lane_of(problem, w, k)
            place.seen_first = below
            place.seen_second = above
        for k in range(min(GROUP, looks - first)):
            place = lane_of(problem, w, k)
            seen_below = followed(seen_below, place.seen_first, first + k)
            seen_above = followed(seen_above, place.seen_second, first + k)
    angle = lane.h * lane.swing
    square = angle * angle
    sixth = square * (square * square)
    share = min(1.0, FOLLOWED + INTERPOLATED * sixth)
    least = NEVER
    for low, top, bend, _, _ in (seen_below, seen_above):
        least = min(least, low - share * (top - low) - 0.125 * bend)
    return least <= 0.0


@scalar
def followed(seen, value, k):
    """Return what is seen of a function with its next value, which has the number k.

    It is the least and the largest value, the largest second difference, and the last
    value and the last difference.
    """
    low, top, bend, before, rise = seen
    step = value - before
    bent = abs(step - rise) if k > 1 else 0.0
    return min(low, value), max(top, value), max(bend, bent), value, step


@scalar
def may_give_way(lane):
    """Return whether the plane may let the spin go in the step, from a closer look.

    The torque is looked at with its rates, on either side by itself: what it lacks of
    the nearer limit has a kink.
    """
    ahead = DIFFERENCE / lane.swing
    angle = lane.h * lane.swing
    first_below, first_above = margins(lane, moved(lane.y, lane.f, ahead))
    last_below, last_above = margins(lane, moved(lane.y1, lane.f1, ahead))
    half_below, half_above = margins(lane, middle(lane))
    start = Point(0.0, lane.below, (first_below - lane.below) / ahead)
    end = Point(lane.h, lane.below1, (last_below - lane.below1) / ahead)
    if falls(start, half_below, end, angle):
        return True
    start = Point(0.0, lane.above, (first_above - lane.above) / ahead)
    end = Point(lane.h, lane.above1, (last_above - lane.above1) / ahead)
    return falls(start, half_above, end, angle)


@njit(**INNER)
def store(lane):
    """Set the results of rests, and of the torque."""
    if lane.mode == HELD:
        lane.held_time += lane.t_ended - lane.t_hold
    if lane.t_held < 0.0:
        lane.t_held = nan
    # Zero and not -0 for a run without a torque.
    lane.pivot_work = 0.0 - lane.problem.model.pivot_work(lane.y1) / lane.energy0


@njit(**INNER)
def prepare(lane):
    """Set the sense of the spin at launch."""
    lane.t_held = -1.0
    lane.left_zero = -1.0
    settle(lane, lane.y, lane.problem.model.spin(lane.y), 0.0)


def launching(base_launch: Callable[..., None]) -> Callable[..., None]:
    """Return `ModeSet.launch` of a model with the torque, from that without it."""

    @njit(**INNER)
    def launch(lane):
        if lane.n0 == 0.0 and lane.mode == PIVOTING:
            # A tap leaves zero here, and may be back within the first step.
            give_slack(lane, lane.y)
        base_launch(lane)
        if lane.mode == SLIDING:
            lane.n0 = lane.n1

    return launch


def observing(base_observe: Callable[..., Any]) -> Callable[..., Any]:
    """Return `ModeSet.observe` of a model with the torque, from that without it."""

    @njit(**FUSED)
    def observe(model, y, slip, constants, mu):
        energy, normal, tangential, torque = base_observe(model, y, slip, constants, mu)
        if slip.speed == 0.0:
            torque, _, _ = model.pivot(y, constants)
        return energy, normal, tangential, torque

    return observe


@njit(**INNER)
def side_after(lane):
    """Return on which side of zero the spin goes on from the end of the step."""
    if lane.mode != SLIDING:
        return lane.sense
    return 1.0 if lane.n1 > 0.0 else -1.0


@njit(**INNER)
def gone_over(lane, t, status, move, goes_on, reversals_recorded):
    """Return status and move of a lane whose spin goes on in another way.

    A spin that returns to its side has not reversed.
    """
    side = side_after(lane)
    if status != OK or side * lane.sign >= 0.0 or lane.arm > 0.0:
        return status, move
    if not goes_on:
        return OK, REVERSED
    lane.sign = side
    note_energies(lane)
    runs.note_zero(lane, t, reversals_recorded)
    return status, move


def sliding_and_pivoting(sliding: Mode) -> Mode:
    """Return the mode of a body that slides with the torque, from that without it."""
    change_sliding = sliding.change

    @njit(**INNER)
    def change(lane, status, move, goes_on, reversals_recorded):
        apart()
        t = lane.t + (lane.h - lane.t_low)
        ends = status == OK and lane.slip1.speed == 0.0
        status, move = change_sliding(lane, status, move, goes_on, reversals_recorded)
        if not ends:
            return status, move
        if lane.mode == PIVOTING and lane.left_zero > lane.steps:
            lane.limit1 = at_zero(lane.limit1)
        return gone_over(lane, t, status, move, goes_on, reversals_recorded)

    return replace(sliding, change=change)


def pivoting_modes(rolling: Mode) -> tuple[Mode, Mode]:
    """Return the modes of a body with the torque that rolls: PIVOTING and HELD.

    ``rolling`` is the mode of the body without it.
    """
    rolling_limit = rolling.limit
    change_rolling = rolling.change

    @scalar
    def limit(lane, h, y, f):
        return both_of(rolling_limit(lane, h, y, f), turn_point(lane, h, y, f))

    @scalar
    def limit_held(lane, h, y, f):
        return both_of(rolling_limit(lane, h, y, f), held_point(lane, h, y, f))

    @njit(**INNER)
    def slide(lane, t, status, move, goes_on, reversals_recorded):
        was_held = lane.mode == HELD
        status, move = change_rolling(lane, status, move, goes_on, reversals_recorded)
        if was_held and lane.mode != HELD:
            release(lane, t)
        return status, move

    @njit(**INNER)
    def change(lane, status, move, goes_on, reversals_recorded):
        apart()
        t = lane.t + (lane.h - lane.t_low)
        is_at_zero = False
        mode = lane.mode
        if status == AT_LIMIT:
            other = rolling_limit(lane, lane.h, lane.y1, lane.f1)
            is_at_zero = distance_from_zero(lane) <= other.value
        if not is_at_zero:
            status, move = slide(lane, t, status, move, goes_on, reversals_recorded)
            if lane.mode != mode:
                return gone_over(lane, t, status, move, goes_on, reversals_recorded)
            return status, move
        leave_zero(lane, t)
        status = OK
        if lane.limit1.value <= 0.0:
            # The force has jumped with the torque, beyond what friction can give.
            status, move = slide(lane, t, AT_LIMIT, move, goes_on, reversals_recorded)
        return gone_over(lane, t, status, move, goes_on, reversals_recorded)

    return (
        Mode(PIVOTING, limit, change, rolling.margin, observe_limit=note_pull),
        Mode(
            HELD,
            limit_held,
            change,
            observe_limit=observe_held,
            gives_way=may_give_way,
        ),
    )
