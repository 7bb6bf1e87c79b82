"""The same runs with heyoka: Taylor's method, one by one or a vector at once.

The equations in six variables, as in the paper, were slower.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import heyoka as hy
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.kernel.outcome import Batch

    Floats = NDArray[np.float64]
    System = tuple[list[tuple[Any, Any]], Any]

# Without the cache, compilation is timed instead of loading.
hy.llvm_state.set_diskcache_enabled(False)

# Steps between two checks for lanes that have reached their horizon.
LOOK = 200


def equations() -> System:
    """Equations in ``(p, q, a, b, c)`` as in ``physics.full``, and the spin's sign."""
    ix, iy, iz, cxx, cxy, cyy = (hy.par[i] for i in range(6))
    p, q, a, b, c = hy.make_vars("p", "q", "a", "b", "c")
    m = p * b - q * a
    dp = q * c - b - p * m
    dq = a - p * c - q * m
    fx = cxx * p + cxy * q
    fy = cxy * p + cyy * q
    x = p + fx
    y = q + fy
    rise = 0.5 * (x * p + y * q)
    z = 1.0 - rise
    twist = fx * q - fy * p
    wx = fy * c + rise * b + p * m - (cxx * dp + cxy * dq)
    wy = q * m - rise * a - fx * c - (cxy * dp + cyy * dq)
    wz = c * twist - 2.0 * m * rise
    kx = b * wz - c * wy
    ky = c * wx - a * wz
    kz = a * wy - b * wx
    uz = -1.0 * (1.0 + p * p + q * q) ** -0.5
    tx = (iy - iz) * (b * c) + (y * kz - z * ky) + uz * (fy + q * rise)
    ty = (iz - ix) * (c * a) + (z * kx - x * kz) - uz * (fx + p * rise)
    tz = (ix - iy) * (a * b) + (x * ky - y * kx) + uz * twist
    da, db, dc = _solve((x, y, z), (tx, ty, tz), (ix, iy, iz))
    return [(p, dp), (q, dq), (a, da), (b, db), (c, dc)], p * a + q * b + c


def _solve(
    r: tuple[Any, ...], t: tuple[Any, ...], inertia: tuple[Any, ...]
) -> list[Any]:
    """Angular acceleration from the torque: Sherman and Morrison's formula.

    This form, with seven divisions, was faster than those with one, two or four: in
    Taylor series a division costs the same as a product.
    """
    r2 = hy.sum([x * x for x in r])
    d = [i + r2 for i in inertia]
    top = hy.sum([x * s / e for x, s, e in zip(r, t, d, strict=True)])
    s = top / (1.0 - hy.sum([x * x / e for x, e in zip(r, d, strict=True)]))
    return [(y + x * s) / e for x, y, e in zip(r, t, d, strict=True)]


class BatchSolver:
    """``taylor_adaptive_batch``, whose lanes take the next run when one has ended."""

    def __init__(self, tol: float, *, high_accuracy: bool = False) -> None:
        system, spin = equations()
        # With code for Zen 3 (``peers.py --avx2``), vectors have four lanes, 256 bits.
        narrow = os.environ.get("NUMBA_CPU_NAME") == "znver3"
        lanes = 4 if narrow else hy.recommended_simd_size()
        self.taylor: Any = hy.taylor_adaptive_batch(
            system,
            np.full((len(system), lanes), 0.1),
            pars=np.ones((6, lanes)),
            t_events=[hy.t_event_batch(spin)],
            tol=tol,
            high_accuracy=high_accuracy,
            compact_mode=False,
            force_avx512=not narrow,
        )
        self.setting = f"tol {tol:.0e}, order {self.taylor.order}"

    def __call__(self, runs: Batch) -> Floats:
        """Return first zeros of the spin, NaN without one before the horizon."""
        taylor = self.taylor
        lanes = taylor.batch_size
        longest_first = iter(np.argsort(-runs.t_end, kind="stable"))
        run_of: list[int | None] = [None] * lanes
        until = np.zeros(lanes)
        now = np.zeros(lanes)
        t_r = np.full(len(runs), np.nan)

        def refill(lane: int) -> None:
            run = next(longest_first, None)
            run_of[lane] = run
            now[lane] = 0.0
            until[lane] = 0.0
            if run is not None:
                taylor.state[:, lane] = runs.y0[run]
                taylor.pars[:, lane] = runs.constants[run]
                until[lane] = runs.t_end[run]
                taylor.reset_cooldowns(lane)

        for lane in range(lanes):
            refill(lane)
        taylor.set_time(now)
        while any(run is not None for run in run_of):
            # Returns when a lane's spin is zero, or after so many steps.
            taylor.propagate_until(until, max_steps=LOOK)
            now[:] = taylor.time
            any_ended = False
            for lane, (outcome, *_) in enumerate(taylor.propagate_res):
                run = run_of[lane]
                if run is None or outcome in (_SUCCESS, _MANY):
                    continue
                if outcome == hy.taylor_outcome.err_nf_state:
                    raise ArithmeticError("heyoka: a state is not finite")
                if outcome != _HORIZON:
                    t_r[run] = now[lane]
                refill(lane)
                any_ended = True
            if any_ended:
                taylor.set_time(now)
        return t_r


class ScalarSolver:
    """``taylor_adaptive``: one run after another."""

    def __init__(self, tol: float) -> None:
        system, spin = equations()
        self.taylor: Any = hy.taylor_adaptive(
            system,
            [0.1] * len(system),
            pars=[1.0] * 6,
            t_events=[hy.t_event(spin)],
            tol=tol,
            compact_mode=False,
        )
        self.setting = f"tol {tol:.0e}, order {self.taylor.order}"

    def __call__(self, runs: Batch) -> Floats:
        """Return first zeros of the spin, NaN without one before the horizon."""
        taylor = self.taylor
        t_r = np.full(len(runs), np.nan)
        for run in range(len(runs)):
            taylor.time = 0.0
            taylor.reset_cooldowns()
            taylor.state[:] = runs.y0[run]
            taylor.pars[:] = runs.constants[run]
            outcome = taylor.propagate_until(runs.t_end[run])[0]
            if outcome == hy.taylor_outcome.err_nf_state:
                raise ArithmeticError("heyoka: a state is not finite")
            if outcome != _HORIZON:
                t_r[run] = taylor.time
        return t_r


_SUCCESS = hy.taylor_outcome.success
_MANY = hy.taylor_outcome.step_limit
_HORIZON = hy.taylor_outcome.time_limit
