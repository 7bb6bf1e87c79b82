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

    from rattlesweep.arrays import Floats

    Complexes = NDArray[np.complex128]

# Of the way, in n^2, from the steady spin to its threshold: spins at which both modes must decay.
POSSIBLE = (0.0, 0.25, 0.5)
MOST_SLOPE = 0.1


def matrix(constants: Floats, n: ArrayLike, sigma: ArrayLike = 0.0) -> Floats:
    """Matrix of the linear system.

    Parameters
    ----------
    constants : ndarray, shape (6, ...)
        Of :func:`rattlesweep.physics.full.constants`.
    n : array_like
        Steady spin, in ``sqrt(g/a)``.
    sigma : array_like
        Of the torque ``-sigma omega``.  The spin itself then falls at the rate ``sigma / gamma``,
        which the matrix knows; its eigenvalues are rates for as long as that is slow.

    Returns
    -------
    ndarray, shape (..., 4, 4)
        Acting on ``(p, q, omega_x, omega_y)``.
    """
    ix, iy, iz, cxx, cxy, cyy, c, loss = np.broadcast_arrays(
        *constants, -np.asarray(n, float), np.asarray(sigma, float)
    )
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
    # Eq. diff-omega to first order: gyroscopic, contact point, gravity, the falling spin.
    fall = -loss * c / iz
    x = np.stack([one, zero, zero, zero]) + fx
    y = np.stack([zero, one, zero, zero]) + fy
    da = ((iy - iz) * c * b - c * wx - fy - loss * a + fall * x) / (ix + 1)
    db = ((iz - ix) * c * a - c * wy + fx - loss * b + fall * y) / (iy + 1)
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


def steady_modes(constants: Floats, n: ArrayLike, sigma: ArrayLike = 0.0) -> SteadyModes:
    """Eigenvalues and left eigenvectors at spin ``n``; the pitch is the faster mode.

    Parameters
    ----------
    constants : ndarray, shape (6, ...)
    n : array_like
        Steady spin.
    sigma : array_like
        As for :func:`matrix`.
    """
    values, vectors = np.linalg.eig(np.swapaxes(matrix(constants, n, sigma), -1, -2))
    # Of each conjugate pair the one with positive frequency, the faster pair first; of a pair
    # that no longer oscillates, the one that grows faster.
    order = np.lexsort((-values.real, -values.imag), axis=-1)
    values = np.take_along_axis(values, order, -1).astype(complex)
    vectors = np.take_along_axis(vectors, order[..., None, :], -1).astype(complex)
    return SteadyModes(values[..., 0], values[..., 1], vectors[..., :, 0], vectors[..., :, 1])


def growth(constants: Floats, n: ArrayLike, sigma: ArrayLike = 0.0) -> tuple[Floats, Floats]:
    """Growth rates of the pitch and the roll amplitude at any spin, in ``sqrt(g/a)``."""
    found = steady_modes(constants, n, sigma)
    return found.pitch.real, found.roll.real


def transient_growth(constants: Floats, n: ArrayLike) -> Floats:
    """Bound of how far the energy of an oscillation rises before it decays, 1 or more.

    Modes that are not orthogonal take energy from each other: of ``dx/dt = A x`` with eigenvectors
    ``V`` and no growing mode, ``|x(t)|^2 <= cond(V)^2 |x(0)|^2`` (Trefethen and Embree, Spectra and
    Pseudospectra, 2005, sec. 14).  The norm is that of :func:`full.oscillation`, in which each mode
    has length 1.

    Parameters
    ----------
    constants : ndarray, shape (6, ...)
    n : array_like
        Steady spin, in ``sqrt(g/a)``.
    """
    ix, iy = constants[:2]
    norm = np.zeros((*np.shape(ix), 4, 4))
    norm[..., :2, :2] = _curvature(constants)
    norm[..., 2, 2], norm[..., 3, 3] = ix + 1, iy + 1
    root = np.swapaxes(np.linalg.cholesky(norm), -1, -2)
    _, vectors = np.linalg.eig(root @ matrix(constants, n) @ np.linalg.inv(root))
    sizes = np.linalg.svd(vectors, compute_uv=False)
    with np.errstate(divide="ignore"):
        bound: Floats = (sizes[..., 0] / sizes[..., -1]) ** 2
    return bound


def settled_oscillation(constants: Floats, n_0: Floats, n_c: Floats, rate: Floats) -> Floats:
    """Oscillation from which on a run only decays towards its steady spin; 0 where none is safe.

    All energy that a run has is spin in the end, ``n_0``, if the oscillation decays.  At this
    energy the steady spin is a fixed point; around it the equations are odd in the oscillation, so
    that what linear theory leaves out is of third order.  Decay is certain while

    - both modes decay, the pitch twice as fast as the roll at least, at every spin that the
      oscillation's energy may still lead to: down to half-way, in ``n^2``, from ``n_0`` to the
      threshold ``n_c``;
    - the energy that the oscillation may rise to, by :func:`transient_growth`, leads no farther,
      and is not enough to lean the body by a slope of ``1/sqrt(2)`` in the direction easiest to;
    - now that slope is 0.1 at most: the amplitude of a mode is known to its square.

    Docs/types.md says how far on the safe side this is.

    Parameters
    ----------
    constants : ndarray, shape (6, runs)
    n_0 : ndarray
        Spin that would hold all the energy, with its sign.
    n_c : ndarray
        Threshold of stability (:func:`theory.bondi_threshold`), with its sign; NaN where there is
        none.
    rate : ndarray
        Least rate that counts as decay, positive, in ``sqrt(g/a)``.

    Returns
    -------
    ndarray
        As :func:`full.oscillation` measures it, twice an energy, in ``M g a``.
    """
    settled = np.zeros(len(n_0))
    place = np.flatnonzero((n_0 * n_c > 0) & (np.abs(n_0) > np.abs(n_c)) & np.isfinite(rate))
    constants, n_0, n_c, rate = constants[:, place], n_0[place], n_c[place], rate[place]
    square = n_0**2 - n_c**2
    certain = np.ones(len(place), dtype=bool)
    for share in POSSIBLE:
        pitch, roll = growth(constants, np.copysign(np.sqrt(n_0**2 - share * square), n_0))
        certain &= (pitch < 2 * roll) & (roll < -rate)
    constants, square, place = constants[:, certain], square[certain], place[certain]
    lean = np.linalg.eigvalsh(_curvature(constants))[..., 0]
    later = POSSIBLE[-1] * np.minimum(constants[2] * square, lean)
    rise = transient_growth(constants, n_0[certain])
    settled[place] = np.minimum(later / rise, MOST_SLOPE**2 * lean)
    return settled


def _curvature(constants: Floats) -> Floats:
    """Matrix ``C``, shape (..., 2, 2): what a slope ``(p, q)`` costs, twice the energy."""
    _, _, _, cxx, cxy, cyy = constants
    return np.stack([np.stack([cxx, cxy], -1), np.stack([cxy, cyy], -1)], -2)
