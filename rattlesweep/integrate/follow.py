"""One run followed past its reversals: accepted steps, states at any times, zeros.

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
from rattlesweep.integrate import attitude as rotations
from rattlesweep.integrate import batch as batches
from rattlesweep.integrate.batch import Batch
from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.lanes import kernel, pivots, runs
from rattlesweep.integrate.lanes.events import HOLD, NEVER, SCAN
from rattlesweep.integrate.lanes.lane import (
    N_SLIP,
    Slip,
    addresses_of,
    call,
    first_of,
    lane_of,
    widest_vectors,
)
from rattlesweep.integrate.model import ATTITUDES, Model, find_model
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DT, MAX_STEPS, TOL, Tableau

STEPS_PER_CALL = 2048  # a few milliseconds, after which Python can act on Ctrl-C
MOST_ZEROS = 256  # in a call
# ``counts`` of :func:`record_steps`: whether the run has begun and ended, its status,
# and the numbers of steps, zeros and reversals that the last call stored.
BEGUN, ENDED, STATUS, N_STEPS, N_ZEROS, N_TURNS, N_COUNTS = range(7)
# Columns of a stored step: time, its low part, sense of the spin from there on, then
# the state, its derivative and slip.
T, T_LOW, SENSE, STATE = range(4)
# ``energies`` at launch and in the last row.
FIRST, LAST = 0, 1
# Columns of ``extremes``: the largest ratio of the contact forces, the least normal
# force.
RATIO_MAX, NORMAL_MIN = 0, 1


def record_steps(
    problem,
    parts,
    w,
    y0,
    constants,
    probe,
    plan,
    options,
    reversals,
    contact,
    steps,
    zeros,
    turns,
    counts,
    energies,
    extremes,
):
    """Continue the run until the tables are full or it ends.

    It ends at its horizon.  The arguments up to ``options`` are those of the
    kernel's ``work`` for one run, which stays in the workspace between calls.  The
    others are outputs: ``reversals`` and ``contact`` of a Recording; ``steps``, where
    the run is and then the ends of accepted steps; times of ``zeros`` and of ``turns``,
    which are reversals; ``counts``; ``energies``; for each row of ``steps``, the
    ``extremes`` of the contact until then, if ``contact`` is recorded.
    """
    widest_vectors()
    nothing = reversals[:0]
    recording = runs.Recording(
        nothing, contact, nothing, reversals, nothing, nothing, nothing
    )
    max_steps = options[kernel.MOST_STEPS]
    lane = lane_of(problem, w, 0)
    if counts[BEGUN] == 0:
        counts[BEGUN] = 1
        problem.hooks.start(lane, 0, y0, constants, probe, plan)
        lane.next = 1e290  # no window ends
        if lane.arm > 0.0:
            # All zeros are searched from the launch on, also those that do not count.
            lane.arm = 0.0
            lane.sign = 1.0 if lane.rate0 > 0.0 else -1.0
            lane.rate_max = lane.arm_rate
        for l in range(1, problem.lanes):
            runs.idle(lane_of(problem, w, l))
    row = 0
    n_zeros = 0
    n_turns = 0
    status = kernel.OK
    accepted = True
    last = False
    ended = False
    while True:
        if accepted:
            steps[row, T] = lane.t_end if last else lane.t
            steps[row, T_LOW] = 0.0 if last else lane.t_low
            if problem.pivots:
                steps[row, SENSE] = lane.constants[-1]
            for c, component in enumerate(lane.y + lane.f):
                steps[row, STATE + c] = component
            for c, component in enumerate(lane.slip):
                steps[row, steps.shape[1] - N_SLIP + c] = component
            extremes[row, RATIO_MAX] = lane.ratio_max
            extremes[row, NORMAL_MIN] = lane.normal_min
            row += 1
        if ended or row == steps.shape[0] or n_zeros == zeros.size:
            break
        crossed = lane.t_crossed
        reversals_before = lane.reversals
        lane.n_after = NEVER  # no peak of a turn is searched
        if kernel.try_step(problem, parts, w, options, recording) > 0:
            status, move = kernel.look_closer(
                problem, parts, w, 0, max_steps, recording
            )
            ended = status != kernel.OK or (move != HOLD and lane.last > 0.0)
        last = lane.last > 0.0
        if lane.t_crossed != crossed and not runs.is_dead(lane):
            zeros[n_zeros] = lane.t_crossed
            n_zeros += 1
        if lane.reversals > reversals_before and not runs.is_dead(lane):
            turns[n_turns] = lane.t_turn
            n_turns += 1
        accepted = lane.accept > 0.0
        if not accepted:
            runs.hold_back(lane)
        if problem.limited or runs.recorded(contact):
            kernel.watch(problem, w, recording)
        kernel.commit(problem, w)
    counts[ENDED] = 1 if ended else 0
    counts[STATUS] = status
    counts[N_STEPS] = row - 1
    counts[N_ZEROS] = n_zeros
    counts[N_TURNS] = n_turns
    energies[FIRST] = lane.energy0
    energies[LAST] = problem.hooks.energy(lane)


def states_after(problem, parts, w, steps, which, offset, constants, swing, scale, out):
    """Write the states a time ``offset`` after rows of ``steps`` to ``out``.

    Each is one step of the method in its own lane.  Components that ``steps`` lacks
    start at zero.
    """
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        lane.constants = first_of(constants, problem.model.n_constants)
        # Lanes that slide try steps of the given sizes.
        lane.mu = constants[-1]
        lane.swing = swing
        lane.mode = SCAN
    given = problem.n_given
    points = which.size
    for first in range(0, points, problem.lanes):
        for l in range(problem.lanes):
            i = min(first + l, points - 1)
            lane = lane_of(problem, w, l)
            row = steps[which[i], STATE:]
            lane.y = first_of(row, given) + problem.extra
            lane.f = first_of(row[given:], given) + problem.extra
            if problem.pivots:
                pivots.set_sense(lane, steps[which[i], SENSE])
            if given < problem.model.n_state:
                runs.derive(lane)
            lane.h = offset[i]
            lane.slip = Slip(*first_of(row[row.size - N_SLIP :], N_SLIP))
            lane.slip1 = lane.slip
        call(parts[kernel.ATTEMPT], (problem, w, scale))
        if problem.slides:
            call(parts[kernel.SLIDE], (problem, w, scale, False))
        for l in range(min(problem.lanes, points - first)):
            lane = lane_of(problem, w, l)
            for c, component in enumerate(lane.y1):
                out[first + l, c] = component
            for c, component in enumerate(lane.slip1):
                out[first + l, out.shape[1] - N_SLIP + c] = component


def observe(problem, states, slips, senses, constants, out):
    """Write spin, energy, normal and tangential contact force to ``out``."""
    model = problem.model
    q = first_of(constants, model.n_constants)
    mu = constants[-1]
    for i in range(out.shape[1]):
        y = first_of(states[i], model.n_state)
        slip = Slip(*first_of(slips[i], N_SLIP))
        if problem.pivots:
            q = q[:-1] + (senses[i],)  # noqa: RUF005
        out[0, i] = model.spin(y)
        out[1, i], out[2, i], out[3, i] = problem.hooks.observe(model, y, slip, q, mu)


OPTIONS = {"nogil": True, "error_model": "numpy"}


def steps_recipe(model_name: str, adaptive: bool, rim: str = "") -> Kernel:
    """Return :func:`record_steps` of a model; ``rim`` is as for `batch.work`."""
    problem = batches.problem_of(find_model(model_name), adaptive, rimmed=bool(rim))
    run = problem, batches.NO_PARTS, batches.FLAT, *batches.RUNS
    times = batches.FLAT, batches.FLAT
    outputs = batches.TABLE, *times, batches.WHOLE, batches.FLAT, batches.TABLE
    recorded = batches.NOTHING.reversals, batches.NOTHING.contact
    arguments = *run, *recorded, *outputs
    return Kernel(record_steps, arguments, OPTIONS)


def states_recipe(model_name: str) -> Kernel:
    """Return :func:`states_after` of a model, which serves all methods."""
    problem = batches.problem_of(find_model(model_name), True)
    points = batches.TABLE, batches.WHOLE, batches.FLAT
    arguments = problem, batches.NO_PARTS, batches.FLAT, *points
    settings = batches.FLAT, 1.0, 1.0
    return Kernel(states_after, (*arguments, *settings, batches.TABLE), OPTIONS)


def observe_recipe(model_name: str) -> Kernel:
    """Return :func:`observe` of a model."""
    problem = batches.problem_of(find_model(model_name), True)
    tables = batches.TABLE, batches.TABLE, batches.FLAT, batches.FLAT, batches.TABLE
    return Kernel(observe, (problem, *tables), OPTIONS)


@dataclass(frozen=True)
class Samples:
    """States at some times, a row each."""

    t: Floats  # in sqrt(a/g)
    y: Floats  # in the model's variables
    # Columns SLIP_SPEED, ... of `lanes.lane.Slip`; the speed is zero where the
    # body rolls.
    slip: Floats
    # Of a body with pivoting friction: sign of the spin from there on, 0 while it is
    # held.
    sense: Floats
    extra: Floats  # heading and contact point (see `physics.full`), or no columns


# What looks on: see `Follower`.
Look = Callable[[Samples, Floats, Floats], None]


class Follower:
    """Integrates a batch of one run past its reversals, as far as states are requested.

    With `attitude`, heading and contact point are integrated over the accepted steps.
    `look` is called with samples, the result of :meth:`observe`, and the extremes of
    the contact until then, between steps too: for the launch, then for the accepted
    steps.  If the step is fixed, only every eighth step counts as
    accepted.  `longest_step` is as for `integrate`.

    A run that leaves the chart of its variables is integrated again from its launch
    with :attr:`Model.anywhere`, as in sweeps; :attr:`model` is the model whose
    variables the states have, and :attr:`constants` has its constants by name.
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
        longest_step: Floats | float = np.inf,
        attitude: bool = False,
        look: Look | None = None,
    ) -> None:
        self._tableau = tableau
        self._dt = dt
        self._settings = tol, dt, max_steps
        self._longest_step = longest_step
        self._look: Look | None = None
        # The contact is only watched for one who looks.
        self._contact = np.zeros((int(look is not None), *runs.SHAPES.contact))
        if model.flat is not None and batches.on_paraboloids(batch, model).all():
            batch, model = batches.flattened(batch, model)
        self._start(batch, model, attitude)
        if model.anywhere is not None:
            while not self.ended:
                self._continue()
            if self.status in batches.FAILED:
                self._start(batches.anywhere(batch), model.anywhere, attitude)
            else:
                self._start(batch, model, attitude)
        self._look = look
        if look is not None:
            look(self.launch(), self.observe(self.launch()), self._extremes[:1])

    def _start(self, batch: Batch, model: Model, attitude: bool) -> None:
        """Load the kernels of a model, and begin the run at its launch."""
        self.model = model
        self.t = 0.0
        self.n_steps = 0
        self.status = Status.OK
        # Times of the spin's zeros so far, without those after which the body is dead,
        # and of the first zero in each reversal.
        self.zeros = list[float]()
        self.reversals = list[float]()
        self.ended = not batch.t_end[0] > 0
        self._batch = batch
        self.constants = model.named(batch.constants[0])
        tableau = self._tableau
        self._models = [model, ATTITUDES[model.name]] if attitude else [model]
        rimmed = batches.can_reach_rim(batch, model)
        rim = ("rimmed",) if rimmed else ()
        # Loaded together, so that they are compiled in parallel.
        self._kernel, self._observe, decision, *others = load_kernels(
            (steps_recipe, model.name, tableau.adaptive, *rim),
            (observe_recipe, model.name),
            (batches.decide_closely, tableau.adaptive),
            *((batches.attempt, tableau.name, each.name) for each in self._models),
            *((states_recipe, each.name) for each in self._models),
            *(
                (batches.slide_lanes, each.name, *rim)
                for each in self._models
                if each.slide
            ),
        )
        count = len(self._models)
        steps = others[:count]
        self._states = others[count : 2 * count]
        slides = others[2 * count :]
        self._parts = [addresses_of(step, decision) for step in steps]
        if slides:
            self._parts = [
                addresses_of(step, decision, slide)
                for step, slide in zip(steps, slides, strict=True)
            ]
        # No window ends, so no amplitudes are compared.
        endless = replace(batch, window=np.full(1, 1e290), first_mark=np.full(1, 1e290))
        self._run = (
            batches.problem_of(model, tableau.adaptive, rimmed=rimmed),
            self._parts[0],
            batches.workspace(tableau, model, 1)[0],
            *batches.run_arrays(
                endless, tableau, *self._settings, longest_step=self._longest_step
            ),
            np.zeros((1, *runs.SHAPES.reversals)),
            self._contact,
        )
        self._counts = np.zeros(N_COUNTS, dtype=np.int64)
        self._energies = np.zeros(2)
        self._zeros = np.zeros(MOST_ZEROS)
        # The first reversal of a call may belong to a zero of the call before.
        self._turns = np.zeros(MOST_ZEROS + 1)
        self._extremes = np.zeros((1 + STEPS_PER_CALL, 2))
        self._outputs = (
            self._zeros,
            self._turns,
            self._counts,
            self._energies,
            self._extremes,
        )
        # Row 0 is where the last call ended.  The first call only stores the launch
        # there.
        width = STATE + 2 * model.n_state + N_SLIP
        self._table = np.zeros((1 + STEPS_PER_CALL, width))
        self._kernel(*self._run, self._table[:1], *self._outputs)
        self._rows = 1
        self.energy_0 = float(self._energies[FIRST])
        self._extra = np.zeros((1, self._models[-1].n_extra))
        self._in_any_position = attitude and model.surface is None
        if self._in_any_position:
            self._extra = rotations.at_launch(batch.y0[0, :3])
        self._launch = self._samples(0, 1)

    def __getstate__(self) -> dict[str, object]:
        # The compiled code of this process cannot be sent to another, so that only
        # results are left there.
        names = ("t", "n_steps", "status", "zeros", "reversals", "ended", "energy_0")
        return {name: getattr(self, name) for name in names}

    def launch(self) -> Samples:
        """Return the state at time zero."""
        return self._launch

    def steps(self) -> Samples:
        """Continue, and return the next accepted steps; none if the run has ended."""
        if self.ended:
            return self._samples(0, 0)
        self._continue()
        return self._samples(1, self._rows)

    def observe(self, samples: Samples) -> Floats:
        """Return spin, energy minus work, normal and tangential force, shape (4, rows).

        They are in ``sqrt(g/a)``, ``M g a`` and ``M g``.
        """
        out = np.empty((4, len(samples.t)))
        problem = batches.problem_of(self._models[0], True)
        constants = self._batch.constants[0]
        self._observe(problem, samples.y, samples.slip, samples.sense, constants, out)
        return out

    @property
    def swing(self) -> float:
        """The fastest angular frequency of the spin, in ``sqrt(g/a)``."""
        return float(self._batch.swing[0])

    def lengths(self) -> Floats:
        """Return the lengths of the steps that the last call continued by."""
        table = self._table[: self._rows]
        lengths: Floats = np.diff(table[:, T]) - np.diff(table[:, T_LOW])
        return lengths

    def within(self, which: Integers, offset: Floats) -> Samples:
        """Return the states at some times within the steps of the last call.

        Each is one step of the method, a time `offset` after the begin of step `which`.
        """
        y, slip = self._between(0, which, offset)
        extra = self._extra[which]
        if self._in_any_position:
            extra = rotations.after(extra, *self._rotations(which, offset))
        elif extra.size:
            # The moves are in the frame of the heading at the start of the step.
            moved = self._moves(which, offset)
            turned = _rotated(extra[:, 0], moved[:, 1:])
            extra[:, 0] += moved[:, 0]
            extra[:, 1:] += turned
        t = self._table[which, T] + (offset - self._table[which, T_LOW])
        return Samples(t, y, slip, self._table[which, SENSE], extra)

    def at(self, times: Floats) -> Samples:
        """Return the states at increasing times, none before those of the last call.

        Times after the end of the run are left out.
        """
        y = np.empty((len(times), self._batch.y0.shape[1]))
        slip = np.empty((len(times), N_SLIP))
        sense = np.empty(len(times))
        extra = np.empty((len(times), self._extra.shape[1]))
        done = 0
        while done < len(times):
            ends = self._table[: self._rows, T]
            upto = int(np.searchsorted(times, ends[-1], side="right"))
            if upto > done:
                wanted = times[done:upto]
                which = np.maximum(np.searchsorted(ends, wanted, side="left") - 1, 0)
                offset = (wanted - ends[which]) + self._table[which, T_LOW]
                samples = self.within(which, offset)
                y[done:upto] = samples.y
                slip[done:upto] = samples.slip
                sense[done:upto] = samples.sense
                extra[done:upto] = samples.extra
                done = upto
            elif self.ended:
                break
            else:
                self._continue()
        return Samples(times[:done], y[:done], slip[:done], sense[:done], extra[:done])

    def _samples(self, first: int, last: int) -> Samples:
        """Return rows of the table of steps."""
        table = self._table[first:last]
        y = table[:, STATE : STATE + self._batch.y0.shape[1]]
        slip = table[:, table.shape[1] - N_SLIP :]
        extra = self._extra[first:last]
        return Samples(
            table[:, T].copy(),
            y.copy(),
            slip.copy(),
            table[:, SENSE].copy(),
            extra.copy(),
        )

    def _between(
        self, place: int, which: Integers, offset: Floats
    ) -> tuple[Floats, Floats]:
        """Return states and slips of a model at some times after rows of the table."""
        model = self._models[place]
        tol, _, _ = self._settings
        out = np.empty((len(which), model.n_state + N_SLIP))
        self._states[place](
            batches.problem_of(model, True),
            self._parts[place],
            batches.workspace(self._tableau, model, 1)[0],
            self._table,
            which.astype(np.int64),
            offset,
            self._batch.constants[0].copy(),
            self.swing,
            1.0 / tol**2,
            out,
        )
        return out[:, : model.n_state], out[:, model.n_state :]

    def _moves(self, which: Integers, offset: Floats) -> Floats:
        """Return the changes of heading and contact point since rows of the table."""
        y, _ = self._between(1, which, offset)
        return y[:, self._batch.y0.shape[1] :]

    def _rotations(
        self, which: Integers, offset: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return what :func:`attitude.after` takes, since rows of the table."""
        y, _ = self._between(1, which, offset)
        n_given = self._batch.y0.shape[1]
        ends = y[:, :n_given]
        starts = self._table[which, STATE : STATE + n_given]
        spins = [
            (state[:, :3] * state[:, 3:6]).sum(axis=1)
            / np.linalg.norm(state[:, :3], axis=1)
            for state in (starts, ends)
        ]
        return y[:, n_given:], ends[:, :3], 0.5 * offset * (spins[0] + spins[1])

    def _continue(self) -> None:
        """Fill the table with the next steps."""
        table = self._table
        counts = self._counts
        self._kernel(*self._run, table, *self._outputs)
        rows = 1 + int(counts[N_STEPS])
        self._rows = rows
        self.n_steps += int(counts[N_STEPS]) * batches.stride(self._tableau)
        self.zeros += self._zeros[: counts[N_ZEROS]].tolist()
        self.reversals += self._turns[: counts[N_TURNS]].tolist()
        self.t = float(table[rows - 1, T])
        self.ended = bool(counts[ENDED])
        self.status = Status(int(counts[STATUS]))
        base = self._extra[-1]
        self._extra = np.repeat(base[None], rows, axis=0)
        if self._in_any_position:
            steps = self._rotations(np.arange(rows - 1), self.lengths())
            self._extra = rotations.added(base, *steps)
        elif base.size:
            moved = self._moves(np.arange(rows - 1), self.lengths())
            self._extra[1:, 0] = base[0] + np.cumsum(moved[:, 0])
            turned = _rotated(self._extra[:-1, 0], moved[:, 1:])
            self._extra[1:, 1:] = base[1:] + np.cumsum(turned, axis=0)
        if self.ended and self.status == Status.OK:
            self._check_accuracy()
        if self._look is not None:
            samples = self._samples(1, rows)
            self._look(samples, self.observe(samples), self._extremes[1:rows])

    def _check_accuracy(self) -> None:
        """Set the status that a sweep gives to a run that cannot be trusted."""
        drift = (float(self._energies[LAST]) - self.energy_0) / self.energy_0
        if not abs(drift) <= runs.MAX_ENERGY_DRIFT:
            self.status = Status.ENERGY if np.isfinite(drift) else Status.NONFINITE
        elif not self._tableau.adaptive:
            coarse = batches.is_coarse(
                self._tableau, self._dt, self._batch.relevant, self.t
            )
            self.status = Status.COARSE if coarse[0] else Status.OK


def _rotated(heading: Floats, move: Floats) -> Floats:
    """Return moves in the plane, rotated by headings."""
    cosine = np.cos(heading)
    sine = np.sin(heading)
    x = move[:, 0]
    y = move[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
