"""Rate at which the flow changes phase volume, relative to it.

The volume is that of the sphere of directions ``u``, which only turn, times that of ``omega``: the
rate is the trace over ``omega`` of the derivative of ``domega/dt = J^-1 T`` (Eq. diff-omega).  With
the contact point ``r`` and ``w = W omega`` the torque's derivative is

    dT/domega = G + (r.w) 1 - w r^T + omega (W^T r)^T - (r.omega) W

with the gyroscopic and viscous part ``G``.

States and constants are those of :mod:`rattlesweep.physics.vectors`.  ``solved`` are the last
values of :func:`rattlesweep.physics.full.turning`, ``dyz, dzx, dxy, along, ivol``: ``J^-1`` is
``ivol (diag(dyz, dzx, dxy) + along s s^T)`` with ``s = (x dyz, y dzx, z dxy)``.
"""

from __future__ import annotations

from math import sqrt

from rattlesweep.physics import vectors
from rattlesweep.physics.full import scalar
from rattlesweep.physics.stone import contact_of


@scalar
def _dot(one, other):  # type: ignore[no-untyped-def]
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@scalar
def _across(u, v):  # type: ignore[no-untyped-def]
    """Return the part of ``v`` in the plane."""
    n = _dot(u, v)
    return v[0] - n * u[0], v[1] - n * u[1], v[2] - n * u[2]


@scalar
def _lift(u, r, j):  # type: ignore[no-untyped-def]
    """Return ``u.(r x j)``."""
    (x, y, z), (a, b, c) = r, j
    return u[0] * (y * c - z * b) + u[1] * (z * a - x * c) + u[2] * (x * b - y * a)


@scalar
def _inverse(r, h, solved):  # type: ignore[no-untyped-def]
    """Return ``J^-1 h``."""
    (x, y, z), (hx, hy, hz), (dyz, dzx, dxy, along, ivol) = r, h, solved
    s = (x * dyz * hx + y * dzx * hy + z * dxy * hz) * along
    return (hx + x * s) * dyz * ivol, (hy + y * s) * dzx * ivol, (hz + z * s) * dxy * ivol


@scalar
def _normal(u, r, rho, a, b, c, surface, inertia, sigma):  # type: ignore[no-untyped-def]
    """Return the normal force without rolling resistance, ``w`` and ``solved``."""
    w = vectors.moving(*u, a, b, c, *r, rho, *surface)
    rates, solved = vectors.free_rates(*u, a, b, c, *r, *w, *inertia, sigma)
    normal, _ = contact_of(*u, a, b, c, *rates, *r, *w)
    return normal, w, solved


@scalar
def smooth_volume(vx, vy, vz, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma):  # type: ignore[no-untyped-def]
    """Return the rate without rolling resistance, in ``sqrt(g/a)``."""
    u = vectors.unit(vx, vy, vz)
    x, y, z, rho = vectors.contact(*u, cxx, cxy, cyy, k)
    r, omega, surface = (x, y, z), (a, b, c), (cxx, cxy, cyy, k)
    _, w, (dyz, dzx, dxy, along, ivol) = _normal(
        u, r, rho, a, b, c, surface, (ix, iy, iz), sigma
    )  # fmt: skip
    s = sx, sy, sz = x * dyz, y * dzx, z * dxy
    # W of s and of the diagonal part of J^-1 omega, and the diagonal of W.
    ws = vectors.moving(*u, *s, *r, rho, *surface)
    wd = vectors.moving(*u, dyz * a, dzx * b, dxy * c, *r, rho, *surface)
    wxx, _, _ = vectors.moving(*u, 1.0, 0.0, 0.0, *r, rho, *surface)
    _, wyy, _ = vectors.moving(*u, 0.0, 1.0, 0.0, *r, rho, *surface)
    _, _, wzz = vectors.moving(*u, 0.0, 0.0, 1.0, *r, rho, *surface)
    part = _dot(r, w) - sigma
    rolled = _dot(r, omega)
    diagonal = part * (dyz + dzx + dxy) - _dot(w, s) + _dot(r, wd)
    diagonal = diagonal - rolled * (dyz * wxx + dzx * wyy + dxy * wzz)
    rank_one = (
        (iy - iz) * sx * (sy * c + sz * b)
        + (iz - ix) * sy * (sz * a + sx * c)
        + (ix - iy) * sz * (sx * b + sy * a)
        + part * _dot(s, s)
        - _dot(w, s) * _dot(r, s)
        + _dot(s, omega) * _dot(r, ws)
        - rolled * _dot(s, ws)
    )
    return ivol * (diagonal + along * rank_one)


@scalar
def volume(vx, vy, vz, a, b, c, work, ix, iy, iz, cxx, cxy, cyy, k, sigma, lever, eps):  # type: ignore[no-untyped-def]
    """Return the rate, in ``sqrt(g/a)``; of ``domega/dt`` the resistance takes ``share J^-1 h``."""
    u = vectors.unit(vx, vy, vz)
    x, y, z, rho = vectors.contact(*u, cxx, cxy, cyy, k)
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
    trace = ivol * (
        dyz * (1.0 - u[0] * u[0]) + dzx * (1.0 - u[1] * u[1]) + dxy * (1.0 - u[2] * u[2])
        + along * _dot(s, _across(u, s))
    )  # fmt: skip
    lost = share * trace + (0.5 * lever * (ahead - behind) - share * wider) / below
    smooth = smooth_volume(vx, vy, vz, a, b, c, ix, iy, iz, cxx, cxy, cyy, k, sigma)
    return smooth - (lost if share > 0.0 else 0.0)
