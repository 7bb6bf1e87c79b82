"""A run in a lane: its start, what is observed at its steps, its end.

A run may carry a tangent, which is scaled by a power of two when it has become very
long or short, or a frame of tangents. Barriers keep their arithmetic apart from that of
the state, whose bits are then the same as without tangents.
"""

# mypy: ignore-errors
from dataclasses import replace
from math import isfinite, log, nan, sqrt
from typing import NamedTuple

from numba import njit

from rattlesweep.arrays import Floats
from rattlesweep.integrate.lanes.events import (
    NEVER,
    least_turn,
    may_be_far,
    may_fall,
    may_peak,
    may_reach,
    turn_points,
)
from rattlesweep.integrate.lanes.lane import (
    INNER,
    Hooks,
    Point,
    barrier,
    clear,
    first_of,
    lane_of,
    moved,
    widest_vectors,
)
from rattlesweep.integrate.lanes.marks import MARKS
from rattlesweep.integrate.model import Model
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
)
T_END, T_R, N_END, DRIFT, GROWTH, DEPARTURE, ENERGY_0, FIRST_STATE = range(8)
# Columns of ``counts``, also attributes of an Outcome.
COUNTS = ("status", "n_steps", "near_tangencies", "n_rejected", "n_turns")
STATUS, STEPS, NEAR, REJECTED, TURNS = range(5)
# Columns of ``plan``, which `batch.plan_of` fills.
(
    HORIZON,
    SWING,
    WINDOW,
    RATE,
    FIRST_STEP,
    COST,
    FUZZ,
    FIRST_MARK,
    FAR,
    TAPPED,
    SETTLED,
    DEAD,
    LONGEST,
    RIM_HEIGHT,
    N_PLAN,
) = range(15)


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
    marks: Floats  # times of the first zeros of `lanes.marks`


N_GROWTHS = 5
# Columns of `lyapunov` after the time and the growths of the frame.
FLOW_GROWTH, ENERGY_GROWTH = 4, 5
N_WINDOWS = 64
# Rows of `lyapunov` for a frame, after those of the windows: the comparisons within the
# first window.  Where a motion dies out there, nothing else tells how.
N_MARKS = 24
MOST_REVERSALS = 8  # reversals that are stored
SHAPES = Recording(
    energy=(1, 1),
    contact=(1, 2),
    windows=(N_WINDOWS, 3),
    reversals=(MOST_REVERSALS, 2),
    volume=(1, 1),
    lyapunov=(N_WINDOWS, 2),
    marks=(1, len(MARKS)),
)

OK = int(Status.OK)
NONFINITE = int(Status.NONFINITE)
ENERGY = int(Status.ENERGY)
LIMIT = int(Status.LIMIT)
RIM = int(Status.RIM)
MAX_ENERGY_DRIFT = 0.01
TINY = 1e-290
# Least squared amplitude that counts, as a share of the first: a mode that has decayed
# by 1e-9 is lost in the rounding errors of the other.
FLOOR = 1e-18
DIFFERENCE = 1e-7  # length of differences along the flow, in radians of the swing
UNKNOWN_RATE = 1e290  # bound of the spin's rate with which every step may reverse
# The norm of a tangent stays between 2^-SHIFT and 2^SHIFT.
SHIFT = 200
LOG_2 = log(2.0)
SHORTER = 2.0**-SHIFT
LONGER = 2.0**SHIFT
SHORT = SHORTER**2
LONG = LONGER**2
# Squared norm below which a flow no longer determines what is normal to it.
NO_FLOW = 1e-270


@njit(**INNER)
def recorded(array):
    """Return whether an observation is recorded."""
    return array.shape[0] > 0


@njit(**INNER)
def goes_on(problem, recording):
    """Return whether runs go on after a zero of the spin."""
    return recorded(recording.reversals) or problem.model.n_tangents > 1


@njit(fastmath=FASTMATH, **INNER)
def energy_at(lane, y):
    """Return the energy of a lane's body in the state ``y``."""
    return lane.problem.model.energy(y, lane.constants)


@njit(**INNER)
def energy_after(lane):
    """Return the energy at the end of the step just tried."""
    return energy_at(lane, lane.y1)


@njit(**INNER)
def work_after(lane):
    """Return the work of friction until the end of the step, which is negative."""
    return lane.problem.model.work(lane.y1)


@njit(fastmath=FASTMATH, **INNER)
def observe(model, y, slip, constants, mu):
    """Return the energy minus the work, and the normal and tangential force."""
    normal, tangential = model.contact(y, constants)
    return model.energy(y, constants), normal, tangential


@njit(**INNER)
def prepared(lane, rate):
    """Do nothing: the equations need nothing but the constants."""


@njit(**INNER)
def unchanged(lane, status, move, recording):
    """Return status and move; the lane goes on as it is."""
    return status, move


@njit(**INNER)
def past_rim(lane, status, move, recording):
    """Return status and move of a run that has no other limit but the rim."""
    return RIM if status == LIMIT else status, move


@njit(fastmath=FASTMATH, **INNER)
def derive(lane):
    """Set the derivative at the start of the step, and return spin and its rate."""
    y = lane.y
    f = lane.problem.model.rhs(y, lane.constants)
    lane.f = f
    return lane.problem.model.spin(y), lane.problem.model.spin_rate(y, f)


# Amplitudes and windows.


@njit(**INNER)
def compare(lane):
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
    compare(lane)
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
def pass_marks(lane, t, run, recording):
    """Make the comparisons and close the windows that are due by time ``t``."""
    include_end(lane)
    while t >= lane.next:
        if lane.mark < lane.window_end:
            compare(lane)
            lane.mark *= 2.0
        else:
            close_window(lane, run, recording)
            lane.mark = 1e290
        lane.next = min(lane.mark, lane.window_end)


@njit(fastmath=FASTMATH, **INNER)
def settled(lane, most):
    """Return whether no amplitude grew in two windows and little oscillation is left.

    ``most`` is the largest oscillation of a settled run, or 0 if none may settle.
    """
    if most == 0.0 or lane.window_no < 2.0 or lane.growth > 1.0 or lane.t_zero >= 0.0:
        return False
    _, oscillation = lane.problem.model.error(lane.y1, lane.y1, lane.constants)
    return oscillation <= most


@njit(**INNER)
def include_end(lane):
    """Let the end of the step just tried count in the present window."""
    lane.a_max = max(lane.a_max, lane.amplitude)
    lane.window_n_min = min(lane.window_n_min, lane.n1)
    lane.window_n_max = max(lane.window_n_max, lane.n1)


# Functions of the state, for the searches in `lanes.events`.


@scalar
def contact_points(lane, h, y, f):
    """Return the ratio of the contact forces and the negative normal force."""
    # The rates are differences along the flow; an error of them only moves the place
    # at which an extreme is evaluated.
    ahead = DIFFERENCE / lane.swing
    contact = lane.problem.model.contact
    normal, tangential = contact(y, lane.constants)
    ratio = tangential / abs(normal)
    later_normal, tangential = contact(moved(y, f, ahead), lane.constants)
    rate = (tangential / abs(later_normal) - ratio) / ahead
    lift_rate = (normal - later_normal) / ahead
    return Point(h, ratio, rate), Point(h, -normal, lift_rate)


@scalar
def limit_point(lane, h, y, f):
    """Return the limit of the model."""
    ahead = DIFFERENCE / lane.swing
    limit = lane.problem.model.limit
    now = limit(y, lane.constants)
    later = limit(moved(y, f, ahead), lane.constants)
    return Point(h, now, (later - now) / ahead)


@scalar
def no_limit(lane, h, y, f):
    """Return the limit of a model that holds everywhere."""
    return Point(h, 1.0, 0.0)


@scalar
def no_rim(lane, y):
    """Return the height that is left below the rim of a body without one."""
    return 1.0


@scalar
def below_rim(lane, y):
    """Return the height that is left between the contact and the rim."""
    return lane.rim - lane.problem.model.rise(y, lane.constants)


@scalar
def rim_point(lane, h, y, f):
    """Return the height that is left below the rim."""
    ahead = DIFFERENCE / lane.swing
    now = below_rim(lane, y)
    later = below_rim(lane, moved(y, f, ahead))
    return Point(h, now, (later - now) / ahead)


@njit(fastmath=FASTMATH, **INNER)
def observe_limit(problem, w):
    """Compute the limit of the model at the end of the step tried on every lane."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        end = problem.hooks.limit(lane, lane.h, lane.y1, lane.f1)
        start = lane.limit0
        lane.limit1 = end
        leaves = 1.0 if may_fall(start, end) else 0.0
        lane.leaves = leaves
        lane.watched += leaves


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
        peak &= (lane.lift0.value < 0.0) & (lift.value < 0.0)
        peak |= may_peak(lane.lift0, lift, -lane.normal_min)
        lane.watched += 1.0 if peak else 0.0


@njit(**INNER)
def observe_spin(problem, w):
    """Compute which steps tried may complete a turn or hold its largest spin."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        start, end = turn_points(lane)
        peak = (start.value > 0.0) & may_peak(start, end, least_turn(lane))
        lane.watched += 1.0 if peak | may_be_far(lane) else 0.0


@njit(**INNER)
def observe_marks(problem, w, marks):
    """Compute which steps tried may hold a mark that has not been reached."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        run = int(lane.run)
        due = 0
        if run >= 0 and lane.n_launch != 0.0:
            for k in range(len(MARKS)):
                if not marks[run, 0, k] >= 0.0 and may_reach(lane, k):
                    due += 1 << k
        lane.marks_due = due
        lane.watched += due


@njit(**INNER)
def note_mark(lane, marks):
    """Store the mark that was found in the step, if there is one."""
    if lane.mark_found > 0.0:
        marks[int(lane.run), 0, int(lane.mark_found) - 1] = lane.t_mark
        lane.mark_found = 0.0


@njit(**INNER)
def start_points(lane):
    """Let the functions at the end of the step be those at the next start."""
    limit = lane.limit1
    ratio = lane.ratio1
    lift = lane.lift1
    lane.limit0 = Point(0.0, limit.value, limit.rate)
    lane.ratio0 = Point(0.0, ratio.value, ratio.rate)
    lane.lift0 = Point(0.0, lift.value, lift.rate)


@njit(**INNER)
def note_contact(lane):
    """Let the end of the step just tried count in the extremes of the contact."""
    lane.ratio_max = max(lane.ratio_max, lane.ratio1.value)
    lane.normal_min = min(lane.normal_min, -lane.lift1.value)


# Reversals.


@njit(**INNER)
def is_dead(lane):
    """Return whether too little energy is left for a reversal at the step's end."""
    if lane.dead == 0.0:
        return False
    return 1.0 + lane.problem.hooks.work(lane) / lane.energy0 < lane.dead


@njit(**INNER)
def note_zero(lane, t, reversals):
    """Note a zero of the spin at time ``t`` in a run that continues after it."""
    lane.n_least = min(lane.n_least, 0.0)
    lane.t_crossed = t
    # After a launch without spin, no zero counts before the spin has been far.
    if lane.side == 0.0 or is_dead(lane):
        return
    if lane.t_zero < 0.0:
        lane.t_zero = t
    if recorded(reversals) and lane.t_pending < 0.0:
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


# Start and end of a run.


@njit(**INNER)
def start(lane, run, y0, constants, probe, plan):
    """Start a run in a lane."""
    clear(lane)
    model = lane.problem.model
    lane.run = run
    lane.root0 = 1.0
    lane.y = first_of(y0[run], model.n_state)
    lane.constants = first_of(constants[run], model.n_constants)
    lane.probe = first_of(probe[run], model.n_probe)
    lane.problem.hooks.prepare(lane, plan[run, RATE])
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
    lane.t_zero = lane.t_pending = lane.t_crossed = -1.0
    lane.awaited = NEVER
    if plan[run, TAPPED] > 0.0:
        lane.awaited = plan[run, FAR]
        lane.arm = 1.0
        lane.arm_rate = lane.far_rate = plan[run, RATE]
        lane.rate_max = UNKNOWN_RATE
        lane.side = 0.0
    lane.n_least = abs(n)
    lane.energy0 = energy_at(lane, lane.y)
    lane.rim = plan[run, RIM_HEIGHT]
    if lane.problem.hooks.left(lane, lane.y) <= 0.0:
        lane.watched = 1.0
    lane.limit1 = lane.problem.hooks.limit(lane, 0.0, lane.y, lane.f)
    lane.ratio1, lane.lift1 = contact_points(lane, 0.0, lane.y, lane.f)
    lane.normal_min = 1e290
    note_contact(lane)
    start_points(lane)
    lane.fuzz = plan[run, FUZZ]
    lane.dead = plan[run, DEAD]
    lane.h_longest = plan[run, LONGEST]
    if plan[run, FIRST_STEP] >= lane.t_end:
        lane.last = 1.0
    lane.h = lane.h_next = min(plan[run, FIRST_STEP], lane.t_end)


@njit(**INNER)
def idle(lane):
    """Empty a lane: a spinning state and steps of size zero, so that nothing is due."""
    clear(lane)
    lane.run = -1.0
    lane.y, lane.constants, lane.probe = lane.problem.idle
    n, _ = derive(lane)
    lane.n0 = n
    lane.sign = 1.0
    lane.t_end = lane.window_end = lane.next = 1e290
    lane.awaited = NEVER


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
    lane.slip1 = lane.slip


@njit(**INNER)
def finish(lane, status, reversal, t, run, result, counts, recording):
    """Store the results of a run that ends with the step just tried, at time ``t``."""
    energy0 = lane.energy0
    drift = (lane.problem.hooks.energy(lane) - energy0) / energy0
    if status in (OK, LIMIT, RIM) and not abs(drift) <= MAX_ENERGY_DRIFT:
        status = ENERGY if isfinite(drift) else NONFINITE
    n = lane.n1
    include_end(lane)
    if t - lane.window_no * lane.window > 0.9 * lane.window:
        close_window(lane, run, recording)
    t_r = t if reversal and status == OK and not is_dead(lane) else nan
    if recorded(recording.reversals):
        note_turn(lane, recording.reversals)
    # A failure after the first zero leaves it valid, unless the energy has drifted.
    if goes_on(lane.problem, recording) and lane.t_zero > 0.0 and status != ENERGY:
        t_r = lane.t_zero
    if recorded(recording.energy):
        recording.energy[run, 0, 0] = max(lane.drift_max, abs(drift))
    if recorded(recording.contact):
        note_contact(lane)
        recording.contact[run, 0, 0] = lane.ratio_max
        recording.contact[run, 0, 1] = lane.normal_min
    if recorded(recording.volume) and status == OK:
        recording.volume[run, 0, 0] = (lane.volume + lane.h * lane.volume_rate1) / t
    result[run, T_END] = t
    result[run, T_R] = t_r
    result[run, N_END] = n
    result[run, DRIFT] = drift
    # The first comparison only sets the reference.
    result[run, GROWTH] = sqrt(lane.growth) - 1.0 if lane.compared > 1.0 else nan
    lost = min(lane.n_least, lane.sign * n) / abs(lane.n_launch)
    result[run, DEPARTURE] = 1.0 - lost
    result[run, ENERGY_0] = energy0
    for i, component in enumerate(lane.y1):
        result[run, FIRST_STATE + i] = component
    counts[run, STATUS] = status
    counts[run, STEPS] = int(lane.steps)
    counts[run, NEAR] = int(lane.near)
    counts[run, REJECTED] = int(lane.rejected)
    counts[run, TURNS] = int(lane.reversals)


@njit(**INNER)
def advance(problem, w):
    """Move all lanes to the end of their step."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        lane.y = lane.y1
        lane.f = lane.f1


# A tangent.


@njit(fastmath=FASTMATH, **INNER)
def start_tangent(lane):
    """Give a lane the model's first tangent, made transverse and of norm 1."""
    model = lane.problem.model
    lane.v = model.seed(lane.y, lane.constants)
    p, q, a, b, c = model.transverse(lane.y, lane.f, lane.v, lane.constants)
    norm = sqrt(model.square((p, q, a, b, c), lane.constants))
    v = p / norm, q / norm, a / norm, b / norm, c / norm
    lane.v = v
    # All components but the last are read again.  This decides which products are
    # fused, and so keeps the last bits of the exponents.
    barrier()
    lane.g = model.rate(lane.y, lane.f, lane.v[:-1] + v[-1:], lane.constants)
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
        size = problem.model.square(lane.v, lane.constants)
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
def window_row(lane):
    """Return the row of the window in the table of growths."""
    return min(int(lane.window_no), N_WINDOWS - 1)


@njit(fastmath=FASTMATH, **INNER)
def note_tangent(lane, t, run, k, growths):
    """Store the time and the tangent's growth in row ``k``."""
    barrier()
    growths[run, k, 0] = t
    growth = 0.5 * log(lane.problem.model.square(lane.v1, lane.constants))
    growths[run, k, 1] = growth + LOG_2 * lane.shift
    barrier()


# A frame of tangents, which is made orthonormal after each step.


@njit(fastmath=FASTMATH, **INNER)
def start_frame(lane):
    """Give a lane the model's first frame, made transverse and orthonormal."""
    model = lane.problem.model
    q = lane.constants
    frame = model.transverse(lane.y, lane.f, model.seed(lane.y, q), q)
    lane.v = model.solve(frame, model.factor(frame, q))
    lane.g = model.rate(lane.y, lane.f, lane.v, q)
    flow, steep = model.trivial(lane.y, lane.f, q)
    lane.flow0 = 0.5 * log(flow)
    lane.steep0 = 0.5 * log(steep)
    lane.length = 1.0, 1.0, 1.0
    lane.shifts = 0.0, 0.0, 0.0


@scalar
def _scaled(length):
    """Return a growth with a power of two taken out, and its exponent."""
    factor = SHORTER if length > LONGER else 1.0
    factor = LONGER if length < SHORTER else factor
    out = 1.0 * SHIFT if length > LONGER else 0.0
    out = -1.0 * SHIFT if length < SHORTER else out
    return length * factor, out


@njit(fastmath=FASTMATH, **INNER)
def advance_frame(problem, w):
    """Move the frames of all lanes to the end of their step."""
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        frame = lane.v1
        triangle = problem.model.factor(frame, lane.constants)
        # A lane that does not move keeps its frame to the last bit.
        moves = lane.accept > 0.0
        r11, r22, r33, r12, r13, r23 = triangle
        triangle = (
            r11 if moves else 1.0,
            r22 if moves else 1.0,
            r33 if moves else 1.0,
            r12 if moves else 0.0,
            r13 if moves else 0.0,
            r23 if moves else 0.0,
        )
        lane.v = problem.model.solve(frame, triangle)
        lane.g = problem.model.solve(lane.g1, triangle)
        first, second, third = lane.length
        first, out_1 = _scaled(first * triangle[0])
        second, out_2 = _scaled(second * triangle[1])
        third, out_3 = _scaled(third * triangle[2])
        lane.length = first, second, third
        s1, s2, s3 = lane.shifts
        lane.shifts = s1 + out_1, s2 + out_2, s3 + out_3


@njit(fastmath=FASTMATH, **INNER)
def note_frame(lane, t, run, k, growths):
    """Store the time and the five growths in row ``k``.

    Where the flow has decayed too far to tell its direction, the row stays empty.
    """
    model = lane.problem.model
    barrier()
    flow, steep = model.trivial(lane.y1, lane.f1, lane.constants)
    if flow < NO_FLOW:
        return
    triangle = model.factor(lane.v1, lane.constants)
    growths[run, k, 0] = t
    for i in range(len(lane.length)):
        growth = log(lane.length[i] * triangle[i])
        growths[run, k, 1 + i] = growth + LOG_2 * lane.shifts[i]
    growths[run, k, FLOW_GROWTH] = 0.5 * log(flow) - lane.flow0
    growths[run, k, ENERGY_GROWTH] = lane.steep0 - 0.5 * log(steep)
    barrier()


# A run and its tangents.


@njit(**INNER)
def start_both(lane, run, y0, constants, probe, plan):
    """Start a run with tangents in a lane."""
    start(lane, run, y0, constants, probe, plan)
    barrier()
    lane.problem.hooks.start_tangents(lane)
    barrier()


@njit(**INNER)
def advance_both(problem, w):
    """Move all lanes and their tangents to the end of their step."""
    advance(problem, w)
    problem.hooks.advance_tangents(problem, w)


@njit(**INNER)
def pass_marks_both(lane, t, run, recording):
    """Pass marks, and store the growth of tangents at the end of a window.

    That of a frame is also stored at the marks in the first window.
    """
    k = window_row(lane)
    if t < lane.window_end:
        k = N_WINDOWS + int(lane.compared)
    if k < recording.lyapunov.shape[1]:
        lane.problem.hooks.note_tangents(lane, t, run, k, recording.lyapunov)
    pass_marks(lane, t, run, recording)


@njit(**INNER)
def finish_both(lane, status, reversal, t, run, result, counts, recording):
    """Store the results of a run, and the growth of its tangents."""
    k = window_row(lane)
    lane.problem.hooks.note_tangents(lane, t, run, k, recording.lyapunov)
    finish(lane, status, reversal, t, run, result, counts, recording)


def hooks_of(model: Model, rimmed: bool) -> Hooks:
    """Return the functions that differ between models."""
    hooks = Hooks(
        start=start,
        prepare=prepared,
        pass_marks=pass_marks,
        finish=finish,
        advance=advance,
        limit=no_limit if model.limit is None else limit_point,
        left=no_rim,
        observe_limit=observe_limit,
        energy=energy_after,
        work=work_after,
        change=unchanged,
        observe=observe,
    )
    if rimmed:
        hooks = replace(hooks, limit=rim_point, left=below_rim, change=past_rim)
    if model.n_tangents == 0:
        return hooks
    hooks = replace(
        hooks,
        start=start_both,
        pass_marks=pass_marks_both,
        finish=finish_both,
        advance=advance_both,
        start_tangents=start_tangent,
        advance_tangents=advance_tangent,
        note_tangents=note_tangent,
    )
    if model.n_tangents == 1:
        return hooks
    return replace(
        hooks,
        start_tangents=start_frame,
        advance_tangents=advance_frame,
        note_tangents=note_frame,
    )
