"""Coulomb's law over Hertz's pressure on a circle that slides and turns, closed form.

The radius of the circle is ``e``, its slip ``v`` and its spin ``n``.  This module does
not import `rattlesweep`.
"""

import math

import numpy as np
from scipy.optimize import brentq

# With |n| < SERIES v/e the closed form loses digits.
SERIES = 0.5
TERMS = 40


def sliding_share(x):
    """Return ``F / (mu N)`` of Hertz's patch at ``x = v / (e |n|)``."""
    if x <= 1:
        return 3 * math.pi / 32 * (4 * x - x**3)
    if x >= 1 / SERIES:
        return 3 / 16 * series(FORCE_TERMS, 1 / x)
    s = math.asin(1 / x)
    w = math.sqrt(x * x - 1)
    return 3 / (16 * x) * ((4 * x**2 - x**4) * s + w * (x**2 + 2))


def turning_share(x):
    """Return ``M / (mu N e)`` of Hertz's patch at ``x = v / (e |n|)``."""
    if x <= 1:
        return 3 * math.pi / 16 * (1 - x**2 + 3 * x**4 / 8)
    if x >= 1 / SERIES:
        return 3 / 16 * series(MOMENT_TERMS, 1 / x) / x
    s = math.asin(1 / x)
    w = math.sqrt(x * x - 1)
    return 3 / 16 * ((2 - 2 * x**2 + 3 * x**4 / 4) * s + w * (6 - 3 * x**2) / 4)


def expansions():
    """Return the coefficients of both closed forms in ``1 / x^2``.

    ``asin z`` is the sum of ``a_k z^(2k+1)`` and ``sqrt(1 - z^2)`` that of
    ``b_k z^2k``.
    """
    a = []
    b = []
    central = 1.0  # (2k)! / (4^k k!^2)
    for k in range(TERMS + 2):
        a.append(central / (2 * k + 1))
        b.append(-central / (2 * k - 1))
        central *= (2 * k + 1) / (2 * k + 2)
    force = []
    moment = []
    for k in range(TERMS):
        force.append(4 * a[k] - a[k + 1] + b[k + 1] + 2 * b[k])
        turning = 2 * a[k] - 2 * a[k + 1] + 3 * a[k + 2] / 4
        moment.append(turning + (6 * b[k + 1] - 3 * b[k + 2]) / 4)
    return force, moment


FORCE_TERMS, MOMENT_TERMS = expansions()


def series(terms, z):
    """Return the sum of ``terms[k] z^2k``."""
    total = 0.0
    for term in reversed(terms):
        total = term + z * z * total
    return total


def rubbing(y):
    """Return ``q``, the torque of a foot that slides over ``-l N``, and its slope.

    ``y`` is ``e n / v``.
    """
    size = abs(y)
    if size < SERIES:
        slopes = [(2 * k + 1) * term for k, term in enumerate(MOMENT_TERMS)]
        return y * series(MOMENT_TERMS, y) / math.pi, series(slopes, y) / math.pi
    x = 1 / size
    value = turning_share(x) * 16 / (3 * math.pi)
    if x <= 1:
        slope = -2 * x + 1.5 * x**3
    else:
        s = math.asin(size)
        w = math.sqrt(x * x - 1)
        slope = ((3 * x**3 - 4 * x) * s - w * (3 * x - 2 / x)) / math.pi
    return math.copysign(value, y), -slope * x * x


def rubbing_of(y):
    """Return ``q`` of a number, of an array, or of a complex step."""
    if isinstance(y, float):
        return rubbing(y)[0]
    values, slopes = np.vectorize(rubbing)(np.real(y))
    return values + slopes * (y - np.real(y))


def ratio_of(share):
    """Return the ``y`` with ``q(y) = share``; ``|share| < 1``."""

    def excess(log):
        return rubbing(math.exp(log))[0] - abs(share)

    if share == 0:
        return 0.0
    log = brentq(excess, math.log(abs(share)), 25.0, xtol=1e-14)
    return math.copysign(math.exp(log), share)
