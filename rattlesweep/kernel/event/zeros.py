"""Search for zeros and extremes of functions of the state within a step.

The spin grazes zero before it reverses, so a pair of zeros often lies inside one step.
A step that may contain a zero is held: the lane goes back to its start and tries
shorter steps from there, each as accurate as the method.  The step is cut into pieces
that are short compared with a swing of the spin.  A piece whose ends differ in sign has
a zero.  In a piece where the spin falls at the start and rises at the end, the minimum
is searched until a bound shows that it is positive or a negative value is found.
Newton's method then finds the zero in its bracket.  The step that is finally accepted
is the one first tried, unless it ends at a zero.

Any smooth function of the state can be searched: all that a search needs is a
:class:`~rattlesweep.kernel.state.fields.Point` of it at both ends of the step, with
its rate or a difference along the flow.  The functions are

- the limit of the mode in which the lane is (`mode.modes`), whose first zero ends the
  step; or ``Model.limit``, which is positive where the model holds: its first zero ends
  the run there with the status ``LIMIT``, and ``Outcome.y_end`` is the state from which
  another model goes on;
- the spin, whose zeros are reversals;
- what the spin lacks of a modulus that is awaited, as zeros of a tap count only after
  it has been reached, and a turn is complete there.  Only the order of this and of
  zeros matters, so it is enough to know the piece or a point beyond;
- those of `look.extremes`, of which the largest value is searched, once it is known
  how the step ends;
- marks (`look.marks`), whose first zeros are searched then, too.
"""

# mypy: disable-error-code="no-any-return"
from math import ceil, floor, sqrt

from numba import njit

from rattlesweep.compiling.intrinsics import INNER
from rattlesweep.kernel.look.extremes import EXTREMES
from rattlesweep.kernel.look.marks import MARKS
from rattlesweep.kernel.state.fields import (
    MINIMUM,
    NEVER,
    REDO,
    ROOT,
    SCAN,
    STEP,
    Number,
    Point,
)
from rattlesweep.kernel.state.lane import Lane
from rattlesweep.kernel.state.ways import counts_zeros
from rattlesweep.physics.full import scalar

# The functions, in the order in which they are searched.
SPIN, LIMIT, FAR, FIRST_EXTREME = range(4)
FIRST_MARK = FIRST_EXTREME + len(EXTREMES)
N_FUNCTIONS = FIRST_MARK + len(MARKS)
# Moves of the search: go back and try ``lane.h_next``, accept the step just tried,
# accept it as a step that ends at a zero; or the spin is as far as awaited in the step,
# and the search goes on behind that.
HOLD, TAKE, REVERSED, ARRIVED = 0, 1, 2, 4
PIECE_ANGLE = 0.5  # longest piece, in radians of the fastest swing
# Where the awaited modulus is small beside the swing, pieces are shorter: no piece may
# have a zero and, between its ends, a spin that is far.
SHORTEST_PIECE = 0.05
# Steps are at most a dozen radians, or so much longer than a swing that no search can
# succeed.
MAX_PIECES = 4096.0
MAX_TRIES = 60
# Share of a piece in which a limit that rises from zero has hardly left it.
NEAR_START = 1e-3
_CLEAR, _DIP, _ZERO = 0, 1, 2
# A further move: the end of the next piece is known already.  It replaces recursion,
# which makes a cached kernel crash when it is loaded, even if two functions share it
# (Numba 0.68).
_KNOWN = 3


class SearchFields:
    """The search within a held step, besides its state."""

    searched: Number  # which function: SPIN, LIMIT, ...
    pieces: Number
    piece: Number  # index of the present one
    tries: Number
    near: Number  # extrema of the spin whose sign the method could not decide
    full: Point  # end of the step as first tried
    full_next: Number  # size of the step after it
    lo: Point  # bracket within the piece
    end: Point  # end of the piece
    hi: Point
    beyond: Point  # the point after the bracketed zero


# Zeros.


@njit(**INNER)
def _sign(lane: Lane) -> float:
    """Return the sign of the function at the start of the step."""
    return lane.sign if lane.searched == SPIN else 1.0


@njit(**INNER)
def _judge(start: Point, end: Point, sign: float) -> int:
    """Return whether a piece, positive at its start times ``sign``, can hold a zero."""
    if sign * end.value <= 0.0:
        return _ZERO
    down = sign * start.rate
    up = sign * end.rate
    if not (down < 0.0 and up > 0.0):
        return _CLEAR
    # A convex curve lies above its tangents, and these meet at this height.
    n0 = sign * start.value
    n1 = sign * end.value
    meet = (n0 * up - n1 * down + (end.h - start.h) * down * up) / (up - down)
    return _CLEAR if meet > 0.0 else _DIP


@scalar
def may_reverse(h, n0, n1, rate1, rate_max):  # type: ignore[no-untyped-def]
    """Return whether a step between spins ``n0`` and ``n1`` may hold a zero."""
    # To reach zero and come back, the spin needs a path of |n0| + |n1|, at most h *
    # max|rate|; twice the largest recent rate is a safe bound.
    recent = 0.9 * rate_max
    now = abs(rate1)
    recent = now if now > recent else recent
    return (abs(n0) + abs(n1) < 2.0 * h * recent) | (n0 * n1 <= 0.0)


@njit(**INNER)
def _pieces(lane: Lane) -> float:
    """Return the number of pieces of the step FULL."""
    angle = PIECE_ANGLE
    if lane.searched == SPIN and lane.arm == 0.0 and lane.awaited < NEVER:
        # In a piece, a spin that swings through zero and back gets swing * rate_max *
        # length^2 / 8 far; half the awaited modulus is allowed.
        finest = sqrt(4.0 * lane.awaited * lane.swing / lane.rate_max)
        angle = min(PIECE_ANGLE, max(SHORTEST_PIECE, finest))
    return min(MAX_PIECES, max(1.0, ceil(lane.full.h * lane.swing / angle)))


@scalar
def _lacking(lane, point):  # type: ignore[no-untyped-def]
    """Return what the spin lacks of the awaited modulus, on the side of END."""
    side = 1.0 if lane.end.value > 0.0 else -1.0
    return Point(point.h, lane.awaited - side * point.value, -side * point.rate)


@njit(**INNER)
def search(lane: Lane, start: Point, tried: Point) -> int:
    """Make one move of the search for a zero, after each step tried on the lane."""
    if lane.search == REDO:
        lane.search = STEP
        lane.h_next = lane.full_next
        return TAKE
    if lane.search == ROOT:
        return _polish(lane, tried)
    if lane.search == MINIMUM:
        return _close_in(lane, tried)
    if lane.search == STEP:
        lane.full = tried
        lane.full_next = lane.h_next
        lane.pieces = _pieces(lane)
        lane.piece = 1.0
        lane.lo = start
        lane.search = SCAN
        if lane.pieces > 1.0:
            lane.h_next = tried.h / lane.pieces
            return HOLD
    # SCAN: the end of a piece.
    lane.end = tried
    return _scan(lane, tried.h)


@njit(**INNER)
def search_limit(lane: Lane) -> int:
    """Make one move of the search for the first zero of the limit."""
    lane.searched = LIMIT
    move = search(lane, lane.limit0, lane.limit1)
    if move != HOLD:
        lane.searched = SPIN
        lane.leaves = 0.0
    if move == REVERSED:
        # What is searched next is searched in the step to this zero.
        lane.h_limit = lane.h
        lane.search = STEP
        return TAKE
    return move


@njit(**INNER)
def search_on(lane: Lane, h: float) -> int:
    """Search the step on after the zero at ``h``, or where the spin is far."""
    if lane.search == ROOT:
        lane.sign = -lane.sign
        lane.search = SCAN
        lane.lo = lane.beyond
        pieces = _pieces(lane)
        if pieces > lane.pieces:
            # Go on from the zero in pieces that are short enough from now on.
            lane.pieces = pieces
            lane.piece = floor(h / lane.full.h * pieces)
            lane.end = Point(h, 0.0, lane.rate1)
            move = _next_piece(lane, h)
            return _scan(lane, h) if move == _KNOWN else move
    return _scan(lane, h)


@njit(**INNER)
def _scan(lane: Lane, tried: float) -> int:
    """Decide on the piece from LO to END, and on later ones whose ends are known."""
    while True:
        verdict = _CLEAR
        if lane.searched == LIMIT or counts_zeros(lane):
            verdict = _judge(lane.lo, lane.end, _sign(lane))
        if verdict == _ZERO:
            lane.hi = lane.end
            return _start_root(lane)
        if verdict == _DIP:
            lane.hi = lane.end
            return _start_minimum(lane)
        if lane.searched == SPIN and lane.awaited < NEVER:
            start = _lacking(lane, lane.lo)
            end = _lacking(lane, lane.end)
            verdict = _judge(start, end, 1.0)
            if verdict == _ZERO:
                return _arrive(lane, lane.end)
            if verdict == _DIP:
                lane.lo = start
                lane.hi = end
                lane.searched = FAR
                return _start_minimum(lane)
        move = _next_piece(lane, tried)
        if move != _KNOWN:
            return move


@njit(**INNER)
def _next_piece(lane: Lane, tried: float) -> int:
    """Go to the piece after END.

    Try its end, or take the step, or return _KNOWN with END set.
    """
    lane.lo = lane.end
    lane.piece += 1.0
    lane.search = SCAN
    if lane.piece < lane.pieces:
        lane.h_next = lane.full.h * (lane.piece / lane.pieces)
        return HOLD
    if lane.piece == lane.pieces:
        # The end of the last piece is the end of the step, known from its first try.
        lane.end = lane.full
        return _KNOWN
    if tried == lane.full.h:
        lane.search = STEP
        lane.h_next = lane.full_next
        return TAKE
    lane.search = REDO
    lane.h_next = lane.full.h
    return HOLD


@njit(**INNER)
def _arrive(lane: Lane, point: Point) -> int:
    """Let the search go on from a point at which the spin is as far as awaited."""
    lane.searched = SPIN
    lane.search = SCAN
    lane.lo = point
    return ARRIVED


@njit(**INNER)
def _start_minimum(lane: Lane) -> int:
    """Start the search for a minimum between LO and HI."""
    lane.search = MINIMUM
    lane.tries = 0.0
    lane.h_next = _towards_extremum(lane)
    return HOLD


@njit(**INNER)
def _close_in(lane: Lane, tried: Point) -> int:
    """Narrow the bracket LO..HI of a minimum until the sign there is certain."""
    sign = _sign(lane)
    point = tried
    if lane.searched == FAR:
        point = _lacking(lane, tried)
        if point.value <= 0.0:
            return _arrive(lane, tried)
    if sign * point.value <= 0.0:
        lane.hi = point
        return _start_root(lane)
    if sign * point.rate < 0.0:
        lane.lo = point
    else:
        lane.hi = point
    lane.tries += 1.0
    verdict = _judge(lane.lo, lane.hi, sign)
    wide = lane.hi.h - lane.lo.h > 1e-12 * lane.full.h
    if verdict == _DIP and wide and lane.tries < MAX_TRIES:
        lane.h_next = _towards_extremum(lane)
        return HOLD
    # The ends of the bracket are nearer to the minimum than a last try in its middle.
    lowest = min(sign * lane.lo.value, sign * lane.hi.value)
    near = lowest < lane.fuzz * lane.rate_max / lane.swing
    if near and lane.searched == SPIN:
        lane.near += 1.0
    if lane.searched == FAR:
        lane.searched = SPIN
    # There is no zero in this piece.
    move = _next_piece(lane, tried.h)
    return _scan(lane, tried.h) if move == _KNOWN else move


@njit(**INNER)
def _towards_extremum(lane: Lane) -> float:
    """Return the next point to try in LO..HI.

    It is found by a secant of the rate, and is halfway every third time.
    """
    lo = lane.lo
    hi = lane.hi
    share = 0.5 if lane.tries % 3.0 == 2.0 else lo.rate / (lo.rate - hi.rate)
    return lo.h + min(0.98, max(0.02, share)) * (hi.h - lo.h)


@njit(**INNER)
def _secant(lane: Lane) -> float:
    """Return where the secant through both ends of the bracket is zero."""
    lo = lane.lo
    hi = lane.hi
    share = lo.value / (lo.value - hi.value)
    # The spin has just left zero and comes back: the zero is not the one it left.
    leaves = share < NEAR_START and lane.searched == LIMIT and lo.rate > 0.0
    if leaves or not 0.0 <= share <= 1.0:
        # Or both are beyond the zero, as the force has jumped at the start.
        share = 0.5
    return lo.h + share * (hi.h - lo.h)


@njit(**INNER)
def _start_root(lane: Lane) -> int:
    """Start Newton's method for the zero between LO and HI, with a secant."""
    lane.beyond = lane.hi
    lane.search = ROOT
    lane.tries = 0.0
    lane.h_next = _secant(lane)
    return HOLD


@njit(**INNER)
def _polish(lane: Lane, tried: Point) -> int:
    """Take a step of Newton's method in LO..HI, until steps are rounding errors."""
    h, n, rate = tried
    if _sign(lane) * n > 0.0:
        lane.lo = tried
    else:
        lane.hi = tried
    lane.tries += 1.0
    lo = lane.lo.h
    hi = lane.hi.h
    full = lane.full.h
    guess = h - n / rate if rate != 0.0 else lo
    # A limit that still rises is not near its zero, although it may be near the one
    # from which it has risen.
    rises = lane.searched == LIMIT and n > 0.0 and rate > 0.0
    if not (guess > lo and guess < hi) or lane.tries % 8.0 == 7.0:
        guess = lo + 0.5 * (hi - lo)
        newton = abs(n / rate) if rate != 0.0 and not rises else full
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
        most = lane.rate_max * lane.rate_max
        near = rate * rate < 2.0 * lane.fuzz * most
        if near and lane.searched == SPIN:
            lane.near += 1.0
        return REVERSED
    lane.h_next = guess
    return HOLD
