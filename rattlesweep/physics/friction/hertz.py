"""Hertz's contact of a smooth elastic body that rests on a plane, in SI units.

With the principal radii of curvature ``R_1 > R_2`` at the bottom, ``A = 1/(2 R_1)``
and ``B = 1/(2 R_2)``, the patch is an ellipse of half axes ``a > b = k a``.  Its
pressure is ``p_0 sqrt(1 - x^2/a^2 - y^2/b^2)`` (K. L. Johnson, Contact Mechanics, 1985,
section 4.2).  With the complete elliptic integrals K and E of the modulus ``e``, where
``e^2 = 1 - k^2``,

    B/A = (E/k^2 - K)/(K - E),        a^3 = 3 N (K - E)/(2 pi E* e^2 A),
    p_0 = 3 N/(2 pi a b),             approach = 3 N K/(2 pi E* a).

The mean distance from the middle, weighted by the pressure, is ``<r> = 3 a E/8``.
"""

from math import cbrt, exp, log, pi
from typing import NamedTuple


class Ellipse(NamedTuple):
    """A patch of contact: half axes, approach and mean radius in m, pressure in Pa."""

    long_half_axis: float
    short_half_axis: float
    peak_pressure: float
    approach: float
    mean_radius: float


def ellipse(force: float, radii: tuple[float, float], modulus: float) -> Ellipse:
    """Return the patch of contact under a normal force.

    Parameters
    ----------
    force : float
        Normal force in N.
    radii : two floats
        Principal radii of curvature in m, in any order.
    modulus : float
        Contact modulus ``E*`` in Pa.
    """
    # SciPy takes long to import.
    from scipy.optimize import brentq
    from scipy.special import elliprd, elliprf, elliprg

    smaller, larger = sorted(radii)
    log_ratio = log(larger / smaller)

    # Carlson's integrals, as K - E and E/k^2 - K lose all digits near the circle.
    def excess(log_k: float) -> float:
        k_squared = exp(2 * log_k)
        both = elliprd(0.0, 1.0, k_squared) / elliprd(0.0, k_squared, 1.0)
        return log(both) - log_ratio

    # The patch is less slender than the radii.  The unit keeps the signs apart for
    # equal radii.
    log_k = brentq(excess, -log_ratio - 1, 1.0, xtol=1e-16)
    k_squared = exp(2 * log_k)
    first = float(elliprf(0.0, k_squared, 1.0))  # K
    second = 2 * float(elliprg(0.0, k_squared, 1.0))  # E
    slope = float(elliprd(0.0, k_squared, 1.0)) / 3  # (K - E)/e^2
    long = cbrt(3 * force * slope * larger / (pi * modulus))
    short = exp(log_k) * long
    return Ellipse(
        long_half_axis=long,
        short_half_axis=short,
        peak_pressure=1.5 * force / (pi * long * short),
        approach=1.5 * force * first / (pi * modulus * long),
        mean_radius=0.375 * long * second,
    )
