"""One run followed past its reversals: its accepted steps, states at any times, all
zeros.

:func:`record_steps` runs the sweep's kernel with one run in one lane, so that accepted
steps and the first reversal have the same bits as in a sweep; but it stores every
accepted step, and does not end the run at a reversal.  :func:`states_after` computes
states at any times, each by one step of the method from the accepted step before it, so
that no accepted step depends on them.
"""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.integrate import batch as batches
from rattlesweep.integrate.batch import Batch
from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.lanes import runs
from rattlesweep.integrate.lanes.events import HOLD, REVERSED
from rattlesweep.integrate.lanes.kernel import (
    AFTER_ZERO,
    ATTEMPT,
    DECIDE,
    OK,
    SPIN,
    commit,
    decide,
)
from rattlesweep.integrate.lanes.lane import (
    addresses_of,
    call,
    call_for_pair,
    first_of,
    lane_of,
    widest_vectors,
)
from rattlesweep.integrate.model import ATTITUDES, Model, find_model
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DT, MAX_STEPS, TOL, Tableau

STEPS_PER_CALL = 2048  # a few milliseconds, after which Python can act on Ctrl-C
# ``counts`` of :func:`record_steps`: whether the run has begun and ended, its status,
# and the numbers of steps and zeros that the last call stored.
BEGUN, ENDED, STATUS, N_STEPS, N_ZEROS, N_COUNTS = 0, 1, 2, 3, 4, 5
# Columns of a stored step: time, its low part, then the state and its derivative.
T, T_LOW, STATE = 0, 1, 2


def record_steps(
    problem,
    parts,
    w,
    y0,
    constants,
    probe,
    plan,
    options,
    record,
    steps,
    zeros,
    counts,
    energies,
):
    """Continue the run until the tables are full or it ends.

    The arguments up to ``record`` are those of the kernel's ``work`` for one run, which
    stays in the workspace between calls.  The others are outputs: ``steps``, where the
    run is and then the ends of accepted steps; ``zeros``; ``counts``; ``energies`` at
    launch and in the last row.
    """
    widest_vectors()
    scale, dt, max_steps = options[0], options[1], options[2]
    lane = lane_of(problem, w, 0)
    if counts[BEGUN] == 0:
        counts[BEGUN] = 1
        problem.start(lane, 0, y0, constants, probe, plan, record)
        lane.next = 1e290
        for l in range(1, problem.lanes):
            runs.idle(lane_of(problem, w, l))
    row, found, status = 0, 0, OK
    accepted, last, ended = True, False, False
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
            status, move = call_for_pair(
                parts[DECIDE], (problem, w, 0, max_steps, SPIN)
            )
            if move == REVERSED:
                if not runs.is_dead(lane):
                    zeros[found] = lane.t + (lane.h - lane.t_low)
                    found += 1
                later, move = call_for_pair(
                    parts[DECIDE], (problem, w, 0, max_steps, AFTER_ZERO)
                )
                status = later if move == HOLD else status
            ended = status != OK or (move != HOLD and lane.last > 0.0)
        accepted = lane.accept > 0.0
        if not accepted:
            runs.hold_back(lane)
        last = lane.last > 0.0
        commit(problem, w)
    counts[ENDED], counts[STATUS] = 1 if ended else 0, status
    counts[N_STEPS], counts[N_ZEROS] = row - 1, found
    energies[0], energies[1] = lane.energy0, runs.energy_at(lane, lane.y)


def states_after(problem, parts, w, steps, which, offset, constants, out):
    """Write the states a time ``offset`` after the rows ``which`` of ``steps`` to
    ``out``.

    Each is one step of the method in its own lane.  Components that ``steps`` lacks
    start at zero.
    """
    widest_vectors()
    for l in range(problem.lanes):
        lane_of(problem, w, l).constants = first_of(constants, problem.n_constants)
    given, points = problem.n_given, which.size
    for first in range(0, points, problem.lanes):
        for l in range(problem.lanes):
            i = min(first + l, points - 1)
            lane = lane_of(problem, w, l)
            row = steps[which[i], STATE:]
            lane.y = first_of(row, given) + problem.others
            lane.f = first_of(row[given:], given) + problem.others
            if given < problem.n_state:
                runs.derive(lane)
            lane.h = offset[i]
        call(parts[ATTEMPT], (problem, w, 1.0))
        for l in range(min(problem.lanes, points - first)):
            for c, component in enumerate(lane_of(problem, w, l).y1):
                out[first + l, c] = component


def observe(problem, states, constants, out):
    """Write spin, energy, normal and tangential contact force in ``states`` to
    ``out``.
    """
    q = first_of(constants, problem.n_constants)
    for i in range(out.shape[1]):
        y = first_of(states[i], problem.n_state)
        out[0, i], out[1, i] = problem.spin(*y), problem.energy(*(y + q))
        out[2, i], out[3, i] = problem.contact(*(y + q))


OPTIONS = {"nogil": True, "error_model": "numpy"}


def steps_recipe(model_name: str, adaptive: bool) -> Kernel:
    """Return :func:`record_steps` of a model."""
    problem = batches.problem_of(find_model(model_name), adaptive)
    given = problem, batches.NO_PARTS, batches.FLAT, *batches.RUNS
    tables = batches.TABLE, batches.FLAT, batches.WHOLE, batches.FLAT
    return Kernel(record_steps, (*given, *tables), OPTIONS)


def states_recipe(model_name: str) -> Kernel:
    """Return :func:`states_after` of a model, which serves all methods."""
    problem = batches.problem_of(find_model(model_name), True)
    tables = batches.TABLE, batches.WHOLE, batches.FLAT, batches.FLAT, batches.TABLE
    return Kernel(
        states_after, (problem, batches.NO_PARTS, batches.FLAT, *tables), OPTIONS
    )


def observe_recipe(model_name: str) -> Kernel:
    """Return :func:`observe` of a model."""
    problem = batches.problem_of(find_model(model_name), True)
    return Kernel(
        observe, (problem, batches.TABLE, batches.FLAT, batches.TABLE), OPTIONS
    )


@dataclass(frozen=True)
class Samples:
    """States at some times, a row each."""

    t: Floats  # in sqrt(a/g)
    y: Floats  # in the model's variables
    extra: Floats  # heading and contact point (see `physics.full`), or no columns


class Follower:
    """Integrates a batch of one run past its reversals, as far as its states are
    requested.

    With `attitude`, heading and contact point are integrated over the accepted steps.
    `look` is called with times and the result of :meth:`observe`: first for the launch,
    then for the accepted steps.  If the step is fixed, only every eighth step counts as
    accepted.
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
    ) -> None:
        self.t, self.n_steps, self.status = 0.0, 0, Status.OK
        # Times of the spin's zeros so far, without those after which the body is dead.
        self.zeros = list[float]()
        self.ended = not batch.t_end[0] > 0
        self._batch, self._tableau, self._dt, self._look = batch, tableau, dt, look
        self._models = [model, ATTITUDES[model.name]] if attitude else [model]
        # Loaded together, so that they are compiled in parallel.
        self._kernel, self._observe, decision, *others = load_kernels(
            (steps_recipe, model.name, tableau.adaptive),
            (observe_recipe, model.name),
            (batches.decide_closely, tableau.adaptive),
            *((batches.attempt, tableau.name, each.name) for each in self._models),
            *((states_recipe, each.name) for each in self._models),
        )
        steps, self._states = others[: len(self._models)], others[len(self._models) :]
        self._steps = [addresses_of(step) for step in steps]
        # No window ends, so no amplitudes are compared.
        endless = replace(batch, window=np.full(1, 1e290), first_mark=np.full(1, 1e290))
        self._run = (
            batches.problem_of(model, tableau.adaptive),
            addresses_of(steps[0], decision),
            batches.workspace(tableau, model, 1)[0],
            *batches.run_arrays(endless, tableau, tol, dt, max_steps),
            np.zeros(runs.N_RECORD, dtype=np.bool_),
        )
        self._counts, self._energies = np.zeros(N_COUNTS, dtype=np.int64), np.zeros(2)
        self._zeros = np.zeros(256)
        # Row 0 is where the last call ended.  The first call only stores the launch
        # there.
        self._table = np.zeros((1 + STEPS_PER_CALL, STATE + 2 * model.n_state))
        self._kernel(
            *self._run, self._table[:1], self._zeros, self._counts, self._energies
        )
        self._rows = 1
        self.energy_0 = float(self._energies[0])
        self._extra = np.zeros((1, self._models[-1].n_extra))
        if look is not None:
            look(np.zeros(1), self.observe(batch.y0))

    def launch(self) -> Samples:
        """Return the state at time zero."""
        return Samples(
            np.zeros(1), self._batch.y0.copy(), np.zeros((1, self._extra.shape[1]))
        )

    def steps(self) -> Samples:
        """Continue, and return the ends of the next accepted steps; none if the run has
        ended.
        """
        if self.ended:
            return self._samples(0, 0)
        self._continue()
        return self._samples(1, self._rows)

    def observe(self, states: Floats) -> Floats:
        """Return spin, energy minus work, normal and tangential force, shape (4, rows).

        They are in ``sqrt(g/a)``, ``M g a`` and ``M g``.
        """
        out = np.empty((4, len(states)))
        problem = batches.problem_of(self._models[0], True)
        self._observe(problem, states, self._batch.constants[0], out)
        return out

    def at(self, times: Floats) -> Samples:
        """Return the states at increasing times, which must not precede those of the
        last call.

        Times after the end of the run are left out.
        """
        out = np.empty((len(times), self._batch.y0.shape[1]))
        extra, done = np.empty((len(times), self._extra.shape[1])), 0
        while done < len(times):
            ends = self._table[: self._rows, T]
            upto = int(np.searchsorted(times, ends[-1], side="right"))
            if upto > done:
                part = times[done:upto]
                which = np.maximum(np.searchsorted(ends, part, side="left") - 1, 0)
                offset = (part - ends[which]) + self._table[which, T_LOW]
                out[done:upto] = self._between(0, which, offset)
                if extra.size:
                    # The moves are in the frame of the heading at the start of the
                    # step.
                    moved, start = self._moves(which, offset), self._extra[which]
                    extra[done:upto, 0] = start[:, 0] + moved[:, 0]
                    extra[done:upto, 1:] = start[:, 1:] + _rotated(
                        start[:, 0], moved[:, 1:]
                    )
                done = upto
            elif self.ended:
                break
            else:
                self._continue()
        return Samples(times[:done], out[:done], extra[:done])

    def _samples(self, first: int, last: int) -> Samples:
        table = self._table[first:last]
        y = table[:, STATE : STATE + self._batch.y0.shape[1]]
        return Samples(table[:, T].copy(), y.copy(), self._extra[first:last].copy())

    def _between(self, place: int, which: Integers, offset: Floats) -> Floats:
        model, constants = self._models[place], self._batch.constants[0].copy()
        w = batches.workspace(self._tableau, model, 1)[0]
        out = np.empty((len(which), model.n_state))
        given = batches.problem_of(model, True), self._steps[place], w, self._table
        self._states[place](*given, which.astype(np.int64), offset, constants, out)
        return out

    def _moves(self, which: Integers, offset: Floats) -> Floats:
        return self._between(1, which, offset)[:, self._batch.y0.shape[1] :]

    def _continue(self) -> None:
        table, counts = self._table, self._counts
        self._kernel(*self._run, table, self._zeros, counts, self._energies)
        self._rows = rows = 1 + int(counts[N_STEPS])
        self.n_steps += int(counts[N_STEPS]) * batches.stride(self._tableau)
        self.zeros += self._zeros[: counts[N_ZEROS]].tolist()
        self.t = float(table[rows - 1, T])
        self.ended, self.status = bool(counts[ENDED]), Status(int(counts[STATUS]))
        base = self._extra[-1]
        self._extra = np.repeat(base[None], rows, axis=0)
        if base.size:
            length = np.diff(table[:rows, T]) - np.diff(table[:rows, T_LOW])
            moved = self._moves(np.arange(rows - 1), length)
            self._extra[1:, 0] = base[0] + np.cumsum(moved[:, 0])
            turned = _rotated(self._extra[:-1, 0], moved[:, 1:])
            self._extra[1:, 1:] = base[1:] + np.cumsum(turned, axis=0)
        if self.ended and self.status == Status.OK:
            self._check_accuracy()
        if self._look is not None:
            found = self._samples(1, rows)
            self._look(found.t, self.observe(found.y))

    def _check_accuracy(self) -> None:
        """Set the status that a sweep would give to a run whose numbers cannot be
        trusted.
        """
        drift = (float(self._energies[1]) - self.energy_0) / self.energy_0
        if not abs(drift) <= runs.MAX_ENERGY_DRIFT:
            self.status = Status.ENERGY if np.isfinite(drift) else Status.NONFINITE
        elif not self._tableau.adaptive:
            coarse = batches.is_coarse(
                self._tableau, self._dt, self._batch.relevant, self.t
            )
            self.status = Status.COARSE if coarse[0] else Status.OK


def _rotated(heading: Floats, move: Floats) -> Floats:
    """Return moves in the plane, rotated by headings."""
    cosine, sine = np.cos(heading), np.sin(heading)
    x, y = move[:, 0], move[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
