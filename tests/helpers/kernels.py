"""Hand-made batches and pieces of the kernels, for the tests of the integrators."""

from functools import cache

import numpy as np
import pytest
from numba import njit

from rattlesweep import arrays
from rattlesweep.kernel import outcome, recipes
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.kernel.step import explicit as stages
from rattlesweep.motion.model import FULL, FULL_ELLIPSOID, find_model
from rattlesweep.physics import full, reduced, steady, theory
from rattlesweep.physics.body import PARAMETERS

N_WINDOWS = 64
LAWS = "viscous", "rolling", "pivoting", "rolling_pivoting"
# Bodies that roll, under each law on each surface.
DAMPED = [find_model(f"{on}_{law}") for on in ("full", "ellipsoid") for law in LAWS]
ROLLING = [FULL, FULL_ELLIPSOID, *DAMPED]
_OTHERS = "reduced", "full_tangent", "full_frame"
_ANYWHERE = "vectors", "vectors_sliding", "vectors_pivoting", "vectors_pivoting_sliding"
# The names of all models whose kernels are tested.
MODEL_NAMES = [
    *(model.name for model in ROLLING),
    *_OTHERS,
    *(f"{model.name}_sliding" for model in ROLLING),
    *_ANYWHERE,
]
# Rows of a batch, or of an outcome.
take = pick = arrays.take


def methods(*quick):
    """Parametrise ``method``; other methods compile kernels, and are slow tests."""
    cases = []
    for name, method in METHODS.items():
        marks = [] if name in quick else [pytest.mark.slow]
        cases.append(pytest.param(method, id=name, marks=marks))
    return pytest.mark.parametrize("method", cases)


def _columns(body, *others):
    """Return the six parameters of bodies and other columns, all of one length."""
    columns = np.broadcast_arrays(*(body[name] for name in PARAMETERS), *others)
    columns = [np.atleast_1d(np.asarray(x, dtype=float)) for x in columns]
    return dict(zip(PARAMETERS, columns[:6], strict=True)), columns[6:]


def _modes(body):
    return theory.modes(
        *(body[name] for name in ("alpha", "beta", "theta", "phi", "xi"))
    )


def _batch(n_i, t_end, **own):
    """Return a batch with N_WINDOWS windows per horizon, without marks or taps."""
    return outcome.Batch(
        t_end=t_end,
        window=t_end / N_WINDOWS,
        first_comparison=t_end,
        scale=np.abs(n_i),
        tapped=np.zeros(len(t_end), bool),
        **own,
    )


def full_batch(body, n_i, omega_xy0=0.01, psi="relevant", t_end=1000.0):
    """Return a batch of the full model, ``psi`` as for `theory.direction`."""
    body, (n_i, omega_xy0, t_end) = _columns(body, n_i, omega_xy0, t_end)
    modes = _modes(body)
    psi = theory.direction(modes, n_i, psi) if isinstance(psi, str) else psi
    constants = full.constants(**body)
    at_spin = steady.steady_modes(constants, n_i)
    is_pitch = modes.K_p * n_i > 0
    probe = np.where(is_pitch[:, None], at_spin.pitch_probe, at_spin.roll_probe)
    speed = theory.oscillation_speed(
        body["alpha"], body["beta"], body["gamma"], omega_xy0, psi
    )
    return _batch(
        n_i,
        t_end,
        y0=theory.full_state(n_i, omega_xy0, psi),
        constants=constants.T,
        probe=np.concatenate([probe.real, probe.imag], axis=1),
        swing=2 * np.maximum(np.abs(at_spin.pitch.imag), modes.omega_p),
        relevant=np.where(is_pitch, at_spin.pitch.imag, at_spin.roll.imag),
        rate=30 * speed**2,
    )


def reduced_batch(body, n_i, e_p, e_r, t_end=1000.0):
    """Return a batch of the reduced model with given energies of pitch and roll."""
    body, (n_i, e_p, e_r, t_end) = _columns(body, n_i, e_p, e_r, t_end)
    modes = _modes(body)
    inertia = body["gamma"]
    n_0 = np.sqrt(n_i**2 + 2 * (e_p + e_r) / inertia)
    fastest = np.maximum(np.abs(modes.K_p), np.abs(modes.K_r))
    pitch = (modes.K_p * n_i > 0).astype(float)
    return _batch(
        n_i,
        t_end,
        y0=np.stack([n_i, e_p, e_r], axis=1),
        constants=np.stack([modes.K_p, modes.K_r, inertia], axis=1),
        probe=np.stack([pitch, 1 - pitch], axis=1),
        swing=fastest * n_0,
        relevant=np.zeros(len(t_end)),
        rate=fastest * n_0**2,
    )


def join(*batches):
    """Concatenate batches."""
    columns = zip(*(vars(each).values() for each in batches), strict=True)
    return outcome.Batch(*map(np.concatenate, columns))


def assert_same(a, b, skip=()):
    """Check that all columns of two outcomes agree to the last bit."""
    for name, value in vars(a).items():
        if name not in (*skip, "stopped"):
            expected = getattr(b, name)
            assert value.shape == expected.shape, name
            assert value.tobytes() == expected.tobytes(), name


def mode_energies(body, n_i, omega_xy0):
    """Return the energies of pitch and roll in a launch along the relevant mode."""
    modes = _modes(body)
    psi = theory.direction(modes, n_i, "relevant")
    return reduced.launch_energies(
        body["alpha"], body["beta"], modes.psi_p, modes.psi_r, omega_xy0, psi
    )


@cache
def attempt(method, model):
    """Return the generated step, which its first call compiles."""
    return njit(**stages.OPTIONS)(
        stages.write_attempt(METHODS[method], recipes.problem_of(find_model(model)))
    )


def problem(model):
    """Return the `Problem` for which the parts of a model are compiled."""
    return recipes.problem_of(find_model(model))
