"""From launches to the batches that the kernels integrate."""

from dataclasses import replace
from typing import Any

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.design.models import constants_of, surface_constant
from rattlesweep.kernel.outcome import Batch
from rattlesweep.kernel.runs import N_WINDOWS
from rattlesweep.motion.model import find_model, reduced_model
from rattlesweep.physics import full, reduced, theory
from rattlesweep.physics.friction import losses
from rattlesweep.physics.steady import settled_oscillation, steady_modes
from rattlesweep.rows.prepared import PreparedRuns
from rattlesweep.words.quantities import ACTING, LOSSES

# Periods of the slower mode that a window has at least; see docs/types.md.
WINDOW_PERIODS = 2.0


# Periods after which amplitudes are compared for the first time.
COMPARISON_PERIODS = 8.0


# Relative fall of an amplitude by the horizon, at which a mode is decaying.
LEAST_DECAY = 0.01


# Relative change of the spin up to which the probes at launch separate the modes.
MOST_APART = 0.02


def make_batch(launches: PreparedRuns, model: str) -> Batch | None:
    """Return the batch of a model; None for gh, a closed formula."""
    if model == "gh":
        return None
    if model == "reduced":
        return reduced_batch(launches)
    return full_batch(launches)


def ending_early(batch: Batch, launches: PreparedRuns) -> Batch:
    """Return a full batch whose runs end once they are certain to be of type SS."""
    n_0 = np.copysign(launches.n_0, launches.n_i)
    decay_rate = LEAST_DECAY / launches.horizon
    settled = settled_oscillation(batch.constants.T, n_0, launches.n_c1, decay_rate)
    # Beyond that, the probes at launch do not separate the modes at n_0.
    is_near = np.abs(n_0) <= (1 + MOST_APART) * np.abs(launches.n_i)
    return replace(batch, settled=np.where(is_near, settled, 0.0))


def full_batch(launches: PreparedRuns) -> Batch:
    """Return the batch of the full dynamics."""
    bodies = launches.bodies
    y0 = theory.full_state(launches.n_i, launches.omega_xy0, launches.psi)
    if bodies.omega is not None and bodies.u is not None:
        y0 = np.ascontiguousarray(full.from_vectors(bodies.u.T, bodies.omega.T).T)
    body_constants = constants_of(bodies)
    count = len(y0)

    model = find_model(launches.full_model)
    assert model.surface is not None
    values: dict[str, Any] = dict(zip(full.CONSTANTS, body_constants, strict=True))
    values["k"] = surface_constant(bodies, model.surface)
    # A constant that is not given has its default beside others of its action.
    values |= {name: constant.default for name, constant in ACTING.items()}
    values |= model.fixed | launches.losses
    constants = [np.broadcast_to(values[name], count) for name in model.of_runs]
    y0 = model.at_launch(y0, values)

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
    if model.lifts:
        # The weight oscillates with the plane, if this moves.
        shakes = launches.losses["base_acceleration"] > 0
        frequency = launches.losses["base_frequency"]
        swing = np.maximum(swing, np.where(shakes, frequency, 0.0))
    oscillation = bodies.gamma * (launches.gh.n_0**2 - launches.n_i**2)
    return Batch(
        y0=y0,
        constants=np.stack(constants, axis=1),
        probe=np.concatenate([probe.real, probe.imag], axis=1),
        t_end=launches.horizon,
        swing=swing,
        rate=swing * oscillation / bodies.gamma,
        relevant=np.abs(relevant),
        window=_windows(launches.horizon, slower),
        first_comparison=COMPARISON_PERIODS * 2 * np.pi / slower,
        scale=launches.spin_scale,
        tapped=launches.n_i == 0,
        dead=launches.dead,
        rim=bodies.rim,
    )


def reduced_batch(launches: PreparedRuns) -> Batch:
    """Return the batch of the reduced dynamics, with ``I_eff = I_zz`` as in Eq. 72.

    Its model is :func:`reduced_model` of the launches' losses.
    """
    bodies = launches.bodies
    modes = launches.modes
    e_p, e_r = reduced.launch_energies(
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
    model = reduced_model(launches.losses)
    values = _reduced_constants(launches)
    y0 = model.at_launch(np.stack([launches.n_i, e_p, e_r], axis=1), values)
    constants = [np.broadcast_to(values[name], count) for name in model.constants]
    slowing = values["sigma"] * n_0 + values["lever"]
    fastest_loss = np.maximum(
        values["loss_p"] + values["slip_p"], values["loss_r"] + values["slip_r"]
    )
    fastest_loss = np.maximum(fastest_loss, values["sigma"] / bodies.gamma)
    return Batch(
        y0=y0,
        constants=np.stack(constants, axis=1),
        # The relevant amplitude is the energy of one mode.
        probe=np.stack([pitch_grows, ~pitch_grows], axis=1).astype(float),
        t_end=launches.horizon,
        swing=np.maximum(fastest_growth, fastest_loss),
        relevant=np.zeros(count),
        rate=fastest_growth * n_0 + slowing / bodies.gamma,
        # Without oscillations, windows may be as short as possible.
        window=_windows(launches.horizon, np.full(count, np.inf)),
        first_comparison=launches.horizon,
        scale=launches.spin_scale,
        tapped=launches.n_i == 0,
        dead=launches.dead,
    )


def _reduced_constants(launches: PreparedRuns) -> dict[str, Any]:
    """Return the constants of the reduced model by name, zero for absent losses."""
    bodies = launches.bodies
    modes = launches.modes
    given = {name: launches.losses.get(name, np.zeros(1)) for name in LOSSES}
    moment_p, moment_r = theory.mode_moments(bodies.alpha, bodies.beta, modes)
    viscous = given["viscous"]
    creep = given["pivot"], given["creep"]
    return {
        "k_p": modes.K_p,
        "k_r": modes.K_r,
        "inertia": bodies.gamma,
        "sigma": given["sigma"],
        "loss_p": losses.share_of_couple(moment_p, given["sigma"]),
        "loss_r": losses.share_of_couple(moment_r, given["sigma"]),
        "slip_p": losses.share_of_slip(modes.omega_p, moment_p, viscous),
        "slip_r": losses.share_of_slip(modes.omega_r, moment_r, viscous),
        "rolling": given["rolling"],
        "moment_p": moment_p,
        "moment_r": moment_r,
        "overlap": np.cos(modes.psi_p - modes.psi_r) ** 2,
        "creep_p": losses.share_of_creep(modes.omega_p, moment_p, *creep),
        "creep_r": losses.share_of_creep(modes.omega_r, moment_r, *creep),
        "lever": given["pivot"],
        "sense": 1.0,
    }


def _windows(horizon: Floats, slower: Floats) -> Floats:
    """Return the lengths of windows, for the frequency of the slower mode."""
    periods = horizon * slower / (2 * np.pi)
    count = np.clip(np.floor(periods / WINDOW_PERIODS), 1, N_WINDOWS)
    return np.where(np.isfinite(horizon), horizon / count, 1.0)


def with_energies(batch: Batch, e_p0: float | None, e_r0: float | None) -> Batch:
    """Return a batch of the reduced model with the initial energies that are given."""
    y0 = batch.y0.copy()
    for column, value in ((1, e_p0), (2, e_r0)):
        if value is not None:
            y0[:, column] = value
    return replace(batch, y0=y0)
