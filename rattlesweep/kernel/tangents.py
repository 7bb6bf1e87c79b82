"""Tangents that a run carries for its Lyapunov exponents: one, or a frame of them.

A tangent is scaled by a power of two when it has become very long or short. Barriers
keep the arithmetic of tangents apart from that of the state, whose bits are then the
same as without them.
"""

# mypy: ignore-errors
from dataclasses import dataclass
from math import log, sqrt
from typing import Annotated

from numba import njit

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import FUSED, barrier, widest_vectors
from rattlesweep.kernel.runs import N_WINDOWS
from rattlesweep.kernel.state.fields import Lengths, Number, State, Tangent
from rattlesweep.kernel.state.lane import Tangents, lane_of, nothing
from rattlesweep.motion.model import Model
from rattlesweep.physics.full import scalar

# Logarithms of growth for a frame: of its tangents, the flow and the energy.
N_GROWTHS = 5
# Rows of a table of growths for a frame, after those of the windows: the comparisons
# within the first window.  Where a motion dies out there, nothing else tells how.
N_COMPARISONS = 24
OF_FRAME = N_WINDOWS + N_COMPARISONS, 1 + N_GROWTHS  # shape of the table
# Columns of a table of growths after the time and the growths of the frame.
FLOW_GROWTH, ENERGY_GROWTH = 4, 5
# The norm of a tangent stays between 2^-SHIFT and 2^SHIFT.
SHIFT = 200
TAKEN_OUT = float(SHIFT)
LOG_2 = log(2.0)
SHORTER = 2.0**-SHIFT
LONGER = 2.0**SHIFT
SHORT = SHORTER**2
LONG = LONGER**2
# Squared norm below which a flow no longer determines what is normal to it.
NO_FLOW = 1e-270


class TangentFields:
    """The tangents at either end of the step."""

    v: Tangent
    g: Tangent  # derivative


class GrowthFields:
    """The growth of tangents, and what their steps need."""

    shift: Number  # exponent of the power of two taken out of the tangent
    flow0: Number  # logarithm of the flow's norm at launch
    steep0: Number  # logarithm of the norm of the energy's gradient at launch
    ys: State  # in a stage
    fs: State
    # Growth of the tangents of a frame so far, with powers of two taken out.
    length: Lengths
    shifts: Lengths  # exponents of these powers


@dataclass(frozen=True)
class GrowthRecord:
    """Time and logarithm of the tangent's growth at the ends of windows and of runs.

    If a step ends several windows, only the row of the first is filled.  A frame has
    more rows and columns (`OF_FRAME`).
    """

    lyapunov: Annotated[Floats, (N_WINDOWS, 2)]


# A tangent.


@njit(**FUSED)
def start_tangent(lane):
    """Give a lane the model's first tangent, made transverse and of norm 1."""
    barrier()
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
    barrier()


@njit(**FUSED)
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
        out = TAKEN_OUT if size > LONG else 0.0
        out = -TAKEN_OUT if size < SHORT else out
        p, q, a, b, c = lane.v
        lane.v = p * factor, q * factor, a * factor, b * factor, c * factor
        p, q, a, b, c = lane.g
        lane.g = p * factor, q * factor, a * factor, b * factor, c * factor
        lane.shift += out


@njit(**FUSED)
def note_tangent(lane, t, k, growths):
    """Store the time and the tangent's growth in row ``k``."""
    barrier()
    run = int(lane.run)
    growths[run, k, 0] = t
    growth = 0.5 * log(lane.problem.model.square(lane.v1, lane.constants))
    growths[run, k, 1] = growth + LOG_2 * lane.shift
    barrier()


# A frame of tangents, which is made orthonormal after each step.


@njit(**FUSED)
def start_frame(lane):
    """Give a lane the model's first frame, made transverse and orthonormal."""
    barrier()
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
    barrier()


@scalar
def _scaled(length):
    """Return a growth with a power of two taken out, and its exponent."""
    factor = SHORTER if length > LONGER else 1.0
    factor = LONGER if length < SHORTER else factor
    out = TAKEN_OUT if length > LONGER else 0.0
    out = -TAKEN_OUT if length < SHORTER else out
    return length * factor, out


@njit(**FUSED)
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


@njit(**FUSED)
def note_frame(lane, t, k, growths):
    """Store the time and the five growths in row ``k``.

    Where the flow has decayed too far to tell its direction, the row stays empty.
    """
    model = lane.problem.model
    barrier()
    flow, steep = model.trivial(lane.y1, lane.f1, lane.constants)
    if flow < NO_FLOW:
        return
    triangle = model.factor(lane.v1, lane.constants)
    run = int(lane.run)
    growths[run, k, 0] = t
    for i in range(len(lane.length)):
        growth = log(lane.length[i] * triangle[i])
        growths[run, k, 1 + i] = growth + LOG_2 * lane.shifts[i]
    growths[run, k, FLOW_GROWTH] = 0.5 * log(flow) - lane.flow0
    growths[run, k, ENERGY_GROWTH] = lane.steep0 - 0.5 * log(steep)
    barrier()


def note_growth(problem, w, l, t, k, growths):
    """Store the growth of the tangents of lane ``l`` at time ``t`` in row ``k``."""
    problem.tangents.note(lane_of(problem, w, l), t, k, growths)


NONE = Tangents(nothing, nothing, nothing)
ONE_TANGENT = Tangents(start_tangent, advance_tangent, note_tangent)
FRAME_OF_TANGENTS = Tangents(start_frame, advance_frame, note_frame)


def tangents_of(model: Model) -> Tangents:
    """Return the functions for the tangents of a model."""
    if model.n_tangents == 0:
        return NONE
    return ONE_TANGENT if model.n_tangents == 1 else FRAME_OF_TANGENTS
