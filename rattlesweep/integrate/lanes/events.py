"""Search for the first zero of the spin within a step.

The spin grazes zero before it reverses, so a pair of zeros often lies inside one step.
A step that may contain a zero is held: the lane goes back to its start and tries
shorter steps from there, each as accurate as the method.  The step is cut into pieces
that are short compared with a swing of the spin.  A piece whose ends differ in sign has
a zero.  In a piece where the spin falls at the start and rises at the end, the minimum
is searched until a bound shows that it is positive or a negative value is found.
Newton's method then finds the zero in its bracket.  The step that is finally accepted
is the one first tried, unless it ends at a zero.
"""

# mypy: disable-error-code="no-any-return, no-untyped-def"
from math import ceil
from typing import Any

from numba import njit

from rattlesweep.integrate.lanes.lane import INNER, Point
from rattlesweep.physics.full import scalar

# Modes of a lane.
STEP, SCAN, MINIMUM, ROOT, REDO, PEAK, RETAKE = 0, 1, 2, 3, 4, 5, 6
# Moves of the search: go back and try ``lane.h_next``, accept the step just tried, or
# accept it as a step that ends at a zero.
HOLD, TAKE, REVERSED = 0, 1, 2
PIECE_ANGLE = 0.5  # longest piece, in radians of the fastest swing
# Steps are at most a dozen radians, or so much longer than a swing that no search can
# succeed.
MAX_PIECES, MAX_TRIES = 4096.0, 60
_CLEAR, _DIP, _ZERO = 0, 1, 2
# A further move: the end of the next piece is known already.  It replaces recursion,
# which makes a cached kernel crash when it is loaded, even if two functions share it
# (Numba 0.68).
_KNOWN = 3


@njit(**INNER)
def _judge(start: Point, end: Point, sign: float) -> int:
    """Return whether a piece can hold a zero; times ``sign``, the spin is positive at
    its start.
    """
    if sign * end.n <= 0.0:
        return _ZERO
    down, up = sign * start.rate, sign * end.rate
    if not (down < 0.0 and up > 0.0):
        return _CLEAR
    # A convex curve lies above its tangents, and these meet at this height.
    n0, n1 = sign * start.n, sign * end.n
    meet = (n0 * up - n1 * down + (end.h - start.h) * down * up) / (up - down)
    return _CLEAR if meet > 0.0 else _DIP


@scalar
def may_reverse(h, n0, n1, rate1, rate_max):
    """Return whether a step of size ``h`` between spins ``n0`` and ``n1`` may hold a
    zero.
    """
    # To reach zero and come back, the spin needs a path of |n0| + |n1|, at most h *
    # max|rate|; twice the largest recent rate is a safe bound.
    recent, now = 0.9 * rate_max, abs(rate1)
    recent = now if now > recent else recent
    return (abs(n0) + abs(n1) < 2.0 * h * recent) | (n0 * n1 <= 0.0)


@njit(**INNER)
def search(lane: Any, tried: Point) -> int:
    """Make one move of the search, after each step tried on the lane."""
    if lane.mode == REDO:
        lane.mode, lane.h_next = STEP, lane.full_next
        return TAKE
    if lane.mode == ROOT:
        return _polish(lane, tried)
    if lane.mode == MINIMUM:
        return _close_in(lane, tried)
    if lane.mode == STEP:
        lane.full, lane.full_next = tried, lane.h_next
        lane.pieces = min(
            MAX_PIECES, max(1.0, ceil(tried.h * lane.swing / PIECE_ANGLE))
        )
        lane.piece = 1.0
        lane.lo = Point(0.0, lane.n0, lane.rate0)
        lane.mode = SCAN
        if lane.pieces > 1.0:
            lane.h_next = tried.h / lane.pieces
            return HOLD
    # SCAN: the end of a piece.
    lane.end = tried
    return _scan(lane, tried.h)


@njit(**INNER)
def search_on(lane: Any, h: float) -> int:
    """Continue the search after the zero at ``h`` in the same step, for one in the
    other sense.
    """
    lane.sign = -lane.sign
    lane.mode = SCAN
    if lane.beyond.h == lane.end.h:
        move = _next_piece(lane, h)
        return _scan(lane, h) if move == _KNOWN else move
    lane.lo = lane.beyond
    return _scan(lane, h)


@njit(**INNER)
def _scan(lane: Any, tried: float) -> int:
    """Decide on the piece from LO to END, and on later ones as long as their ends are
    known.
    """
    while True:
        verdict = _judge(lane.lo, lane.end, lane.sign)
        if verdict != _CLEAR:
            lane.hi = lane.end
            if verdict == _ZERO:
                return _start_root(lane)
            lane.mode, lane.tries = MINIMUM, 0.0
            lane.h_next = _towards_extremum(lane)
            return HOLD
        move = _next_piece(lane, tried)
        if move != _KNOWN:
            return move


@njit(**INNER)
def _next_piece(lane: Any, tried: float) -> int:
    """Go to the piece after END: try its end, or take the step, or return _KNOWN with
    END set.
    """
    lane.lo = lane.end
    lane.piece += 1.0
    lane.mode = SCAN
    if lane.piece < lane.pieces:
        lane.h_next = lane.full.h * (lane.piece / lane.pieces)
        return HOLD
    if lane.piece == lane.pieces:
        # The end of the last piece is the end of the step, known from its first try.
        lane.end = lane.full
        return _KNOWN
    if tried == lane.full.h:
        lane.mode, lane.h_next = STEP, lane.full_next
        return TAKE
    lane.mode, lane.h_next = REDO, lane.full.h
    return HOLD


@njit(**INNER)
def _close_in(lane: Any, tried: Point) -> int:
    """Narrow the bracket LO..HI of a minimum until the sign of the spin there is
    certain.
    """
    if lane.sign * tried.n <= 0.0:
        lane.hi = tried
        return _start_root(lane)
    if lane.sign * tried.rate < 0.0:
        lane.lo = tried
    else:
        lane.hi = tried
    lane.tries += 1.0
    verdict = _judge(lane.lo, lane.hi, lane.sign)
    wide = lane.hi.h - lane.lo.h > 1e-12 * lane.full.h
    if verdict == _DIP and wide and lane.tries < MAX_TRIES:
        lane.h_next = _towards_extremum(lane)
        return HOLD
    # The ends of the bracket are nearer to the minimum than a last try in its middle.
    lowest = min(lane.sign * lane.lo.n, lane.sign * lane.hi.n)
    if lowest < lane.fuzz * lane.rate_max / lane.swing:
        lane.near += 1.0
    # There is no zero in this piece.
    move = _next_piece(lane, tried.h)
    return _scan(lane, tried.h) if move == _KNOWN else move


@njit(**INNER)
def _towards_extremum(lane: Any) -> float:
    """Return the next point to try in LO..HI: by a secant of the rate, every third time
    halfway.
    """
    lo, hi = lane.lo, lane.hi
    share = 0.5 if lane.tries % 3.0 == 2.0 else lo.rate / (lo.rate - hi.rate)
    return lo.h + min(0.98, max(0.02, share)) * (hi.h - lo.h)


@njit(**INNER)
def _start_root(lane: Any) -> int:
    """Start Newton's method for the zero between LO and HI, with a secant."""
    lo, hi = lane.lo, lane.hi
    lane.beyond, lane.mode, lane.tries = hi, ROOT, 0.0
    lane.h_next = lo.h + lo.n / (lo.n - hi.n) * (hi.h - lo.h)
    return HOLD


@njit(**INNER)
def _polish(lane: Any, tried: Point) -> int:
    """Take a step of Newton's method in the bracket LO..HI, until steps are rounding
    errors.
    """
    h, n, rate = tried
    if lane.sign * n > 0.0:
        lane.lo = tried
    else:
        lane.hi = tried
    lane.tries += 1.0
    lo, hi, full = lane.lo.h, lane.hi.h, lane.full.h
    guess = h - n / rate if rate != 0.0 else lo
    if not (guess > lo and guess < hi) or lane.tries % 8.0 == 7.0:
        guess = lo + 0.5 * (hi - lo)
        newton = abs(n / rate) if rate != 0.0 else full
    else:
        newton = abs(guess - h)
    if (
        n == 0.0
        or newton < 1e-14 * full
        or hi - lo < 1e-15 * full
        or lane.tries >= MAX_TRIES
    ):
        # Beyond the zero the spin goes rate^2 / (2 n'') deep, with n'' at most SWING *
        # RATE_MAX.
        if rate * rate < 2.0 * lane.fuzz * lane.rate_max**2:
            lane.near += 1.0
        return REVERSED
    lane.h_next = guess
    return HOLD


# Functions whose extremes are searched.
RATIO, LIFT, SPIN = 0, 1, 2
N_PEAKS = 3
# An extreme is taken from the cubic through both ends of its bracket if it is higher
# than them by less than this share; the cubic is then right to a tenth of that.
RISE = 2e-4
# Share of its height above the ends that the cubic may be wrong in a whole step.
SLACK = 0.2
FINE = 1e-5  # smallest relative excess over the largest value so far that counts
MAX_CLIMBS = 12.0


@scalar
def height(start, end):
    """Return the largest value between two points, of which the function rises and falls."""
    length = end.h - start.h
    rise, fall = length * start.rate, length * end.rate
    step = end.n - start.n
    # The cubic through both ends, at the place where the secant of the rates is zero.
    share = rise / (rise - fall)
    cubic = rise + fall - 2.0 * step
    return start.n + share * (rise + share * (step - rise - cubic + share * cubic))


@scalar
def may_peak(start, end, largest):
    """Return whether a function may exceed its largest value so far between two points."""
    top = height(start, end)
    ends = end.n if end.n > start.n else start.n
    peak = (start.rate > 0.0) & (end.rate < 0.0)
    return peak & (top + SLACK * (top - ends) > largest + FINE * abs(largest))


@scalar
def spin_points(lane):
    """Return the modulus of the spin at both ends of the step; the first may be negative."""
    side = 1.0 if lane.n1 > 0.0 else -1.0
    start = Point(0.0, side * lane.n0, side * lane.rate0)
    return start, Point(lane.h, side * lane.n1, side * lane.rate1)


@scalar
def least_peak(lane):
    """Return the modulus that the spin must exceed for a new largest one of its turn."""
    # After a zero, the turn counts once the spin is far on the other side.
    after, far = lane.n_after, lane.far
    within = after if lane.reversals > 0.0 else 1e290
    return far if lane.t_pending >= 0.0 else within


@njit(**INNER)
def climb(lane: Any) -> int:
    """Make one move of the search for extremes in a step that is to be taken.

    The first move is made right after the step was tried.
    """
    if lane.mode == PEAK:
        if lane.climbed == RATIO:
            tried = lane.ratio1
        elif lane.climbed == LIFT:
            tried = lane.lift1
        else:
            _, tried = spin_points(lane)
        if tried.rate > 0.0:
            lane.lo = tried
        else:
            lane.hi = tried
        lane.tries += 1.0
        if _goes_on(lane):
            return HOLD
        # The step to take is tried again, since its end has been overwritten.
        lane.mode = RETAKE
        lane.h_next = lane.taken
        return HOLD
    if lane.mode == RETAKE:
        lane.climbed += 1.0
        lane.h_next = lane.taken_next
    else:
        lane.climbed = 0.0
        lane.taken = lane.h
        lane.taken_next = lane.h_next
    while lane.climbed < N_PEAKS:
        if _starts(lane) and _goes_on(lane):
            return HOLD
        lane.climbed += 1.0
    lane.mode = STEP
    return int(lane.move)


@njit(**INNER)
def _starts(lane: Any) -> bool:
    """Return whether the function may have an extreme in the step, and set its bracket."""
    if lane.climbed == RATIO:
        lane.lo, lane.hi = lane.ratio0, lane.ratio1
        largest = lane.ratio_max
        possible = lane.lift0.n < 0.0 and lane.lift1.n < 0.0
    elif lane.climbed == LIFT:
        lane.lo, lane.hi = lane.lift0, lane.lift1
        largest = -lane.normal_min
        possible = True
    else:
        lane.lo, lane.hi = spin_points(lane)
        largest = least_peak(lane)
        possible = lane.lo.n > 0.0
    lane.tries = 0.0
    return possible and may_peak(lane.lo, lane.hi, largest)


@njit(**INNER)
def _goes_on(lane: Any) -> bool:
    """Set the next point to try, or note the extreme between LO and HI if it is known."""
    top = height(lane.lo, lane.hi)
    ends = max(lane.lo.n, lane.hi.n)
    if top - ends > RISE * abs(top) and lane.tries < MAX_CLIMBS:
        lane.mode = PEAK
        lane.h_next = _towards_extremum(lane)
        return True
    top = max(top, ends)
    if lane.climbed == RATIO:
        lane.ratio_max = max(lane.ratio_max, top)
    elif lane.climbed == LIFT:
        lane.normal_min = min(lane.normal_min, -top)
    else:
        lane.n_top = max(lane.n_top, top)
    return False
