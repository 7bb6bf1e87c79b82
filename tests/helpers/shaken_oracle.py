"""A body on a plane that shakes up and down, from the laws of mechanics, with SciPy.

This module does not import `rattlesweep`.  As in `stone_oracle`, the unknowns are the
angular acceleration and the contact force, and the laws of Newton and Euler and the
rolling condition are six linear equations for them.  In the frame of the plane the
weight is ``1 + eps cos(Omega t + phase)``.  Units M = a = g = 1; the state is ``(u,
omega, work of all, work of the plane)``, in the body's axes.
"""

from dataclasses import dataclass

import numpy as np
import oracle
from oracle import cross, matrix_of
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from stone_oracle import SMOOTHING, contact


@dataclass(frozen=True)
class Shaken:
    """A drive, and the losses beside it."""

    frequency: float
    acceleration: float
    phase: float = 0.0
    sigma: float = 0.0
    rolling: float = 0.0
    pivot: float = 0.0

    def weight(self, t):
        """Return the weight at a time."""
        return 1 + self.acceleration * np.cos(self.frequency * t + self.phase)


def motion(t, y, body, drive):
    """Return the angular acceleration, the contact force and the two powers."""
    u = y[:3]
    w = y[3:6]
    weight = drive.weight(t)
    r, dr = contact(u, cross(u, w), body)
    inertia = oracle.matrices(body)[2]
    across = w - (u @ w) * u
    rubbing = drive.rolling * across / np.sqrt(across @ across + SMOOTHING**2)
    rubbing = rubbing + drive.pivot * np.sign(u @ w) * u
    left = np.zeros((6, 6))
    right = np.zeros(6)
    # dv/dt of v = r x omega in space is F - weight u.
    left[:3, :3] = matrix_of(r)
    left[:3, 3:] = -np.eye(3)
    right[:3] = -weight * u - cross(dr, w) - cross(w, cross(r, w))
    # I domega/dt + omega x I omega = r x F - sigma omega - (F.u) rubbing
    left[3:, :3] = inertia
    left[3:, 3:] = -matrix_of(r) + np.outer(rubbing, u)
    right[3:] = -cross(w, inertia @ w) - drive.sigma * w
    solution = np.linalg.solve(left, right)
    force = solution[3:]
    plane = -(weight - 1) * (u @ cross(r, w))
    lost = -drive.sigma * (w @ w) - (force @ u) * (rubbing @ w)
    return solution[:3], force, (plane + lost, plane)


def rhs(t, y, body, drive):
    """Return the rates of the state."""
    acceleration, _, powers = motion(t, y, body, drive)
    return np.concatenate([cross(y[:3], y[3:6]), acceleration, powers])


def normal_force(t, y, body, drive):
    """Return the normal force."""
    return motion(t, y, body, drive)[1] @ y[:3]


def follow(body, u, omega, t_end, drive, tol=1e-12):
    """Return SciPy's solution from a state; it ends where the body lifts off."""

    def lifts(t, y):
        return normal_force(t, y, body, drive)

    lifts.terminal = True
    y0 = np.concatenate([u, omega, [0.0, 0.0]])
    return solve_ivp(
        lambda t, y: rhs(t, y, body, drive),
        (0, t_end),
        y0,
        "DOP853",
        dense_output=True,
        events=lifts,
        rtol=tol,
        atol=1e-4 * tol,
        # A run at rest must notice the drive.
        max_step=0.25 * 2 * np.pi / max(drive.frequency, 1.0),
    )


def first_zero(found, samples=40_000):
    """Return the first zero of the spin after the launch, or None."""
    times = np.linspace(0, found.t[-1], samples)[1:]
    y = found.sol(times)
    n = (y[:3] * y[3:6]).sum(axis=0)
    changes = np.flatnonzero(n[1:] * n[:-1] < 0)
    if not changes.size:
        return None

    def spin(t):
        at = found.sol(t)
        return at[:3] @ at[3:6]

    return brentq(spin, times[changes[0]], times[changes[0] + 1], xtol=1e-14)
