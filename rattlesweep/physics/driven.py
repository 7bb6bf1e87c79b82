"""What a plane that shakes does to a body at rest, by theory, for small oscillations.

Mathieu's first tongue: a drive near twice the frequency of a mode makes its amplitude
grow.  The mode turns the body, and the spin damps the mode that it comes from, until
the growth ends.
"""

import numpy as np
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
