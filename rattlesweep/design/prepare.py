"""Prepare runs: from their keys to bodies, launches, theory and horizons."""

from dataclasses import replace

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.config.schema import Config, FullState
from rattlesweep.design.models import constants_of, full_model_of, surface_constant
from rattlesweep.design.plan import Plan
from rattlesweep.physics import full, surface, theory
from rattlesweep.physics.surface import Surface
from rattlesweep.rows.prepared import Bodies, PreparedRuns
from rattlesweep.words.quantities import INITIAL_RATES


def prepare_launches(plan: Plan, case: Integers, sample: Integers) -> PreparedRuns:
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
    dead = np.zeros(0)
    for name in config.acting.values if config.acting else ():
        losses[name] = _value(name, plan, case, bodies)
    if "base_amplitude" in losses:
        stroke = losses.pop("base_amplitude")
        losses["base_acceleration"] = stroke * losses["base_frequency"] ** 2
    if config.dissipation:
        if config.dissipation.creeps_with_mu:
            losses["creep"] = np.where(losses["pivot"] > 0, losses["mu"], 0.0)
        dead = np.full(len(sample), config.classify.dead_energy)
        # A plane that shakes can wake a body that has hardly any energy left.
        dead[losses.get("base_acceleration", np.zeros(len(sample))) > 0] = 0.0
    launches = PreparedRuns(
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


def _with_state(bodies: Bodies, state: FullState) -> Bodies:
    """Return bodies that are all launched from the state of a config."""
    count = len(bodies.alpha)
    omega = np.tile(state.omega, (count, 1))
    u = np.tile(state.u, (count, 1))
    n_i, omega_xy0, psi = theory.spin_and_oscillation(omega, u)
    return replace(bodies, n_i=n_i, omega_xy0=omega_xy0, psi=psi, omega=omega, u=u)


def _value(name: str, plan: Plan, case: Integers, bodies: Bodies) -> Floats:
    """Return a quantity of a table's rows, or else of the cases, in units of bodies."""
    of_rows: Floats | None = bodies.losses.get(name)
    if name in INITIAL_RATES:
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
    constants = constants_of(bodies)
    p, q, omega_x, omega_y, _ = full.from_vectors(u.T, (omega - n_i[:, None] * u).T)
    # The formula in Python takes arrays; compiled, it takes numbers.
    energy = full.oscillation.py_func
    twice = energy((p, q, omega_x, omega_y), constants)
    return np.sqrt(twice / constants[2])


def _spin_of_energy(
    bodies: Bodies, omega: Floats, u: Floats, of_surface: Surface
) -> Floats:
    """Return the spins that would hold all the energy of full states."""
    state = full.from_vectors(u.T, omega.T)
    constants = constants_of(bodies)
    if of_surface is surface.PARABOLOID:
        # A paraboloid is an ellipsoid with an infinite semi-axis.
        of_surface = surface.ELLIPSOID
    k = surface_constant(bodies, of_surface)
    # In Python, as it would take long to compile.
    energy = of_surface.energy.py_func  # type: ignore[attr-defined]
    rows = zip(state.T, np.stack([*constants, k], axis=1), strict=True)
    energies = np.array([energy(tuple(y), tuple(q)) for y, q in rows])
    return np.sqrt(2 * energies / bodies.gamma)


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
