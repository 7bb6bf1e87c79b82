"""An ellipsoid in any position, as one that has rolled onto its side.

There ``u_z = 0``, and the slopes of :mod:`rattlesweep.physics.full` end.  The state here is
``(v_x, v_y, v_z, a, b, c, work)``: a vector along the vertical, on whose length nothing depends,
the angular velocity and the work of friction.  With ``u = v/|v|``, ``B = 1 + C`` and ``k = 1/c``
the ellipsoid of :mod:`rattlesweep.physics.stone` touches the plane at

    r = (-B (u_x, u_y) / rho, 1 - (1 + u_z/rho) / k),    rho^2 = u_z^2 + k s,
    s = (u_x, u_y).B (u_x, u_y),

and for ``k = 0``, where it must stand on its lower surface, the paraboloid.  Constants are those of
an ellipsoid with friction, ``sigma = lever = 0`` being none.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics import full, stone
from rattlesweep.physics.full import scalar, turning
from rattlesweep.physics.stone import contact_of, resistance

N_STATE = 7


@scalar
def unit(vx, vy, vz):  # type: ignore[no-untyped-def]
    """Unit vector along a vector."""
    length = sqrt(vx * vx + vy * vy + vz * vz)
    return vx / length, vy / length, vz / length


@scalar
def contact(ux, uy, uz, cxx, cxy, cyy, k):  # type: ignore[no-untyped-def]
    """Return the contact point ``r``, and ``rho``."""
    bx, by = ux + cxx * ux + cxy * uy, uy + cxy * ux + cyy * uy
    s = bx * ux + by * uy
    rho = sqrt(uz * uz + k * s)
    # The first form does not cancel, and needs no k; upside down it is the other that does not.
    rise = s / (rho * (rho - uz)) if uz < 0.0 else (1.0 + uz / rho) / k
    return -bx / rho, -by / rho, 1.0 - rise, rho


@scalar
def moving(ux, uy, uz, a, b, c, x, y, z, rho, cxx, cxy, cyy, k):  # type: ignore[no-untyped-def]
    """Return ``w = r x omega - dr/dt``, which is linear in ``omega``."""
    du = uy * c - uz * b
    dv = uz * a - ux * c
    dw = ux * b - uy * a
    bx, by = du + cxx * du + cxy * dv, dv + cxy * du + cyy * dv
    # Half the rate of s; the rate of rho, over rho.
    g = ux * bx + uy * by
    fall = (uz * dw + k * g) / (rho * rho)
    # Minus the rate of the third component of r: k is taken out of it.
    sink = (uz * g + (x * ux + y * uy) * rho * dw) / (rho * rho * rho)
    return (
        y * c - z * b + bx / rho + x * fall,
        z * a - x * c + by / rho + y * fall,
        x * b - y * a - sink,
    )


@scalar
def free_rates(ux, uy, uz, a, b, c, x, y, z, wx, wy, wz, ix, iy, iz, sigma):  # type: ignore[no-untyped-def]
    """``domega/dt`` without rolling resistance, and what solves for another torque."""
    # As of a slope of zero, with the torque of the rest of gravity, r x (u_x, u_y, 0), beside.
    return turning(
        0.0, 0.0, a, b, c, ix, iy, iz,
        -sigma * a - z * uy, -sigma * b + z * ux, -sigma * c + x * uy - y * ux,
        x, y, 1.0 - z, wx, wy, wz, uz,
    )  # fmt: skip


@scalar
def rhs(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
    """Time derivative of the state (Eqs. diff-u and diff-omega, with friction)."""
    ux, uy, uz = unit(vx, vy, vz)
    x, y, z, rho = contact(ux, uy, uz, cxx, cxy, cyy, k)
    wx, wy, wz = moving(ux, uy, uz, a, b, c, x, y, z, rho, cxx, cxy, cyy, k)
    (da, db, dc), solved = free_rates(
        ux, uy, uz, a, b, c, x, y, z, wx, wy, wz, ix, iy, iz, sigma
    )  # fmt: skip
    normal, _ = contact_of(ux, uy, uz, a, b, c, da, db, dc, x, y, z, wx, wy, wz)
    ra, rb, rc, loss = resistance(ux, uy, uz, a, b, c, x, y, z, normal, lever, eps, *solved)
    power = -sigma * (a * a + b * b + c * c) - loss
    return (
        vy * c - vz * b, vz * a - vx * c, vx * b - vy * a,
        da - ra, db - rb, dc - rc, power,
    )  # fmt: skip


@scalar
def spin(vx, vy, vz, a, b, c, work):  # type: ignore[no-untyped-def]
    """Spin ``n = u . omega``, in ``sqrt(g/a)``."""
    return (vx * a + vy * b + vz * c) / sqrt(vx * vx + vy * vy + vz * vz)


@scalar
def spin_rate(vx, vy, vz, a, b, c, work, dvx, dvy, dvz, da, db, dc, power):  # type: ignore[no-untyped-def]
    """Return ``dn/dt = u . domega/dt``."""
    return spin(vx, vy, vz, da, db, dc, work)


@scalar
def energy(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
    """Energy less the work of friction, in ``M g a``; zero upright and at rest."""
    ux, uy, uz = unit(vx, vy, vz)
    x, y, z, _ = contact(ux, uy, uz, cxx, cxy, cyy, k)
    vx, vy, vz = y * c - z * b, z * a - x * c, x * b - y * a
    moving = ix * a * a + iy * b * b + iz * c * c + vx * vx + vy * vy + vz * vz
    return 0.5 * moving - (x * ux + y * uy + z * uz) - 1.0 - work


@scalar
def contact_force(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
    """Contact force; as :func:`rattlesweep.physics.full.contact_force`."""
    _, _, _, da, db, dc, _ = rhs(
        vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps
    )  # fmt: skip
    ux, uy, uz = unit(vx, vy, vz)
    x, y, z, rho = contact(ux, uy, uz, cxx, cxy, cyy, k)
    wx, wy, wz = moving(ux, uy, uz, a, b, c, x, y, z, rho, cxx, cxy, cyy, k)
    return contact_of(ux, uy, uz, a, b, c, da, db, dc, x, y, z, wx, wy, wz)


def from_slopes(y: Floats, constants: Floats) -> tuple[Floats, Floats]:
    """Return states (runs, 7) and constants (runs, 10) of those in slopes, with friction or not."""
    u, omega = full.to_vectors(y[:, : full.N_STATE].T)
    work, loss = y[:, full.N_STATE :], constants[:, stone.N_CONSTANTS :]
    if not work.size:
        work = np.zeros((len(y), 1))
        loss = np.tile([0.0, 0.0, stone.SMOOTHING], (len(y), 1))
    return np.hstack([u.T, omega.T, work]), np.hstack([constants[:, : stone.N_CONSTANTS], loss])


def to_slopes(y: Floats) -> Floats:
    """Return slopes, angular velocity and work of states, shape (runs, 6)."""
    return np.hstack([y[:, :2] / y[:, 2:3], y[:, 3:]])
