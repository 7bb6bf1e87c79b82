"""Linear stability of the steady vertical spin, exact in the spin.

Around ``u = (0, 0, -1)``, ``omega = (0, 0, -n)`` the slope and the horizontal angular velocity
``(p, q, omega_x, omega_y)`` obey a linear system with constant coefficients.  Its eigenvalues are
the growth rates and frequencies at any spin; their limit for small ``n`` is the theory of Case and
Jalal, and their real part vanishes at Bondi's threshold.  Its left eigenvectors measure the
amplitude of one mode alone, free of the beat with the other and of its own
oscillation, which is what the types R, SS and SW need to see a slow growth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]


def matrix(constants: Floats, n: ArrayLike) -> Floats:
    """Matrix of the linear system.

    Parameters
    ----------
    constants : ndarray, shape (6, ...)
        Of :func:`rattlesweep.physics.full.constants`.
    n : array_like
        Steady spin, in ``sqrt(g/a)``.

    Returns
    -------
    ndarray, shape (..., 4, 4)
        Acting on ``(p, q, omega_x, omega_y)``.
    """
    ix, iy, iz, cxx, cxy, cyy, c = np.broadcast_arrays(*constants, -np.asarray(n, float))
    zero, one = np.zeros_like(ix), np.ones_like(ix)
    # Rows as coefficients of (p, q, a, b); Eq. diff-u first.
    dp = np.stack([zero, c, zero, -one])
    dq = np.stack([-c, zero, one, zero])
    # w = r x omega - dr/dt to first order, with r_perp = (1 + C)(p, q).
    fx = np.stack([cxx, cxy, zero, zero])
    fy = np.stack([cxy, cyy, zero, zero])
    wx = fy * c - (cxx * dp + cxy * dq)
    wy = -fx * c - (cxy * dp + cyy * dq)
    a = np.stack([zero, zero, one, zero])
    b = np.stack([zero, zero, zero, one])
    # Eq. diff-omega to first order: gyroscopic, contact point, gravity.
    da = ((iy - iz) * c * b - c * wx - fy) / (ix + 1)
    db = ((iz - ix) * c * a - c * wy + fx) / (iy + 1)
    rows = np.stack([dp, dq, da, db])
    return np.moveaxis(rows, (0, 1), (-2, -1))


@dataclass(frozen=True)
class SteadyModes:
    """Modes of the steady spin.

    Attributes
    ----------
    pitch, roll : ndarray of complex
        Eigenvalues: growth rate plus i times the frequency, in ``sqrt(g/a)``.
    pitch_probe, roll_probe : ndarray of complex, shape (..., 4)
        Left eigenvectors: the amplitude of a mode is the modulus of the product with
        ``(p, q, omega_x, omega_y)``.
    """

    pitch: Complexes
    roll: Complexes
    pitch_probe: Complexes
    roll_probe: Complexes


def steady_modes(constants: Floats, n: ArrayLike) -> SteadyModes:
    """Eigenvalues and left eigenvectors at spin ``n``; the pitch is the faster mode.

    Parameters
    ----------
    constants : ndarray, shape (6, ...)
    n : array_like
        Steady spin.
    """
    values, vectors = np.linalg.eig(np.swapaxes(matrix(constants, n), -1, -2))
    # Of each conjugate pair the one with positive frequency, the faster pair first; of a pair
    # that no longer oscillates, the one that grows faster.
    order = np.lexsort((-values.real, -values.imag), axis=-1)
    values = np.take_along_axis(values, order, -1).astype(complex)
    vectors = np.take_along_axis(vectors, order[..., None, :], -1).astype(complex)
    return SteadyModes(values[..., 0], values[..., 1], vectors[..., :, 0], vectors[..., :, 1])


def growth(constants: Floats, n: ArrayLike) -> tuple[Floats, Floats]:
    """Growth rates of the pitch and the roll amplitude at any spin, in ``sqrt(g/a)``."""
    found = steady_modes(constants, n)
    return found.pitch.real, found.roll.real
