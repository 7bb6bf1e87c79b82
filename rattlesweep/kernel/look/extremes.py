"""Extremes: functions of the state whose largest value is kept, between steps too.

An extreme is a record.  A further one is an entry of :data:`EXTREMES`, with its fields
and its table; an observer in `event.looks`, which says which steps may hold it; and its
fields of the step tried in `fields.END_OF_STEP`.  Its place within an accepted step is
found with shorter steps of the method (`event.peaks`).  The search changes nothing else
of the run.
"""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from numba import njit

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import INNER, choice, widest_vectors
from rattlesweep.kernel.state.fields import NEVER, Number, Peak, Point
from rattlesweep.kernel.state.lane import lane_of, recorded
from rattlesweep.physics.full import TINY, scalar

# Words of `record` for which extremes are searched, and their bits in what is wanted.
OF_EXTREMES = "contact", "reversals"
CONTACT, REVERSALS = 1, 2


class ExtremeFields:
    """The functions that are searched for extremes, and their extremes so far."""

    # The contact forces.
    ratio0: Point  # tangential over normal force, at the start of the step
    ratio1: Point  # the same at its end
    lift0: Point  # normal force with a minus sign
    lift1: Point
    ratio_peak: Peak  # of the step tried, as interpolated (`look.inside`)
    lift_peak: Peak
    ratio_max: Number  # largest ratio so far
    normal_min: Number  # least normal force so far

    # The spin since the last reversal.
    turn_peak: Peak  # of the step tried, as interpolated
    n_after: Number  # largest modulus of the spin since the last reversal
    n_peak: Number  # largest modulus found within the step


@dataclass(frozen=True)
class ExtremeRecord:
    """Extremes, over runs.  Those of the spin are in `runs.RunRecord.reversals`."""

    # Largest ratio of the contact forces, least normal force.
    contact: Annotated[Floats, (1, 2)]

    @property
    def contact_ratio_max(self) -> Floats:
        """Return the largest ratio of the forces."""
        return self.contact[:, 0, 0]

    @property
    def contact_normal_min(self) -> Floats:
        """Return the least normal force."""
        return self.contact[:, 0, 1]


class Extreme(NamedTuple):
    """A function of the state, as compiled functions of a lane."""

    # tried(lane): a Point of the function at the end of the step just tried
    tried: Callable[..., Any]
    # peak(lane): what may be its highest Peak within the step, if that may exceed the
    # largest value so far; else a Peak with h = 0
    peak: Callable[..., Any]
    # scale(lane): what the bend of this peak is divided by at the first point tried, to
    # be one of the function.  (That of the ratio is a bend of what the tangential force
    # exceeds, see `looks.observe_contact`.)
    scale: Callable[..., Any]
    # keep(lane, value): keep a largest value within the step
    keep: Callable[..., None]


# Extremes at the ends of steps.


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
def wanted(recording):
    """Return which extremes are recorded, as bits."""
    bits = CONTACT if recorded(recording.contact) else 0
    return bits + (REVERSALS if recorded(recording.reversals) else 0)


@njit(**INNER)
def advance(problem, w, recording):
    """Let the ends of the steps that are taken count, and be the starts of the next.

    The spin of a turn is noted by `runs.note_turn`.
    """
    if recorded(recording.contact):
        _advance_contact(problem, w)


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
        rises = moves & (after.value > most)
        falls = moves & (-lift_after.value < least)
        lane.ratio_max = after.value if rises else most
        lane.normal_min = -lift_after.value if falls else least
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


@njit(**INNER)
def store(lane, run, recording):
    """Store the extremes of a run that has ended."""
    if recorded(recording.contact):
        note_contact(lane)
        recording.contact[run, 0, 0] = lane.ratio_max
        recording.contact[run, 0, 1] = lane.normal_min


# Extremes within steps.


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

tried_of, peak_of, scale_of, keep_of = (
    choice(dict(enumerate(functions)), inline=True)
    for functions in zip(*EXTREMES, strict=True)
)
