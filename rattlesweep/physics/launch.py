"""Launch states: the vertical vector upright, the angular velocity as asked (Eqs. sim-ic)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.physics.theory import unsteady

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from rattlesweep.physics.theory import Modes

    Floats = NDArray[np.float64]


def direction(modes: Modes, n_i: ArrayLike, psi: str | float) -> Floats:
    """Direction of the launch's horizontal angular velocity, in radians (Eq. sim-ic-3).

    Parameters
    ----------
    modes : Modes
        Of the bodies.
    n_i : array_like
        Initial spins.
    psi : str or float
        ``relevant`` (pitch in the unsteady direction, else roll), ``pitch``, ``roll``, or degrees.
    """
    shape = np.broadcast(modes.psi_p, n_i).shape
    if psi == "pitch":
        return np.broadcast_to(modes.psi_p, shape)
    if psi == "roll":
        return np.broadcast_to(modes.psi_r, shape)
    if psi == "relevant":
        return np.where(unsteady(modes.K_p, n_i), modes.psi_p, modes.psi_r)
    return np.full(shape, np.radians(float(psi)))


def full_state(n_i: ArrayLike, omega_xy0: ArrayLike, psi: ArrayLike) -> Floats:
    """States of the full dynamics, shape (..., 5), in the variables of ``physics.full``."""
    n_i, omega_xy0, psi = np.broadcast_arrays(n_i, omega_xy0, psi)
    zero = np.zeros(n_i.shape)
    # u points up and the z axis down: n = u . omega = -omega_z.
    return np.stack([zero, zero, omega_xy0 * np.cos(psi), omega_xy0 * np.sin(psi), -n_i], axis=-1)
