"""What happens to a single lane: a run begins, a window closes, a run ends.

Templates like those of :mod:`rattlesweep.integrate.lanes.kernel`, which calls them for the few
lanes where something is due.
"""

# mypy: ignore-errors
from __future__ import annotations

from math import isfinite, nan, sqrt

from rattlesweep.integrate.lanes import columns as C
from rattlesweep.integrate.lanes import rows as R
from rattlesweep.integrate.lanes.rows import AMPLITUDE, N1, RATE1
from rattlesweep.integrate.status import Status

OK = int(Status.OK)
NONFINITE = int(Status.NONFINITE)
ENERGY = int(Status.ENERGY)

MAX_ENERGY_DRIFT = 0.01
TINY = 1e-290
# Of the first squared amplitude: what has decayed by 1e-9 is gone.  A mode that dies at once would
# else be followed into the rounding of the other.
FLOOR = 1e-18
# Bound of a spin's rate that makes every step due.
UNKNOWN_RATE = 1e290

# Bound by kernels.build.
N_STATE = N_CONSTANTS = N_PROBE = 0
Y = Y1 = Q = PROBE = 0


def lane_energy(lane, row):
    """Energy of a lane at the state from row ``row`` on."""
    raise NotImplementedError


def lane_contact(lane, row):
    """Normal and tangential contact force."""
    raise NotImplementedError


def lane_oscillation(lane, row):
    """Square of the oscillation that step errors are compared with."""
    raise NotImplementedError


def lane_rhs(lane):
    """Derivative at the state Y into F; returns the spin and its rate."""
    raise NotImplementedError


def compare(lane):
    """Compare the largest amplitude since the last time with the smallest one before."""
    largest = max(lane[R.A_MAX], lane[R.A_FLOOR], TINY)
    if lane[R.COMPARED] > 0.0:
        lane[R.GROWTH] = max(lane[R.GROWTH], largest / lane[R.A_MIN])
        largest = min(largest, lane[R.A_MIN])
    else:
        lane[R.A_FLOOR] = FLOOR * largest
    lane[R.A_MIN] = largest
    lane[R.COMPARED] += 1.0
    lane[R.W_A_MAX] = max(lane[R.W_A_MAX], lane[R.A_MAX])
    # The state at the border belongs to both sides.
    lane[R.A_MAX] = lane[AMPLITUDE]


def close_window(lane, run, windows, record):
    """Compare, and write the window down if that was asked for."""
    compare(lane)
    k = int(lane[R.WINDOW_NO])
    if record[C.REC_WINDOWS] and k < windows.shape[1]:
        windows[run, k, 0] = sqrt(lane[R.W_A_MAX])
        windows[run, k, 1] = lane[R.W_N_MIN]
        windows[run, k, 2] = lane[R.W_N_MAX]
    lane[R.W_A_MAX] = lane[AMPLITUDE]
    lane[R.W_N_MIN] = lane[N1]
    lane[R.W_N_MAX] = lane[N1]
    lane[R.WINDOW_NO] = k + 1
    lane[R.WINDOW_END] = (k + 2) * lane[R.WINDOW]


def pass_marks(lane, t, run, windows, record):
    """Close the windows, and compare at the marks within the first, that end by time ``t``."""
    reach_border(lane)
    while t >= lane[R.NEXT]:
        if lane[R.MARK] < lane[R.WINDOW_END]:
            compare(lane)
            lane[R.MARK] *= 2.0
        else:
            close_window(lane, run, windows, record)
            lane[R.MARK] = 1e290
        lane[R.NEXT] = min(lane[R.MARK], lane[R.WINDOW_END])


def settled(lane, most):
    """Whether the amplitude never grew in two windows or more, and all oscillation is `most`.

    Not within the first window: the last comparison there is after any short time.
    """
    if most == 0.0 or lane[R.WINDOW_NO] < 2.0 or lane[R.GROWTH] > 1.0 or lane[R.T_ZERO] >= 0.0:
        return False
    return lane_oscillation(lane, Y1) <= most


def reach_border(lane):
    """Count the state at the end of the step just tried to the window."""
    lane[R.A_MAX] = max(lane[R.A_MAX], lane[AMPLITUDE])
    lane[R.W_N_MIN] = min(lane[R.W_N_MIN], lane[N1])
    lane[R.W_N_MAX] = max(lane[R.W_N_MAX], lane[N1])


def see_contact(lane, row):
    """Note the contact force at the state in row ``row``."""
    normal, tangential = lane_contact(lane, row)
    lane[R.NORMAL_MIN] = min(lane[R.NORMAL_MIN], normal)
    lane[R.RATIO_MAX] = max(lane[R.RATIO_MAX], tangential / abs(normal))


def see_zero(lane, t):
    """Note a zero of the spin at time ``t``, of a run that goes on behind it."""
    lane[R.N_LEAST] = min(lane[R.N_LEAST], 0.0)
    if lane[R.T_ZERO] < 0.0:
        lane[R.T_ZERO] = t
    if lane[R.T_PENDING] < 0.0:
        lane[R.T_PENDING] = t


def see_side(lane, windows, record):
    """Count a reversal once the spin is far on the other side, and note its largest size since.

    Written into the columns of the windows behind those of :func:`close_window`.
    """
    run = int(lane[R.RUN])
    at = 3 if record[C.REC_WINDOWS] else 0
    n = lane[N1]
    if abs(n) > lane[R.FAR]:
        side = 1.0 if n > 0.0 else -1.0
        if side * lane[R.SIDE] < 0.0:
            k = int(lane[R.REVERSALS])
            lane[R.REVERSALS] += 1.0
            lane[R.N_AFTER] = 0.0
            if k < C.MOST_REVERSALS:
                windows[run, k, at] = lane[R.T_PENDING]
        lane[R.SIDE] = side
        lane[R.T_PENDING] = -1.0
    k = int(lane[R.REVERSALS]) - 1
    if k >= 0 and abs(n) > lane[R.N_AFTER]:
        lane[R.N_AFTER] = abs(n)
        if k < C.MOST_REVERSALS:
            windows[run, k, at + 1] = abs(n)


def start(lane, run, y0, constants, probe, plan, record):
    """Put a run into a lane."""
    for i in range(N_STATE):
        lane[Y + i] = y0[run, i]
    for i in range(N_CONSTANTS):
        lane[Q + i] = constants[run, i]
    for i in range(N_PROBE):
        lane[PROBE + i] = probe[run, i]
    for i in range(R.STATE_ROWS):
        lane[i] = 0.0
    lane[R.RUN] = run
    lane[R.ROOT0] = 1.0
    n, rate = lane_rhs(lane)
    swing = plan[run, C.SWING]
    lane[R.T_END] = plan[run, C.HORIZON]
    lane[R.SWING] = swing
    lane[R.WINDOW] = plan[run, C.WINDOW]
    lane[R.WINDOW_END] = plan[run, C.WINDOW]
    lane[R.MARK] = plan[run, C.FIRST_MARK]
    lane[R.NEXT] = min(plan[run, C.FIRST_MARK], plan[run, C.WINDOW])
    lane[R.RATE_MAX] = plan[run, C.RATE]
    lane[R.N_START] = n
    lane[R.N0] = n
    lane[R.RATE0] = rate
    lane[R.SIGN] = 1.0 if n > 0.0 else -1.0
    lane[R.FAR] = plan[run, C.FAR]
    lane[R.SIDE] = lane[R.SIGN]
    lane[R.T_ZERO] = -1.0
    lane[R.T_PENDING] = -1.0
    if plan[run, C.TAPPED] > 0.0:
        lane[R.ARM] = plan[run, C.FAR]
        lane[R.ARM_RATE] = plan[run, C.RATE]
        lane[R.RATE_MAX] = UNKNOWN_RATE
        lane[R.SIDE] = 0.0
    lane[R.N_LEAST] = abs(n)
    lane[R.W_N_MIN] = n
    lane[R.W_N_MAX] = n
    lane[R.ENERGY0] = lane_energy(lane, Y)
    lane[R.NORMAL_MIN] = 1e290
    if record[C.REC_CONTACT]:
        see_contact(lane, Y)
    lane[R.FUZZ] = plan[run, C.FUZZ]
    h = plan[run, C.FIRST_STEP]
    if h >= plan[run, C.HORIZON]:
        h = plan[run, C.HORIZON]
        lane[R.LAST] = 1.0
    lane[R.H_NEXT] = h


def idle(lane):
    """Leave a lane empty: some spinning state and steps of zero, so that nothing is ever due."""
    for i in range(N_STATE):
        lane[Y + i] = 1.0
    for i in range(N_CONSTANTS):
        lane[Q + i] = 1.0
    for i in range(N_PROBE):
        lane[PROBE + i] = 0.0
    for i in range(R.STATE_ROWS):
        lane[i] = 0.0
    lane[R.RUN] = -1.0
    n, _ = lane_rhs(lane)
    lane[R.N0] = n
    lane[R.SIGN] = 1.0
    lane[R.T_END] = 1e290
    lane[R.WINDOW_END] = 1e290
    lane[R.NEXT] = 1e290


def stay(lane):
    """Make the end of the step tried its start, in a lane that does not take it."""
    for i in range(2 * N_STATE):
        lane[Y1 + i] = lane[Y + i]
    lane[N1] = lane[R.N0]
    lane[RATE1] = lane[R.RATE0]
    lane[AMPLITUDE] = lane[R.A_MAX]
    lane[R.ROOT] = lane[R.ROOT0]


def finish(lane, status, reversal, t, run, result, counts, windows, record):
    """Write down a run that has ended at the end of the step just tried, at time ``t``."""
    energy0 = lane[R.ENERGY0]
    drift = (lane_energy(lane, Y1) - energy0) / energy0
    if status == OK and not abs(drift) <= MAX_ENERGY_DRIFT:
        status = ENERGY if isfinite(drift) else NONFINITE
    n = lane[N1]
    least = min(lane[R.N_LEAST], lane[R.SIGN] * n)
    reach_border(lane)
    begun = lane[R.WINDOW_NO] * lane[R.WINDOW]
    if t - begun > 0.9 * lane[R.WINDOW]:
        close_window(lane, run, windows, record)
    if record[C.REC_CONTACT]:
        see_contact(lane, Y1)
    result[run, C.T_END] = t
    result[run, C.T_R] = t if reversal and status == OK else nan
    if record[C.REC_REVERSALS]:
        see_side(lane, windows, record)
        if lane[R.T_ZERO] > 0.0 and status == OK:
            result[run, C.T_R] = lane[R.T_ZERO]
    result[run, C.N_END] = n
    result[run, C.DRIFT] = drift
    growth = lane[R.GROWTH]
    # Twice at least, or there was nothing to compare with.
    result[run, C.GROWTH] = sqrt(growth) - 1.0 if lane[R.COMPARED] > 1.0 else nan
    result[run, C.DEPARTURE] = 1.0 - least / abs(lane[R.N_START])
    result[run, C.ENERGY_0] = energy0
    result[run, C.DRIFT_MAX] = max(lane[R.DRIFT_MAX], abs(drift))
    result[run, C.RATIO_MAX] = lane[R.RATIO_MAX]
    result[run, C.NORMAL_MIN] = lane[R.NORMAL_MIN]
    for i in range(N_STATE):
        result[run, C.FIRST_STATE + i] = lane[Y1 + i]
    counts[run, C.STATUS] = status
    counts[run, C.STEPS] = int(lane[R.STEPS])
    counts[run, C.NEAR] = int(lane[R.NEAR])
    counts[run, C.REJECTED] = int(lane[R.REJECTED])
    counts[run, C.REVERSALS] = int(lane[R.REVERSALS])
