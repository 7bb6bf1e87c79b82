"""Runs that carry a tangent: how they begin, are watched, end and move on.

The functions do what those of the same names in :mod:`runs` and :mod:`kernel` do, and look after
the tangent.  Barriers keep the two apart, so that the last bits of the state are those of a run
without one.  The tangent obeys a linear equation, so its length may be changed at any time: it is
multiplied by a power of two when it has become very long or short, which rounds nothing.
"""

# mypy: ignore-errors
from __future__ import annotations

from math import log, sqrt

from numba import njit

from rattlesweep.integrate.lanes import kernel, runs
from rattlesweep.integrate.lanes.intrinsics import INNER, barrier, over, times, widest_vectors
from rattlesweep.integrate.lanes.lane import lane_of
from rattlesweep.physics.full import FASTMATH

# The norm of a tangent stays within 2^-SHIFT .. 2^SHIFT.
SHIFT, LOG_2 = 200, log(2.0)
SHORTER, LONGER = 2.0**-SHIFT, 2.0**SHIFT
LONG, SHORT = LONGER**2, SHORTER**2


@njit(fastmath=FASTMATH, **INNER)
def seed(lane):
    """Give a lane the model's first tangent."""
    lane.v = lane.problem.seed(*(lane.y + lane.constants))


@njit(fastmath=FASTMATH, **INNER)
def begin(lane):
    """Make it transverse and of norm 1."""
    v = lane.problem.transverse(*(lane.y + lane.f + lane.v + lane.constants))
    v = over(v, sqrt(lane.problem.square(*(v + lane.constants))))
    lane.v = v
    # What is read afresh decides which products are fused: the last bits of all exponents so far.
    barrier()
    lane.g = lane.problem.rate(*(lane.y + lane.f + lane.v[:-1] + v[-1:] + lane.constants))
    lane.shift = 0.0


@njit(fastmath=FASTMATH, **INNER)
def growth(lane):
    """Return the logarithm of the tangent's growth from the launch to the end of the step."""
    return 0.5 * log(lane.problem.square(*(lane.v1 + lane.constants))) + LOG_2 * lane.shift


@njit(fastmath=FASTMATH, **INNER)
def tangent_advance(problem, w):
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
        lane.v = times(lane.v, factor)
        lane.g = times(lane.g, factor)
        lane.shift += out


@njit(**INNER)
def advance(problem, w):
    """Move all lanes and their tangents to the end of their step."""
    kernel.advance(problem, w)
    tangent_advance(problem, w)


@njit(**INNER)
def start(lane, run, y0, constants, probe, plan, record):
    """Put a run and its tangent into a lane."""
    runs.start(lane, run, y0, constants, probe, plan, record)
    barrier()
    seed(lane)
    begin(lane)
    barrier()


@njit(**INNER)
def see_tangent(lane, t, run, windows):
    """Write the time and the tangent's growth into the last two columns of the window's row."""
    k = min(int(lane.window_no), windows.shape[1] - 1)
    barrier()
    windows[run, k, windows.shape[2] - 2] = t
    windows[run, k, windows.shape[2] - 1] = growth(lane)
    barrier()


@njit(**INNER)
def pass_marks(lane, t, run, windows, record):
    """Note the tangent at the end of a window."""
    if t >= lane.window_end:
        see_tangent(lane, t, run, windows)
    runs.pass_marks(lane, t, run, windows, record)


@njit(**INNER)
def finish(lane, status, reversal, t, run, result, counts, windows, record):
    """Write down a run that has ended, and its tangent."""
    see_tangent(lane, t, run, windows)
    runs.finish(lane, status, reversal, t, run, result, counts, windows, record)
