"""Linear stability of the steady vertical spin, exact in the spin.

Around ``u = (0, 0, -1)``, ``omega = (0, 0, -n)`` the slope and the horizontal angular
velocity ``(p, q, omega_x, omega_y)`` obey a linear system.  Its eigenvalues are the
growth rates and frequencies of the two modes; its left eigenvectors measure the
amplitude of one mode alone.

For the slope alone the system is of second order, ``P(lambda) s = 0`` with

    P = [[beta lambda^2 + d_p lambda + k_pp,  g_p lambda + k_pq],
         [g_q lambda + k_qp,  alpha lambda^2 + d_q lambda + k_qq]],

and ``det P`` is a product of two real quadratics, one for each mode.  Their linear
coefficients are minus twice the growth rates, so that small growth rates are found as
small numbers.

All arithmetic is on real numbers and rounds in one way only, as IEEE 754 prescribes.
Products of complex numbers in NumPy are fused on some processors, and the last bits of
LAPACK differ with its build.

Stability: may change.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rattlesweep.arrays import Floats
from rattlesweep.physics.quartic import (
    Coefficients,
    Pair,
    choose,
    quadratics,
    roots,
)
from rattlesweep.physics.theory import two_product

Complexes = NDArray[np.complex128]

# Spins at which both modes must decay: shares of the way, in n^2, from n_0 to the
# threshold.
SHARES = (0.0, 0.25, 0.5)
MAX_SLOPE = 0.1
JACOBI_SWEEPS = 6


def matrix(constants: Floats, n: ArrayLike, sigma: ArrayLike = 0.0) -> Floats:
    """Return the matrix, shape (..., 4, 4), that acts on ``(p, q, omega_x, omega_y)``.

    Bodies are given by :func:`rattlesweep.physics.full.constants`, shape (6, ...).
    Under a torque ``-sigma omega`` the spin falls, and eigenvalues are rates only while
    it falls slowly.
    """
    system = _System(constants, n, sigma)
    c = system.c
    zero = np.zeros_like(system.c)
    unity = np.ones_like(system.c)
    # Rows of coefficients of (p, q, omega_x, omega_y): the linear Eq. 10, then P s = 0
    # with omega_x = dq/dt + c p, omega_y = c q - dp/dt.
    dp = np.stack([zero, c, zero, -unity])
    dq = np.stack([-c, zero, unity, zero])
    k_p = np.stack([system.k_pp, system.k_pq, zero, zero])
    k_q = np.stack([system.k_qp, system.k_qq, zero, zero])
    da = c * dp - (system.d_q * dq + system.g_q * dp + k_q) / system.alpha
    db = c * dq + (system.d_p * dp + system.g_p * dq + k_p) / system.beta
    return np.moveaxis(np.stack([dp, dq, da, db]), (0, 1), (-2, -1))


@dataclass(frozen=True)
class SteadyModes:
    """Eigenvalues and left eigenvectors of the two modes.

    An eigenvalue is the growth rate plus i times the frequency.

    A probe is a left eigenvector of length 1, shape (..., 4).  The modulus of its
    product with ``(p, q, omega_x, omega_y)`` measures the amplitude of its mode.
    """

    pitch: Complexes
    roll: Complexes
    pitch_probe: Complexes
    roll_probe: Complexes


def steady_modes(
    constants: Floats, n: ArrayLike, sigma: ArrayLike = 0.0
) -> SteadyModes:
    """Return the modes at a spin; arguments as for :func:`matrix`.

    The pitch is the mode of higher frequency.  Of a conjugate pair the eigenvalue with
    positive frequency is returned; of two real eigenvalues the larger one.
    """
    system = _System(constants, n, sigma)
    pitch, roll = _leading(system)
    pitch_probe = system.left_vector(*pitch)
    roll_probe = system.left_vector(*roll)
    return SteadyModes(*(_complex(*x) for x in (pitch, roll, pitch_probe, roll_probe)))


def growth(
    constants: Floats, n: ArrayLike, sigma: ArrayLike = 0.0
) -> tuple[Floats, Floats]:
    """Return the growth rates of pitch and roll (for small spins those of Eq. 74)."""
    (pitch, _), (roll, _) = _leading(_System(constants, n, sigma))
    return pitch[()], roll[()]


def transient_growth(constants: Floats, n: ArrayLike) -> Floats:
    """Return a bound on the factor by which a decaying energy may rise, 1 or more.

    For ``dx/dt = A x`` with eigenvectors ``V`` of length 1 and no growing mode, the
    bound is ``cond(V)^2`` (Trefethen and Embree, Spectra and Pseudospectra, 2005, sec.
    14) in the norm of :func:`full.oscillation`: the ratio of the extreme eigenvalues of
    ``V^* V``.
    """
    system = _System(constants, n, 0.0)
    columns = []
    for pair in quadratics(*system.quartic()):
        upper, lower = roots(*pair)
        first, imaginary = system.right_vector(*upper)
        second, _ = system.right_vector(*lower)
        # A unitary matrix turns a conjugate pair into its real and imaginary parts
        # times sqrt(2).
        oscillates = upper[1] > 0
        second = np.where(oscillates, imaginary, second)
        squares = [system.energy(x, x) for x in (first, second)]
        mean = (squares[0] + squares[1]) / 2
        for x, square in zip((first, second), squares, strict=True):
            columns.append(x / np.sqrt(np.where(oscillates, mean, square)))
    sizes = symmetric_eigenvalues(
        [[system.energy(x, y) for y in columns] for x in columns]
    )
    with np.errstate(divide="ignore"):
        bound: Floats = np.max(sizes, axis=0) / np.maximum(np.min(sizes, axis=0), 0.0)
    return bound


def settled_oscillation(
    constants: Floats, n_0: Floats, n_c: Floats, rate: Floats
) -> Floats:
    """Return the oscillation below which a run must decay to its steady spin, (runs,).

    It is measured by :func:`full.oscillation`, and is 0 where no decay is certain.
    `constants` has the shape (6, runs), the others (runs,): `n_0` is the spin that
    would hold all the energy, `n_c` the threshold of stability or NaN, `rate` the
    smallest rate that counts as decay.

    The decay is certain (docs/types.md) if

    - both modes decay, the pitch at least twice as fast as the roll, at all spins down
      to half-way, in ``n^2``, from `n_0` to `n_c`;
    - the largest energy that the oscillation can reach, by :func:`transient_growth`,
      takes the spin no further than half-way, and cannot tilt the body to a slope of
      ``1/sqrt(2)`` in its softest direction;
    - the present slope is at most 0.1, since linear theory leaves out terms of third
      order.
    """
    settled = np.zeros(len(n_0))
    rows = np.flatnonzero(
        (n_0 * n_c > 0) & (np.abs(n_0) > np.abs(n_c)) & np.isfinite(rate)
    )
    constants = constants[:, rows]
    n_0 = n_0[rows]
    n_c = n_c[rows]
    rate = rate[rows]
    square = n_0**2 - n_c**2
    certain = np.ones(len(rows), dtype=bool)
    for share in SHARES:
        pitch, roll = growth(
            constants, np.copysign(np.sqrt(n_0**2 - share * square), n_0)
        )
        certain &= (pitch < 2 * roll) & (roll < -rate)
    constants = constants[:, certain]
    square = square[certain]
    rows = rows[certain]
    _, _, _, cxx, cxy, cyy = constants
    # The smaller eigenvalue of C, without cancellation: the determinant over the larger
    # one.
    apart = np.sqrt((cxx - cyy) * (cxx - cyy) + 4 * cxy * cxy)
    softest = 2 * _determinant(cxx, cxy, cyy) / (cxx + cyy + apart)
    largest = SHARES[-1] * np.minimum(constants[2] * square, softest)
    rise = transient_growth(constants, n_0[certain])
    settled[rows] = np.minimum(largest / rise, MAX_SLOPE**2 * softest)
    return settled


class _System:
    """The matrix ``P`` of the module's docstring; ``c = -n``."""

    def __init__(self, constants: Floats, n: ArrayLike, sigma: ArrayLike) -> None:
        ix, iy, iz, cxx, cxy, cyy, c, sigma = np.broadcast_arrays(
            *constants, -np.asarray(n, float), np.asarray(sigma, float)
        )
        fall = -sigma * c / iz
        c2 = c * c
        self.constants = (ix, iy, iz, cxx, cxy, cyy)
        self.c = c
        self.sigma = sigma
        self.alpha = ix + 1
        self.beta = iy + 1
        self.h = ix + iy + 1 - iz
        self.d_p = sigma + c * cxy
        self.d_q = sigma - c * cxy
        self.g_p = c * (cyy - self.h)
        self.g_q = c * (self.h - cxx)
        # k_pp and k_qq without losses.
        self.kept_p = (1 + c2) * cxx + (iz - ix) * c2
        self.kept_q = (1 + c2) * cyy + (iz - iy) * c2
        self.k_pp = self.kept_p + fall * cxy
        self.k_qq = self.kept_q - fall * cxy
        self.k_pq = (1 + c2) * cxy - sigma * c + fall * (1 + cyy)
        self.k_qp = (1 + c2) * cxy + sigma * c - fall * (1 + cxx)

    def quartic(self) -> Coefficients:
        """Return a3 to a0 of ``det P / (alpha beta)``, free of cancellation."""
        ix, iy, iz, cxx, cxy, cyy = self.constants
        c = self.c
        sigma = self.sigma
        h = self.h
        c2 = c * c
        skew = c * cxy * (ix - iy)
        square = _determinant(cxx, cxy, cyy)
        # The falling spin adds to the torque through the contact point, by these
        # factors.
        x = 1 + (1 + cxx) / iz
        y = 1 + (1 + cyy) / iz
        a3 = skew + sigma * (self.alpha + self.beta)
        a2 = self.beta * self.k_qq + self.alpha * self.k_pp
        a2 = a2 + c2 * (square - h * (cxx + cyy) + h * h) + sigma * sigma
        a1 = c2 * skew + sigma * (
            self.kept_p
            + self.kept_q
            + c2 * (2 * cxy * cxy / iz - (cyy - h) * x - (cxx - h) * y)
        )
        a0 = (
            (1 + c2) * ((1 + c2) * square + c2 * (cxx * (iz - iy) + cyy * (iz - ix)))
            + c2 * c2 * (iz - ix) * (iz - iy)
            + c2 * sigma * (sigma * (x * y - cxy * cxy / (iz * iz)) - skew / iz)
        )
        both = self.alpha * self.beta
        return a3 / both, a2 / both, a1 / both, a0 / both

    def elements(self, re: Floats, im: Floats) -> tuple[Pair, Pair, Pair, Pair]:
        """Return ``P_pp, P_pq, P_qp, P_qq`` at an eigenvalue ``re + i im``."""
        square = re * re - im * im
        twice = 2 * re * im
        return (
            (
                self.beta * square + self.d_p * re + self.k_pp,
                self.beta * twice + self.d_p * im,
            ),
            (self.g_p * re + self.k_pq, self.g_p * im),
            (self.g_q * re + self.k_qp, self.g_q * im),
            (
                self.alpha * square + self.d_q * re + self.k_qq,
                self.alpha * twice + self.d_q * im,
            ),
        )

    def left_vector(self, re: Floats, im: Floats) -> Pair:
        """Return a left eigenvector of length 1, shape (..., 4)."""
        ix, iy, iz, cxx, _, cyy = self.constants
        c = self.c
        pp, pq, qp, qq = self.elements(re, im)
        u, v = _null_vector(pp, qp, pq, qq)
        # The rows of P s = 0 are -beta and alpha times the equations of omega_y and
        # omega_x.
        p = _product(u, (self.beta * re + self.d_p, self.beta * im))
        q = _product(v, (self.alpha * re + self.d_q, self.alpha * im))
        p_v = c * (iy - iz - cxx)
        q_u = c * (iz - ix + cyy)
        vectors = [
            [p[k] + p_v * v[k], q[k] + q_u * u[k], self.alpha * v[k], -self.beta * u[k]]
            for k in (0, 1)
        ]
        length = np.sqrt(sum(x * x for vector in vectors for x in vector))
        real, imaginary = (
            np.stack([x / length for x in vector], axis=-1) for vector in vectors
        )
        return real, imaginary

    def right_vector(self, re: Floats, im: Floats) -> Pair:
        """Return a right eigenvector, shape (4, ...), of any length."""
        pp, pq, qp, qq = self.elements(re, im)
        p, q = _null_vector(pp, pq, qp, qq)
        # omega_x = dq/dt + c p, omega_y = c q - dp/dt.
        dp = _product((re, im), p)
        dq = _product((re, im), q)
        c = self.c
        real, imaginary = (
            np.stack([p[k], q[k], dq[k] + c * p[k], c * q[k] - dp[k]]) for k in (0, 1)
        )
        return real, imaginary

    def energy(self, x: Floats, y: Floats) -> Floats:
        """Return the inner product whose square is :func:`full.oscillation`."""
        _, _, _, cxx, cxy, cyy = self.constants
        p, q, a, b = x
        p_1, q_1, a_1, b_1 = y
        tilt = p * (cxx * p_1 + cxy * q_1) + q * (cxy * p_1 + cyy * q_1)
        return np.asarray(tilt + self.alpha * a * a_1 + self.beta * b * b_1)


def _leading(system: _System) -> tuple[Pair, Pair]:
    (first, low_1), (second, low_2) = (
        roots(*pair) for pair in quadratics(*system.quartic())
    )
    swap = (second[1] > first[1]) | ((second[1] == first[1]) & (second[0] > first[0]))
    re, im = choose(swap, second, first)
    re_2, im_2 = choose(swap, first, second)
    # Where nothing oscillates, the two largest roots may be of the same quadratic.
    low = np.where(swap, low_2[0], low_1[0])
    return (re, im), (np.where((im == 0) & (low > re_2), low, re_2), im_2)


def _product(x: Pair, y: Pair) -> Pair:
    return x[0] * y[0] - x[1] * y[1], x[0] * y[1] + x[1] * y[0]


def _complex(re: Floats, im: Floats) -> Complexes:
    result = np.empty(np.shape(re), complex)
    result.real = re
    result.imag = im
    return result[()]


def _null_vector(a: Pair, b: Pair, c: Pair, d: Pair) -> tuple[Pair, Pair]:
    """Return ``x, y`` with ``a x + b y = c x + d y = 0``, from the larger row."""
    first, second = (
        x[0] * x[0] + x[1] * x[1] + y[0] * y[0] + y[1] * y[1]
        for x, y in ((a, b), (c, d))
    )
    lower = second > first
    re, im = choose(lower, c, a)
    y = choose(lower, d, b)
    # If P = 0, any vector is a solution.
    y = np.where((first == 0) & (second == 0), 1.0, y[0]), y[1]
    return y, (-re, -im)


def _determinant(cxx: Floats, cxy: Floats, cyy: Floats) -> Floats:
    """Return ``C_xx C_yy - C_xy^2`` to rounding, also where the products cancel."""
    direct, direct_low = two_product(cxx, cyy)
    cross, cross_low = two_product(cxy, cxy)
    return (direct - cross) + (direct_low - cross_low)


def symmetric_eigenvalues(matrix: list[list[Floats]]) -> list[Floats]:
    """Return the eigenvalues of symmetric matrices, given by rows, in any order.

    The method is that of Jacobi (Golub and Van Loan, Matrix Computations, 4th ed., sec.
    8.5).
    """
    a = [list(row) for row in matrix]
    places = range(len(a))
    for i, j in JACOBI_SWEEPS * [(i, j) for i in places for j in places if i < j]:
        twice = 2 * a[i][j]
        apart = a[j][j] - a[i][i]
        below = np.abs(apart) + np.sqrt(apart * apart + twice * twice)
        t = np.copysign(1.0, apart) * twice / np.where(below > 0, below, 1.0)
        cos = 1 / np.sqrt(1 + t * t)
        sin = t * cos
        shift = t * a[i][j]
        a[i][i] = a[i][i] - shift
        a[j][j] = a[j][j] + shift
        a[i][j] = a[j][i] = np.zeros_like(t)
        for k in places:
            if k not in (i, j):
                x, y = a[i][k], a[j][k]
                a[i][k] = a[k][i] = cos * x - sin * y
                a[j][k] = a[k][j] = sin * x + cos * y
    return [a[i][i] for i in places]
