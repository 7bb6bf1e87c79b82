"""Runs before their integration: bodies, launches, theory, horizons, batches."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import Batch
from rattlesweep.integrate.lanes.runs import N_WINDOWS
from rattlesweep.integrate.model import (
    FRICTION,
    FRICTIONLESS,
    MODELS,
    SLIDING,
    Model,
)
from rattlesweep.physics import full, reduced, surface, theory
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.steady import settled_oscillation, steady_modes
from rattlesweep.physics.surface import Surface
from rattlesweep.quantities import COUPLES, LOSSES, SURFACES
from rattlesweep.sweeps.bodies import Bodies
from rattlesweep.sweeps.bodies.table import TableBodies
from rattlesweep.sweeps.config import not_one_of
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.config.schema import DIRECTIONS, Config, State, TableSource
from rattlesweep.sweeps.plan import Plan, make_plan

# Periods of the slower mode that a window has at least; see docs/types.md.
WINDOW_PERIODS = 2.0
# Periods after which amplitudes are compared for the first time.
MARK_PERIODS = 8.0
# Relative fall of an amplitude by the horizon, at which a mode is decaying.
LEAST_DECAY = 0.01
# Relative change of the spin up to which the probes at launch separate the modes.
MOST_APART = 0.02


@dataclass(frozen=True)
class Launches:
    """Runs that are ready to be integrated, as arrays with one entry per run."""

    case: Integers
    sample: Integers
    bodies: Bodies

    # Spin and oscillation
    n_i: Floats
    omega_xy0: Floats
    psi: Floats

    # Theory
    modes: theory.Modes
    gh: theory.GarciaHubbard
    n_0: Floats  # spin if all energy were spin
    n_c1: Floats  # Bondi's threshold; NaN if there is none

    # Time at which a run without a reversal ends; not finite if there is none
    horizon: Floats

    # Name of the model that is integrated for `model: full`
    full_model: str
    # Constants of dissipation by name; none without it
    losses: dict[str, Floats] = field(default_factory=dict)
    # Fraction of the initial energy below which a body is dead
    dead: Floats | None = None

    @property
    def spin_scale(self) -> Floats:
        """Spin to compare others with: ``|n_i|``, or ``n_0`` if that is zero."""
        return np.where(self.n_i == 0, self.n_0, np.abs(self.n_i))

    @property
    def has_couples(self) -> Flags:
        """Whether couples of friction let the spin of a run decay."""
        lossy = np.zeros(len(self.n_i), bool)
        for name in COUPLES & self.losses.keys():
            lossy |= self.losses[name] > 0
        return lossy

    @property
    def has_linear_rate(self) -> Flags:
        """Whether small oscillations of a run grow or decay at a rate of theory."""
        linear = np.ones(len(self.n_i), bool)
        for name, values in self.losses.items():
            if not LOSSES[name].is_linear:
                linear &= ~(values > 0)
        return linear


def prepare(plan: Plan, case: Integers, sample: Integers) -> Launches:
    """Return the launches of runs with some keys, in any order."""
    config = plan.config
    bodies = plan.source.bodies(plan.targets[case], sample)
    if config.launch is not None and bodies.n_i is None:
        bodies = _with_state(bodies, config.launch)
    n_i = _value("n_i", plan, case, bodies)
    omega_xy0 = _value("omega_xy0", plan, case, bodies)

    modes = theory.modes(bodies.alpha, bodies.beta, bodies.theta, bodies.phi, bodies.xi)
    psi = _direction(config, bodies, modes, n_i)
    gh = theory.garcia_hubbard(bodies, modes, n_i, omega_xy0, psi)
    n_0 = gh.n_0
    if bodies.omega is not None and bodies.u is not None:
        # A full state is tilted as well, and its energy includes that of the tilt.
        gh = replace(gh, speed=_oscillation_speed(bodies, bodies.omega, bodies.u, n_i))
        of_surface = surface.SURFACES[config.bodies.bottom]
        n_0 = _spin_of_energy(bodies, bodies.omega, bodies.u, of_surface)
    n_c1 = theory.bondi_threshold(
        bodies.alpha, bodies.beta, bodies.gamma, bodies.theta, bodies.phi
    )
    # The steady direction of mirrored bodies is n > 0.
    n_c1 = np.where(bodies.xi > 0, -n_c1, n_c1)

    losses: dict[str, Floats] = {}
    dead = None
    if config.dissipation:
        for name in config.dissipation.values:
            losses[name] = _value(name, plan, case, bodies)
        dead = np.full(len(sample), config.classify.dead_energy)
    launches = Launches(
        case=case,
        sample=sample,
        bodies=bodies,
        n_i=n_i,
        omega_xy0=omega_xy0,
        psi=psi,
        modes=modes,
        gh=gh,
        n_0=n_0,
        n_c1=n_c1,
        horizon=_horizon(config, bodies, gh.t_rgh, losses.get("sigma")),
        full_model=full_model_of(config).name,
        losses=losses,
        dead=dead,
    )
    # A decaying spin does not stay above a threshold.
    n_c1 = np.where(launches.has_couples, np.nan, launches.n_c1)
    return replace(launches, n_c1=n_c1)


def _with_state(bodies: Bodies, state: State) -> Bodies:
    """Return bodies that are all launched from the state of a config."""
    count = len(bodies.alpha)
    omega = np.tile(state.omega, (count, 1))
    u = np.tile(state.u, (count, 1))
    n_i, omega_xy0, psi = theory.spin_and_oscillation(omega, u)
    return replace(bodies, n_i=n_i, omega_xy0=omega_xy0, psi=psi, omega=omega, u=u)


def _value(name: str, plan: Plan, case: Integers, bodies: Bodies) -> Floats:
    """Return a quantity of a table's rows, or else of the cases, in units of bodies."""
    of_rows: Floats | None = bodies.losses.get(name)
    if name not in LOSSES:
        of_rows = getattr(bodies, name)
    if of_rows is not None:
        return of_rows
    settings = [each.setting(name) for each in plan.cases]
    in_si = [setting.si for setting in settings]
    if in_si[0] is None:
        return np.array([setting.natural for setting in settings], float)[case]
    assert bodies.units is not None
    return bodies.units.natural(np.array(in_si, float)[case], in_si[0].kind)


def _direction(
    config: Config, bodies: Bodies, modes: theory.Modes, n_i: Floats
) -> Floats:
    """Return the directions of oscillations; where a table has none, the config's."""
    psi = bodies.psi
    if psi is None:
        psi = np.full(len(n_i), np.nan)
    if bodies.omega is not None:
        return psi
    of_config = config.spin.psi if config.spin is not None else "relevant"
    return np.where(np.isnan(psi), theory.direction(modes, n_i, of_config), psi)


def _oscillation_speed(bodies: Bodies, omega: Floats, u: Floats, n_i: Floats) -> Floats:
    """Return the spins that would hold the energy of the oscillation and the tilt.

    The energy of the tilt is that of second order in the tilt.
    """
    ix, iy, iz, cxx, cxy, cyy = _constants_of(bodies)
    p, q, omega_x, omega_y, _ = full.from_vectors(u.T, (omega - n_i[:, None] * u).T)
    # The formula in Python takes arrays; compiled, it takes numbers.
    energy = full.oscillation.py_func
    twice = energy(p, q, omega_x, omega_y, ix, iy, cxx, cxy, cyy)
    return np.asarray(np.sqrt(twice / iz))


def _spin_of_energy(
    bodies: Bodies, omega: Floats, u: Floats, of_surface: Surface
) -> Floats:
    """Return the spins that would hold all the energy of full states."""
    state = full.from_vectors(u.T, omega.T)
    constants = _constants_of(bodies)
    if of_surface is surface.PARABOLOID:
        # A paraboloid is an ellipsoid with an infinite semi-axis.
        of_surface = surface.ELLIPSOID
    k = _surface_constant(bodies, of_surface)
    energy = surface.in_python(of_surface.energy, 1)
    return np.asarray(np.sqrt(2 * energy(*state, *constants, k) / bodies.gamma))


def _surface_constant(bodies: Bodies, of_surface: Surface) -> Floats:
    """Return the further constant of a surface as models take it; 0 for paraboloids."""
    name = SURFACES[of_surface.name]
    none = np.full(len(bodies.alpha), np.nan)
    values = none if name is None else bodies.further.get(name, none)
    return of_surface.constant(values)


def _constants_of(bodies: Bodies) -> Floats:
    return full.constants(
        bodies.alpha, bodies.beta, bodies.gamma, bodies.theta, bodies.phi, bodies.xi
    )


def _horizon(
    config: Config, bodies: Bodies, t_rgh: Floats, sigma: Floats | None
) -> Floats:
    """Return the smallest of the config's horizons, or a table's own."""
    (setting,) = config.settings["t_end"]
    t: Floats | float | None = setting.natural
    if setting.si is not None and bodies.units is not None:
        t = bodies.units.natural(setting.si, setting.si.kind)
    horizon = config.horizon.earliest(t, t_rgh, bodies.gamma, sigma)
    if bodies.t_end is not None:
        horizon = np.where(np.isfinite(bodies.t_end), bodies.t_end, horizon)
    return horizon


def model_of(config: Config) -> Model:
    """Return the equations that a sweep integrates; the model gh has none."""
    if config.model != "full":
        return MODELS[config.model]
    return full_model_of(config)


def full_model_of(config: Config) -> Model:
    """Return the equations of a config for `model: full`."""
    name = surface.SURFACES[config.bodies.bottom].model
    law = config.dissipation.law
    model = FRICTIONLESS[name] if law is None else FRICTION[name, law]
    if config.dissipation.slides:
        model = SLIDING[model.name]
    if "volume" in config.record and model.volume is None:
        raise ConfigError(
            f"record: the phase volume of {model.name} is not known; leave volume out"
        )
    return model


def make_batch(launches: Launches, model: str) -> Batch | None:
    """Return the batch of a model; None for gh, a closed formula."""
    if model == "gh":
        return None
    if model == "reduced":
        return reduced_batch(launches)
    return full_batch(launches)


def ending_early(batch: Batch, launches: Launches) -> Batch:
    """Return a full batch whose runs end once they are certain to be of type SS."""
    n_0 = np.copysign(launches.n_0, launches.n_i)
    decay_rate = LEAST_DECAY / launches.horizon
    settled = settled_oscillation(batch.constants.T, n_0, launches.n_c1, decay_rate)
    # Beyond that, the probes at launch do not separate the modes at n_0.
    is_near = np.abs(n_0) <= (1 + MOST_APART) * np.abs(launches.n_i)
    return replace(batch, settled=np.where(is_near, settled, 0.0))


def full_batch(launches: Launches) -> Batch:
    """Return the batch of the full dynamics."""
    bodies = launches.bodies
    y0 = theory.full_state(launches.n_i, launches.omega_xy0, launches.psi)
    if bodies.omega is not None and bodies.u is not None:
        y0 = np.ascontiguousarray(full.from_vectors(bodies.u.T, bodies.omega.T).T)
    body_constants = _constants_of(bodies)
    count = len(y0)

    # Constants of the surface and of dissipation follow those of the body.
    model = MODELS[launches.full_model]
    assert model.surface is not None
    constants = [*body_constants]
    if model.surface is not surface.PARABOLOID or model.law is not None:
        constants.append(_surface_constant(bodies, model.surface))
    if model.law is not None:
        for each in model.law.loss:
            value = launches.losses[each] if isinstance(each, str) else each
            constants.append(np.broadcast_to(value, count))
        # The last component of the state is the work of dissipation.
        y0 = np.concatenate([y0, np.zeros((count, 1))], axis=1)
    if model.slide is not None:
        constants.append(launches.losses["mu"])

    sigma = launches.losses.get("sigma", 0.0)
    modes = steady_modes(body_constants, launches.n_i, sigma)
    pitch_grows = theory.unsteady(launches.modes.K_p, launches.n_i)
    probe = np.where(pitch_grows[:, None], modes.pitch_probe, modes.roll_probe)
    relevant = np.where(pitch_grows, modes.pitch.imag, modes.roll.imag)
    fastest = np.maximum(np.abs(modes.pitch.imag), launches.modes.omega_p)
    # An overdamped roll has no frequency at this spin.
    slower = np.where(modes.roll.imag > 0, modes.roll.imag, launches.modes.omega_r)
    # The spin oscillates at twice the frequency of the oscillation.
    swing = 2 * fastest
    oscillation = bodies.gamma * (launches.gh.n_0**2 - launches.n_i**2)
    dead = launches.dead
    if dead is None:
        dead = np.zeros(0)
    return Batch(
        y0=y0,
        constants=np.stack(constants, axis=1),
        probe=np.concatenate([probe.real, probe.imag], axis=1),
        t_end=launches.horizon,
        swing=swing,
        rate=swing * oscillation / bodies.gamma,
        relevant=np.abs(relevant),
        window=_windows(launches.horizon, slower),
        first_mark=MARK_PERIODS * 2 * np.pi / slower,
        scale=launches.spin_scale,
        tapped=launches.n_i == 0,
        dead=dead,
        rim=bodies.rim,
    )


def reduced_batch(launches: Launches) -> Batch:
    """Return the batch of the reduced dynamics, with ``I_eff = I_zz`` as in Eq. 72."""
    bodies = launches.bodies
    modes = launches.modes
    e_p, e_r = reduced.mode_energies(
        bodies.alpha,
        bodies.beta,
        modes.psi_p,
        modes.psi_r,
        launches.omega_xy0,
        launches.psi,
    )
    pitch_grows = theory.unsteady(modes.K_p, launches.n_i)
    n_0 = launches.gh.n_0
    fastest_growth = np.maximum(np.abs(modes.K_p), np.abs(modes.K_r)) * n_0
    count = len(n_0)
    return Batch(
        y0=np.stack([launches.n_i, e_p, e_r], axis=1),
        constants=np.stack([modes.K_p, modes.K_r, bodies.gamma], axis=1),
        # The relevant amplitude is the energy of one mode.
        probe=np.stack([pitch_grows, ~pitch_grows], axis=1).astype(float),
        t_end=launches.horizon,
        swing=fastest_growth,
        relevant=np.zeros(count),
        rate=fastest_growth * n_0,
        # Without oscillations, windows may be as short as possible.
        window=_windows(launches.horizon, np.full(count, np.inf)),
        first_mark=launches.horizon,
        scale=launches.spin_scale,
        tapped=launches.n_i == 0,
    )


def _windows(horizon: Floats, slower: Floats) -> Floats:
    """Return the lengths of windows, for the frequency of the slower mode."""
    periods = horizon * slower / (2 * np.pi)
    count = np.clip(np.floor(periods / WINDOW_PERIODS), 1, N_WINDOWS)
    return np.where(np.isfinite(horizon), horizon / count, 1.0)


@dataclass(frozen=True)
class Launch:
    """One run, with the keys of a config (but ``dt_step``) and a default horizon of 5
    t_rGH.

    In the reduced model `e_p0` and `e_r0` replace the initial energies of the modes, in
    ``M g a``.
    """

    body: Rattleback
    n_i: float | None = None
    omega_xy0: float | None = None
    t_end: float | None = None
    psi: str | float | None = None
    model: str = "full"
    integrator: Mapping[str, object] = field(default_factory=dict)
    e_p0: float | None = None
    e_r0: float | None = None
    omega: Sequence[float] | None = None
    u: Sequence[float] | None = None
    losses: Mapping[str, float] = field(default_factory=dict)
    record: Sequence[str] = ()


def is_full_state(omega: object, u: object, spin: Mapping[str, object]) -> bool:
    """Return whether a launch is a full state; raise if it also has a spin, or lacks
    omega.
    """
    if omega is None and u is None:
        return False
    if given := " and ".join(name for name, value in spin.items() if value is not None):
        advice = "keep omega and u, or n_i, omega_xy0 and psi"
        raise ConfigError(f"{given} given with a full state; {advice}")
    if omega is None:
        raise ConfigError("omega: missing; a full state has omega and u")
    return True


def directions(columns: Mapping[str, Floats], psi: str) -> Floats:
    """Return the directions of the oscillations of rows, by a word for the mode."""
    if psi not in DIRECTIONS:
        raise ConfigError(f"psi: {not_one_of(psi, DIRECTIONS)}, or give degrees")
    names = ("alpha", "beta", "theta", "phi", "xi")
    modes = theory.modes(*(columns[name] for name in names))
    return theory.direction(modes, columns["n_i"], psi)


def plan_of(run: Launch) -> Plan:
    """Return the plan of one run."""
    names = (*PARAMETERS, "c")  # without c, which is None, a NaN
    rows = TableBodies(
        {name: np.array([getattr(run.body, name)], float) for name in names}
    )
    if run.body.rim is not None:
        rows.carried["rim"] = np.array([run.body.rim])
    spin = {"n_i": run.n_i, "omega_xy0": run.omega_xy0, "psi": run.psi}
    if is_full_state(run.omega, run.u, spin):
        launch: dict[str, object] = {"launch": {"omega": run.omega, "u": run.u}}
    elif run.t_end is None and run.n_i == 0:
        raise ConfigError("t_end: missing; a launch without spin has no t_rGH")
    else:
        launch = {"spin": spin}
    horizon = {"t_rgh": 5.0} if run.t_end is None else {"t": run.t_end}
    keys = {"horizon": horizon, "dissipation": dict(run.losses), **launch}
    return plan_of_rows(rows, run.model, run.integrator, run.record, keys)


def plan_of_rows(
    rows: TableBodies,
    model: str,
    integrator: Mapping[str, object],
    record: Sequence[str],
    keys: Mapping[str, object],
) -> Plan:
    """Return the plan of bodies in memory, by default up to 5 t_rGH.

    `keys` are further keys of a config; without them, the rows have launches.
    """
    steps = {
        "dt" if name == "dt_step" else name: value
        for name, value in integrator.items()
        if value is not None
    }
    try:
        config = parse_config(
            {"model": model, "integrator": steps, "record": list(record), **keys},
            bodies=TableSource.in_memory(rows.surface),
        )
    except ConfigError as error:
        raise ConfigError(map(_of_arguments, error.messages)) from None
    return make_plan(config, rows=rows)


def _of_arguments(message: str) -> str:
    """Return a message about a key of the integrator, as it is named in calls."""
    message = message.removeprefix("integrator.")
    if message.startswith("dt: "):
        # The rows of a trajectory are ``dt`` apart.
        return re.sub(r"\bdt\b", "dt_step", message)
    return message


def with_energies(batch: Batch, e_p0: float | None, e_r0: float | None) -> Batch:
    """Return a batch of the reduced model with the initial energies that are given."""
    y0 = batch.y0.copy()
    for column, value in ((1, e_p0), (2, e_r0)):
        if value is not None:
            y0[:, column] = value
    return replace(batch, y0=y0)
