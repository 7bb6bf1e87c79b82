"""Claim T6: uniform ellipsoids and their lower halves as rattlebacks.

The surface is ``x^2/c^2 + y^2/b^2 + z^2/a^2 = 1``; here ``a = 1``.  Shapes are given by ``b^2`` and
``c^2``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.paper.claims.claim import EXACT, Claim
from rattlesweep.physics import theory

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

KINDS = ("whole", "half")
# The least c^2 at which the body stands upright: its curvature, c^-2 times the height of the
# centre of mass, must be below 1.
LEAST = {"whole": 1.0, "half": 5 / 8}
BOTTOM = {"whole": -1.0, "half": 0.0}


def shapes(kind: str, samples: int, seed: int = 2017) -> tuple[Floats, Floats]:
    """``b^2`` and ``c^2`` over all that is allowed, ``b^2 > c^2 > LEAST``: a grid and random ones.

    Distances from both borders run from 1e-6 to 1e4 of the border itself, as far as doubles tell
    the two frequencies apart.
    """
    steps = 10.0 ** np.linspace(-6, 4, max(2, int(np.sqrt(samples))))
    grid = [axis.ravel() for axis in np.meshgrid(steps, steps)]
    rng = np.random.default_rng(seed)
    first, second = (np.append(axis, 10.0 ** rng.uniform(-6, 4, samples)) for axis in grid)
    c2 = LEAST[kind] * (1 + first)
    return c2 * (1 + second), c2


def by_slices(kind: str, b2: Floats, c2: Floats) -> dict[str, Floats]:
    """Parameters of the body, its inertia by integration over horizontal slices.

    At height ``z`` the slice is an ellipse of area ``pi b c s`` and mean squares ``s c^2/4`` and
    ``s b^2/4``, ``s = 1 - z^2``; Gauss's rule is exact for these polynomials.
    """
    bottom = BOTTOM[kind]
    node, weight = np.polynomial.legendre.leggauss(6)
    z = (1 + bottom) / 2 + (1 - bottom) / 2 * node
    square = 1 - z**2
    share = weight * square / np.sum(weight * square)
    centre = float(np.sum(share * z))
    xx, yy = c2 * np.sum(share * square) / 4, b2 * np.sum(share * square) / 4
    zz = np.sum(share * (z - centre) ** 2)
    height = 1 - centre
    return {
        "alpha": (yy + zz) / height**2 + 1,
        "beta": (xx + zz) / height**2 + 1,
        "gamma": (xx + yy) / height**2,
        # The surface has the curvatures 1/c^2 and 1/b^2 at the bottom.
        "theta": height / c2,
        "phi": height / b2,
    }


def square_difference(kind: str, b2: Floats, c2: Floats) -> Floats:
    """``omega_p0^2 - omega_r0^2`` in closed form, a positive number times ``b^2 - c^2``."""
    if kind == "whole":
        # f(s) = 5 (s - 1)/(s + 6)
        return 35 * (b2 - c2) / ((b2 + 6) * (c2 + 6))
    # f(s) = (25/16) (8 s - 5)/(4 s + 9)
    return 25 / 16 * 92 * (b2 - c2) / ((4 * b2 + 9) * (4 * c2 + 9))


def ellipsoids(samples: int) -> Claim:
    """T6: pitch faster than roll for uniform ellipsoids and their lower halves."""
    least, formula, count = np.inf, 0.0, 0
    for kind in KINDS:
        b2, c2 = shapes(kind, samples)
        body = by_slices(kind, b2, c2)
        found = theory.modes(body["alpha"], body["beta"], body["theta"], body["phi"], 0.0)
        pitch, roll = found.omega_p0**2, found.omega_r0**2
        least = min(least, float(np.min(pitch / roll - 1)))
        exact = square_difference(kind, b2, c2)
        formula = max(formula, float(np.max(np.abs(pitch - roll - exact) / pitch)))
        count += len(b2)
    return Claim(
        id="T6",
        where="Typical rattleback parameters",
        words="“the pitch frequency is always higher for an ellipsoid with a uniform mass "
        "density” with b^2 > c^2 > a^2, and “for a semi-ellipsoid for b^2 > c^2 > (5/8)a^2”",
        measured=(
            f"{count:,} shapes: smallest omega_p0^2/omega_r0^2 - 1 = {least:.2g}; largest "
            f"deviation of omega_p0^2 - omega_r0^2 from its closed form: {formula:.1g} omega_p0^2"
        ),
        value=least,
        checks=[
            ("pitch faster than roll for every shape", least > 0),
            (
                f"difference of the squared frequencies as in closed form, to {EXACT:g}",
                formula < EXACT,
            ),
        ],
        notes=(
            "Both squared frequencies are given by one function f, of b^2/a^2 and of c^2/a^2: "
            "f(s) = 5(s - 1)/(s + 6), or (25/16)(8s - 5)/(4s + 9) for the half (in units of the "
            "height of its centre of mass). f increases everywhere and vanishes at s = 1 and "
            "s = 5/8, which are the conditions. Closed forms: 35 (b^2 - c^2)/((b^2 + 6)(c^2 + 6)) "
            "and (25/16) 92 (b^2 - c^2)/((4 b^2 + 9)(4 c^2 + 9)). Shapes lie between 1e-6 and "
            "1e4 beyond the conditions; inertia by integration over slices."
        ),
    )
