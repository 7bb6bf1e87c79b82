"""The lane kernel: many runs at once, each with its own step.

A thread holds :data:`LANES` runs.  Every turn tries one step on all of them (the generated
``attempt``), decides on all of them in loops over lanes that vectorise, looks closer
only at the lanes where something is due (a rejection, a possible zero of the spin, the end of a
window or of the run), and refills the lanes whose run has ended from a queue
that all threads share.  The arithmetic of a run depends on its own numbers
alone, so its results are the same bits in any lane, thread and batch.

What costs much to compile and is called seldom, or takes long where it is called, is compiled for
itself and called by its address (:data:`PARTS`): the step, of a method and a model, is then the
same code in sweeps and trajectories, and all the rest the same for all methods with error control.
"""

# mypy: ignore-errors
from __future__ import annotations

from math import isfinite

from numba import njit, prange

from rattlesweep.integrate.lanes import columns as C
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
from rattlesweep.integrate.lanes.intrinsics import (
    INNER,
    call,
    call_for_two,
    fetch_add,
    load,
    widest_vectors,
)
from rattlesweep.integrate.lanes.lane import Point, lane_of
from rattlesweep.integrate.lanes.runs import (
    UNKNOWN_RATE,
    energy_at,
    idle,
    see_contact,
    see_side,
    see_zero,
    settled,
    stay,
)
from rattlesweep.integrate.status import Status

OK = int(Status.OK)
NONFINITE = int(Status.NONFINITE)
STEP_LIMIT = int(Status.STEP_LIMIT)
STEP_TOO_SMALL = int(Status.STEP_TOO_SMALL)

# Places in ``parts``: the addresses of the step, ``attempt``, and of :func:`decide_closely`.
ATTEMPT, DECIDE = 0, 1
PARTS = 2


@njit(**INNER)
def give_up(lane, max_steps):
    """Status of a lane whose step failed, OK to go on with a shorter one."""
    if not lane.problem.adaptive:
        return NONFINITE
    if lane.steps + lane.rejected >= max_steps:
        return STEP_LIMIT
    if lane.h * lane.swing < LEAST_STEP:
        return STEP_TOO_SMALL if isfinite(lane.error) else NONFINITE
    return OK


def decide_closely(problem, w, l, max_steps, on):
    """Decide again on the step tried on a lane where something is due.

    Parameters
    ----------
    problem : Problem
        One without a model: this function is the same for all of them.
    w : ndarray
        Workspace, of any model.
    l : int
        The lane.
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
    lane = lane_of(problem, w, l)
    if on:
        move = search_on(lane, lane.h)
        lane.accept = 0.0 if move == HOLD else 1.0
        return OK, move
    if lane.mode == STEP and lane.accept == 0.0:
        lane.rejected += 1.0
        lane.held = 1.0
        lane.h_next = lane.h * retry_ratio(lane.error)
        return give_up(lane, max_steps), HOLD
    move = TAKE
    if lane.arm > 0.0:
        # No zero counts yet, and every step is looked at (may_reverse).
        lane.rate_max = UNKNOWN_RATE
        if abs(lane.n1) > lane.arm:
            lane.arm = 0.0
            lane.sign = 1.0 if lane.n1 > 0.0 else -1.0
            lane.rate_max = lane.arm_rate
    elif lane.mode != STEP or may_reverse(lane.h, lane.n0, lane.n1, lane.rate1, lane.rate_max):
        move = search(lane, Point(lane.h, lane.n1, lane.rate1))
    lane.accept = 0.0 if move == HOLD else 1.0
    full = move != HOLD and lane.steps >= max_steps
    return STEP_LIMIT if full else OK, move


@njit(**INNER)
def decide(problem, w, dt, max_steps):
    """Decide on the step tried on every lane; returns how many lanes need a closer look."""
    widest_vectors()
    special = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        h = lane.h
        accept = lane.error <= 1.0
        if problem.adaptive:
            root = error_root(lane.error)
            lane.root = root
            lane.h_next = h * step_ratio(root, lane.root0, lane.held > 0.0)
        else:
            lane.h_next = dt
        # No 'or': what is behind it would be read under a mask.
        due = (
            may_reverse(h, lane.n0, lane.n1, lane.rate1, lane.rate_max)
            | (lane.last > 0.0)
            | (lane.mode > 0.0)
            | (lane.t + h >= lane.next)
            | (lane.steps >= max_steps)
            | (not accept)
        )
        lane.accept = 1.0 if accept else 0.0
        lane.due = 1.0 if due else 0.0
        special += 1 if due else 0
    return special


@njit(**INNER)
def advance(problem, w):
    """Move all lanes to the end of their step."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        lane.y = lane.y1
        lane.f = lane.f1


@njit(**INNER)
def commit(problem, w):
    """Move all lanes to the end of the step tried, and set their next step.

    Lanes that do not take it were told to :func:`stay`.  Nothing is read or written under a mask,
    which AVX2 does slowly: so nothing is written back as it was, and nothing read for one choice.
    """
    widest_vectors()
    problem.advance(problem, w)
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        n1 = lane.n1
        lane.n0 = n1
        signed = lane.sign * n1
        least = lane.n_least
        lane.n_least = (signed if signed < least else least) + 0.0
        largest = lane.a_max
        now = lane.amplitude
        lane.a_max = (now if now > largest else largest) + 0.0
        lane.root0 = lane.root
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        accept = lane.accept
        lane.steps += accept
        lane.held *= 1.0 - accept
        rate1 = lane.rate1
        lane.rate0 = rate1
        recent = (1.0 - 0.1 * accept) * lane.rate_max
        now = abs(rate1)
        lane.rate_max = now if now > recent else recent
        # Compensated sum: a million steps lose nothing.
        t0 = lane.t
        part = lane.h * accept - lane.t_low
        t1 = t0 + part
        lane.t = t1
        lane.t_low = (t1 - t0) - part
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        # A search holds the step it began with; the others must not pass the horizon.
        h_next = lane.h_next
        searching = 1.0 if lane.mode > 0.0 else 0.0
        left = (lane.t_end - lane.t) + 1e290 * searching
        kept = lane.last * searching
        lane.last = 1.0 if h_next >= left else kept
        lane.h = left if h_next >= left else h_next


@njit(**INNER)
def watch(problem, w, windows, record):
    """Observations that are made at every accepted step only when they are asked for."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        if lane.accept > 0.0:
            if record[C.REC_ENERGY]:
                energy0 = lane.energy0
                drift = abs(energy_at(lane, lane.y1) - energy0) / energy0 if energy0 > 0.0 else 0.0
                lane.drift_max = max(lane.drift_max, drift)
            if record[C.REC_CONTACT]:
                see_contact(lane, lane.y1)
            if record[C.REC_WINDOWS]:
                lane.window_n_min = min(lane.window_n_min, lane.n1)
                lane.window_n_max = max(lane.window_n_max, lane.n1)
            if record[C.REC_REVERSALS]:
                see_side(lane, windows, record)
            if record[C.REC_VOLUME]:
                lane.volume += lane.h * lane.volume_rate1


def work(problem, thread, parts, w, shared, order, y0, constants, probe, plan, options,
         record, result, counts, windows, progress):  # fmt: skip
    """Do what one thread does until the queue is empty or Python says stop.

    Parameters
    ----------
    problem : Problem
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
        or record[C.REC_VOLUME]
    )
    total = order.size
    busy = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        place = fetch_add(shared, 0, 1)
        if place < total:
            problem.start(lane, order[place], y0, constants, probe, plan, record)
            busy += 1
        else:
            idle(lane)
    turns = 0
    while busy > 0:
        call(parts[ATTEMPT], (problem, w, scale))
        special = decide(problem, w, dt, max_steps)
        if special > 0:
            for l in range(problem.lanes):
                lane = lane_of(problem, w, l)
                if lane.due == 0.0:
                    continue
                run = int(lane.run)
                if run < 0:
                    lane.accept = 0.0
                    lane.h_next = 0.0
                    stay(lane)
                    continue
                status, move = call_for_two(parts[DECIDE], (problem, w, l, max_steps, False))
                t = lane.t + (lane.h - lane.t_low)
                if move == REVERSED and record[C.REC_REVERSALS]:
                    # Go on behind the zero, in the same step.
                    see_zero(lane, t)
                    behind, move = call_for_two(parts[DECIDE], (problem, w, l, max_steps, True))
                    status = behind if move == HOLD else status
                reversal = move == REVERSED
                ended = status != OK or reversal
                if move == TAKE and lane.last > 0.0:
                    t = lane.t_end
                    ended = True
                if move == TAKE and not ended and t >= lane.next:
                    problem.pass_marks(lane, t, run, windows, record)
                    ended = settled(lane, plan[run, C.SETTLED])
                if ended:
                    lane.steps += 1.0
                    problem.finish(lane, status, reversal, t, run, result, counts, windows, record)
                    progress[thread, 0] += plan[run, C.COST]
                    progress[thread, 2] += 1.0
                    place = fetch_add(shared, 0, 1)
                    if place < total:
                        problem.start(lane, order[place], y0, constants, probe, plan, record)
                    else:
                        idle(lane)
                        busy -= 1
                    lane.accept = 0.0
                if lane.accept == 0.0:
                    stay(lane)
        if watching:
            watch(problem, w, windows, record)
        commit(problem, w)
        turns += 1
        if turns % 256 == 0:
            if load(shared, 1) != 0:
                return
            under_way = 0.0
            for l in range(problem.lanes):
                lane = lane_of(problem, w, l)
                run = int(lane.run)
                if run >= 0:
                    under_way += min(1.0, lane.t / plan[run, C.HORIZON]) * plan[run, C.COST]
            progress[thread, 1] = under_way
    progress[thread, 1] = 0.0


def drive(address, parts, threads, w, shared, order, y0, constants, probe, plan, options,
          record, result, counts, windows, progress):  # fmt: skip
    """Do :func:`work`, known by its address, on each thread.

    This way the driver is compiled once for all problems, and none is compiled again inside of it.
    A problem has no value, so none is handed over.
    """
    for thread in prange(threads):
        call(
            address,
            (
                thread, parts, w[thread], shared, order, y0, constants, probe, plan, options,
                record, result, counts, windows, progress,
            ),
        )  # fmt: skip
