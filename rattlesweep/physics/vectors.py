"""An ellipsoid in any position, as one that has rolled onto its side; and phase volume.

There the slopes of :mod:`rattlesweep.physics.full` end.  The state here is
``(v_x, v_y, v_z, a, b, c, work)``: a vector along the vertical, on whose length nothing depends,
the angular velocity and the work of friction.  With ``u = v/|v|``, ``B = 1 + C`` and ``k = 1/c``
the ellipsoid of :mod:`rattlesweep.physics.stone` touches the plane at

    r = (-B (u_x, u_y) / rho, 1 - (1 + u_z/rho) / k),    rho^2 = u_z^2 + k s,
    s = (u_x, u_y).B (u_x, u_y),

and for ``k = 0``, on its lower surface, the paraboloid.  Constants are those with friction.

The flow changes phase volume, that of the directions ``u``, which only turn, times that of
``omega``, at the relative rate ``tr d(J^-1 T)/domega`` (Eq. diff-omega).  With ``w = W omega``

    dT/domega = G + (r.w) 1 - w r^T + omega (W^T r)^T - (r.omega) W

with the gyroscopic and viscous part ``G``, and by the last values ``dyz, dzx, dxy, along, ivol`` of
:func:`rattlesweep.physics.full.turning`, here ``solved``, ``J^-1`` is
``ivol (diag(dyz, dzx, dxy) + along s s^T)`` with ``s = (x dyz, y dzx, z dxy)``.
"""

# mypy: disable-error-code="no-untyped-def"
from math import sqrt

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics import full, stone
from rattlesweep.physics.full import scalar, turning
from rattlesweep.physics.stone import contact_of, resistance

N_STATE = 7


@scalar
def unit(vx, vy, vz):
    """Unit vector along a vector."""
    length = sqrt(vx * vx + vy * vy + vz * vz)
    return vx / length, vy / length, vz / length


@scalar
def contact(ux, uy, uz, cxx, cxy, cyy, k):
    """Return the contact point ``r``, and ``rho``."""
    bx, by = ux + cxx * ux + cxy * uy, uy + cxy * ux + cyy * uy
    s = bx * ux + by * uy
    rho = sqrt(uz * uz + k * s)
    # The first form does not cancel, and needs no k; upside down it is the other that does not.
    rise = s / (rho * (rho - uz)) if uz < 0.0 else (1.0 + uz / rho) / k
    return -bx / rho, -by / rho, 1.0 - rise, rho


@scalar
def moving(ux, uy, uz, a, b, c, x, y, z, rho, cxx, cxy, cyy, k):
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
def free_rates(ux, uy, uz, a, b, c, x, y, z, wx, wy, wz, ix, iy, iz, sigma):
    """``domega/dt`` without rolling resistance, and what solves for another torque."""
    # As of a slope of zero, with the torque of the rest of gravity, r x (u_x, u_y, 0), beside.
    return turning(
        0.0, 0.0, a, b, c, ix, iy, iz,
        -sigma * a - z * uy, -sigma * b + z * ux, -sigma * c + x * uy - y * ux,
        x, y, 1.0 - z, wx, wy, wz, uz,
    )  # fmt: skip


@scalar
def rhs(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
    """Time derivative of the state (Eqs. diff-u and diff-omega, with friction)."""
    ux, uy, uz = unit(vx, vy, vz)
    x, y, z, rho = contact(ux, uy, uz, cxx, cxy, cyy, k)
    wx, wy, wz = moving(ux, uy, uz, a, b, c, x, y, z, rho, cxx, cxy, cyy, k)
    rates, solved = free_rates(ux, uy, uz, a, b, c, x, y, z, wx, wy, wz, ix, iy, iz, sigma)
    da, db, dc = rates
    normal, _ = contact_of(ux, uy, uz, a, b, c, da, db, dc, x, y, z, wx, wy, wz)
    ra, rb, rc, loss = resistance(ux, uy, uz, a, b, c, x, y, z, normal, lever, eps, *solved)
    power = -sigma * (a * a + b * b + c * c) - loss
    dv = vy * c - vz * b, vz * a - vx * c, vx * b - vy * a
    return dv + (da - ra, db - rb, dc - rc, power)  # noqa: RUF005


@scalar
def spin(vx, vy, vz, a, b, c, work):
    """Spin ``n = u . omega``, in ``sqrt(g/a)``."""
    return (vx * a + vy * b + vz * c) / sqrt(vx * vx + vy * vy + vz * vz)


@scalar
def spin_rate(vx, vy, vz, a, b, c, work, dvx, dvy, dvz, da, db, dc, power):
    """Return ``dn/dt = u . domega/dt``."""
    return spin(vx, vy, vz, da, db, dc, work)


@scalar
def energy(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
    """Energy less the work of friction, in ``M g a``; zero upright and at rest."""
    ux, uy, uz = unit(vx, vy, vz)
    x, y, z, _ = contact(ux, uy, uz, cxx, cxy, cyy, k)
    vx, vy, vz = y * c - z * b, z * a - x * c, x * b - y * a
    moving = ix * a * a + iy * b * b + iz * c * c + vx * vx + vy * vy + vz * vz
    return 0.5 * moving - (x * ux + y * uy + z * uz) - 1.0 - work


@scalar
def contact_force(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
    """Contact force; as :func:`rattlesweep.physics.full.contact_force`."""
    f = rhs(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps)
    ux, uy, uz = unit(vx, vy, vz)
    x, y, z, rho = contact(ux, uy, uz, cxx, cxy, cyy, k)
    wx, wy, wz = moving(ux, uy, uz, a, b, c, x, y, z, rho, cxx, cxy, cyy, k)
    return contact_of(ux, uy, uz, a, b, c, f[3], f[4], f[5], x, y, z, wx, wy, wz)


@scalar
def _dot(one, other):
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@scalar
def _across(u, v):
    n = _dot(u, v)
    return v[0] - n * u[0], v[1] - n * u[1], v[2] - n * u[2]


@scalar
def _lift(u, r, j):
    (x, y, z), (a, b, c) = r, j
    return u[0] * (y * c - z * b) + u[1] * (z * a - x * c) + u[2] * (x * b - y * a)


@scalar
def _inverse(r, h, solved):
    (x, y, z), (hx, hy, hz), (dyz, dzx, dxy, along, ivol) = r, h, solved
    s = (x * dyz * hx + y * dzx * hy + z * dxy * hz) * along
    return (hx + x * s) * dyz * ivol, (hy + y * s) * dzx * ivol, (hz + z * s) * dxy * ivol


@scalar
def _normal(u, r, rho, a, b, c, surface, inertia, sigma):
    w = moving(*u, a, b, c, *r, rho, *surface)
    rates, solved = free_rates(*u, a, b, c, *r, *w, *inertia, sigma)
    normal, _ = contact_of(*u, a, b, c, *rates, *r, *w)
    return normal, w, solved


@scalar
def smooth_volume(vx, vy, vz, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma):
    """Return the rate without rolling resistance, in ``sqrt(g/a)``."""
    u = unit(vx, vy, vz)
    x, y, z, rho = contact(*u, cxx, cxy, cyy, k)
    r, omega, surface = (x, y, z), (a, b, c), (cxx, cxy, cyy, k)
    _, w, solved = _normal(u, r, rho, a, b, c, surface, (ix, iy, iz), sigma)
    dyz, dzx, dxy, along, ivol = solved
    s = sx, sy, sz = x * dyz, y * dzx, z * dxy
    # W of s and of the diagonal part of J^-1 omega, and the diagonal of W.
    ws = moving(*u, *s, *r, rho, *surface)
    wd = moving(*u, dyz * a, dzx * b, dxy * c, *r, rho, *surface)
    wxx, _, _ = moving(*u, 1.0, 0.0, 0.0, *r, rho, *surface)
    _, wyy, _ = moving(*u, 0.0, 1.0, 0.0, *r, rho, *surface)
    _, _, wzz = moving(*u, 0.0, 0.0, 1.0, *r, rho, *surface)
    part = _dot(r, w) - sigma
    rolled = _dot(r, omega)
    diagonal = part * (dyz + dzx + dxy) - _dot(w, s) + _dot(r, wd)
    diagonal = diagonal - rolled * (dyz * wxx + dzx * wyy + dxy * wzz)
    rank_one = (
        (iy - iz) * sx * (sy * c + sz * b) + (iz - ix) * sy * (sz * a + sx * c)
        + (ix - iy) * sz * (sx * b + sy * a)
        + part * _dot(s, s) - _dot(w, s) * _dot(r, s)
        + _dot(s, omega) * _dot(r, ws) - rolled * _dot(s, ws)
    )  # fmt: skip
    return ivol * (diagonal + along * rank_one)


@scalar
def volume(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
    """Return the rate, in ``sqrt(g/a)``; of ``domega/dt`` the resistance takes ``share J^-1 h``."""
    u = unit(vx, vy, vz)
    x, y, z, rho = contact(*u, cxx, cxy, cyy, k)
    r, surface, inertia = (x, y, z), (cxx, cxy, cyy, k), (ix, iy, iz)
    normal, _, solved = _normal(u, r, rho, a, b, c, surface, inertia, sigma)
    dyz, dzx, dxy, along, ivol = solved
    h = _across(u, (a, b, c))
    j = ja, jb, jc = _inverse(r, h, solved)
    root = sqrt(_dot(h, h) + eps * eps)
    below = root + lever * _lift(u, r, j)
    share = lever * normal / below
    # Along j: the normal force is of second degree, so that central differences are exact.
    ahead, _, _ = _normal(u, r, rho, a + ja, b + jb, c + jc, surface, inertia, sigma)
    behind, _, _ = _normal(u, r, rho, a - ja, b - jb, c - jc, surface, inertia, sigma)
    g = _across(u, j)
    wider = _dot(h, g) / root + lever * _lift(u, r, _inverse(r, g, solved))
    s = x * dyz, y * dzx, z * dxy
    flat = dyz * (1.0 - u[0] * u[0]) + dzx * (1.0 - u[1] * u[1]) + dxy * (1.0 - u[2] * u[2])
    trace = ivol * (flat + along * _dot(s, _across(u, s)))
    lost = share * trace + (0.5 * lever * (ahead - behind) - share * wider) / below
    smooth = smooth_volume(vx, vy, vz, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma)
    return smooth - (lost if share > 0.0 else 0.0)


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
