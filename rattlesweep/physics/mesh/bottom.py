"""The bottom of a mesh near its foot: a quadric through points of the convex hull.

A quadric whose lowest point is at the height ``z0`` satisfies

    z - z0 = b.x + x.K.x / 2 + (z - z0) n.x + k (z - z0)^2 / 2

with the horizontal place ``x``.  All unknowns but ``z0`` are linear, so a fit by least
squares is exact for ellipsoids and paraboloids, however wide the range.  Where the
slope ``b`` is zero, ``K`` has the principal curvatures, and ``1/k`` is the vertical
semi-axis of an ellipsoid that stands upright.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rattlesweep.arrays import Floats, Integers

UNKNOWNS = 9
LEAST_POINTS = 3 * UNKNOWNS
_BLOCK = 500  # rows that are factorised together
MOST_POINTS = 5000  # more tell nothing that these do not


@dataclass(frozen=True)
class Quadric:
    """A fitted quadric, in m and 1/m, about a place above its lowest point."""

    z0: float
    slope: Floats  # b, shape (2,)
    curvature: Floats  # K, shape (2, 2)
    k: float
    k_error: float  # standard error of k
    lean: Floats  # n, shape (2,)
    reach: float  # height over the lowest point up to which points are fitted
    residuals: Floats  # z of the points less that of the quadric
    fitted: Integers  # places of the points that are fitted

    @property
    def radii(self) -> Floats:
        """The principal radii, the smaller one first; infinite or negative if not
        convex.
        """
        with np.errstate(divide="ignore"):
            radii: Floats = 1 / np.linalg.eigvalsh(self.curvature)[::-1]
        return radii

    @property
    def rms(self) -> float:
        """Root mean square of the residuals in m."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    def height(self, x: Floats) -> Floats:
        """Return z at horizontal places, shape (points, 2)."""
        straight = x @ self.slope + np.einsum("ij,jk,ik->i", x, self.curvature, x) / 2
        tilted = 1 - x @ self.lean
        root = np.sqrt(np.maximum(tilted**2 - 2 * self.k * straight, 0.0))
        return self.z0 + 2 * straight / (tilted + root)


def fit_quadric(points: Floats, weights: Floats, reach: float) -> Quadric | None:
    """Return the quadric through the points up to a height over the lowest one.

    `points` has the shape (n, 3), with z upwards, in no order: the first `MOST_POINTS`
    of those in reach stand for all of them.  None if there are too few points.
    """
    z0 = float(points[:, 2].min())
    found: Quadric | None = None
    # The height of the lowest point enters the terms of the fit.
    for _ in range(12):
        chosen = np.flatnonzero(points[:, 2] - z0 <= reach)[:MOST_POINTS]
        if len(chosen) < LEAST_POINTS:
            return None
        x, y, z = points[chosen].T
        height = z - z0
        terms = np.column_stack(
            [
                *(np.ones(len(x)), x, y, x * x / 2, x * y, y * y / 2),
                *(height * x, height * y, height**2 / 2),
            ]
        )
        sizes = np.abs(terms).max(axis=0)
        root = np.sqrt(weights[chosen] / weights[chosen].mean())
        scaled = terms / sizes * root[:, None]
        # The last column of the triangle has the right side.
        triangle = _triangle(np.column_stack([scaled, height * root]))
        r = triangle[:UNKNOWNS, :UNKNOWNS]
        if np.abs(np.diag(r)).min() < 1e-9 * np.abs(np.diag(r)).max():
            return None  # the points lie on one curve
        solution = np.linalg.solve(r, triangle[:UNKNOWNS, UNKNOWNS])
        misfit = height * root - scaled @ solution
        variance = misfit @ misfit / (len(x) - UNKNOWNS)
        k_error = np.sqrt(variance) * np.abs(np.linalg.inv(r)[-1]).max() / sizes[-1]
        offset, bx, by, kxx, kxy, kyy, nx, ny, k = solution / sizes
        z0 += offset
        found = Quadric(
            z0=z0,
            slope=np.array([bx, by]),
            curvature=np.array([[kxx, kxy], [kxy, kyy]]),
            k=float(k),
            k_error=float(k_error),
            lean=np.array([nx, ny]),
            reach=reach,
            residuals=height - terms @ (solution / sizes),
            fitted=chosen,
        )
        if abs(offset) < 1e-12 * reach:
            break
    return found


def _triangle(matrix: Floats) -> Floats:
    """Return the triangle R of a QR factorisation of a tall matrix.

    Blocks of rows are factorised first, since threads of BLAS would take longer to meet
    than to factorise one.
    """
    count = -(-len(matrix) // _BLOCK)
    padded = np.zeros((count * _BLOCK, matrix.shape[1]))
    padded[: len(matrix)] = matrix
    triangles = np.asarray(np.linalg.qr(padded.reshape(count, _BLOCK, -1), mode="r"))
    stacked: Floats = triangles.reshape(-1, matrix.shape[1])
    return np.asarray(np.linalg.qr(stacked, mode="r"))


def foot(surface: Quadric, height: float) -> Floats | None:
    """Return where the normal of a surface passes through the centre of mass.

    The centre of mass is at `height` over ``z0`` at x = 0; the result is the horizontal
    place, shape (2,), to first order in the slope.  None if the centre of mass is not
    below both centres of curvature, so that it would tip over.
    """
    # The normal at x has the slope b + K x, and meets the axis if x = a (b + K x).
    matrix = np.eye(2) - height * surface.curvature
    if np.linalg.eigvalsh(matrix).min() <= 0 or surface.radii.min() <= 0:
        return None
    place = np.linalg.solve(matrix, height * surface.slope)
    return np.asarray(place, float)
