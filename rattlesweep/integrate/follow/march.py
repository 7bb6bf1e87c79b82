"""One run followed past its reversals: its accepted steps, and states between them.

Templates like those of :mod:`rattlesweep.integrate.lanes.kernel`.  ``march`` is the sweep's
kernel with one run in one lane: the same ``attempt``, ``decide``, ``commit`` and search for zeros,
so that the accepted steps and the first reversal are those of a sweep, bit for bit.  It differs in
that a reversal does not end the run, and that every accepted step is written down.  ``aside`` gives
states at any times, each by one step of the method from the accepted step before it, one time in
each lane; no accepted step depends on them.
"""

# mypy: ignore-errors
from __future__ import annotations

from math import isfinite

from numba import njit

from rattlesweep.integrate.lanes import rows as R
from rattlesweep.integrate.lanes.cells import INNER
from rattlesweep.integrate.lanes.events import (
    _KNOWN,
    HOLD,
    REVERSED,
    ROOT,
    SCAN,
    STEP,
    _next_piece,
    _scan,
    _set,
    search,
)
from rattlesweep.integrate.lanes.kernel import OK, STEP_LIMIT, attempt, commit, decide, give_up
from rattlesweep.integrate.lanes.runs import idle, start
from rattlesweep.integrate.lanes.step import LANES as L

# ``counts`` of march: whether the run has begun and ended, its status, and how many steps and
# zeros were written by the last call.
BEGUN, ENDED, STATUS, N_STEPS, N_ZEROS, REJECTED = 0, 1, 2, 3, 4, 5
N_COUNTS = 6
# Columns of a written step: time and its low part, behind them the state and its derivative.
T, T_LOW, STATE = 0, 1, 2

# Bound by trajectory_kernels.
N_STATE = N_CONSTANTS = N_GIVEN = 0
Y = F = Y1 = Q = H = ERROR = N1 = RATE1 = 0


def lane_rhs(w, l):
    """Derivative at the state Y into F; returns the spin and its rate."""
    raise NotImplementedError


@njit(**INNER)
def resume(l, h, w, beyond):
    """Search on in the same step behind the zero at ``h``.

    ``beyond`` is the point behind the zero, with the new sign, that the search had begun with.
    """
    w[R.SIGN * L + l] = -w[R.SIGN * L + l]
    w[R.MODE * L + l] = SCAN
    if beyond[0] == w[R.END_H * L + l]:
        move = _next_piece(l, w, h)
        return _scan(l, w, h) if move == _KNOWN else move
    _set(w, l, R.LO_H, beyond[0], beyond[1], beyond[2])
    return _scan(l, w, h)


def march(w, lane_run, y0, constants, probe, plan, options, record, beyond, steps, zeros, counts):
    """Go on with the run until the tables are full or it ends.

    Parameters
    ----------
    w, lane_run : ndarray
        Workspace of a thread; it keeps the run between calls.
    y0, constants, probe, plan : ndarray, shape (1, ...)
    options, record : ndarray
        As for :func:`rattlesweep.integrate.lanes.kernel.work`.
    beyond : ndarray, shape (3,)
        Kept between calls, for :func:`resume`.
    steps : ndarray, shape (rows, 2 + 2 n_state)
        Written to: the accepted steps' ends.
    zeros : ndarray
        Written to: the times of the zeros found.
    counts : int64 ndarray, shape (N_COUNTS,)
    """
    scale, dt, max_steps = options[0], options[1], options[2]
    if counts[BEGUN] == 0:
        counts[BEGUN] = 1
        start(0, 0, w, lane_run, y0, constants, probe, plan, record)
        w[R.NEXT * L] = 1e290
        for l in range(1, L):
            idle(l, w, lane_run)
        for l in range(L):
            w[H * L + l] = w[R.H_NEXT * L + l]
    row = 0
    found = 0
    status = OK
    ended = False
    while not ended and row < steps.shape[0] and found < zeros.size:
        attempt(w, scale)
        if decide(w, dt, max_steps) > 0:
            h = w[H * L]
            mode = w[R.MODE * L]
            if mode == STEP and w[R.ACCEPT * L] == 0.0:
                w[R.REJECTED * L] += 1.0
                w[R.HELD * L] = 1.0
                if not isfinite(w[ERROR * L]):
                    w[R.H_NEXT * L] = 0.2 * h
                status = give_up(0, h, w, max_steps)
                ended = status != OK
            else:
                n0 = w[R.N0 * L]
                n1 = w[N1 * L]
                rate = w[RATE1 * L]
                recent = max(abs(rate), 0.9 * w[R.RATE_MAX * L])
                take = True
                if mode != STEP or abs(n0) + abs(n1) < 2.0 * h * recent or n0 * n1 <= 0.0:
                    verdict = search(0, h, n1, rate, w)
                    if verdict == REVERSED:
                        zeros[found] = w[R.T * L] + (h - w[R.T_LOW * L])
                        found += 1
                        verdict = resume(0, h, w, beyond)
                        mode = STEP
                    if w[R.MODE * L] == ROOT and mode != ROOT:
                        for i in range(3):
                            beyond[i] = w[(R.HI_H + i) * L]
                    take = verdict != HOLD
                w[R.ACCEPT * L] = 1.0 if take else 0.0
                if take:
                    if w[R.STEPS * L] >= max_steps:
                        status = STEP_LIMIT
                    ended = w[R.LAST * L] > 0.0 or status != OK
        accepted = w[R.ACCEPT * L] > 0.0
        last = w[R.LAST * L] > 0.0
        commit(w)
        if accepted:
            steps[row, T] = w[R.T_END * L] if last else w[R.T * L]
            steps[row, T_LOW] = 0.0 if last else w[R.T_LOW * L]
            for c in range(N_STATE):
                steps[row, STATE + c] = w[(Y + c) * L]
                steps[row, STATE + N_STATE + c] = w[(F + c) * L]
            row += 1
    counts[ENDED] = 1 if ended else 0
    counts[STATUS] = status
    counts[N_STEPS] = row
    counts[N_ZEROS] = found
    counts[REJECTED] = int(w[R.REJECTED * L])


def aside(w, steps, which, offset, constants, out):
    """States ``offset`` behind the ends of steps: one step of the method each, a lane each.

    Parameters
    ----------
    w : ndarray
        Workspace of a thread.
    steps : ndarray
        As written by :func:`march`.
    which : int64 ndarray, shape (points,)
        Rows of ``steps`` to start from.
    offset : ndarray, shape (points,)
    constants : ndarray, shape (n_constants,)
    out : ndarray, shape (points, n_state)
        Written to.  Components that ``steps`` does not have begin at zero.
    """
    for l in range(L):
        for i in range(N_CONSTANTS):
            w[(Q + i) * L + l] = constants[i]
    points = which.size
    for first in range(0, points, L):
        for l in range(L):
            i = min(first + l, points - 1)
            for c in range(N_GIVEN):
                w[(Y + c) * L + l] = steps[which[i], STATE + c]
                w[(F + c) * L + l] = steps[which[i], STATE + N_GIVEN + c]
            for c in range(N_GIVEN, N_STATE):
                w[(Y + c) * L + l] = 0.0
            if N_GIVEN < N_STATE:
                lane_rhs(w, l)
            w[H * L + l] = offset[i]
        attempt(w, 1.0)
        for l in range(min(L, points - first)):
            for c in range(N_STATE):
                out[first + l, c] = w[(Y1 + c) * L + l]
