"""Times of reversal to measure others by: two methods that agree, and a third that confirms."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from rattlesweep.arrays import Flags, Floats
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.analysis.tradeoff.runs import Runs, Solution
from rattlesweep.analysis.tradeoff.settings import Setting

Vector = Any  # three numbers

AGREE = 1e-8
# Of the spins at the horizon, where neither has a reversal.  A tumbling body amplifies rounding:
# whether it reverses one day is then not for double precision to say.
AGREE_N = 1e-6
# The third integrator: as tight as SciPy allows without a warning, or nearly.
RTOL = 1e-12


@dataclass(frozen=True)
class Reference:
    """What the runs come to."""

    solution: Solution  # of the first method
    both: Flags
    """Both methods have a reversal, and agree on its time to :data:`AGREE`."""
    neither: Flags
    """Neither has one, and both give the same type and, to :data:`AGREE_N`, the same last spin."""
    apart: Floats
    """Relative difference of the two times, of each run with a reversal in both."""


def make_reference(runs: Runs, settings: Iterable[Setting], threads: int) -> Reference:
    """Integrate the runs with two methods at a tight tolerance."""
    every = np.arange(len(runs))
    one, other = (runs.solve(setting, every, threads=threads) for setting in settings)
    reversal = np.isfinite(one.t_r) & np.isfinite(other.t_r)
    apart = np.abs(one.t_r / other.t_r - 1)
    none = np.isnan(one.t_r) & np.isnan(other.t_r) & one.ok & other.ok
    none &= np.abs(one.n_end - other.n_end) <= AGREE_N * np.abs(runs.launches.n_i)
    return Reference(
        solution=one,
        both=reversal & (apart < AGREE),
        neither=none & (one.types == other.types),
        apart=apart[reversal],
    )


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: Vector, b: Vector) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _equations(body: dict[str, float]) -> Callable[[float, Floats], list[float]]:
    """The paper's Eqs. diff-u and diff-omega in ``(u, omega)``, for a solver of SciPy.

    Written apart from :mod:`rattlesweep.physics`: six variables instead of five, the matrix of
    Eq. diff-omega inverted as a diagonal less ``r r^T`` (Sherman and Morrison), no cancellation
    taken out by hand.  Plain Python: vectors of three are too short for NumPy.
    """
    inertia = (body["alpha"] - 1, body["beta"] - 1, body["gamma"])
    cos, sin = np.cos(body["xi"]), np.sin(body["xi"])
    turn = np.array([[cos, -sin], [sin, cos]])
    radii = turn @ np.diag([1 / body["theta"], 1 / body["phi"]]) @ turn.T
    (bxx, bxy), (_, byy) = radii.tolist()

    def derivatives(t: float, state: Floats) -> list[float]:
        ux, uy, uz, *w = state.tolist()
        u_rate = _cross((ux, uy, uz), w)
        # Contact point (Eqs. def-xy, def-z) and its rate.
        p, q = ux / uz, uy / uz
        dp, dq = (u_rate[0] - p * u_rate[2]) / uz, (u_rate[1] - q * u_rate[2]) / uz
        x, y = bxx * p + bxy * q, bxy * p + byy * q
        dx, dy = bxx * dp + bxy * dq, bxy * dp + byy * dq
        r = (x, y, 1 - (p * x + q * y) / 2)
        a, b = _cross((dx, dy, -(p * dx + q * dy)), w), _cross(w, _cross(r, w))
        force = (a[0] + b[0] + ux, a[1] + b[1] + uy, a[2] + b[2] + uz)
        gyration = _cross([i * k for i, k in zip(inertia, w, strict=True)], w)
        torque = [i + k for i, k in zip(gyration, _cross(r, force), strict=True)]
        diagonal = [i + _dot(r, r) for i in inertia]
        free = [i / k for i, k in zip(torque, diagonal, strict=True)]
        lever = [i / k for i, k in zip(r, diagonal, strict=True)]
        pull = _dot(r, free) / (1 - _dot(r, lever))
        return [*u_rate, *(i + pull * k for i, k in zip(free, lever, strict=True))]

    return derivatives


def _spin(t: float, state: Floats) -> float:
    return _dot(state[:3], state[3:])


_spin.terminal = True  # type: ignore[attr-defined]


def independent_reversal(
    body: dict[str, float], n_i: float, omega_xy0: float, psi: float, t_end: float
) -> float:
    """Time of the first reversal by SciPy's DOP853 and equations of its own; NaN without one."""
    from scipy.integrate import solve_ivp

    omega = omega_xy0 * np.cos(psi), omega_xy0 * np.sin(psi), -n_i
    start = np.array([0.0, 0.0, -1.0, *omega])
    atol = 1e-2 * RTOL * omega_xy0
    found = solve_ivp(_equations(body), (0.0, t_end), start, method="DOP853", events=_spin,
                      rtol=RTOL, atol=atol)  # fmt: skip
    times = found.t_events
    return float(times[0][0]) if times is not None and len(times[0]) else float("nan")


def confirm(runs: Runs, reference: Reference, *, units: float) -> dict[str, Any]:
    """Check the reference by a third, independent integrator, and say how far off it is.

    The runs are a few cheap ones of each direction and amplitude, `units` long in all; plain Python
    takes about 1 ms for a unit of time.
    """
    launches = runs.launches
    columns = {name: getattr(launches, name) for name in ("n_i", "omega_xy0", "psi")}
    columns |= {name: getattr(launches.bodies, name) for name in PARAMETERS}
    known = pd.DataFrame(columns).assign(t_r=reference.solution.t_r)[reference.both]
    cheap = known.sort_values("t_r", kind="stable")
    cheap = cheap.groupby([np.sign(cheap.n_i), cheap.omega_xy0]).head(2)
    # As many as the time allows, and at least one.
    apart = []
    for run in cheap[: max(1, (cheap.t_r.cumsum() <= units).sum())].to_dict("records"):
        body = {name: run[name] for name in PARAMETERS}
        found = independent_reversal(
            body, run["n_i"], run["omega_xy0"], run["psi"], 1.01 * run["t_r"]
        )
        apart.append(abs(found / run["t_r"] - 1))
    good = [value for value in apart if value == value]
    return {
        "confirmed_runs": len(apart),
        "confirmed_within": max(good, default=None),
        "confirmed_missed": len(apart) - len(good),
    }
