"""One run followed past its reversals: accepted steps, states at any times, zeros.

:func:`record_steps` runs the sweep's kernel with one run in one lane, so that accepted
steps and the first reversal have the same bits as in a sweep; but it stores every
accepted step, and does not end the run at a reversal.  :func:`states_after` computes
states at any times, each by one step of the method from the accepted step before it, so
that no accepted step depends on them.
"""

# mypy: disable-error-code="no-untyped-def"
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import NamedTuple, Self, cast

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.compiling.intrinsics import call, first_of, widest_vectors
from rattlesweep.compiling.loading import Kernel, Order, load_kernels
from rattlesweep.kernel import answer, recipes, runs, turn
from rattlesweep.kernel import batch as batches
from rattlesweep.kernel.event.zeros import HOLD
from rattlesweep.kernel.method.tableau import DT, MAX_STEPS, TOL, Tableau
from rattlesweep.kernel.outcome import Batch
from rattlesweep.kernel.state.fields import (
    GROUP,
    N_SLIP,
    NEVER,
    NO_ROW,
    SCAN,
    SLIP_SPEED,
    Slip,
)
from rattlesweep.kernel.state.lane import lane_of, recorded
from rattlesweep.kernel.state.status import Status
from rattlesweep.kernel.state.statuses import OK
from rattlesweep.kernel.state.ways import mode_of
from rattlesweep.motion import rotations
from rattlesweep.motion.chart import ANYWHERE
from rattlesweep.motion.model import Model, find_model

STEPS_PER_CALL = 2048  # a few milliseconds, after which Python can act on Ctrl-C
MOST_ZEROS = 256  # in a call
CALLS_AHEAD = 100  # calls whose steps are kept for later, a few hundred kB each
# Columns of a stored step: time, its low part, sense of the spin from there on, then
# the state, its derivative and slip.
T, T_LOW, SENSE, STATE = range(4)
# Columns of ``extremes``: the largest ratio of the contact forces, the least normal
# force.
RATIO_MAX, NORMAL_MIN = 0, 1


class StoredSteps(NamedTuple):
    """How far a call of :func:`record_steps` has come."""

    rows: int  # of the tables
    zeros: int
    turns: int
    ended: bool
    status: int
    energy_0: float  # at launch
    energy: float  # in the last row


def record_steps(
    problem,
    traits,
    parts,
    w,
    inputs,
    options,
    recording,
    begins,
    steps,
    extremes,
    zeros,
    turns,
):
    """Begin or continue the run until the tables are full or it ends at its horizon.

    The arguments up to ``options`` are those of `turn.work_off` for one run, which
    stays in the workspace between calls.  ``recording`` is that of reversals and
    perhaps of the contact.  The tables are ``steps``, where the run is and then the
    ends of accepted steps; the ``extremes`` of the contact until then, if they are
    recorded; times of ``zeros``; and times of ``turns``, which are reversals.
    """
    widest_vectors()
    max_steps = options.most_steps
    lane = lane_of(problem, w, 0)
    if begins:
        turn.start_run(problem, traits, parts, w, 0, 0, inputs)
        lane.next = NEVER  # no window ends
        if lane.arm > 0.0:
            # All zeros are searched from the launch on, also those that do not count.
            lane.arm = 0.0
            lane.sign = 1.0 if lane.rate0 > 0.0 else -1.0
            lane.rate_max = lane.arm_rate
        for l in range(1, problem.lanes):
            turn.empty_lane(problem, traits, parts, w, l)
    row = 0
    n_zeros = 0
    n_turns = 0
    status = OK
    accepted = True
    last = False
    ended = False
    while True:
        if accepted:
            steps[row, T] = lane.t
            steps[row, T_LOW] = lane.t_low
            if last:
                steps[row, T] = lane.t_end
                steps[row, T_LOW] = 0.0
            if traits.sense != NO_ROW:
                steps[row, SENSE] = w[traits.sense * problem.lanes]
            count = traits.n_state
            rate = STATE + count
            runs.read_rows(problem, w, 0, traits.y, steps, row, STATE, count)
            runs.read_rows(problem, w, 0, traits.f, steps, row, rate, count)
            if traits.slip != NO_ROW:
                slip = rate + count
                runs.read_rows(problem, w, 0, traits.slip, steps, row, slip, N_SLIP)
            extremes[row, RATIO_MAX] = lane.ratio_max
            extremes[row, NORMAL_MIN] = lane.normal_min
            row += 1
        if ended or row == steps.shape[0] or n_zeros == zeros.size:
            break
        crossed = lane.t_crossed
        reversals_before = lane.reversals
        lane.n_after = NEVER  # no peak of a turn is searched
        due = turn.try_step(problem, traits, parts, w, options, recording, GROUP, False)
        if due & 1 != 0:
            status, move = turn.call_closer(traits, parts, w, 0, max_steps, recording)
            ended = status != OK or (move != HOLD and lane.last > 0.0)
        last = lane.last > 0.0
        is_new = lane.t_crossed != crossed or lane.reversals > reversals_before
        if is_new and lane.dead > 0.0:
            turn.ask(parts, answer.MEASURE, w, 0)
        if lane.t_crossed != crossed and not runs.is_dead(lane):
            zeros[n_zeros] = lane.t_crossed
            n_zeros += 1
        if lane.reversals > reversals_before and not runs.is_dead(lane):
            turns[n_turns] = lane.t_turn
            n_turns += 1
        accepted = lane.accept > 0.0
        if not accepted:
            runs.hold_back(problem, traits, w, 0)
        if traits.limited or recorded(recording.contact):
            turn.watch(problem, traits, parts, w, recording)
        turn.commit(problem, traits, parts, w)
    turn.ask(parts, answer.MEASURE, w, 0)
    energy = lane.energy1
    return StoredSteps(row, n_zeros, n_turns, ended, status, lane.energy0, energy)


def states_after(
    problem, traits, given, parts, w, steps, which, offset, constants, swing, scale, out
):
    """Write the states a time ``offset`` after rows of ``steps`` to ``out``.

    Each is one step of the method in its own lane.  ``steps`` has the first ``given``
    components of the state; others start at zero, as the workspace does.
    ``constants`` are those of the run, and ``swing`` is the fastest angular frequency
    of the spin.  The slip is written behind the state if the model slides.
    """
    widest_vectors()
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        runs.fill_constants(problem, traits, w, l, constants, 0)
        # Lanes that slide try steps of the given sizes.
        lane.swing = swing
        lane.search = SCAN
    points = which.size
    for first in range(0, points, problem.lanes):
        for l in range(problem.lanes):
            i = min(first + l, points - 1)
            lane = lane_of(problem, w, l)
            step = which[i]
            rate = STATE + given
            runs.fill_rows(problem, w, l, traits.y, steps, step, STATE, given)
            runs.fill_rows(problem, w, l, traits.f, steps, step, rate, given)
            sense = steps[step, SENSE]
            has_sense = traits.sense != NO_ROW
            if has_sense:
                w[traits.sense * problem.lanes + l] = sense
            if given < traits.n_state:
                turn.ask(parts, answer.DERIVE, w, l)
            lane.h = offset[i]
            slip = STATE + 2 * given
            speed = steps[step, slip + SLIP_SPEED]
            lane.mode = mode_of(speed, has_sense, sense)
            if traits.slip != NO_ROW:
                for place in (traits.slip, traits.slip + traits.n_end):
                    runs.fill_rows(problem, w, l, place, steps, step, slip, N_SLIP)
        call(parts[turn.ATTEMPT], (w, scale, problem.lanes))
        if parts[turn.SLIDE] != 0:
            call(parts[turn.SLIDE], (w, scale, False, 0))
        for l in range(min(problem.lanes, points - first)):
            point = first + l
            count = traits.n_state
            end = traits.y + traits.n_end
            runs.read_rows(problem, w, l, end, out, point, 0, count)
            if traits.slip != NO_ROW:
                end = traits.slip + traits.n_end
                runs.read_rows(problem, w, l, end, out, point, count, N_SLIP)


def observe_samples(problem, states, slips, constants, mu, out):
    """Write spin, energy, contact forces and torque of pivoting to ``out``.

    Each state has a row of constants, as the sense of a spin changes.
    """
    model = problem.model
    for i in range(out.shape[1]):
        y = first_of(states[i], model.n_state)
        slip = Slip(*first_of(slips[i], N_SLIP))
        q = first_of(constants[i], model.n_constants)
        out[0, i] = model.spin(y)
        observed = problem.modes.observe(model, y, slip, q, mu)
        for row, value in enumerate(observed):
            out[1 + row, i] = value


def steps_recipe() -> Kernel:
    """Return :func:`record_steps`, which serves all models and methods."""
    loop = recipes.problem_of(None), recipes.TRAITS, recipes.NO_PARTS, recipes.FLAT
    run = *loop, recipes.INPUTS, recipes.SETTINGS
    tables = recipes.TABLE, recipes.TABLE, recipes.FLAT, recipes.FLAT
    return Kernel(record_steps, (*run, recipes.NOTHING, True, *tables), recipes.CALLED)


def states_recipe() -> Kernel:
    """Return :func:`states_after`, which serves all models and methods."""
    model = recipes.problem_of(None), recipes.TRAITS, 1, recipes.NO_PARTS
    points = recipes.TABLE, recipes.WHOLE, recipes.FLAT
    settings = recipes.TABLE, 1.0, 1.0
    arguments = *model, recipes.FLAT, *points, *settings, recipes.TABLE
    return Kernel(states_after, arguments, recipes.CALLED)


def observe_recipe(model_name: str) -> Kernel:
    """Return :func:`observe_samples` of a model."""
    problem = recipes.problem_of(find_model(model_name))
    tables = recipes.TABLE, recipes.TABLE, recipes.TABLE
    arguments = problem, *tables, 1.0, recipes.TABLE
    return Kernel(observe_samples, arguments, recipes.CALLED)


@dataclass(frozen=True)
class Samples:
    """States at some times, a row each."""

    t: Floats  # in sqrt(a/g)
    y: Floats  # in the model's variables
    # Columns SLIP_SPEED, ... of `state.fields`; the speed is zero where the body rolls.
    slip: Floats
    # Of a body with pivoting friction: sign of the spin from there on, 0 while it is
    # held.
    sense: Floats
    extra: Floats  # heading and contact point (see `physics.full`), or no columns

    @classmethod
    def joined(cls, pieces: Sequence[Self]) -> Self:
        """Return samples one after the other."""
        names = [field.name for field in fields(cls)]
        columns = [[getattr(piece, name) for piece in pieces] for name in names]
        return cls(*map(np.concatenate, columns))


@dataclass(frozen=True)
class Stretch:
    """A part of a run: what a call of :func:`record_steps` has stored."""

    steps: Floats  # where it begins, and then the ends of accepted steps
    extremes: Floats
    zeros: list[float]
    turns: list[float]
    ended: bool
    status: Status


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
        self._tol = tol
        self._max_steps = max_steps
        self._longest_step = longest_step
        self._look: Look | None = None
        self._recorded = {"reversals"}
        if look is not None:
            # The contact is only watched for one who looks.
            self._recorded.add("contact")
        ((_, own),) = batches.by_own_model(batch, model)
        batch = batches.with_model(batch, model, own)
        model = own
        self._start(batch, model, attitude)
        there = model.anywhere
        if there is not None:
            self._look_ahead(batch, there, attitude)
        self._look = look
        if look is not None:
            look(self.launch(), self.observe(self.launch()), self._extremes)

    def _look_ahead(self, batch: Batch, anywhere: Model, attitude: bool) -> None:
        """Integrate the run to its end, and begin anew in other variables if it fails.

        What it has stored until then is kept for later, unless it is too much.
        """
        ended = self.ended
        status = Status.OK
        too_long = False
        while not ended:
            stretch = self._integrate()
            ended = stretch.ended
            status = stretch.status
            self._ahead.append(stretch)
            if len(self._ahead) > CALLS_AHEAD:
                too_long = True
                self._ahead.clear()
        if status in batches.LEFT_CHART:
            self._start(batches.anywhere(batch, self.model), anywhere, attitude)
        elif too_long:
            self._start(batch, self.model, attitude)

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
        self._models = [model]
        if attitude:
            self._models.append(model.with_attitude)
        rimmed = batches.can_reach_rim(batch, model)
        record: Order = (steps_recipe,)
        after: Order = (states_recipe,)
        look: Order = (observe_recipe, model.name)
        parts: list[list[Order | None]] = []
        for each in self._models:
            # Nobody asks for the peaks of the spin between reversals, and of the
            # attitude's model single steps are taken (`states_after`).
            steps = each is model
            looked = self._recorded - {"reversals"} if steps else ()
            own = recipes.parts_of(tableau, each, looked, rimmed=rimmed)
            if not steps:
                own[turn.ANSWER_FOR_ALL] = None
            parts.append(own)
        # Loaded together, so that they are compiled in parallel, like parts one after
        # the other.
        alike = filter(None, chain.from_iterable(zip(*parts, strict=True)))
        orders = [record, after, *alike, look]
        loaded = dict(zip(orders, load_kernels(*orders), strict=True))
        self._kernel = loaded[record]
        self._observe = loaded[look]
        self._after = loaded[after]
        self._parts = [recipes.addresses(own, loaded) for own in parts]
        # No window ends, so no amplitudes are compared.
        endless = replace(
            batch, window=np.full(1, NEVER), first_comparison=np.full(1, NEVER)
        )
        self._run = (
            recipes.problem_of(None),
            recipes.traits_for(tableau, model, rimmed=rimmed),
            self._parts[0],
            recipes.workspace(tableau, model, 1)[0],
            batches.inputs_of(
                endless, tableau, self._tol, self._dt, longest_step=self._longest_step
            ),
            batches.options_of(tableau, self._tol, self._dt, self._max_steps),
            batches.recording_of(1, self._recorded),
        )
        # Columns of the table of steps.
        self._width = STATE + 2 * model.n_state + N_SLIP
        # Stretches of the run that are known already.
        self._ahead = deque[Stretch]()
        launch, stored = self._call(1, begins=True)
        self._table = launch.steps
        self._extremes = launch.extremes
        self.energy_0 = stored.energy_0
        self._extra = np.zeros((1, self._models[-1].n_extra))
        self._in_any_position = attitude and model.chart is ANYWHERE
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
        return self._samples(1, len(self._table))

    def observe(self, samples: Samples) -> Floats:
        """Return an array of shape (5, rows) of what samples show.

        Its rows are the spin in ``sqrt(g/a)``, the energy minus the work in ``M g a``,
        the normal and the tangential force in ``M g``, and the torque of pivoting
        friction in ``M g a``.
        """
        count = len(samples.t)
        out = np.empty((5, count))
        values = self.constants
        if "sense" in values:
            values = values | {"sense": samples.sense}
        names = self.model.constants
        columns = [np.broadcast_to(values[name], count) for name in names]
        constants = np.stack(columns, axis=1)
        mu = float(values.get("mu", np.inf))
        problem = recipes.problem_of(self.model)
        # The kernel is compiled for arrays without gaps.
        states, slips = map(np.ascontiguousarray, (samples.y, samples.slip))
        self._observe(problem, states, slips, constants, mu, out)
        return out

    @property
    def swing(self) -> float:
        """The fastest angular frequency of the spin, in ``sqrt(g/a)``."""
        return float(self._batch.swing[0])

    def lengths(self) -> Floats:
        """Return the lengths of the steps that the last call continued by."""
        table = self._table
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
        pieces = [self._samples(0, 0)]
        done = 0
        while done < len(times):
            ends = self._table[:, T]
            upto = int(np.searchsorted(times, ends[-1], side="right"))
            if upto > done:
                wanted = times[done:upto]
                which = np.maximum(np.searchsorted(ends, wanted, side="left") - 1, 0)
                offset = (wanted - ends[which]) + self._table[which, T_LOW]
                pieces.append(replace(self.within(which, offset), t=wanted))
                done = upto
            elif self.ended:
                break
            else:
                self._continue()
        return Samples.joined(pieces)

    def _samples(self, first: int, last: int) -> Samples:
        """Return rows of the table of steps."""
        table = self._table[first:last]
        y = table[:, STATE : STATE + self._batch.y0.shape[1]]
        slip = table[:, STATE + 2 * self._batch.y0.shape[1] :]
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
        out = np.zeros((len(which), model.n_state + N_SLIP))
        self._after(
            recipes.problem_of(None),
            recipes.traits_for(self._tableau, model),
            self._batch.y0.shape[1],
            self._parts[place],
            recipes.workspace(self._tableau, model, 1)[0],
            self._table,
            which.astype(np.int64),
            offset,
            self._batch.constants[:1],
            self.swing,
            1.0 / self._tol**2,
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
        """Return what :func:`rotations.after` takes, since rows of the table."""
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

    def _call(self, rows: int, *, begins: bool) -> tuple[Stretch, StoredSteps]:
        """Begin or continue the run, for a number of rows of the table of steps."""
        steps = np.zeros((rows, self._width))
        extremes = np.zeros((rows, 2))
        zeros = np.zeros(MOST_ZEROS)
        # The first reversal of a call may belong to a zero of the call before.
        turns = np.zeros(MOST_ZEROS + 1)
        tables = steps, extremes, zeros, turns
        stored = cast(StoredSteps, self._kernel(*self._run, begins, *tables))
        stretch = Stretch(
            steps=steps[: stored.rows],
            extremes=extremes[: stored.rows],
            zeros=zeros[: stored.zeros].tolist(),
            turns=turns[: stored.turns].tolist(),
            ended=bool(stored.ended),
            status=Status(stored.status),
        )
        return stretch, stored

    def _integrate(self) -> Stretch:
        """Return the next stretch of the run."""
        stretch, stored = self._call(1 + STEPS_PER_CALL, begins=False)
        if stretch.ended and stretch.status == Status.OK:
            drift = (stored.energy - stored.energy_0) / stored.energy_0
            status = self._trusted(drift, float(stretch.steps[-1, T]))
            stretch = replace(stretch, status=status)
        return stretch

    def _continue(self) -> None:
        """Go on to the next stretch."""
        if self._ahead:
            stretch = self._ahead.popleft()
        else:
            stretch = self._integrate()
        table = stretch.steps
        rows = len(table)
        self._table = table
        self._extremes = stretch.extremes
        self.n_steps += (rows - 1) * batches.stride(self._tableau)
        self.zeros += stretch.zeros
        self.reversals += stretch.turns
        self.t = float(table[-1, T])
        self.ended = stretch.ended
        self.status = stretch.status
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
        if self._look is not None:
            samples = self._samples(1, rows)
            self._look(samples, self.observe(samples), stretch.extremes[1:])

    def _trusted(self, drift: float, t_end: float) -> Status:
        """Return the status that a sweep gives to a run that has reached its end."""
        if not abs(drift) <= runs.MAX_ENERGY_DRIFT:
            if np.isfinite(drift):
                return Status.ENERGY
            return Status.NONFINITE
        tableau = self._tableau
        relevant = self._batch.relevant
        if tableau.adaptive or not batches.is_coarse(
            tableau, self._dt, relevant, t_end
        ):
            return Status.OK
        return Status.COARSE


def _rotated(heading: Floats, move: Floats) -> Floats:
    """Return moves in the plane, rotated by headings."""
    cosine = np.cos(heading)
    sine = np.sin(heading)
    x = move[:, 0]
    y = move[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
