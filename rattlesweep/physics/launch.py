"""Launch states: the vertical vector upright, the angular velocity as asked (Eqs. sim-ic)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from rattlesweep.physics import theory

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rattlesweep.arrays import Floats
    from rattlesweep.physics.theory import Modes


class Inertia(Protocol):
    """One body or many: numbers or arrays."""

    @property
    def alpha(self) -> ArrayLike:
        """``I_xx + 1``."""

    @property
    def beta(self) -> ArrayLike:
        """``I_yy + 1``."""

    @property
    def gamma(self) -> ArrayLike:
        """``I_zz``."""


@dataclass(frozen=True)
class GarciaHubbard:
    """Garcia and Hubbard's spin after a launch: the growing mode alone, up to one reversal.

    Attributes
    ----------
    K : ndarray
        Torque coefficient of the mode that grows.
    n_i : ndarray
        Initial spin, in ``sqrt(g/a)``.
    speed : ndarray
        Of the oscillation (:func:`rattlesweep.physics.theory.oscillation_speed`).
    """

    K: Floats
    n_i: Floats
    speed: Floats

    @property
    def n_0(self) -> Floats:
        """Spin if all energy were spin (Eq. def-n0)."""
        n_0: Floats = np.hypot(self.n_i, self.speed)
        return n_0

    @property
    def t_rgh(self) -> Floats:
        """Time of reversal, in ``sqrt(a/g)``; NaN without an initial spin, which has none."""
        return np.where(self.n_i == 0, np.nan, theory.reversal_time(self.K, self.n_i, self.speed))

    def spin(self, t: ArrayLike) -> Floats:
        """The spin at times ``t``."""
        return theory.spin_gh(t, self.K, self.n_i, self.speed)


def garcia_hubbard(
    body: Inertia, modes: Modes, n_i: ArrayLike, omega_xy0: ArrayLike, psi: ArrayLike
) -> GarciaHubbard:
    """Garcia and Hubbard's spin after a launch in the direction ``psi``, in radians."""
    speed = theory.oscillation_speed(body.alpha, body.beta, body.gamma, omega_xy0, psi)
    relevant = theory.relevant_coefficient(modes.K_p, modes.K_r, n_i)
    return GarciaHubbard(relevant, np.asarray(n_i, float), speed)


def direction(modes: Modes, n_i: ArrayLike, psi: str | float) -> Floats:
    """Direction of the launch's horizontal angular velocity, in radians (Eq. sim-ic-3).

    Parameters
    ----------
    modes : Modes
        Of the bodies.
    n_i : array_like
        Initial spins.
    psi : str or float
        ``relevant`` (pitch in the unsteady direction, roll in the steady one; without a spin
        pitch, as a tap on an end gives it), ``pitch``, ``roll``, or degrees.
    """
    shape = np.broadcast(modes.psi_p, n_i).shape
    if psi == "pitch":
        return np.broadcast_to(modes.psi_p, shape)
    if psi == "roll":
        return np.broadcast_to(modes.psi_r, shape)
    if psi == "relevant":
        pitch = theory.unsteady(modes.K_p, n_i) | (np.asarray(n_i) == 0)
        return np.where(pitch, modes.psi_p, modes.psi_r)
    return np.full(shape, np.radians(float(psi)))


def full_state(n_i: ArrayLike, omega_xy0: ArrayLike, psi: ArrayLike) -> Floats:
    """States of the full dynamics, shape (..., 5), in the variables of ``physics.full``."""
    n_i, omega_xy0, psi = np.broadcast_arrays(n_i, omega_xy0, psi)
    zero = np.zeros(n_i.shape)
    # u points up and the z axis down: n = u . omega = -omega_z.
    return np.stack([zero, zero, omega_xy0 * np.cos(psi), omega_xy0 * np.sin(psi), -n_i], axis=-1)


# Of the angular velocity: a spin below this share of it is the rounding of a zero.
NO_SPIN = 1e-15


def spin_and_oscillation(omega: ArrayLike, u: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """What spin and what oscillation a state has; those of :func:`full_state` if ``u`` is upright.

    Parameters
    ----------
    omega, u : array_like, shape (..., 3)
        Angular velocity and vertical unit vector, body-fixed components.

    Returns
    -------
    n : ndarray
        Spin ``u . omega``; 0 where it is no more than rounding.
    omega_xy : ndarray
        Size of the rest of the angular velocity, ``omega - n u``.
    psi : ndarray
        Direction of that from the x axis, in radians.
    """
    omega, u = np.asarray(omega, float), np.asarray(u, float)
    n = (omega * u).sum(axis=-1)
    n = np.where(np.abs(n) <= NO_SPIN * np.linalg.norm(omega, axis=-1), 0.0, n)
    rest = omega - n[..., None] * u
    return n, np.linalg.norm(rest, axis=-1), np.arctan2(rest[..., 1], rest[..., 0])
