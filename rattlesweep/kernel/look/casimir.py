"""The Casimir invariant of the averaged dynamics along a run (Eq. 51).

It is ``w_p ln E_p + w_r ln E_r``, with weights in proportion to ``1/K_p`` and ``1/K_r``
and the energies of pitch and roll averaged over one period of the roll
(`Model.mode_energies`).  The averages are sums over accepted steps by trapezoids, from
the first end of a step after a period to the next.  In the reduced model energies are
averages already.
"""

# mypy: ignore-errors
from dataclasses import dataclass
from math import log, nan
from typing import Annotated

from numba import njit

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import FUSED, INNER
from rattlesweep.kernel.state.fields import MOST_REVERSALS, Number

# Rows of the table of a run: the least and the largest value, then the mean before the
# first reversal, between the first and the second, and so on.
RANGE, MEANS = 0, 1


@dataclass(frozen=True)
class CasimirRecord:
    """The invariant of runs: least and largest value, then means between reversals."""

    casimir: Annotated[Floats, (MEANS + 1 + MOST_REVERSALS, 2)]


class CasimirFields:
    """The invariant so far."""

    casimir_low: Number  # its range
    casimir_high: Number
    casimir_seen: Number  # number of its values
    casimir_time: Number  # time and integrals of both energies in the present period
    casimir_pitch: Number
    casimir_roll: Number
    casimir_sum: Number  # sum and number of the values since the last reversal
    casimir_count: Number
    casimir_next: Number  # the same since a zero that may be a reversal
    casimir_nexts: Number
    casimir_turns: Number  # reversals until now whose means are stored


@njit(**FUSED)
def note_value(lane, pitch, roll, weights):
    """Let a value count; an energy of zero has none."""
    if pitch <= 0.0 or roll <= 0.0:
        return
    value = weights[0] * log(pitch) + weights[1] * log(roll)
    if lane.casimir_seen == 0.0:
        lane.casimir_low = lane.casimir_high = value
    lane.casimir_seen += 1.0
    lane.casimir_low = min(lane.casimir_low, value)
    lane.casimir_high = max(lane.casimir_high, value)
    # After a zero of the spin, it is not known at once whether it is a reversal.
    if lane.t_pending >= 0.0:
        lane.casimir_next += value
        lane.casimir_nexts += 1.0
    else:
        lane.casimir_sum += value
        lane.casimir_count += 1.0


@njit(**FUSED)
def store_mean(lane, casimir):
    """Store the mean between two reversals, and begin the next."""
    k = MEANS + int(lane.casimir_turns)
    if k < casimir.shape[1]:
        count = lane.casimir_count
        mean = nan
        if count > 0.0:
            mean = lane.casimir_sum / count
        casimir[int(lane.run), k, 0] = mean
    lane.casimir_sum = 0.0
    lane.casimir_count = 0.0


@njit(**FUSED)
def join_pending(lane, casimir):
    """Let the values since a zero count, once it is known what the zero was."""
    if lane.t_pending >= 0.0:
        return
    while lane.casimir_turns < lane.reversals:
        store_mean(lane, casimir)
        lane.casimir_turns += 1.0
    lane.casimir_sum += lane.casimir_next
    lane.casimir_count += lane.casimir_nexts
    lane.casimir_next = 0.0
    lane.casimir_nexts = 0.0


@njit(**FUSED)
def note_casimir(lane, casimir):
    """Let the step just tried count."""
    join_pending(lane, casimir)
    energies = lane.problem.model.mode_energies
    pitch1, roll1, w_p, w_r, period = energies(lane.y1, lane.constants)
    pitch0, roll0, _, _, _ = energies(lane.y, lane.constants)
    if period == 0.0:
        if lane.casimir_seen == 0.0:
            note_value(lane, pitch0, roll0, (w_p, w_r))
        note_value(lane, pitch1, roll1, (w_p, w_r))
        return
    half = 0.5 * lane.h
    lane.casimir_pitch += half * (pitch0 + pitch1)
    lane.casimir_roll += half * (roll0 + roll1)
    lane.casimir_time += lane.h
    if lane.casimir_time >= period:
        close_period(lane, (w_p, w_r))


@njit(**FUSED)
def close_period(lane, weights):
    """Let the average since the last period count."""
    time = lane.casimir_time
    note_value(lane, lane.casimir_pitch / time, lane.casimir_roll / time, weights)
    lane.casimir_pitch = 0.0
    lane.casimir_roll = 0.0
    lane.casimir_time = 0.0


@njit(**INNER)
def store_casimir(lane, casimir):
    """Store the range and the last mean at the end of a run."""
    _, _, w_p, w_r, _ = lane.problem.model.mode_energies(lane.y1, lane.constants)
    if lane.casimir_seen == 0.0 and lane.casimir_time > 0.0:
        # The run is shorter than a period.
        close_period(lane, (w_p, w_r))
    lane.t_pending = -1.0
    join_pending(lane, casimir)
    store_mean(lane, casimir)
    if lane.casimir_seen > 0.0:
        casimir[int(lane.run), RANGE, 0] = lane.casimir_low
        casimir[int(lane.run), RANGE, 1] = lane.casimir_high
