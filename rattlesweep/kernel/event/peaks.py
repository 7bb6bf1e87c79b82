"""Peaks and marks within a step, found with shorter steps of the method."""

# mypy: disable-error-code="no-any-return"

from numba import njit

from rattlesweep.compiling.intrinsics import INNER, apart
from rattlesweep.kernel.event.zeros import (
    FIRST_EXTREME,
    FIRST_MARK,
    HOLD,
    N_FUNCTIONS,
    SPIN,
    _polish,
    _secant,
)
from rattlesweep.kernel.look.extremes import (
    keep_of,
    note_contact,
    peak_of,
    scale_of,
    tried_of,
)
from rattlesweep.kernel.look.marks import value_of
from rattlesweep.kernel.look.put_off import (
    copy_start,
    has_kept,
    keep_step,
    kept_of,
)
from rattlesweep.kernel.runs import keep_end, restore_end
from rattlesweep.kernel.state.fields import (
    PEAK,
    PUT_OFF,
    RETAKE,
    STEP,
    Number,
    Point,
)
from rattlesweep.kernel.state.lane import Lane, lane_of
from rattlesweep.kernel.state.ways import steps_in_rack
from rattlesweep.physics.full import scalar

# Newton's method ends where a peak is higher than the point tried by less than this
# share, which is added.  If it ends earlier, up to the second share is added.
NO_RISE = 1e-9
SMALL_RISE = 1e-5
MAX_PEAK_TRIES = 8.0


class PeakFields:
    """The search for extremes and marks in a step that is to be taken."""

    bend: Number  # curvature at the peak that is searched
    move: Number  # what happens after the search


# Extremes.


@njit(**INNER)
def search_peaks(problem, traits, w, l):  # type: ignore[no-untyped-def]
    """Make one move of the search for extremes in a step that is to be taken.

    The first move follows the try of that step.  Its end is kept, as the tries of the
    search overwrite it.  A lane that slides tries the step again instead.
    """
    lane = lane_of(problem, w, l)
    if lane.search == PEAK:
        if _try_on(lane):
            return HOLD
        if steps_in_rack(lane):
            lane.search = RETAKE
            lane.h_next = lane.full.h
            return HOLD
        restore_end(problem, traits, w, l)
        lane.searched += 1.0
    elif lane.search == RETAKE:
        lane.searched += 1.0
    else:
        lane.searched = FIRST_EXTREME
        lane.full = Point(lane.h, 0.0, 0.0)
        lane.full_next = lane.h_next
        if _bracket_next(lane):
            keep_end(problem, traits, w, l)
            return HOLD
    if _bracket_next(lane):
        return HOLD
    lane.h_next = lane.full_next
    lane.searched = SPIN
    lane.search = STEP
    return int(lane.move)


@njit(**INNER)
def begin_kept(problem, traits, w, l, status, move):  # type: ignore[no-untyped-def]
    """Begin the search of the steps kept on a lane whose run ends.

    Return whether there are any; then the run ends with the same status and move once
    they are searched (`look.put_off`).  Its end is kept meanwhile.
    """
    apart()
    lane = lane_of(problem, w, l)
    if lane.ends > 0.0:
        return False
    if lane.accept > 0.0:
        keep_step(problem, traits, w, l)
    if not has_kept(lane):
        return False
    note_contact(lane)
    lane.searched = FIRST_EXTREME
    keep_end(problem, traits, w, l)
    if not _begin_next_kept(problem, traits, w, l):
        return False
    lane.ends = 1.0
    lane.end_status = status
    lane.move = move
    lane.accept = 0.0
    return True


@njit(**INNER)
def search_kept(problem, traits, w, l):  # type: ignore[no-untyped-def]
    """Make one move of the search of the steps kept; return whether it goes on."""
    lane = lane_of(problem, w, l)
    lane.accept = 0.0
    if _climb(lane):
        return True
    lane.searched += 1.0
    if _begin_next_kept(problem, traits, w, l):
        return True
    restore_end(problem, traits, w, l)
    return False


@njit(**INNER)
def _begin_next_kept(problem, traits, w, l):  # type: ignore[no-untyped-def]
    """Go to the start of the next step kept, and set the first point to try in it.

    Return whether there is one.
    """
    apart()
    lane = lane_of(problem, w, l)
    while lane.searched < FIRST_EXTREME + 2.0:
        k = int(lane.searched) - FIRST_EXTREME
        kept = kept_of(lane, k)
        if kept.h > 0.0:
            copy_start(problem, traits, w, l, k, False)
            lane.search = PUT_OFF
            lane.tries = 0.0
            lane.bend = kept.bend
            lane.full = Point(lane.ratio_step if k == 0 else lane.lift_step, 0.0, 0.0)
            lane.h_next = kept.h
            return True
        lane.searched += 1.0
    return False


@njit(**INNER)
def _try_on(lane: Lane) -> bool:
    """Let the point just tried count; return whether there is a next one."""
    if lane.searched >= FIRST_MARK:
        return _try_mark(lane)
    return _climb(lane)


@njit(**INNER)
def _bracket_next(lane: Lane) -> bool:
    """Set the first point to try for the next function that is searched.

    Return whether there is one.
    """
    while lane.searched < N_FUNCTIONS:
        if lane.searched >= FIRST_MARK:
            if _bracket_mark(lane):
                return True
        elif _bracket_peak(lane):
            return True
        lane.searched += 1.0
    return False


@njit(**INNER)
def _bracket_peak(lane: Lane) -> bool:
    """Set the first point to try if the step may hold a new extreme."""
    peak = peak_of(int(lane.searched) - FIRST_EXTREME, lane)
    if not 0.0 < peak.h < lane.full.h:
        return False
    lane.search = PEAK
    lane.tries = 0.0
    lane.bend = peak.bend
    lane.h_next = peak.h
    return True


@njit(**INNER)
def _climb(lane: Lane) -> bool:
    """Keep the point just tried; return whether there is a next one, nearer the top."""
    apart()
    k = int(lane.searched) - FIRST_EXTREME
    tried = tried_of(k, lane)
    if lane.tries == 0.0:
        lane.bend /= scale_of(k, lane)
    rise = _rise_to_top(lane, tried)
    value = tried.value
    goes_on = rise > NO_RISE * abs(value) and _approach_top(lane, tried)
    # At the first try the bend is a guess, so that it may say too much.
    if not goes_on and rise < SMALL_RISE * abs(value):
        value += rise
    keep_of(k, lane, value)
    return goes_on


@njit(**INNER)
def _rise_to_top(lane: Lane, tried: Point) -> float:
    """Return by how much the peak is higher than the point just tried.

    The rates at two points tell how the function bends.
    """
    before = lane.lo
    if lane.tries > 0.0:
        bend = (tried.rate - before.rate) / (tried.h - before.h)
        lane.bend = min(bend, 0.1 * lane.bend)
    lane.lo = tried
    return -0.5 * tried.rate * tried.rate / lane.bend


@njit(**INNER)
def _approach_top(lane: Lane, tried: Point) -> bool:
    """Set the next point to try by Newton's method; return whether there is one."""
    lane.tries += 1.0
    h = tried.h - tried.rate / lane.bend
    lane.h_next = h
    inside = 0.0 < h < lane.full.h
    moves = abs(h - tried.h) > 1e-12 * lane.full.h
    return inside and moves and lane.tries < MAX_PEAK_TRIES


# Marks.


@scalar
def mark_points(lane, k):  # type: ignore[no-untyped-def]
    """Return the mark ``k`` at both ends of the step just tried."""
    value, rate = value_of(k, lane.n0, lane.rate0, lane.n_launch)
    end, end_rate = value_of(k, lane.n1, lane.rate1, lane.n_launch)
    return Point(0.0, value, rate), Point(lane.h, end, end_rate)


@njit(**INNER)
def _bracket_mark(lane: Lane) -> bool:
    """Set the first point to try if the step may hold the mark that is searched."""
    k = int(lane.searched) - FIRST_MARK
    if (int(lane.marks_due) >> k) % 2 == 0:
        return False
    lane.lo, lane.hi = mark_points(lane, k)
    lane.tries = 0.0
    if _look_at_dip(lane):
        return True
    if lane.hi.value > 0.0:
        # The step ends earlier than the one that was observed.
        return False
    lane.search = PEAK
    lane.h_next = _secant(lane)
    return True


@njit(**INNER)
def _look_at_dip(lane: Lane) -> bool:
    """Set a point to try where the mark may be negative, before the point tried."""
    dip = lane.mark_peak
    lane.looks = 0.0
    if not 0.0 < dip.h < lane.h:
        return False
    lane.looks = 1.0
    lane.tries = 0.0
    lane.bend = -dip.bend
    lane.search = PEAK
    lane.h_next = dip.h
    return True


@njit(**INNER)
def _try_mark(lane: Lane) -> bool:
    """Narrow LO..HI by the point just tried; return whether there is a next one.

    Note the mark once it is found.
    """
    k = int(lane.searched) - FIRST_MARK
    _, tried = mark_points(lane, k)
    if lane.looks > 0.0:
        return _look_on(lane, tried)
    if _polish(lane, tried) == HOLD:
        return True
    lane.mark_found = k + 1.0
    lane.t_mark = lane.t + (lane.h - lane.t_low)
    return False


@njit(**INNER)
def _look_on(lane: Lane, tried: Point) -> bool:
    """Set the next point after one at a dip; return whether there is one."""
    if tried.value <= 0.0:
        lane.hi = tried
        # The step just tried may itself have a dip.
        if not _look_at_dip(lane):
            lane.tries = 0.0
            lane.h_next = _secant(lane)
        return True
    before = lane.end
    lane.end = tried
    if lane.tries > 0.0:
        bend = (tried.rate - before.rate) / (tried.h - before.h)
        lane.bend = max(bend, 0.1 * lane.bend)
    least = tried.value - 0.5 * tried.rate * tried.rate / lane.bend
    h = tried.h - tried.rate / lane.bend
    lane.tries += 1.0
    is_near = least <= SMALL_RISE * tried.value and lane.tries < MAX_PEAK_TRIES
    if is_near and 0.0 < h < lane.full.h and h != tried.h:
        lane.h_next = h
        return True
    # There is no zero in this dip.
    lane.looks = 0.0
    if lane.hi.value > 0.0 or lane.hi.h < tried.h:
        return False
    lane.lo = tried
    lane.tries = 0.0
    lane.h_next = _secant(lane)
    return True
