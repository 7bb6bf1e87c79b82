"""The paper's six-variable equations (u and omega), at any precision.

This module does not import `rattlesweep` and shares nothing with its kernels: it has
other variables, solves the 3x3 system by cofactors, and computes in longdoubles or
mpmath numbers. Units M = a = g = 1.
"""

import numpy as np
from mpmath import mp

PARAMETERS = ("alpha", "beta", "gamma", "theta", "phi", "xi")


def real(values, exact=False):
    """Convert doubles to longdoubles, or to mpmath numbers if `exact`."""
    values = np.asarray(values, dtype=float)
    if not exact:
        return values.astype(np.longdouble)
    return np.vectorize(lambda x: mp.mpf(float(x)), otypes=[object])(values)


def trigonometry(angle, exact):
    if not exact:
        return np.cos(angle), np.sin(angle)
    return (np.vectorize(f, otypes=[object])(angle) for f in (mp.cos, mp.sin))


def constants(parameters, exact=False):
    """Return inertia, radii B and curvatures A of bodies from rows of parameters."""
    alpha, beta, gamma, theta, phi, xi = real(np.transpose(parameters), exact)
    c, s = trigonometry(xi, exact)
    # R(xi) diag R(xi)^-1 of the principal radii and of the principal curvatures.
    radii = [
        c * c / theta + s * s / phi,
        c * s * (1 / theta - 1 / phi),
        s * s / theta + c * c / phi,
    ]
    curvatures = [
        c * c * theta + s * s * phi,
        c * s * (theta - phi),
        s * s * theta + c * c * phi,
    ]
    return np.stack([alpha - 1, beta - 1, gamma, *radii, *curvatures])


def cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def add(*vectors):
    return tuple(sum(parts[1:], parts[0]) for parts in zip(*vectors, strict=True))


def contact(u, du, q):
    """Return the contact point and its rate: Eqs. 4 and 8."""
    bxx, bxy, byy, axx, axy, ayy = q[3:]
    up = u[0] / u[2]
    uq = u[1] / u[2]
    x = bxx * up + bxy * uq
    y = bxy * up + byy * uq
    fx = axx * x + axy * y
    fy = axy * x + ayy * y
    dp = (du[0] - up * du[2]) / u[2]
    dq = (du[1] - uq * du[2]) / u[2]
    dx = bxx * dp + bxy * dq
    dy = bxy * dp + byy * dq
    return (x, y, 1 - (x * fx + y * fy) / 2), (dx, dy, -(fx * dx + fy * dy))


def rhs(y, q):
    """Return the derivatives of (u, omega): Eqs. 10 and 11."""
    u = y[:3]
    w = y[3:]
    ix, iy, iz = q[:3]
    du = cross(u, w)
    r, dr = contact(u, du, q)
    x, y_, z = r
    iw = (ix * w[0], iy * w[1], iz * w[2])
    t = add(
        cross(iw, w),
        cross(r, add(cross(dr, w), cross(w, cross(r, w)))),
        cross(r, u),
    )
    # The matrix of dw -> I dw - r x (r x dw), inverted by its cofactors.
    mxx = ix + y_ * y_ + z * z
    myy = iy + x * x + z * z
    mzz = iz + x * x + y_ * y_
    mxy = -x * y_
    mxz = -x * z
    myz = -y_ * z
    cxx = myy * mzz - myz * myz
    cxy = mxz * myz - mxy * mzz
    cxz = mxy * myz - mxz * myy
    cyy = mxx * mzz - mxz * mxz
    cyz = mxy * mxz - mxx * myz
    czz = mxx * myy - mxy * mxy
    det = mxx * cxx + mxy * cxy + mxz * cxz
    return np.stack(
        [
            *du,
            (cxx * t[0] + cxy * t[1] + cxz * t[2]) / det,
            (cxy * t[0] + cyy * t[1] + cyz * t[2]) / det,
            (cxz * t[0] + cyz * t[1] + czz * t[2]) / det,
        ]
    )


def step(y, h, q, columns=8):
    """Return the state after a step of the extrapolated midpoint rule.

    Its order is 2 * columns.
    """
    f0 = rhs(y, q)
    table = []
    for j in range(1, columns + 1):
        sub = h / (2 * j)
        before = 0 * y
        now = sub * f0
        for _ in range(2 * j - 1):
            before, now = now, before + 2 * sub * rhs(y + now, q)
        # Aitken-Neville extrapolation in the square of the substep.
        row = [now]
        for i, old in enumerate(table, start=1):
            ratio = (row[0] * 0 + 1)[:1] * (j * j) / ((j - i) * (j - i)) - 1
            row.append(row[-1] + (row[-1] - old) / ratio)
        table = row
    return y + table[-1]
