"""What rolling resistance takes of pitch and roll, averaged over their phases.

Rolling resistance with the lever ``l`` takes ``l abs(h)`` of the energy a unit of time,
for the angular velocity ``h`` in the plane.  The mean of this over the phases of pitch
and roll is ``l G(x, y)``, where ``x > y`` are the amplitudes of ``h`` in both modes.
With ``t = y / x`` and the angle between the modes, whose cosine is ``c``,

    G / x = 2/pi + t^2 (1 - c^2) / (2 pi) (ln(8 / t) - ln(1 - c^2) / 2)
            + t^2 c^2 / (2 pi) + O(t^4 ln t),

and each mode loses ``l x dG/dx``.  The last term makes ``G(1, 1)`` right; with it the
error of ``G`` is at most 1.3e-4 for ``c^2`` up to 0.6.
"""

# mypy: disable-error-code="no-untyped-def"
from math import log, pi, sqrt

from rattlesweep.physics.full import scalar

# Coefficients of c^0, c^2, c^4 and c^6 in G(1, 1), for c^2 up to 0.7.
EQUAL_MODES = (0.95815157, -0.08413528, -0.0086043, -0.03344365)
# The resistance is l h / sqrt(h^2 + eps^2).  For oscillations far below eps, the means
# are right if eps times this counts as a part of both amplitudes.
SMOOTHED = EQUAL_MODES[0]


@scalar
def larger_by_smaller(t, overlap):
    """Return ``G / x`` of the head of this module, and its derivative times ``t``."""
    apart = max(1.0 - overlap, 1e-9)
    square = t * t
    level = log(t)
    bend = (apart * (log(8.0) - 0.5 * log(apart)) + overlap) / (2.0 * pi)
    steep = -apart / (2.0 * pi)
    a, b, c, d = EQUAL_MODES
    equal = a + overlap * (b + overlap * (c + overlap * d))
    # At t = 1 both modes lose the same.
    more = equal - 2.0 / pi - bend
    slope = 0.5 * equal - 2.0 * bend - steep - 4.0 * more
    near = bend + steep * level
    far = more + slope * level
    value = 2.0 / pi + square * (near + square * far)
    rise = square * (2.0 * near + steep + square * (4.0 * far + slope))
    return value, rise


@scalar
def rolling_losses(x, y, overlap, eps):
    """Return what rolling resistance takes of pitch and roll, per unit of its lever.

    ``x`` and ``y`` are the amplitudes of the angular velocity in both modes,
    ``overlap`` the squared cosine of the angle between them, ``eps`` the smoothing.
    """
    small = (SMOOTHED * eps) * (SMOOTHED * eps)
    pitch = sqrt(x * x + small)
    roll = sqrt(y * y + small)
    is_pitch = pitch >= roll
    large = pitch if is_pitch else roll
    less = roll if is_pitch else pitch
    value, rise = larger_by_smaller(less / large, overlap)
    # Of the whole amplitudes the modes lose x dG/dx, of which eps is no part.
    of_large = (value - rise) / large
    of_less = rise * large / (less * less)
    of_pitch = of_large if is_pitch else of_less
    of_roll = of_less if is_pitch else of_large
    return of_pitch * x * x, of_roll * y * y
