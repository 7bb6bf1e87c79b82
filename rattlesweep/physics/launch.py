"""Launch states: the vertical vector upright, the angular velocity as asked (Eqs. sim-ic)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.physics import theory

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rattlesweep.arrays import Floats
    from rattlesweep.physics.theory import Modes

NO_SPIN = 1e-15
"""A spin below this share of the angular velocity is the rounding of a zero."""


@dataclass(frozen=True)
class GarciaHubbard:
    """Garcia and Hubbard's spin after a launch: the growing mode alone, up to one reversal.

    By the torque coefficient of that mode, the initial spin and `theory.oscillation_speed`.
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
        """Return the spin at times ``t``."""
        return theory.spin_gh(t, self.K, self.n_i, self.speed)


def garcia_hubbard(
    body: Any, modes: Modes, n_i: ArrayLike, omega_xy0: ArrayLike, psi: ArrayLike
) -> GarciaHubbard:
    """Return the spin after a launch of a `body`, one or many, in the direction ``psi``."""
    speed = theory.oscillation_speed(body.alpha, body.beta, body.gamma, omega_xy0, psi)
    grows = np.where(theory.unsteady(modes.K_p, n_i), modes.K_p, modes.K_r)
    return GarciaHubbard(grows, np.asarray(n_i, float), speed)


def direction(modes: Modes, n_i: ArrayLike, psi: str | float) -> Floats:
    """Return the direction of the launch's horizontal angular velocity (Eq. sim-ic-3).

    `psi` is ``pitch``, ``roll``, degrees, or ``relevant``: the pitch in the unsteady direction and
    without a spin, as a tap on an end gives it, the roll in the steady one.
    """
    if psi == "relevant":
        pitch = theory.unsteady(modes.K_p, n_i) | (np.asarray(n_i) == 0)
        return np.where(pitch, modes.psi_p, modes.psi_r)
    found = {"pitch": modes.psi_p, "roll": modes.psi_r}.get(str(psi))
    shape = np.broadcast(modes.psi_p, n_i).shape
    return np.broadcast_to(np.radians(float(psi)) if found is None else found, shape)


def full_state(n_i: ArrayLike, omega_xy0: ArrayLike, psi: ArrayLike) -> Floats:
    """Return states of the full dynamics, shape (..., 5), in the variables of `physics.full`."""
    n_i, omega_xy0, psi = np.broadcast_arrays(n_i, omega_xy0, psi)
    zero = np.zeros(n_i.shape)
    # u points up and the z axis down: n = u . omega = -omega_z.
    return np.stack([zero, zero, omega_xy0 * np.cos(psi), omega_xy0 * np.sin(psi), -n_i], axis=-1)


def spin_and_oscillation(omega: ArrayLike, u: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Return ``n = u . omega``, the size of ``omega - n u`` and its direction, of full states."""
    omega, u = np.asarray(omega, float), np.asarray(u, float)
    n = (omega * u).sum(axis=-1)
    n = np.where(np.abs(n) <= NO_SPIN * np.linalg.norm(omega, axis=-1), 0.0, n)
    rest = omega - n[..., None] * u
    return n, np.linalg.norm(rest, axis=-1), np.arctan2(rest[..., 1], rest[..., 0])
