"""Scalar RK4, one run after another, as one would write it first: the yardstick of speed."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.cache import cached
from rattlesweep.physics import full

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.integrate.batch import Batch

DT = 0.002


@full.scalar
def rk4_step(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, dt):  # type: ignore[no-untyped-def]
    """One step of the classical method for one run."""
    half, sixth = dt / 2, dt / 6
    p1, q1, a1, b1, c1 = full.rhs(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy)
    p2, q2, a2, b2, c2 = full.rhs(
        p + half * p1, q + half * q1, a + half * a1, b + half * b1, c + half * c1,
        ix, iy, iz, cxx, cxy, cyy,
    )  # fmt: skip
    p3, q3, a3, b3, c3 = full.rhs(
        p + half * p2, q + half * q2, a + half * a2, b + half * b2, c + half * c2,
        ix, iy, iz, cxx, cxy, cyy,
    )  # fmt: skip
    p4, q4, a4, b4, c4 = full.rhs(
        p + dt * p3, q + dt * q3, a + dt * a3, b + dt * b3, c + dt * c3,
        ix, iy, iz, cxx, cxy, cyy,
    )  # fmt: skip
    return (
        p + sixth * (p1 + 2 * (p2 + p3) + p4),
        q + sixth * (q1 + 2 * (q2 + q3) + q4),
        a + sixth * (a1 + 2 * (a2 + a3) + a4),
        b + sixth * (b1 + 2 * (b2 + b3) + b4),
        c + sixth * (c1 + 2 * (c2 + c3) + c4),
    )


def _reversals(y0, constants, t_end, dt, t_r):  # type: ignore[no-untyped-def]
    for k in range(len(y0)):
        ix, iy, iz, cxx, cxy, cyy = constants[k]
        p, q, a, b, c = y0[k]
        n = full.spin(p, q, a, b, c)
        t_r[k] = np.nan
        for step in range(int(np.ceil(t_end[k] / dt))):
            p, q, a, b, c = rk4_step(p, q, a, b, c, ix, iy, iz, cxx, cxy, cyy, dt)
            n1 = full.spin(p, q, a, b, c)
            if n * n1 <= 0:
                t_r[k] = (step + n / (n - n1)) * dt
                break
            n = n1


@cache
def _compiled() -> Callable[..., Any]:
    compiled: Callable[..., Any] = cached(
        _reversals, fastmath=full.FASTMATH, error_model="numpy", nogil=True
    )
    return compiled


def scalar_rk4(batch: Batch) -> NDArray[np.float64]:
    """Times of reversal by RK4 at dt 0.002 with the package's own equations.

    The spin's sign is looked at once a step and its zero interpolated linearly; nothing else is
    observed.
    """
    t_r = np.empty(len(batch))
    _compiled()(batch.y0, batch.constants, batch.t_end, DT, t_r)
    return t_r
