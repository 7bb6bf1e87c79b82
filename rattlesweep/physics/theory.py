"""The theory of Garcia and Hubbard as given by Kondo and Nakanishi (2017), vectorised.

Formulas are rewritten so that nothing cancels where the paper's own forms would lose
all digits. Angles are in radians, frequencies in ``sqrt(g/a)``, times in ``sqrt(a/g)``.
Arguments broadcast.

Stability: stable.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rattlesweep.arrays import Flags, Floats
from rattlesweep.physics.friction import losses

# A spin below this share of the angular velocity is a rounding error of zero.
NO_SPIN = 1e-15


@dataclass(frozen=True)
class Modes:
    """Small oscillations without spin: the faster mode (pitch) and the slower (roll).

    Stability: stable.

    Attributes
    ----------
    omega_p, omega_r : ndarray
        Frequencies (Eq. 24).
    psi_p, psi_r : ndarray
        Angles of the angular velocities from the x axis, in (-pi/2, pi/2].
    omega_p0, omega_r0 : ndarray
        Frequencies of pitch and roll at zero skew angle (Eqs. 28 and 29).
    K_p, K_r : ndarray
        Asymmetric torque coefficients (Eqs. 39 and 40).
    """

    omega_p: Floats
    omega_r: Floats
    psi_p: Floats
    psi_r: Floats
    omega_p0: Floats
    omega_r0: Floats
    K_p: Floats
    K_r: Floats


def hessian(
    alpha: Floats, beta: Floats, theta: Floats, phi: Floats, xi: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return ``H_11, H_12, H_22`` of the matrix ``H`` (Eq. 22), in ``g/a``."""
    roll = (1 - theta) / theta
    pitch = (1 - phi) / phi
    sin = np.sin(xi)
    cos = np.cos(xi)
    h11 = (sin**2 * roll + cos**2 * pitch) / alpha
    h22 = (cos**2 * roll + sin**2 * pitch) / beta
    h12 = sin * cos * ((theta - phi) / (theta * phi)) / np.sqrt(alpha * beta)
    return h11, h12, h22


def torque_coefficients(
    alpha: Floats, beta: Floats, theta: Floats, phi: Floats, xi: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return ``omega_p^2, omega_r^2, K_p, K_r`` (Eqs. 24, 39 and 40).

    Only arithmetic and ufuncs are used, so that samplers can compile it for scalars.
    """
    roll = (1 - theta) / theta
    pitch = (1 - phi) / phi
    h11, h12, h22 = hessian(alpha, beta, theta, phi, xi)
    split = np.hypot(h11 - h22, 2 * h12)  # omega_p^2 - omega_r^2
    square_p = (h11 + h22 + split) / 2
    # det H = omega_p^2 omega_r^2 does not depend on xi.
    square_r = roll * pitch / (alpha * beta) / square_p
    # Eq. 38 is the difference of inverse inertias times that of radii; Eqs. 39 and 40
    # divide it by omega_p^2 - omega_r^2.
    inertias = -0.5 * np.sin(2 * xi) * ((alpha - beta) / (alpha * beta))
    torque = inertias * ((theta - phi) / (theta * phi)) / split
    return square_p, square_r, torque * square_p, torque * square_r


def modes(
    alpha: ArrayLike, beta: ArrayLike, theta: ArrayLike, phi: ArrayLike, xi: ArrayLike
) -> Modes:
    """Return the two modes of bodies; ``K_p, K_r > 0`` for ``xi < 0``."""
    alpha, beta, theta, phi, xi = (
        np.asarray(x, float) for x in (alpha, beta, theta, phi, xi)
    )
    roll = (1 - theta) / theta
    pitch = (1 - phi) / phi
    h11, h12, h22 = hessian(alpha, beta, theta, phi, xi)
    square_p, square_r, K_p, K_r = torque_coefficients(alpha, beta, theta, phi, xi)
    # The eigenvectors of H (Eq. 22) are (cos, sin) and (-sin, cos) of chi. The
    # horizontal angular velocity of a mode is J^-1/2 times its eigenvector, where J is
    # diag(alpha, beta).
    chi = np.arctan2(2 * h12, h11 - h22) / 2
    sin = np.sin(chi)
    cos = np.cos(chi)
    psi = (
        np.arctan2(sin * np.sqrt(alpha), cos * np.sqrt(beta)),
        np.arctan2(cos * np.sqrt(alpha), -sin * np.sqrt(beta)),
    )
    # psi and psi + pi are the same direction.
    psi_p, psi_r = (np.where(x > np.pi / 2, x - np.pi, x) for x in psi)
    psi_p, psi_r = (np.where(x <= -np.pi / 2, x + np.pi, x) for x in (psi_p, psi_r))
    return Modes(
        omega_p=np.sqrt(square_p),
        omega_r=np.sqrt(square_r),
        psi_p=psi_p,
        psi_r=psi_r,
        omega_p0=np.sqrt(pitch / alpha),
        omega_r0=np.sqrt(roll / beta),
        K_p=K_p,
        K_r=K_r,
    )


def inertia_along(alpha: ArrayLike, beta: ArrayLike, psi: ArrayLike) -> Floats:
    """Return the moment of inertia about the line along ``psi`` through the contact."""
    return np.asarray(
        np.asarray(alpha) * np.cos(psi) ** 2 + np.asarray(beta) * np.sin(psi) ** 2
    )


def mode_moments(
    alpha: ArrayLike, beta: ArrayLike, modes: Modes
) -> tuple[Floats, Floats]:
    """Return the moments of inertia of pitch and roll about the contact point."""
    pitch = inertia_along(alpha, beta, modes.psi_p)
    return pitch, inertia_along(alpha, beta, modes.psi_r)


def oscillation_speed(
    alpha: ArrayLike,
    beta: ArrayLike,
    gamma: ArrayLike,
    omega_xy0: ArrayLike,
    psi: ArrayLike,
) -> Floats:
    """Return ``w``, in ``sqrt(g/a)``, such that ``n_0^2 = n_i^2 + w^2`` (Eq. 72).

    ``gamma w^2 / 2`` is the energy of the oscillation at launch.
    """
    inertia = inertia_along(alpha, beta, psi)
    return np.asarray(np.abs(omega_xy0) * np.sqrt(inertia / np.asarray(gamma, float)))


def unsteady(K_p: ArrayLike, n_i: ArrayLike) -> Flags:
    """Return whether the pitch grows: for ``n_i > 0``, or ``n_i < 0`` if ``xi > 0``."""
    return np.asarray(np.asarray(K_p) * np.asarray(n_i) > 0)


def growth_rates(K_p: ArrayLike, K_r: ArrayLike, n: ArrayLike) -> tuple[Floats, Floats]:
    """Return the growth rates of pitch and roll at a small spin (Eq. 74)."""
    n = np.asarray(n, float)
    return n * np.asarray(K_p) / 2, -n * np.asarray(K_r) / 2


def damping_rates(
    alpha: ArrayLike, beta: ArrayLike, modes: Modes, sigma: ArrayLike
) -> tuple[Floats, Floats]:
    """Return the rates at which a torque ``-sigma omega`` damps pitch and roll.

    They are those without spin.
    """
    pitch, roll = mode_moments(alpha, beta, modes)
    return (
        losses.share_of_couple(pitch, sigma) / 2,
        losses.share_of_couple(roll, sigma) / 2,
    )


def loss_shares(
    moment_p: Floats, moment_r: Floats, modes: Modes, given: Mapping[str, Floats]
) -> tuple[Floats, Floats]:
    """Return what losses take of the energies of pitch and roll at any spin.

    `given` are the constants of dissipation by name.
    """
    sigma = given["sigma"]
    viscous = given["viscous"]
    pitch = losses.share_of_couple(moment_p, sigma)
    roll = losses.share_of_couple(moment_r, sigma)
    return (
        pitch + losses.share_of_slip(modes.omega_p, moment_p, viscous),
        roll + losses.share_of_slip(modes.omega_r, moment_r, viscous),
    )


def lossy_growth_rates(
    alpha: ArrayLike,
    beta: ArrayLike,
    modes: Modes,
    n: ArrayLike,
    given: Mapping[str, Floats],
) -> tuple[Floats, Floats]:
    """Return the growth rates of pitch and roll at a small spin, with losses.

    `given` are the constants of dissipation by name; rolling resistance is left out.
    """
    moment_p, moment_r = mode_moments(alpha, beta, modes)
    share_p, share_r = loss_shares(moment_p, moment_r, modes, given)
    patch = given["pivot"], given["creep"]
    creep_p = losses.share_of_creep(modes.omega_p, moment_p, *patch)
    creep_r = losses.share_of_creep(modes.omega_r, moment_r, *patch)
    return (
        losses.growth_of_mode(modes.K_p, n, share_p, creep_p),
        losses.growth_of_mode(-modes.K_r, n, share_r, creep_r),
    )


def creeping_coefficients(
    alpha: ArrayLike,
    beta: ArrayLike,
    modes: Modes,
    pivot: ArrayLike,
    creep: ArrayLike,
) -> tuple[Floats, Floats]:
    """Return ``K_p`` and ``K_r`` less what the creep of the contact takes from them.

    A foot that pivots under a lever ``l`` with the friction ``mu`` drifts (see
    :mod:`rattlesweep.physics.friction.creep`).  A mode loses ``|n| c l / mu^2`` of its
    energy a unit of time, with ``c = 128 omega_i^2 / (9 pi^2 J_i)`` and the moment
    ``J_i`` about the contact point along the mode.  Oscillations grow only where the
    rest has the sign of the coefficient (that of mirrored bodies is negative): where
    that of ``K_r`` has not, no steady spin of any size turns back.

    NaN where ``creep`` is zero.
    """
    moment_p, moment_r = mode_moments(alpha, beta, modes)
    pitch = losses.share_of_creep(modes.omega_p, moment_p, pivot, creep)
    roll = losses.share_of_creep(modes.omega_r, moment_r, pivot, creep)
    creeps = np.asarray(creep, float) > 0
    return (
        np.where(creeps, losses.less_creep(modes.K_p, pitch), np.nan),
        np.where(creeps, losses.less_creep(modes.K_r, roll), np.nan),
    )


def slip_thresholds(
    alpha: ArrayLike, beta: ArrayLike, modes: Modes, viscous: ArrayLike
) -> tuple[Floats, Floats]:
    """Return ``n_p`` and ``n_r``: which spins the slip of the foot lets last.

    Under a friction ``-k v`` of the contact point a mode loses ``gamma_i = omega_i^2 /
    (k J_i)`` of its energy a unit of time, with the moment ``J_i`` about the contact
    point along the mode, and an upright spin loses nothing.  So the pitch grows at
    spins above ``gamma_p / K_p``, the roll below ``-gamma_r / K_r``, to first order in
    ``1/k``.

    NaN where ``viscous`` is zero, which means that nothing slips, or a ``K`` is.
    """
    moment_p, moment_r = mode_moments(alpha, beta, modes)
    pitch = losses.share_of_slip(modes.omega_p, moment_p, viscous)
    roll = losses.share_of_slip(modes.omega_r, moment_r, viscous)
    slips = np.asarray(viscous, float) > 0
    no_creep = np.asarray(0.0)
    return (
        np.where(slips, losses.growing_from(modes.K_p, pitch, no_creep), np.nan),
        np.where(slips, losses.growing_from(modes.K_r, roll, no_creep), np.nan),
    )


def _two_sum(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return the sum and its exact rounding error (Dekker 1971)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def two_product(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return the product and its exact rounding error (Dekker 1971)."""
    p = a * b
    # The factor 2^27 + 1 splits a number into halves of 26 bits.
    at = 134217729.0 * a
    bt = 134217729.0 * b
    ah = at - (at - a)
    bh = bt - (bt - b)
    al = a - ah
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


def bondi_threshold(
    alpha: ArrayLike,
    beta: ArrayLike,
    gamma: ArrayLike,
    theta: ArrayLike,
    phi: ArrayLike,
) -> Floats:
    """Return Bondi's threshold ``n_c1 < 0`` (Eq. 73), NaN where there is none.

    The steady spin is stable for ``n < n_c1``, or ``n > -n_c1`` if ``xi > 0``, as far
    as a second threshold, if there is one;
    :func:`rattlesweep.physics.steady.growth` is exact.
    """
    alpha, beta, gamma, theta, phi = np.broadcast_arrays(
        *(np.asarray(x, float) for x in (alpha, beta, gamma, theta, phi))
    )
    # The denominator is 2 - s - k d with k = alpha + beta - gamma, s = theta + phi and
    # d = s - 2 theta phi.  It passes through zero, so it is computed in twice the
    # precision: a name that ends in a number or in `low` is a rounding error.
    k, k1 = _two_sum(alpha, beta)
    k, k2 = _two_sum(k, -gamma)
    k, k_low = _two_sum(k, k1 + k2)
    s, s_low = _two_sum(theta, phi)
    m, m_low = two_product(theta, phi)
    d, d1 = _two_sum(s, -2 * m)
    d, d_low = _two_sum(d, d1 + s_low - 2 * m_low)
    p, p1 = two_product(k, d)
    p_low = p1 + k * d_low + k_low * d
    a, a1 = _two_sum(np.full_like(s, 2.0), -s)
    b, b1 = _two_sum(a, -p)
    denominator = b + (b1 + a1 - s_low - p_low)
    with np.errstate(divide="ignore", invalid="ignore"):
        square = -(1 - theta) * (1 - phi) / denominator
        return np.where(
            (denominator < 0) & np.isfinite(square), -np.sqrt(np.abs(square)), np.nan
        )


@dataclass(frozen=True)
class GarciaHubbard:
    """Garcia and Hubbard's spin after a launch, driven by the growing mode alone."""

    K: Floats  # asymmetric torque coefficient of the growing mode
    n_i: Floats  # spin at launch
    speed: Floats  # oscillation_speed

    @property
    def n_0(self) -> Floats:
        """Return the spin that would hold all the energy (Eq. 72)."""
        return np.asarray(np.hypot(self.n_i, self.speed))

    @property
    def t_rgh(self) -> Floats:
        """Return the time for reversal (Eqs. 56 and 58); NaN without an initial spin.

        Since ``n_0^2 - n^2 = w^2``, ``ln((n_0 + n)/(n_0 - n))`` is ``2 asinh(n/w)``.
        """
        n = np.abs(self.n_i)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            time = (
                2
                * np.arcsinh(n / self.speed)
                / (np.hypot(n, self.speed) * np.abs(self.K))
            )
        return np.where(n == 0, np.nan, time)

    def spin(self, t: ArrayLike) -> Floats:
        """Return the spin at times ``t`` (Eqs. 55 and 57, as a hyperbolic tangent)."""
        # Without an initial spin there is no reversal (NaN), and the spin stays zero.
        t_rgh = np.where(self.n_i == 0, 0.0, self.t_rgh)
        since_reversal = np.asarray(t, float) - t_rgh
        rate = self.n_0 * np.abs(self.K)
        share = np.tanh(rate * since_reversal / 2)
        return np.asarray(-np.sign(self.n_i) * self.n_0 * share)


def garcia_hubbard(
    body: Any, modes: Modes, n_i: ArrayLike, omega_xy0: ArrayLike, psi: ArrayLike
) -> GarciaHubbard:
    """Return the solution for a launch of a body, or of many, along ``psi``."""
    speed = oscillation_speed(body.alpha, body.beta, body.gamma, omega_xy0, psi)
    growing_K = np.where(unsteady(modes.K_p, n_i), modes.K_p, modes.K_r)
    return GarciaHubbard(growing_K, np.asarray(n_i, float), speed)


def direction(modes: Modes, n_i: ArrayLike, psi: str | float) -> Floats:
    """Return the direction of the horizontal angular velocity at launch (Eq. 70).

    `psi` is ``pitch``, ``roll``, a number of degrees, or ``relevant``: the roll for
    spins in the steady direction, otherwise the pitch, which is also what a tap on an
    end excites.
    """
    if psi == "relevant":
        is_pitch = unsteady(modes.K_p, n_i) | (np.asarray(n_i) == 0)
        return np.where(is_pitch, modes.psi_p, modes.psi_r)
    if psi == "pitch":
        angle = modes.psi_p
    elif psi == "roll":
        angle = modes.psi_r
    else:
        angle = np.radians(np.asarray(float(psi)))
    return np.broadcast_to(angle, np.broadcast(modes.psi_p, n_i).shape)


def full_state(n_i: ArrayLike, omega_xy0: ArrayLike, psi: ArrayLike) -> Floats:
    """Return upright states of `physics.full`, shape (..., 5) (Eqs. 68 and 69)."""
    n_i, omega_xy0, psi = np.broadcast_arrays(n_i, omega_xy0, psi)
    zero = np.zeros(n_i.shape)
    # u points up and the z axis down: n = u . omega = -omega_z.
    return np.stack(
        [zero, zero, omega_xy0 * np.cos(psi), omega_xy0 * np.sin(psi), -n_i], axis=-1
    )


def spin_and_oscillation(
    omega: ArrayLike, u: ArrayLike
) -> tuple[Floats, Floats, Floats]:
    """Return ``n = u . omega``, and modulus and direction of ``omega - n u``.

    `omega` and `u` have the shape (..., 3), the results (...).  The direction is an
    angle from the x axis, in radians.
    """
    omega = np.asarray(omega, float)
    u = np.asarray(u, float)
    n = (omega * u).sum(axis=-1)
    n = np.where(np.abs(n) <= NO_SPIN * np.linalg.norm(omega, axis=-1), 0.0, n)
    rest = omega - n[..., None] * u
    return n, np.linalg.norm(rest, axis=-1), np.arctan2(rest[..., 1], rest[..., 0])
