"""The lane kernel: many runs at once, each with its own step.

A thread holds :data:`LANES` runs.  Every turn tries one step on all of them (the generated
``attempt``), decides on all of them in loops over lanes that vectorise, looks closer
only at the lanes where something is due (a rejection, a possible zero of the spin, the end of a
window or of the run), and refills the lanes whose run has ended from a queue
that all threads share.  The arithmetic of a run depends on its own numbers
alone, so its results are the same bits in any lane, thread and batch.

The functions here are templates: :mod:`rattlesweep.integrate.lanes.build` binds the capitalised
globals and the model's functions.  What costs much to compile and is called seldom, or takes long
where it is called, is compiled for itself and called by its address (:data:`PARTS`): the step, of a
method and a model, is then the same code in sweeps and trajectories, and all the rest the
same for all methods with error control.
"""

# mypy: ignore-errors
from __future__ import annotations

from math import isfinite

from numba import prange

from rattlesweep.integrate.lanes import columns as C
from rattlesweep.integrate.lanes import rows as R
from rattlesweep.integrate.lanes.atomics import (
    call,
    call_for_two,
    fetch_add,
    load,
    widest_vectors,
)
from rattlesweep.integrate.lanes.controller import LEAST_STEP, error_root, retry_ratio, step_ratio
from rattlesweep.integrate.lanes.events import (
    HOLD,
    REVERSED,
    STEP,
    TAKE,
    may_reverse,
    search,
    search_on,
)
from rattlesweep.integrate.lanes.rows import AMPLITUDE, ERROR, N1, RATE1, H
from rattlesweep.integrate.lanes.runs import (
    UNKNOWN_RATE,
    finish,
    idle,
    pass_marks,
    see_contact,
    see_side,
    see_zero,
    settled,
    start,
    stay,
)
from rattlesweep.integrate.lanes.step import LANES as L
from rattlesweep.integrate.status import Status

OK = int(Status.OK)
NONFINITE = int(Status.NONFINITE)
STEP_LIMIT = int(Status.STEP_LIMIT)
STEP_TOO_SMALL = int(Status.STEP_TOO_SMALL)

# Places in ``parts``: the addresses of the step, attempt(w, scale), and of :func:`settle`.
ATTEMPT, SETTLE = 0, 1
PARTS = 2

# Bound by kernels.build.
Y1 = 0
ADAPTIVE = False


def lane_energy(lane, row):
    """Energy of a lane at the state from row ``row`` on."""
    raise NotImplementedError


def advance(w):
    """Move all lanes to the end of their step."""
    raise NotImplementedError


def give_up(lane, max_steps):
    """Status of a lane whose step failed, OK to go on with a shorter one."""
    if not ADAPTIVE:
        return NONFINITE
    if lane[R.STEPS] + lane[R.REJECTED] >= max_steps:
        return STEP_LIMIT
    if lane[H] * lane[R.SWING] < LEAST_STEP:
        return STEP_TOO_SMALL if isfinite(lane[ERROR]) else NONFINITE
    return OK


def settle(lane, max_steps, on):
    """Decide again on the step tried on a lane where something is due.

    Parameters
    ----------
    lane : ndarray
    max_steps : float
    on : bool
        Whether that step has been found to end at a zero, behind which the search is to go on.

    Returns
    -------
    status : int
        OK to go on.
    move : int
        HOLD (the step is not taken), TAKE, or REVERSED (it is, and ends at a zero of the spin).
    """
    if on:
        move = search_on(lane, lane[H])
        lane[R.ACCEPT] = 0.0 if move == HOLD else 1.0
        return OK, move
    if lane[R.MODE] == STEP and lane[R.ACCEPT] == 0.0:
        lane[R.REJECTED] += 1.0
        lane[R.HELD] = 1.0
        lane[R.H_NEXT] = lane[H] * retry_ratio(lane[ERROR])
        return give_up(lane, max_steps), HOLD
    move = TAKE
    n1, rate1 = lane[N1], lane[RATE1]
    if lane[R.ARM] > 0.0:
        # No zero counts yet, and every step is looked at (may_reverse).
        lane[R.RATE_MAX] = UNKNOWN_RATE
        if abs(n1) > lane[R.ARM]:
            lane[R.ARM] = 0.0
            lane[R.SIGN] = 1.0 if n1 > 0.0 else -1.0
            lane[R.RATE_MAX] = lane[R.ARM_RATE]
    elif lane[R.MODE] != STEP or may_reverse(lane[H], lane[R.N0], n1, rate1, lane[R.RATE_MAX]):
        move = search(lane, lane[H], n1, rate1)
    lane[R.ACCEPT] = 0.0 if move == HOLD else 1.0
    full = move != HOLD and lane[R.STEPS] >= max_steps
    return STEP_LIMIT if full else OK, move


def decide(w, dt, max_steps):
    """Decide on the step tried on every lane; returns how many lanes need a closer look."""
    widest_vectors()
    special = 0
    for l in range(L):
        h = w[H * L + l]
        error = w[ERROR * L + l]
        accept = error <= 1.0
        if ADAPTIVE:
            root = error_root(error)
            w[R.ROOT * L + l] = root
            held = w[R.HELD * L + l] > 0.0
            w[R.H_NEXT * L + l] = h * step_ratio(root, w[R.ROOT0 * L + l], held)
        else:
            w[R.H_NEXT * L + l] = dt
        # No 'or': what is behind it would be read under a mask.
        due = (
            may_reverse(h, w[R.N0 * L + l], w[N1 * L + l], w[RATE1 * L + l], w[R.RATE_MAX * L + l])
            | (w[R.LAST * L + l] > 0.0)
            | (w[R.MODE * L + l] > 0.0)
            | (w[R.T * L + l] + h >= w[R.NEXT * L + l])
            | (w[R.STEPS * L + l] >= max_steps)
            | (not accept)
        )
        w[R.ACCEPT * L + l] = 1.0 if accept else 0.0
        w[R.DUE * L + l] = 1.0 if due else 0.0
        special += 1 if due else 0
    return special


def commit(w):
    """Move all lanes to the end of the step tried, and set their next step.

    Lanes that do not take it were told to :func:`stay`.  Nothing is read or written under a mask,
    which AVX2 does slowly: so nothing is written back as it was, and nothing read for one choice.
    """
    widest_vectors()
    advance(w)
    for l in range(L):
        n1 = w[N1 * L + l]
        w[R.N0 * L + l] = n1
        signed = w[R.SIGN * L + l] * n1
        least = w[R.N_LEAST * L + l]
        w[R.N_LEAST * L + l] = (signed if signed < least else least) + 0.0
        largest = w[R.A_MAX * L + l]
        now = w[AMPLITUDE * L + l]
        w[R.A_MAX * L + l] = (now if now > largest else largest) + 0.0
        w[R.ROOT0 * L + l] = w[R.ROOT * L + l]
    for l in range(L):
        accept = w[R.ACCEPT * L + l]
        w[R.STEPS * L + l] += accept
        w[R.HELD * L + l] *= 1.0 - accept
        rate1 = w[RATE1 * L + l]
        w[R.RATE0 * L + l] = rate1
        recent = (1.0 - 0.1 * accept) * w[R.RATE_MAX * L + l]
        now = abs(rate1)
        w[R.RATE_MAX * L + l] = now if now > recent else recent
        # Compensated sum: a million steps lose nothing.
        t0 = w[R.T * L + l]
        part = w[H * L + l] * accept - w[R.T_LOW * L + l]
        t1 = t0 + part
        w[R.T * L + l] = t1
        w[R.T_LOW * L + l] = (t1 - t0) - part
    for l in range(L):
        # A search holds the step it began with; the others must not pass the horizon.
        h_next = w[R.H_NEXT * L + l]
        searching = 1.0 if w[R.MODE * L + l] > 0.0 else 0.0
        left = (w[R.T_END * L + l] - w[R.T * L + l]) + 1e290 * searching
        kept = w[R.LAST * L + l] * searching
        w[R.LAST * L + l] = 1.0 if h_next >= left else kept
        w[H * L + l] = left if h_next >= left else h_next


def watch(w, windows, record):
    """Observations that are made at every accepted step only when they are asked for."""
    for l in range(L):
        if w[R.ACCEPT * L + l] > 0.0:
            lane = w[l::L]
            if record[C.REC_ENERGY]:
                energy0 = lane[R.ENERGY0]
                drift = abs(lane_energy(lane, Y1) - energy0) / energy0 if energy0 > 0.0 else 0.0
                lane[R.DRIFT_MAX] = max(lane[R.DRIFT_MAX], drift)
            if record[C.REC_CONTACT]:
                see_contact(lane, Y1)
            if record[C.REC_WINDOWS]:
                lane[R.W_N_MIN] = min(lane[R.W_N_MIN], lane[N1])
                lane[R.W_N_MAX] = max(lane[R.W_N_MAX], lane[N1])
            if record[C.REC_REVERSALS]:
                see_side(lane, windows, record)


def work(thread, parts, w, shared, order, y0, constants, probe, plan, options,
         record, result, counts, windows, progress):  # fmt: skip
    """What one thread does until the queue is empty or Python says stop.

    Parameters
    ----------
    thread : int
        Row of ``progress`` to write to.
    parts : int64 ndarray, shape (PARTS,)
        Addresses of what is compiled for itself.
    w : ndarray
        The thread's own workspace.
    shared : int64 ndarray
        ``[next place in the queue, stop flag]``.
    order : int64 ndarray, shape (runs,)
        The queue, longest runs first.
    y0, constants, probe : ndarray, shape (runs, ...)
        Initial states, the bodies' constants and the amplitudes' coefficients.
    plan, options : ndarray
        See :mod:`rattlesweep.integrate.lanes.columns`, as for ``record``, ``result`` and
        ``counts``.
    record : bool ndarray, shape (N_RECORD,)
        Which extra observations to make.
    result, counts, windows : ndarray
        Written to, one row a run.
    progress : ndarray, shape (threads, ...)
        Expected cost of the runs that have ended, and of the lanes' runs so far.
    """
    widest_vectors()
    scale, dt, max_steps = options[0], options[1], options[2]
    watching = (
        record[C.REC_ENERGY]
        or record[C.REC_CONTACT]
        or record[C.REC_WINDOWS]
        or record[C.REC_REVERSALS]
    )
    total = order.size
    busy = 0
    for l in range(L):
        lane = w[l::L]
        place = fetch_add(shared, 0, 1)
        if place < total:
            start(lane, order[place], y0, constants, probe, plan, record)
            busy += 1
        else:
            idle(lane)
        lane[H] = lane[R.H_NEXT]
    turns = 0
    while busy > 0:
        call(parts[ATTEMPT], (w, scale))
        special = decide(w, dt, max_steps)
        if special > 0:
            for l in range(L):
                if w[R.DUE * L + l] == 0.0:
                    continue
                lane = w[l::L]
                run = int(lane[R.RUN])
                if run < 0:
                    lane[R.ACCEPT] = 0.0
                    lane[R.H_NEXT] = 0.0
                    stay(lane)
                    continue
                status, move = call_for_two(parts[SETTLE], (lane, max_steps, False))
                t = lane[R.T] + (lane[H] - lane[R.T_LOW])
                if move == REVERSED and record[C.REC_REVERSALS]:
                    # Go on behind the zero, in the same step.
                    see_zero(lane, t)
                    behind, move = call_for_two(parts[SETTLE], (lane, max_steps, True))
                    status = behind if move == HOLD else status
                reversal = move == REVERSED
                ended = status != OK or reversal
                if move == TAKE and lane[R.LAST] > 0.0:
                    t = lane[R.T_END]
                    ended = True
                if move == TAKE and not ended and t >= lane[R.NEXT]:
                    pass_marks(lane, t, run, windows, record)
                    ended = settled(lane, plan[run, C.SETTLED])
                if ended:
                    lane[R.STEPS] += 1.0
                    finish(lane, status, reversal, t, run, result, counts, windows, record)
                    progress[thread, 0] += plan[run, C.COST]
                    progress[thread, 2] += 1.0
                    place = fetch_add(shared, 0, 1)
                    if place < total:
                        start(lane, order[place], y0, constants, probe, plan, record)
                    else:
                        idle(lane)
                        busy -= 1
                    lane[R.ACCEPT] = 0.0
                if lane[R.ACCEPT] == 0.0:
                    stay(lane)
        if watching:
            watch(w, windows, record)
        commit(w)
        turns += 1
        if turns % 256 == 0:
            if load(shared, 1) != 0:
                return
            under_way = 0.0
            for l in range(L):
                run = int(w[R.RUN * L + l])
                if run >= 0:
                    under_way += min(1.0, w[R.T * L + l] / plan[run, C.HORIZON]) * plan[run, C.COST]
            progress[thread, 1] = under_way
    progress[thread, 1] = 0.0


def drive(address, parts, threads, w, shared, order, y0, constants, probe, plan, options,
          record, result, counts, windows, progress):  # fmt: skip
    """One :func:`work` on each thread; the one of a method and a model is known by its address.

    This way the driver is compiled once for all of them, and none is compiled again inside of it.
    """
    for thread in prange(threads):
        call(
            address,
            (
                thread, parts, w[thread], shared, order, y0, constants, probe, plan, options,
                record, result, counts, windows, progress,
            ),
        )  # fmt: skip
