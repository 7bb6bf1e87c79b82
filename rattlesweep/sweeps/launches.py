"""Runs before their integration: bodies, launches, theory, horizons, and the kernel's batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import N_WINDOWS, Batch
from rattlesweep.integrate.model import ELLIPSOID, FRICTION, FULL, MODELS, Model
from rattlesweep.physics import full, reduced, stone, theory
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.steady import settled_oscillation, steady_modes
from rattlesweep.sweeps.bodies import Bodies
from rattlesweep.sweeps.bodies.sources import GridBodies
from rattlesweep.sweeps.bodies.table import TableBodies
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.config.schema import MAX_SPEED, Config, Horizon
from rattlesweep.sweeps.plan import Plan, make_plan
from rattlesweep.units import Quantity

WINDOW_PERIODS = 2.0  # of the slower mode in a window at least; see the evidence in docs/types.md
MARK_PERIODS = 8.0  # after which amplitudes are compared for the first time
LEAST_DECAY = 0.01  # fall of its amplitude until the horizon by which a mode counts as decaying
MOST_APART = 0.02  # change of the spin up to which its first probes tell pitch from roll


@dataclass(frozen=True)
class Launches:
    """Runs that are ready to be integrated; all arrays have one entry a run.

    A launch has the spin `n_i` and an oscillation of size `omega_xy0` in the direction `psi`.
    `modes` are those without spin, `gh` is Garcia and Hubbard's spin, `n_0` the spin that would
    hold all the energy, `n_c1` Bondi's threshold (NaN: none), `t_end` the horizon (not finite:
    none), `dead` the share of the launch's energy below which a body is dead.  `sigma`, `rolling`
    and `dead` are None in a sweep without dissipation.
    """

    case: Integers
    sample: Integers
    bodies: Bodies
    n_i: Floats
    omega_xy0: Floats
    psi: Floats
    modes: theory.Modes
    gh: theory.GarciaHubbard
    n_0: Floats
    n_c1: Floats
    t_end: Floats
    sigma: Floats | None = None
    rolling: Floats | None = None
    dead: Floats | None = None

    @property
    def spin_scale(self) -> Floats:
        """Spin that later spins are compared with: that of the launch, or ``n_0`` without one."""
        return np.where(self.n_i == 0, self.n_0, np.abs(self.n_i))


def prepare(plan: Plan, case: Integers, sample: Integers) -> Launches:
    """Return the launches of some runs, given by their keys in any order."""
    config, bodies = plan.config, plan.source.bodies(plan.targets[case], sample)
    if (state := config.launch) is not None and bodies.n_i is None:
        omega, u = (np.tile(x, (len(sample), 1)) for x in (state.omega, state.u))
        n_i, omega_xy0, psi = theory.spin_and_oscillation(omega, u)
        bodies = replace(bodies, n_i=n_i, omega_xy0=omega_xy0, psi=psi, omega=omega, u=u)

    def value(name: str) -> Floats:
        """Return what rows of a table say, or the config of all bodies, or else each case."""
        own: Floats | None = getattr(bodies, name)
        if own is None and name in config.in_si and getattr(plan.cases[0], name) is None:
            own = _natural(config.in_si[name][0], bodies)
        return np.array([getattr(c, name) for c in plan.cases], float)[case] if own is None else own

    n_i, omega_xy0 = value("n_i"), value("omega_xy0")
    modes = theory.modes(bodies.alpha, bodies.beta, bodies.theta, bodies.phi, bodies.xi)
    way = config.spin.psi if config.spin else "relevant"
    psi = theory.direction(modes, n_i, way) if bodies.psi is None else bodies.psi
    losses = (value("sigma"), value("rolling")) if config.dissipation else None
    launches = with_theory(case, sample, bodies, n_i, omega_xy0, psi, modes, config.horizon, losses)
    if losses is None:
        return launches
    return replace(launches, dead=np.full(len(sample), config.classify.dead_energy))


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
    """Return launches with their columns of theory; `losses` are ``sigma`` and ``rolling``."""
    b = bodies
    gh = theory.garcia_hubbard(b, modes, n_i, omega_xy0, psi)
    n_0 = gh.n_0
    if b.omega is not None and b.u is not None:
        ix, iy, iz, *curvature = full.constants(b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi)
        # The oscillation has the energy of the tilt too, here to second order.
        p, q, x, y, _ = full.from_vectors(b.u.T, (b.omega - n_i[:, None] * b.u).T)
        speed = np.sqrt(full.oscillation.py_func(p, q, x, y, ix, iy, *curvature) / iz)
        gh = replace(gh, speed=speed)
        n_0 = np.sqrt(2 * _energy(b, b.omega, b.u) / b.gamma)
    n_c1 = theory.bondi_threshold(b.alpha, b.beta, b.gamma, b.theta, b.phi)
    sigma, rolling = losses or (None, None)
    if sigma is not None and rolling is not None:
        # No spin stays above a threshold while it decays.
        n_c1 = np.where((sigma > 0) | (rolling > 0), np.nan, n_c1)
    n_c1 = np.where(b.xi > 0, -n_c1, n_c1)  # mirrored bodies spin steadily with n > 0
    t_end = np.full(len(n_i), np.inf)
    if horizon.t_rgh is not None:
        # A launch without t_rGH, which is NaN, has the others.
        t_end = np.fmin(t_end, horizon.t_rgh * gh.t_rgh)
    if horizon.t is not None:
        in_si = isinstance(horizon.t, Quantity)
        t_end = np.minimum(t_end, _natural(horizon.t, b) if in_si else horizon.t)
    if horizon.t_decay is not None and sigma is not None:
        with np.errstate(divide="ignore"):
            t_end = np.minimum(t_end, horizon.t_decay * b.gamma / sigma)
    if b.t_end is not None:
        t_end = np.where(np.isfinite(b.t_end), b.t_end, t_end)
    return Launches(
        case, sample, bodies, n_i, omega_xy0, psi, modes, gh, n_0, n_c1, t_end, sigma, rolling
    )


def _natural(value: Quantity, bodies: Bodies) -> Floats:
    """Return a value in the units of each body."""
    assert bodies.scale is not None
    return bodies.scale.natural(value, value.kind)


def _energy(bodies: Bodies, omega: Floats, u: Floats) -> Floats:
    """Return the energies of full states, above that of a body upright and at rest."""
    b = bodies
    constants = full.constants(b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi)
    # An ellipsoid with an infinite semi-axis is a paraboloid.
    energy = np.vectorize(stone.energy.py_func, otypes=[float])
    state = full.from_vectors(u.T, omega.T)
    return np.asarray(energy(*state, *constants, stone.inverse_semi_axis(b.c)))


def model_of(config: Config) -> Model:
    """Return the equations that a sweep integrates; the closed form has none."""
    if config.model != "full":
        return MODELS[config.model]
    surface = ELLIPSOID if config.bodies.ellipsoidal else FULL
    kind = config.dissipation.kind
    return FRICTION[surface.name, kind] if kind else surface


def make_batch(launches: Launches, model: str) -> Batch | None:
    """Return the batch of a model; None for the closed form, which needs no integration."""
    make = {"full": full_batch, "reduced": reduced_batch}.get(model)
    return None if make is None else make(launches)


def ending_early(batch: Batch, launches: Launches) -> Batch:
    """Return a batch of the full dynamics whose runs end once they are certain to be of type SS."""
    n_0 = np.copysign(launches.n_0, launches.n_i)
    rate = LEAST_DECAY / launches.t_end
    settled = settled_oscillation(batch.constants.T, n_0, launches.n_c1, rate)
    near = np.abs(n_0) <= (1 + MOST_APART) * np.abs(launches.n_i)
    return replace(batch, settled=np.where(near, settled, 0.0))


def full_batch(launches: Launches) -> Batch:
    """Return the batch for the full dynamics."""
    b = launches.bodies
    if b.omega is None or b.u is None:
        y0 = theory.full_state(launches.n_i, launches.omega_xy0, launches.psi)
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
        # The last component of the state is the work, none yet.
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
        tapped=launches.n_i == 0,
        dead=np.zeros(0) if launches.dead is None else launches.dead,
    )


def reduced_batch(launches: Launches) -> Batch:
    """Return the batch for the reduced dynamics; ``I_eff = I_zz`` as in Eq. def-n0."""
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
        tapped=launches.n_i == 0,
    )


def _windows(t_end: Floats, slower: Floats) -> Floats:
    """Return the lengths of windows: equal parts of the horizon of at least a few periods each."""
    # Not t_end / period: the reduced model has no oscillation, and so an infinite frequency here.
    parts = np.clip(np.floor(t_end * slower / (WINDOW_PERIODS * 2 * np.pi)), 1, N_WINDOWS)
    return np.where(np.isfinite(t_end), t_end / parts, 1.0)


@dataclass(frozen=True)
class Launch:
    """One run as a user asks for it, in the words of a config.

    The launch is `n_i` and `omega_xy0`, or the full state `omega` and `u` (None: upright), with
    components along the body's axes.  Without `t_end` the horizon is 5 t_rGH of the spin's own
    direction.  `e_p0` and `e_r0` are initial energies of pitch and roll in the reduced model, in
    ``M g a``; None stands for those of the launch.
    """

    body: Rattleback
    n_i: float | None = None
    omega_xy0: float | None = None
    t_end: float | None = None
    psi: str | float | None = None
    model: str = "full"
    integrator: Mapping[str, Any] = field(default_factory=dict)
    e_p0: float | None = None
    e_r0: float | None = None
    omega: Sequence[float] | None = None
    u: Sequence[float] | None = None
    sigma: float = 0.0
    rolling: float = 0.0
    record: Sequence[str] = ()


def is_full_state(omega: Any, u: Any, spin: Mapping[str, Any]) -> bool:
    """Return whether a launch is a full state; refuse half of one, and one beside a spin."""
    if omega is None and u is None:
        return False
    if given := [name for name, value in spin.items() if value is not None]:
        told = f"{' and '.join(given)} given with a full state"
        raise ConfigError(f"{told}; keep omega and u, or n_i, omega_xy0 and psi")
    if omega is None:
        raise ConfigError("omega: missing; a full state has omega and u")
    return True


def plan_of(run: Launch, source: TableBodies | None = None) -> Plan:
    """Return the sweep of one body, or of the bodies, launches and dissipation of `source`."""
    c = run.body.c
    bodies: dict[str, Any] = {"source": "preset", "name": "GH"}
    if source is not None:
        bodies = {"source": "table", "path": "the table is in memory"}
    if c is not None if source is None else source.has_semi_axes:
        bodies |= {"surface": "ellipsoid"} | ({"c": c} if source is None else {})
    spin = {"n_i": run.n_i, "omega_xy0": run.omega_xy0, "psi": run.psi}
    if is_full_state(run.omega, run.u, spin):
        state = {"omega": run.omega, "u": run.u}
        own: dict[str, Any] = {"launch": {k: list(v) for k, v in state.items() if v is not None}}
    elif run.t_end is None and run.n_i == 0:
        raise ConfigError("t_end: missing; a launch without spin has no t_rGH")
    else:
        own = {"spin": {k: v for k, v in spin.items() if v is not None}}
    config = parse_config({
        "bodies": bodies,
        **own,
        "model": run.model,
        "horizon": {"t_rgh": 5.0} if run.t_end is None else {"t": run.t_end},
        "integrator": dict(run.integrator),
        "dissipation": {"sigma": run.sigma, "rolling": run.rolling},
        "record": list(run.record),
    })  # fmt: skip
    if source is not None:
        assert config.bodies.source == "table"
        return make_plan(config, source=source.with_surface(config.bodies))
    # The body itself, which was checked when it was made, takes the place of the preset.
    names = PARAMETERS if c is None else (*PARAMETERS, "c")
    one = GridBodies({name: getattr(run.body, name) for name in names}, {})
    return make_plan(config, source=one)


def single_run(run: Launch) -> tuple[Config, Launches, Batch | None]:
    """Return config, launch and batch of one run, as a sweep has them; no batch for ``gh``."""
    plan = plan_of(run)
    launches = prepare(plan, np.zeros(1, np.int64), np.zeros(1, np.int64))
    batch = make_batch(launches, run.model)
    if batch is not None and run.model == "reduced":
        batch = with_energies(batch, run.e_p0, run.e_r0)
    return plan.config, launches, batch


def with_energies(batch: Batch, e_p0: float | None, e_r0: float | None) -> Batch:
    """Return a batch of the reduced model with other initial energies, where they are given."""
    y0 = batch.y0.copy()
    for column, name, value in ((1, "e_p0", e_p0), (2, "e_r0", e_r0)):
        if value is None:
            continue
        if not 0 <= value <= MAX_SPEED**2:
            raise ConfigError(f"{name} {value:g}: from 0 to {MAX_SPEED**2:g} M g a is allowed")
        y0[:, column] = value
    return replace(batch, y0=y0)
