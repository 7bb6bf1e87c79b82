"""The same runs as a user would first write them: scalar Numba RK4, SciPy's DOP853."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit, prange
from scipy.integrate import solve_ivp

from rattlesweep.physics import full

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.kernel.outcome import Batch

    Floats = NDArray[np.float64]


@njit(fastmath=True, error_model="numpy", inline="always")
def derivatives(ux, uy, uz, a, b, c, ix, iy, iz, cxx, cxy, cyy):  # type: ignore[no-untyped-def]
    """Return the derivatives of ``(u, omega)`` (Eqs. 10 and 11), written by hand."""
    up = 1.0 / uz
    p = ux * up
    q = uy * up
    x = p + cxx * p + cxy * q
    y = q + cxy * p + cyy * q
    z = 1.0 - 0.5 * (x * p + y * q)
    dux = uy * c - uz * b
    duy = uz * a - ux * c
    duz = ux * b - uy * a
    dp = (dux - p * duz) * up
    dq = (duy - q * duz) * up
    wx = y * c - z * b - (dp + cxx * dp + cxy * dq)
    wy = z * a - x * c - (dq + cxy * dp + cyy * dq)
    wz = x * b - y * a + (x * dp + y * dq)
    kx = b * wz - c * wy + ux
    ky = c * wx - a * wz + uy
    kz = a * wy - b * wx + uz
    tx = (iy - iz) * b * c + y * kz - z * ky
    ty = (iz - ix) * c * a + z * kx - x * kz
    tz = (ix - iy) * a * b + x * ky - y * kx
    r2 = x * x + y * y + z * z
    ex = 1.0 / (ix + r2)
    ey = 1.0 / (iy + r2)
    ez = 1.0 / (iz + r2)
    s = (x * tx * ex + y * ty * ey + z * tz * ez) / (
        1.0 - (x * x * ex + y * y * ey + z * z * ez)
    )
    return dux, duy, duz, (tx + x * s) * ex, (ty + y * s) * ey, (tz + z * s) * ez


@njit(fastmath=True, error_model="numpy", parallel=True)
def rk4_runs(y0, constants, t_end, dt, t_r):  # type: ignore[no-untyped-def]
    """Integrate by classical RK4, to a zero interpolated between two steps."""
    for k in prange(len(y0)):
        ix, iy, iz, cxx, cxy, cyy = constants[k]
        u, v, w, a, b, c = y0[k]
        n = u * a + v * b + w * c
        half = 0.5 * dt
        for step in range(int(np.ceil(t_end[k] / dt))):
            u1, v1, w1, a1, b1, c1 = derivatives(
                u, v, w, a, b, c, ix, iy, iz, cxx, cxy, cyy
            )
            u2, v2, w2, a2, b2, c2 = derivatives(
                u + half * u1,
                v + half * v1,
                w + half * w1,
                a + half * a1,
                b + half * b1,
                c + half * c1,
                ix,
                iy,
                iz,
                cxx,
                cxy,
                cyy,
            )
            u3, v3, w3, a3, b3, c3 = derivatives(
                u + half * u2,
                v + half * v2,
                w + half * w2,
                a + half * a2,
                b + half * b2,
                c + half * c2,
                ix,
                iy,
                iz,
                cxx,
                cxy,
                cyy,
            )
            u4, v4, w4, a4, b4, c4 = derivatives(
                u + dt * u3,
                v + dt * v3,
                w + dt * w3,
                a + dt * a3,
                b + dt * b3,
                c + dt * c3,
                ix,
                iy,
                iz,
                cxx,
                cxy,
                cyy,
            )
            u += dt / 6.0 * (u1 + 2.0 * u2 + 2.0 * u3 + u4)
            v += dt / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
            w += dt / 6.0 * (w1 + 2.0 * w2 + 2.0 * w3 + w4)
            a += dt / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            b += dt / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
            c += dt / 6.0 * (c1 + 2.0 * c2 + 2.0 * c3 + c4)
            n1 = u * a + v * b + w * c
            if n * n1 <= 0.0:
                t_r[k] = (step + n / (n - n1)) * dt
                break
            n = n1


@njit(fastmath=True, error_model="numpy")
def _vector_field(t, y, body):  # type: ignore[no-untyped-def]
    out = np.empty(6)
    ix, iy, iz, cxx, cxy, cyy = body
    out[0], out[1], out[2], out[3], out[4], out[5] = derivatives(
        y[0], y[1], y[2], y[3], y[4], y[5], ix, iy, iz, cxx, cxy, cyy
    )
    return out


@njit
def _dot(t, y, body):  # type: ignore[no-untyped-def]
    return y[0] * y[3] + y[1] * y[4] + y[2] * y[5]


def _event(t: float, y: Floats, body: Floats) -> Any:
    return _dot(t, y, body)


_event.terminal = True  # type: ignore[attr-defined]


def _vectors(runs: Batch) -> Floats:
    u, omega = full.to_vectors(runs.y0.T)
    return np.concatenate([u, omega]).T.copy()


def plain_rk4(dt: float) -> Callable[[Batch], Floats]:
    """Scalar RK4 in ``prange``."""

    def solve(runs: Batch) -> Floats:
        t_r = np.full(len(runs), np.nan)
        rk4_runs(_vectors(runs), runs.constants, runs.t_end, dt, t_r)
        return t_r

    return solve


def scipy_dop853(rtol: float, atol: float) -> Callable[[Batch], Floats]:
    """``solve_ivp`` with a compiled right-hand side and a terminal event."""

    def solve(runs: Batch) -> Floats:
        t_r = np.full(len(runs), np.nan)
        for k, y0 in enumerate(_vectors(runs)):
            solution = solve_ivp(
                _vector_field,
                (0.0, runs.t_end[k]),
                y0,
                method="DOP853",
                events=_event,
                args=(runs.constants[k],),
                rtol=rtol,
                atol=atol,
            )
            zeros = solution.t_events[0]
            if len(zeros):
                t_r[k] = zeros[0]
        return t_r

    return solve
