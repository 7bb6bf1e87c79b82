"""A plane that shakes up and down or along itself, in the frame of the plane.

Its acceleration in units of g is ``A = eps cos(Omega t + phase)`` along the vertical
``u`` or along a horizontal unit vector ``e``.  In its frame gravity swells and fades,
so that the body has the weight ``1 + A``, or the force ``-A e`` acts at its centre of
mass.  About the contact point at ``r`` this force has the torque ``A r x e``.

The state counts the turns of the phase.  What a turn lacks of a whole number is exact
however long the run, so the cosine needs no library call, which loops over lanes could
not vectorise.  The direction ``e`` rests on the plane.  The state has its components
along the axes of the body, which change at the rate ``e x omega`` in any position.
"""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Mapping
from math import pi

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics.friction.sliding import cross
from rattlesweep.physics.full import (
    acceleration,
    contact_point,
    moments,
    scalar,
    slope_rate,
    solve_rates,
    to_vectors,
)
from rattlesweep.physics.stone import dot

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


def first_turns(place: Floats, values: Mapping[str, Floats]) -> tuple[Floats, ...]:
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


# Along the plane


@scalar
def force_of_plane(place, own):
    """Return the force at the centre of mass of a plane that shakes along itself."""
    acceleration_of_plane, _, _, _, turns, ex, ey, ez = own
    force = -acceleration_of_plane * cosine(turns)
    return force * ex, force * ey, force * ez


@scalar
def swayed_rates(place, own):
    """Return the rates of the turns of the phase and of the direction."""
    _, frequency, _, _, _, ex, ey, ez = own
    x, y, z = cross((ex, ey, ez), place.omega)
    return frequency * (0.5 / pi), x, y, z


def first_direction(place: Floats, values: Mapping[str, Floats]) -> tuple[Floats, ...]:
    """Return the turns and the direction at launch.

    `place` has slopes and angular velocities, shape (rows, 5).  The azimuth counts from
    ``h_1``, the horizontal part of the body's x axis, towards ``u x h_1``.
    """
    (ux, uy, uz), _ = to_vectors(place.T)
    root = np.sqrt(uy * uy + uz * uz)
    azimuth = np.asarray(values["base_azimuth"])
    along = np.cos(azimuth)
    across = np.sin(azimuth) / root
    ex = along * root
    ey = across * uz - along * ux * uy / root
    ez = -across * uy - along * ux * uz / root
    return *first_turns(place, values), ex, ey, ez


@scalar
def swayed_rhs(contact, y, inertia, shape, loss):
    """Return what :func:`shaken_rhs` does, of a plane that shakes along itself.

    The direction follows the turns.
    """
    _, _, a, b, c = y[:5]
    sigma, eps, frequency, _, _ = loss
    e = y[8:11]
    dp, dq, m = slope_rate(y)
    touch = contact(y, (dp, dq, m), shape)
    _, _, uz = touch
    lx, ly, lz = -sigma * a, -sigma * b, -sigma * c
    whole, turning, gravity, _ = moments(y, inertia, (lx, ly, lz), touch)
    r = contact_point(y, touch)
    push_x, push_y, push_z = cross(r, e)
    force = eps * cosine(y[7])
    torque = (
        turning[0] + uz * gravity[0] + force * push_x,
        turning[1] + uz * gravity[1] + force * push_y,
        turning[2] + uz * gravity[2] + force * push_z,
    )
    # The torques of gravity and of the force about the contact point are normal to r.
    rates, _ = solve_rates(r, inertia, torque, dot(r, whole))
    plane = force * (push_x * a + push_y * b + push_z * c)
    viscous = -sigma * (a * a + b * b + c * c)
    works = viscous + plane, plane, frequency * (0.5 / pi)
    return (dp, dq) + rates + works + cross(e, (a, b, c))  # noqa: RUF005
