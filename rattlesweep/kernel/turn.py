"""The lane kernel: many runs at once, each with its own step.

A thread holds :data:`~rattlesweep.kernel.state.fields.LANES` runs.  Every turn tries
one step on all of them (the generated ``attempt``) and decides on all of them, in loops
over lanes that vectorise.  It looks closer only at lanes where something is due: a
rejection, a possible zero of the spin, the end of a window or of the run.  A lane whose
run has ended takes the next run from a queue that all threads share.  The arithmetic of
a run depends on its own numbers alone, so it yields the same bits in any lane, thread
and batch.

All this is compiled once for all models.  What depends on the model lies in ``parts``,
which are called by their addresses: ``attempt``, compiled for each method and model,
`answer.answer` for each model, and others where a model or a record needs them.
:func:`look_closer` is such a part, too, as sweeps (:func:`work_off`) and trajectories
(`recorder.record_steps`) are made of the same turns: :func:`try_step`,
:func:`look_closer` at the lanes that are due, :func:`commit`.
"""

# mypy: ignore-errors
from math import isfinite, sqrt
from typing import NamedTuple

from numba import njit, prange

from rattlesweep.compiling.intrinsics import (
    INLINED,
    INNER,
    call,
    call_for_pair,
    fetch_add,
    lowest_bit,
    rough_root,
    widest_vectors,
)
from rattlesweep.kernel import answer, runs
from rattlesweep.kernel.event import looks, peaks, zeros
from rattlesweep.kernel.event.zeros import (
    ARRIVED,
    HOLD,
    REVERSED,
    TAKE,
    may_reverse,
)
from rattlesweep.kernel.look import extremes, late, put_off
from rattlesweep.kernel.look.extremes import ROLLED, STEPPED, may_be_far
from rattlesweep.kernel.look.marks import note_mark
from rattlesweep.kernel.state.fields import (
    GROUP,
    NEVER,
    PEAK,
    PUT_OFF,
    STEP,
    Point,
)
from rattlesweep.kernel.state.lane import lane_of, recorded
from rattlesweep.kernel.state.statuses import (
    AT_LIMIT,
    NONFINITE,
    OK,
    RIM,
    STEP_LIMIT,
    STEP_TOO_SMALL,
)
from rattlesweep.kernel.state.ways import (
    counts_zeros,
    keeps_zero,
    steps_in_rack,
    turns_at_zero,
)
from rattlesweep.kernel.step import slots
from rattlesweep.kernel.step.radau import WIDTH


class Options(NamedTuple):
    """How a kernel integrates."""

    scale: float  # 1 / tol^2
    fixed_step: float  # of SUBSTEPS substeps
    most_steps: float


# Indices into ``parts``: the addresses of ``attempt``, of :func:`look_closer`, of
# `answer.answer`; of `answer.answer_for_all` for models with modes or tangents, of
# `slots.slide_lanes` for a model that slides, of `notes.note_step` where something is
# noted that depends on the model, of `tangents.note_growth` for models with tangents;
# of `looks.LOOKS_AT` where steps are looked into.  Others are 0.
ATTEMPT, CLOSER, ANSWER, ANSWER_FOR_ALL, SLIDE, NOTE, GROWTH, FIRST_LOOK = range(8)
N_PARTS = FIRST_LOOK + len(looks.LOOKS_AT)
# Stages of :func:`decide_closely`: the zeros in a step tried, those after an event that
# was found in it, the extremes in a step that is to be taken.
ZEROS, AFTER_EVENT, PEAKS = 0, 1, 2
# Columns of ``progress``, which each thread writes in its row: the expected cost of its
# runs that have ended, the part done of the expected cost of those in its lanes, the
# number of runs that have ended.
COST_DONE, COST_UNDER_WAY, ENDED = range(3)
# Places in ``shared``: the next place in the queue, the stop flag.
NEXT_PLACE, STOP = 0, 1
TURNS_PER_REPORT = 256

# Step size control.  Errors are squared and in units of the tolerance. First step for a
# tolerance of 1, and least step, in radians of the fastest swing of the spin.
FIRST_STEP_ANGLE = 6.0
LEAST_ANGLE = 1e-9
SAFETY = 0.95
SAFETY_REJECTED = 0.85
# Least ratio of two steps after a rejection; the least error limits the ratio to 7.3
# otherwise.
SHRINK = 0.2
LEAST_ERROR = 1e-30


@njit(**INNER)
def ask(parts, asked, w, l):
    """Ask the model of lane ``l`` for what changes neither a status nor a move."""
    call_for_pair(parts[ANSWER], (asked, w, l, OK, HOLD, False, False))


@njit(**INNER)
def reject(traits, lane, max_steps):
    """Let the step just tried be tried again, and shorter; return a status."""
    lane.rejected += 1.0
    lane.held = 1.0
    # If the error is NaN, this comparison is false, and the step shrinks by SHRINK.
    ratio = SAFETY_REJECTED / sqrt(sqrt(sqrt(sqrt(lane.error + LEAST_ERROR))))
    lane.h_next = lane.h * (ratio if ratio > SHRINK else SHRINK)
    if not traits.adaptive:
        return NONFINITE
    if lane.steps + lane.rejected >= max_steps:
        return STEP_LIMIT
    if lane.h * lane.swing < LEAST_ANGLE:
        return STEP_TOO_SMALL if isfinite(lane.error) else NONFINITE
    return OK


@njit(**INNER)
def decide_closely(problem, traits, w, l, max_steps, stage):
    """Decide on the step tried on a lane where something is due.

    Returns a status, which is OK if the run goes on, and a
    move: HOLD (the step is not taken), TAKE, REVERSED (the step is taken and ends at a
    zero of the spin), or ARRIVED (the spin is as far as awaited within the step).
    """
    lane = lane_of(problem, w, l)
    if stage == ZEROS:
        move = search_zeros(lane)
    elif stage == AFTER_EVENT:
        move = zeros.search_on(lane, lane.h)
    else:
        move = peaks.search_peaks(problem, traits, w, l)
    lane.accept = 0.0 if move == HOLD else 1.0
    if move == HOLD:
        return OK, HOLD
    if move == TAKE and lane.h == lane.h_limit:
        # The step that is taken ends at the limit of its mode.
        return AT_LIMIT, TAKE
    return STEP_LIMIT if lane.steps >= max_steps else OK, move


@njit(**INNER)
def search_zeros(lane):
    """Make one move of the searches for zeros in the step just tried."""
    move = TAKE
    if lane.search == STEP:
        # No step has this size; one that ends at a limit may have the size zero.
        lane.h_limit = -1.0
        if lane.arm > 0.0:
            # No zero counts yet; UNKNOWN_RATE makes every step due (`may_reverse`).
            lane.rate_max = runs.UNKNOWN_RATE
            lane.far_rate = max(0.9 * lane.far_rate, abs(lane.rate1))
    reverses = may_reverse(lane.h, lane.n0, lane.n1, lane.rate1, lane.rate_max)
    leaves = lane.leaves > 0.0 or (turns_at_zero(lane) and reverses)
    if lane.searched == zeros.LIMIT or (lane.search == STEP and leaves):
        move = zeros.search_limit(lane)
    if move != TAKE:
        return move
    crosses = reverses and counts_zeros(lane) and lane.sign != 0.0
    if lane.search == STEP and not crosses and not may_be_far(lane):
        return TAKE
    start = Point(0.0, lane.n0, lane.rate0)
    return zeros.search(lane, start, Point(lane.h, lane.n1, lane.rate1))


def deciding(adaptive: bool):
    """Return the loop that decides on the steps of adaptive methods, or of others."""

    @njit(**INLINED)
    def decide_all(problem, w, dt, max_steps):
        widest_vectors()
        bits = 0
        for l in range(problem.lanes):
            lane = lane_of(problem, w, l)
            h = lane.h
            error = lane.error
            accept = error <= 1.0
            root = 1.0
            h_next = dt
            if adaptive:
                # PI control of low gain (docs/design.md); no growth right after a
                # rejection.
                root = rough_root(error + LEAST_ERROR)
                ratio = SAFETY * lane.root0 / (root * root)
                h_next = h * (1.0 if (lane.held > 0.0) & (ratio > 1.0) else ratio)
                longest = lane.h_longest
                h_next = h_next if h_next < longest else longest
            reverses = may_reverse(h, lane.n0, lane.n1, lane.rate1, lane.rate_max)
            # A spin that is held does not reverse, nor one of which no zero counts.
            reverses &= (lane.sign != 0.0) & (not keeps_zero(lane))
            # With 'or' instead of '|' the later operands would be loaded under a mask.
            due = (
                reverses
                | (lane.last > 0.0)
                | (lane.search > 0.0)
                | (lane.t + h >= lane.next)
                | (lane.steps >= max_steps)
                | (lane.watched > 0.0)
                | (not accept)
            )
            bits |= (1 if due else 0) << l
            lane.h_next = h_next
            lane.root = root
            lane.accept = 1.0 if accept else 0.0
        return bits

    return decide_all


decide_adaptive = deciding(True)
decide_fixed = deciding(False)


@njit(**INLINED)
def decide(problem, traits, w, dt, max_steps):
    """Decide on the step tried on every lane, and return which lanes are due, as bits.

    Of a lane all is read before any is written (:func:`commit`).
    """
    if traits.adaptive:
        return decide_adaptive(problem, w, dt, max_steps)
    return decide_fixed(problem, w, dt, max_steps)


@njit(**INNER)
def commit(problem, traits, parts, w):
    """Move all lanes to the end of the step tried, and set their next step.

    No load or store is masked, as masked ones are slow with AVX2.  All of a lane is
    read before any of it is written: a processor lets a load wait for an earlier store
    to an address that is the same modulo 4 KiB, as it is 16 rows further.
    """
    widest_vectors()
    runs.advance(problem, traits, w)
    if traits.advances:
        call_for_pair(parts[ANSWER_FOR_ALL], (answer.ADVANCE, w, 0))
    move_on(problem, w)


@njit(**INNER)
def move_on(problem, w):
    """Let the times and sizes of all lanes be those of their next step."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        accept = lane.accept
        steps = lane.steps
        held = lane.held
        root = lane.root
        n1 = lane.n1
        signed = lane.sign * n1
        least = lane.n_least
        now = lane.amplitude
        largest = lane.a_max
        rate1 = lane.rate1
        rate = abs(rate1)
        recent = (1.0 - 0.1 * accept) * lane.rate_max
        # Compensated sum, so that a million steps do not add up rounding errors.
        t0 = lane.t
        part = lane.h * accept - lane.t_low
        t1 = t0 + part
        # Steps of a search stay within the step it began with; others must not pass the
        # horizon.
        h_next = lane.h_next
        searching = 1.0 if lane.search > 0.0 else 0.0
        left = (lane.t_end - t1) + NEVER * searching
        kept = lane.last * searching
        lane.steps = steps + accept
        lane.held = held * (1.0 - accept)
        lane.root0 = root
        lane.n0 = n1
        lane.n_least = (signed if signed < least else least) + 0.0
        lane.a_max = (now if now > largest else largest) + 0.0
        lane.rate0 = rate1
        lane.rate_max = rate if rate > recent else recent
        lane.t = t1
        lane.t_low = (t1 - t0) - part
        lane.last = 1.0 if h_next >= left else kept
        lane.h = left if h_next >= left else h_next
        lane.watched = 0.0


@njit(**INNER)
def watch(problem, traits, parts, w, recording):
    """Update the records of lanes whose step was accepted."""
    if traits.limited:
        runs.advance_limit(problem, w)
    if recorded(recording.contact):
        put_off.keep_steps(problem, traits, w)
    extremes.advance(problem, w, recording)
    if not takes_each(parts, recording):
        return
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        if lane.accept == 0.0:
            continue
        if recorded(recording.energy) and lane.energy0 > 0.0:
            ask(parts, answer.MEASURE, w, l)
            if traits.lifts:
                runs.note_energy(lane)
            off = abs(lane.energy1 - lane.energy0)
            scale = runs.scale_of_energy(traits, lane)
            lane.drift_max = max(lane.drift_max, off / scale)
        if parts[NOTE] != 0:
            casimir = recording.casimir
            noted = recorded(recording.late), recorded(casimir), False
            call(parts[NOTE], (w, l, *noted, casimir))
        if recorded(recording.windows):
            lane.window_n_min = min(lane.window_n_min, lane.n1)
            lane.window_n_max = max(lane.window_n_max, lane.n1)
        if recorded(recording.reversals):
            runs.note_turn(lane, recording.reversals)
        if recorded(recording.volume):
            lane.volume += lane.h * lane.volume_rate1


@njit(**INNER)
def is_recording(parts, recording):
    """Return whether something is recorded of each accepted step."""
    return recorded(recording.contact) or takes_each(parts, recording)


@njit(**INNER)
def takes_each(parts, recording):
    """Return whether accepted steps are recorded lane by lane."""
    return (
        recorded(recording.energy)
        or recorded(recording.reversals)
        or recorded(recording.windows)
        or recorded(recording.volume)
        or parts[NOTE] != 0
    )


@njit(**INNER)
def watch_far(problem, w):
    """Watch lanes on which the spin may reach the awaited modulus in the step tried."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        lane.watched += 1.0 if may_be_far(lane) else 0.0


@njit(**INLINED)
def look(parts, w, stage, may_put_off, recording):
    """Look into the steps tried on all lanes, at a stage of the turn."""
    for k in range(FIRST_LOOK, N_PARTS):
        if parts[k] != 0:
            call(parts[k], (w, stage, may_put_off, recording.marks))


@njit(**INLINED)
def try_step(problem, traits, parts, w, options, recording, used, may_put_off):
    """Try a step on the first lanes, decide on it, and return which of them are due.

    The first ``used`` lanes are whole groups.  Lanes may wait for a turn that more
    lanes share (`slots.schedule_slides`).  ``may_put_off`` says whether searches for
    extremes may be put off to the end of the run (`look.put_off`).
    """
    rolls = True
    some_slide = False
    if traits.schedules:
        scheduled = call_for_pair(parts[ANSWER_FOR_ALL], (answer.SCHEDULE, w, 0))
        rolls = scheduled[0] != 0
        some_slide = scheduled[1] != 0
    if rolls:
        call(parts[ATTEMPT], (w, options.scale, used))
        if traits.limited:
            call_for_pair(parts[ANSWER_FOR_ALL], (answer.OBSERVE, w, used))
        look(parts, w, ROLLED, may_put_off, recording)
    if some_slide:
        # Lanes that slide replace what was done to them.
        fewest = slots.FEWEST_SLIDING if rolls else WIDTH
        call(parts[SLIDE], (w, options.scale, recorded(recording.contact), fewest))
    if recorded(recording.reversals):
        watch_far(problem, w)
    look(parts, w, STEPPED, may_put_off, recording)
    due = decide(problem, traits, w, options.fixed_step, options.most_steps)
    if some_slide:
        due, _ = call_for_pair(parts[ANSWER_FOR_ALL], (answer.DECIDE, w, due))
    return due & ((1 << used) - 1)


def look_closer(problem, traits, parts, w, l, max_steps, goes_on, reversals, marks):
    """Decide on the step tried on lane ``l``, which is due; return a status and a move.

    At a limit the lane may change its mode.  ``goes_on`` says whether the run goes on
    after a zero of the spin; ``reversals`` and ``marks`` are recorded if they have
    runs.
    """
    lane = lane_of(problem, w, l)
    if lane.refused0 > 0.0:
        # It was launched beyond the rim or off the plane, and ends there.
        lane.accept = 0.0
        lane.h = 0.0
        lane.last = 0.0
        runs.hold_back(problem, traits, w, l)
        return int(lane.refused0), TAKE
    if lane.dead > 0.0:
        ask(parts, answer.MEASURE, w, l)
    if traits.limited:
        ask(parts, answer.LIMIT, w, l)
    settings = max_steps, goes_on, reversals, marks
    status, move = search_closely(problem, traits, w, l, *settings)
    if status in (OK, AT_LIMIT) and runs.stalls(lane, move != HOLD):
        status = STEP_TOO_SMALL
        move = HOLD
        # The last point tried is no end of a step.
        lane.h = 0.0
        runs.hold_back(problem, traits, w, l)
    if status == AT_LIMIT:
        # The step ends before the horizon.
        lane.last = 0.0
    if traits.limited and (status != OK or move != HOLD):
        changed = answer.CHANGE, w, l, status, move, goes_on, recorded(reversals)
        return call_for_pair(parts[ANSWER], changed)
    return status, move


@njit(**INNER)
def search_closely(problem, traits, w, l, max_steps, goes_on, reversals, marks):
    """Search the step tried on a lane; return a status and a move.

    First come zeros, which say where the step ends, and then, if it is taken, extremes
    and marks within it.
    """
    lane = lane_of(problem, w, l)
    if lane.search == STEP and lane.accept == 0.0:
        return reject(traits, lane, max_steps), HOLD
    where = problem, traits, w, l
    if lane.search == PUT_OFF:
        if peaks.search_kept(*where):
            return OK, HOLD
        return int(lane.end_status), int(lane.move)
    if lane.search < PEAK:
        status, move = decide_closely(*where, max_steps, ZEROS)
        while move == ARRIVED or (move == REVERSED and goes_on):
            if move == ARRIVED:
                runs.note_far(lane, reversals)
            else:
                t = lane.t + (lane.h - lane.t_low)
                runs.note_zero(lane, t, recorded(reversals))
            status, move = decide_closely(*where, max_steps, AFTER_EVENT)
        if move == TAKE and lane.t_zero >= 0.0 and not recorded(reversals):
            # Only the first zero is asked for.
            lane.sign = 0.0
        # What to return once the extremes are found.
        lane.move = move
        if status not in (OK, AT_LIMIT) or move == HOLD or lane.watched == 0.0:
            return status, move
    status, move = decide_closely(*where, max_steps, PEAKS)
    if recorded(marks):
        note_mark(lane, marks)
    return status, move


@njit(**INNER)
def call_closer(traits, parts, w, l, max_steps, recording):
    """Call :func:`look_closer` by its address."""
    goes_on = runs.goes_on(traits, recording)
    recorded_there = goes_on, recording.reversals, recording.marks
    return call_for_pair(
        parts[CLOSER], (traits, parts, w, l, max_steps, *recorded_there)
    )


@njit(**INNER)
def compare_at(problem, traits, parts, w, l, t, recording):
    """Make the comparisons and close the windows that are due by time ``t``."""
    lane = lane_of(problem, w, l)
    run = int(lane.run)
    if traits.has_tangents:
        row = runs.growth_row(lane, t)
        if row < recording.lyapunov.shape[1]:
            call(parts[GROWTH], (w, l, t, row, recording.lyapunov))
    if traits.lifts and t >= lane.window_end:
        ask(parts, answer.MEASURE, w, l)
        runs.note_energy(lane)
    runs.compare_due(lane, t, run, recording)


@njit(**INNER)
def settled(parts, w, l, lane):
    """Return whether no amplitude grew in two windows and the oscillation is small."""
    most = lane.settled
    if most == 0.0 or lane.window_no < 2.0 or lane.growth > 1.0 or lane.t_zero >= 0.0:
        return False
    ask(parts, answer.SETTLE, w, l)
    return lane.oscillation1 <= most


@njit(**INNER)
def start_run(problem, traits, parts, w, l, run, inputs):
    """Begin a run in lane ``l``."""
    runs.start(problem, traits, w, l, run, inputs)
    ask(parts, answer.BEGIN, w, l)


@njit(**INNER)
def empty_lane(problem, traits, parts, w, l):
    """Empty a lane."""
    runs.clear(problem, traits, w, l)
    ask(parts, answer.IDLE, w, l)


@njit(**INNER)
def end_run(problem, traits, parts, w, l, status, reversal, t, outputs, recording):
    """Store the results of a run that ends with the step just tried, at time ``t``."""
    lane = lane_of(problem, w, l)
    run = int(lane.run)
    if traits.has_tangents:
        row = runs.window_row(lane)
        call(parts[GROWTH], (w, l, t, row, recording.lyapunov))
    lane.t_ended = t
    ask(parts, answer.END, w, l)
    status = runs.finish(problem, traits, w, l, status, reversal, t, outputs, recording)
    casimir = recording.casimir
    if recorded(recording.late) and status == OK and t >= lane.t_end:
        call(parts[NOTE], (w, l, True, False, False, casimir))
        mean, deviation = late.mean_and_deviation(lane)
        recording.late[run, 0, 0] = mean
        recording.late[run, 0, 1] = deviation
    if recorded(casimir):
        is_sound = status in (OK, AT_LIMIT, RIM)
        call(parts[NOTE], (w, l, False, is_sound, True, casimir))


@njit(**INNER)
def under_way(problem, w):
    """Return the part done of the expected cost of the runs in the lanes."""
    done = 0.0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        if lane.run >= 0.0:
            done += min(1.0, lane.t / lane.horizon) * lane.cost
    return done


@njit(**INNER)
def next_run(problem, traits, parts, w, l, shared, order, inputs):
    """Start the next run of the queue in a lane; return whether there was one."""
    place = fetch_add(shared, NEXT_PLACE, 1)
    if place < order.size:
        start_run(problem, traits, parts, w, l, order[place], inputs)
        return True
    empty_lane(problem, traits, parts, w, l)
    return False


@njit(**INNER)
def close_ranks(problem, traits, parts, w, used):
    """Let the last runs of a thread lie in the first lanes; return how many are used.

    A lane that slides stays where it is, as its step may be in a rack.
    """
    free = 0
    for l in range(used - 1, -1, -1):
        lane = lane_of(problem, w, l)
        if lane.run >= 0.0 and not steps_in_rack(lane):
            while free < l and lane_of(problem, w, free).run >= 0.0:
                free += 1
            if free < l:
                for k in range(traits.n_fields):
                    w[k * problem.lanes + free] = w[k * problem.lanes + l]
                empty_lane(problem, traits, parts, w, l)
        if lane.run >= 0.0:
            return (l // GROUP + 1) * GROUP
    return 0


def work_off(
    problem,
    traits,
    thread,
    parts,
    w,
    shared,
    order,
    inputs,
    options,
    progress,
    outputs,
    recording,
):
    """Integrate runs of the queue in one thread, until it is empty or a stop is asked.

    The problem has no model, which ``traits`` and ``parts`` stand for; ``w`` is the
    thread's workspace, ``order`` the queue.
    """
    widest_vectors()
    watching = traits.limited or is_recording(parts, recording)
    max_steps = options.most_steps
    # What is noted when a run has ended needs the start of its last step.
    may_put_off = parts[NOTE] == 0
    busy = 0
    for l in range(problem.lanes):
        if next_run(problem, traits, parts, w, l, shared, order, inputs):
            busy += 1
    turns = 0
    used = problem.lanes
    while busy > 0:
        due = try_step(problem, traits, parts, w, options, recording, used, may_put_off)
        while due != 0:
            l = lowest_bit(due)
            due &= due - 1
            lane = lane_of(problem, w, l)
            if lane.run < 0.0:
                runs.stay_empty(problem, traits, w, l)
                continue
            status, move = call_closer(traits, parts, w, l, max_steps, recording)
            t = lane.t + (lane.h - lane.t_low)
            reversal = move == REVERSED
            is_last = lane.ends > 0.0 and move != HOLD
            ended = status != OK or reversal or is_last
            if move == TAKE and lane.last > 0.0 and status != AT_LIMIT:
                t = lane.t_end
                ended = True
            if move == TAKE and not ended and t >= lane.next:
                compare_at(problem, traits, parts, w, l, t, recording)
                ended = settled(parts, w, l, lane)
            if ended and peaks.begin_kept(problem, traits, w, l, status, move):
                ended = False
            if ended:
                lane.steps += 1.0
                end_run(
                    problem,
                    traits,
                    parts,
                    w,
                    l,
                    status,
                    reversal,
                    t,
                    outputs,
                    recording,
                )
                progress[thread, COST_DONE] += lane.cost
                progress[thread, ENDED] += 1.0
                if not next_run(problem, traits, parts, w, l, shared, order, inputs):
                    busy -= 1
                lane.accept = 0.0
            if lane.accept == 0.0:
                runs.hold_back(problem, traits, w, l)
        if watching:
            watch(problem, traits, parts, w, recording)
        commit(problem, traits, parts, w)
        if used - busy >= GROUP:
            used = close_ranks(problem, traits, parts, w, used)
        turns += 1
        if turns % TURNS_PER_REPORT == 0:
            if fetch_add(shared, STOP, 0) != 0:
                return
            progress[thread, COST_UNDER_WAY] = under_way(problem, w)
    progress[thread, COST_UNDER_WAY] = 0.0


def drive(
    address,
    traits,
    parts,
    threads,
    w,
    shared,
    order,
    inputs,
    options,
    progress,
    outputs,
    recording,
):
    """Call :func:`work_off` by its address on each thread."""
    for thread in prange(threads):
        own = traits, thread, parts, w[thread]
        common = shared, order, inputs, options, progress, outputs, recording
        call(address, own + common)
