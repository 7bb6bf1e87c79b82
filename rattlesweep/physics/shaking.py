"""A plane that shakes up and down, as gravity that swells and fades in its frame.

The plane's acceleration is ``-eps cos(Omega t + phase) u`` in units of g, so a body on
it has the weight ``1 + eps cos(Omega t + phase)``.  The state counts the turns of the
phase.  What a turn lacks of a whole number is exact however long the run, so the cosine
needs no library call, which loops over lanes could not vectorise.
"""

# mypy: disable-error-code="no-untyped-def"
from math import pi

import numpy as np

from rattlesweep.physics.full import acceleration, scalar, slope_rate

# Adding this number to a smaller one, and subtracting it, rounds to a whole number.
TO_WHOLE = 6755399441055744.0
# sin(2 pi x) / x for |x| <= 1/4, in powers of x^2: Chebyshev's interpolation, whose
# error is a rounding error.
COEFFICIENTS = (
    6.283185307179586,
    -41.341702240399755,
    81.60524927607362,
    -76.70585975282492,
    42.058693925428685,
    -15.0946416761179,
    3.8199280942271643,
    -0.7177337921413454,
    0.10089695501646812,
)


@scalar
def cosine(turns):
    """Return the cosine of an angle in turns, ``cos(2 pi turns)``."""
    whole = (turns + TO_WHOLE) - TO_WHOLE
    # The cosine is the sine of what the angle lacks of a quarter.
    x = 0.25 - abs(turns - whole)
    s = x * x
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = COEFFICIENTS
    low = a0 + s * (a1 + s * (a2 + s * (a3 + s * a4)))
    high = a5 + s * (a6 + s * (a7 + s * a8))
    square = s * s
    return x * (low + square * square * (s * high))


@scalar
def more_weight(place, own):
    """Return what a plane that shakes adds to the weight 1."""
    acceleration_of_plane, _, _, turns = own
    return acceleration_of_plane * cosine(turns)


@scalar
def turns_rate(place, own):
    """Return the rate of the turns of the phase."""
    _, frequency, _, _ = own
    return (frequency * (0.5 / pi),)


def first_turns(values):
    """Return the turns at launch, from the constants by name."""
    return (np.asarray(values["base_phase"]) / (2.0 * np.pi),)


@scalar
def shaken_rhs(contact, y, inertia, shape, loss):
    """Return the derivative of state, works and turns under ``-sigma omega``, shaken.

    The work of all that acts comes before that of the plane alone.
    """
    p, q, a, b, c = y[:5]
    sigma, eps, frequency, _ = loss
    dp, dq, m = slope_rate(y)
    touch = contact(y, (dp, dq, m), shape)
    more = eps * cosine(y[7])
    torque = -sigma * a, -sigma * b, -sigma * c
    rates, _ = acceleration(y, inertia, torque, touch, 1.0 + more)
    # The torque of gravity about the contact point, as in `full.moments`.
    (fx, fy, rise), _, uz = touch
    gravity = (fy + q * rise) * a - (fx + p * rise) * b + (fx * q - fy * p) * c
    plane = more * uz * gravity
    viscous = -sigma * (a * a + b * b + c * c)
    works = viscous + plane, plane, frequency * (0.5 / pi)
    return (dp, dq) + rates + works  # noqa: RUF005
