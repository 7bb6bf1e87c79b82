"""Rate at which the flow changes phase volume, relative to it.

The volume is that of the sphere of directions ``u`` times that of ``omega``.  At fixed ``omega``
the direction only turns, so the rate is the trace over ``omega`` of the derivative of
``domega/dt = J^-1 T`` (Eq. diff-omega).  With the contact point ``r`` and ``w = W omega`` linear in
``omega``, the torque's derivative is

    dT/domega = G + (r.w) 1 - w r^T + omega (W^T r)^T - (r.omega) W

with the gyroscopic and viscous part ``G``.  Near a steady spin of small skew the rate is
``n (K_p - K_r)``.

``solved`` are the last values of :func:`rattlesweep.physics.full.turning`, ``dyz, dzx, dxy, along,
ivol``: ``J^-1`` is ``ivol (diag(dyz, dzx, dxy) + along s s^T)`` with ``s = (x dyz, y dzx, z dxy)``.
"""

from __future__ import annotations

from math import sqrt

from rattlesweep.physics import vectors
from rattlesweep.physics.full import scalar, slope_rate, turning
from rattlesweep.physics.stone import contact_of, ellipsoid, flat


@scalar
def _dot(one, other):  # type: ignore[no-untyped-def]
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@scalar
def _applied(columns, v):  # type: ignore[no-untyped-def]
    """Return ``W v`` of the columns of ``W``."""
    (xx, yx, zx), (xy, yy, zy), (xz, yz, zz) = columns
    a, b, c = v
    return xx * a + xy * b + xz * c, yx * a + yy * b + yz * c, zx * a + zy * b + zz * c


@scalar
def _smooth(columns, r, omega, inertia, sigma, solved):  # type: ignore[no-untyped-def]
    """Trace without rolling resistance, of the columns of ``W``."""
    (x, y, z), (a, b, c), (ix, iy, iz) = r, omega, inertia
    dyz, dzx, dxy, along, ivol = solved
    s = sx, sy, sz = x * dyz, y * dzx, z * dxy
    w = _applied(columns, omega)
    ws = _applied(columns, s)
    part = _dot(r, w) - sigma
    rom = _dot(r, omega)
    diagonal = (
        part * (dyz + dzx + dxy)
        - _dot(w, s)
        + _dot(r, _applied(columns, (dyz * a, dzx * b, dxy * c)))
        - rom * (dyz * columns[0][0] + dzx * columns[1][1] + dxy * columns[2][2])
    )
    gyroscopic = (
        (iy - iz) * sx * (sy * c + sz * b)
        + (iz - ix) * sy * (sz * a + sx * c)
        + (ix - iy) * sz * (sx * b + sy * a)
    )
    rank_one = (
        gyroscopic
        + part * _dot(s, s)
        - _dot(w, s) * _dot(r, s)
        + _dot(s, omega) * _dot(r, ws)
        - rom * _dot(s, ws)
    )
    return ivol * (diagonal + along * rank_one)


@scalar
def _across(u, v):  # type: ignore[no-untyped-def]
    """Return the part of ``v`` in the plane."""
    n = _dot(u, v)
    return v[0] - n * u[0], v[1] - n * u[1], v[2] - n * u[2]


@scalar
def _inverse(r, h, solved):  # type: ignore[no-untyped-def]
    """Return ``J^-1 h``."""
    (x, y, z), (hx, hy, hz), (dyz, dzx, dxy, along, ivol) = r, h, solved
    s = (x * dyz * hx + y * dzx * hy + z * dxy * hz) * along
    return (hx + x * s) * dyz * ivol, (hy + y * s) * dzx * ivol, (hz + z * s) * dxy * ivol


@scalar
def _lift(u, r, j):  # type: ignore[no-untyped-def]
    """Return ``u.(r x j)``."""
    return (
        u[0] * (r[1] * j[2] - r[2] * j[1])
        + u[1] * (r[2] * j[0] - r[0] * j[2])
        + u[2] * (r[0] * j[1] - r[1] * j[0])
    )


@scalar
def _rolling(normal, rise, j, h, u, r, solved, lever, eps):  # type: ignore[no-untyped-def]
    """What rolling resistance adds to the trace.

    Of ``domega/dt`` it takes ``share j`` with ``j = J^-1 h``, see
    :func:`rattlesweep.physics.stone.resistance`.  ``normal`` is the normal force without it and
    ``rise`` its derivative along ``j``.
    """
    dyz, dzx, dxy, along, ivol = solved
    root = sqrt(_dot(h, h) + eps * eps)
    below = root + lever * _lift(u, r, j)
    share = lever * normal / below
    g = _across(u, j)
    wider = _dot(h, g) / root + lever * _lift(u, r, _inverse(r, g, solved))
    s = r[0] * dyz, r[1] * dzx, r[2] * dxy
    t = _across(u, s)
    trace = ivol * (
        dyz * (1.0 - u[0] * u[0]) + dzx * (1.0 - u[1] * u[1]) + dxy * (1.0 - u[2] * u[2])
        + along * _dot(s, t)
    )  # fmt: skip
    lost = share * trace + (lever * rise - share * wider) / below
    return -lost if share > 0.0 else 0.0


# -- slopes ----------------------------------------------------------------------------------------


@scalar
def _moving(surface, p, q, a, b, c, cxx, cxy, cyy, k):  # type: ignore[no-untyped-def]
    dp, dq, m = slope_rate(p, q, a, b, c)
    fx, fy, rise, wx, wy, wz, uz = surface(p, q, a, b, c, dp, dq, m, cxx, cxy, cyy, k)
    return (fx, fy, rise), (wx, wy, wz), uz


@scalar
def _normal(surface, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma):  # type: ignore[no-untyped-def]
    """Return the normal force without rolling resistance, and what else turning finds."""
    f, w, uz = _moving(surface, p, q, a, b, c, cxx, cxy, cyy, k)
    rates, solved = turning(
        p, q, a, b, c, ix, iy, iz, -sigma * a, -sigma * b, -sigma * c, *f, *w, uz
    )  # fmt: skip
    r = p + f[0], q + f[1], 1.0 - f[2]
    u = p * uz, q * uz, uz
    normal, _ = contact_of(*u, a, b, c, *rates, *r, *w)
    return normal, u, r, solved


@scalar
def _trace(surface, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma):  # type: ignore[no-untyped-def]
    _, _, r, solved = _normal(surface, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma)
    _, x, _ = _moving(surface, p, q, 1.0, 0.0, 0.0, cxx, cxy, cyy, k)
    _, y, _ = _moving(surface, p, q, 0.0, 1.0, 0.0, cxx, cxy, cyy, k)
    _, z, _ = _moving(surface, p, q, 0.0, 0.0, 1.0, cxx, cxy, cyy, k)
    return _smooth((x, y, z), r, (a, b, c), (ix, iy, iz), sigma, solved)


@scalar
def paraboloid_volume(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy):  # type: ignore[no-untyped-def]
    """Return the rate of a paraboloid, in ``sqrt(g/a)``."""
    return _trace(flat, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, 0.0, 0.0)


@scalar
def ellipsoid_volume(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k):  # type: ignore[no-untyped-def]
    """Return the rate of an ellipsoid."""
    return _trace(ellipsoid, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, 0.0)


@scalar
def viscous_volume(surface, p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
    """Return the rate under viscous friction alone."""
    return _trace(surface, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma)


@scalar
def rolling_volume(surface, p, q, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
    """Return the rate under both couples."""
    # No star before arguments of which one is a function: Numba warns of it.
    normal, u, r, solved = _normal(
        surface, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma
    )  # fmt: skip
    h = _across(u, (a, b, c))
    j = ja, jb, jc = _inverse(r, h, solved)
    # The normal force is of second degree: central differences are exact, whatever the step.
    ahead, _, _, _ = _normal(
        surface, p, q, a + ja, b + jb, c + jc, ix, iy, iz, cxx, cxy, cyy, k, sigma
    )  # fmt: skip
    behind, _, _, _ = _normal(
        surface, p, q, a - ja, b - jb, c - jc, ix, iy, iz, cxx, cxy, cyy, k, sigma
    )  # fmt: skip
    smooth = _trace(surface, p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma)
    return smooth + _rolling(normal, 0.5 * (ahead - behind), j, h, u, r, solved, lever, eps)


# -- vectors ---------------------------------------------------------------------------------------


@scalar
def _vectors_normal(u, r, rho, a, b, c, surface, inertia, sigma):  # type: ignore[no-untyped-def]
    w = vectors.moving(*u, a, b, c, *r, rho, *surface)
    rates, solved = vectors.free_rates(*u, a, b, c, *r, *w, *inertia, sigma)
    normal, _ = contact_of(*u, a, b, c, *rates, *r, *w)
    return normal, solved


@scalar
def vectors_volume(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
    """Return the rate of the states of :mod:`rattlesweep.physics.vectors`."""
    u = vectors.unit(vx, vy, vz)
    x, y, z, rho = vectors.contact(*u, cxx, cxy, cyy, k)
    r, surface, inertia = (x, y, z), (cxx, cxy, cyy, k), (ix, iy, iz)
    normal, solved = _vectors_normal(u, r, rho, a, b, c, surface, inertia, sigma)
    columns = (
        vectors.moving(*u, 1.0, 0.0, 0.0, *r, rho, *surface),
        vectors.moving(*u, 0.0, 1.0, 0.0, *r, rho, *surface),
        vectors.moving(*u, 0.0, 0.0, 1.0, *r, rho, *surface),
    )
    h = _across(u, (a, b, c))
    j = _inverse(r, h, solved)
    ahead, _ = _vectors_normal(u, r, rho, a + j[0], b + j[1], c + j[2], surface, inertia, sigma)
    behind, _ = _vectors_normal(u, r, rho, a - j[0], b - j[1], c - j[2], surface, inertia, sigma)
    return _smooth(columns, r, (a, b, c), inertia, sigma, solved) + _rolling(
        normal, 0.5 * (ahead - behind), j, h, u, r, solved, lever, eps
    )
