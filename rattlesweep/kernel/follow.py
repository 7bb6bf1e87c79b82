"""One run followed past its reversals: accepted steps, states at any times, zeros."""

# mypy: disable-error-code="no-untyped-def"
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.kernel import batch as batches
from rattlesweep.kernel.method.tableau import DT, MAX_STEPS, TOL, Tableau
from rattlesweep.kernel.outcome import Batch
from rattlesweep.kernel.recorder import (
    SENSE,
    STATE,
    STEPS_PER_CALL,
    T_LOW,
    Recorder,
    Samples,
    Stretch,
    T,
)
from rattlesweep.kernel.state.status import Status
from rattlesweep.motion import rotations
from rattlesweep.motion.chart import ANYWHERE
from rattlesweep.motion.model import Model

CALLS_AHEAD = 100  # calls whose steps are kept for later, a few hundred kB each

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
        self._longest_step = longest_step
        self._look: Look | None = None
        recorded = {"reversals"}
        if look is not None:
            # The contact is only watched for one who looks.
            recorded.add("contact")
        self._settings = batches.BatchSettings(tol, dt, max_steps, frozenset(recorded))
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
            stretch = self._call(1 + STEPS_PER_CALL, begins=False)
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
        self.constants = model.named(batch.constants[0])
        self._recorder = Recorder(
            batch,
            self._tableau,
            model,
            self._settings,
            longest_step=self._longest_step,
            attitude=attitude,
        )
        # Stretches of the run that are known already.
        self._ahead = deque[Stretch]()
        launch = self._call(1, begins=True)
        self._table = launch.steps
        self._extremes = launch.extremes
        self.energy_0 = launch.energy_0
        self._extra = np.zeros((1, self._recorder.models[-1].n_extra))
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
        return self._recorder.observe(0, samples)

    @property
    def swing(self) -> float:
        """The fastest angular frequency of the spin, in ``sqrt(g/a)``."""
        return float(self._recorder.batch.swing[0])

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
            extra = moved_on(extra, self._moves(which, offset))
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
        y = table[:, STATE : STATE + self._recorder.batch.y0.shape[1]]
        slip = table[:, STATE + 2 * self._recorder.batch.y0.shape[1] :]
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
        return self._recorder.between(
            place, self._table, which, offset, np.zeros_like(which)
        )

    def _moves(self, which: Integers, offset: Floats) -> Floats:
        """Return the changes of heading and contact point since rows of the table."""
        return self._recorder.moves(self._table, which, offset, np.zeros_like(which))

    def _rotations(
        self, which: Integers, offset: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return what :func:`rotations.after` takes, since rows of the table."""
        y, _ = self._between(1, which, offset)
        n_given = self._recorder.batch.y0.shape[1]
        ends = y[:, :n_given]
        starts = self._table[which, STATE : STATE + n_given]
        spins = [
            (state[:, :3] * state[:, 3:6]).sum(axis=1)
            / np.linalg.norm(state[:, :3], axis=1)
            for state in (starts, ends)
        ]
        return y[:, n_given:], ends[:, :3], 0.5 * offset * (spins[0] + spins[1])

    def _call(self, rows: int, *, begins: bool) -> Stretch:
        """Begin or continue the run, for a number of rows of the table of steps."""
        (stretch,) = self._recorder.record(rows, begins=begins)
        return stretch

    def _continue(self) -> None:
        """Go on to the next stretch."""
        if self._ahead:
            stretch = self._ahead.popleft()
        else:
            stretch = self._call(1 + STEPS_PER_CALL, begins=False)
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
            self._extra = added_up(base, moved)
        if self._look is not None:
            samples = self._samples(1, rows)
            self._look(samples, self.observe(samples), stretch.extremes[1:])


def moved_on(extra: Floats, moved: Floats) -> Floats:
    """Return headings and places after moves from each of them.

    The moves are in the frame of the heading at the start of the step.
    """
    turned = _rotated(extra[:, 0], moved[:, 1:])
    return np.concatenate([extra[:, :1] + moved[:, :1], extra[:, 1:] + turned], axis=1)


def added_up(base: Floats, moved: Floats) -> Floats:
    """Return headings and places: `base`, and after each of successive moves."""
    extra = np.repeat(base[None], len(moved) + 1, axis=0)
    extra[1:, 0] = base[0] + np.cumsum(moved[:, 0])
    turned = _rotated(extra[:-1, 0], moved[:, 1:])
    extra[1:, 1:] = base[1:] + np.cumsum(turned, axis=0)
    return extra


def _rotated(heading: Floats, move: Floats) -> Floats:
    """Return moves in the plane, rotated by headings."""
    cosine = np.cos(heading)
    sine = np.sin(heading)
    x = move[:, 0]
    y = move[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
