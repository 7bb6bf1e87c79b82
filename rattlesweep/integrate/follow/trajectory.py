"""One run as a time series: its accepted steps, states at any times, all zeros of its spin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.integrate.batch import MAX_DAMPING, kernel_options, run_plans, stride
from rattlesweep.integrate.defaults import DT, MAX_STEPS, TOL
from rattlesweep.integrate.follow import kernels as follow
from rattlesweep.integrate.lanes import columns as C
from rattlesweep.integrate.lanes.build import workspace
from rattlesweep.integrate.lanes.runs import MAX_ENERGY_DRIFT
from rattlesweep.integrate.model import ATTITUDES
from rattlesweep.integrate.status import Status

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.integrate.batch import Batch
    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau

    Floats = NDArray[np.float64]

STATUSES = tuple(Status)  # by their codes
# Steps between two looks from Python: some milliseconds, so that Ctrl-C is heard.
STEPS_AT_ONCE = 2048


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
        self._counts = np.zeros(follow.N_COUNTS, dtype=np.int64)
        self._zeros = np.zeros(256)
        self._energies = np.zeros(2)
        follow.load_all(tableau.name, model.name, attitude)
        self._record_steps = follow.steps_kernel(tableau.name, model.name)
        # Row 0 is where the last call ended: at first the launch, without any step.
        self._table = np.zeros((1 + STEPS_AT_ONCE, follow.STATE + 2 * model.n_state))
        self._record_steps(*self._state, self._table[:1], self._zeros, self._counts, self._energies)
        self._rows = 1
        self.energy_0 = float(self._energies[0])
        if look is not None:
            look(np.zeros(1), y0)
        self._states = _Between(tableau, model, self._constants[0])
        moving = ATTITUDES[model.name] if attitude else model
        self._attitude = _Between(tableau, moving, self._constants[0]) if attitude else None
        self._extra = np.zeros((1, moving.n_state - model.n_state))

    @property
    def rejected(self) -> int:
        """Steps that were tried and failed."""
        return int(self._counts[follow.REJECTED])

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
            ends = self._table[: self._rows, follow.T]
            upto = int(np.searchsorted(times, ends[-1], side="right"))
            if upto > done:
                part = times[done:upto]
                which = np.maximum(np.searchsorted(ends, part, side="left") - 1, 0)
                offset = (part - ends[which]) + self._table[which, follow.T_LOW]
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
        y = table[:, follow.STATE : follow.STATE + self._model.n_state]
        return Samples(table[:, follow.T].copy(), y.copy(), self._extra[rows].copy())

    def _go_on(self) -> None:
        """Fill the table with the next accepted steps."""
        table, counts = self._table, self._counts
        self._record_steps(*self._state, table, self._zeros, counts, self._energies)
        self._rows = 1 + int(counts[follow.N_STEPS])
        self.n_steps += int(counts[follow.N_STEPS]) * stride(self._tableau)
        self.zeros += self._zeros[: counts[follow.N_ZEROS]].tolist()
        self.t = float(table[self._rows - 1, follow.T])
        self.ended = bool(counts[follow.ENDED])
        self.status = STATUSES[counts[follow.STATUS]]
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
        t, low = table[:rows, follow.T], table[:rows, follow.T_LOW]
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

    def __init__(self, tableau: Tableau, model: Model, constants: Floats) -> None:
        self._constants, self._n_state = constants, model.n_state
        self._w = workspace(tableau, model, 1)[0]
        self._find = follow.states_kernel(tableau.name, model.name)

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
