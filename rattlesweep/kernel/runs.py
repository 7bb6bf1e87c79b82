"""A run in a lane: its start, what is observed at its steps, its end."""

# mypy: ignore-errors
from dataclasses import dataclass
from math import isfinite, nan, sqrt
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rattlesweep.arrays import Floats, Integers
from rattlesweep.compiling.intrinsics import INNER, apart, copy_numbers, widest_vectors
from rattlesweep.kernel.look import extremes
from rattlesweep.kernel.state.fields import (
    MOST_REVERSALS,
    NEVER,
    NO_ROW,
    STEP,
    Flag,
    Number,
    OfEnd,
    Point,
)
from rattlesweep.kernel.state.lane import lane_of, recorded
from rattlesweep.kernel.state.statuses import AT_LIMIT, ENERGY_OFF, NONFINITE, OK, RIM
from rattlesweep.kernel.state.ways import keeps_zero, steps_in_rack
from rattlesweep.physics.full import TINY

N_WINDOWS = 64  # windows that are stored
# Types of the numbers in arrays of results.
NUMBER_OF: dict[Any, type] = {Floats: float, Integers: int, NDArray[np.int32]: np.int32}


class StartFields:
    """What a run begins with; a row of the table of starts has these numbers."""

    horizon: Number
    swing: Number  # fastest angular frequency of the spin
    window: Number  # length of the windows whose amplitudes are compared
    rate: Number  # bound of the spin's rate in the first steps
    first_step: Number
    longest_step: Number
    cost: Number  # expected
    fuzz: Number  # depth of an undecided extremum, relative to the swing
    comparison: Number  # time of the next comparison of amplitudes in the first window
    far: Number  # modulus beyond which the spin counts as being on one side
    # Whether no zero counts before the spin is far: after a launch without spin.
    arm: Flag
    # Largest oscillation, as in Model.error, of a settled run; 0 if none may settle.
    settled: Number
    dead: Number  # fraction of the energy below which a body is dead
    rim: Number  # height of the rim


START = np.dtype([(name, float) for name in get_type_hints(StartFields)])


class RunFields:
    """The run in a lane."""

    run: Number  # index, or -1 in an empty lane
    refused0: Number  # status of a launch that ends at once, or 0
    t_ended: Number  # time at which it has ended
    rejected: Number  # rejected steps
    t_moved: Number  # time up to which searches have brought the lane
    looked: Number  # tries and steps since then that have brought it no further

    # Spin.
    n_launch: Number
    # `far` while it matters when the spin gets there, else `NEVER`: after a launch
    # without spin, and after a zero if reversals are recorded.
    awaited: Number
    arm_rate: Number  # `rate_max` from there on
    far_rate: Number  # largest recent rate until then

    # Comparisons of squared amplitudes.
    a_min: Number  # smallest of those compared
    growth: Number  # largest ratio
    compared: Number  # number of comparisons
    a_floor: Number  # smallest amplitude that counts

    # The present window.
    window_end: Number
    window_no: Number
    window_a_max: Number  # squared amplitude
    window_n_min: Number
    window_n_max: Number

    # Energy, as the model says when asked (`kernel.answer`).
    energy0: Number  # at launch
    energy1: Number  # at the end of the step, less the work
    energy_most: Number  # largest at launch and at the ends of windows
    work1: Number  # of friction until the end of the step
    oscillation1: Number  # largest oscillation at the end of the step
    drift_max: Number
    volume: Number  # logarithm of phase volume
    volume_rate1: OfEnd[Number]  # its rate over the step

    # Reversals; times are -1 for none.
    t_zero: Number  # first zero of the spin
    t_pending: Number  # first zero since the spin was last far
    t_crossed: Number  # latest zero, also of a dead body
    t_turn: Number  # latest reversal
    side: Number  # sign of the spin when it was last far, 0 if it has never been
    reversals: Number  # changes of side


@dataclass(frozen=True)
class RunResults:
    """Results of every run: arrays over runs, NaN where a run has no value."""

    t_end: Floats  # time reached
    t_r: Floats  # first reversal
    n_end: Floats  # spin at t_end
    energy_drift: Floats  # at t_end, relative to energy_0
    # Largest growth of the relevant amplitude between comparisons, relative.
    amp_growth: Floats
    n_departure: Floats  # largest loss of spin, relative to the launch
    energy_0: Floats  # energy at launch
    status: Integers  # values of Status
    n_steps: Integers
    near_tangencies: Integers
    n_rejected: Integers
    n_turns: Integers  # 0 if reversals are not recorded


RESULT = np.dtype(
    [(name, NUMBER_OF[kind]) for name, kind in get_type_hints(RunResults).items()]
)


@dataclass(frozen=True)
class RunRecord:
    """What may be recorded of every run."""

    energy: Annotated[Floats, (1, 1)]  # largest drift
    # Amplitude, least and largest spin in each window.
    windows: Annotated[Floats, (N_WINDOWS, 3)]
    # Time of each reversal and largest modulus of the spin until the next.
    reversals: Annotated[Floats, (MOST_REVERSALS, 2)]
    volume: Annotated[Floats, (1, 1)]  # mean rate of phase volume

    @property
    def energy_drift_max(self) -> Floats:
        """Return the largest drift of the energy."""
        return self.energy[:, 0, 0]

    @property
    def volume_rate(self) -> Floats:
        """Return the mean rate of phase volume."""
        return self.volume[:, 0, 0]


class Inputs(NamedTuple):
    """What a kernel reads."""

    y0: Floats  # initial states
    constants: Floats
    probe: Floats
    starts: Floats  # columns of START


class Outputs(NamedTuple):
    """What a kernel writes of every run."""

    results: NDArray[np.void]  # of RESULT
    ends: Floats  # state at the end, then results of modes


MAX_ENERGY_DRIFT = 0.01
# Least squared amplitude that counts, as a share of the first: a mode that has decayed
# by 1e-9 is lost in the rounding errors of the other.
FLOOR = 1e-18
# The least headway in time that counts, as a share of the time since the launch and of
# a radian of the fastest swing; how many tries may go by without it, and as how many
# of them a step counts.
LEAST_HEADWAY = 1e-15
MOST_TRIES = 1e5
TRIES_OF_STEP = 1e3
UNKNOWN_RATE = NEVER  # bound of the spin's rate with which every step may reverse


@njit(**INNER)
def goes_on(traits, recording):
    """Return whether runs go on after a zero of the spin."""
    is_followed = recorded(recording.reversals) or recorded(recording.late)
    return is_followed or traits.has_frame


# Energy.


@njit(**INNER)
def note_energy(lane):
    """Let the energy at the end of the step count as one of the largest."""
    lane.energy_most = max(lane.energy_most, lane.energy1 + lane.work1)


@njit(**INNER)
def scale_of_energy(traits, lane):
    """Return the energy that its errors are compared with.

    A plane that shakes may give a body at rest many times its energy at launch.
    """
    if traits.lifts:
        return max(lane.energy0, lane.energy_most)
    return lane.energy0


# Amplitudes and windows.


@njit(**INNER)
def compare_amplitudes(lane):
    """Compare the largest amplitude since the last comparison with those before."""
    largest = max(lane.a_max, lane.a_floor, TINY)
    if lane.compared > 0.0:
        lane.growth = max(lane.growth, largest / lane.a_min)
        largest = min(largest, lane.a_min)
    else:
        lane.a_floor = FLOOR * largest
    lane.a_min = largest
    lane.compared += 1.0
    lane.window_a_max = max(lane.window_a_max, lane.a_max)
    # The state at the border belongs to both windows.
    lane.a_max = lane.amplitude


@njit(**INNER)
def close_window(lane, run, recording):
    """Compare amplitudes, store the window if it is recorded, and open the next one."""
    compare_amplitudes(lane)
    k = int(lane.window_no)
    if recorded(recording.windows) and k < N_WINDOWS:
        recording.windows[run, k, 0] = sqrt(lane.window_a_max)
        recording.windows[run, k, 1] = lane.window_n_min
        recording.windows[run, k, 2] = lane.window_n_max
    lane.window_a_max = lane.amplitude
    lane.window_n_min = lane.window_n_max = lane.n1
    lane.window_no = k + 1
    lane.window_end = (k + 2) * lane.window


@njit(**INNER)
def compare_due(lane, t, run, recording):
    """Make the comparisons and close the windows that are due by time ``t``."""
    include_end(lane)
    while t >= lane.next:
        if lane.comparison < lane.window_end:
            compare_amplitudes(lane)
            lane.comparison *= 2.0
        else:
            close_window(lane, run, recording)
            lane.comparison = NEVER
        lane.next = min(lane.comparison, lane.window_end)


@njit(**INNER)
def include_end(lane):
    """Let the end of the step just tried count in the present window."""
    lane.a_max = max(lane.a_max, lane.amplitude)
    lane.window_n_min = min(lane.window_n_min, lane.n1)
    lane.window_n_max = max(lane.window_n_max, lane.n1)


@njit(**INNER)
def advance_limit(problem, w):
    """Let the limit at the end of an accepted step be the one at the next start."""
    widest_vectors()
    others = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        start = lane.margin0
        end = lane.margin1
        slides = steps_in_rack(lane)
        lane.margin0 = end if lane.accept > 0.0 else start
        others += 1 if slides else 0
    if others == 0:
        return
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        moves = lane.accept > 0.0
        start = lane.limit0
        end = lane.limit1
        value = end.value if moves else start.value
        lane.limit0 = Point(0.0, value, end.rate if moves else start.rate)


# Reversals.


@njit(**INNER)
def is_dead(lane):
    """Return whether too little energy is left for a reversal at the step's end.

    The work of friction until there is `RunFields.work1`.
    """
    if lane.dead == 0.0:
        return False
    return 1.0 + lane.work1 / lane.energy0 < lane.dead


@njit(**INNER)
def note_zero(lane, t, reversals_recorded):
    """Note a zero of the spin at time ``t`` in a run that continues after it."""
    lane.n_least = min(lane.n_least, 0.0)
    lane.t_crossed = t
    # After a launch without spin, no zero counts before the spin has been far.
    if lane.side == 0.0 or is_dead(lane):
        return
    if lane.t_zero < 0.0:
        lane.t_zero = t
    if reversals_recorded and lane.t_pending < 0.0:
        lane.t_pending = t
        lane.awaited = lane.far


@njit(**INNER)
def note_far(lane, reversals):
    """Note that the spin is far, at the point from which the search goes on.

    After a zero, this completes a reversal if the spin was far on the other side.
    """
    n = lane.lo.value
    side = 1.0 if n > 0.0 else -1.0
    if lane.arm > 0.0:
        lane.arm = 0.0
        lane.sign = side
        lane.rate_max = lane.arm_rate
    if side * lane.side < 0.0:
        lane.reversals += 1.0
        lane.t_turn = lane.t_pending
        lane.n_after = 0.0
        k = int(lane.reversals) - 1
        if k < MOST_REVERSALS:
            reversals[int(lane.run), k, 0] = lane.t_turn
        note_size(lane, abs(n), reversals)
    lane.side = side
    lane.t_pending = -1.0
    lane.awaited = NEVER


@njit(**INNER)
def note_size(lane, size, reversals):
    """Let a modulus of the spin count as one of the present turn."""
    k = int(lane.reversals) - 1
    if k >= 0 and size > lane.n_after:
        lane.n_after = size
        if k < MOST_REVERSALS:
            reversals[int(lane.run), k, 1] = size


@njit(**INNER)
def note_turn(lane, reversals):
    """Let the end of the step just tried and a peak within it count in the turn."""
    note_size(lane, max(abs(lane.n1), lane.n_peak), reversals)
    lane.n_peak = 0.0


# Headway.


@njit(**INNER)
def stalls(lane, moves):
    """Return whether the steps of a lane, or searches, bring it no further in time.

    ``moves`` says whether the step just tried is taken.  One that ends at an event may
    be shorter than rounding errors of the time, but not one after another; and the
    tries within a step are limited.
    """
    least = LEAST_HEADWAY * (lane.t + 1.0 / lane.swing)
    if moves:
        if lane.t + lane.h > lane.t_moved + least:
            lane.t_moved = lane.t + lane.h
            lane.looked = 0.0
            return False
        lane.looked += TRIES_OF_STEP
    elif lane.search != STEP:
        lane.looked += 1.0
    return lane.looked > MOST_TRIES


# Start and end of a run.


@njit(**INNER)
def clear(problem, traits, w, l):
    """Set all fields of lane ``l`` to zero."""
    for k in range(traits.n_fields):
        w[k * problem.lanes + l] = 0.0


@njit(**INNER)
def fill_rows(problem, w, l, row, table, place, first, count):
    """Write numbers of a row of a table, from a column on, to rows of lane ``l``."""
    for k in range(count):
        w[(row + k) * problem.lanes + l] = table[place, first + k]


@njit(**INNER)
def read_rows(problem, w, l, row, table, place, first, count):
    """Copy rows of lane ``l`` to a row of a table, from a column on."""
    for k in range(count):
        table[place, first + k] = w[(row + k) * problem.lanes + l]


@njit(**INNER)
def fill_constants(problem, traits, w, l, table, place):
    """Write the constants of a run, from a row of a table, to rows of lane ``l``."""
    count = traits.n_constants
    fill_rows(problem, w, l, traits.constants, table, place, 0, count)
    if traits.mu != NO_ROW:
        fill_rows(problem, w, l, traits.mu, table, place, count, 1)


@njit(**INNER)
def start(problem, traits, w, l, run, inputs):
    """Copy the next run to a lane, whose model then begins it."""
    lane = lane_of(problem, w, l)
    clear(problem, traits, w, l)
    # The start has the first rows.
    fill_rows(problem, w, l, 0, inputs.starts, run, 0, inputs.starts.shape[1])
    lane.run = run
    lane.root0 = 1.0
    fill_rows(problem, w, l, traits.y, inputs.y0, run, 0, traits.n_state)
    fill_rows(problem, w, l, traits.probe, inputs.probe, run, 0, traits.n_probe)
    fill_constants(problem, traits, w, l, inputs.constants, run)
    lane.t_end = lane.horizon
    lane.h_longest = lane.longest_step
    lane.rate_max = lane.rate
    lane.window_end = lane.window
    lane.next = min(lane.comparison, lane.window)
    lane.t_zero = lane.t_pending = lane.t_crossed = -1.0
    lane.awaited = NEVER
    if lane.arm > 0.0:
        lane.awaited = lane.far
    if lane.first_step >= lane.t_end:
        lane.last = 1.0
    lane.h = lane.h_next = min(lane.first_step, lane.t_end)


@njit(**INNER)
def hold_values(lane):
    """Let what is known of the end of a step be what is known of its start."""
    # The amplitude at the start is not kept.  The largest since the last comparison
    # stands for it, since this changes no maximum.
    lane.n1 = lane.n0
    lane.rate1 = lane.rate0
    lane.amplitude = lane.a_max
    lane.root = lane.root0


@njit(**INNER)
def hold_back(problem, traits, w, l):
    """Copy the start of a step that is not taken to its end."""
    lane = lane_of(problem, w, l)
    for k in range(traits.n_end):
        start = (problem.first + k) * problem.lanes + l
        w[start + traits.n_end * problem.lanes] = w[start]
    hold_values(lane)


@njit(**INNER)
def stay_empty(problem, traits, w, l):
    """Take back the step that was tried on an empty lane."""
    lane = lane_of(problem, w, l)
    lane.accept = 0.0
    lane.h_next = 0.0
    hold_back(problem, traits, w, l)


@njit(**INNER)
def keep_end(problem, traits, w, l):
    """Keep the end of the step just tried, while a search in it tries shorter ones.

    Kept are the rows that are :data:`OfEnd`, and then those that the model has there.
    """
    apart()
    lanes = problem.lanes
    kept = traits.kept * lanes + l
    for row in problem.rows_of_end:
        w[kept] = w[row * lanes + l]
        kept += lanes
    end = (problem.first + traits.n_end) * lanes + l
    for k in range(traits.n_end):
        w[kept + k * lanes] = w[end + k * lanes]


@njit(**INNER)
def restore_end(problem, traits, w, l):
    """Let the end that :func:`keep_end` kept be that of the step just tried again."""
    apart()
    lanes = problem.lanes
    kept = traits.kept * lanes + l
    for row in problem.rows_of_end:
        w[row * lanes + l] = w[kept]
        kept += lanes
    end = (problem.first + traits.n_end) * lanes + l
    for k in range(traits.n_end):
        w[end + k * lanes] = w[kept + k * lanes]


@njit(**INNER)
def advance(problem, traits, w):
    """Move all lanes to the end of their step."""
    size = traits.n_end * problem.lanes
    start = problem.first * problem.lanes
    copy_numbers(w, start, start + size, size)


@njit(**INNER)
def finish(problem, traits, w, l, status, reversal, t, outputs, recording):
    """Store the results of a run that ends with the step just tried, at time ``t``.

    The model has set its energy there, and the results of its modes (`answer.END`).
    """
    lane = lane_of(problem, w, l)
    run = int(lane.run)
    if traits.lifts:
        note_energy(lane)
    energy0 = lane.energy0
    drift = (lane.energy1 - energy0) / scale_of_energy(traits, lane)
    if status in (OK, AT_LIMIT, RIM) and not abs(drift) <= MAX_ENERGY_DRIFT:
        status = ENERGY_OFF if isfinite(drift) else NONFINITE
    n = lane.n1
    include_end(lane)
    if t - lane.window_no * lane.window > 0.9 * lane.window:
        close_window(lane, run, recording)
    t_r = nan
    if reversal and status == OK and not is_dead(lane):
        t_r = t
    if recorded(recording.reversals):
        note_turn(lane, recording.reversals)
    # A failure after the first zero leaves it valid, unless the energy has drifted.
    if goes_on(traits, recording) and lane.t_zero > 0.0 and status != ENERGY_OFF:
        t_r = lane.t_zero
    if recorded(recording.energy):
        recording.energy[run, 0, 0] = max(lane.drift_max, abs(drift))
    extremes.store(lane, run, recording)
    if recorded(recording.volume) and status == OK:
        recording.volume[run, 0, 0] = (lane.volume + lane.h * lane.volume_rate1) / t
    result = outputs.results[run]
    result["t_end"] = t
    result["t_r"] = t_r
    result["n_end"] = n
    if keeps_zero(lane):
        # Without the rounding errors of the state, so that rows tell it is held.
        result["n_end"] = 0.0
    result["energy_drift"] = drift
    result["amp_growth"] = nan
    if lane.compared > 1.0:
        # The first comparison only sets the reference.
        result["amp_growth"] = sqrt(lane.growth) - 1.0
    lost = min(lane.n_least, lane.sign * n) / abs(lane.n_launch)
    result["n_departure"] = 1.0 - lost
    result["energy_0"] = energy0
    result["status"] = status
    result["n_steps"] = int(lane.steps)
    result["near_tangencies"] = int(lane.near)
    result["n_rejected"] = int(lane.rejected)
    result["n_turns"] = int(lane.reversals)
    end = traits.y + traits.n_end
    first = traits.n_state
    read_rows(problem, w, l, end, outputs.ends, run, 0, first)
    count = traits.n_results
    read_rows(problem, w, l, traits.results, outputs.ends, run, first, count)
    return status


@njit(**INNER)
def window_row(lane):
    """Return the row of the window in the table of growths."""
    return min(int(lane.window_no), N_WINDOWS - 1)


@njit(**INNER)
def growth_row(lane, t):
    """Return the row of a time in the table of growths.

    Growths are stored at the ends of windows, and those of a frame at the comparisons
    in the first window, too.
    """
    if t < lane.window_end:
        return N_WINDOWS + int(lane.compared)
    return window_row(lane)
