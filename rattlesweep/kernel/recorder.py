"""Runs of one model in lanes side by side, with every accepted step in a table.

:func:`record_steps` runs the sweep's kernel with a run in each lane, so that accepted
steps and the first reversal have the same bits as in a sweep; but it stores every
accepted step, and does not end a run at a reversal.  :func:`states_after` computes
states at any times, each by one step of the method from the accepted step before it, so
that no accepted step depends on them.
"""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Sequence, Set
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import chain
from typing import Any, NamedTuple, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rattlesweep.arrays import Floats, Integers
from rattlesweep.compiling.intrinsics import (
    INNER,
    call,
    first_of,
    lowest_bit,
    widest_vectors,
)
from rattlesweep.compiling.loading import Compiled, Kernel, Order, load_kernels
from rattlesweep.kernel import answer, recipes, runs, turn
from rattlesweep.kernel import batch as batches
from rattlesweep.kernel.event.zeros import HOLD
from rattlesweep.kernel.method.tableau import METHODS, Tableau
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
from rattlesweep.motion.model import Model, find_model

STEPS_PER_CALL = 2048  # a few milliseconds, after which Python can act on Ctrl-C
MOST_ZEROS = 256  # in a call
# Columns of a stored step: time, its low part, sense of the spin from there on, then
# the state, its derivative and slip.
T, T_LOW, SENSE, STATE = range(4)
# Columns of ``extremes``: the largest ratio of the contact forces, the least normal
# force.
RATIO_MAX, NORMAL_MIN = 0, 1
# Columns of what is ``stored`` of a run in a call: how many rows its tables have, how
# it is, its energy at launch and in the last row; and of the turn under way, what was
# known before, whether the step ends the run and whether it is taken.
ROWS, ZEROS, TURNS, ENDED, STATUS, ENERGY_0, ENERGY = range(7)
CROSSED, REVERSED, LAST, ACCEPTED = range(7, 11)
N_STORED = 11


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
    stored,
):
    """Begin or continue runs until a table is full or all end at their horizons.

    The arguments up to ``options`` are those of `turn.work_off`; each run has a lane,
    in which it stays between calls.  ``recording`` is that of reversals and perhaps of
    the contact.  The tables have a part for each run: ``steps``, where the run is and
    then the ends of accepted steps; the ``extremes`` of the contact until then, if they
    are recorded; times of ``zeros``; times of ``turns``, which are reversals; and what
    is ``stored`` of the call, in columns ROWS to ACCEPTED.
    """
    widest_vectors()
    count = steps.shape[0]
    used = (count + GROUP - 1) // GROUP * GROUP
    if begins:
        for l in range(problem.lanes):
            if l < count:
                turn.start_run(problem, traits, parts, w, l, l, inputs)
                await_zeros(lane_of(problem, w, l))
            else:
                turn.empty_lane(problem, traits, parts, w, l)
    going = 0
    is_full = False
    for l in range(count):
        stored[l] = 0.0
        lane = lane_of(problem, w, l)
        if lane.run < 0.0:
            stored[l, ENDED] = 1.0
            continue
        going += 1
        store_step(problem, traits, w, l, steps[l], extremes[l], stored[l])
        is_full |= steps.shape[1] == 1
    while going > 0 and not is_full:
        for l in range(count):
            lane = lane_of(problem, w, l)
            stored[l, CROSSED] = lane.t_crossed
            stored[l, REVERSED] = lane.reversals
            lane.n_after = NEVER  # no peak of a turn is searched
        due = turn.try_step(problem, traits, parts, w, options, recording, used, False)
        while due != 0:
            l = lowest_bit(due)
            due &= due - 1
            lane = lane_of(problem, w, l)
            if lane.run < 0.0:
                runs.stay_empty(problem, traits, w, l)
                continue
            most = options.most_steps
            status, move = turn.call_closer(traits, parts, w, l, most, recording)
            stored[l, STATUS] = status
            if status != OK or (move != HOLD and lane.last > 0.0):
                stored[l, ENDED] = 1.0
        for l in range(count):
            lane = lane_of(problem, w, l)
            if lane.run < 0.0:
                continue
            store_events(parts, w, l, lane, zeros[l], turns[l], stored[l])
            stored[l, LAST] = lane.last
            stored[l, ACCEPTED] = lane.accept
            if lane.accept == 0.0:
                runs.hold_back(problem, traits, w, l)
        if traits.limited or recorded(recording.contact):
            turn.watch(problem, traits, parts, w, recording)
        turn.commit(problem, traits, parts, w)
        for l in range(count):
            if lane_of(problem, w, l).run < 0.0:
                continue
            if stored[l, ACCEPTED] > 0.0:
                store_step(problem, traits, w, l, steps[l], extremes[l], stored[l])
            if stored[l, ENDED] > 0.0:
                store_energy(parts, w, l, lane_of(problem, w, l), stored[l])
                turn.empty_lane(problem, traits, parts, w, l)
                going -= 1
                continue
            is_full |= stored[l, ROWS] == steps.shape[1]
            is_full |= stored[l, ZEROS] == zeros.shape[1]
    for l in range(count):
        lane = lane_of(problem, w, l)
        if lane.run >= 0.0:
            store_energy(parts, w, l, lane, stored[l])


@njit(**INNER)
def await_zeros(lane):
    """Let all zeros count from the launch on, and no window end."""
    lane.next = NEVER
    if lane.arm > 0.0:
        lane.arm = 0.0
        lane.sign = 1.0 if lane.rate0 > 0.0 else -1.0
        lane.rate_max = lane.arm_rate


@njit(**INNER)
def store_step(problem, traits, w, l, steps, extremes, stored):
    """Store where the run in a lane is."""
    lane = lane_of(problem, w, l)
    row = int(stored[ROWS])
    steps[row, T] = lane.t
    steps[row, T_LOW] = lane.t_low
    if stored[LAST] > 0.0:
        steps[row, T] = lane.t_end
        steps[row, T_LOW] = 0.0
    if traits.sense != NO_ROW:
        steps[row, SENSE] = w[traits.sense * problem.lanes + l]
    count = traits.n_state
    rate = STATE + count
    runs.read_rows(problem, w, l, traits.y, steps, row, STATE, count)
    runs.read_rows(problem, w, l, traits.f, steps, row, rate, count)
    if traits.slip != NO_ROW:
        slip = rate + count
        runs.read_rows(problem, w, l, traits.slip, steps, row, slip, N_SLIP)
    extremes[row, RATIO_MAX] = lane.ratio_max
    extremes[row, NORMAL_MIN] = lane.normal_min
    stored[ROWS] += 1.0


@njit(**INNER)
def store_events(parts, w, l, lane, zeros, turns, stored):
    """Store the zero and the reversal that a lane has found in the step tried."""
    is_zero = lane.t_crossed != stored[CROSSED]
    is_turn = lane.reversals > stored[REVERSED]
    if (is_zero or is_turn) and lane.dead > 0.0:
        turn.ask(parts, answer.MEASURE, w, l)
    if is_zero and not runs.is_dead(lane):
        zeros[int(stored[ZEROS])] = lane.t_crossed
        stored[ZEROS] += 1.0
    if is_turn and not runs.is_dead(lane):
        turns[int(stored[TURNS])] = lane.t_turn
        stored[TURNS] += 1.0


@njit(**INNER)
def store_energy(parts, w, l, lane, stored):
    """Store the energy of a lane at launch and now."""
    turn.ask(parts, answer.MEASURE, w, l)
    stored[ENERGY_0] = lane.energy0
    stored[ENERGY] = lane.energy1


def states_after(
    problem, traits, given, parts, w, steps, which, offset, run, constants, scale, out
):
    """Write the states a time ``offset`` after rows of ``steps`` to ``out``.

    Each is one step of the method in its own lane.  ``steps`` has the first ``given``
    components of the state; others start at zero, as the workspace does.  ``run`` is
    the row of ``constants``, which are those of a run and then the fastest angular
    frequency of the spin.  The slip is written behind the state if the model slides.
    """
    widest_vectors()
    for l in range(problem.lanes):
        # Lanes that slide try steps of the given sizes.
        lane_of(problem, w, l).search = SCAN
    points = which.size
    for first in range(0, points, problem.lanes):
        for l in range(problem.lanes):
            i = min(first + l, points - 1)
            lane = lane_of(problem, w, l)
            step = which[i]
            runs.fill_constants(problem, traits, w, l, constants, run[i])
            lane.swing = constants[run[i], constants.shape[1] - 1]
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


TABLES = np.zeros((0, 1, 1))  # a table with a part for each run


def steps_recipe() -> Kernel:
    """Return :func:`record_steps`, which serves all models and methods."""
    loop = recipes.problem_of(None), recipes.TRAITS, recipes.NO_PARTS, recipes.FLAT
    run = *loop, recipes.INPUTS, recipes.SETTINGS
    tables = TABLES, TABLES, recipes.TABLE, recipes.TABLE, recipes.TABLE
    return Kernel(record_steps, (*run, recipes.NOTHING, True, *tables), recipes.CALLED)


def states_recipe() -> Kernel:
    """Return :func:`states_after`, which serves all models and methods."""
    model = recipes.problem_of(None), recipes.TRAITS, 1, recipes.NO_PARTS
    points = recipes.TABLE, recipes.WHOLE, recipes.FLAT, recipes.WHOLE
    arguments = *model, recipes.FLAT, *points, recipes.TABLE, 1.0, recipes.TABLE
    return Kernel(states_after, arguments, recipes.CALLED)


def observe_recipe(model_name: str) -> Kernel:
    """Return :func:`observe_samples` of a model."""
    problem = recipes.problem_of(find_model(model_name))
    tables = recipes.TABLE, recipes.TABLE, recipes.TABLE
    arguments = problem, *tables, 1.0, recipes.TABLE
    return Kernel(observe_samples, arguments, recipes.CALLED)


class Loaded(NamedTuple):
    """The kernels that follow runs of one model, in memory."""

    record: Compiled
    after: Compiled
    observe: Compiled
    parts: list[NDArray[Any]]  # addresses, of each model
    kept: tuple[Compiled, ...]  # what lies at these addresses


@cache
def _loaded(
    tableau_name: str, model_names: tuple[str, ...], recorded: Set[str], rimmed: bool
) -> Loaded:
    """Return the kernels for a model, and for its attitude's model if it is named.

    A fit follows thousands of runs, which share them.
    """
    tableau = METHODS[tableau_name]
    models = [find_model(name) for name in model_names]
    record: Order = (steps_recipe,)
    after: Order = (states_recipe,)
    look: Order = (observe_recipe, models[0].name)
    parts: list[list[Order | None]] = []
    for model in models:
        # Nobody asks for the peaks of the spin between reversals, and of the attitude's
        # model single steps are taken (`states_after`).
        steps = model is models[0]
        looked = recorded - {"reversals"} if steps else ()
        own = recipes.parts_of(tableau, model, looked, rimmed=rimmed)
        if not steps:
            own[turn.ANSWER_FOR_ALL] = None
        parts.append(own)
    # Loaded together, so that they are compiled in parallel, like parts one after the
    # other.
    alike = filter(None, chain.from_iterable(zip(*parts, strict=True)))
    orders = [record, after, *alike, look]
    kernels = load_kernels(*orders)
    loaded = dict(zip(orders, kernels, strict=True))
    return Loaded(
        loaded[record],
        loaded[after],
        loaded[look],
        [recipes.addresses(own, loaded) for own in parts],
        tuple(kernels),
    )


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
    energy_0: float  # at launch
    energy: float  # in the last row


class Recorder:
    """Integrates runs of one model side by side in lanes, and stores their steps.

    Of a run with `attitude`, heading and contact point are integrated as well over
    steps that are known.  No more runs than lanes are possible.
    """

    def __init__(
        self,
        batch: Batch,
        tableau: Tableau,
        model: Model,
        settings: batches.BatchSettings,
        *,
        longest_step: Floats | float = np.inf,
        attitude: bool = False,
    ) -> None:
        self.batch = batch
        self.models = [model, model.with_attitude] if attitude else [model]
        self._tableau = tableau
        self._settings = settings
        rimmed = batches.can_reach_rim(batch, model)
        names = tuple(each.name for each in self.models)
        self._loaded = _loaded(tableau.name, names, settings.record, rimmed)
        # No window ends, so no amplitudes are compared.
        count = len(batch)
        never = np.full(count, NEVER)
        endless = replace(batch, window=never, first_comparison=never)
        tol = settings.tol
        dt = settings.dt
        self._runs = (
            recipes.problem_of(None),
            recipes.traits_for(tableau, model, rimmed=rimmed),
            self._loaded.parts[0],
            recipes.workspace(tableau, model, 1)[0],
            batches.inputs_of(endless, tableau, tol, dt, longest_step=longest_step),
            batches.options_of(tableau, tol, dt, settings.max_steps),
            batches.recording_of(count, settings.record),
        )
        # Columns of the table of steps.
        self._width = STATE + 2 * model.n_state + N_SLIP

    def record(self, rows: int, *, begins: bool) -> list[Stretch]:
        """Begin or continue the runs, for a number of rows of the tables of steps."""
        count = len(self.batch)
        steps = np.zeros((count, rows, self._width))
        extremes = np.zeros((count, rows, 2))
        zeros = np.zeros((count, MOST_ZEROS))
        # The first reversal of a call may belong to a zero of the call before.
        turns = np.zeros((count, MOST_ZEROS + 1))
        stored = np.zeros((count, N_STORED))
        tables = steps, extremes, zeros, turns, stored
        self._loaded.record(*self._runs, begins, *tables)
        stretches = []
        for run, row in enumerate(stored):
            n_rows, n_zeros, n_turns = row[:ENDED].astype(int)
            stretch = Stretch(
                steps=steps[run, :n_rows],
                extremes=extremes[run, :n_rows],
                zeros=zeros[run, :n_zeros].tolist(),
                turns=turns[run, :n_turns].tolist(),
                ended=bool(row[ENDED]),
                status=Status(int(row[STATUS])),
                energy_0=float(row[ENERGY_0]),
                energy=float(row[ENERGY]),
            )
            if stretch.ended and stretch.status == Status.OK:
                stretch = replace(stretch, status=self._trusted(run, stretch))
            stretches.append(stretch)
        return stretches

    def _trusted(self, run: int, stretch: Stretch) -> Status:
        """Return the status that a sweep gives to a run that has reached its end."""
        drift = (stretch.energy - stretch.energy_0) / stretch.energy_0
        if not abs(drift) <= runs.MAX_ENERGY_DRIFT:
            if np.isfinite(drift):
                return Status.ENERGY
            return Status.NONFINITE
        relevant = self.batch.relevant[run]
        t_end = float(stretch.steps[-1, T])
        tableau = self._tableau
        dt = self._settings.dt
        if tableau.adaptive or not batches.is_coarse(tableau, dt, relevant, t_end):
            return Status.OK
        return Status.COARSE

    def between(
        self, place: int, table: Floats, which: Integers, offset: Floats, run: Integers
    ) -> tuple[Floats, Floats]:
        """Return states and slips of a model at some times after rows of a table.

        Each is a time `offset` after the row `which` of a table of the run `run`.
        """
        model = self.models[place]
        out = np.zeros((len(which), model.n_state + N_SLIP))
        constants = np.append(self.batch.constants, self.batch.swing[:, None], axis=1)
        self._loaded.after(
            recipes.problem_of(None),
            recipes.traits_for(self._tableau, model),
            self.batch.y0.shape[1],
            self._loaded.parts[place],
            recipes.workspace(self._tableau, model, 1)[0],
            table,
            which.astype(np.int64),
            offset,
            run.astype(np.int64),
            constants,
            1.0 / self._settings.tol**2,
            out,
        )
        return out[:, : model.n_state], out[:, model.n_state :]

    def moves(
        self, table: Floats, which: Integers, offset: Floats, run: Integers
    ) -> Floats:
        """Return the changes of heading and contact point since rows of a table."""
        y, _ = self.between(1, table, which, offset, run)
        return y[:, self.batch.y0.shape[1] :]

    def observe(self, run: int, samples: Samples) -> Floats:
        """Return what samples of a run show, as :meth:`Follower.observe` does."""
        count = len(samples.t)
        out = np.empty((5, count))
        model = self.models[0]
        values = model.named(self.batch.constants[run])
        if "sense" in values:
            values = values | {"sense": samples.sense}
        columns = [np.broadcast_to(values[name], count) for name in model.constants]
        constants = np.stack(columns, axis=1)
        mu = float(values.get("mu", np.inf))
        # The kernel is compiled for arrays without gaps.
        states, slips = map(np.ascontiguousarray, (samples.y, samples.slip))
        problem = recipes.problem_of(model)
        self._loaded.observe(problem, states, slips, constants, mu, out)
        return out
