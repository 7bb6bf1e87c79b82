"""The energies of pitch and roll in the full dynamics, as compiled functions.

:func:`rattlesweep.physics.readings.mode_energies` has the same for arrays.
"""

# mypy: disable-error-code="no-untyped-def"
from math import atan2, cos, pi, sin, sqrt

from rattlesweep.physics.full import scalar


@scalar
def energies_of_modes(slope, rate, constants):
    """Return the energies of pitch and roll, weights, and the period of the roll.

    ``rate`` is the angular velocity in the plane.  The weights are the inverse squared
    frequencies, to which ``1/K_p`` and ``1/K_r`` are in proportion.
    """
    ix, iy, _, cxx, cxy, cyy = constants[:6]
    alpha = ix + 1.0
    beta = iy + 1.0
    # The matrix of Eq. 22: a rotation (q, -p) tilts the body.
    h11 = cyy / alpha
    h12 = -cxy / sqrt(alpha * beta)
    h22 = cxx / beta
    split = sqrt((h11 - h22) * (h11 - h22) + 4.0 * h12 * h12)
    square_p = 0.5 * (h11 + h22 + split)
    square_r = (h11 * h22 - h12 * h12) / square_p
    chi = 0.5 * atan2(2.0 * h12, h11 - h22)
    c = cos(chi)
    s = sin(chi)
    vx = sqrt(alpha) * rate[0]
    vy = sqrt(beta) * rate[1]
    tx = sqrt(alpha) * slope[1]
    ty = -sqrt(beta) * slope[0]
    speed = c * vx + s * vy
    tilt = c * tx + s * ty
    pitch = 0.5 * (speed * speed + square_p * tilt * tilt)
    speed = c * vy - s * vx
    tilt = c * ty - s * tx
    roll = 0.5 * (speed * speed + square_r * tilt * tilt)
    period = 2.0 * pi / sqrt(square_r)
    return pitch, roll, 1.0 / square_p, 1.0 / square_r, period
