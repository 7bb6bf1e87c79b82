"""Random bodies for the tests of formulas: columns of the six parameters, shape (6,
size).
"""

import numpy as np
import oracle

NAMES = tuple(oracle.GH)
GH = tuple(oracle.GH.values())


def log_uniform(rng, low, high, size=None):
    """Draw numbers with uniform logarithms."""
    return 10 ** rng.uniform(np.log10(low), np.log10(high), size)


def dumbbells(gamma, f_sd):
    """Return ``alpha, beta, gamma`` of shell-dumbbells."""
    return (1 - f_sd) * gamma + 1, f_sd * gamma + 1, gamma


def table_one(size, seed):
    """Draw bodies of the paper's set SD."""
    rng = np.random.default_rng(seed)
    inertia = dumbbells(rng.uniform(5, 15, size), rng.uniform(0.05, 0.15, size))
    theta = rng.uniform(0.6, 0.95, size)
    phi = rng.uniform(0.01, 0.1, size)
    return np.stack([*inertia, theta, phi, -np.radians(rng.uniform(0.1, 6, size))])


def any_body(size, seed):
    """Draw any legal inertia and a wide range of surfaces, left- and right-handed."""
    rng = np.random.default_rng(seed)
    beta = rng.uniform(1.05, 4, size)
    alpha = beta + rng.uniform(0.05, 8, size)
    gamma = rng.uniform(alpha - beta, alpha + beta - 2)
    theta = rng.uniform(0.3, 0.98, size)
    phi = theta * rng.uniform(0.01, 0.9, size)
    xi = rng.uniform(0.01, 0.8, size) * rng.choice([-1, 1], size)
    return np.stack([alpha, beta, gamma, theta, phi, xi])


def far_outside(size, seed):
    """Draw bodies near the ends of all ranges, combined at random."""
    rng = np.random.default_rng(seed)
    f_sd = np.choose(
        rng.integers(0, 3, size),
        [
            log_uniform(rng, 1e-9, 0.5, size),
            0.5 - log_uniform(rng, 1e-9, 0.5, size) / 2,
            rng.uniform(0.05, 0.45, size),
        ],
    )
    alpha, beta, gamma = dumbbells(log_uniform(rng, 1e-2, 1e3, size), f_sd)
    # Every third has alpha within 1e-9..1e-1 of beta, and any gamma that a body can
    # have.
    near = np.arange(size) % 3 == 0
    alpha = np.where(near, beta * (1 + log_uniform(rng, 1e-9, 1e-1, size)), alpha)
    gamma = np.where(near, rng.uniform(alpha - beta, alpha + beta - 2), gamma)
    flat = rng.uniform(size=size) < 0.6
    theta = np.where(
        flat, 1 - log_uniform(rng, 1e-9, 0.5, size), rng.uniform(0.05, 0.99, size)
    )
    phi = theta * log_uniform(rng, 1e-4, 0.9, size)
    deep = rng.uniform(size=size) < 0.3
    degrees = np.where(deep, rng.uniform(1, 89, size), log_uniform(rng, 1e-8, 89, size))
    return np.stack([alpha, beta, gamma, theta, phi, -np.radians(degrees)])


def swinging_launches(size, seed):
    """Draw launches of bodies with tiny ``phi``, whose modes differ much in frequency.

    Return a table of bodies with spins. Most energy is in the oscillation.
    """
    rng = np.random.default_rng(seed)
    alpha = rng.uniform(1.3, 10, size)
    beta = 1 + (alpha - 1) * rng.uniform(0.03, 0.9, size)
    gamma = rng.uniform(alpha - beta, alpha + beta - 2)
    theta = rng.uniform(0.2, 0.95, size)
    phi = log_uniform(rng, 1e-3, 8e-3, size)
    xi = -log_uniform(rng, 0.002, 0.2, size)
    table = dict(zip(NAMES, (alpha, beta, gamma, theta, phi, xi), strict=True))
    table["n_i"] = rng.choice([-1, 1], size) * log_uniform(rng, 0.005, 0.07, size)
    table["omega_xy0"] = log_uniform(rng, 0.05, 0.5, size)
    return table


def wide_launches(size, seed, losses, ellipsoid=False):
    """Draw launches of any legal body in any position, with friction of any strength.

    Skews are up to 0.5 rad.  Half of the bodies stand upright, with a spin of 0.02 to
    0.5 and a push of 0.003 to 0.5; the others are tilted by up to 0.3 rad and turn at
    0.03 to 0.6 about any axis.  ``losses`` are names of constants of friction; half of
    the bodies with ``sigma`` have none of it.  The same seed has the same bodies and
    launches, whatever the friction.
    """
    rng = np.random.default_rng(seed)
    beta = rng.uniform(1.05, 4, size)
    alpha = beta + rng.uniform(0.05, 8, size)
    gamma = rng.uniform(alpha - beta, alpha + beta - 2)
    theta = rng.uniform(0.3, 0.98, size)
    phi = theta * log_uniform(rng, 0.01, 0.9, size)
    xi = rng.uniform(0.01, 0.5, size) * rng.choice([-1, 1], size)
    table = dict(zip(NAMES, (alpha, beta, gamma, theta, phi, xi), strict=True))

    n_i = rng.choice([-1, 1], size) * log_uniform(rng, 0.02, 0.5, size)
    push = log_uniform(rng, 0.003, 0.5, size)
    azimuth = rng.uniform(0, 2 * np.pi, size)
    is_tilted = rng.uniform(size=size) < 0.5
    tilt = np.where(is_tilted, rng.uniform(0, 0.3, size), 0.0)
    towards = rng.uniform(0, 2 * np.pi, size)
    axis = rng.normal(size=(3, size))
    axis *= log_uniform(rng, 0.03, 0.6, size) / np.linalg.norm(axis, axis=0)
    upright = [push * np.cos(azimuth), push * np.sin(azimuth), -n_i]
    omega = np.where(is_tilted, axis, upright)
    u = (
        np.sin(tilt) * np.cos(towards),
        np.sin(tilt) * np.sin(towards),
        -np.cos(tilt),
    )
    for k, name in enumerate("xyz"):
        table[f"omega_{name}"] = omega[k]
        table[f"u_{name}"] = u[k]

    if ellipsoid:
        table["c"] = 1 + log_uniform(rng, 0.01, 2, size)
    has_sigma = rng.uniform(size=size) >= 0.5
    strengths = {
        "sigma": np.where(has_sigma, log_uniform(rng, 1e-5, 3e-3, size), 0.0),
        "pivot": log_uniform(rng, 2e-4, 1e-2, size),
        "rolling": log_uniform(rng, 1e-6, 1e-3, size),
        "mu": rng.uniform(0.1, 1, size),
        "creep": np.zeros(size),
    }
    if "creep" in losses and "mu" not in losses:
        # Beside slides the patch is one that does not give way.
        strengths["creep"] = rng.uniform(0.1, 1, size)
    return table | {name: strengths[name] for name in losses}


def rows(columns):
    """Return bodies one by one, as lists of floats."""
    return np.stack(columns, -1).tolist()


def mapping(body):
    """Return one body as a mapping of its parameters."""
    return dict(zip(NAMES, body, strict=True))
