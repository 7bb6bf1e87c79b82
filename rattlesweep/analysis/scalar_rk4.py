"""Scalar RK4, one run after another, as one would write it first: the yardstick of speed."""

from __future__ import annotations

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.integrate.batch import Batch
from rattlesweep.integrate.compile import Kernel, load_kernel
from rattlesweep.physics import full

DT = 0.002


@full.scalar
def _moved(y, h, k):  # type: ignore[no-untyped-def]
    """Return ``y + h k``, component by component."""
    return (y[0] + h * k[0], y[1] + h * k[1], y[2] + h * k[2], y[3] + h * k[3], y[4] + h * k[4])


@full.scalar
def rk4_step(y, body, dt):  # type: ignore[no-untyped-def]
    """Return the state after one step of the classical method; `y` and `body` are tuples."""
    k1 = full.rhs(*(y + body))
    k2 = full.rhs(*(_moved(y, dt / 2, k1) + body))
    k3 = full.rhs(*(_moved(y, dt / 2, k2) + body))
    k4 = full.rhs(*(_moved(y, dt, k3) + body))
    slope = _moved(_moved(k1, 2.0, _moved(k2, 1.0, k3)), 1.0, k4)
    return _moved(y, dt / 6, slope)


def _reversals(y0, constants, t_end, dt, t_r):  # type: ignore[no-untyped-def]
    for k in range(len(y0)):
        p, q, a, b, c = y0[k]
        ix, iy, iz, cxx, cxy, cyy = constants[k]
        y, body = (p, q, a, b, c), (ix, iy, iz, cxx, cxy, cyy)
        n = full.spin(*y)
        t_r[k] = np.nan
        for step in range(int(np.ceil(t_end[k] / dt))):
            y = rk4_step(y, body, dt)
            n1 = full.spin(*y)
            if n * n1 <= 0:
                t_r[k] = (step + n / (n - n1)) * dt
                break
            n = n1


def reversals() -> Kernel:
    """Return the loop over runs, to be compiled."""
    arguments = np.zeros((0, 5)), np.zeros((0, 6)), np.zeros(0), DT, np.zeros(0)
    options = {"fastmath": full.FASTMATH, "error_model": "numpy", "nogil": True}
    return Kernel(_reversals, arguments, options, (__file__,))


def scalar_rk4(batch: Batch) -> Floats:
    """Return times of reversal by RK4 at dt 0.002 with the package's own equations.

    The spin's sign is looked at once a step and its zero interpolated linearly; nothing else is
    observed.
    """
    t_r = np.empty(len(batch))
    state, constants = map(np.ascontiguousarray, (batch.y0, batch.constants))
    load_kernel(reversals)(state, constants, batch.t_end, DT, t_r)
    return t_r
