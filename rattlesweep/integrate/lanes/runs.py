"""What happens to a single lane: a run begins, a window closes, a run ends.

Templates like those of :mod:`rattlesweep.integrate.lanes.kernel`, which calls them for the few
lanes where something is due.
"""

# mypy: ignore-errors
from __future__ import annotations

from math import isfinite, nan, sqrt

from rattlesweep.integrate.lanes import columns as C
from rattlesweep.integrate.lanes import rows as R
from rattlesweep.integrate.lanes.step import LANES as L
from rattlesweep.integrate.status import Status

OK = int(Status.OK)
NONFINITE = int(Status.NONFINITE)
ENERGY = int(Status.ENERGY)

MAX_ENERGY_DRIFT = 0.01
TINY = 1e-290
# Of the first squared amplitude: what has decayed by 1e-9 is gone.  A mode that dies at once would
# else be followed into the rounding of the other.
FLOOR = 1e-18

# Bound by kernels.build.
N_STATE = N_CONSTANTS = N_PROBE = 0
Y = Y1 = Q = PROBE = N1 = AMPLITUDE = 0


def lane_energy(w, row, l):
    """Energy of lane ``l`` at the state in row ``row``."""
    raise NotImplementedError


def lane_contact(w, row, l):
    """Normal and tangential contact force."""
    raise NotImplementedError


def lane_rhs(w, l):
    """Derivative at the state Y into F; returns the spin and its rate."""
    raise NotImplementedError


def compare(l, w):
    """Compare the largest amplitude since the last time with the smallest one before."""
    largest = max(w[R.A_MAX * L + l], w[R.A_FLOOR * L + l], TINY)
    if w[R.COMPARED * L + l] > 0.0:
        w[R.GROWTH * L + l] = max(w[R.GROWTH * L + l], largest / w[R.A_MIN * L + l])
        largest = min(largest, w[R.A_MIN * L + l])
    else:
        w[R.A_FLOOR * L + l] = FLOOR * largest
    w[R.A_MIN * L + l] = largest
    w[R.COMPARED * L + l] += 1.0
    w[R.W_A_MAX * L + l] = max(w[R.W_A_MAX * L + l], w[R.A_MAX * L + l])
    # The state at the border belongs to both sides.
    w[R.A_MAX * L + l] = w[AMPLITUDE * L + l]


def close_window(l, w, run, windows, record):
    """Compare, and write the window down if that was asked for."""
    compare(l, w)
    k = int(w[R.WINDOW_NO * L + l])
    if record[C.REC_WINDOWS] and k < windows.shape[1]:
        windows[run, k, 0] = sqrt(w[R.W_A_MAX * L + l])
        windows[run, k, 1] = w[R.W_N_MIN * L + l]
        windows[run, k, 2] = w[R.W_N_MAX * L + l]
    w[R.W_A_MAX * L + l] = w[AMPLITUDE * L + l]
    w[R.W_N_MIN * L + l] = w[N1 * L + l]
    w[R.W_N_MAX * L + l] = w[N1 * L + l]
    w[R.WINDOW_NO * L + l] = k + 1
    w[R.WINDOW_END * L + l] = (k + 2) * w[R.WINDOW * L + l]


def pass_marks(l, t, w, run, windows, record):
    """Close the windows, and compare at the marks within the first, that end by time ``t``."""
    reach_border(l, w)
    while t >= w[R.NEXT * L + l]:
        if w[R.MARK * L + l] < w[R.WINDOW_END * L + l]:
            compare(l, w)
            w[R.MARK * L + l] *= 2.0
        else:
            close_window(l, w, run, windows, record)
            w[R.MARK * L + l] = 1e290
        w[R.NEXT * L + l] = min(w[R.MARK * L + l], w[R.WINDOW_END * L + l])


def reach_border(l, w):
    """Count the state at the end of the step just tried to the window."""
    w[R.A_MAX * L + l] = max(w[R.A_MAX * L + l], w[AMPLITUDE * L + l])
    w[R.W_N_MIN * L + l] = min(w[R.W_N_MIN * L + l], w[N1 * L + l])
    w[R.W_N_MAX * L + l] = max(w[R.W_N_MAX * L + l], w[N1 * L + l])


def see_contact(l, w, row):
    """Note the contact force at the state in row ``row``."""
    normal, tangential = lane_contact(w, row, l)
    w[R.NORMAL_MIN * L + l] = min(w[R.NORMAL_MIN * L + l], normal)
    w[R.RATIO_MAX * L + l] = max(w[R.RATIO_MAX * L + l], tangential / abs(normal))


def start(l, run, w, lane_run, y0, constants, probe, plan, record):
    """Put a run into a lane."""
    lane_run[l] = run
    for i in range(N_STATE):
        w[(Y + i) * L + l] = y0[run, i]
    for i in range(N_CONSTANTS):
        w[(Q + i) * L + l] = constants[run, i]
    for i in range(N_PROBE):
        w[(PROBE + i) * L + l] = probe[run, i]
    for i in range(R.STATE_ROWS):
        w[i * L + l] = 0.0
    n, rate = lane_rhs(w, l)
    swing = plan[run, C.SWING]
    w[R.T_END * L + l] = plan[run, C.HORIZON]
    w[R.SWING * L + l] = swing
    w[R.WINDOW * L + l] = plan[run, C.WINDOW]
    w[R.WINDOW_END * L + l] = plan[run, C.WINDOW]
    w[R.MARK * L + l] = plan[run, C.FIRST_MARK]
    w[R.NEXT * L + l] = min(plan[run, C.FIRST_MARK], plan[run, C.WINDOW])
    w[R.RATE_MAX * L + l] = plan[run, C.RATE]
    w[R.N_START * L + l] = n
    w[R.N0 * L + l] = n
    w[R.RATE0 * L + l] = rate
    w[R.SIGN * L + l] = 1.0 if n > 0.0 else -1.0
    w[R.N_LEAST * L + l] = abs(n)
    w[R.W_N_MIN * L + l] = n
    w[R.W_N_MAX * L + l] = n
    w[R.ENERGY0 * L + l] = lane_energy(w, Y, l)
    w[R.NORMAL_MIN * L + l] = 1e290
    if record[C.REC_CONTACT]:
        see_contact(l, w, Y)
    w[R.FUZZ * L + l] = plan[run, C.FUZZ]
    h = plan[run, C.FIRST_STEP]
    if h >= plan[run, C.HORIZON]:
        h = plan[run, C.HORIZON]
        w[R.LAST * L + l] = 1.0
    w[R.H_NEXT * L + l] = h


def idle(l, w, lane_run):
    """Leave a lane empty: some spinning state and steps of zero, so that nothing is ever due."""
    lane_run[l] = -1
    for i in range(N_STATE):
        w[(Y + i) * L + l] = 1.0
    for i in range(N_CONSTANTS):
        w[(Q + i) * L + l] = 1.0
    for i in range(N_PROBE):
        w[(PROBE + i) * L + l] = 0.0
    for i in range(R.STATE_ROWS):
        w[i * L + l] = 0.0
    n, _ = lane_rhs(w, l)
    w[R.N0 * L + l] = n
    w[R.SIGN * L + l] = 1.0
    w[R.T_END * L + l] = 1e290
    w[R.WINDOW_END * L + l] = 1e290
    w[R.NEXT * L + l] = 1e290


def finish(l, status, reversal, t, w, run, result, counts, windows, record):
    """Write down a run that has ended at the end of the step just tried, at time ``t``."""
    energy0 = w[R.ENERGY0 * L + l]
    drift = (lane_energy(w, Y1, l) - energy0) / energy0
    if status == OK and not abs(drift) <= MAX_ENERGY_DRIFT:
        status = ENERGY if isfinite(drift) else NONFINITE
    n = w[N1 * L + l]
    least = min(w[R.N_LEAST * L + l], w[R.SIGN * L + l] * n)
    reach_border(l, w)
    begun = w[R.WINDOW_NO * L + l] * w[R.WINDOW * L + l]
    if t - begun > 0.9 * w[R.WINDOW * L + l]:
        close_window(l, w, run, windows, record)
    if record[C.REC_CONTACT]:
        see_contact(l, w, Y1)
    result[run, C.T_END] = t
    result[run, C.T_R] = t if reversal and status == OK else nan
    result[run, C.N_END] = n
    result[run, C.DRIFT] = drift
    growth = w[R.GROWTH * L + l]
    # Twice at least, or there was nothing to compare with.
    result[run, C.GROWTH] = sqrt(growth) - 1.0 if w[R.COMPARED * L + l] > 1.0 else nan
    result[run, C.DEPARTURE] = 1.0 - least / abs(w[R.N_START * L + l])
    result[run, C.ENERGY_0] = energy0
    result[run, C.DRIFT_MAX] = max(w[R.DRIFT_MAX * L + l], abs(drift))
    result[run, C.RATIO_MAX] = w[R.RATIO_MAX * L + l]
    result[run, C.NORMAL_MIN] = w[R.NORMAL_MIN * L + l]
    for i in range(N_STATE):
        result[run, C.FIRST_STATE + i] = w[(Y1 + i) * L + l]
    counts[run, C.STATUS] = status
    counts[run, C.STEPS] = int(w[R.STEPS * L + l])
    counts[run, C.NEAR] = int(w[R.NEAR * L + l])
    counts[run, C.REJECTED] = int(w[R.REJECTED * L + l])
