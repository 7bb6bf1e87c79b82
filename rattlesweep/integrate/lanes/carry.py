"""A run that carries a tangent: what is added to how runs begin, are watched and end.

Templates that stand in for those of the same names in :mod:`rattlesweep.integrate.lanes.runs`, do
what these do, and look after the tangent.  Barriers keep the two apart: the state's last bits
are those of a run without tangent.

The tangent obeys a linear equation, so its length may be changed at any time.  It is multiplied by
a power of two when it has become very long or short; that rounds nothing, costs no
logarithm, and the tangent never overflows.
"""

# mypy: ignore-errors
from __future__ import annotations

from math import log, sqrt

from rattlesweep.integrate.lanes.atomics import barrier, widest_vectors
from rattlesweep.integrate.lanes.bound import L, lane_of
from rattlesweep.integrate.lanes.cells import each

times, over = each("fmul"), each("fdiv")
# A tangent is multiplied by a power of two when its norm leaves 2^-SHIFT .. 2^SHIFT.
SHIFT = 200
SHORTER, LONGER = 2.0**-SHIFT, 2.0**SHIFT
LONG, SHORT = LONGER**2, SHORTER**2
LOG_2 = log(2.0)

# Of :class:`rattlesweep.integrate.model.Tangent`; bound by build, as what STAND_INS stand in for.
rate = seed = transverse = square = None
plain_start = plain_finish = plain_pass_marks = plain_advance = None


def tangent_seed(lane):
    """Give a lane the model's first tangent."""
    lane.v = seed(*(lane.y + lane.constants))


def tangent_begin(lane):
    """Make it transverse and of norm 1."""
    v = transverse(*(lane.y + lane.f + lane.v + lane.constants))
    v = over(v, sqrt(square(*(v + lane.constants))))
    lane.v = v
    # What is read afresh decides which products are fused: the last bits of all exponents so far.
    barrier()
    lane.g = rate(*(lane.y + lane.f + lane.v[:-1] + v[-1:] + lane.constants))
    lane.shift = 0.0


def tangent_log(lane):
    """Logarithm of the tangent's growth from the start of the run to the end of the step."""
    return 0.5 * log(square(*(lane.v1 + lane.constants))) + LOG_2 * lane.shift


def tangent_advance(w):
    """Move the tangents of all lanes to the end of their step."""
    widest_vectors()
    for l in range(L):
        lane = lane_of(w, l)
        lane.v = lane.v1
        lane.g = lane.g1
    for l in range(L):
        lane = lane_of(w, l)
        size = square(*(lane.v + lane.constants))
        factor = SHORTER if size > LONG else 1.0
        factor = LONGER if size < SHORT else factor
        out = 1.0 * SHIFT if size > LONG else 0.0
        out = -1.0 * SHIFT if size < SHORT else out
        lane.v = times(lane.v, factor)
        lane.g = times(lane.g, factor)
        lane.shift += out


def start(lane, run, y0, constants, probe, plan, record):
    """Put a run and its tangent into a lane."""
    plain_start(lane, run, y0, constants, probe, plan, record)
    barrier()
    tangent_seed(lane)
    tangent_begin(lane)
    barrier()


def see_tangent(lane, t, run, windows):
    """Write the time and the tangent's growth into the last two columns of the window's row."""
    k = min(int(lane.window_no), windows.shape[1] - 1)
    barrier()
    windows[run, k, windows.shape[2] - 2] = t
    windows[run, k, windows.shape[2] - 1] = tangent_log(lane)
    barrier()


def pass_marks(lane, t, run, windows, record):
    """Note the tangent at the end of a window."""
    if t >= lane.window_end:
        see_tangent(lane, t, run, windows)
    plain_pass_marks(lane, t, run, windows, record)


def finish(lane, status, reversal, t, run, result, counts, windows, record):
    """Write down a run that has ended, and its tangent."""
    see_tangent(lane, t, run, windows)
    plain_finish(lane, status, reversal, t, run, result, counts, windows, record)


def advance(w):
    """Move all lanes and their tangents to the end of their step."""
    plain_advance(w)
    tangent_advance(w)


TANGENTS = (tangent_seed, tangent_begin, tangent_log, tangent_advance)
STAND_INS = (see_tangent, start, pass_marks, finish, advance)
