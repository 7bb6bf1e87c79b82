"""Quantities read off states: contact point, energies of the modes, needed friction.

They are NumPy formulas for time series and for single bodies; those that the kernels
need are compiled in `full` and `stone`.
"""

from typing import NamedTuple

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics.theory import Modes, inertia_along

_STEEPEST = 1e3  # slope up to which a body is tilted to find its turning point


class Shape(NamedTuple):
    """The constants of a surface, and of an ellipsoid ``k = 1/c``."""

    cxx: Floats | float
    cxy: Floats | float
    cyy: Floats | float
    k: Floats | float = 0.0


def placed_contact(p: Floats, q: Floats, shape: Shape) -> Floats:
    """Return the contact point from the centre of mass (Eqs. 4 and 8), shape (3, ...).

    The surface is a paraboloid or an ellipsoid.
    """
    cxx, cxy, cyy, k = shape
    x = p + cxx * p + cxy * q
    y = q + cxy * p + cyy * q
    square = x * p + y * q
    rho = np.sqrt(1 + k * square)
    return np.array([x / rho, y / rho, 1 - square / (rho + rho**2)])


def mode_energy(
    psi: float | Floats,
    frequency: float | Floats,
    moments: tuple[Floats, Floats],
    slope: tuple[Floats, Floats],
    rate: tuple[Floats, Floats],
) -> Floats:
    """Return the energy of an oscillation in one mode of the body without spin.

    Let ``e`` be the eigenvector of Eq. 23 in the direction `psi`, ``omega`` the angular
    velocity less the spin (`rate`), and ``tilt`` the angle whose rate it is (Eq. 16).
    The energy is ``((e.J^1/2 omega)^2 + omega_j^2 (e.J^1/2 tilt)^2) / 2`` with the
    moments ``J = alpha, beta``.
    """
    alpha, beta = moments
    p, q = slope
    rate_x, rate_y = rate
    x, y = alpha * np.cos(psi), beta * np.sin(psi)
    inertia = inertia_along(alpha, beta, psi)
    speed = x * rate_x + y * rate_y
    tilt = x * q - y * p
    energy: Floats = 0.5 * (speed**2 + (frequency * tilt) ** 2) / inertia
    return energy


def mode_energies(
    modes: Modes,
    moments: tuple[Floats, Floats],
    slope: tuple[Floats, Floats],
    rate: tuple[Floats, Floats],
) -> tuple[Floats, Floats]:
    """Return the energies of pitch and roll; see :func:`mode_energy`."""
    pitch = mode_energy(modes.psi_p, modes.omega_p, moments, slope, rate)
    roll = mode_energy(modes.psi_r, modes.omega_r, moments, slope, rate)
    return pitch, roll


def turning_friction(moments: Floats, shape: Shape, psi: float, energy: float) -> float:
    """Return the friction that rolling needs at the turning point of an oscillation.

    The body, with its principal `moments`, is at rest, tilted about the direction `psi`
    until it has the `energy`.
    There the tangential force of the contact is about the largest of the oscillation:
    in 700 runs of Table I that reverse (|n_i| from 0.1 to 0.3), the largest ratio of
    the forces was 0.93 to 1.00 times this (5 to 95 %).
    The result is NaN if the body cannot hold so much energy.
    """
    # SciPy takes long to import.
    from scipy.optimize import brentq

    direction = np.array([-np.sin(psi), np.cos(psi)])

    def surplus(tilt: float) -> float:
        contact, up = _contact_and_vertical(tilt * direction, shape)
        return float(-contact @ up) - 1 - energy

    if not (np.isfinite(energy) and energy > 0 and surplus(_STEEPEST) > 0):
        return float("nan")
    tilt = float(brentq(surplus, 0.0, _STEEPEST))
    contact, up = _contact_and_vertical(tilt * direction, shape)
    # Eqs. 11 and 1 for a body at rest: the torque of gravity accelerates it.
    inertia = np.diag(moments + contact @ contact) - np.outer(contact, contact)
    acceleration = np.cross(contact, np.linalg.solve(inertia, np.cross(contact, up)))
    lift = acceleration @ up
    tangential = np.linalg.norm(acceleration - lift * up)
    return float(tangential / (1 + lift))


def _contact_and_vertical(slope: Floats, shape: Shape) -> tuple[Floats, Floats]:
    """Return the contact point and the vertical unit vector of a slope."""
    p, q = slope
    up = -np.array([p, q, 1.0]) / np.sqrt(1 + p * p + q * q)
    return placed_contact(p, q, shape), up
