"""Random stones of any shape, and their constants."""

import math

import numpy as np
import stone_oracle

from rattlesweep.motion.model import FULL_ELLIPSOID
from rattlesweep.physics import full, stone
from rattlesweep.physics.body import PARAMETERS, shell_dumbbell


def random_bodies(count, seed):
    """Bodies, states and friction coefficients; every fourth body is a paraboloid."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        gamma = rng.uniform(3, 20)
        f_sd = rng.uniform(0.05, 0.3)
        alpha, beta = shell_dumbbell(gamma, f_sd)
        theta = rng.uniform(0.15, 0.95)
        body = dict(
            zip(
                PARAMETERS,
                (
                    alpha,
                    beta,
                    gamma,
                    theta,
                    rng.uniform(0.004, 0.8) * theta,
                    -math.radians(rng.uniform(0.1, 9)),
                ),
                strict=True,
            )
        )
        body["c"] = None if k % 4 == 0 else theta * (1 + rng.lognormal(0, 1.5))
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
    values = dict(zip(full.CONSTANTS, shape, strict=True))
    values |= {"k": k, "sigma": sigma, "rolling": rolling} | model.fixed
    return [values[name] for name in model.constants]


def of_model(model, body, sigma, rolling):
    """Return body and coefficients without what the model does not have."""
    flat = model.name.startswith("full")
    sigma = 0.0 if model is FULL_ELLIPSOID else sigma
    rolling = rolling if model.name.endswith("rolling") else 0.0
    return body | {"c": None if flat else body["c"]}, sigma, rolling


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
