"""The reduced dynamics in three variables (Eqs. 47-49), without and with losses.

The state is ``(n, E_p, E_r)``, the spin and the energies of pitch and roll averaged
over the oscillations; the constants are ``(K_p, K_r, I_eff)``.  With losses the
averages of :mod:`rattlesweep.physics.friction.losses` are added, and works follow the
state:

    I dn/dt   = K_r E_r - K_p E_p - sigma n - l sign(n)
    dE_p/dt   = (K_p n - G_p - abs(n) C_p) E_p - R_p
    dE_r/dt   = (-K_r n - G_r - abs(n) C_r) E_r - R_r

``G`` is what a torque or a slip takes of a mode, ``C`` what creep takes, and ``R`` what
rolling resistance takes.  A spin that comes to zero is held there while ``abs(K_r E_r -
K_p E_p) <= l``.  Its sign is constant between two zeros: the ``sense``, 0 while it is
held (:mod:`rattlesweep.physics.friction.pivoting`).  The normal force is the weight.

Stability: may change.
"""

# mypy: disable-error-code="no-untyped-def"
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from rattlesweep.arrays import Floats
from rattlesweep.physics.friction.rolling_mean import rolling_losses
from rattlesweep.physics.full import scalar
from rattlesweep.physics.stone import SMOOTHING

N_STATE = 3
CONSTANTS = "k_p", "k_r", "inertia"
# Without all of these nothing is lost; the lever is that of pivoting.
STRENGTHS = "sigma", "loss_p", "loss_r", "slip_p", "slip_r", "rolling"
LOSSY_CONSTANTS = *CONSTANTS, *STRENGTHS, "moment_p", "moment_r", "overlap"
PIVOTING_CONSTANTS = *LOSSY_CONSTANTS, "creep_p", "creep_r", "lever", "sense"


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


@scalar
def lossy_energy(y, constants):
    """Return the energy less the work of the losses, in ``M g a``."""
    n, e_p, e_r, work = y[:4]
    return 0.5 * constants[2] * n * n + e_p + e_r - work


@scalar
def lossy_rates(n, e_p, e_r, k_p, k_r, lost):
    """Return the drive of the spin, both rates of energies, and the power of losses.

    The last is the power of slip alone.  ``lost`` are the constants from sigma on.
    """
    sigma, loss_p, loss_r, slip_p, slip_r, rolling = lost[:6]
    moment_p, moment_r, overlap = lost[6:]
    # A rounding error below zero has no amplitude.
    x = sqrt(2.0 * max(e_p, 0.0) / moment_p)
    y = sqrt(2.0 * max(e_r, 0.0) / moment_r)
    resisted_p, resisted_r = rolling_losses(x, y, overlap, SMOOTHING)
    slipped_p = slip_p * e_p
    slipped_r = slip_r * e_r
    taken_p = loss_p * e_p + rolling * resisted_p + slipped_p
    taken_r = loss_r * e_r + rolling * resisted_r + slipped_r
    braked = sigma * n
    drive = k_r * e_r - k_p * e_p - braked
    pitch = k_p * n * e_p - taken_p
    roll = -k_r * n * e_r - taken_r
    power = -(braked * n + taken_p + taken_r)
    return drive, pitch, roll, power, -(slipped_p + slipped_r)


@scalar
def lossy_rhs(y, constants):
    """Return the derivatives of ``n, E_p, E_r``, and of works: of all losses, slip."""
    n, e_p, e_r = y[:3]
    k_p, k_r, inertia = constants[:3]
    drive, pitch, roll, power, slipped = lossy_rates(
        n, e_p, e_r, k_p, k_r, constants[3:]
    )
    return drive / inertia, pitch, roll, power, slipped


@scalar
def lossy_pivoting_rhs(y, constants):
    """Return the derivatives of ``n, E_p, E_r`` and of works.

    These are those of all losses, of pivoting, of creep and of slip.
    """
    n, e_p, e_r = y[:3]
    k_p, k_r, inertia = constants[:3]
    creep_p, creep_r, lever, sense = constants[12:]
    drive, pitch, roll, power, slipped = lossy_rates(
        n, e_p, e_r, k_p, k_r, constants[3:12]
    )
    # Where the spin is held, it is zero, and neither turns nor creeps.
    free = sense * sense
    size = sense * n
    crept_p = size * creep_p * e_p
    crept_r = size * creep_r * e_r
    pivoted = -lever * size
    crept = -(crept_p + crept_r)
    works = power + pivoted + crept, pivoted, crept, slipped
    turning = free * (drive - lever * sense) / inertia
    return (turning, pitch - crept_p, roll - crept_r) + works  # noqa: RUF005


@scalar
def pivot(y, constants):
    """Return the torque against pivoting along the vertical, and the normal force,
    once as what holds a spin and once as such.

    Where the spin is held it is the torque that holds it.
    """
    _, e_p, e_r = y[:3]
    k_p, k_r = constants[:2]
    lever, sense = constants[-2:]
    held = k_p * e_p - k_r * e_r
    torque = -lever * sense
    if sense == 0.0:
        torque = held
    return torque, 1.0, 1.0


@scalar
def averaged_energies(y, constants):
    """Return the energies of pitch and roll, weights 1/K, and no period."""
    k_p, k_r = constants[:2]
    return y[1], y[2], 1.0 / k_p, 1.0 / k_r, 0.0


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
