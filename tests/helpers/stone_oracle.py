"""Ellipsoids and friction from the laws of mechanics, in NumPy and SciPy.

This module does not import `rattlesweep`.  The unknowns are the angular acceleration
and the contact force.  Newton's law for the centre of mass, Euler's law about it and
the rolling condition are six linear equations for them.  Units M = a = g = 1; the state
is ``(u, omega, work)``, body-fixed components, ``z`` down at rest.
"""

import math
from functools import cache

import numpy as np
import oracle
from oracle import cross, matrix_of
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

SMOOTHING = 1e-4


@cache
def ellipsoid(theta, phi, xi, c):
    """Return the centre and the matrix ``E`` of the ellipsoid ``x.E^-1 x = 1``."""
    turn = np.eye(3)
    turn[:2, :2] = oracle.rotation(xi)
    return np.array([0, 0, 1 - c]), turn @ np.diag([c / theta, c / phi, c**2]) @ turn.T


def contact(u, du, body):
    """Return the contact point from the centre of mass, and its rate in the body."""
    if body.get("c") is None:
        return oracle.contact_point(u, body), oracle.contact_point_dot(u, du, body)
    centre, e = ellipsoid(
        *(oracle.get(body, name) for name in ("theta", "phi", "xi", "c"))
    )
    # The outward normal at the contact points down.
    s = np.sqrt(u @ e @ u)
    return centre - e @ u / s, -e @ du / s + e @ u * (u @ e @ du) / s**3


def forces(y, body, sigma=0.0, rolling=0.0):
    """Return the angular acceleration, the contact force and the power of friction."""
    u = y[:3]
    w = y[3:6]
    r, dr = contact(u, cross(u, w), body)
    inertia = oracle.matrices(body)[2]
    across = w - (u @ w) * u
    direction = across / np.sqrt(across @ across + SMOOTHING**2)
    left = np.zeros((6, 6))
    right = np.zeros(6)
    # dv/dt of v = r x omega in space is F - u.
    left[:3, :3] = matrix_of(r)
    left[:3, 3:] = -np.eye(3)
    right[:3] = -u - cross(dr, w) - cross(w, cross(r, w))
    # I domega/dt + omega x I omega = r x F - sigma omega - rolling (F.u) direction
    left[3:, :3] = inertia
    left[3:, 3:] = -matrix_of(r) + rolling * np.outer(direction, u)
    right[3:] = -cross(w, inertia @ w) - sigma * w
    solution = np.linalg.solve(left, right)
    force = solution[3:]
    if rolling and force @ u < 0:
        # A plane cannot pull, and without a force there is no rolling friction.
        return forces(y, body, sigma)
    power = -sigma * (w @ w) - rolling * (force @ u) * (direction @ w)
    return solution[:3], force, power


def rhs(t, y, body, sigma=0.0, rolling=0.0):
    """Return the rates of ``u, omega`` and the work."""
    acceleration, _, power = forces(y, body, sigma, rolling)
    return np.concatenate([cross(y[:3], y[3:6]), acceleration, [power]])


def energy(y, body):
    """Return the energy; the potential is zero at rest."""
    u = y[:3]
    w = y[3:6]
    r, _ = contact(u, np.zeros(3), body)
    v = cross(r, w)
    return 0.5 * (v @ v + w @ oracle.matrices(body)[2] @ w) - r @ u - 1


def follow(body, u, omega, t_end, sigma=0.0, rolling=0.0, tol=1e-13):
    """Return SciPy's solution from a state, with dense output."""
    y0 = np.concatenate([u, omega, [0.0]])
    return solve_ivp(
        rhs,
        (0, t_end),
        y0,
        "DOP853",
        dense_output=True,
        rtol=tol,
        atol=1e-3 * tol,
        args=(body, sigma, rolling),
    )


def first_zero(found, value, samples=40_000):
    """Return the first zero of a vectorised function of the state, or None."""
    times = np.linspace(0, found.t[-1], samples)
    values = value(found.sol(times))
    changes = np.flatnonzero(values[1:] * values[:-1] < 0)
    if not changes.size:
        return None
    a = times[changes[0]]
    b = times[changes[0] + 1]
    return brentq(lambda t: value(found.sol(t)), a, b, xtol=1e-15)


KL_HEIGHT = 0.01  # m
KL_INERTIA = (
    np.array([[2, -0.2, 0], [-0.2, 16, 0], [0, 0, 17]]) * 1e-4
)  # kg m^2, mass 1 kg
KL_GRAVITY = 9.81
KL_TILT = math.radians(0.5)
