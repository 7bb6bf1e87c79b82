"""The full dynamics (Eqs. 4, 8, 10, 11) in five variables, and the track on the plane.

Equation numbers in this package are those of Kondo and Nakanishi, Phys. Rev. E 95,
062207 (2017), and the units are M = a = g = 1.

The body stands on its lower surface, so that ``u_z < 0``, and the slope

    p = u_x / u_z,   q = u_y / u_z,   u = -(p, q, 1) / sqrt(1 + p^2 + q^2)

describes the vertical unit vector.  The state is ``(p, q, a, b, c)`` with ``(a, b, c) =
omega``, so that quantities that are small near the steady spin are stored as small
numbers.  For the same reason the surface enters as ``C = B - 1`` with ``B = R(xi)
Theta^-1 R^-1(xi)``: subtracting 1 from ``B`` would lose nine digits at ``theta = 1 -
1e-9``.

The heading is the angle of the horizontal part ``h_1`` of the body's x axis from its
direction at the start.  ``h_1`` and ``u x h_1`` at the start are the axes of the plane,
with the origin at the contact point.

Stability: may change.
"""

# mypy: disable-error-code="no-untyped-def"
import os
from math import cos, sin, sqrt

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import FASTMATH
from rattlesweep.compiling.loading import IS_CHILD

N_STATE = 5
CONSTANTS = "ix", "iy", "iz", "cxx", "cxy", "cyy"
N_EXTRA = 3  # heading and the two co-ordinates of the contact point on the plane

# Nothing calls these functions from C, and nothing from Python in a process that
# compiles kernels.  Wrappers for it take time to compile.
scalar = njit(
    fastmath=FASTMATH,
    error_model="numpy",
    forceinline=True,
    no_cfunc_wrapper=True,
    no_cpython_wrapper=IS_CHILD in os.environ,
)
# Added to a divisor, it prevents a division by zero, as in empty lanes, and changes no
# other result.
TINY = 1e-290
NO_FORCE = 0.0, 0.0, 0.0


def constants(
    alpha: ArrayLike,
    beta: ArrayLike,
    gamma: ArrayLike,
    theta: ArrayLike,
    phi: ArrayLike,
    xi: ArrayLike,
) -> Floats:
    """Return ``I_xx, I_yy, I_zz, C_xx, C_xy, C_yy``, shape (6, ...) (Eqs. 6, 14)."""
    alpha, beta, gamma, theta, phi, xi = np.broadcast_arrays(
        *(np.asarray(x, float) for x in (alpha, beta, gamma, theta, phi, xi))
    )
    roll = (1 - theta) / theta
    pitch = (1 - phi) / phi
    s = np.sin(xi)
    c = np.cos(xi)
    skew = -s * c * (theta - phi) / (theta * phi)
    curvature = c**2 * roll + s**2 * pitch, skew, s**2 * roll + c**2 * pitch
    return np.stack([alpha - 1, beta - 1, gamma, *curvature])


@scalar
def slope_rate(y):
    """Return ``dp/dt, dq/dt`` (Eq. 10 for the slope) and ``m = p b - q a``."""
    p, q, a, b, c = y[:5]
    m = p * b - q * a
    return q * c - b - p * m, a - p * c - q * m, m


@scalar
def paraboloid(y, slope_rates, shape):
    """Return the contact (Eqs. 4 and 8): ``(fx, fy, rise), w, u_z``.

    ``slope_rates`` are those of :func:`slope_rate`.  The contact point is ``r = (p +
    fx, q + fy, 1 - rise)``.  In ``w = r x omega - dr/dt`` the terms that cancel are
    left out.  A fourth constant of the shape, which other surfaces have, is not used.
    """
    p, q, a, b, c = y[:5]
    dp, dq, m = slope_rates
    cxx, cxy, cyy = shape[:3]
    fx = cxx * p + cxy * q
    fy = cxy * p + cyy * q
    x = p + fx
    y_ = q + fy
    rise = 0.5 * (x * p + y_ * q)
    twist = fx * q - fy * p
    wx = fy * c + rise * b + p * m - (cxx * dp + cxy * dq)
    wy = q * m - rise * a - fx * c - (cxy * dp + cyy * dq)
    wz = c * twist - 2.0 * m * rise
    uz = -1.0 / sqrt(1.0 + p * p + q * q)
    return (fx, fy, rise), (wx, wy, wz), uz


@scalar
def contact_point(y, touch):
    """Return the contact point ``r`` of a contact, as :func:`paraboloid` returns it."""
    p, q = y[:2]
    (fx, fy, rise), _, _ = touch
    return p + fx, q + fy, 1.0 - rise


@scalar
def solve_rates(r, inertia, torque, product):
    """Return ``J^-1 T``, with ``J`` on the left side of Eq. 11, and the inverse used.

    ``J = D - r r^T`` with ``D = I + r^2``; by the formula of Sherman and Morrison
    ``J^-1 T = D^-1 (T + r s)`` with ``s = r.D^-1 T / (1 - r.D^-1 r)``.  For a long
    ``r`` numerator and denominator of ``s`` cancel, so they are written with ``1 -
    r^2/d = I/d`` and with the ``product`` ``r.T``, which callers compute without the
    parts of ``T`` normal to ``r``.

    The second value ``(dyz, dzx, dxy, along, ivol)`` solves for another torque ``h``:
    ``s = along (x dyz h_x + y dzx h_y + z dxy h_z)`` and ``D^-1 = ivol diag(dyz, dzx,
    dxy)``.
    """
    x, y, z = r
    ix, iy, iz = inertia
    tx, ty, tz = torque
    r2 = x * x + y * y + z * z
    dx, dy, dz = ix + r2, iy + r2, iz + r2
    dyz, dzx, dxy = dy * dz, dz * dx, dx * dy
    vol = dx * dyz
    sx, sy, sz = ix * x * dyz, iy * y * dzx, iz * z * dxy
    det = sx * x + sy * y + sz * z
    inv = 1.0 / (det * vol)
    s = (product * vol - (sx * tx + sy * ty + sz * tz)) * vol * inv
    ivol = det * inv
    rates = (
        (tx + x * s) * dyz * ivol,
        (ty + y * s) * dzx * ivol,
        (tz + z * s) * dxy * ivol,
    )
    return rates, (dyz, dzx, dxy, r2 * vol * inv, ivol)


@scalar
def moments(y, inertia, torque, touch):
    """Return parts of the torque about the contact point, and ``omega x w`` (Eq. 11).

    They are: the gyroscopic torque, to which a further ``torque`` is added; the same
    with that by the motion of the contact point; gravity's over ``u_z``, ``g = r x (p,
    q, 1)``.
    """
    p, q, a, b, c = y[:5]
    ix, iy, iz = inertia
    lx, ly, lz = torque
    (fx, fy, rise), (wx, wy, wz), _ = touch
    x, y_, z = p + fx, q + fy, 1.0 - rise
    twist = fx * q - fy * p
    kx, ky, kz = b * wz - c * wy, c * wx - a * wz, a * wy - b * wx
    gx, gy, gz = (iy - iz) * b * c + lx, (iz - ix) * c * a + ly, (ix - iy) * a * b + lz
    tx = gx + (y_ * kz - z * ky)
    ty = gy + (z * kx - x * kz)
    tz = gz + (x * ky - y_ * kx)
    gravity = fy + q * rise, -(fx + p * rise), twist
    return (gx, gy, gz), (tx, ty, tz), gravity, (kx, ky, kz)


@scalar
def acceleration(y, inertia, torque, touch, weight=1.0):
    """Return ``domega/dt`` (Eq. 11) under a further torque, and the inverse used.

    ``weight`` is that of the body, in ``M g``.
    """
    r = x, y_, z = contact_point(y, touch)
    (gx, gy, gz), (tx, ty, tz), (vx, vy, vz), _ = moments(y, inertia, torque, touch)
    _, _, uz = touch
    pull = weight * uz
    whole = tx + pull * vx, ty + pull * vy, tz + pull * vz
    return solve_rates(r, inertia, whole, x * gx + y_ * gy + z * gz)


@scalar
def rhs(y, constants):
    """Return the time derivative of the state (Eqs. 10 and 11)."""
    dp, dq, m = slope_rate(y)
    touch = paraboloid(y, (dp, dq, m), constants[3:])
    rates, _ = acceleration(y, constants[:3], (0.0, 0.0, 0.0), touch)
    return (dp, dq) + rates  # noqa: RUF005


@scalar
def spin(y):
    """Return the spin ``n = u . omega`` (Eq. 46), in ``sqrt(g/a)``."""
    p, q, a, b, c = y[:5]
    return -(p * a + q * b + c) / sqrt(1.0 + p * p + q * q)


@scalar
def spin_rate(y, dy):
    """Return ``dn/dt = u . domega/dt``, as ``(u x omega) . omega`` is zero."""
    p, q = y[:2]
    _, _, da, db, dc = dy[:5]
    return -(p * da + q * db + dc) / sqrt(1.0 + p * p + q * q)


@scalar
def oscillation(y, constants):
    """Return twice the energy of the oscillation to second order, in ``M g a``."""
    p, q, a, b = y[:4]
    ix, iy, _, cxx, cxy, cyy = constants[:6]
    return (
        (ix + 1.0) * a * a
        + (iy + 1.0) * b * b
        + cxx * p * p
        + 2.0 * cxy * p * q
        + cyy * q * q
    )


@scalar
def energy(y, constants):
    """Return the energy in ``M g a``, which is zero upright at rest.

    The potential loses no digits there.
    """
    p, q, a, b, c = y[:5]
    ix, iy, iz, cxx, cxy, cyy = constants[:6]
    fx = cxx * p + cxy * q
    fy = cxy * p + cyy * q
    x = p + fx
    y_ = q + fy
    z = 1.0 - 0.5 * (x * p + y_ * q)
    vx, vy, vz = y_ * c - z * b, z * a - x * c, x * b - y_ * a
    tilt = p * p + q * q
    root = sqrt(1.0 + tilt)
    lift = tilt / (1.0 + root)
    potential = 0.5 * (fx * p + fy * q + lift * lift) / root
    return (
        0.5 * (ix * a * a + iy * b * b + iz * c * c + vx * vx + vy * vy + vz * vz)
        + potential
    )


@scalar
def force(u, omega, rates, r, r_rate, v, weight=1.0, applied=NO_FORCE):
    """Return ``F . u`` and ``(F - (F . u) u)^2`` of the contact force (Eq. 1).

    The contact point ``r`` has the derivative ``r_rate``, ``omega`` the derivative
    ``rates``, and ``v = r x omega``.  Beside the ``weight``, the force ``applied`` acts
    at the centre of mass.  ``F . u`` is negative where the plane would have to pull.
    """
    px, py, pz = applied
    ux, uy, uz = u
    a, b, c = omega
    da, db, dc = rates
    x, y, z = r
    xd, yd, zd = r_rate
    vx, vy, vz = v
    # dv/dt in space: the derivative in the body frame plus omega x v (Eqs. 3 and 9).
    gx = (yd * c - zd * b) + (y * dc - z * db) + (b * vz - c * vy) - px
    gy = (zd * a - xd * c) + (z * da - x * dc) + (c * vx - a * vz) - py
    gz = (xd * b - yd * a) + (x * db - y * da) + (a * vy - b * vx) - pz
    lift = gx * ux + gy * uy + gz * uz
    hx, hy, hz = gx - lift * ux, gy - lift * uy, gz - lift * uz
    return weight + lift, hx * hx + hy * hy + hz * hz


@scalar
def contact_force(y, dy, constants):
    """Return the contact force, as :func:`force` does, from the derivative."""
    p, q, a, b, c = y[:5]
    dp, dq, da, db, dc = dy[:5]
    cxx, cxy, cyy = constants[3:6]
    x = p + cxx * p + cxy * q
    y_ = q + cxy * p + cyy * q
    z = 1.0 - 0.5 * (x * p + y_ * q)
    xd = dp + cxx * dp + cxy * dq
    yd = dq + cxy * dp + cyy * dq
    zd = -(x * dp + y_ * dq)
    v = y_ * c - z * b, z * a - x * c, x * b - y_ * a
    uz = -1.0 / sqrt(1.0 + p * p + q * q)
    u = p * uz, q * uz, uz
    return force(u, (a, b, c), (da, db, dc), (x, y_, z), (xd, yd, zd), v)


@scalar
def track_at(u, omega, r, w, heading):
    """Return the rates of the heading and of the contact point's place on the plane.

    With the x axis ``e``, the rate of the heading is the vertical part of ``e x (omega
    x e)`` over ``1 - (e . u)^2``.  The contact point has the velocity ``dr/dt + v``
    with ``v`` of Eq. 3.
    """
    _, uy, uz = u
    a, b, c = omega
    x, y, z = r
    wx, wy, wz = w
    square = uy * uy + uz * uz
    root = sqrt(square)
    turn = (uy * b + uz * c) / square
    # dr/dt = r x omega - w
    xd = y * c - z * b - wx
    yd = z * a - x * c - wy
    zd = x * b - y * a - wz
    first = xd / root
    second = (yd * uz - zd * uy) / root
    cosine = cos(heading)
    sine = sin(heading)
    return turn, cosine * first - sine * second, sine * first + cosine * second


@scalar
def track(y, heading, touch):
    """Return what :func:`track_at` does, for a slope and its contact."""
    p, q, a, b, c = y[:5]
    _, w, uz = touch
    u = p * uz, q * uz, uz
    return track_at(u, (a, b, c), contact_point(y, touch), w, heading)


def to_vectors(state: Floats) -> tuple[Floats, Floats]:
    """Return ``u`` and ``omega``, both (3, ...), of states of shape (5, ...)."""
    p = state[0]
    q = state[1]
    slope = np.stack([p, q, np.ones_like(p)])
    return -slope / np.sqrt(1 + p * p + q * q), np.array(state[2:])


def from_vectors(u: ArrayLike, omega: ArrayLike) -> Floats:
    """Return states (5, ...) of ``u`` and ``omega``, (3, ...).

    Raise ValueError where ``u_z >= 0``.
    """
    u = np.asarray(u, float)
    omega = np.asarray(omega, float)
    if np.any(~(u[2] < 0)):
        raise ValueError("u_z must be negative: the body stands on its lower surface")
    return np.concatenate([u[:2] / u[2], omega])


def quaternion(u: Floats, heading: Floats) -> Floats:
    """Return unit quaternions (4, ...), scalar first, from the body to the plane.

    `u` has the shape (3, ...), `heading` (...).  The result is continuous in time.
    """
    ux, uy, uz = u
    root = np.sqrt(uy * uy + uz * uz)
    # The rotation at heading zero has the rows h_1, h_2 and u, with root and h_2y = uz
    # / root on its diagonal.  Near the upright position it is half a turn about x, so
    # q1 is the safe pivot.
    h2y = uz / root
    h2z = -uy / root
    pivot = 0.5 * np.sqrt(1 + root - h2y - uz)
    w = (uy - h2z) / (4 * pivot)
    y = -ux * uy / root / (4 * pivot)
    z = (ux - ux * uz / root) / (4 * pivot)
    cosine = np.cos(heading / 2)
    sine = np.sin(heading / 2)
    first = cosine * w - sine * z, cosine * pivot - sine * y
    return np.stack([*first, cosine * y + sine * pivot, cosine * z + sine * w])
