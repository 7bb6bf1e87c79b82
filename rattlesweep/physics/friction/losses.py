"""What losses take from spin, pitch and roll: rates, thresholds, the critical lever.

A small oscillation in a mode with the frequency ``omega`` and the moment ``J`` about
the contact point loses of its energy, a unit of time,

| loss | share |
|---|---|
| a torque ``-sigma omega`` | ``sigma / J`` |
| a slip under ``F_t = -k v`` (viscous) | ``omega^2 / (k J)`` |
| the creep of a patch that pivots | ``abs(n) c l / mu^2`` |

with ``c = 128 omega^2 / (9 pi^2 J)``.

At a spin ``n`` the pitch gains ``K_p n`` of it, and the roll ``-K_r n``.  So the spins
``n_p > 0`` and ``n_r < 0`` of :func:`growing_from` bound those at which neither grows.

Rolling resistance is not linear: see :mod:`rattlesweep.physics.friction.rolling_mean`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rattlesweep.arrays import Floats


def share_of_couple(moment: Floats, sigma: ArrayLike) -> Floats:
    """Return the share of its energy that a mode loses to a torque ``-sigma omega``."""
    return np.asarray(np.asarray(sigma, float) / moment)


def share_of_slip(omega: Floats, moment: Floats, viscous: ArrayLike) -> Floats:
    """Return the share that a mode loses to a slip under ``-viscous v``; 0: no slip."""
    k = np.asarray(viscous, float)
    inverse = np.zeros(k.shape)
    np.divide(1.0, k, out=inverse, where=k > 0)
    return np.asarray(omega**2 / moment * inverse)


def creep_factor(omega: Floats, moment: Floats) -> Floats:
    """Return ``c``: creep takes the share ``abs(n) c l / mu^2`` of a mode's energy."""
    return np.asarray(128 / (9 * np.pi**2) * omega**2 / moment)


def share_of_creep(
    omega: Floats, moment: Floats, pivot: ArrayLike, creep: ArrayLike
) -> Floats:
    """Return ``c l / mu^2`` of the lever `pivot` and the friction `creep`.

    Without creep (a coefficient of zero) the patch does not give way, and it is zero.
    """
    mu = np.asarray(creep, float)
    shape = np.broadcast(mu, np.asarray(pivot)).shape
    ratio = np.zeros(shape)
    np.divide(np.asarray(pivot, float), mu * mu, out=ratio, where=mu > 0)
    return np.asarray(creep_factor(omega, moment) * ratio)


def less_creep(K: Floats, creep: Floats) -> Floats:
    """Return what creep leaves of a coefficient, whose sign may be any."""
    return np.asarray(K - np.sign(K) * creep)


def critical_lever(
    K_r: Floats, omega_r: Floats, moment: Floats, creep: ArrayLike
) -> Floats:
    """Return the lever above which no steady spin reverses, NaN without creep.

    There creep takes as much of the roll at each spin as the spin gives it.
    """
    mu = np.asarray(creep, float)
    lever = np.abs(K_r) * mu * mu / creep_factor(omega_r, moment)
    return np.where(mu > 0, lever, np.nan)


def growth_of_mode(K: Floats, n: ArrayLike, share: Floats, creep: Floats) -> Floats:
    """Return the growth rate of an amplitude at a small spin.

    `K` is that of the pitch, or ``-K_r``.  `share` is lost at any spin, and ``abs(n)
    creep`` by creep.
    """
    spin = np.asarray(n, float)
    return np.asarray((K * spin - share - np.abs(spin) * creep) / 2)


def growing_from(K: Floats, share: Floats, creep: Floats) -> Floats:
    """Return the spin beyond which a mode grows, NaN if creep takes all that it gains.

    `K` is that of the pitch, or ``-K_r``; the spin has its sign.
    """
    gain = np.asarray(np.abs(K) - creep, float)
    spin = np.full(np.broadcast(gain, share).shape, np.nan)
    np.divide(share, gain, out=spin, where=gain > 0)
    # Without a share it is zero, and not -0.
    return np.asarray(np.sign(K) * spin + 0.0)


def least_growing(rate: Floats, moment: Floats, rolling: ArrayLike) -> Floats:
    """Return the amplitude of oscillation above which rolling resistance is outgrown.

    `rate` is the growth rate of a mode without it, which oscillates alone.  NaN where
    no oscillation grows.
    """
    lever = np.asarray(rolling, float)
    least = np.full(np.broadcast(lever, rate).shape, np.nan)
    # d(J h^2 / 2)/dt = 2 rate (J h^2 / 2) - (2/pi) lever h.
    np.divide(2 / np.pi * lever, rate * moment, out=least, where=np.asarray(rate) > 0)
    return least
