"""What a real stone adds to :mod:`rattlesweep.physics.full`: an ellipsoid below, and friction.

The ellipsoid has the vertical semi-axis ``c`` and at its bottom the curvatures ``theta, phi``; its
centre lies ``c`` above the lowest point.  With ``B = 1 + C`` and ``s = (p, q).B(p, q)`` it touches

    r = (e B(p, q), 1 - c (1 - e)),    e = 1 / sqrt(1 + s / c),

which for ``1/c = 0`` is the paraboloid's.  The bodies' constant is ``k = 1/c``.

Friction are two couples: ``-sigma omega`` (Kane and Levinson 1982, Eqs. 47-49), and the rolling
resistance ``-lever F_n omega_t / sqrt(omega_t^2 + eps^2)`` with the part ``omega_t`` in the plane
and the normal force ``F_n``.  Their work is a sixth variable; energy minus work is conserved.

A ``surface`` is :func:`flat`, :func:`ellipsoid` or :func:`carried_ellipsoid`.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.physics import full
from rattlesweep.physics.full import force, paraboloid, scalar, slope_rate, turning

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rattlesweep.arrays import Floats

N_CONSTANTS = 7
N_FRICTION_STATE = 6
N_FRICTION_CONSTANTS = 10

SMOOTHING = 1e-4  # angular velocity below which rolling resistance becomes viscous


def inverse_semi_axis(c: ArrayLike | None) -> Floats:
    """``1/c``; 0 for a paraboloid, whose ``c`` is None or NaN."""
    values = np.asarray(np.nan if c is None else c, float)
    return np.where(np.isnan(values), 0.0, 1.0 / values)


@scalar
def touching(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy, k, e, rise):
    """How an ellipsoid of known ``e`` and ``rise = (1 - e) / k`` touches the plane."""
    gx, gy = cxx * p + cxy * q, cxy * p + cyy * q
    x0, y0 = p + gx, q + gy
    less = k * rise
    fx, fy = e * gx - less * p, e * gy - less * q
    # Of 1 / e, its rate times e.
    fall = k * (e * e) * (x0 * dp + y0 * dq)
    lift = rise - less
    wx = e * (gy * c + p * m - cxx * dp - cxy * dq + fall * x0) + lift * b
    wy = e * (q * m - gx * c - cxy * dp - cyy * dq + fall * y0) - lift * a
    wz = c * (fx * q - fy * p) - (x0 * p + y0 * q) * e * (m + fall)
    return fx, fy, rise, wx, wy, wz, -1.0 / sqrt(1.0 + p * p + q * q)


@scalar
def shape_at(p, q, cxx, cxy, cyy, k):
    """``e`` and ``rise`` of an ellipsoid."""
    s = (p + (cxx * p + cxy * q)) * p + (q + (cxy * p + cyy * q)) * q
    rho = sqrt(1.0 + k * s)
    # Two divisions and not one, as what waits for them waits less.
    return 1.0 / rho, s / (rho + rho * rho)


@scalar
def ellipsoid(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy, k):
    """How the ellipsoid touches the plane; as :func:`rattlesweep.physics.full.paraboloid`."""
    e, rise = shape_at(p, q, cxx, cxy, cyy, k)
    return touching(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy, k, e, rise)


@scalar
def frictionless_rhs(surface, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):
    """Time derivative of the state without friction."""
    dp, dq, m = slope_rate(p, q, a, b, c)
    fx, fy, rise, wx, wy, wz, uz = surface(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy, k)
    rates, _ = turning(p, q, a, b, c, ix, iy, iz, 0.0, 0.0, 0.0, fx, fy, rise, wx, wy, wz, uz)
    return (dp, dq) + rates  # noqa: RUF005


@scalar
def rhs(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):
    """Time derivative of an ellipsoid's state without friction."""
    return frictionless_rhs(ellipsoid, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k)


@scalar
def corrected(p, q, cxx, cxy, cyy, k, rise):
    """Return ``e`` and ``rise`` by a step of Newton's method from a ``rise`` nearby."""
    s = (p + (cxx * p + cxy * q)) * p + (q + (cxy * p + cyy * q)) * q
    e = 1.0 - k * rise
    step = (0.5 * e) * (s * (e * e) - (rise + rise * e))
    return e - k * step, rise + step


@scalar
def rise_rate(p, q, dp, dq, cxx, cxy, cyy, k, rise):
    """Derivative of the ``rise``."""
    e, _ = corrected(p, q, cxx, cxy, cyy, k, rise)
    return e * (e * e) * ((p + (cxx * p + cxy * q)) * dp + (q + (cxy * p + cyy * q)) * dq)


@scalar
def carried_ellipsoid(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy, k):
    """:func:`ellipsoid` without its root: ``k`` is ``1/c`` and the ``rise`` that a step carries."""
    inverse, near = k
    e, rise = corrected(p, q, cxx, cxy, cyy, inverse, near)
    return touching(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy, inverse, e, rise)


@scalar
def energy(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):
    """Energy of an ellipsoid; as :func:`rattlesweep.physics.full.energy`."""
    gx, gy = cxx * p + cxy * q, cxy * p + cyy * q
    tilt = p * p + q * q
    s = tilt + gx * p + gy * q
    rho = sqrt(1.0 + k * s)
    half = s / (1.0 + rho)
    x, y, z = (p + gx) / rho, (q + gy) / rho, 1.0 - half / rho
    vx, vy, vz = y * c - z * b, z * a - x * c, x * b - y * a
    root = sqrt(1.0 + tilt)
    lift = tilt / (1.0 + root)
    potential = 0.5 * (gx * p + gy * q + lift * lift - k * half * half) / root
    return 0.5 * (ix * a * a + iy * b * b + iz * c * c + vx * vx + vy * vy + vz * vz) + potential


@scalar
def contact_of(ux, uy, uz, a, b, c, da, db, dc, x, y, z, wx, wy, wz):
    """Contact force at ``r = (x, y, z)``; ``dr/dt = v - w`` with ``v = r x omega``."""
    vx, vy, vz = y * c - z * b, z * a - x * c, x * b - y * a
    dx, dy, dz = vx - wx, vy - wy, vz - wz
    return force(ux, uy, uz, a, b, c, da, db, dc, x, y, z, dx, dy, dz, vx, vy, vz)


@scalar
def force_on(surface, p, q, a, b, c, dp, dq, da, db, dc, cxx, cxy, cyy, k):
    """Contact force in a state of known derivative; as `full.contact_force`."""
    m = p * b - q * a
    fx, fy, rise, wx, wy, wz, uz = surface(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy, k)
    x, y, z = p + fx, q + fy, 1.0 - rise
    return contact_of(p * uz, q * uz, uz, a, b, c, da, db, dc, x, y, z, wx, wy, wz)


@scalar
def contact_force(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):
    """Contact force of an ellipsoid without friction."""
    dp, dq, da, db, dc = rhs(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k)
    return force_on(ellipsoid, p, q, a, b, c, dp, dq, da, db, dc, cxx, cxy, cyy, k)


@scalar
def flat(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy, k):
    """The paraboloid as a surface of these templates."""
    return paraboloid(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy)


@scalar
def flat_energy(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):
    """Energy of the paraboloid."""
    return full.energy(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy)


@scalar
def viscous_rhs(surface, p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
    """Return the time derivative of the state and the work under ``-sigma omega`` alone."""
    dp, dq, m = slope_rate(p, q, a, b, c)
    fx, fy, rise, wx, wy, wz, uz = surface(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy, k)
    lx, ly, lz = -sigma * a, -sigma * b, -sigma * c
    rates, _ = turning(p, q, a, b, c, ix, iy, iz, lx, ly, lz, fx, fy, rise, wx, wy, wz, uz)
    return (dp, dq) + rates + (lx * a + ly * b + lz * c,)  # noqa: RUF005


@scalar
def resistance(ux, uy, uz, a, b, c, x, y, z, normal, lever, eps, dyz, dzx, dxy, along, ivol):
    """Return the change of ``domega/dt`` by rolling resistance, and its power.

    With the matrix ``J`` of Eq. diff-omega and the direction ``h``: ``-lever F_n J^-1 h``.
    """
    n = ux * a + uy * b + uz * c
    hx, hy, hz = a - n * ux, b - n * uy, c - n * uz
    square = hx * hx + hy * hy + hz * hz
    s = (x * dyz * hx + y * dzx * hy + z * dxy * hz) * along
    jx, jy, jz = (hx + x * s) * dyz * ivol, (hy + y * s) * dzx * ivol, (hz + z * s) * dxy * ivol
    change = ux * (y * jz - z * jy) + uy * (z * jx - x * jz) + uz * (x * jy - y * jx)
    # All of it over the smoothed |h|: one division.
    share = lever * normal / (sqrt(square + eps * eps) + lever * change)
    # A plane that would have to pull does not resist.
    share = 0.5 * (share + abs(share))
    return share * jx, share * jy, share * jz, share * square


@scalar
def rolling_rhs(surface, p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):
    """Return the time derivative of the state and the work under both couples."""
    dp, dq, m = slope_rate(p, q, a, b, c)
    fx, fy, rise, wx, wy, wz, uz = surface(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy, k)
    lx, ly, lz = -sigma * a, -sigma * b, -sigma * c
    rates, solved = turning(p, q, a, b, c, ix, iy, iz, lx, ly, lz, fx, fy, rise, wx, wy, wz, uz)
    da, db, dc = rates
    ux, uy = p * uz, q * uz
    x, y, z = p + fx, q + fy, 1.0 - rise
    normal, _ = contact_of(ux, uy, uz, a, b, c, da, db, dc, x, y, z, wx, wy, wz)
    ra, rb, rc, loss = resistance(ux, uy, uz, a, b, c, x, y, z, normal, lever, eps, *solved)
    return dp, dq, da - ra, db - rb, dc - rc, lx * a + ly * b + lz * c - loss
