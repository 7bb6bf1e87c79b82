"""One run followed past its reversals: its accepted steps, and states between them.

:func:`record_steps` is the sweep's kernel with one run in one lane: the same step, ``decide``,
``commit`` and search for zeros, so that the accepted steps and the first reversal are those of a
sweep, bit for bit.  It differs in that a reversal does not end the run, and that every accepted
step is written down.  :func:`states_behind` gives states at any times, each by one step of the
method from the accepted step before it, one time in each lane; no accepted step depends on them.
"""

# mypy: ignore-errors
from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.lanes import columns as C
from rattlesweep.integrate.lanes.build import (
    NO_PARTS,
    attempt,
    decide_closely,
    problem_of,
    workspace,
)
from rattlesweep.integrate.lanes.events import HOLD, REVERSED
from rattlesweep.integrate.lanes.intrinsics import (
    addresses_of,
    call,
    call_for_two,
    first_of,
    widest_vectors,
)
from rattlesweep.integrate.lanes.kernel import ATTEMPT, DECIDE, OK, commit, decide
from rattlesweep.integrate.lanes.lane import lane_of
from rattlesweep.integrate.lanes.runs import derive, energy_at, idle, is_dead, stay
from rattlesweep.integrate.model import ATTITUDES, find_model
from rattlesweep.integrate.tableau import DOP853, METHODS

if TYPE_CHECKING:
    from collections.abc import Callable

# ``counts`` of :func:`record_steps`: whether the run has begun and ended, its status, and how many
# steps and zeros were written by the last call.
BEGUN, ENDED, STATUS, N_STEPS, N_ZEROS, REJECTED = 0, 1, 2, 3, 4, 5
N_COUNTS = 6
# Columns of a written step: time and its low part, behind them the state and its derivative.
T, T_LOW, STATE = 0, 1, 2


def record_steps(problem, parts, w, y0, constants, probe, plan, options,
                 record, steps, zeros, counts, energies):  # fmt: skip
    """Go on with the run until the tables are full or it ends.

    Parameters
    ----------
    problem : Problem
    parts : int64 ndarray
        As for :func:`rattlesweep.integrate.lanes.kernel.work`.
    w : ndarray
        Workspace of a thread; it keeps the run between calls.
    y0, constants, probe, plan : ndarray, shape (1, ...)
    options, record : ndarray
        As for :func:`rattlesweep.integrate.lanes.kernel.work`.
    steps : ndarray, shape (rows, 2 + 2 n_state)
        Written to: where the run has come to, and the accepted steps' ends.
    zeros : ndarray
        Written to: the times of the zeros found, but for those after the body is dead.
    counts : int64 ndarray, shape (N_COUNTS,)
    energies : ndarray, shape (2,)
        Written to: energies of the launch and of the last row.
    """
    widest_vectors()
    scale, dt, max_steps = options[0], options[1], options[2]
    lane = lane_of(problem, w, 0)
    if counts[BEGUN] == 0:
        counts[BEGUN] = 1
        problem.start(lane, 0, y0, constants, probe, plan, record)
        lane.next = 1e290
        for l in range(1, problem.lanes):
            idle(lane_of(problem, w, l))
    row = 0
    found = 0
    status = OK
    accepted = True
    last = False
    ended = False
    while True:
        if accepted:
            steps[row, T] = lane.t_end if last else lane.t
            steps[row, T_LOW] = 0.0 if last else lane.t_low
            for c, component in enumerate(lane.y + lane.f):
                steps[row, STATE + c] = component
            row += 1
        if ended or row == steps.shape[0] or found == zeros.size:
            break
        call(parts[ATTEMPT], (problem, w, scale))
        if decide(problem, w, dt, max_steps) > 0:
            status, move = call_for_two(parts[DECIDE], (problem, w, 0, max_steps, False))
            if move == REVERSED:
                if not is_dead(lane):
                    zeros[found] = lane.t + (lane.h - lane.t_low)
                    found += 1
                behind, move = call_for_two(parts[DECIDE], (problem, w, 0, max_steps, True))
                status = behind if move == HOLD else status
            ended = status != OK or (move != HOLD and lane.last > 0.0)
        accepted = lane.accept > 0.0
        if not accepted:
            stay(lane)
        last = lane.last > 0.0
        commit(problem, w)
    counts[ENDED] = 1 if ended else 0
    counts[STATUS] = status
    counts[N_STEPS] = row - 1
    counts[N_ZEROS] = found
    counts[REJECTED] = int(lane.rejected)
    energies[0] = lane.energy0
    energies[1] = energy_at(lane, lane.y)


def states_behind(problem, parts, w, steps, which, offset, constants, out):
    """Find the states ``offset`` behind the ends of steps: one step of the method and a lane each.

    Parameters
    ----------
    problem : Problem
    parts : int64 ndarray
        As for :func:`record_steps`.
    w : ndarray
        Workspace of a thread.
    steps : ndarray
        As written by :func:`record_steps`.
    which : int64 ndarray, shape (points,)
        Rows of ``steps`` to start from.
    offset : ndarray, shape (points,)
    constants : ndarray, shape (n_constants,)
    out : ndarray, shape (points, n_state)
        Written to.  Components that ``steps`` does not have begin at zero.
    """
    widest_vectors()
    for l in range(problem.lanes):
        lane_of(problem, w, l).constants = first_of(constants, problem.n_constants)
    given = problem.n_given
    points = which.size
    for first in range(0, points, problem.lanes):
        for l in range(problem.lanes):
            i = min(first + l, points - 1)
            lane = lane_of(problem, w, l)
            row = steps[which[i], STATE:]
            lane.y = first_of(row, given) + problem.others
            lane.f = first_of(row[given:], given) + problem.others
            if given < problem.n_state:
                derive(lane)
            lane.h = offset[i]
        call(parts[ATTEMPT], (problem, w, 1.0))
        for l in range(min(problem.lanes, points - first)):
            for c, component in enumerate(lane_of(problem, w, l).y1):
                out[first + l, c] = component


# -- recipes and kernels ---------------------------------------------------------------------------

OPTIONS = {"nogil": True, "error_model": "numpy"}


def steps_recipe(model_name: str, adaptive: bool) -> Kernel:
    """Return :func:`record_steps` of a model."""
    model = find_model(model_name)
    arguments = (
        problem_of(model, adaptive),
        NO_PARTS,
        workspace(DOP853, model, 1)[0],
        np.zeros((1, model.n_state)),
        np.zeros((1, model.n_constants)),
        np.zeros((1, model.n_probe)),
        np.zeros((1, C.N_PLAN)),
        np.zeros(C.N_OPTIONS),
        np.zeros(C.N_RECORD, dtype=np.bool_),
        np.zeros((1, STATE + 2 * model.n_state)),
        np.zeros(0),
        np.zeros(N_COUNTS, dtype=np.int64),
        np.zeros(2),
    )
    return Kernel(record_steps, arguments, OPTIONS)


def states_recipe(model_name: str) -> Kernel:
    """Return :func:`states_behind` of a model, which is that of all methods."""
    model = find_model(model_name)
    problem = problem_of(model, True)
    arguments = (
        problem,
        NO_PARTS,
        workspace(DOP853, model, 1)[0],
        np.zeros((1, STATE + 2 * problem.n_given)),
        np.zeros(0, dtype=np.int64),
        np.zeros(0),
        np.zeros(model.n_constants),
        np.zeros((0, model.n_state)),
    )
    return Kernel(states_behind, arguments, OPTIONS)


def _of_steps(tableau_name: str, model_name: str) -> list[tuple[Any, ...]]:
    adaptive = METHODS[tableau_name].adaptive
    step = (attempt, tableau_name, model_name)
    return [(steps_recipe, model_name, adaptive), step, (decide_closely, adaptive)]


def _of_states(tableau_name: str, model_name: str) -> list[tuple[Any, ...]]:
    return [(states_recipe, model_name), (attempt, tableau_name, model_name)]


def steps_kernel(tableau_name: str, model_name: str) -> Callable[..., None]:
    """Return :func:`record_steps` of a method and a model, to be given its workspace and more."""
    steps, *others = load_kernels(*_of_steps(tableau_name, model_name))
    problem = problem_of(find_model(model_name), METHODS[tableau_name].adaptive)
    return partial(steps, problem, addresses_of(*others))


def states_kernel(tableau_name: str, model_name: str) -> Callable[..., None]:
    """Return :func:`states_behind` of a method and a model, likewise."""
    states, *parts = load_kernels(*_of_states(tableau_name, model_name))
    return partial(states, problem_of(find_model(model_name), True), addresses_of(*parts))


def load_all(tableau_name: str, model_name: str, attitude: bool) -> None:
    """Load the kernels of a trajectory at the same time."""
    wanted = _of_steps(tableau_name, model_name) + _of_states(tableau_name, model_name)
    if attitude:
        wanted += _of_states(tableau_name, ATTITUDES[model_name].name)
    load_kernels(*dict.fromkeys(wanted))
