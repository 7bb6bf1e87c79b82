"""First zero of the spin within a step, with no misses.

The spin swings at twice the frequency of the oscillation and grazes zero before it reverses, so
a pair of zeros often lies inside one step.  When a step that met the tolerance may
hold a zero, it is held: the lane goes back to the start of the step and tries shorter steps from
there, each as good as the method itself.  The step is cut into pieces that are
short against a swing.  A piece whose ends differ in sign has a zero; a piece
with the spin falling at its start and rising at its end is searched for its minimum until a bound
shows it positive or a negative value is found; the zero is then polished by Newton's method, kept
in its bracket.  The search never changes the step that is finally accepted, so it leaves
the trajectory alone, and it works for any method without dense output.
"""

from __future__ import annotations

from math import ceil

from numba import njit

from rattlesweep.integrate.lanes import rows as R
from rattlesweep.integrate.lanes.cells import INNER
from rattlesweep.physics.full import scalar

# Modes of a lane.
STEP, SCAN, MINIMUM, ROOT, REDO = 0, 1, 2, 3, 4
# What a move of the search decides.
HOLD, TAKE, REVERSED = 0, 1, 2
# Longest piece, in radians of the fastest swing.
PIECE_ANGLE = 0.5
# Steps are a dozen radians at most, or so much longer than a swing that nothing is to be found.
MAX_PIECES = 4096.0
MAX_TRIES = 60

_CLEAR, _DIP, _ZERO = 0, 1, 2
# No function here may call itself, not even through another: Numba cannot cache recursion (the
# cached kernel crashes when it is loaded, seen with Numba 0.68).
_KNOWN = 3


@njit(**INNER)
def _judge(h0, n0, r0, h1, n1, r1, sign):  # type: ignore[no-untyped-def]
    """Whether a piece with the spin positive (after ``sign``) at its start can hold a zero."""
    if sign * n1 <= 0.0:
        return _ZERO
    down = sign * r0
    up = sign * r1
    if not (down < 0.0 and up > 0.0):
        return _CLEAR
    # A convex curve lies above its tangents, and these meet at this height.
    n0 = sign * n0
    n1 = sign * n1
    width = h1 - h0
    meet = (n0 * up - n1 * down + width * down * up) / (up - down)
    return _CLEAR if meet > 0.0 else _DIP


@njit(**INNER)
def _set(lane, row, h, n, r):  # type: ignore[no-untyped-def]
    lane[row] = h
    lane[row + 1] = n
    lane[row + 2] = r


@scalar
def may_reverse(h, n0, n1, rate1, rate_max):  # type: ignore[no-untyped-def]
    """Whether a step of size ``h`` between spins ``n0`` and ``n1`` may hold a zero."""
    # The spin changes by at most h * max|rate| in all; twice the recent largest is safe.
    recent = 0.9 * rate_max
    now = abs(rate1)
    recent = now if now > recent else recent
    return (abs(n0) + abs(n1) < 2.0 * h * recent) | (n0 * n1 <= 0.0)


@njit(**INNER)
def search(lane, h, n, r):  # type: ignore[no-untyped-def]
    """One move of the search, after each step tried on the lane.

    Parameters
    ----------
    lane : ndarray
        The lane's cells by the rows of :mod:`rattlesweep.integrate.lanes.rows`.  FUZZ is the depth
        of an extremum, relative to the swing, below which the method cannot tell whether the spin
        touched zero; such extrema are counted.
    h, n, r : float
        Step just tried, the spin and its rate at its end.

    Returns
    -------
    int
        HOLD (go back and try ``lane[H_NEXT]``), TAKE (accept the step just tried), or REVERSED (the
        step just tried ends at the first zero).
    """
    sign = lane[R.SIGN]
    mode = lane[R.MODE]
    if mode == REDO:
        lane[R.MODE] = STEP
        lane[R.H_NEXT] = lane[R.FULL_NEXT]
        return TAKE
    if mode == STEP:
        _set(lane, R.FULL_H, h, n, r)
        lane[R.FULL_NEXT] = lane[R.H_NEXT]
        pieces = min(MAX_PIECES, max(1.0, ceil(h * lane[R.SWING] / PIECE_ANGLE)))
        lane[R.PIECES] = pieces
        lane[R.PIECE] = 1.0
        _set(lane, R.LO_H, 0.0, lane[R.N0], lane[R.RATE0])
        lane[R.MODE] = mode = SCAN
        if pieces > 1:
            lane[R.H_NEXT] = h / pieces
            return HOLD

    if mode == ROOT:
        return _polish(lane, h, n, r)

    if mode == MINIMUM:
        if sign * n <= 0.0:
            _set(lane, R.HI_H, h, n, r)
            return _start_root(lane)
        if sign * r < 0.0:
            _set(lane, R.LO_H, h, n, r)
        else:
            _set(lane, R.HI_H, h, n, r)
        tries = lane[R.TRIES] + 1.0
        lane[R.TRIES] = tries
        lo, hi = lane[R.LO_H], lane[R.HI_H]
        verdict = _judge(
            lo, lane[R.LO_N], lane[R.LO_R],
            hi, lane[R.HI_N], lane[R.HI_R], sign,
        )  # fmt: skip
        if verdict == _DIP and hi - lo > 1e-12 * lane[R.FULL_H] and tries < MAX_TRIES:
            lane[R.H_NEXT] = _towards_minimum(lane, tries)
            return HOLD
        # The last try may have been the middle of the bracket; its ends are nearer the minimum.
        lowest = min(sign * lane[R.LO_N], sign * lane[R.HI_N])
        if lowest < lane[R.FUZZ] * lane[R.RATE_MAX] / lane[R.SWING]:
            lane[R.NEAR] += 1.0
        # No zero here; go on behind the piece that held the minimum.
        move = _next_piece(lane, h)
        return _scan(lane, h) if move == _KNOWN else move

    # SCAN: a piece from LO to the point just tried.
    _set(lane, R.END_H, h, n, r)
    return _scan(lane, h)


@njit(**INNER)
def _scan(lane, tried):  # type: ignore[no-untyped-def]
    """Decide on the pieces from LO on whose ends are known; END is the end of the first."""
    while True:
        verdict = _judge(
            lane[R.LO_H], lane[R.LO_N], lane[R.LO_R],
            lane[R.END_H], lane[R.END_N], lane[R.END_R], lane[R.SIGN],
        )  # fmt: skip
        if verdict != _CLEAR:
            _set(lane, R.HI_H, lane[R.END_H], lane[R.END_N], lane[R.END_R])
            if verdict == _ZERO:
                return _start_root(lane)
            lane[R.MODE] = MINIMUM
            lane[R.TRIES] = 0.0
            lane[R.H_NEXT] = _towards_minimum(lane, 0.0)
            return HOLD
        move = _next_piece(lane, tried)
        if move != _KNOWN:
            return move


@njit(**INNER)
def search_on(lane, h):  # type: ignore[no-untyped-def]
    """Search in the same step behind the zero at ``h``, for one of the other direction."""
    lane[R.SIGN] = -lane[R.SIGN]
    lane[R.MODE] = SCAN
    if lane[R.BEYOND_H] == lane[R.END_H]:
        move = _next_piece(lane, h)
        return _scan(lane, h) if move == _KNOWN else move
    _set(lane, R.LO_H, lane[R.BEYOND_H], lane[R.BEYOND_N], lane[R.BEYOND_R])
    return _scan(lane, h)


@njit(**INNER)
def _next_piece(lane, tried):  # type: ignore[no-untyped-def]
    """Go on behind END: try the next piece's end, or take the step, or _KNOWN if END now is it."""
    _set(lane, R.LO_H, lane[R.END_H], lane[R.END_N], lane[R.END_R])
    piece = lane[R.PIECE] + 1.0
    pieces = lane[R.PIECES]
    full = lane[R.FULL_H]
    lane[R.PIECE] = piece
    lane[R.MODE] = SCAN
    if piece < pieces:
        lane[R.H_NEXT] = full * (piece / pieces)
        return HOLD
    if piece == pieces:
        # The end of the last piece is the end of the step, known from its first try.
        _set(lane, R.END_H, full, lane[R.FULL_N], lane[R.FULL_R])
        return _KNOWN
    if tried == full:
        lane[R.MODE] = STEP
        lane[R.H_NEXT] = lane[R.FULL_NEXT]
        return TAKE
    lane[R.MODE] = REDO
    lane[R.H_NEXT] = full
    return HOLD


@njit(**INNER)
def _towards_minimum(lane, tries):  # type: ignore[no-untyped-def]
    """Next point in LO..HI, where the rate changes sign: a secant, every third time the middle."""
    lo, hi = lane[R.LO_H], lane[R.HI_H]
    share = lane[R.LO_R] / (lane[R.LO_R] - lane[R.HI_R])
    if tries % 3.0 == 2.0:
        share = 0.5
    return lo + min(0.98, max(0.02, share)) * (hi - lo)


@njit(**INNER)
def _start_root(lane):  # type: ignore[no-untyped-def]
    """Begin to polish the zero between LO and HI."""
    _set(lane, R.BEYOND_H, lane[R.HI_H], lane[R.HI_N], lane[R.HI_R])
    lane[R.MODE] = ROOT
    lane[R.TRIES] = 0.0
    lo, hi = lane[R.LO_H], lane[R.HI_H]
    share = lane[R.LO_N] / (lane[R.LO_N] - lane[R.HI_N])
    lane[R.H_NEXT] = lo + share * (hi - lo)
    return HOLD


@njit(**INNER)
def _polish(lane, h, n, r):  # type: ignore[no-untyped-def]
    """Newton's method in the bracket LO..HI until it moves by rounding only."""
    if lane[R.SIGN] * n > 0.0:
        _set(lane, R.LO_H, h, n, r)
    else:
        _set(lane, R.HI_H, h, n, r)
    tries = lane[R.TRIES] + 1.0
    lane[R.TRIES] = tries
    lo, hi = lane[R.LO_H], lane[R.HI_H]
    full = lane[R.FULL_H]
    guess = h - n / r if r != 0.0 else lo
    if not (guess > lo and guess < hi) or tries % 8.0 == 7.0:
        guess = lo + 0.5 * (hi - lo)
        newton = abs(n / r) if r != 0.0 else full
    else:
        newton = abs(guess - h)
    if n == 0.0 or newton < 1e-14 * full or hi - lo < 1e-15 * full or tries >= MAX_TRIES:
        # The swing behind the zero is r^2 / (2 n'') deep, n'' at most SWING * RATE_MAX.
        if r * r < 2.0 * lane[R.FUZZ] * lane[R.RATE_MAX] ** 2:
            lane[R.NEAR] += 1.0
        return REVERSED
    lane[R.H_NEXT] = guess
    return HOLD
