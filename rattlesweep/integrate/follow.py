"""One run followed past its reversals: its accepted steps, states at any times, all zeros.

:func:`record_steps` is the sweep's kernel with one run in one lane: the same step, ``decide``,
``commit`` and search for zeros, so that the accepted steps and the first reversal are those of a
sweep, bit for bit.  It differs in that a reversal does not end the run, and that every accepted
step is written down.  :func:`states_behind` gives states at any times, each by one step of the
method from the accepted step before it, one time in each lane; no accepted step depends on them.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.integrate.batch import MAX_DAMPING, kernel_options, run_plans, stride
from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.defaults import DT, MAX_STEPS, TOL
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
from rattlesweep.integrate.lanes.runs import (
    MAX_ENERGY_DRIFT,
    derive,
    energy_at,
    idle,
    is_dead,
    stay,
)
from rattlesweep.integrate.model import ATTITUDES, find_model
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DOP853

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.integrate.batch import Batch
    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau

    Floats = NDArray[np.float64]

# Steps between two looks from Python: some milliseconds, so that Ctrl-C is heard.
STEPS_AT_ONCE = 2048
# ``counts`` of :func:`record_steps`: whether the run has begun and ended, its status, how many
# steps and zeros were written by the last call, and rejected steps.
BEGUN, ENDED, STATUS, N_STEPS, N_ZEROS, REJECTED = 0, 1, 2, 3, 4, 5
N_COUNTS = 6
# Columns of a written step: time and its low part, behind them the state and its derivative.
T, T_LOW, STATE = 0, 1, 2


# -- kernels ---------------------------------------------------------------------------------------


def record_steps(problem, parts, w, y0, constants, probe, plan, options,
                 record, steps, zeros, counts, energies):  # fmt: skip
    """Go on with the run until the tables are full or it ends.

    Arguments up to ``record`` are those of :func:`rattlesweep.integrate.lanes.kernel.work` for one
    run; the workspace keeps the run between calls.  Written to are ``steps``, of shape (rows,
    2 + 2 n_state): where the run has come to, and the ends of the accepted steps; ``zeros``: times
    of the zeros found, but for those after the body is dead; ``counts``; ``energies``: of the
    launch and of the last row.
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
    """Find the states ``offset`` behind the rows ``which`` of ``steps``, and write them to ``out``.

    Each is one step of the method, in a lane of its own.  Components that ``steps`` does not have
    begin at zero.
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


def steps_recipe(model_name: str, adaptive: bool) -> Kernel:
    """Return :func:`record_steps` of a model."""
    model = find_model(model_name)
    runs = [np.zeros((1, n)) for n in (model.n_state, model.n_constants, model.n_probe, C.N_PLAN)]
    tables = np.zeros((1, STATE + 2 * model.n_state)), np.zeros(0), np.zeros(N_COUNTS, np.int64)
    arguments = (
        problem_of(model, adaptive), NO_PARTS, workspace(DOP853, model, 1)[0], *runs,
        np.zeros(C.N_OPTIONS), np.zeros(C.N_RECORD, dtype=np.bool_), *tables, np.zeros(2),
    )  # fmt: skip
    return Kernel(record_steps, arguments, OPTIONS)


def states_recipe(model_name: str) -> Kernel:
    """Return :func:`states_behind` of a model, which is that of all methods."""
    model = find_model(model_name)
    problem = problem_of(model, True)
    arguments = (
        problem, NO_PARTS, workspace(DOP853, model, 1)[0],
        np.zeros((1, STATE + 2 * problem.n_given)), np.zeros(0, dtype=np.int64), np.zeros(0),
        np.zeros(model.n_constants), np.zeros((0, model.n_state)),
    )  # fmt: skip
    return Kernel(states_behind, arguments, OPTIONS)


OPTIONS = {"nogil": True, "error_model": "numpy"}


def _load(tableau: Tableau, models: list[Model]) -> list[Callable[..., None]]:
    """Return :func:`record_steps` of the first model and :func:`states_behind` of all.

    They lack the workspace and what follows.
    """
    first, *_ = models
    wanted = [(steps_recipe, first.name, tableau.adaptive), (decide_closely, tableau.adaptive)]
    for model in models:
        wanted += [(attempt, tableau.name, model.name), (states_recipe, model.name)]
    steps, decision, *others = load_kernels(*wanted)
    parts = addresses_of(others[0], decision)
    return [
        partial(steps, problem_of(first, tableau.adaptive), parts),
        *(partial(states, problem_of(model, True), addresses_of(step))
          for model, step, states in zip(models, others[::2], others[1::2], strict=True)),
    ]  # fmt: skip


# -- one run ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Samples:
    """States at times.

    Attributes
    ----------
    t : ndarray, shape (points,)
        In ``sqrt(a/g)``.
    y : ndarray, shape (points, n_state)
        States in the model's variables.
    extra : ndarray, shape (points, 3)
        Heading in radians and contact point on the plane in units of ``a``, see
        :mod:`rattlesweep.physics.attitude`; zero columns where they were not asked for.
    """

    t: Floats
    y: Floats
    extra: Floats


class Follower:
    """Integrates one run, past its reversals, as far as its states are asked for.

    Parameters
    ----------
    batch : Batch
        One run.
    tableau, model
        Method and equations.
    tol, dt, max_steps
        As for :func:`rattlesweep.integrate.batch.integrate`.
    attitude : bool
        Whether to integrate heading and contact point too (full model only).  They are quadratures
        over the accepted steps and change none of them.
    look : callable, optional
        Called with the times and the states, one row each, of the accepted steps as they come, and
        at first with the launch; every eighth of a method without error control.
    watch : callable, optional
        Called with the time reached every few thousand steps; what it raises ends the work.

    Attributes
    ----------
    t : float
        Time reached by the accepted steps.
    zeros : list of float
        Times of the zeros of the spin so far, but for those after the body is dead.
    status : Status
        What became of the run so far.
    energy_0 : float
        Energy of the launch, in ``M g a``.
    """

    def __init__(
        self,
        batch: Batch,
        tableau: Tableau,
        model: Model,
        *,
        tol: float = TOL,
        dt: float = DT,
        max_steps: int = MAX_STEPS,
        attitude: bool = False,
        look: Callable[[Floats, Floats], None] | None = None,
        watch: Callable[[float], None] | None = None,
    ) -> None:
        if len(batch) != 1:
            raise ValueError(f"{len(batch)} runs; a trajectory is of one")
        self.t, self.t_end = 0.0, float(batch.t_end[0])
        self.zeros: list[float] = []
        self.status = Status.OK
        self.ended = not self.t_end > 0
        self.n_steps = 0
        self._tableau, self._model, self._dt = tableau, model, dt
        self._batch, self._look, self._watch = batch, look, watch
        # No windows: nothing is due at their ends.
        never = np.full(1, 1e290)
        plan = run_plans(replace(batch, window=never, first_mark=never), tableau, tol, dt)
        self._constants = np.ascontiguousarray(batch.constants)
        y0 = np.ascontiguousarray(batch.y0)
        self._state = (
            workspace(tableau, model, 1)[0],
            y0,
            self._constants,
            np.ascontiguousarray(batch.probe),
            plan,
            kernel_options(tableau, tol, dt, max_steps),
            np.zeros(C.N_RECORD, dtype=np.bool_),
        )
        self._counts = np.zeros(N_COUNTS, dtype=np.int64)
        self._zeros = np.zeros(256)
        self._energies = np.zeros(2)
        moving = ATTITUDES[model.name] if attitude else model
        self._record_steps, *find = _load(tableau, [model, moving] if attitude else [model])
        # Row 0 is where the last call ended: at first the launch, without any step.
        self._table = np.zeros((1 + STEPS_AT_ONCE, STATE + 2 * model.n_state))
        self._record_steps(*self._state, self._table[:1], self._zeros, self._counts, self._energies)
        self._rows = 1
        self.energy_0 = float(self._energies[0])
        if look is not None:
            look(np.zeros(1), y0)
        self._states = _Between(find[0], tableau, model, self._constants[0])
        self._attitude = None
        if attitude:
            self._attitude = _Between(find[1], tableau, moving, self._constants[0])
        self._extra = np.zeros((1, moving.n_state - model.n_state))

    @property
    def rejected(self) -> int:
        """Steps that were tried and failed."""
        return int(self._counts[REJECTED])

    def launch(self) -> Samples:
        """State at time zero."""
        return Samples(np.zeros(1), self._batch.y0.copy(), np.zeros((1, self._extra.shape[1])))

    def steps(self) -> Samples:
        """Go on, and give the ends of the next accepted steps: none when the run has ended.

        A method without error control shows every eighth step only.
        """
        if self.ended:
            return self._samples(slice(0, 0))
        self._go_on()
        return self._samples(slice(1, self._rows))

    def at(self, times: Floats) -> Samples:
        """States at increasing times, none earlier than those of the last call.

        Each is one step of the method away from the accepted step before it.  Fewer than asked
        for come back where the run ended earlier.
        """
        out = np.empty((len(times), self._model.n_state))
        extra = np.empty((len(times), self._extra.shape[1]))
        done = 0
        while done < len(times):
            ends = self._table[: self._rows, T]
            upto = int(np.searchsorted(times, ends[-1], side="right"))
            if upto > done:
                part = times[done:upto]
                which = np.maximum(np.searchsorted(ends, part, side="left") - 1, 0)
                offset = (part - ends[which]) + self._table[which, T_LOW]
                out[done:upto] = self._states(self._table, which, offset)
                if self._attitude is not None:
                    moved = self._attitude(self._table, which, offset)[:, self._model.n_state :]
                    extra[done:upto] = _compose(self._extra[which], moved)
                done = upto
            elif self.ended:
                break
            else:
                self._go_on()
        return Samples(times[:done], out[:done], extra[:done])

    def _samples(self, rows: slice) -> Samples:
        table = self._table[rows]
        y = table[:, STATE : STATE + self._model.n_state]
        return Samples(table[:, T].copy(), y.copy(), self._extra[rows].copy())

    def _go_on(self) -> None:
        """Fill the table with the next accepted steps."""
        table, counts = self._table, self._counts
        self._record_steps(*self._state, table, self._zeros, counts, self._energies)
        self._rows = 1 + int(counts[N_STEPS])
        self.n_steps += int(counts[N_STEPS]) * stride(self._tableau)
        self.zeros += self._zeros[: counts[N_ZEROS]].tolist()
        self.t = float(table[self._rows - 1, T])
        self.ended = bool(counts[ENDED])
        self.status = Status(counts[STATUS])
        if self._attitude is not None:
            self._turn()
        if self.ended and self.status == Status.OK:
            self._judge()
        if self._look is not None:
            found = self._samples(slice(1, self._rows))
            self._look(found.t, found.y)
        if self._watch is not None:
            self._watch(self.t)

    def _turn(self) -> None:
        """Heading and contact point at the ends of the steps in the table."""
        assert self._attitude is not None
        table, rows = self._table, self._rows
        t, low = table[:rows, T], table[:rows, T_LOW]
        length = np.diff(t) - np.diff(low)
        moved = self._attitude(table, np.arange(rows - 1), length)[:, self._model.n_state :]
        base = self._extra[-1]
        extra = np.empty((rows, 3))
        extra[0] = base
        extra[1:, 0] = base[0] + np.cumsum(moved[:, 0])
        # Each step's track is known in the frame of its start.
        extra[1:, 1:] = base[1:] + np.cumsum(_turned(extra[:-1, 0], moved[:, 1:]), axis=0)
        self._extra = extra

    def _judge(self) -> None:
        """Numbers that cannot be trusted get the status they have in a sweep."""
        drift = (float(self._energies[1]) - self.energy_0) / self.energy_0
        if not abs(drift) <= MAX_ENERGY_DRIFT:
            self.status = Status.ENERGY if np.isfinite(drift) else Status.NONFINITE
        elif not self._tableau.adaptive:
            damping = self._tableau.damping(self._dt * self._batch.relevant)[0]
            if not abs(damping * (self.t / self._dt)) <= MAX_DAMPING:
                self.status = Status.COARSE


class _Between:
    """States between the accepted steps, in one model."""

    def __init__(
        self, find: Callable[..., None], tableau: Tableau, model: Model, constants: Floats
    ) -> None:
        self._find, self._constants, self._n_state = find, constants, model.n_state
        self._w = workspace(tableau, model, 1)[0]

    def __call__(self, table: Floats, which: NDArray[np.int64], offset: Floats) -> Floats:
        out = np.empty((len(which), self._n_state))
        self._find(self._w, table, which.astype(np.int64), offset, self._constants, out)
        return out


def _turned(heading: Floats, move: Floats) -> Floats:
    cosine, sine = np.cos(heading), np.sin(heading)
    x, y = move[:, 0], move[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)


def _compose(start: Floats, moved: Floats) -> Floats:
    """Heading and contact point after moves known in the frames of their starts."""
    place = start[:, 1:] + _turned(start[:, 0], moved[:, 1:])
    return np.concatenate([(start[:, 0] + moved[:, 0])[:, None], place], axis=1)
