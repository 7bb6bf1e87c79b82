"""The reduced dynamics in three variables (Eqs. 47-49).

The state is ``(n, E_p, E_r)``, the spin and the energies of pitch and roll averaged
over the oscillations; the constants are ``(K_p, K_r, I_eff)``.
"""

# mypy: disable-error-code="no-untyped-def"
import numpy as np
from numpy.typing import ArrayLike

from rattlesweep.arrays import Floats
from rattlesweep.physics.full import scalar

N_STATE = 3
CONSTANTS = "k_p", "k_r", "inertia"


@scalar
def rhs(y, constants):
    """Return the time derivatives of ``n, E_p, E_r`` (Eqs. 47-49)."""
    n, e_p, e_r = y
    k_p, k_r, inertia = constants
    return (k_r * e_r - k_p * e_p) / inertia, k_p * n * e_p, -k_r * n * e_r


@scalar
def energy(y, constants):
    """Return the conserved energy ``E_tot`` (Eq. 50), in ``M g a``."""
    n, e_p, e_r = y
    _, _, inertia = constants
    return 0.5 * inertia * n * n + e_p + e_r


def casimir(e_p: ArrayLike, e_r: ArrayLike, K_p: ArrayLike, K_r: ArrayLike) -> Floats:
    """Return the Casimir invariant ``C_I`` (Eq. 51); infinite if an energy is zero."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(e_p) / np.asarray(K_p) + np.log(e_r) / np.asarray(K_r))


def launch_energies(
    alpha: Floats,
    beta: Floats,
    psi_p: Floats,
    psi_r: Floats,
    omega_xy0: ArrayLike,
    psi: ArrayLike,
) -> tuple[Floats, Floats]:
    """Return the energies of pitch and roll at launch (Eqs. 68, 69), in ``M g a``."""

    def along(direction: Floats, other: Floats) -> Floats:
        # The modes are orthogonal in the metric J = diag(alpha, beta) (Eq. 18).
        c = np.cos(direction)
        s = np.sin(direction)
        product = alpha * c * np.cos(psi) + beta * s * np.sin(psi)
        norm = alpha * c * c + beta * s * s
        energy = 0.5 * np.asarray(omega_xy0) ** 2 * product**2 / norm
        return np.where(np.asarray(psi) == other, 0.0, energy)

    return along(psi_p, psi_r), along(psi_r, psi_p)
