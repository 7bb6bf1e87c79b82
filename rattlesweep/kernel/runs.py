"""A run in a lane: its start, what is observed at its steps, its end."""

# mypy: ignore-errors
from math import isfinite, nan, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import INNER, copy_numbers, widest_vectors
from rattlesweep.kernel.look.casimir import MEANS
from rattlesweep.kernel.look.marks import MARKS
from rattlesweep.kernel.state.fields import NEVER, SLIDING, STEP, Point
from rattlesweep.kernel.state.lane import clear, lane_of
from rattlesweep.kernel.state.statuses import AT_LIMIT, ENERGY_OFF, NONFINITE, OK, RIM
from rattlesweep.physics.full import TINY

# The arrays that a kernel reads and writes have one row for each run.
PLAN = np.dtype(
    [
        ("horizon", float),
        ("swing", float),  # fastest angular frequency of the spin
        ("window", float),  # length of the windows whose amplitudes are compared
        ("rate", float),  # bound of the spin's rate in the first steps
        ("first_step", float),
        ("longest_step", float),
        ("cost", float),  # expected
        # depth of an extremum whose sign is not known, relative to the swing
        ("fuzz", float),
        ("first_comparison", float),  # time of the first comparison of amplitudes
        ("far", float),  # modulus beyond which the spin is on one side
        ("tapped", float),  # 1 if the run is launched without spin
        # largest oscillation, as in Model.error, of a settled run; 0 if none may settle
        ("settled", float),
        ("dead", float),  # fraction of the energy below which a body is dead
        ("rim", float),  # height of the rim
    ],
    align=True,
)
# Fields of the results of a run, which are attributes of an Outcome.
RESULTS = (
    ("t_end", float),
    ("t_r", float),
    ("n_end", float),
    ("energy_drift", float),
    ("amp_growth", float),
    ("n_departure", float),
    ("energy_0", float),
    ("status", int),
    ("n_steps", int),
    ("near_tangencies", int),
    ("n_rejected", int),
    ("n_turns", int),
)


class Inputs(NamedTuple):
    """What a kernel reads."""

    y0: Floats  # initial states
    constants: Floats
    probe: Floats
    plan: NDArray[np.void]  # of PLAN


class Recording(NamedTuple):
    """What a kernel records: arrays of shape (runs, rows, columns).

    An array has no runs if its observation is not recorded.
    """

    energy: Floats  # largest drift
    contact: Floats  # largest ratio of the forces, least normal force
    windows: Floats  # amplitude, least and largest spin in each window
    # Time of each reversal and largest modulus of the spin until the next.
    reversals: Floats
    volume: Floats  # mean rate of phase volume
    # Time and logarithm of the tangent's growth at the ends of the windows and of the
    # run.  If a step ends several windows, only the row of the first is filled.  With a
    # frame there are N_GROWTHS logarithms: of its tangents, the flow and the energy.
    lyapunov: Floats
    marks: Floats  # times of the first zeros of `look.marks`
    late: Floats  # mean spin and its standard deviation in the last quarter
    casimir: Floats  # range, and means between reversals, of `look.casimir`


N_GROWTHS = 5
N_WINDOWS = 64
# Rows of `lyapunov` for a frame, after those of the windows: the comparisons within the
# first window.  Where a motion dies out there, nothing else tells how.
N_COMPARISONS = 24
MOST_REVERSALS = 8  # reversals that are stored
SHAPES = Recording(
    energy=(1, 1),
    contact=(1, 2),
    windows=(N_WINDOWS, 3),
    reversals=(MOST_REVERSALS, 2),
    volume=(1, 1),
    lyapunov=(N_WINDOWS, 2),
    marks=(1, len(MARKS)),
    late=(1, 2),
    casimir=(MEANS + 1 + MOST_REVERSALS, 2),
)


class Outputs(NamedTuple):
    """What a kernel writes of every run."""

    results: NDArray[np.void]  # of RESULTS and `Mode.results`
    y_end: Floats


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
def recorded(array):
    """Return whether an observation is recorded."""
    return array.shape[0] > 0


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
def may_settle(lane, most):
    """Return whether no amplitude grew in two windows, so that the run may settle.

    ``most`` is the largest oscillation of a settled run, or 0 if none may settle.
    """
    if most == 0.0 or lane.window_no < 2.0 or lane.growth > 1.0:
        return False
    return lane.t_zero < 0.0


@njit(**INNER)
def include_end(lane):
    """Let the end of the step just tried count in the present window."""
    lane.a_max = max(lane.a_max, lane.amplitude)
    lane.window_n_min = min(lane.window_n_min, lane.n1)
    lane.window_n_max = max(lane.window_n_max, lane.n1)


@njit(**INNER)
def note_mark(lane, marks):
    """Store the mark that was found in the step, if there is one."""
    if lane.mark_found > 0.0:
        marks[int(lane.run), 0, int(lane.mark_found) - 1] = lane.t_mark
        lane.mark_found = 0.0


@njit(**INNER)
def start_points(lane):
    """Let the functions at the end of the step be those at the next start."""
    ratio = lane.ratio1
    lift = lane.lift1
    lane.ratio0 = Point(0.0, ratio.value, ratio.rate)
    lane.lift0 = Point(0.0, lift.value, lift.rate)


@njit(**INNER)
def advance_limit(problem, w):
    """Let the limit at the end of an accepted step be the one at the next start."""
    widest_vectors()
    others = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        start = lane.margin0
        end = lane.margin1
        mode = lane.mode
        lane.margin0 = end if lane.accept > 0.0 else start
        others += 1 if mode == SLIDING else 0
    if others == 0:
        return
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        moves = lane.accept > 0.0
        start = lane.limit0
        end = lane.limit1
        value = end.value if moves else start.value
        lane.limit0 = Point(0.0, value, end.rate if moves else start.rate)


@njit(**INNER)
def note_contact(lane):
    """Let the end of the step just tried count in the extremes of the contact."""
    lane.ratio_max = max(lane.ratio_max, lane.ratio1.value)
    lane.normal_min = min(lane.normal_min, -lane.lift1.value)


# Reversals.


@njit(**INNER)
def is_dead(lane):
    """Return whether too little energy is left for a reversal at the step's end.

    The work of friction until there is `Lane.work1`.
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
def fill_rows(problem, w, l, row, numbers, count):
    """Write the first numbers of an array to rows of lane ``l``."""
    for k in range(count):
        w[(row + k) * problem.lanes + l] = numbers[k]


@njit(**INNER)
def start(problem, traits, w, l, run, inputs):
    """Set launch and plan of the next run in a lane, whose model then begins it."""
    lane = lane_of(problem, w, l)
    clear(lane)
    plan = inputs.plan[run]
    constants = inputs.constants[run]
    lane.run = run
    lane.root0 = 1.0
    row = problem.first
    fill_rows(problem, w, l, row, inputs.y0[run], traits.n_state)
    row += 2 * traits.n_end
    fill_rows(problem, w, l, row, constants, traits.n_constants)
    row += traits.n_constants
    fill_rows(problem, w, l, row, inputs.probe[run], traits.n_probe)
    if traits.slides:
        lane.mu = constants[traits.n_constants]
    lane.t_end = plan["horizon"]
    lane.swing = plan["swing"]
    lane.window = lane.window_end = plan["window"]
    lane.comparison = plan["first_comparison"]
    lane.next = min(plan["first_comparison"], plan["window"])
    lane.rate_max = plan["rate"]
    lane.far = plan["far"]
    lane.t_zero = lane.t_pending = lane.t_crossed = -1.0
    lane.awaited = NEVER
    if plan["tapped"] > 0.0:
        lane.awaited = plan["far"]
        lane.arm = 1.0
    lane.rim = plan["rim"]
    lane.fuzz = plan["fuzz"]
    lane.dead = plan["dead"]
    lane.h_longest = plan["longest_step"]
    if plan["first_step"] >= lane.t_end:
        lane.last = 1.0
    lane.h = lane.h_next = min(plan["first_step"], lane.t_end)


@njit(**INNER)
def hold_values(lane):
    """Let what is known of the end of a step be what is known of its start."""
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
    if traits.slides:
        lane.slip1 = lane.slip


@njit(**INNER)
def advance(problem, traits, w):
    """Move all lanes to the end of their step."""
    size = traits.n_end * problem.lanes
    start = problem.first * problem.lanes
    copy_numbers(w, start, start + size, size)


@njit(**INNER)
def finish(problem, traits, w, l, status, reversal, t, outputs, recording):
    """Store the results of a run that ends with the step just tried, at time ``t``.

    The energy there is known (`Lane.energy1`).
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
    t_r = t if reversal and status == OK and not is_dead(lane) else nan
    if recorded(recording.reversals):
        note_turn(lane, recording.reversals)
    # A failure after the first zero leaves it valid, unless the energy has drifted.
    if goes_on(traits, recording) and lane.t_zero > 0.0 and status != ENERGY_OFF:
        t_r = lane.t_zero
    if recorded(recording.energy):
        recording.energy[run, 0, 0] = max(lane.drift_max, abs(drift))
    if recorded(recording.contact):
        note_contact(lane)
        recording.contact[run, 0, 0] = lane.ratio_max
        recording.contact[run, 0, 1] = lane.normal_min
    if recorded(recording.volume) and status == OK:
        recording.volume[run, 0, 0] = (lane.volume + lane.h * lane.volume_rate1) / t
    result = outputs.results[run]
    result["t_end"] = t
    result["t_r"] = t_r
    result["n_end"] = n
    result["energy_drift"] = drift
    # The first comparison only sets the reference.
    result["amp_growth"] = sqrt(lane.growth) - 1.0 if lane.compared > 1.0 else nan
    lost = min(lane.n_least, lane.sign * n) / abs(lane.n_launch)
    result["n_departure"] = 1.0 - lost
    result["energy_0"] = energy0
    result["status"] = status
    result["n_steps"] = int(lane.steps)
    result["near_tangencies"] = int(lane.near)
    result["n_rejected"] = int(lane.rejected)
    result["n_turns"] = int(lane.reversals)
    end = (problem.first + traits.n_end) * problem.lanes + l
    for i in range(traits.n_state):
        outputs.y_end[run, i] = w[end + i * problem.lanes]
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
