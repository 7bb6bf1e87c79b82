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
from rattlesweep.integrate.lanes.step import LANES as L

# Modes of a lane.
STEP, SCAN, MINIMUM, ROOT, REDO = 0, 1, 2, 3, 4
# What a move of the search decides.
HOLD, TAKE, REVERSED = 0, 1, 2
# Longest piece, in radians of the fastest swing.
PIECE_ANGLE = 0.5
MAX_PIECES = 16
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
def _set(w, l, row, h, n, r):  # type: ignore[no-untyped-def]
    w[row * L + l] = h
    w[(row + 1) * L + l] = n
    w[(row + 2) * L + l] = r


@njit(**INNER)
def search(l, h, n, r, w):  # type: ignore[no-untyped-def]
    """One move of the search, after each step tried on lane ``l``.

    Parameters
    ----------
    l : int
        Lane.
    h, n, r : float
        Step just tried, the spin and its rate at its end.
    w : ndarray
        Workspace, with the rows of :mod:`rattlesweep.integrate.lanes.rows`.  FUZZ is the depth of
        an extremum, relative to the swing, below which the method cannot tell whether the spin
        touched zero; such extrema are counted.

    Returns
    -------
    int
        HOLD (go back and try ``w[H_NEXT]``), TAKE (accept the step just tried), or REVERSED (the
        step just tried ends at the first zero).
    """
    sign = w[R.SIGN * L + l]
    mode = w[R.MODE * L + l]
    if mode == REDO:
        w[R.MODE * L + l] = STEP
        w[R.H_NEXT * L + l] = w[R.FULL_NEXT * L + l]
        return TAKE
    if mode == STEP:
        _set(w, l, R.FULL_H, h, n, r)
        w[R.FULL_NEXT * L + l] = w[R.H_NEXT * L + l]
        pieces = min(MAX_PIECES, max(1, ceil(h * w[R.SWING * L + l] / PIECE_ANGLE)))
        w[R.PIECES * L + l] = pieces
        w[R.PIECE * L + l] = 1.0
        _set(w, l, R.LO_H, 0.0, w[R.N0 * L + l], w[R.RATE0 * L + l])
        w[R.MODE * L + l] = mode = SCAN
        if pieces > 1:
            w[R.H_NEXT * L + l] = h / pieces
            return HOLD

    if mode == ROOT:
        return _polish(l, h, n, r, w)

    if mode == MINIMUM:
        if sign * n <= 0.0:
            _set(w, l, R.HI_H, h, n, r)
            return _start_root(l, w)
        if sign * r < 0.0:
            _set(w, l, R.LO_H, h, n, r)
        else:
            _set(w, l, R.HI_H, h, n, r)
        tries = w[R.TRIES * L + l] + 1.0
        w[R.TRIES * L + l] = tries
        lo, hi = w[R.LO_H * L + l], w[R.HI_H * L + l]
        verdict = _judge(
            lo, w[R.LO_N * L + l], w[R.LO_R * L + l],
            hi, w[R.HI_N * L + l], w[R.HI_R * L + l], sign,
        )  # fmt: skip
        if verdict == _DIP and hi - lo > 1e-12 * w[R.FULL_H * L + l] and tries < MAX_TRIES:
            w[R.H_NEXT * L + l] = _towards_minimum(l, w, tries)
            return HOLD
        # The last try may have been the middle of the bracket; its ends are nearer the minimum.
        lowest = min(sign * w[R.LO_N * L + l], sign * w[R.HI_N * L + l])
        if lowest < w[R.FUZZ * L + l] * w[R.RATE_MAX * L + l] / w[R.SWING * L + l]:
            w[R.NEAR * L + l] += 1.0
        # No zero here; go on behind the piece that held the minimum.
        move = _next_piece(l, w, h)
        return _scan(l, w, h) if move == _KNOWN else move

    # SCAN: a piece from LO to the point just tried.
    _set(w, l, R.END_H, h, n, r)
    return _scan(l, w, h)


@njit(**INNER)
def _scan(l, w, tried):  # type: ignore[no-untyped-def]
    """Decide on the pieces from LO on whose ends are known; END is the end of the first."""
    while True:
        verdict = _judge(
            w[R.LO_H * L + l], w[R.LO_N * L + l], w[R.LO_R * L + l],
            w[R.END_H * L + l], w[R.END_N * L + l], w[R.END_R * L + l], w[R.SIGN * L + l],
        )  # fmt: skip
        if verdict != _CLEAR:
            _set(w, l, R.HI_H, w[R.END_H * L + l], w[R.END_N * L + l], w[R.END_R * L + l])
            if verdict == _ZERO:
                return _start_root(l, w)
            w[R.MODE * L + l] = MINIMUM
            w[R.TRIES * L + l] = 0.0
            w[R.H_NEXT * L + l] = _towards_minimum(l, w, 0.0)
            return HOLD
        move = _next_piece(l, w, tried)
        if move != _KNOWN:
            return move


@njit(**INNER)
def _next_piece(l, w, tried):  # type: ignore[no-untyped-def]
    """Go on behind END: try the next piece's end, or take the step, or _KNOWN if END now is it."""
    _set(w, l, R.LO_H, w[R.END_H * L + l], w[R.END_N * L + l], w[R.END_R * L + l])
    piece = w[R.PIECE * L + l] + 1.0
    pieces = w[R.PIECES * L + l]
    full = w[R.FULL_H * L + l]
    w[R.PIECE * L + l] = piece
    w[R.MODE * L + l] = SCAN
    if piece < pieces:
        w[R.H_NEXT * L + l] = full * (piece / pieces)
        return HOLD
    if piece == pieces:
        # The end of the last piece is the end of the step, known from its first try.
        _set(w, l, R.END_H, full, w[R.FULL_N * L + l], w[R.FULL_R * L + l])
        return _KNOWN
    if tried == full:
        w[R.MODE * L + l] = STEP
        w[R.H_NEXT * L + l] = w[R.FULL_NEXT * L + l]
        return TAKE
    w[R.MODE * L + l] = REDO
    w[R.H_NEXT * L + l] = full
    return HOLD


@njit(**INNER)
def _towards_minimum(l, w, tries):  # type: ignore[no-untyped-def]
    """Next point in LO..HI, where the rate changes sign: a secant, every third time the middle."""
    lo, hi = w[R.LO_H * L + l], w[R.HI_H * L + l]
    share = w[R.LO_R * L + l] / (w[R.LO_R * L + l] - w[R.HI_R * L + l])
    if tries % 3.0 == 2.0:
        share = 0.5
    return lo + min(0.98, max(0.02, share)) * (hi - lo)


@njit(**INNER)
def _start_root(l, w):  # type: ignore[no-untyped-def]
    """Begin to polish the zero between LO and HI."""
    w[R.MODE * L + l] = ROOT
    w[R.TRIES * L + l] = 0.0
    lo, hi = w[R.LO_H * L + l], w[R.HI_H * L + l]
    share = w[R.LO_N * L + l] / (w[R.LO_N * L + l] - w[R.HI_N * L + l])
    w[R.H_NEXT * L + l] = lo + share * (hi - lo)
    return HOLD


@njit(**INNER)
def _polish(l, h, n, r, w):  # type: ignore[no-untyped-def]
    """Newton's method in the bracket LO..HI until it moves by rounding only."""
    if w[R.SIGN * L + l] * n > 0.0:
        _set(w, l, R.LO_H, h, n, r)
    else:
        _set(w, l, R.HI_H, h, n, r)
    tries = w[R.TRIES * L + l] + 1.0
    w[R.TRIES * L + l] = tries
    lo, hi = w[R.LO_H * L + l], w[R.HI_H * L + l]
    full = w[R.FULL_H * L + l]
    guess = h - n / r if r != 0.0 else lo
    if not (guess > lo and guess < hi) or tries % 8.0 == 7.0:
        guess = lo + 0.5 * (hi - lo)
        newton = abs(n / r) if r != 0.0 else full
    else:
        newton = abs(guess - h)
    if n == 0.0 or newton < 1e-14 * full or hi - lo < 1e-15 * full or tries >= MAX_TRIES:
        # The swing behind the zero is r^2 / (2 n'') deep, n'' at most SWING * RATE_MAX.
        if r * r < 2.0 * w[R.FUZZ * L + l] * w[R.RATE_MAX * L + l] ** 2:
            w[R.NEAR * L + l] += 1.0
        return REVERSED
    w[R.H_NEXT * L + l] = guess
    return HOLD
