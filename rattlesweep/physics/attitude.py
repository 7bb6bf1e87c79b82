"""Attitude and track: where the body points and where it touches the plane.

The heading is the angle of the horizontal part ``h_1`` of the body's x axis from its direction at
the start; with ``h_2 = u x h_1`` and ``u`` it spans a frame that never degenerates while the body
stands on its lower surface.  The plane's axes are ``h_1, h_2`` at the start, and its origin the
first point of contact.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.physics.full import scalar

if TYPE_CHECKING:
    from rattlesweep.arrays import Floats

# Heading and the two co-ordinates of the contact point on the plane.
N_EXTRA = 3


@scalar
def track(p, q, a, b, c, heading, fx, fy, rise, wx, wy, wz, uz):  # type: ignore[no-untyped-def]
    """Return the rates of the heading and of the contact point on the plane.

    The x axis ``e`` moves with ``omega x e``; the vertical part of ``e x (omega x e)`` over
    ``1 - e_vertical^2`` is the heading's rate.  The contact point moves with the dotted derivative
    of ``r`` plus ``v`` (Eq. no-slip), which is horizontal.
    """
    uy = q * uz
    square = uy * uy + uz * uz
    root = sqrt(square)
    turn = (uy * b + uz * c) / square
    x, y, z = p + fx, q + fy, 1.0 - rise
    # dr/dt = r x omega - w
    xd = y * c - z * b - wx
    yd = z * a - x * c - wy
    zd = x * b - y * a - wz
    first = xd / root
    second = (yd * uz - zd * uy) / root
    cosine, sine = cos(heading), sin(heading)
    return turn, cosine * first - sine * second, sine * first + cosine * second


def quaternion(u: Floats, heading: Floats) -> Floats:
    """Return the attitude as unit quaternions, shape (4, ...), the scalar first, without jumps.

    They turn components in the body's frame, where the vertical is `u`, shape (3, ...), into those
    along the plane's axes and the vertical.  The heading is in radians, of any number of turns.
    """
    ux, uy, uz = u
    root = np.sqrt(uy * uy + uz * uz)
    # Rows h_1, h_2, u of the turn at heading zero, root and h_2y = uz / root on its diagonal.
    # Near the upright position it is half a turn about x, so that q1 is the safe pivot.
    h2y, h2z = uz / root, -uy / root
    pivot = 0.5 * np.sqrt(1 + root - h2y - uz)
    w = (uy - h2z) / (4 * pivot)
    y = -ux * uy / root / (4 * pivot)
    z = (ux - ux * uz / root) / (4 * pivot)
    cosine, sine = np.cos(heading / 2), np.sin(heading / 2)
    first = cosine * w - sine * z, cosine * pivot - sine * y
    return np.stack([*first, cosine * y + sine * pivot, cosine * z + sine * w])
