"""Ellipsoids and friction against an independent formulation of the mechanics."""

import math

import numpy as np
import pytest
import stone_oracle
from exact import exactly
from mpmath import mp

from rattlesweep.integrate.model import ELLIPSOID, FRICTION
from rattlesweep.physics import full, stone
from rattlesweep.physics.body import PARAMETERS, shell_dumbbell

MODELS = [ELLIPSOID, *FRICTION.values()]


def random_bodies(count, seed):
    """Bodies, states and friction coefficients; every fourth body is a paraboloid."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        gamma = rng.uniform(3, 20)
        f_sd = rng.uniform(0.05, 0.3)
        alpha, beta = shell_dumbbell(gamma, f_sd)
        theta = rng.uniform(0.15, 0.95)
        body = {
            "alpha": alpha,
            "beta": beta,
            "gamma": gamma,
            "theta": theta,
            "phi": rng.uniform(0.004, 0.8) * theta,
            "xi": -math.radians(rng.uniform(0.1, 9)),
            "c": None,
        }
        if k % 4:
            body["c"] = theta * (1 + rng.lognormal(0, 1.5))
        tilt = rng.uniform(0, 0.3)
        turn = rng.uniform(0, 2 * math.pi)
        u = np.array(
            [
                math.sin(tilt) * math.cos(turn),
                math.sin(tilt) * math.sin(turn),
                -math.cos(tilt),
            ]
        )
        yield body, u, rng.normal(0, 0.4, 3), rng.uniform(0, 0.1), rng.uniform(0, 0.01)


def constants_of(model, body, sigma=0.0, rolling=0.0):
    """Return the constants of a body for a model."""
    shape = full.constants(*(body[name] for name in PARAMETERS))
    k = stone.inverse_semi_axis(body["c"])
    return [*shape, k, sigma, rolling, stone.SMOOTHING][: model.n_constants]


def of_model(model, body, sigma, rolling):
    """Return body and coefficients without what the model does not have."""
    flat = model.name.startswith("full")
    sigma = 0.0 if model is ELLIPSOID else sigma
    rolling = rolling if model.name.endswith("rolling") else 0.0
    return body | {"c": None if flat else body["c"]}, sigma, rolling


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_equations_are_those_of_mechanics(model):
    for body, u, omega, sigma, rolling in random_bodies(100, 1):
        body, sigma, rolling = of_model(model, body, sigma, rolling)
        y = np.concatenate([u, omega, [0.0]])
        state = [*full.from_vectors(u, omega), 0.3][: model.n_state]
        q = constants_of(model, body, sigma, rolling)
        wanted, force, power = stone_oracle.forces(y, body, sigma, rolling)
        got = model.rhs(*state, *q)
        scale = 1 + np.abs(wanted).max()
        np.testing.assert_allclose(got[2:5], wanted, rtol=0, atol=2e-12 * scale)
        p, q_slope = state[:2]
        du = np.cross(u, omega)
        slope = (du[:2] * u[2] - u[:2] * du[2]) / u[2] ** 2
        np.testing.assert_allclose(
            got[:2], slope, rtol=0, atol=1e-13 * (1 + abs(slope).max())
        )
        normal, tangential = model.contact(*state, *q)
        assert normal == pytest.approx(force @ u, abs=1e-11 * scale)
        across = np.linalg.norm(force - (force @ u) * u)
        assert tangential == pytest.approx(across, abs=1e-11 * scale)
        work = 0.3 if model.n_state == 6 else 0.0
        total = stone_oracle.energy(y, body) - work
        assert model.energy(*state, *q) == pytest.approx(
            total, abs=1e-13 * (1 + abs(total))
        )
        if model.n_state == 6:
            assert got[5] == pytest.approx(power, rel=1e-10, abs=1e-13)
        fx, fy, rise, *_ = model.surface.contact(
            p,
            q_slope,
            *omega,
            *got[:2],
            p * omega[1] - q_slope * omega[0],
            *q[3 : 3 + 4],
        )
        r, _ = stone_oracle.contact(u, du, body)
        np.testing.assert_allclose([p + fx, q_slope + fy, 1 - rise], r, atol=1e-12)


@pytest.mark.parametrize(
    "model", [m for m in MODELS if m.n_carried], ids=lambda model: model.name
)
def test_carried_functions_of_a_step(model):
    """Start and rate are those of the contact point, at 60 digits."""
    assert model.n_carried == 1
    start, carried, plain = map(
        exactly, (model.carried_start, model.carried_rhs, model.rhs)
    )
    for body, u, omega, sigma, rolling in random_bodies(12, 6):
        body, sigma, rolling = of_model(model, body, sigma, rolling)
        with mp.workdps(60):
            y = [
                mp.mpf(x) for x in [*full.from_vectors(u, omega), 0.3][: model.n_state]
            ]
            q = [mp.mpf(float(x)) for x in constants_of(model, body, sigma, rolling)]
            (rise,) = start(*y, *q)
            wanted = plain(*y, *q)
            *got, rate = carried(*y, rise, *q)
            assert max(abs(a - b) for a, b in zip(got, wanted, strict=True)) < 1e-50
            h = mp.mpf(10) ** -25
            ahead, behind = (
                start(*(a + s * b for a, b in zip(y, wanted, strict=True)), *q)[0]
                for s in (h, -h)
            )
            assert abs((ahead - behind) / (2 * h) - rate) < 1e-30
            # An error of the rise enters squared.
            off = rise * (1 + mp.mpf(10) ** -8)
            nearly = carried(*y, off, *q)
            assert (
                max(abs(a - b) for a, b in zip(nearly, (*got, rate), strict=True))
                < 1e-12
            )


def kl_state(omega_3):
    """Return Kane and Levinson's launch in our units: ``u``, ``omega``, a second."""
    tilt = stone_oracle.KL_TILT
    _, vectors = np.linalg.eigh(stone_oracle.KL_INERTIA)
    x = vectors[:, 1] * np.sign(vectors[1, 1])
    z = np.array([0, 0, 1.0])
    frame = np.array([x, np.cross(z, x), z])
    down = np.array(
        [-math.cos(tilt) * math.sin(tilt), math.sin(tilt), math.cos(tilt) ** 2]
    )
    second = math.sqrt(stone_oracle.KL_GRAVITY / stone_oracle.KL_HEIGHT)
    return frame @ -down, frame @ [0, 0, omega_3 / second], second
