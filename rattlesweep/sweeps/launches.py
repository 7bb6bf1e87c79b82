"""Runs before their integration: bodies, launches, theory, horizons, and the kernel's
batch.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import Batch
from rattlesweep.integrate.lanes.runs import N_WINDOWS
from rattlesweep.integrate.model import ELLIPSOID, FRICTION, FULL, MODELS, Model
from rattlesweep.physics import full, reduced, stone, theory
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.steady import settled_oscillation, steady_modes
from rattlesweep.sweeps.bodies import Bodies
from rattlesweep.sweeps.bodies.table import TableBodies
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.plan import Plan, make_plan
from rattlesweep.units import Quantity

WINDOW_PERIODS = (
    2.0  # periods of the slower mode that a window has at least; see docs/types.md
)
MARK_PERIODS = 8.0  # periods after which amplitudes are compared for the first time
LEAST_DECAY = (
    0.01  # relative fall of an amplitude by the horizon, at which a mode is decaying
)
# relative change of the spin up to which the probes at launch separate the modes
MOST_APART = 0.02


@dataclass(frozen=True)
class Launches:
    """Runs that are ready to be integrated, as arrays with one entry per run."""

    case: Integers
    sample: Integers
    bodies: Bodies
    n_i: Floats
    omega_xy0: Floats
    psi: Floats
    modes: theory.Modes
    gh: theory.GarciaHubbard
    n_0: Floats  # spin if all energy were spin
    n_c1: Floats  # Bondi's threshold; NaN if there is none
    t_end: Floats  # horizon; not finite if there is none
    # The last three are None without dissipation.
    sigma: Floats | None = None
    rolling: Floats | None = None
    dead: Floats | None = (
        None  # fraction of the initial energy below which a body is dead
    )

    @property
    def spin_scale(self) -> Floats:
        """Spin that later spins are compared with: ``|n_i|``, or ``n_0`` if that is
        zero.
        """
        return np.where(self.n_i == 0, self.n_0, np.abs(self.n_i))


def prepare(plan: Plan, case: Integers, sample: Integers) -> Launches:
    """Return the launches of runs with some keys, in any order."""
    config, b = plan.config, plan.source.bodies(plan.targets[case], sample)
    if (state := config.launch) is not None and b.n_i is None:
        omega, u = (np.tile(x, (len(sample), 1)) for x in (state.omega, state.u))
        n_i, omega_xy0, psi = theory.spin_and_oscillation(omega, u)
        b = replace(b, n_i=n_i, omega_xy0=omega_xy0, psi=psi, omega=omega, u=u)

    def natural(value: float | Floats, kind: str) -> Floats:
        assert b.units is not None
        return b.units.natural(value, kind)

    def value(name: str) -> Floats:
        """Return the values of a table, or those of the cases in units of each body."""
        own: Floats | None = getattr(b, name)
        if own is not None:
            return own
        given = [getattr(c, name) for c in plan.cases]
        own = np.array(given, float)[case]
        return (
            own if not isinstance(given[0], Quantity) else natural(own, given[0].kind)
        )

    n_i, omega_xy0 = value("n_i"), value("omega_xy0")
    modes = theory.modes(b.alpha, b.beta, b.theta, b.phi, b.xi)
    direction = config.spin.psi if config.spin else "relevant"
    psi = np.full(len(n_i), np.nan) if b.psi is None else b.psi
    if b.omega is None:  # where a table gives no direction, that of the config applies
        psi = np.where(np.isnan(psi), theory.direction(modes, n_i, direction), psi)
    gh = theory.garcia_hubbard(b, modes, n_i, omega_xy0, psi)
    n_0 = gh.n_0
    if b.omega is not None and b.u is not None:
        ix, iy, iz, *curvature = full.constants(
            b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi
        )
        # The energy of the oscillation includes that of the tilt, here to second order.
        p, q, x, y, _ = full.from_vectors(b.u.T, (b.omega - n_i[:, None] * b.u).T)
        speed = np.sqrt(full.oscillation.py_func(p, q, x, y, ix, iy, *curvature) / iz)
        gh = replace(gh, speed=speed)
        energy = np.vectorize(stone.energy.py_func, otypes=[float])
        start = full.from_vectors(b.u.T, b.omega.T)
        # A paraboloid is an ellipsoid with an infinite semi-axis.
        total = energy(*start, ix, iy, iz, *curvature, stone.inverse_semi_axis(b.c))
        n_0 = np.sqrt(2 * total / b.gamma)
    n_c1 = theory.bondi_threshold(b.alpha, b.beta, b.gamma, b.theta, b.phi)
    n_c1 = np.where(
        b.xi > 0, -n_c1, n_c1
    )  # the steady direction of mirrored bodies is n > 0
    sigma = rolling = dead = None
    if config.dissipation:
        sigma, rolling = value("sigma"), value("rolling")
        dead = np.full(len(sample), config.classify.dead_energy)
        # A decaying spin does not stay above a threshold.
        n_c1 = np.where((sigma > 0) | (rolling > 0), np.nan, n_c1)
    t_end, horizon = np.full(len(n_i), np.inf), config.horizon
    if horizon.t_rgh is not None:
        # fmin ignores NaN, the t_rGH of launches that have none.
        t_end = np.fmin(t_end, horizon.t_rgh * gh.t_rgh)
    if (t := horizon.t) is not None:
        t_end = np.minimum(t_end, natural(t, t.kind) if isinstance(t, Quantity) else t)
    if horizon.t_decay is not None and sigma is not None:
        with np.errstate(divide="ignore"):
            t_end = np.minimum(t_end, horizon.t_decay * b.gamma / sigma)
    if b.t_end is not None:
        t_end = np.where(np.isfinite(b.t_end), b.t_end, t_end)
    return Launches(
        case,
        sample,
        b,
        n_i,
        omega_xy0,
        psi,
        modes,
        gh,
        n_0,
        n_c1,
        t_end,
        sigma,
        rolling,
        dead,
    )


def model_of(config: Config) -> Model:
    """Return the equations that a sweep integrates; not for the model gh, which has
    none.
    """
    if config.model != "full":
        return MODELS[config.model]
    surface = ELLIPSOID if config.bodies.ellipsoidal else FULL
    kind = config.dissipation.kind
    return FRICTION[surface.name, kind] if kind else surface


def make_batch(launches: Launches, model: str) -> Batch | None:
    """Return the batch of a model; None for gh, a closed formula."""
    if model == "gh":
        return None
    return full_batch(launches) if model == "full" else reduced_batch(launches)


def ending_early(batch: Batch, launches: Launches) -> Batch:
    """Return a full batch whose runs end once they are certain to be of type SS."""
    n_0 = np.copysign(launches.n_0, launches.n_i)
    rate = LEAST_DECAY / launches.t_end
    settled = settled_oscillation(batch.constants.T, n_0, launches.n_c1, rate)
    near = np.abs(n_0) <= (1 + MOST_APART) * np.abs(launches.n_i)
    return replace(batch, settled=np.where(near, settled, 0.0))


def full_batch(launches: Launches) -> Batch:
    """Return the batch of the full dynamics."""
    b = launches.bodies
    y0 = theory.full_state(launches.n_i, launches.omega_xy0, launches.psi)
    if b.omega is not None and b.u is not None:
        y0 = np.ascontiguousarray(full.from_vectors(b.u.T, b.omega.T).T)
    constants = full.constants(b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi)
    sigma, rolling = launches.sigma, launches.rolling
    modes = steady_modes(constants, launches.n_i, 0.0 if sigma is None else sigma)
    pitch = theory.unsteady(launches.modes.K_p, launches.n_i)
    probe = np.where(pitch[:, None], modes.pitch_probe, modes.roll_probe)
    # The spin oscillates at twice the frequency of the oscillation.
    fastest = np.maximum(np.abs(modes.pitch.imag), launches.modes.omega_p)
    slower = np.where(modes.roll.imag > 0, modes.roll.imag, launches.modes.omega_r)
    more = []  # constants of ellipsoids and of dissipation
    if b.c is not None or sigma is not None:
        more = [np.broadcast_to(stone.inverse_semi_axis(b.c), len(y0))]
    if sigma is not None and rolling is not None:
        more += [sigma, rolling, np.full(len(y0), stone.SMOOTHING)]
        # The last component of the state is the work of dissipation.
        y0 = np.concatenate([y0, np.zeros((len(y0), 1))], axis=1)
    oscillation = b.gamma * (launches.gh.n_0**2 - launches.n_i**2)
    return Batch(
        y0=y0,
        constants=np.stack([*constants, *more], axis=1),
        probe=np.concatenate([probe.real, probe.imag], axis=1),
        t_end=launches.t_end,
        swing=2 * fastest,
        rate=2 * fastest * oscillation / b.gamma,
        relevant=np.abs(np.where(pitch, modes.pitch.imag, modes.roll.imag)),
        window=_windows(launches.t_end, slower),
        first_mark=MARK_PERIODS * 2 * np.pi / slower,
        scale=launches.spin_scale,
        tapped=launches.n_i == 0,
        dead=np.zeros(0) if launches.dead is None else launches.dead,
    )


def reduced_batch(launches: Launches) -> Batch:
    """Return the batch of the reduced dynamics, with ``I_eff = I_zz`` as in Eq. 72."""
    b, m = launches.bodies, launches.modes
    directions = m.psi_p, m.psi_r, launches.omega_xy0, launches.psi
    e_p, e_r = reduced.mode_energies(b.alpha, b.beta, *directions)
    pitch, n_0 = theory.unsteady(m.K_p, launches.n_i), launches.gh.n_0
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
    """Return the lengths of windows; an infinite frequency gives as many as
    possible.
    """
    parts = np.clip(
        np.floor(t_end * slower / (WINDOW_PERIODS * 2 * np.pi)), 1, N_WINDOWS
    )
    return np.where(np.isfinite(t_end), t_end / parts, 1.0)


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
    integrator: Mapping[str, Any] = field(default_factory=dict)
    e_p0: float | None = None
    e_r0: float | None = None
    omega: Sequence[float] | None = None
    u: Sequence[float] | None = None
    sigma: float = 0.0
    rolling: float = 0.0
    record: Sequence[str] = ()


def is_full_state(omega: Any, u: Any, spin: Mapping[str, Any]) -> bool:
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


def plan_of(run: Launch, source: TableBodies | None = None) -> Plan:
    """Return the plan of one run, or of the bodies, launches and dissipation of a
    table.
    """
    if source is None:
        names = (*PARAMETERS, "c")  # without c, which is None, a NaN
        source = TableBodies(
            {name: np.array([getattr(run.body, name)], float) for name in names}
        )
    section = "spin"
    given: dict[str, Any] = {"n_i": run.n_i, "omega_xy0": run.omega_xy0, "psi": run.psi}
    if is_full_state(run.omega, run.u, given):
        section, given = "launch", {"omega": run.omega, "u": run.u}
    elif run.t_end is None and run.n_i == 0:
        raise ConfigError("t_end: missing; a launch without spin has no t_rGH")
    config = parse_config(
        {
            "bodies": {
                "source": "table",
                "path": "the table is in memory",
                "surface": source.surface,
            },
            section: given,
            "model": run.model,
            "horizon": {"t_rgh": 5.0} if run.t_end is None else {"t": run.t_end},
            "integrator": {
                "dt" if name == "dt_step" else name: value
                for name, value in run.integrator.items()
                if value is not None
            },
            "dissipation": {"sigma": run.sigma, "rolling": run.rolling},
            "record": list(run.record),
        }
    )
    return make_plan(config, rows=source)


def single_run(run: Launch) -> tuple[Config, Launches, Batch | None]:
    """Return the config, launch and batch of one run; the model ``gh`` has no batch."""
    plan, first = plan_of(run), np.zeros(1, np.int64)
    launches = prepare(plan, first, first)
    batch = make_batch(launches, run.model)
    if batch is not None and run.model == "reduced":
        batch = with_energies(batch, run.e_p0, run.e_r0)
    return plan.config, launches, batch


def with_energies(batch: Batch, e_p0: float | None, e_r0: float | None) -> Batch:
    """Return a batch of the reduced model with the initial energies that are given."""
    y0 = batch.y0.copy()
    for column, value in ((1, e_p0), (2, e_r0)):
        if value is not None:
            y0[:, column] = value
    return replace(batch, y0=y0)
