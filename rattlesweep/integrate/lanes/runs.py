"""A run in a lane: its start, the ends of its windows, its end.

A run may carry a tangent, which is scaled by a power of two when it has become very
long or short. Barriers keep the arithmetic of the tangent apart from that of the state,
whose bits are then the same as without a tangent.
"""

# mypy: ignore-errors
from math import isfinite, log, nan, sqrt

from numba import njit

from rattlesweep.integrate.lanes.events import least_peak, may_peak, spin_points
from rattlesweep.integrate.lanes.lane import (
    INNER,
    barrier,
    clear,
    Point,
    first_of,
    lane_of,
    moved,
    widest_vectors,
)
from rattlesweep.integrate.status import Status
from rattlesweep.physics.full import FASTMATH, scalar

# The arrays that a kernel reads and writes have one row for each run.  Columns of
# ``result`` are attributes of an Outcome, followed by the state at the end.
RESULT = (
    "t_end",
    "t_r",
    "n_end",
    "energy_drift",
    "amp_growth",
    "n_departure",
    "energy_0",
    "energy_drift_max",
    "contact_ratio_max",
    "contact_normal_min",
    "volume_rate",
)
T_END, T_R, GROWTH, DEPARTURE = map(
    RESULT.index, ("t_end", "t_r", "amp_growth", "n_departure")
)
FIRST_STATE = len(RESULT)
# Columns of ``counts``, also attributes of an Outcome.
COUNTS = ("status", "n_steps", "near_tangencies", "n_rejected", "n_turns")
STATUS, STEPS = 0, 1
# Columns of ``plan``, which `batch.run_arrays` fills from the attributes of a Batch.
HORIZON, SWING, WINDOW, RATE, FIRST_STEP, COST, FUZZ, FIRST_MARK = (
    0,
    1,
    2,
    3,
    4,
    5,
    6,
    7,
)
FAR, TAPPED, SETTLED, DEAD = 8, 9, 10, 11
# ``options`` holds 1 / tol^2, fixed step and maximum number of steps, of SUBSTEPS
# substeps each if the step is fixed.  ``record`` holds the flags:
REC_ENERGY, REC_CONTACT, REC_WINDOWS, REC_REVERSALS, REC_VOLUME, N_RECORD = (
    0,
    1,
    2,
    3,
    4,
    5,
)
MOST_REVERSALS = 8  # reversals that are stored, each in a row of the run's ``windows``

OK, NONFINITE, ENERGY = int(Status.OK), int(Status.NONFINITE), int(Status.ENERGY)
MAX_ENERGY_DRIFT = 0.01
TINY = 1e-290
# Least squared amplitude that counts, as a share of the first: a mode that has decayed
# by 1e-9 is lost in the rounding errors of the other.
FLOOR = 1e-18
DIFFERENCE = 1e-7  # length of differences along the flow, in radians of the swing
UNKNOWN_RATE = 1e290  # bound of the spin's rate with which every step may reverse
# The norm of a tangent stays between 2^-SHIFT and 2^SHIFT.
SHIFT, LOG_2 = 200, log(2.0)
SHORTER, LONGER = 2.0**-SHIFT, 2.0**SHIFT
SHORT, LONG = SHORTER**2, LONGER**2


@njit(fastmath=FASTMATH, **INNER)
def energy_at(lane, y):
    """Return the energy of a lane's body in the state ``y``."""
    return lane.problem.energy(*(y + lane.constants))


@njit(fastmath=FASTMATH, **INNER)
def derive(lane):
    """Set the derivative at the start of the step, and return the spin and its rate
    there.
    """
    y = lane.y
    f = lane.problem.rhs(*(y + lane.constants))
    lane.f = f
    return lane.problem.spin(*y), lane.problem.spin_rate(*(y + f))


@njit(**INNER)
def compare(lane):
    """Compare the largest amplitude since the last comparison with the smallest before
    that.
    """
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
def close_window(lane, run, windows, record):
    """Compare amplitudes, store the window if it is recorded, and open the next one."""
    compare(lane)
    k = int(lane.window_no)
    if record[REC_WINDOWS] and k < windows.shape[1]:
        windows[run, k, 0] = sqrt(lane.window_a_max)
        windows[run, k, 1] = lane.window_n_min
        windows[run, k, 2] = lane.window_n_max
    lane.window_a_max = lane.amplitude
    lane.window_n_min = lane.window_n_max = lane.n1
    lane.window_no = k + 1
    lane.window_end = (k + 2) * lane.window


@njit(**INNER)
def pass_marks(lane, t, run, windows, record):
    """Make the comparisons and close the windows that are due by time ``t``."""
    include_end(lane)
    while t >= lane.next:
        if lane.mark < lane.window_end:
            compare(lane)
            lane.mark *= 2.0
        else:
            close_window(lane, run, windows, record)
            lane.mark = 1e290
        lane.next = min(lane.mark, lane.window_end)


@njit(fastmath=FASTMATH, **INNER)
def settled(lane, most):
    """Return whether no amplitude grew in two windows and the oscillation is at most
    ``most``.
    """
    if most == 0.0 or lane.window_no < 2.0 or lane.growth > 1.0 or lane.t_zero >= 0.0:
        return False
    _, oscillation = lane.problem.error(*(lane.y1 + lane.y1 + lane.constants))
    return oscillation <= most


@njit(**INNER)
def include_end(lane):
    """Let the end of the step just tried count in the present window."""
    lane.a_max = max(lane.a_max, lane.amplitude)
    lane.window_n_min = min(lane.window_n_min, lane.n1)
    lane.window_n_max = max(lane.window_n_max, lane.n1)


@scalar
def contact_points(lane, h, y, f):
    """Return ratio of the contact forces and negative normal force, with their rates."""
    # The rates are differences along the flow; an error of them only moves the place
    # at which an extreme is evaluated.
    ahead = DIFFERENCE / lane.swing
    normal, tangential = lane.problem.contact(*(y + lane.constants))
    ratio = tangential / abs(normal)
    y = moved(y, f, ahead)
    later, tangential = lane.problem.contact(*(y + lane.constants))
    ratio_rate = (tangential / abs(later) - ratio) / ahead
    return Point(h, ratio, ratio_rate), Point(h, -normal, (normal - later) / ahead)


@njit(fastmath=FASTMATH, **INNER)
def observe_contact(problem, w):
    """Compute the contact forces at the end of the step tried on every lane."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        ratio, lift = contact_points(lane, lane.h, lane.y1, lane.f1)
        lane.ratio1 = ratio
        lane.lift1 = lift
        peak = may_peak(lane.ratio0, ratio, lane.ratio_max)
        # Where the normal force is negative, the ratio has poles and no largest value.
        peak &= (lane.lift0.n < 0.0) & (lift.n < 0.0)
        peak |= may_peak(lane.lift0, lift, -lane.normal_min)
        lane.peak += 1.0 if peak else 0.0


@njit(**INNER)
def note_contact(lane):
    """Let the end of the step just tried count in the extremes of the contact forces."""
    lane.ratio_max = max(lane.ratio_max, lane.ratio1.n)
    lane.normal_min = min(lane.normal_min, -lane.lift1.n)


@njit(**INNER)
def observe_spin(problem, w):
    """Compute whether the step tried on any lane may hold the largest spin of a turn."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        start, end = spin_points(lane)
        peak = (start.n > 0.0) & may_peak(start, end, least_peak(lane))
        lane.peak += 1.0 if peak else 0.0


@njit(**INNER)
def is_dead(lane):
    """Return whether, after the step just tried, too little energy is left for a
    reversal.
    """
    # With friction the last component of the state is the work, which is negative.
    return lane.dead > 0.0 and 1.0 + lane.y1[-1] / lane.energy0 < lane.dead


@njit(**INNER)
def note_zero(lane, t):
    """Note a zero of the spin at time ``t`` in a run that continues after it."""
    lane.n_least = min(lane.n_least, 0.0)
    if is_dead(lane):
        return
    if lane.t_zero < 0.0:
        lane.t_zero = t
    if lane.t_pending < 0.0:
        lane.t_pending = t


@njit(**INNER)
def note_side(lane, windows, record):
    """Count a reversal once the spin is far on the other side, and store its largest
    modulus.
    """
    run = int(lane.run)
    at = 3 if record[REC_WINDOWS] else 0
    n = lane.n1
    size = max(abs(n), lane.n_top)
    lane.n_top = 0.0
    if size > lane.far:
        side = 1.0 if n > 0.0 else -1.0
        # Without a pending zero the body was dead when the spin changed sign.
        if side * lane.side < 0.0 and lane.t_pending >= 0.0:
            k = int(lane.reversals)
            lane.reversals += 1.0
            lane.n_after = 0.0
            if k < MOST_REVERSALS:
                windows[run, k, at] = lane.t_pending
        lane.side = side
        lane.t_pending = -1.0
    k = int(lane.reversals) - 1
    if k >= 0 and size > lane.n_after:
        lane.n_after = size
        if k < MOST_REVERSALS:
            windows[run, k, at + 1] = size


@njit(**INNER)
def start(lane, run, y0, constants, probe, plan, record):
    """Start a run in a lane."""
    clear(lane)
    lane.run = run
    lane.root0 = 1.0
    lane.y = first_of(y0[run], lane.problem.n_state)
    lane.constants = first_of(constants[run], lane.problem.n_constants)
    lane.probe = first_of(probe[run], lane.problem.n_probe)
    n, rate = derive(lane)
    lane.t_end = plan[run, HORIZON]
    lane.swing = plan[run, SWING]
    lane.window = lane.window_end = plan[run, WINDOW]
    lane.mark = plan[run, FIRST_MARK]
    lane.next = min(plan[run, FIRST_MARK], plan[run, WINDOW])
    lane.rate_max = plan[run, RATE]
    lane.n_launch = lane.n0 = lane.window_n_min = lane.window_n_max = n
    lane.rate0 = rate
    lane.sign = lane.side = 1.0 if n > 0.0 else -1.0
    lane.far = plan[run, FAR]
    lane.t_zero = lane.t_pending = -1.0
    if plan[run, TAPPED] > 0.0:
        lane.arm = plan[run, FAR]
        lane.arm_rate = plan[run, RATE]
        lane.rate_max = UNKNOWN_RATE
        lane.side = 0.0
    lane.n_least = abs(n)
    lane.energy0 = energy_at(lane, lane.y)
    lane.normal_min = 1e290
    if record[REC_CONTACT]:
        lane.ratio1, lane.lift1 = contact_points(lane, 0.0, lane.y, lane.f)
        note_contact(lane)
        lane.ratio0, lane.lift0 = lane.ratio1, lane.lift1
    lane.fuzz = plan[run, FUZZ]
    lane.dead = plan[run, DEAD]
    if plan[run, FIRST_STEP] >= lane.t_end:
        lane.last = 1.0
    lane.h = lane.h_next = min(plan[run, FIRST_STEP], lane.t_end)


@njit(**INNER)
def idle(lane):
    """Empty a lane: in a spinning state and with steps of size zero, no zero and no end
    is due.
    """
    clear(lane)
    lane.run = -1.0
    lane.y, lane.constants, lane.probe = lane.problem.idle
    n, _ = derive(lane)
    lane.n0 = n
    lane.sign = 1.0
    lane.t_end = lane.window_end = lane.next = 1e290


@njit(**INNER)
def hold_back(lane):
    """Copy the start of a step that is not taken to its end."""
    lane.y1 = lane.y
    lane.f1 = lane.f
    lane.v1 = lane.v
    lane.g1 = lane.g
    lane.n1 = lane.n0
    lane.rate1 = lane.rate0
    lane.amplitude = lane.a_max
    lane.root = lane.root0


@njit(**INNER)
def finish(lane, status, reversal, t, run, result, counts, windows, record):
    """Store the results of a run that ends with the step just tried, at time ``t``."""
    energy0 = lane.energy0
    drift = (energy_at(lane, lane.y1) - energy0) / energy0
    if status == OK and not abs(drift) <= MAX_ENERGY_DRIFT:
        status = ENERGY if isfinite(drift) else NONFINITE
    n = lane.n1
    include_end(lane)
    if t - lane.window_no * lane.window > 0.9 * lane.window:
        close_window(lane, run, windows, record)
    if record[REC_CONTACT]:
        note_contact(lane)
    t_r = t if reversal and status == OK and not is_dead(lane) else nan
    if record[REC_REVERSALS]:
        note_side(lane, windows, record)
        # A failure after the first zero leaves it valid, unless the energy has drifted.
        if lane.t_zero > 0.0 and status != ENERGY:
            t_r = lane.t_zero
    # The first comparison only sets the reference.
    growth = sqrt(lane.growth) - 1.0 if lane.compared > 1.0 else nan
    departure = 1.0 - min(lane.n_least, lane.sign * n) / abs(lane.n_launch)
    rate = nan
    if record[REC_VOLUME] and status == OK:
        rate = (lane.volume + lane.h * lane.volume_rate1) / t
    found = t, t_r, n, drift, growth, departure
    seen = (
        energy0,
        max(lane.drift_max, abs(drift)),
        lane.ratio_max,
        lane.normal_min,
        rate,
    )
    for i, value in enumerate(found + seen + lane.y1):
        result[run, i] = value
    counts[run, STATUS] = status
    for i, count in enumerate((lane.steps, lane.near, lane.rejected, lane.reversals)):
        counts[run, STEPS + i] = int(count)


@njit(**INNER)
def advance(problem, w):
    """Move all lanes to the end of their step."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        lane.y = lane.y1
        lane.f = lane.f1


@njit(fastmath=FASTMATH, **INNER)
def start_tangent(lane):
    """Give a lane the model's first tangent, made transverse and of norm 1."""
    lane.v = lane.problem.seed(*(lane.y + lane.constants))
    p, q, a, b, c = lane.problem.transverse(
        *(lane.y + lane.f + lane.v + lane.constants)
    )
    norm = sqrt(lane.problem.square(p, q, a, b, c, *lane.constants))
    v = p / norm, q / norm, a / norm, b / norm, c / norm
    lane.v = v
    # All components but the last are read again.  This decides which products are
    # fused, and so keeps the last bits of the exponents.
    barrier()
    lane.g = lane.problem.rate(
        *(lane.y + lane.f + lane.v[:-1] + v[-1:] + lane.constants)
    )
    lane.shift = 0.0


@njit(fastmath=FASTMATH, **INNER)
def advance_tangent(problem, w):
    """Move the tangents of all lanes to the end of their step."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        lane.v = lane.v1
        lane.g = lane.g1
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        size = lane.problem.square(*(lane.v + lane.constants))
        factor = SHORTER if size > LONG else 1.0
        factor = LONGER if size < SHORT else factor
        out = 1.0 * SHIFT if size > LONG else 0.0
        out = -1.0 * SHIFT if size < SHORT else out
        p, q, a, b, c = lane.v
        lane.v = p * factor, q * factor, a * factor, b * factor, c * factor
        p, q, a, b, c = lane.g
        lane.g = p * factor, q * factor, a * factor, b * factor, c * factor
        lane.shift += out


@njit(**INNER)
def advance_both(problem, w):
    """Move all lanes and their tangents to the end of their step."""
    advance(problem, w)
    advance_tangent(problem, w)


@njit(**INNER)
def start_both(lane, run, y0, constants, probe, plan, record):
    """Start a run with a tangent in a lane."""
    start(lane, run, y0, constants, probe, plan, record)
    barrier()
    start_tangent(lane)
    barrier()


@njit(fastmath=FASTMATH, **INNER)
def note_tangent(lane, t, run, windows):
    """Store the time and the tangent's growth in the last two columns of the window's
    row.
    """
    k = min(int(lane.window_no), windows.shape[1] - 1)
    barrier()
    windows[run, k, windows.shape[2] - 2] = t
    growth = 0.5 * log(lane.problem.square(*(lane.v1 + lane.constants)))
    windows[run, k, windows.shape[2] - 1] = growth + LOG_2 * lane.shift
    barrier()


@njit(**INNER)
def pass_marks_both(lane, t, run, windows, record):
    """Do as :func:`pass_marks`, and store the tangent's growth at the end of a
    window.
    """
    if t >= lane.window_end:
        note_tangent(lane, t, run, windows)
    pass_marks(lane, t, run, windows, record)


@njit(**INNER)
def finish_both(lane, status, reversal, t, run, result, counts, windows, record):
    """Do as :func:`finish`, and store the tangent's growth."""
    note_tangent(lane, t, run, windows)
    finish(lane, status, reversal, t, run, result, counts, windows, record)
