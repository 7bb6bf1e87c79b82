"""One run followed past its reversals: its accepted steps, and states between them.

Templates like those of :mod:`rattlesweep.integrate.lanes.kernel`.  ``march`` is the sweep's
kernel with one run in one lane: the same step, ``decide``, ``commit`` and search for zeros,
so that the accepted steps and the first reversal are those of a sweep, bit for bit.  It differs in
that a reversal does not end the run, and that every accepted step is written down.  ``aside`` gives
states at any times, each by one step of the method from the accepted step before it, one time in
each lane; no accepted step depends on them.
"""

# mypy: ignore-errors
from __future__ import annotations

from numba.np.unsafe.ndarray import to_fixed_tuple

from rattlesweep.integrate.lanes.atomics import call, call_for_two, widest_vectors
from rattlesweep.integrate.lanes.bound import N_CONSTANTS, N_STATE, L, lane_of
from rattlesweep.integrate.lanes.events import HOLD, REVERSED
from rattlesweep.integrate.lanes.kernel import ATTEMPT, OK, SETTLE, commit, decide
from rattlesweep.integrate.lanes.runs import derive, energy_at, idle, start, stay

# ``counts`` of march: whether the run has begun and ended, its status, and how many steps and
# zeros were written by the last call.
BEGUN, ENDED, STATUS, N_STEPS, N_ZEROS, REJECTED = 0, 1, 2, 3, 4, 5
N_COUNTS = 6
# Columns of a written step: time and its low part, behind them the state and its derivative.
T, T_LOW, STATE = 0, 1, 2

# Bound by kernels.py: components of the state that a written step has, and the others at first.
N_GIVEN = 0
OTHERS = ()


def march(parts, w, y0, constants, probe, plan, options, record, steps, zeros, counts, energies):
    """Go on with the run until the tables are full or it ends.

    Parameters
    ----------
    parts : int64 ndarray
        As for :func:`rattlesweep.integrate.lanes.kernel.work`.
    w : ndarray
        Workspace of a thread; it keeps the run between calls.
    y0, constants, probe, plan : ndarray, shape (1, ...)
    options, record : ndarray
        As for :func:`rattlesweep.integrate.lanes.kernel.work`.
    steps : ndarray, shape (rows, 2 + 2 n_state)
        Written to: where the run has come to, and the accepted steps' ends.
    zeros : ndarray
        Written to: the times of the zeros found.
    counts : int64 ndarray, shape (N_COUNTS,)
    energies : ndarray, shape (2,)
        Written to: energies of the launch and of the last row.
    """
    widest_vectors()
    scale, dt, max_steps = options[0], options[1], options[2]
    lane = lane_of(w, 0)
    if counts[BEGUN] == 0:
        counts[BEGUN] = 1
        start(lane, 0, y0, constants, probe, plan, record)
        lane.next = 1e290
        for l in range(1, L):
            idle(lane_of(w, l))
    row = 0
    found = 0
    status = OK
    accepted = True
    last = False
    ended = False
    while True:
        if accepted:
            steps[row, T] = lane.t_end if last else lane.t
            steps[row, T_LOW] = 0.0 if last else lane.t_low
            for c, component in enumerate(lane.y + lane.f):
                steps[row, STATE + c] = component
            row += 1
        if ended or row == steps.shape[0] or found == zeros.size:
            break
        call(parts[ATTEMPT], (w, scale))
        if decide(w, dt, max_steps) > 0:
            status, move = call_for_two(parts[SETTLE], (w, 0, max_steps, False))
            if move == REVERSED:
                zeros[found] = lane.t + (lane.h - lane.t_low)
                found += 1
                behind, move = call_for_two(parts[SETTLE], (w, 0, max_steps, True))
                status = behind if move == HOLD else status
            ended = status != OK or (move != HOLD and lane.last > 0.0)
        accepted = lane.accept > 0.0
        if not accepted:
            stay(lane)
        last = lane.last > 0.0
        commit(w)
    counts[ENDED] = 1 if ended else 0
    counts[STATUS] = status
    counts[N_STEPS] = row - 1
    counts[N_ZEROS] = found
    counts[REJECTED] = int(lane.rejected)
    energies[0] = lane.energy0
    energies[1] = energy_at(lane, lane.y)


def aside(parts, w, steps, which, offset, constants, out):
    """States ``offset`` behind the ends of steps: one step of the method each, a lane each.

    Parameters
    ----------
    parts : int64 ndarray
        As for :func:`march`.
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
    widest_vectors()
    for l in range(L):
        lane_of(w, l).constants = to_fixed_tuple(constants, N_CONSTANTS)
    points = which.size
    for first in range(0, points, L):
        for l in range(L):
            i = min(first + l, points - 1)
            lane = lane_of(w, l)
            lane.y = to_fixed_tuple(steps[which[i], STATE:], N_GIVEN) + OTHERS
            lane.f = to_fixed_tuple(steps[which[i], STATE + N_GIVEN :], N_GIVEN) + OTHERS
            if N_GIVEN < N_STATE:
                derive(lane)
            lane.h = offset[i]
        call(parts[ATTEMPT], (w, 1.0))
        for l in range(min(L, points - first)):
            for c, component in enumerate(lane_of(w, l).y1):
                out[first + l, c] = component
