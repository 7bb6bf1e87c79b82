"""The same runs with heyoka: Taylor's method, one by one or a vector at once, events
on.
"""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any

import heyoka as hy
import numpy as np

from rattlesweep.physics import full

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.integrate.batch import Batch

    Floats = NDArray[np.float64]
    System = tuple[list[tuple[Any, Any]], Any]

# Without the cache, compilation is timed instead of loading.
hy.llvm_state.set_diskcache_enabled(False)

# Steps between two checks for lanes that have reached their horizon.
LOOK = 200


def slope_system() -> System:
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
    kx, ky, kz = b * wz - c * wy, c * wx - a * wz, a * wy - b * wx
    uz = -1.0 * (1.0 + p * p + q * q) ** -0.5
    tx = (iy - iz) * (b * c) + (y * kz - z * ky) + uz * (fy + q * rise)
    ty = (iz - ix) * (c * a) + (z * kx - x * kz) - uz * (fx + p * rise)
    tz = (ix - iy) * (a * b) + (x * ky - y * kx) + uz * twist
    da, db, dc = _solve((x, y, z), (tx, ty, tz), (ix, iy, iz))
    return [(p, dp), (q, dq), (a, da), (b, db), (c, dc)], p * a + q * b + c


def vector_system() -> System:
    """Equations in ``(u, omega)`` as in the paper (Eqs. 10 and 11), and the spin."""
    ix, iy, iz, cxx, cxy, cyy = (hy.par[i] for i in range(6))
    ux, uy, uz, a, b, c = hy.make_vars("ux", "uy", "uz", "a", "b", "c")
    bxx, bxy, byy = 1.0 + cxx, cxy, 1.0 + cyy
    up = 1.0 / uz
    p, q = ux * up, uy * up
    x, y = bxx * p + bxy * q, bxy * p + byy * q
    z = 1.0 - 0.5 * (x * p + y * q)
    dux, duy, duz = uy * c - uz * b, uz * a - ux * c, ux * b - uy * a
    dp, dq = (dux - p * duz) * up, (duy - q * duz) * up
    xd, yd, zd = bxx * dp + bxy * dq, bxy * dp + byy * dq, -1.0 * (x * dp + y * dq)
    wx, wy, wz = y * c - z * b - xd, z * a - x * c - yd, x * b - y * a - zd
    kx, ky, kz = b * wz - c * wy + ux, c * wx - a * wz + uy, a * wy - b * wx + uz
    tx = (iy - iz) * (b * c) + y * kz - z * ky
    ty = (iz - ix) * (c * a) + z * kx - x * kz
    tz = (ix - iy) * (a * b) + x * ky - y * kx
    da, db, dc = _solve((x, y, z), (tx, ty, tz), (ix, iy, iz))
    system = [(ux, dux), (uy, duy), (uz, duz), (a, da), (b, db), (c, dc)]
    return system, ux * a + uy * b + uz * c


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


SYSTEMS: dict[str, Callable[[], System]] = {
    "5 variables": slope_system,
    "6 variables": vector_system,
}


def _initial(runs: Batch, system: str) -> Floats:
    """Launch states of the runs; the launch is upright."""
    if system == "5 variables":
        return runs.y0
    u, omega = full.to_vectors(runs.y0.T)
    return np.concatenate([u, omega]).T


class BatchSolver:
    """``taylor_adaptive_batch``: a lane whose run has ended takes the next one, longest
    first.

    Without ``refill``, runs of similar horizons start together, and the next ones start
    when all of them have ended.
    """

    def __init__(
        self,
        system: str,
        tol: float,
        *,
        high_accuracy: bool = False,
        refill: bool = True,
    ) -> None:
        hy.llvm_state.clear_memcache()
        self.refill = refill
        begin = time.perf_counter()
        equations, spin = SYSTEMS[system]()
        # With code for Zen 3 (``peers.py --avx2``), vectors have four lanes, 256 bits.
        narrow = os.environ.get("NUMBA_CPU_NAME") == "znver3"
        lanes = 4 if narrow else hy.recommended_simd_size()
        self.system = system
        self.taylor: Any = hy.taylor_adaptive_batch(
            equations,
            np.full((len(equations), lanes), 0.1),
            pars=np.ones((6, lanes)),
            t_events=[hy.t_event_batch(spin)],
            tol=tol,
            high_accuracy=high_accuracy,
            compact_mode=False,
            force_avx512=not narrow,
        )
        self.compile_seconds = time.perf_counter() - begin
        self.setting = f"tol {tol:.0e}, order {self.taylor.order}"

    def __call__(self, runs: Batch) -> Floats:
        """First zeros of the spin, NaN where there is none before the horizon."""
        taylor, y0 = self.taylor, _initial(runs, self.system)
        state, pars = taylor.state, taylor.pars
        lanes = taylor.batch_size
        queue = iter(np.argsort(-runs.t_end, kind="stable"))
        holds: list[int | None] = [None] * lanes
        until, now = np.zeros(lanes), np.zeros(lanes)
        t_r = np.full(len(runs), np.nan)

        def refill(lane: int) -> None:
            run = next(queue, None)
            holds[lane], now[lane], until[lane] = run, 0.0, 0.0
            if run is not None:
                state[:, lane], pars[:, lane] = y0[run], runs.constants[run]
                until[lane] = runs.t_end[run]
                taylor.reset_cooldowns(lane)

        def refill_all() -> bool:
            for lane in range(lanes):
                refill(lane)
            taylor.set_time(now)
            return any(run is not None for run in holds)

        refill_all()
        while any(run is not None for run in holds) or refill_all():
            # Returns when a lane's spin is zero, or after so many steps.
            taylor.propagate_until(until, max_steps=LOOK)
            now[:] = taylor.time
            ended = False
            for lane, (outcome, *_) in enumerate(taylor.propagate_res):
                run = holds[lane]
                if run is None or outcome in (_SUCCESS, _MANY):
                    continue
                if outcome == hy.taylor_outcome.err_nf_state:
                    raise ArithmeticError("heyoka: a state is not finite")
                if outcome != _HORIZON:
                    t_r[run] = now[lane]
                if self.refill:
                    refill(lane)
                else:
                    holds[lane], now[lane], until[lane] = None, 0.0, 0.0
                ended = True
            if ended:
                taylor.set_time(now)
        return t_r


class ScalarSolver:
    """``taylor_adaptive``: one run after another."""

    def __init__(self, system: str, tol: float) -> None:
        hy.llvm_state.clear_memcache()
        begin = time.perf_counter()
        equations, spin = SYSTEMS[system]()
        self.system = system
        self.taylor: Any = hy.taylor_adaptive(
            equations,
            [0.1] * len(equations),
            pars=[1.0] * 6,
            t_events=[hy.t_event(spin)],
            tol=tol,
            compact_mode=False,
        )
        self.compile_seconds = time.perf_counter() - begin
        self.setting = f"tol {tol:.0e}, order {self.taylor.order}"

    def __call__(self, runs: Batch) -> Floats:
        """First zeros of the spin, NaN where there is none before the horizon."""
        taylor, y0 = self.taylor, _initial(runs, self.system)
        t_r = np.full(len(runs), np.nan)
        for run in range(len(runs)):
            taylor.time = 0.0
            taylor.reset_cooldowns()
            taylor.state[:] = y0[run]
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
