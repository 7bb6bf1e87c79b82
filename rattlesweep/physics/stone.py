"""Ellipsoidal surface and friction: what a real stone adds to `physics.full`.

The ellipsoid has the vertical semi-axis ``c`` and the curvatures ``theta, phi`` at its
bottom; its centre lies ``c`` above the lowest point.  With ``B = 1 + C`` and ``s = (p,
q).B(p, q)`` its contact point is

    r = (e B(p, q), 1 - c (1 - e)),    e = 1 / sqrt(1 + s / c),

which for ``1/c = 0`` is that of the paraboloid.  The further constant of a body is ``k
= 1/c``.

Friction consists of two couples: ``-sigma omega`` (Kane and Levinson 1982, Eqs. 47-49),
and the rolling resistance ``-lever F_n omega_t / sqrt(omega_t^2 + eps^2)`` with the
part ``omega_t`` of ``omega`` in the plane and the normal force ``F_n``.  Their work is
the sixth variable of the state; energy minus work is conserved.

Functions that take a ``contact`` and its constants ``shape`` work for every surface
(:mod:`rattlesweep.physics.surface`).
"""

# mypy: disable-error-code="no-untyped-def"
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from rattlesweep.arrays import Floats
from rattlesweep.physics import full
from rattlesweep.physics.full import (
    NO_FORCE,
    acceleration,
    contact_point,
    force,
    moments,
    scalar,
    slope_rate,
)

CONSTANTS = *full.CONSTANTS, "k"
N_CONSTANTS = len(CONSTANTS)
N_FRICTION_STATE = 6

SMOOTHING = 1e-4  # eps, in sqrt(g/a): below it rolling resistance becomes viscous


def inverse_semi_axis(c: ArrayLike | None) -> Floats:
    """Return ``1/c``, or 0 for paraboloids, whose ``c`` is None or NaN."""
    values = np.asarray(np.nan if c is None else c, float)
    return np.where(np.isnan(values), 0.0, 1.0 / values)


@scalar
def ellipsoid_contact(y, slope_rates, shape, e, rise):
    """Return the contact of an ellipsoid from its ``e`` and ``rise = (1 - e) / k``."""
    p, q, a, b, c = y[:5]
    dp, dq, m = slope_rates
    cxx, cxy, cyy, k = shape[:4]
    gx = cxx * p + cxy * q
    gy = cxy * p + cyy * q
    x0 = p + gx
    y0 = q + gy
    less = k * rise
    fx = e * gx - less * p
    fy = e * gy - less * q
    # Logarithmic derivative of 1 / e.
    fall = k * (e * e) * (x0 * dp + y0 * dq)
    lift = rise - less
    wx = e * (gy * c + p * m - cxx * dp - cxy * dq + fall * x0) + lift * b
    wy = e * (q * m - gx * c - cxy * dp - cyy * dq + fall * y0) - lift * a
    wz = c * (fx * q - fy * p) - (x0 * p + y0 * q) * e * (m + fall)
    return (fx, fy, rise), (wx, wy, wz), -1.0 / sqrt(1.0 + p * p + q * q)


@scalar
def shape_at(y, shape):
    """Return ``e`` and ``rise = (1 - e) / k`` of an ellipsoid."""
    p, q = y[:2]
    cxx, cxy, cyy, k = shape
    s = (p + (cxx * p + cxy * q)) * p + (q + (cxy * p + cyy * q)) * q
    rho = sqrt(1.0 + k * s)
    # Two independent divisions have a lower latency than one division and a product.
    return 1.0 / rho, s / (rho + rho * rho)


@scalar
def ellipsoid(y, slope_rates, shape):
    """Return the contact of the ellipsoid, as :func:`full.paraboloid` does."""
    e, rise = shape_at(y, shape)
    return ellipsoid_contact(y, slope_rates, shape, e, rise)


@scalar
def frictionless_rhs(contact, y, inertia, shape, loss):
    """Return the time derivative of the state without friction; ``loss`` is empty."""
    dp, dq, m = slope_rate(y)
    touch = contact(y, (dp, dq, m), shape)
    rates, _ = acceleration(y, inertia, (0.0, 0.0, 0.0), touch)
    return (dp, dq) + rates  # noqa: RUF005


@scalar
def rise_at(y, shape):
    """Return ``rise``, which steps carry, since each stage would need a root for it."""
    _, rise = shape_at(y, shape)
    return rise


@scalar
def corrected_rise(y, shape):
    """Return ``e`` and ``rise`` by a step of Newton's method from a nearby ``rise``.

    That is the last number of ``shape``.
    """
    p, q = y[:2]
    cxx, cxy, cyy, k, rise = shape
    s = (p + (cxx * p + cxy * q)) * p + (q + (cxy * p + cyy * q)) * q
    e = 1.0 - k * rise
    step = (0.5 * e) * (s * (e * e) - (rise + rise * e))
    return e - k * step, rise + step


@scalar
def rise_rate(y, dy, shape):
    """Return the derivative of ``rise``, the last number of ``shape``."""
    p, q = y[:2]
    dp, dq = dy[:2]
    cxx, cxy, cyy = shape[:3]
    e, _ = corrected_rise(y, shape)
    return (
        e * (e * e) * ((p + (cxx * p + cxy * q)) * dp + (q + (cxy * p + cyy * q)) * dq)
    )


@scalar
def carried_ellipsoid(y, slope_rates, shape):
    """Like :func:`ellipsoid`, but avoids the square root by an approximate ``rise``.

    That is the last number of ``shape``.
    """
    e, rise = corrected_rise(y, shape)
    return ellipsoid_contact(y, slope_rates, shape, e, rise)


@scalar
def energy(y, constants):
    """Return the energy of an ellipsoid, as :func:`full.energy` does."""
    p, q, a, b, c = y[:5]
    ix, iy, iz, cxx, cxy, cyy, k = constants[:7]
    gx = cxx * p + cxy * q
    gy = cxy * p + cyy * q
    tilt = p * p + q * q
    s = tilt + gx * p + gy * q
    rho = sqrt(1.0 + k * s)
    half = s / (1.0 + rho)
    x, y_, z = (p + gx) / rho, (q + gy) / rho, 1.0 - half / rho
    vx, vy, vz = y_ * c - z * b, z * a - x * c, x * b - y_ * a
    root = sqrt(1.0 + tilt)
    lift = tilt / (1.0 + root)
    potential = 0.5 * (gx * p + gy * q + lift * lift - k * half * half) / root
    return (
        0.5 * (ix * a * a + iy * b * b + iz * c * c + vx * vx + vy * vy + vz * vz)
        + potential
    )


@scalar
def force_at(u, omega, rates, r, w, weight=1.0, applied=NO_FORCE):
    """Return the contact force, as `full.force` does; ``dr/dt = r x omega - w``."""
    a, b, c = omega
    x, y, z = r
    wx, wy, wz = w
    vx, vy, vz = y * c - z * b, z * a - x * c, x * b - y * a
    r_rate = vx - wx, vy - wy, vz - wz
    return force(u, omega, rates, r, r_rate, (vx, vy, vz), weight, applied)


@scalar
def surface_force(contact, y, dy, constants):
    """Return the contact force, as :func:`full.contact_force`, from the derivative."""
    p, q, a, b, c = y[:5]
    dp, dq, da, db, dc = dy[:5]
    m = p * b - q * a
    touch = contact(y, (dp, dq, m), constants[3:7])
    _, w, uz = touch
    u = p * uz, q * uz, uz
    return force_at(u, (a, b, c), (da, db, dc), contact_point(y, touch), w)


@scalar
def dot(u, v):
    """Return ``u . v``."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@scalar
def horizontal(u, v):
    """Return the part of a vector normal to the unit vector ``u``."""
    n = dot(u, v)
    return v[0] - n * u[0], v[1] - n * u[1], v[2] - n * u[2]


@scalar
def triple(u, r, v):
    """Return ``u . (r x v)``."""
    x, y, z = r
    a, b, c = v
    return u[0] * (y * c - z * b) + u[1] * (z * a - x * c) + u[2] * (x * b - y * a)


@scalar
def solve_again(r, h, solved):
    """Return ``J^-1 h``, where ``solved`` is the second value of `full.solve_rates`."""
    x, y, z = r
    hx, hy, hz = h
    dyz, dzx, dxy, along, ivol = solved
    s = (x * dyz * hx + y * dzx * hy + z * dxy * hz) * along
    return (
        (hx + x * s) * dyz * ivol,
        (hy + y * s) * dzx * ivol,
        (hz + z * s) * dxy * ivol,
    )


@scalar
def viscous_rhs(contact, y, inertia, shape, loss):
    """Return the derivative of state and work under the torque ``-sigma omega``."""
    a, b, c = y[2:5]
    (sigma,) = loss
    dp, dq, m = slope_rate(y)
    touch = contact(y, (dp, dq, m), shape)
    lx, ly, lz = -sigma * a, -sigma * b, -sigma * c
    rates, _ = acceleration(y, inertia, (lx, ly, lz), touch)
    return (dp, dq) + rates + (lx * a + ly * b + lz * c,)  # noqa: RUF005


@scalar
def rolling_resistance(u, omega, lever, eps):
    """Return the torque of the rolling resistance over the normal force."""
    hx, hy, hz = h = horizontal(u, omega)
    share = -lever / sqrt(dot(h, h) + eps * eps)
    return share * hx, share * hy, share * hz


@scalar
def viscous_torque(place, own):
    """Return the torque ``-sigma omega`` of an action."""
    (sigma,) = own
    a, b, c = place.omega
    return -sigma * a, -sigma * b, -sigma * c


@scalar
def rolling_torque(place, own):
    """Return what :func:`rolling_resistance` does, for an action."""
    lever, eps = own
    return rolling_resistance(place.u, place.omega, lever, eps)


@scalar
def resistance(u, omega, r, normal, lever, eps, solved):
    """Return what rolling resistance takes from ``domega/dt``, and the power it takes.

    With the part ``h`` of ``omega`` in the plane, the first is ``lever F_n J^-1 h /
    sqrt(h^2 + eps^2)``.  The normal force ``F_n`` is the one with resistance,
    ``normal`` the one without.
    """
    h = horizontal(u, omega)
    square = dot(h, h)
    j = jx, jy, jz = solve_again(r, h, solved)
    # lever F_n over the smoothed |h|, by one division.
    share = lever * normal / (sqrt(square + eps * eps) + lever * triple(u, r, j))
    # There is no resistance where the plane would have to pull.
    share = 0.5 * (share + abs(share))
    return share * jx, share * jy, share * jz, share * square


@scalar
def adjugate(r, inertia):
    """Return the adjugate of ``J`` on the left side of Eq. 11, and its determinant.

    Its components are ``xx, yy, zz, yz, zx, xy``.  Nothing cancels in them, but in the
    product with a torque rounding errors grow as ``r^2 / I``.
    """
    x, y, z = r
    ix, iy, iz = inertia
    xx, yy, zz = x * x, y * y, z * z
    r2 = xx + (yy + zz)
    dx, dy, dz = ix + r2, iy + r2, iz + r2
    cx = (xx + iy) * ((xx + iz) + yy) + zz * (xx + iz)
    cy = (yy + iz) * ((yy + ix) + zz) + xx * (yy + ix)
    cz = (zz + ix) * ((zz + iy) + xx) + yy * (zz + iy)
    det = ix * cx + ((iy * yy) * dz + (iz * zz) * dy)
    return (cx, cy, cz, y * z * dx, z * x * dy, x * y * dz), det


@scalar
def multiplied(matrix, h):
    """Return the product of a matrix, as :func:`adjugate` returns it, and a vector."""
    xx, yy, zz, yz, zx, xy = matrix
    a, b, c = h
    return (
        xx * a + xy * b + zx * c,
        xy * a + yy * b + yz * c,
        zx * a + yz * b + zz * c,
    )


@scalar
def without_grip(contact, y, inertia, shape, sigma):
    """Return the motion without forces in proportion to the normal force ``F_n``.

    The vertical is ``u = -e / root`` with ``e = (p, q, 1)`` and its length ``root``,
    and ``F_n = 1 - (e . (omega x w) - g . domega/dt) / root`` with ``g = r x e``.
    ``domega/dt`` has the factor ``scale = root det J``, so that it needs no division.

    Values: rates of the slope, power of ``-sigma omega``, ``root``, ``det J`` and its
    adjugate, ``g``, ``e . (omega x w)``, ``scale domega/dt``.
    """
    p, q, a, b, c = y[:5]
    root = sqrt(1.0 + p * p + q * q)
    dp, dq, m = slope_rate(y)
    touch = contact(y, (dp, dq, m), shape)
    lx, ly, lz = -sigma * a, -sigma * b, -sigma * c
    _, (tx, ty, tz), g, (kx, ky, kz) = moments(y, inertia, (lx, ly, lz), touch)
    gx, gy, gz = g
    solver, det = adjugate(contact_point(y, touch), inertia)
    rates = multiplied(solver, (root * tx - gx, root * ty - gy, root * tz - gz))
    power = lx * a + ly * b + lz * c
    return (dp, dq), power, root, det, solver, g, p * kx + q * ky + kz, rates


@scalar
def resisted(p, q, dp, dq, root, eps):
    """Return ``root^2 omega_t``, which follows from the slope, its square and length.

    The length is smoothed by ``eps``.
    """
    h = dq, -dp, q * dp - p * dq
    square = dot(h, h)
    smoothing = root * (root * eps)
    return h, square, sqrt(square + smoothing * smoothing)


@scalar
def rolling_rhs(contact, y, inertia, shape, loss):
    """Return what :func:`viscous_rhs` does, with rolling resistance."""
    p, q = y[:2]
    sigma, lever, eps = loss
    (dp, dq), power, root, det, solver, g, sink, rates = without_grip(
        contact, y, inertia, shape, sigma
    )
    sa, sb, sc = rates
    h, square, smoothed = resisted(p, q, dp, dq, root, eps)
    j = ja, jb, jc = multiplied(solver, h)
    scale = root * det
    normal = root * scale + (dot(g, rates) - sink * scale)
    # There is no resistance where the plane would have to pull.
    normal = normal if normal > 0.0 else 0.0
    share = lever * normal / (scale * smoothed + lever * dot(g, j))
    inv = 1.0 / scale
    part = inv * det
    taken = share * (square * (part * (part * part)))
    return (
        dp,
        dq,
        (sa - share * ja) * inv,
        (sb - share * jb) * inv,
        (sc - share * jc) * inv,
        power - taken,
    )
