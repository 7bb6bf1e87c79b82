"""Tangent dynamics: a small difference between two runs of `physics.full`.

The norm of a tangent is an energy (:func:`square`).  In two directions a difference
neither grows nor decays exponentially: along the flow, where it is a delay, and across
the surface of constant energy.  So only the transverse part is measured: it lies in
that surface, normal to the flow.
"""

# mypy: disable-error-code="no-untyped-def"
from math import sqrt

from rattlesweep.physics.full import (
    TINY,
    contact_point,
    oscillation,
    paraboloid,
    scalar,
    solve_rates,
)


@scalar
def rate(y, dy, tangent, constants):
    """Return the derivative of a tangent ``(p1, q1, a1, b1, c1)`` under ``full.rhs``.

    Names that end in 1 are derivatives along the tangent.  Differentiating ``J domega =
    T`` with ``J = D - r r^T`` gives ``J domega1 = T1 - J1 domega``.  The product of the
    right side with ``r`` is taken from the identity ``r . (I domega - g) = 0``, in
    which nothing cancels.
    """
    p, q, a, b, c = y
    dp, dq, da, db, dc = dy
    p1, q1, a1, b1, c1 = tangent
    ix, iy, iz, cxx, cxy, cyy = constants
    m = p * b - q * a
    m1 = p1 * b + p * b1 - q1 * a - q * a1
    dp1 = q1 * c + q * c1 - b1 - p1 * m - p * m1
    dq1 = a1 - p1 * c - p * c1 - q1 * m - q * m1
    touch = paraboloid(y, (dp, dq, m), (cxx, cxy, cyy))
    (fx, fy, rise), (wx, wy, wz), uz = touch
    fx1 = cxx * p1 + cxy * q1
    fy1 = cxy * p1 + cyy * q1
    x, y_, z = r = contact_point(y, touch)
    x1 = p1 + fx1
    y1 = q1 + fy1
    rise1 = x * p1 + y_ * q1
    twist = fx * q - fy * p
    twist1 = fx1 * q + fx * q1 - fy1 * p - fy * p1
    wx1 = (
        fy1 * c
        + fy * c1
        + rise1 * b
        + rise * b1
        + p1 * m
        + p * m1
        - (cxx * dp1 + cxy * dq1)
    )
    wy1 = (
        q1 * m
        + q * m1
        - rise1 * a
        - rise * a1
        - fx1 * c
        - fx * c1
        - (cxy * dp1 + cyy * dq1)
    )
    wz1 = c1 * twist + c * twist1 - 2.0 * (m1 * rise + m * rise1)
    kx, ky, kz = b * wz - c * wy, c * wx - a * wz, a * wy - b * wx
    kx1 = b1 * wz + b * wz1 - c1 * wy - c * wy1
    ky1 = c1 * wx + c * wx1 - a1 * wz - a * wz1
    kz1 = a1 * wy + a * wy1 - b1 * wx - b * wx1
    uz1 = -uz * uz * uz * (p * p1 + q * q1)
    gx, gy, gz = (iy - iz) * b * c, (iz - ix) * c * a, (ix - iy) * a * b
    gx1 = (iy - iz) * (b1 * c + b * c1)
    gy1 = (iz - ix) * (c1 * a + c * a1)
    gz1 = (ix - iy) * (a1 * b + a * b1)
    px = fy + q * rise
    py = fx + p * rise
    px1 = fy1 + q1 * rise + q * rise1
    py1 = fx1 + p1 * rise + p * rise1
    tx = gx1 + (y1 * kz + y_ * kz1 + rise1 * ky - z * ky1) + (uz1 * px + uz * px1)
    ty = gy1 + (z * kx1 - rise1 * kx - x1 * kz - x * kz1) - (uz1 * py + uz * py1)
    tz = gz1 + (x1 * ky + x * ky1 - y1 * kx - y_ * kx1) + (uz1 * twist + uz * twist1)
    # z1 is -rise1.
    along = x * da + y_ * db + z * dc
    along1 = x1 * da + y1 * db - rise1 * dc
    longer = 2.0 * (x * x1 + y_ * y1 - z * rise1)
    tx += x1 * along + x * along1 - longer * da
    ty += y1 * along + y_ * along1 - longer * db
    tz += z * along1 - rise1 * along - longer * dc
    product = (
        x * gx1
        + y_ * gy1
        + z * gz1
        + x1 * (gx - ix * da)
        + y1 * (gy - iy * db)
        - rise1 * (gz - iz * dc)
    )
    rates, _ = solve_rates(r, (ix, iy, iz), (tx, ty, tz), product)
    return (dp1, dq1) + rates  # noqa: RUF005


@scalar
def gradient(y, constants):
    """Return the gradient of :func:`rattlesweep.physics.full.energy` over the state."""
    p, q, a, b, c = y
    ix, iy, iz, cxx, cxy, cyy = constants
    fx = cxx * p + cxy * q
    fy = cxy * p + cyy * q
    x = p + fx
    y_ = q + fy
    z = 1.0 - 0.5 * (x * p + y_ * q)
    vx, vy, vz = y_ * c - z * b, z * a - x * c, x * b - y_ * a
    # Derivative of the kinetic energy by the contact point, and below that of the
    # height (1 + (x p + y_ q)/2) / sqrt(1 + p^2 + q^2) by the slope.
    rx, ry, rz = b * vz - c * vy, c * vx - a * vz, a * vy - b * vx
    tilt = p * p + q * q
    square = 1.0 + tilt
    root = sqrt(square)
    flat = 0.5 * (tilt - fx * p - fy * q) / square
    return (
        rx * (1.0 + cxx) + ry * cxy - rz * x + (fx + p * flat) / root,
        rx * cxy + ry * (1.0 + cyy) - rz * y_ + (fy + q * flat) / root,
        ix * a + z * vy - y_ * vz,
        iy * b + x * vz - z * vx,
        iz * c + y_ * vx - x * vy,
    )


@scalar
def square(tangent, constants):
    """Return the squared norm, in ``M g a``: twice the energy with ``B = 1 + C``."""
    p1, q1, _, _, c1 = tangent
    slope = p1 * p1 + q1 * q1
    return oscillation(tangent, constants) + slope + constants[2] * c1 * c1


@scalar
def transverse(y, dy, tangent, constants):
    """Return the part of a tangent at constant energy and normal to the flow."""
    ix, iy, iz, cxx, cxy, cyy = constants
    dp, dq, da, db, dc = dy
    p1, q1, a1, b1, c1 = tangent
    ep, eq, ea, eb, ec = gradient(y, constants)
    # The inverse of the norm's matrix applied to the gradient.
    bxx = 1.0 + cxx
    byy = 1.0 + cyy
    det = bxx * byy - cxy * cxy
    hp = (byy * ep - cxy * eq) / det
    hq = (bxx * eq - cxy * ep) / det
    ha, hb, hc = ea / (ix + 1.0), eb / (iy + 1.0), ec / iz
    steep = ep * hp + eq * hq + ea * ha + eb * hb + ec * hc + TINY
    off = (ep * p1 + eq * q1 + ea * a1 + eb * b1 + ec * c1) / steep
    p1 = p1 - off * hp
    q1 = q1 - off * hq
    a1, b1, c1 = a1 - off * ha, b1 - off * hb, c1 - off * hc
    # At rest there is no flow, and nothing is removed.
    speed = square(dy, constants) + TINY
    late = (
        dp * (bxx * p1 + cxy * q1)
        + dq * (cxy * p1 + byy * q1)
        + (ix + 1.0) * da * a1
        + (iy + 1.0) * db * b1
        + iz * dc * c1
    ) / speed
    return (
        p1 - late * dp,
        q1 - late * dq,
        a1 - late * da,
        b1 - late * db,
        c1 - late * dc,
    )


@scalar
def seed(y, constants):
    """Return a tangent that favours no mode: slopes and rates of equal energies."""
    ix, iy, _, cxx, _, cyy = constants
    p = 1.0 / sqrt(1.0 + cxx)
    q = 1.0 / sqrt(1.0 + cyy)
    return p, q, 1.0 / sqrt(ix + 1.0), 1.0 / sqrt(iy + 1.0), 0.0
