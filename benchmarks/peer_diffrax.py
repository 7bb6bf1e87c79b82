"""The same runs with diffrax: Dopri8 under vmap and jit, one batch, events on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from rattlesweep.arrays import take

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.kernel.outcome import Batch

    Floats = NDArray[np.float64]

jax.config.update("jax_enable_x64", True)

# Approximate number of runs in a call.  A batch goes on until its last run has ended,
# but larger batches share the cost that XLA has in each step: 120 and 240 were slower,
# 960 was as fast.
RUNS = 480


def field(t: Any, y: tuple[Any, ...], body: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return derivatives of ``(p, q, a, b, c)``.

    XLA fuses tuples, which are thrice as fast as arrays.
    """
    p, q, a, b, c = y
    ix, iy, iz, cxx, cxy, cyy = body
    m = p * b - q * a
    dp = q * c - b - p * m
    dq = a - p * c - q * m
    fx = cxx * p + cxy * q
    fy = cxy * p + cyy * q
    x = p + fx
    y_ = q + fy
    rise = 0.5 * (x * p + y_ * q)
    z = 1.0 - rise
    twist = fx * q - fy * p
    wx = fy * c + rise * b + p * m - (cxx * dp + cxy * dq)
    wy = q * m - rise * a - fx * c - (cxy * dp + cyy * dq)
    wz = c * twist - 2.0 * m * rise
    kx = b * wz - c * wy
    ky = c * wx - a * wz
    kz = a * wy - b * wx
    uz = -1.0 / jnp.sqrt(1.0 + p * p + q * q)
    tx = (iy - iz) * b * c + (y_ * kz - z * ky) + uz * (fy + q * rise)
    ty = (iz - ix) * c * a + (z * kx - x * kz) - uz * (fx + p * rise)
    tz = (ix - iy) * a * b + (x * ky - y_ * kx) + uz * twist
    r2 = x * x + y_ * y_ + z * z
    ex = 1.0 / (ix + r2)
    ey = 1.0 / (iy + r2)
    ez = 1.0 / (iz + r2)
    s = (x * tx * ex + y_ * ty * ey + z * tz * ez) / (
        1.0 - (x * x * ex + y_ * y_ * ey + z * z * ez)
    )
    return dp, dq, (tx + x * s) * ex, (ty + y_ * s) * ey, (tz + z * s) * ez


def _spin(t: Any, y: tuple[Any, ...], args: Any, **_: Any) -> Any:
    """Sign and zeros of the spin."""
    return y[0] * y[2] + y[1] * y[3] + y[4]


class Solver:
    """Jitted ``diffeqsolve`` over a batch of runs."""

    def __init__(self, rtol: float, atol: float) -> None:
        self.setting = f"rtol {rtol:.0e}, atol {atol:.0e}"
        event = diffrax.Event(
            _spin, optimistix.Newton(1e-10, 1e-10, optimistix.rms_norm)
        )

        def one(y0: Any, body: Any, t_end: Any) -> Any:
            solution = diffrax.diffeqsolve(
                diffrax.ODETerm(field),
                diffrax.Dopri8(),
                t0=0.0,
                t1=t_end,
                dt0=0.05,
                y0=tuple(y0),
                args=tuple(body),
                stepsize_controller=diffrax.PIDController(rtol=rtol, atol=atol),
                event=event,
                saveat=diffrax.SaveAt(t1=True),
                adjoint=diffrax.ForwardMode(),
                max_steps=None,
                throw=False,
            )
            return jnp.where(solution.event_mask, solution.ts[-1], jnp.nan)

        self.solve: Any = jax.jit(jax.vmap(one))

    def __call__(self, runs: Batch) -> Floats:
        """Return first zeros of the spin, NaN without one before the horizon."""
        t_r = np.full(len(runs), np.nan)
        # Runs of similar length are batched together; batches of one size avoid
        # recompilation.
        order = np.argsort(runs.t_end, kind="stable")
        size = -(-len(runs) // max(1, round(len(runs) / RUNS)))
        for first in range(0, len(runs), size):
            index = order[min(first, len(runs) - size) :][:size]
            some = take(runs, index)
            t_r[index] = np.asarray(self.solve(some.y0, some.constants, some.t_end))
        return t_r
