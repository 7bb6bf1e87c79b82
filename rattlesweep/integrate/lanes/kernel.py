"""The lane kernel: many runs at once, each with its own step.

A thread holds :data:`~rattlesweep.integrate.lanes.lane.LANES` runs.  Every turn tries
one step on all of them (the generated ``attempt``) and decides on all of them, in loops
over lanes that vectorise.  It looks closer only at lanes where something is due: a
rejection, a possible zero of the spin, the end of a window or of the run.  A lane whose
run has ended takes the next run from a queue that all threads share.  The arithmetic of
a run depends on its own numbers alone, so it yields the same bits in any lane, thread
and batch.

``attempt`` is compiled for each method and model, :func:`decide_closely` once for all
models.  Both are called by their addresses (``parts``), in sweeps and in trajectories.
"""

# mypy: ignore-errors
from math import isfinite, sqrt

import numpy as np
from numba import njit, prange

from rattlesweep.integrate.lanes import events, runs
from rattlesweep.integrate.lanes.events import (
    HOLD,
    PEAK,
    REVERSED,
    STEP,
    TAKE,
    may_reverse,
)
from rattlesweep.integrate.lanes.lane import (
    INNER,
    Point,
    call,
    call_for_pair,
    fetch_add,
    lane_of,
    widest_vectors,
)
from rattlesweep.integrate.status import Status

OK, NONFINITE = int(Status.OK), int(Status.NONFINITE)
STEP_LIMIT, STEP_TOO_SMALL = int(Status.STEP_LIMIT), int(Status.STEP_TOO_SMALL)
# Indices into ``parts``: the addresses of ``attempt`` and of :func:`decide_closely`.
ATTEMPT, DECIDE, PARTS = 0, 1, 2
# Stages of :func:`decide_closely`.
SPIN, AFTER_ZERO, PEAKS = 0, 1, 2

# Step size control.  Errors are squared and in units of the tolerance. First step for a
# tolerance of 1, and least step, in radians of the fastest swing of the spin.
FIRST_ANGLE, LEAST_ANGLE = 6.0, 1e-9
SAFETY, SAFETY_REJECTED = 0.95, 0.85
# Least ratio of two steps after a rejection; the least error limits the ratio to 7.3
# otherwise.
SHRINK, LEAST_ERROR = 0.2, 1e-30
OFFSET = np.uint64(
    (1023 << 52) - (1023 << 46)
)  # for `rough_root` of 1, where 1023 << 52 is 1.0


def decide_closely(problem, w, l, max_steps, stage):
    """Decide on the step tried on lane ``l``, where something is due; return a status
    and a move.

    The problem has no model.  In the stage ``AFTER_ZERO``, the step tried ends at a zero
    of the spin, and the search continues after it; in the stage ``PEAKS``, the step is
    to be taken, and extremes in it are searched.  The status is OK if the run goes on.  The
    move is HOLD (the step is not taken), TAKE, or REVERSED (the step is taken and ends
    at a zero).
    """
    lane = lane_of(problem, w, l)
    if stage != SPIN:
        if stage == PEAKS:
            move = events.climb(lane)
        else:
            move = events.search_on(lane, lane.h)
        lane.accept = 0.0 if move == HOLD else 1.0
        return OK, move
    if lane.mode == STEP and lane.accept == 0.0:
        lane.rejected += 1.0
        lane.held = 1.0
        # If the error is NaN, the comparison below is false, and the step shrinks by
        # SHRINK.
        ratio = SAFETY_REJECTED / sqrt(sqrt(sqrt(sqrt(lane.error + LEAST_ERROR))))
        lane.h_next = lane.h * (ratio if ratio > SHRINK else SHRINK)
        status = OK
        if not problem.adaptive:
            status = NONFINITE
        elif lane.steps + lane.rejected >= max_steps:
            status = STEP_LIMIT
        elif lane.h * lane.swing < LEAST_ANGLE:
            status = STEP_TOO_SMALL if isfinite(lane.error) else NONFINITE
        return status, HOLD
    move = TAKE
    if lane.arm > 0.0:
        # No zero counts yet; UNKNOWN_RATE makes every step due (`may_reverse`).
        lane.rate_max = runs.UNKNOWN_RATE
        if abs(lane.n1) > lane.arm:
            lane.arm = 0.0
            lane.sign = 1.0 if lane.n1 > 0.0 else -1.0
            lane.rate_max = lane.arm_rate
    elif lane.mode != STEP or may_reverse(
        lane.h, lane.n0, lane.n1, lane.rate1, lane.rate_max
    ):
        move = events.search(lane, Point(lane.h, lane.n1, lane.rate1))
    lane.accept = 0.0 if move == HOLD else 1.0
    return STEP_LIMIT if move != HOLD and lane.steps >= max_steps else OK, move


@njit(**INNER)
def rough_root(x):
    """Return roughly ``x^(1/64)`` of a positive number, by dividing its bits as a
    logarithm.

    The result is 0 to 6.2 % too large, as ``1 + m`` replaces ``2^m``, and rises with
    ``x``.
    """
    bits = np.float64(x).view(np.uint64) >> np.uint64(6)
    return np.uint64(bits + OFFSET).view(np.float64)


@njit(**INNER)
def decide(problem, w, dt, max_steps):
    """Decide on the step tried on every lane, and return how many lanes need a closer
    look.
    """
    widest_vectors()
    special = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        h = lane.h
        accept = lane.error <= 1.0
        if problem.adaptive:
            # PI control of low gain (docs/design.md); no growth right after a
            # rejection.
            root = rough_root(lane.error + LEAST_ERROR)
            ratio = SAFETY * lane.root0 / (root * root)
            lane.root = root
            lane.h_next = h * (1.0 if (lane.held > 0.0) & (ratio > 1.0) else ratio)
        else:
            lane.h_next = dt
        # With 'or' instead of '|' the later operands would be loaded under a mask.
        due = (
            may_reverse(h, lane.n0, lane.n1, lane.rate1, lane.rate_max)
            | (lane.last > 0.0)
            | (lane.mode > 0.0)
            | (lane.t + h >= lane.next)
            | (lane.steps >= max_steps)
            | (lane.peak > 0.0)
            | (not accept)
        )
        lane.accept = 1.0 if accept else 0.0
        lane.due = 1.0 if due else 0.0
        special += 1 if due else 0
    return special


@njit(**INNER)
def commit(problem, w):
    """Move all lanes to the end of the step tried, and set their next step.

    No load or store is masked, as masked ones are slow with AVX2.
    """
    widest_vectors()
    problem.advance(problem, w)
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        n1 = lane.n1
        lane.n0 = n1
        signed, least = lane.sign * n1, lane.n_least
        lane.n_least = (signed if signed < least else least) + 0.0
        now, largest = lane.amplitude, lane.a_max
        lane.a_max = (now if now > largest else largest) + 0.0
        lane.root0 = lane.root
        lane.peak = 0.0
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
        # Compensated sum, so that a million steps do not add up rounding errors.
        t0 = lane.t
        part = lane.h * accept - lane.t_low
        t1 = t0 + part
        lane.t = t1
        lane.t_low = (t1 - t0) - part
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        # Steps of a search stay within the step it began with; others must not pass the
        # horizon.
        h_next = lane.h_next
        searching = 1.0 if lane.mode > 0.0 else 0.0
        left = (lane.t_end - lane.t) + 1e290 * searching
        kept = lane.last * searching
        lane.last = 1.0 if h_next >= left else kept
        lane.h = left if h_next >= left else h_next


@njit(**INNER)
def watch(problem, w, windows, record):
    """Update the records of lanes whose step was accepted."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        if lane.accept == 0.0:
            continue
        if record[runs.REC_ENERGY] and lane.energy0 > 0.0:
            off = abs(runs.energy_at(lane, lane.y1) - lane.energy0)
            lane.drift_max = max(lane.drift_max, off / lane.energy0)
        if record[runs.REC_CONTACT]:
            runs.note_contact(lane)
            lane.ratio0 = Point(0.0, lane.ratio1.n, lane.ratio1.rate)
            lane.lift0 = Point(0.0, lane.lift1.n, lane.lift1.rate)
        if record[runs.REC_WINDOWS]:
            lane.window_n_min = min(lane.window_n_min, lane.n1)
            lane.window_n_max = max(lane.window_n_max, lane.n1)
        if record[runs.REC_REVERSALS]:
            runs.note_side(lane, windows, record)
        if record[runs.REC_VOLUME]:
            lane.volume += lane.h * lane.volume_rate1


@njit(**INNER)
def look_closer(problem, parts, w, l, max_steps, record):
    """Decide on the step tried on lane ``l``; return a status and a move."""
    lane = lane_of(problem, w, l)
    if lane.mode < PEAK:
        status, move = call_for_pair(parts[DECIDE], (problem, w, l, max_steps, SPIN))
        if move == REVERSED and record[runs.REC_REVERSALS]:
            # Go on after the zero, in the same step.
            runs.note_zero(lane, lane.t + (lane.h - lane.t_low))
            later, move = call_for_pair(
                parts[DECIDE], (problem, w, l, max_steps, AFTER_ZERO)
            )
            status = later if move == HOLD else status
        if status != OK or move == HOLD or lane.peak == 0.0:
            return status, move
        lane.move = move
    return call_for_pair(parts[DECIDE], (problem, w, l, max_steps, PEAKS))


def work(
    problem,
    thread,
    parts,
    w,
    shared,
    order,
    y0,
    constants,
    probe,
    plan,
    options,
    record,
    result,
    counts,
    windows,
    progress,
):
    """Integrate runs of the queue in one thread, until the queue is empty or Python
    asks to stop.

    ``thread`` is the row of ``progress`` that it writes: the expected cost of its runs
    that have ended, the part done of the expected cost of those in its lanes, and the
    number of runs that have ended.  ``parts`` are addresses, ``w`` is the thread's
    workspace, ``order`` the queue, and ``shared`` holds the next place in the queue and
    the stop flag.
    """
    widest_vectors()
    scale, dt, max_steps = options[0], options[1], options[2]
    watching = record.any()
    total = order.size
    busy = 0
    for l in range(problem.lanes):
        place = fetch_add(shared, 0, 1)
        if place < total:
            run = order[place]
            problem.start(
                lane_of(problem, w, l), run, y0, constants, probe, plan, record
            )
            busy += 1
        else:
            runs.idle(lane_of(problem, w, l))
    turns = 0
    while busy > 0:
        call(parts[ATTEMPT], (problem, w, scale))
        if record[runs.REC_CONTACT]:
            runs.observe_contact(problem, w)
        if record[runs.REC_REVERSALS]:
            runs.observe_spin(problem, w)
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
                    runs.hold_back(lane)
                    continue
                status, move = look_closer(problem, parts, w, l, max_steps, record)
                t = lane.t + (lane.h - lane.t_low)
                reversal = move == REVERSED
                ended = status != OK or reversal
                if move == TAKE and lane.last > 0.0:
                    t = lane.t_end
                    ended = True
                if move == TAKE and not ended and t >= lane.next:
                    problem.pass_marks(lane, t, run, windows, record)
                    ended = runs.settled(lane, plan[run, runs.SETTLED])
                if ended:
                    lane.steps += 1.0
                    problem.finish(
                        lane, status, reversal, t, run, result, counts, windows, record
                    )
                    progress[thread, 0] += plan[run, runs.COST]
                    progress[thread, 2] += 1.0
                    place = fetch_add(shared, 0, 1)
                    if place < total:
                        problem.start(
                            lane, order[place], y0, constants, probe, plan, record
                        )
                    else:
                        runs.idle(lane)
                        busy -= 1
                    lane.accept = 0.0
                if lane.accept == 0.0:
                    runs.hold_back(lane)
        if watching:
            watch(problem, w, windows, record)
        commit(problem, w)
        turns += 1
        if turns % 256 == 0:
            if fetch_add(shared, 1, 0) != 0:
                return
            under_way = 0.0
            for l in range(problem.lanes):
                lane = lane_of(problem, w, l)
                run = int(lane.run)
                if run >= 0:
                    under_way += (
                        min(1.0, lane.t / plan[run, runs.HORIZON])
                        * plan[run, runs.COST]
                    )
            progress[thread, 1] = under_way
    progress[thread, 1] = 0.0


def drive(address, parts, threads, w, shared):
    """Call :func:`work` by its address on each thread, so that one driver serves all
    problems.
    """
    for thread in prange(threads):
        call(address, (thread, parts, w[thread]) + shared)  # noqa: RUF005
