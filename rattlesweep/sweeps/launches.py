"""Runs of a block before integration: bodies, launch, theory, horizon."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import N_WINDOWS, Batch
from rattlesweep.integrate.model import ELLIPSOID, FRICTION, FULL, MODELS, Model
from rattlesweep.physics import full, launch, reduced, stone, theory
from rattlesweep.physics.steady import settled_oscillation, steady_modes
from rattlesweep.sweeps.bodies.sources import Bodies
from rattlesweep.sweeps.columns import MEASURED
from rattlesweep.sweeps.config.schema import Config, Horizon
from rattlesweep.sweeps.plan import Plan

if TYPE_CHECKING:
    from rattlesweep.sweeps.bodies.measured import Measured

# A window is at least this many periods of the slower mode, so that it holds its largest
# amplitude; see the evidence in docs/types.md.
WINDOW_PERIODS = 2.0
# Within the first window, amplitudes are compared first after this many periods.
MARK_PERIODS = 8.0
# A mode counts as one that decays if its amplitude falls by this share by the horizon.
LEAST_DECAY = 0.01
# Up to this share from the initial spin its probes tell pitch from roll well enough for that.
MOST_APART = 0.02


@dataclass(frozen=True)
class Launches:
    """Runs that are ready to go; arrays over runs.

    `gh` is the spin as Garcia and Hubbard have it; `t_end` the horizon, not finite where it cannot
    be told; `second` the unit of time in seconds, None where it is not stored; `carried` columns
    that the runs get from a table. `sigma` and `rolling` are None in a sweep without dissipation.
    """

    case: Integers
    sample: Integers
    bodies: Bodies
    n_i: Floats
    omega_xy0: Floats
    psi: Floats
    modes: theory.Modes
    gh: launch.GarciaHubbard
    n_c1: Floats
    t_end: Floats
    second: Floats | None = None
    carried: dict[str, NDArray[Any]] = field(default_factory=dict)
    sigma: Floats | None = None
    rolling: Floats | None = None

    @property
    def tapped(self) -> Flags:
        """Which are launched without spin."""
        return np.equal(self.n_i, 0.0)

    @property
    def spin_scale(self) -> Floats:
        """What later spins are measured by: that of the launch, without one ``n_0``."""
        return np.where(self.tapped, self.gh.n_0, np.abs(self.n_i))


def prepare(plan: Plan, case: Integers, sample: Integers) -> Launches:
    """Bodies, launches, theory and horizons of runs, in any order."""
    bodies = plan.source.bodies(plan.targets[case], sample)
    spin, state = plan.config.spin, plan.config.launch
    if state is not None and bodies.n_i is None:
        omega, u = (np.tile(x, (len(sample), 1)) for x in (state.omega, state.u))
        n_i, omega_xy0, psi = launch.spin_and_oscillation(omega, u)
        bodies = replace(bodies, n_i=n_i, omega_xy0=omega_xy0, psi=psi, omega=omega, u=u)

    def told(name: str) -> Floats:
        """What the runs' rows in a table say, or else their cases."""
        own: Floats | None = getattr(bodies, name)
        return np.array([getattr(c, name) for c in plan.cases], float)[case] if own is None else own

    n_i, omega_xy0 = told("n_i"), told("omega_xy0")
    modes = theory.modes(bodies.alpha, bodies.beta, bodies.theta, bodies.phi, bodies.xi)
    if bodies.psi is not None:
        psi = bodies.psi
    else:
        psi = launch.direction(modes, n_i, spin.psi if spin is not None else "relevant")
    horizon = plan.config.horizon
    losses = (told("sigma"), told("rolling")) if plan.config.dissipation else None
    found = with_theory(case, sample, bodies, n_i, omega_xy0, psi, modes, horizon, losses)
    measured: Measured | None = getattr(plan.source, "measured", None)
    if measured is None:
        return found
    names = {field.name for field in plan.extra}
    carried = {name: of[sample] for name, of in measured.carried.items() if name in names}
    second = measured.second if MEASURED[0].name in names else None
    return replace(found, carried=carried, second=None if second is None else second[sample])


def with_theory(
    case: Integers,
    sample: Integers,
    bodies: Bodies,
    n_i: Floats,
    omega_xy0: Floats,
    psi: Floats,
    modes: theory.Modes,
    horizon: Horizon,
    losses: tuple[Floats, Floats] | None = None,
) -> Launches:
    """Launches with what theory says of them; `losses` are ``sigma`` and ``rolling``."""
    gh = launch.garcia_hubbard(bodies, modes, n_i, omega_xy0, psi)
    if bodies.omega is not None and bodies.u is not None:
        # The tilt has energy too.
        gh = replace(gh, speed=_oscillation_speed(bodies, n_i, bodies.omega, bodies.u))
    n_c1 = theory.bondi_threshold(bodies.alpha, bodies.beta, bodies.gamma, bodies.theta, bodies.phi)
    sigma, rolling = losses or (None, None)
    if sigma is not None and rolling is not None:
        # No spin stays beyond a threshold that dies.
        n_c1 = np.where((sigma > 0) | (rolling > 0), np.nan, n_c1)
    t_end = np.full(len(n_i), np.inf)
    if horizon.t_rgh is not None:
        # Without t_rGH, which is NaN, the other counts.
        t_end = np.fmin(t_end, horizon.t_rgh * gh.t_rgh)
    if horizon.t is not None:
        t_end = np.minimum(t_end, horizon.t)
    if horizon.t_decay is not None and sigma is not None:
        with np.errstate(divide="ignore"):
            t_end = np.minimum(t_end, horizon.t_decay * bodies.gamma / sigma)
    if bodies.t_end is not None:
        t_end = np.where(np.isfinite(bodies.t_end), bodies.t_end, t_end)
    return Launches(
        case=case,
        sample=sample,
        bodies=bodies,
        n_i=n_i,
        omega_xy0=omega_xy0,
        psi=psi,
        modes=modes,
        gh=gh,
        # Mirrored bodies spin steadily with n > 0.
        n_c1=np.where(bodies.xi > 0, -n_c1, n_c1),
        t_end=t_end,
        sigma=sigma,
        rolling=rolling,
    )


def _oscillation_speed(bodies: Bodies, n_i: Floats, omega: Floats, u: Floats) -> Floats:
    """As :func:`rattlesweep.physics.theory.oscillation_speed`, of full states."""
    b = bodies
    ix, iy, iz, *c = full.constants(b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi)
    p, q, x, y, _ = full.from_vectors(u.T, (omega - n_i[:, None] * u).T)
    speed: Floats = np.sqrt(full.oscillation.py_func(p, q, x, y, ix, iy, *c) / iz)
    return speed


def model_of(config: Config) -> Model:
    """The equations that a sweep integrates; the closed form has none."""
    if config.model != "full":
        return MODELS[config.model]
    surface = ELLIPSOID if config.bodies.ellipsoidal else FULL
    kind = config.dissipation.kind
    return FRICTION[surface.name, kind] if kind else surface


def make_batch(launches: Launches, model: str) -> Batch | None:
    """Batch for a model; None for the closed form, of which nothing is integrated."""
    if model == "gh":
        return None
    return reduced_batch(launches) if model == "reduced" else full_batch(launches)


def ending_early(batch: Batch, launches: Launches) -> Batch:
    """A batch of the full dynamics whose runs end as soon as they are certain to be of type SS."""
    n_0 = np.copysign(launches.gh.n_0, launches.n_i)
    rate = LEAST_DECAY / launches.t_end
    settled = settled_oscillation(batch.constants.T, n_0, launches.n_c1, rate)
    near = np.abs(n_0) <= (1 + MOST_APART) * np.abs(launches.n_i)
    return replace(batch, settled=np.where(near, settled, 0.0))


def full_batch(launches: Launches) -> Batch:
    """Batch for the full dynamics."""
    b = launches.bodies
    if b.omega is None or b.u is None:
        y0 = launch.full_state(launches.n_i, launches.omega_xy0, launches.psi)
    else:
        y0 = np.ascontiguousarray(full.from_vectors(b.u.T, b.omega.T).T)
    constants = full.constants(b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi)
    sigma, rolling = launches.sigma, launches.rolling
    modes = steady_modes(constants, launches.n_i, 0.0 if sigma is None else sigma)
    pitch = theory.unsteady(launches.modes.K_p, launches.n_i)
    probe = np.where(pitch[:, None], modes.pitch_probe, modes.roll_probe)
    # The spin swings at twice the oscillation's frequency.
    fastest = np.maximum(np.abs(modes.pitch.imag), launches.modes.omega_p)
    slower = np.where(modes.roll.imag > 0, modes.roll.imag, launches.modes.omega_r)
    more = []
    if b.c is not None or sigma is not None:
        more = [np.broadcast_to(stone.inverse_semi_axis(b.c), len(y0))]
    if sigma is not None and rolling is not None:
        more += [sigma, rolling, np.full(len(y0), stone.SMOOTHING)]
        # Behind the state the work, none yet.
        y0 = np.concatenate([y0, np.zeros((len(y0), 1))], axis=1)
    oscillation = b.gamma * (launches.gh.n_0**2 - launches.n_i**2)
    return Batch(
        y0=y0,
        constants=np.stack([*constants, *more], axis=1),
        probe=np.concatenate([probe.real, probe.imag], axis=1),
        t_end=launches.t_end,
        swing=2 * fastest,
        relevant=np.abs(np.where(pitch, modes.pitch.imag, modes.roll.imag)),
        rate=2 * fastest * oscillation / b.gamma,
        window=_windows(launches.t_end, slower),
        first_mark=MARK_PERIODS * 2 * np.pi / slower,
        scale=launches.spin_scale,
        tapped=launches.tapped,
    )


def reduced_batch(launches: Launches) -> Batch:
    """Batch for the reduced dynamics; ``I_eff = I_zz`` as in Eq. def-n0."""
    b, m = launches.bodies, launches.modes
    e_p, e_r = reduced.mode_energies(
        b.alpha, b.beta, m.psi_p, m.psi_r, launches.omega_xy0, launches.psi
    )
    pitch = theory.unsteady(m.K_p, launches.n_i)
    n_0 = launches.gh.n_0
    rate = np.maximum(np.abs(m.K_p), np.abs(m.K_r)) * n_0
    return Batch(
        y0=np.stack([launches.n_i, e_p, e_r], axis=1),
        constants=np.stack([m.K_p, m.K_r, b.gamma], axis=1),
        probe=np.stack([pitch, ~pitch], axis=1).astype(float),
        t_end=launches.t_end,
        swing=rate,
        relevant=np.zeros(len(rate)),
        rate=rate * n_0,
        window=_windows(launches.t_end, np.full(len(rate), np.inf)),
        first_mark=launches.t_end,
        scale=launches.spin_scale,
        tapped=launches.tapped,
    )


def with_energies(batch: Batch, e_p0: float | None, e_r0: float | None) -> Batch:
    """A batch of the reduced model with other energies of the launch, where they are given."""
    y0 = batch.y0.copy()
    for column, name, value in ((1, "e_p0", e_p0), (2, "e_r0", e_r0)):
        if value is None:
            continue
        if not (math.isfinite(value) and value >= 0):
            raise ConfigError(f"{name} {value:g}: the energy must be finite and not negative")
        y0[:, column] = value
    return replace(batch, y0=y0)


def _windows(t_end: Floats, slower: Floats) -> Floats:
    """Lengths of windows: the horizon in equal parts, but none shorter than a few periods."""
    # Not t_end / period: the reduced model has no oscillation, and so an infinite frequency here.
    parts = np.clip(np.floor(t_end * slower / (WINDOW_PERIODS * 2 * np.pi)), 1, N_WINDOWS)
    return np.where(np.isfinite(t_end), t_end / parts, 1.0)
