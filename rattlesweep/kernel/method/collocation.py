"""Collocation at Radau's points: Radau IIA methods of any number of stages.

The solution over a step is the polynomial that satisfies the differential equation at
the points; the last point is the end of the step, so that stiff components are damped
at once (Hairer and Wanner, Solving Ordinary Differential Equations II, Sec. IV.5).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from rattlesweep.arrays import Floats

STAGES = 5  # of the method by which bodies slide


class Collocation(NamedTuple):
    """Coefficients of a method of order ``2 s - 1`` with ``s`` stages."""

    points: Floats  # c, shape (s,), as fractions of the step
    integrals: Floats  # a, shape (s, s): from derivatives to changes at the points
    # Shape (s, s): from derivatives to their coefficients in Legendre's polynomials.
    spectrum: Floats


def radau(stages: int) -> Collocation:
    """Return the coefficients of a Radau IIA method."""
    # The points are the zeros of P_s - P_(s-1) on (-1, 1].
    series = np.zeros(stages + 1)
    series[stages] = 1.0
    series[stages - 1] = -1.0
    derivative = legendre.legder(series)
    points = np.sort(legendre.legroots(series).real)
    for _ in range(3):
        points -= legendre.legval(points, series) / legendre.legval(points, derivative)
    points[-1] = 1.0
    values = legendre.legvander(points, stages - 1)
    spectrum: Floats = np.linalg.inv(values).astype(np.float64)
    moments = np.empty((stages, stages))
    for k in range(stages):
        term = legendre.Legendre.basis(k).integ(lbnd=-1)
        moments[:, k] = 0.5 * term(points)
    return Collocation(0.5 * (points + 1.0), moments @ spectrum, spectrum)
