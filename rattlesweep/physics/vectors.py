"""Ellipsoids in any position, and the rate at which the flow changes phase volume.

An ellipsoid that rolls onto its side leaves the slopes of
:mod:`rattlesweep.physics.full`.  Here the state is ``(v_x, v_y, v_z, a, b, c, work)``:
a vector along the vertical, of any length, the angular velocity and the work of
friction.  With ``u = v/|v|``, ``B = 1 + C`` and ``k = 1/c`` the ellipsoid of
:mod:`rattlesweep.physics.stone` touches the plane at

    r = (-B (u_x, u_y) / rho, 1 - (1 + u_z/rho) / k),    rho^2 = u_z^2 + k s,
    s = (u_x, u_y).B (u_x, u_y),

and for ``k = 0`` and ``u_z < 0`` so does the paraboloid.  The constants are those with
friction.

Phase volume is the product of the volumes of ``u``, which only turns, and of ``omega``.
It changes at the relative rate ``tr d(J^-1 T)/domega`` with ``J`` and ``T``, the right
side of Eq. 11, as in :func:`rattlesweep.physics.full.solve_rates`.  With ``w = W
omega`` and the gyroscopic and viscous part ``G``,

    dT/domega = G + (r.w) 1 - w r^T + omega (W^T r)^T - (r.omega) W,
    J^-1 = ivol (diag(dyz, dzx, dxy) + along s s^T),    s = (x dyz, y dzx, z dxy).

``solved`` stands for ``(dyz, dzx, dxy, along, ivol)``.
"""

# mypy: disable-error-code="no-untyped-def"
from math import sqrt

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics import full, stone
from rattlesweep.physics.full import acceleration, scalar
from rattlesweep.physics.stone import (
    dot,
    force_at,
    horizontal,
    resistance,
    solve_again,
    triple,
)

N_STATE = 7
CONSTANTS = *stone.CONSTANTS, "sigma", "rolling", "smoothing"
# Rotation and path since the start of a step, which single steps add to the state.
N_EXTRA = 7


@scalar
def unit(vx, vy, vz):
    """Return the unit vector along a vector."""
    length = sqrt(vx * vx + vy * vy + vz * vz)
    return vx / length, vy / length, vz / length


@scalar
def contact_under(ux, uy, uz, cxx, cxy, cyy, k):
    """Return the contact point ``r`` and ``rho``."""
    bx = ux + cxx * ux + cxy * uy
    by = uy + cxy * ux + cyy * uy
    s = bx * ux + by * uy
    rho = sqrt(uz * uz + k * s)
    # Nothing cancels in the first form if u_z < 0, also for k = 0, nor in the second
    # otherwise.
    rise = s / (rho * (rho - uz)) if uz < 0.0 else (1.0 + uz / rho) / k
    return (-bx / rho, -by / rho, 1.0 - rise), rho


@scalar
def moving(u, omega, r, rho, cxx, cxy, cyy, k):
    """Return ``w = r x omega - dr/dt``, which is linear in ``omega``."""
    ux, uy, uz = u
    a, b, c = omega
    x, y, z = r
    du = uy * c - uz * b
    dv = uz * a - ux * c
    dw = ux * b - uy * a
    bx = du + cxx * du + cxy * dv
    by = dv + cxy * du + cyy * dv
    # Half the derivative of s, and the logarithmic derivative of rho.
    g = ux * bx + uy * by
    fall = (uz * dw + k * g) / (rho * rho)
    # Minus the derivative of the third component of r, without dividing by k.
    sink = (uz * g + (x * ux + y * uy) * rho * dw) / (rho * rho * rho)
    return (
        y * c - z * b + bx / rho + x * fall,
        z * a - x * c + by / rho + y * fall,
        x * b - y * a - sink,
    )


@scalar
def smooth_rates(u, omega, r, rho, surface, inertia, sigma):
    """Return ``domega/dt`` without rolling resistance, ``F_n, w`` and ``solved``."""
    ux, uy, uz = u
    a, b, c = omega
    x, y, z = r
    w = moving(u, omega, r, rho, *surface)
    # At slope zero gravity acts along z only; the torque r x (u_x, u_y, 0) of the rest
    # is added.
    rates, solved = acceleration(
        0.0,
        0.0,
        a,
        b,
        c,
        *inertia,
        -sigma * a - z * uy,
        -sigma * b + z * ux,
        -sigma * c + x * uy - y * ux,
        x,
        y,
        1.0 - z,
        *w,
        uz,
    )
    normal, _ = force_at(*u, *omega, *rates, *r, *w)
    return rates, normal, w, solved


@scalar
def rhs(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
    """Return the time derivative of the state (Eqs. 10 and 11, with friction)."""
    u = unit(vx, vy, vz)
    omega = (a, b, c)
    surface = (cxx, cxy, cyy, k)
    r, rho = contact_under(*u, *surface)
    rates, normal, _, solved = smooth_rates(
        u, omega, r, rho, surface, (ix, iy, iz), sigma
    )
    da, db, dc = rates
    ra, rb, rc, loss = resistance(u, omega, r, normal, lever, eps, solved)
    power = -sigma * (a * a + b * b + c * c) - loss
    dv = vy * c - vz * b, vz * a - vx * c, vx * b - vy * a
    return dv + (da - ra, db - rb, dc - rc, power)  # noqa: RUF005


@scalar
def spin(vx, vy, vz, a, b, c):
    """Return the spin ``n = u . omega`` (Eq. 46), in ``sqrt(g/a)``."""
    return (vx * a + vy * b + vz * c) / sqrt(vx * vx + vy * vy + vz * vz)


@scalar
def energy(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
    """Return the energy minus the work of friction, in ``M g a``; 0 at rest upright."""
    ux, uy, uz = unit(vx, vy, vz)
    (x, y, z), _ = contact_under(ux, uy, uz, cxx, cxy, cyy, k)
    # The velocity of the centre of mass, r x omega.
    px, py, pz = y * c - z * b, z * a - x * c, x * b - y * a
    twice_kinetic = ix * a * a + iy * b * b + iz * c * c + px * px + py * py + pz * pz
    return 0.5 * twice_kinetic - (x * ux + y * uy + z * uz) - 1.0 - work


@scalar
def contact_force(vx, vy, vz, a, b, c, da, db, dc, cxx, cxy, cyy, k):
    """Return the contact force in ``M g``, as :func:`full.force` does."""
    u = unit(vx, vy, vz)
    omega = (a, b, c)
    r, rho = contact_under(*u, cxx, cxy, cyy, k)
    w = moving(u, omega, r, rho, cxx, cxy, cyy, k)
    return force_at(*u, *omega, da, db, dc, *r, *w)


@scalar
def smooth_volume(vx, vy, vz, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma):
    """Return the rate of phase volume without rolling resistance, in ``sqrt(g/a)``."""
    u = unit(vx, vy, vz)
    omega = (a, b, c)
    surface = (cxx, cxy, cyy, k)
    r, rho = contact_under(*u, *surface)
    x, y, z = r
    _, _, w, solved = smooth_rates(u, omega, r, rho, surface, (ix, iy, iz), sigma)
    dyz, dzx, dxy, along, ivol = solved
    s = sx, sy, sz = x * dyz, y * dzx, z * dxy
    # W times s, W times diag(dyz, dzx, dxy) omega, and the diagonal of W.
    ws = moving(u, s, r, rho, *surface)
    wd = moving(u, (dyz * a, dzx * b, dxy * c), r, rho, *surface)
    wxx, _, _ = moving(u, (1.0, 0.0, 0.0), r, rho, *surface)
    _, wyy, _ = moving(u, (0.0, 1.0, 0.0), r, rho, *surface)
    _, _, wzz = moving(u, (0.0, 0.0, 1.0), r, rho, *surface)
    gain = dot(r, w) - sigma
    rolled = dot(r, omega)
    diagonal = gain * (dyz + dzx + dxy) - dot(w, s) + dot(r, wd)
    diagonal = diagonal - rolled * (dyz * wxx + dzx * wyy + dxy * wzz)
    rank_one = (
        (iy - iz) * sx * (sy * c + sz * b)
        + (iz - ix) * sy * (sz * a + sx * c)
        + (ix - iy) * sz * (sx * b + sy * a)
        + gain * dot(s, s)
        - dot(w, s) * dot(r, s)
        + dot(s, omega) * dot(r, ws)
        - rolled * dot(s, ws)
    )
    return ivol * (diagonal + along * rank_one)


@scalar
def volume(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
    """Return the rate of phase volume with the resistance ``share J^-1 h``."""
    u = unit(vx, vy, vz)
    omega = (a, b, c)
    surface = (cxx, cxy, cyy, k)
    inertia = (ix, iy, iz)
    r, rho = contact_under(*u, *surface)
    x, y, z = r
    _, normal, _, solved = smooth_rates(u, omega, r, rho, surface, inertia, sigma)
    dyz, dzx, dxy, along, ivol = solved
    h = horizontal(u, omega)
    j = ja, jb, jc = solve_again(r, h, solved)
    root = sqrt(dot(h, h) + eps * eps)
    below = root + lever * triple(u, r, j)
    share = lever * normal / below
    # The normal force is quadratic in omega, so its central difference along j is
    # exact.
    more = (a + ja, b + jb, c + jc)
    less = (a - ja, b - jb, c - jc)
    _, ahead, _, _ = smooth_rates(u, more, r, rho, surface, inertia, sigma)
    _, behind, _, _ = smooth_rates(u, less, r, rho, surface, inertia, sigma)
    g = horizontal(u, j)
    wider = dot(h, g) / root + lever * triple(u, r, solve_again(r, g, solved))
    s = x * dyz, y * dzx, z * dxy
    flat = (
        dyz * (1.0 - u[0] * u[0])
        + dzx * (1.0 - u[1] * u[1])
        + dxy * (1.0 - u[2] * u[2])
    )
    trace = ivol * (flat + along * dot(s, horizontal(u, s)))
    lost = share * trace + (0.5 * lever * (ahead - behind) - share * wider) / below
    smooth = smooth_volume(vx, vy, vz, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma)
    return smooth - (lost if share > 0.0 else 0.0)


@scalar
def rolled(u, omega, shape):
    """Return the velocity of the contact point of a rolling body, in its own axes."""
    a, b, c = omega
    r, rho = contact_under(*u, *shape)
    x, y, z = r
    wx, wy, wz = moving(u, omega, r, rho, *shape)
    # dr/dt = r x omega - w
    return y * c - z * b - wx, z * a - x * c - wy, x * b - y * a - wz


@scalar
def carried_on(rotation, omega, velocity):
    """Return the rates of the rotation and the path since the start of a step.

    The rotation is a unit quaternion less 1, so that it starts at zero.  The path has
    the axes of the body at the start.
    """
    less, x, y, z = rotation
    w = 1.0 + less
    a, b, c = omega
    vx, vy, vz = velocity
    # The velocity turned by the quaternion: v + 2 q x (q x v + w v).
    tx = y * vz - z * vy + w * vx
    ty = z * vx - x * vz + w * vy
    tz = x * vy - y * vx + w * vz
    return (
        -0.5 * (x * a + y * b + z * c),
        0.5 * (w * a + y * c - z * b),
        0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y * a),
        vx + 2.0 * (y * tz - z * ty),
        vy + 2.0 * (z * tx - x * tz),
        vz + 2.0 * (x * ty - y * tx),
    )


def from_slopes(y: Floats, constants: Floats) -> tuple[Floats, Floats]:
    """Return states (runs, 7) and constants (runs, 10) of runs in slopes.

    The runs may have friction or not.
    """
    u, omega = full.to_vectors(y[:, : full.N_STATE].T)
    work = y[:, full.N_STATE :]
    loss = constants[:, stone.N_CONSTANTS :]
    if not work.size:
        work = np.zeros((len(y), 1))
        no_loss = np.tile([0.0, 0.0, stone.SMOOTHING], (len(y), 1))
        loss = np.hstack([no_loss, loss])
    return np.hstack([u.T, omega.T, work]), np.hstack(
        [constants[:, : stone.N_CONSTANTS], loss]
    )


def to_slopes(y: Floats) -> Floats:
    """Return slopes, angular velocity and work, (runs, 6), of states (runs, 7)."""
    return np.hstack([y[:, :2] / y[:, 2:3], y[:, 3:]])
