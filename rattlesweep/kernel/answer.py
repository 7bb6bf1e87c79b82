"""What only a model can tell of its lanes, when the loop asks.

The loop (`kernel.turn`, `kernel.runs`) is compiled once for all models.  It knows the
fields that all lanes have, and asks for the rest by numbers: :func:`answer` for one
lane where something is due, :func:`answer_for_all` in each turn of a model with modes
or tangents.  Both are compiled for each model and called by their addresses.
"""

# mypy: ignore-errors
from numba import njit

from rattlesweep.compiling.intrinsics import FUSED, FUSED_INLINED, INNER
from rattlesweep.kernel.look.extremes import (
    contact_points,
    note_contact,
    start_extremes,
)
from rattlesweep.kernel.runs import UNKNOWN_RATE
from rattlesweep.kernel.state.fields import NEVER
from rattlesweep.kernel.state.lane import lane_of
from rattlesweep.kernel.state.statuses import LIFTS_OFF, OK, RIM

# What is asked for one lane.
BEGIN, IDLE, DERIVE, MEASURE, SETTLE, LIMIT, END, CHANGE = range(8)
# What is asked for all lanes.
SCHEDULE, OBSERVE, DECIDE, ADVANCE = range(4)


@njit(**FUSED)
def derive(lane):
    """Set the derivative at the start of the step, and return spin and its rate."""
    y = lane.y
    f = lane.problem.model.rhs(y, lane.constants)
    lane.f = f
    return lane.problem.model.spin(y), lane.problem.model.spin_rate(y, f)


@njit(**FUSED_INLINED)
def jump(lane):
    """Let the force jump, at the end of the step, to that of a lane's new mode.

    Both its values count as extremes of the contact.
    """
    note_contact(lane)
    model = lane.problem.model
    y = lane.y1
    f = model.rhs(y, lane.constants)
    lane.f1 = f
    lane.rate1 = model.spin_rate(y, f)
    lane.margin1 = lane.problem.modes.margin(lane, y, f)
    lane.limit1 = lane.problem.modes.limit(lane, lane.h, y, f)
    lane.ratio1, lane.lift1 = contact_points(lane, lane.h, y, f)
    lane.root = 1.0


@njit(**INNER)
def begin_run(lane):
    """Begin the run of which the loop has set the launch and the settings."""
    model = lane.problem.model
    lane.problem.modes.prepare(lane)
    n, rate = derive(lane)
    lane.n_launch = lane.n0 = lane.window_n_min = lane.window_n_max = n
    lane.rate0 = rate
    lane.sign = lane.side = 1.0 if n > 0.0 else -1.0
    if lane.arm > 0.0:
        lane.arm_rate = lane.far_rate = lane.rate_max
        lane.rate_max = UNKNOWN_RATE
        lane.side = 0.0
    lane.n_least = abs(n)
    lane.energy0 = lane.energy_most = model.energy(lane.y, lane.constants)
    lane.margin0 = lane.problem.modes.margin(lane, lane.y, lane.f)
    if lane.problem.modes.refuses(lane):
        lane.refused0 = LIFTS_OFF
    if lane.problem.modes.left(lane, lane.y) <= 0.0:
        lane.refused0 = RIM
    if lane.refused0 > 0.0:
        lane.watched = 1.0
    lane.limit0 = lane.problem.modes.limit(lane, 0.0, lane.y, lane.f)
    start_extremes(lane)
    lane.problem.modes.launch(lane)
    lane.problem.tangents.start(lane)


@njit(**INNER)
def idle(lane):
    """Empty a lane: a spinning state and steps of size zero, so that nothing is due.

    The loop has set all its fields to zero.
    """
    lane.run = -1.0
    lane.y, lane.constants, lane.probe = lane.problem.idle
    n, _ = derive(lane)
    lane.n0 = n
    lane.sign = 1.0
    lane.t_end = lane.window_end = lane.next = NEVER
    lane.awaited = NEVER


@njit(**INNER)
def note_energies(lane):
    """Note the energy and the work of friction at the end of the step just tried."""
    lane.energy1 = lane.problem.modes.energy(lane)
    lane.work1 = lane.problem.modes.work(lane)


@njit(**FUSED)
def note_oscillation(lane):
    """Note how large the oscillation is at the end of the step just tried."""
    _, lane.oscillation1 = lane.problem.model.error(lane.y1, lane.y1, lane.constants)


def answer(problem, asked, w, l, status, move, goes_on, reversals_recorded):
    """Do what is asked for lane ``l``; return a status and a move.

    These are those of the step just tried, which only CHANGE may replace.  ``goes_on``
    says whether the run goes on after a reversal.
    """
    lane = lane_of(problem, w, l)
    if asked == CHANGE:
        recorded = goes_on, reversals_recorded
        return problem.modes.change(lane, status, move, *recorded)
    if asked == MEASURE:
        note_energies(lane)
    elif asked == LIMIT:
        problem.modes.look(lane)
    elif asked == SETTLE:
        note_oscillation(lane)
    elif asked == END:
        note_energies(lane)
        problem.modes.store(lane)
    elif asked == BEGIN:
        begin_run(lane)
    elif asked == DERIVE:
        lane.n0, lane.rate0 = derive(lane)
    else:
        idle(lane)
    return status, move


def answer_rates(problem, asked, w, l, status, move, goes_on, reversals_recorded):
    """Do what DERIVE asks, which is all for a model of which no run is begun."""
    lane = lane_of(problem, w, l)
    lane.n0, lane.rate0 = derive(lane)
    return status, move


def answer_for_all(problem, asked, w, given):
    """Do what is asked for all lanes.

    SCHEDULE returns whether lanes that roll try a step in this turn and whether some
    slide.  OBSERVE is given how many lanes are used.  DECIDE is given which lanes are
    due, and returns which are and 0.  Others return nothing of use.
    """
    if asked == SCHEDULE:
        rolls, some_slide = problem.modes.schedule(problem, w)
        return 1 if rolls else 0, 1 if some_slide else 0
    if asked == OBSERVE:
        problem.modes.observe_limit(problem, w, given)
    elif asked == ADVANCE:
        problem.modes.advance(problem, w)
        problem.tangents.advance(problem, w)
    else:
        return problem.modes.decide(problem, w, given), 0
    return OK, 0
