"""What a plane that shakes does to a body at rest, by theory, for small oscillations.

A plane that shakes up and down drives Mathieu's first tongue: near twice the frequency
of a mode its amplitude grows.  One that shakes along itself drives resonance: near the
frequency of the mode.  The mode turns the body, and the spin damps the mode that it
comes from, until the growth ends.
"""

import math

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from rattlesweep.arrays import Floats


def growth_of_drive(
    omega: ArrayLike, frequency: ArrayLike, acceleration: ArrayLike
) -> Floats:
    """Return the rate at which a drive makes a mode at rest grow, without losses.

    The mode has the frequency `omega`.  Its amplitude grows at ``sqrt((eps omega /
    4)^2 - Delta^2)``, where ``2 Delta`` is what the frequency of the drive has more
    than ``2 omega``.  Elsewhere the rate is zero.
    """
    of_mode = np.asarray(omega, float)
    strength = np.asarray(acceleration, float) * of_mode / 4
    detuning = np.asarray(frequency, float) / 2 - of_mode
    return np.asarray(np.sqrt(np.maximum(strength**2 - detuning**2, 0.0)))


def driven_spin(
    growth: ArrayLike, damping: ArrayLike, coefficient: ArrayLike
) -> Floats:
    """Return the spin that stops the growth of a mode; NaN where losses are larger.

    `growth` is that of the drive, `damping` that of losses, and ``K n / 2`` with the
    `coefficient` ``K`` that of the spin ``n``: ``K_p`` of the pitch, ``-K_r`` of the
    roll.
    """
    left = np.asarray(growth, float) - np.asarray(damping, float)
    spin = -2 * left / np.asarray(coefficient, float)
    return np.where(left > 0, spin, np.nan)


# Along the plane


def growth_of_push(
    inertia: ArrayLike, angle: ArrayLike, acceleration: ArrayLike
) -> Floats:
    """Return the rate at which the angular velocity of a mode at rest grows.

    A plane that shakes along itself at the frequency of the mode pushes it.  The mode
    has the `inertia` ``J`` about the contact point, and turns the body about a
    horizontal direction at an `angle` to that of the plane's path.  Its amplitude grows
    in proportion to the time, in ``g/a``, until losses or the spin stop it.
    """
    push = np.asarray(acceleration, float) * np.abs(np.sin(angle))
    return np.asarray(push / (2 * np.asarray(inertia, float)))


def spin_of_push(
    omega: ArrayLike,
    frequency: ArrayLike,
    acceleration: ArrayLike,
    inertia: ArrayLike,
    damping: ArrayLike,
    coefficient: ArrayLike,
) -> Floats:
    """Return the spin to which a plane leads that shakes along itself.

    Seen from a body that spins at ``n``, the plane pushes at ``Omega + n`` and ``Omega
    - n``.  With ``Delta = Omega - omega`` and the `damping` ``g`` the mode has the
    energy

        E = (eps^2 / 32 J) sum of 1 / (G^2 + (Delta +- n)^2),    G = g + |K n| / 2,

    and ``2 g J |n| = |K| E``, where the loss ``2 g J`` takes the spin, too.  The result
    is the slowest of the spins at which this holds, NaN without losses.  The
    `coefficient` is that of :func:`driven_spin`.
    """
    detuning = np.asarray(frequency, float) - np.asarray(omega, float)
    push = np.asarray(acceleration, float) / np.asarray(inertia, float)
    given = detuning, np.abs(coefficient) * push**2 / 64, damping, coefficient
    columns = np.broadcast_arrays(*(np.asarray(each, float) for each in given))
    sizes = [_first_balance(*row) for row in zip(*map(np.ravel, columns), strict=True)]
    spins = -np.sign(coefficient) * np.reshape(sizes, columns[0].shape)
    return np.asarray(spins, float)


def _first_balance(
    detuning: float, torque: float, damping: float, coefficient: float
) -> float:
    """Return the smallest ``x > 0`` with ``damping x = torque (1/A + 1/B)``.

    ``A`` and ``B`` are ``(damping + |coefficient| x / 2)^2 + (detuning +- x)^2``.
    """
    if not damping > 0:
        return math.nan
    square = Polynomial([damping, abs(coefficient) / 2]) ** 2
    above = square + Polynomial([detuning, 1.0]) ** 2
    below = square + Polynomial([detuning, -1.0]) ** 2
    balance = Polynomial([0.0, damping]) * above * below - torque * (above + below)
    roots = balance.roots()
    real = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
    if not real.size:
        return math.nan
    return float(real.min())
