"""The spin in the last quarter of a run: its mean over time, and how it varies.

Each accepted step adds the integrals of the spin and of its square, of the part of the
step that lies in that quarter.
"""

# mypy: ignore-errors
from dataclasses import dataclass
from math import sqrt
from typing import Annotated

from numba import njit

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import FUSED, INNER, apart
from rattlesweep.kernel.look.inside import rates_beyond, state_at
from rattlesweep.kernel.state.fields import Number
from rattlesweep.kernel.state.ways import steps_in_rack

BEGIN = 0.75  # of the horizon
# Places and weights of Gauss's rule of five points in a step of length 1.
PLACES = (
    0.04691007703066802,
    0.23076534494715845,
    0.5,
    0.7692346550528415,
    0.9530899229693319,
)
WEIGHTS = (
    0.11846344252809454,
    0.23931433524968324,
    0.28444444444444444,
    0.23931433524968324,
    0.11846344252809454,
)


@dataclass(frozen=True)
class LateRecord:
    """The spin in the last quarter of runs: its mean and its standard deviation."""

    late: Annotated[Floats, (1, 2)]


class LateFields:
    """The spin in the last quarter of the run."""

    late_spin: Number  # at its begin, or at the end of the first step in it
    late_sum: Number  # integral of the spin less that
    late_square: Number  # integral of its square


@njit(**FUSED)
def cubic(lane, share):
    """Return the spin at a share of the step, from its values and rates at both ends.

    A step of a slide, which is short, needs no more.
    """
    rest = 1.0 - share
    ends = rest * rest * (1.0 + 2.0 * share) * lane.n0
    ends += share * share * (1.0 + 2.0 * rest) * lane.n1
    return ends + lane.h * share * rest * (rest * lane.rate0 - share * lane.rate1)


@njit(**FUSED)
def note(lane):
    """Add the step just accepted to the integrals."""
    apart()
    begin = BEGIN * lane.t_end
    end = lane.t + lane.h
    if not end > begin:
        return
    if lane.t <= begin:
        lane.late_spin = lane.n1
    first = max(0.0, (begin - lane.t) / lane.h)
    part = 1.0 - first
    beyond = rates_beyond(lane)
    for place, weight in zip(PLACES, WEIGHTS):  # noqa: B905
        share = first + part * place
        if steps_in_rack(lane):
            spin = cubic(lane, share)
        else:
            spin = lane.problem.model.spin(state_at(lane, beyond, share))
        away = spin - lane.late_spin
        lane.late_sum += weight * part * lane.h * away
        lane.late_square += weight * part * lane.h * away * away


@njit(**INNER)
def mean_and_deviation(lane):
    """Return the mean of the spin over the last quarter, and its deviation."""
    length = (1.0 - BEGIN) * lane.t_end
    away = lane.late_sum / length
    variance = lane.late_square / length - away * away
    return lane.late_spin + away, sqrt(max(variance, 0.0))
