"""What a block knows of its runs when they have ended: records, and what follows.

The columns of `runs` (:mod:`rattlesweep.rows.columns`) are functions of
:class:`Results`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.config.schema import Config
from rattlesweep.kernel import growths
from rattlesweep.kernel.look.casimir import MEANS, RANGE
from rattlesweep.kernel.outcome import Batch, Estimated, Outcome, has_settled
from rattlesweep.kernel.state.fields import MOST_REVERSALS
from rattlesweep.kernel.state.status import Status
from rattlesweep.motion.model import Model, find_model, reduced_model
from rattlesweep.physics import full, steady
from rattlesweep.physics.chaos import is_chaotic
from rattlesweep.physics.theory import (
    creeping_coefficients,
    damping_rates,
    slip_thresholds,
    unsteady,
)
from rattlesweep.rows import regimes
from rattlesweep.rows.arrow import Words, ragged
from rattlesweep.rows.prepared import Bodies, PreparedRuns
from rattlesweep.rows.types import (
    TYPES,
    classify,
    is_held_at_end,
    living,
    slowed_by_friction,
    sure_types,
)
from rattlesweep.words.names import REGIMES

STATUS_WORDS = [status.label for status in Status]


@dataclass(frozen=True)
class ClosedForm:
    """What Garcia and Hubbard's theory says of runs, by the names of an `Outcome`."""

    t_end: Floats
    t_r: Floats
    n_end: Floats
    energy_drift: Floats
    amp_growth: Floats
    n_departure: Floats
    status: Integers
    n_steps: Integers
    near_tangencies: Integers


class InitialStates(NamedTuple):
    """Components of full initial states along the bodies' axes."""

    omega_x: Floats
    omega_y: Floats
    omega_z: Floats
    u_x: Floats
    u_y: Floats
    u_z: Floats


def closed_form(launches: PreparedRuns) -> ClosedForm:
    """Return the results of runs by the closed form, which has no steps."""
    t_rgh = launches.gh.t_rgh
    has_horizon = np.isfinite(launches.horizon)
    reverses = has_horizon & (t_rgh <= launches.horizon)
    t_end = np.where(has_horizon, launches.horizon, 0.0)
    t_end = np.where(reverses, t_rgh, t_end)
    n_end = np.where(reverses, 0.0, launches.gh.spin(t_end))
    none = np.zeros(len(t_end), dtype=np.int64)
    return ClosedForm(
        t_end=t_end,
        t_r=np.where(reverses, t_rgh, np.nan),
        n_end=np.where(has_horizon, n_end, np.nan),
        energy_drift=np.where(has_horizon, 0.0, np.nan),
        # An unknown growth rules out SS: here the relevant oscillation only grows.
        amp_growth=np.full(len(t_end), np.nan),
        n_departure=np.where(has_horizon, 1 - n_end / launches.n_i, np.nan),
        status=np.where(has_horizon, Status.OK, Status.NO_HORIZON),
        n_steps=none,
        near_tangencies=none,
    )


@dataclass(frozen=True)
class Results:
    """Runs with their results, and what follows from these."""

    config: Config
    launches: PreparedRuns
    batch: Batch | None
    outcome: Outcome | ClosedForm

    @property
    def bodies(self) -> Bodies:
        """The bodies of the runs."""
        return self.launches.bodies

    @property
    def integrated(self) -> Outcome:
        """The outcome of an integration, for columns that the closed form lacks."""
        assert isinstance(self.outcome, Outcome)
        return self.outcome

    @property
    def estimated(self) -> Estimated:
        """The outcome with errors, for columns of `record: [error]`."""
        assert isinstance(self.outcome, Estimated)
        return self.outcome

    @property
    def window(self) -> Floats:
        """Length of one window."""
        assert self.batch is not None
        return self.batch.window

    @cached_property
    def is_ok(self) -> Flags:
        """Whether the integration of a run succeeded."""
        return self.outcome.status == Status.OK

    @property
    def status(self) -> Words:
        """Index of the status of each run, and the words."""
        return self.outcome.status, STATUS_WORDS

    # ------------------------------------------------------------------ types

    @cached_property
    def type_codes(self) -> NDArray[np.int8]:
        """Index of the type of each run, -1 without one."""
        return classify(
            self.is_ok,
            self.outcome.t_r,
            self.outcome.amp_growth,
            self.outcome.n_departure,
            self.config.classify,
            self._energy_for_life if self.config.dissipation else None,
            self._is_held,
            self._slowed,
        )

    @property
    def _energy_for_life(self) -> Floats:
        """The energy that is left, which tells the dead if the plane is at rest."""
        return living(self.energy_left, self.launches.losses.get("base_acceleration"))

    @property
    def _slowed(self) -> Floats | None:
        """What friction takes of a spin without oscillation, None without it."""
        losses = self.launches.losses
        if not self.config.dissipation:
            return None
        return slowed_by_friction(
            self.outcome.t_end, self.launches.n_i, self.bodies.gamma, losses
        )

    @property
    def _is_held(self) -> Flags | None:
        """Whether the spin is held at the end, None without pivoting friction."""
        if not self.config.dissipation.pivots:
            return None
        return is_held_at_end(self.integrated.t_held, self.integrated.n_end)

    @property
    def type(self) -> Words:
        """Index of the type of each run, and the words."""
        return self.type_codes, TYPES

    @property
    def type_sure(self) -> pa.Array:
        """Whether the type is the same within the errors."""
        outcome = self.estimated
        is_sure = sure_types(
            self.type_codes,
            outcome.reversal_sure,
            (outcome.amp_growth, outcome.n_departure),
            (outcome.amp_growth_error, outcome.n_departure_error),
            self.config.classify,
            self._slowed,
        )
        return pa.array(is_sure, mask=self.type_codes < 0)

    # ------------------------------------------------------ spins and energies

    @property
    def n_end(self) -> Floats:
        """Spin at the end; where a run has settled, the spin with all of its energy."""
        if self.batch is None or not self.config.classify.early:
            return self.outcome.n_end
        outcome = self.integrated
        limit = np.sqrt(2 * outcome.energy_0 / self.bodies.gamma)
        settled = has_settled(self.batch, outcome)
        return np.where(settled, np.copysign(limit, self.launches.n_i), outcome.n_end)

    @property
    def energy_left(self) -> Floats:
        """Fraction of the initial energy that is left."""
        left = np.ones(len(self.integrated.energy_0))
        if self.config.acting.does_work:
            work = self.integrated.y_end[:, self._model.column("work")]
            left = 1 + work / self.integrated.energy_0
        if self.config.dissipation.slides:
            left = left - self.integrated.slide_work
        return left

    @property
    def base_work(self) -> Floats:
        """Work of the plane that shakes, over the initial energy."""
        return 0.0 - self._work_of("base work")

    @cached_property
    def _model(self) -> Model:
        """The equations that were integrated."""
        if self.config.model == "reduced":
            return reduced_model(self.launches.losses)
        return find_model(self.launches.full_model)

    def _work_of(self, component: str) -> Floats:
        """Work that a component of the state counts, over the initial energy."""
        work = self.integrated.y_end[:, self._model.column(component)]
        # Zero and not -0 for a run without it.
        return 0.0 - work / self.integrated.energy_0

    @property
    def creep_work(self) -> Floats:
        """Energy lost by the drift of the contact point, over the initial energy."""
        return self._work_of("creep work")

    @property
    def creep_doubtful(self) -> Floats:
        """Share of it that is lost where the law is in doubt, NaN without creep."""
        lost = self.creep_work
        share = np.full(len(lost), np.nan)
        if self.config.model == "reduced":
            # Its force is an average.
            return share
        np.divide(self._work_of("doubtful work"), lost, out=share, where=lost > 0)
        return share

    @cached_property
    def creeping(self) -> tuple[Floats, Floats]:
        """The coefficients of pitch and roll with creep, NaN without."""
        losses = self.launches.losses
        none = np.zeros(len(self.bodies.alpha))
        return creeping_coefficients(
            self.bodies.alpha,
            self.bodies.beta,
            self.launches.modes,
            losses.get("pivot", none),
            losses["creep"],
        )

    @property
    def K_p_creep(self) -> Floats:
        """Coefficient of pitch with creep."""
        pitch, _ = self.creeping
        return pitch

    @property
    def K_r_creep(self) -> Floats:
        """Coefficient of roll with creep."""
        _, roll = self.creeping
        return roll

    @property
    def slip_work(self) -> Floats:
        """Energy lost by viscous slip, over the initial energy."""
        return self._work_of("slip work")

    @cached_property
    def _slip_thresholds(self) -> tuple[Floats, Floats]:
        return slip_thresholds(
            self.bodies.alpha,
            self.bodies.beta,
            self.launches.modes,
            self.launches.losses["viscous"],
        )

    @property
    def n_p(self) -> Floats:
        """Spin above which the pitch grows against viscous slip."""
        pitch, _ = self._slip_thresholds
        return pitch

    @property
    def n_r(self) -> Floats:
        """Minus the spin below which the roll grows against viscous slip."""
        _, roll = self._slip_thresholds
        return roll

    @property
    def growth(self) -> Floats:
        """Growth rate of the relevant mode, where friction is linear."""
        bodies = self.bodies
        body_constants = full.constants(
            *(bodies.alpha, bodies.beta, bodies.gamma),
            *(bodies.theta, bodies.phi, bodies.xi),
        )
        pitch_rate, roll_rate = steady.growth(
            body_constants, self.launches.n_i, self.launches.losses["sigma"]
        )
        return self._if_linear(np.where(self._pitch_grows, pitch_rate, roll_rate))

    @property
    def n_growth(self) -> Floats:
        """Spin at which the growth of the relevant mode balances its damping."""
        pitch_loss, roll_loss = damping_rates(
            self.bodies.alpha,
            self.bodies.beta,
            self.launches.modes,
            self.launches.losses["sigma"],
        )
        loss = np.where(self._pitch_grows, pitch_loss, roll_loss)
        direction = np.sign(self.launches.n_i)
        return self._if_linear(direction * 2 * loss / np.abs(self.launches.gh.K))

    @property
    def _pitch_grows(self) -> Flags:
        return unsteady(self.launches.modes.K_p, self.launches.n_i)

    def _if_linear(self, values: Floats) -> Floats:
        return np.where(self.launches.has_linear_rate, values, np.nan)

    # ---------------------------------------------------- launches and SI units

    @cached_property
    def state(self) -> InitialStates:
        """Full initial states."""
        assert self.bodies.omega is not None
        assert self.bodies.u is not None
        return InitialStates(*self.bodies.omega.T, *self.bodies.u.T)

    @property
    def _second(self) -> Floats:
        """The unit of time in seconds."""
        assert self.bodies.units is not None
        return self.bodies.units.time

    @property
    def n_i_rpm(self) -> Floats:
        """Initial spin in turns a minute."""
        return self.launches.n_i / self._second * 30 / np.pi

    @property
    def t_r_s(self) -> Floats:
        """Reversal time in seconds."""
        return self.outcome.t_r * self._second

    # ------------------------------------------------------------ `record` keys

    @cached_property
    def exponents(self) -> tuple[Floats, Floats]:
        """Lyapunov exponents of the whole run, and of its second half."""
        return growths.exponents(self.integrated.lyapunov)

    @property
    def lyapunov(self) -> Floats:
        """Largest Lyapunov exponent of the whole run."""
        whole, _ = self.exponents
        return whole[:, 0]

    @property
    def lyapunov_late(self) -> Floats:
        """Largest Lyapunov exponent of the second half."""
        _, late = self.exponents
        return late[:, 0]

    @property
    def chaotic(self) -> pa.Array:
        """Whether differences grew by more than `chaos.LEAST_GROWTH` in that half."""
        _, late = self.exponents
        largest = late.max(axis=1)
        flags = is_chaotic(largest, self.outcome.t_end)
        return pa.array(flags, mask=~np.isfinite(largest))

    @property
    def lyapunov_spectrum(self) -> pa.Array:
        """Lyapunov exponents of the whole run, in descending order."""
        whole, _ = self.exponents
        return _descending(whole)

    @property
    def lyapunov_spectrum_late(self) -> pa.Array:
        """Lyapunov exponents of the second half, in descending order."""
        _, late = self.exponents
        return _descending(late)

    @cached_property
    def _level(self) -> Floats:
        """Significant late exponents at constant energy."""
        _, late = self.exponents
        # The last exponent is that of the energy.
        return regimes.significant(late[:, :-1], self.outcome.t_end)

    @property
    def kaplan_yorke(self) -> Floats:
        """Dimension of Kaplan and Yorke."""
        return regimes.kaplan_yorke(self._level)

    @property
    def regime(self) -> Words:
        """Index of the regime of each run, and the words."""
        third, last = growths.late_growths(self.integrated.lyapunov)
        # The last exponent is that of the energy.
        return regimes.regime_codes(third[:, :-1], last[:, :-1]), REGIMES

    @property
    def window_amplitude(self) -> pa.Array:
        """Largest amplitude in each window."""
        return self._by_window(0)

    @property
    def window_n_min(self) -> pa.Array:
        """Smallest spin in each window."""
        return self._by_window(1)

    @property
    def window_n_max(self) -> pa.Array:
        """Largest spin in each window."""
        return self._by_window(2)

    @cached_property
    def _casimir(self) -> Floats:
        """Range and means of the Casimir invariant, shape (runs, 10, 2)."""
        values = self.integrated.casimir
        if self.config.model == "reduced":
            return values
        # The weights in the kernel are inverse squared frequencies.
        modes = self.launches.modes
        scale = modes.omega_p**2 / modes.K_p
        return scale[:, None, None] * values

    @property
    def casimir_min(self) -> Floats:
        """Least Casimir invariant; in mirrored bodies it has the other sign."""
        return self._casimir[:, RANGE].min(axis=1)

    @property
    def casimir_max(self) -> Floats:
        """Largest Casimir invariant."""
        return self._casimir[:, RANGE].max(axis=1)

    @property
    def casimir_jumps(self) -> pa.Array:
        """Changes of the mean Casimir invariant at the first turns."""
        return self._by_turn(np.diff(self._casimir[:, MEANS:, 0], axis=1))

    def _by_window(self, number: int) -> pa.Array:
        windows = self.integrated.windows
        is_filled = np.isfinite(windows[:, :, 0])
        return ragged(windows[:, :, number], is_filled.sum(axis=1))

    @property
    def n_turns(self) -> pa.Array:
        """Number of turns, null for a run that failed."""
        return pa.array(self.integrated.n_turns.astype(np.int32), mask=~self.is_ok)

    @property
    def turn_times(self) -> pa.Array:
        """Times of the first turns."""
        return self._by_turn(self.integrated.reversals[:, :, 0])

    @property
    def spin_after_turn(self) -> pa.Array:
        """Largest absolute spins after the first turns."""
        return self._by_turn(self.integrated.reversals[:, :, 1])

    @property
    def reversals_sure(self) -> pa.Array:
        """Number of first turns with a small error."""
        return pa.array(self.estimated.turns_sure.astype(np.int32), mask=~self.is_ok)

    @property
    def reversal_times_error(self) -> pa.Array:
        """Errors of the times of the first turns."""
        return self._by_turn(self.estimated.turn_errors)

    def _by_turn(self, values: Floats) -> pa.Array:
        stored_turns = np.minimum(self.integrated.n_turns, MOST_REVERSALS)
        return ragged(values, np.where(self.is_ok, stored_turns, -1))


def _descending(exponents: Floats) -> pa.Array:
    is_known = np.isfinite(exponents).all(axis=1)
    counts = np.where(is_known, exponents.shape[1], -1)
    return ragged(-np.sort(-exponents, axis=1), counts)
