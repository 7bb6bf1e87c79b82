"""The full dynamics (Eqs. diff-u, diff-omega, def-z, def-xy) in five variables, and the track.

The body stands on its lower surface, so ``u_z < 0``, and the slope

    p = u_x / u_z,   q = u_y / u_z,   u = -(p, q, 1) / sqrt(1 + p^2 + q^2)

describes the vertical unit vector.  The state is ``(p, q, a, b, c)`` with ``(a, b, c) = omega``:
what is small near the steady spin is a small number.  For the same reason the surface enters as
``C = B - 1`` with ``B = R(xi) Theta^-1 R^-1(xi)``; ``B - 1`` formed late would lose nine digits at
``theta = 1 - 1e-9``.  The constants of a body are the six numbers of :func:`constants`.

The heading is the angle of the horizontal part ``h_1`` of the body's x axis from its direction at
the start.  The plane's axes are ``h_1`` and ``u x h_1`` at the start, its origin the first contact.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from math import cos, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rattlesweep.arrays import Floats

N_STATE = 5
N_CONSTANTS = 6
N_EXTRA = 3  # heading and the two co-ordinates of the contact point on the plane

# Fused multiply-add only.  With 'nnan' and 'ninf' LLVM folds the test for a non-finite state away;
# 'reassoc' and 'arcp' let the last bits depend on how often a function was optimised.
FASTMATH = {"contract", "nsz"}
# No function pointer for C: it would take time to compile.
scalar = njit(fastmath=FASTMATH, error_model="numpy", forceinline=True, no_cfunc_wrapper=True)


def constants(
    alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike,
    theta: ArrayLike, phi: ArrayLike, xi: ArrayLike,
) -> Floats:  # fmt: skip
    """Return ``I_xx, I_yy, I_zz, C_xx, C_xy, C_yy`` of bodies, (6, ...) (Eqs. def-abg, def-z)."""
    alpha, beta, gamma, theta, phi, xi = np.broadcast_arrays(
        *(np.asarray(x, float) for x in (alpha, beta, gamma, theta, phi, xi))
    )
    roll, pitch = (1 - theta) / theta, (1 - phi) / phi
    s, c = np.sin(xi), np.cos(xi)
    skew = -s * c * (theta - phi) / (theta * phi)
    curvature = c**2 * roll + s**2 * pitch, skew, s**2 * roll + c**2 * pitch
    return np.stack([alpha - 1, beta - 1, gamma, *curvature])


@scalar
def slope_rate(p, q, a, b, c):
    """Derivatives of ``p, q`` (Eq. diff-u, written for the slope), and what they share."""
    m = p * b - q * a
    return q * c - b - p * m, a - p * c - q * m, m


@scalar
def paraboloid(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy):
    """Return how the paraboloid touches the plane (Eqs. def-xy, def-z).

    ``fx, fy, rise`` of the contact point ``r = (p + fx, q + fy, 1 - rise)``; ``wx, wy, wz`` of
    ``w = r x omega - dr/dt``, with what cancels between the two taken out by hand; and ``u_z``.
    """
    fx, fy = cxx * p + cxy * q, cxy * p + cyy * q
    x, y = p + fx, q + fy
    rise = 0.5 * (x * p + y * q)
    twist = fx * q - fy * p
    wx = fy * c + rise * b + p * m - (cxx * dp + cxy * dq)
    wy = q * m - rise * a - fx * c - (cxy * dp + cyy * dq)
    wz = c * twist - 2.0 * m * rise
    uz = -1.0 / sqrt(1.0 + p * p + q * q)
    return fx, fy, rise, wx, wy, wz, uz


@scalar
def turning(p, q, a, b, c, ix, iy, iz, lx, ly, lz, fx, fy, rise, wx, wy, wz, uz):
    """Return the derivatives of ``a, b, c`` (Eq. diff-omega); ``(lx, ly, lz)`` is another torque.

    And, for another right side ``h``, what makes of it ``D^-1 (h + r s)`` with
    ``s = along (x dyz h_x + y dzx h_y + z dxy h_z)``: ``dyz, dzx, dxy, along, ivol``.

    The bracket of Eq. diff-omega is ``omega x w``; the matrix on its left side, ``D - r r^T``, is
    inverted by Sherman and Morrison's formula.  For a long ``r`` both parts of
    ``s = r.D^-1 T / (1 - r.D^-1 r)`` cancel, and are written with ``1 - r^2/d = I/d`` and the
    gyroscopic torque ``(gx, gy, gz)``.
    """
    x, y, z = p + fx, q + fy, 1.0 - rise
    twist = fx * q - fy * p
    kx, ky, kz = b * wz - c * wy, c * wx - a * wz, a * wy - b * wx
    # Torque about the contact point: inertia, motion of the contact point, gravity.
    gx, gy, gz = (iy - iz) * b * c + lx, (iz - ix) * c * a + ly, (ix - iy) * a * b + lz
    tx = gx + (y * kz - z * ky) + uz * (fy + q * rise)
    ty = gy + (z * kx - x * kz) - uz * (fx + p * rise)
    tz = gz + (x * ky - y * kx) + uz * twist
    r2 = x * x + y * y + z * z
    dx, dy, dz = ix + r2, iy + r2, iz + r2
    dyz, dzx, dxy = dy * dz, dz * dx, dx * dy
    vol = dx * dyz
    sx, sy, sz = ix * x * dyz, iy * y * dzx, iz * z * dxy
    det = sx * x + sy * y + sz * z
    inv = 1.0 / (det * vol)
    s = ((x * gx + y * gy + z * gz) * vol - (sx * tx + sy * ty + sz * tz)) * vol * inv
    ivol = det * inv
    rates = (tx + x * s) * dyz * ivol, (ty + y * s) * dzx * ivol, (tz + z * s) * dxy * ivol
    return rates, (dyz, dzx, dxy, r2 * vol * inv, ivol)


@scalar
def rhs(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy):
    """Return the time derivative of the state (Eqs. diff-u and diff-omega)."""
    dp, dq, m = slope_rate(p, q, a, b, c)
    fx, fy, rise, wx, wy, wz, uz = paraboloid(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy)
    rates, _ = turning(p, q, a, b, c, ix, iy, iz, 0.0, 0.0, 0.0, fx, fy, rise, wx, wy, wz, uz)
    return (dp, dq) + rates  # noqa: RUF005


@scalar
def spin(p, q, a, b, c):
    """Spin ``n = u . omega``, in ``sqrt(g/a)``."""
    return -(p * a + q * b + c) / sqrt(1.0 + p * p + q * q)


@scalar
def spin_rate(p, q, da, db, dc):
    """Rate ``dn/dt = u . domega/dt``; the other term, ``(u x omega) . omega``, is zero."""
    return -(p * da + q * db + dc) / sqrt(1.0 + p * p + q * q)


@scalar
def oscillation(p, q, a, b, ix, iy, cxx, cxy, cyy):
    """Twice the energy of the oscillation to second order, in ``M g a``; measures step errors."""
    return (ix + 1.0) * a * a + (iy + 1.0) * b * b + cxx * p * p + 2.0 * cxy * p * q + cyy * q * q


@scalar
def energy(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy):
    """Energy, in ``M g a``; the potential, zero for ``u = (0, 0, -1)``, is a sum of small terms."""
    fx, fy = cxx * p + cxy * q, cxy * p + cyy * q
    x, y = p + fx, q + fy
    z = 1.0 - 0.5 * (x * p + y * q)
    vx, vy, vz = y * c - z * b, z * a - x * c, x * b - y * a
    tilt = p * p + q * q
    root = sqrt(1.0 + tilt)
    lift = tilt / (1.0 + root)
    potential = 0.5 * (fx * p + fy * q + lift * lift) / root
    return 0.5 * (ix * a * a + iy * b * b + iz * c * c + vx * vx + vy * vy + vz * vz) + potential


@scalar
def force(ux, uy, uz, a, b, c, da, db, dc, x, y, z, xd, yd, zd, vx, vy, vz):
    """Return the contact force (Eq. em-1) at ``r``, of rate ``(xd, yd, zd)``, ``v = r x omega``.

    ``F . u``, negative where the plane would have to pull, and ``|F - (F . u) u|``, in ``M g``.
    """
    # dv/dt in space: derivative in the body frame plus omega x v (Eqs. no-slip, em-1).
    gx = (yd * c - zd * b) + (y * dc - z * db) + (b * vz - c * vy)
    gy = (zd * a - xd * c) + (z * da - x * dc) + (c * vx - a * vz)
    gz = (xd * b - yd * a) + (x * db - y * da) + (a * vy - b * vx)
    lift = gx * ux + gy * uy + gz * uz
    hx, hy, hz = gx - lift * ux, gy - lift * uy, gz - lift * uz
    return 1.0 + lift, sqrt(hx * hx + hy * hy + hz * hz)


@scalar
def contact_force(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy):
    """Return the contact force as :func:`force`."""
    dp, dq, da, db, dc = rhs(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy)
    x, y = p + cxx * p + cxy * q, q + cxy * p + cyy * q
    z = 1.0 - 0.5 * (x * p + y * q)
    xd = dp + cxx * dp + cxy * dq
    yd = dq + cxy * dp + cyy * dq
    zd = -(x * dp + y * dq)
    vx, vy, vz = y * c - z * b, z * a - x * c, x * b - y * a
    uz = -1.0 / sqrt(1.0 + p * p + q * q)
    return force(p * uz, q * uz, uz, a, b, c, da, db, dc, x, y, z, xd, yd, zd, vx, vy, vz)


@scalar
def track(p, q, a, b, c, heading, fx, fy, rise, wx, wy, wz, uz):
    """Return the rates of the heading and of the contact point on the plane.

    The heading's is the vertical part of ``e x (omega x e)`` over ``1 - e_vertical^2`` with the x
    axis ``e``; the contact point's is ``dr/dt + v`` (Eq. no-slip).
    """
    uy = q * uz
    square = uy * uy + uz * uz
    root = sqrt(square)
    turn = (uy * b + uz * c) / square
    x, y, z = p + fx, q + fy, 1.0 - rise
    # dr/dt = r x omega - w
    xd = y * c - z * b - wx
    yd = z * a - x * c - wy
    zd = x * b - y * a - wz
    first = xd / root
    second = (yd * uz - zd * uy) / root
    cosine, sine = cos(heading), sin(heading)
    return turn, cosine * first - sine * second, sine * first + cosine * second


def to_vectors(state: Floats) -> tuple[Floats, Floats]:
    """Return ``u`` and ``omega`` (in ``sqrt(g/a)``), both (3, ...), of states of shape (5, ...)."""
    p, q = state[0], state[1]
    slope = np.stack([p, q, np.ones_like(p)])
    return -slope / np.sqrt(1 + p * p + q * q), np.array(state[2:])


def from_vectors(u: ArrayLike, omega: ArrayLike) -> Floats:
    """Return the states (5, ...) of ``u`` and ``omega``, both (3, ...), where ``u_z < 0``."""
    u, omega = np.asarray(u, float), np.asarray(omega, float)
    if np.any(~(u[2] < 0)):
        raise ValueError("u_z must be negative: the body stands on its lower surface")
    return np.concatenate([u[:2] / u[2], omega])


def quaternion(u: Floats, heading: Floats) -> Floats:
    """Return the attitude as unit quaternions, shape (4, ...), the scalar first, without jumps.

    From the body's frame, where the vertical is `u`, shape (3, ...), to the plane's axes.
    """
    ux, uy, uz = u
    root = np.sqrt(uy * uy + uz * uz)
    # Rows h_1, h_2, u of the turn at heading zero, root and h_2y = uz / root on its diagonal.
    # Near the upright position it is half a turn about x, so that q1 is the safe pivot.
    h2y, h2z = uz / root, -uy / root
    pivot = 0.5 * np.sqrt(1 + root - h2y - uz)
    w = (uy - h2z) / (4 * pivot)
    y = -ux * uy / root / (4 * pivot)
    z = (ux - ux * uz / root) / (4 * pivot)
    cosine, sine = np.cos(heading / 2), np.sin(heading / 2)
    first = cosine * w - sine * z, cosine * pivot - sine * y
    return np.stack([*first, cosine * y + sine * pivot, cosine * z + sine * w])
