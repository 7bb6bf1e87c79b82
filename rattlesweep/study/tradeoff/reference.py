"""Times of reversal to measure others by: two methods that agree, and a third that confirms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.physics.body import PARAMETERS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.study.tradeoff.runs import Runs, Solution

    Floats = NDArray[np.float64]
    Vector = tuple[float, float, float]

METHODS = ("verner98", "dop853")
TOL = 1e-13
AGREE = 1e-8
# Of the spins at the horizon, where neither has a reversal.  A tumbling body amplifies rounding:
# whether it reverses one day is then not for double precision to say.
AGREE_N = 1e-6
# The third integrator: as tight as SciPy allows without a warning, or nearly.
RTOL = 1e-12


@dataclass(frozen=True)
class Reference:
    """What the runs come to.

    Attributes
    ----------
    solution : Solution
        Of the first method.
    both : ndarray of bool
        Both methods have a reversal, and agree on its time to :data:`AGREE`.
    neither : ndarray of bool
        Neither has a reversal, and both give the run the same type and, to :data:`AGREE_N`, the
        same spin at its end.
    reverse_in_both : int
        Runs with a reversal in both, agreeing or not.
    apart : ndarray
        Relative difference of the two times, where there are two.
    """

    solution: Solution
    both: NDArray[np.bool_]
    neither: NDArray[np.bool_]
    reverse_in_both: int
    apart: Floats

    @property
    def dropped(self) -> int:
        """Runs that the two methods do not agree on."""
        return int((~self.both & ~self.neither).sum())


def make_reference(runs: Runs, threads: int) -> Reference:
    """Integrate the runs with two methods at a tight tolerance."""
    one, other = (
        runs.integrate(runs.batches["full"], "full", {"method": method, "tol": TOL}, threads)
        for method in METHODS
    )
    reversal = np.isfinite(one.t_r) & np.isfinite(other.t_r)
    apart = np.abs(one.t_r / other.t_r - 1)
    none = np.isnan(one.t_r) & np.isnan(other.t_r) & one.ok & other.ok
    none &= np.abs(one.n_end - other.n_end) <= AGREE_N * np.abs(runs.launches.n_i)
    return Reference(
        solution=one,
        both=reversal & (apart < AGREE),
        neither=none & (one.types == other.types),
        reverse_in_both=int(reversal.sum()),
        apart=apart[reversal],
    )


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _equations(body: dict[str, float]) -> Any:
    """The paper's Eqs. diff-u and diff-omega in ``(u, omega)``, for a solver of SciPy.

    Written apart from :mod:`rattlesweep.physics`: six variables instead of five, the matrix of
    Eq. diff-omega inverted by its cofactors, no cancellation taken out by hand.
    """
    ix, iy, iz = body["alpha"] - 1, body["beta"] - 1, body["gamma"]
    cos, sin = np.cos(body["xi"]), np.sin(body["xi"])
    turn = np.array([[cos, -sin], [sin, cos]])
    curvature = turn @ np.diag([body["theta"], body["phi"]]) @ turn.T
    radii = turn @ np.diag([1 / body["theta"], 1 / body["phi"]]) @ turn.T
    (axx, axy), (_, ayy) = curvature.tolist()
    (bxx, bxy), (_, byy) = radii.tolist()

    def derivatives(t: float, y: Floats) -> list[float]:
        u0, u1, u2, w0, w1, w2 = y.tolist()
        u, w = (u0, u1, u2), (w0, w1, w2)
        du = _cross(u, w)
        # Contact point (Eqs. def-xy, def-z) and its rate.
        p, q = u0 / u2, u1 / u2
        dp, dq = (du[0] - p * du[2]) / u2, (du[1] - q * du[2]) / u2
        x, y_ = bxx * p + bxy * q, bxy * p + byy * q
        dx, dy = bxx * dp + bxy * dq, bxy * dp + byy * dq
        fx, fy = axx * x + axy * y_, axy * x + ayy * y_
        r = (x, y_, 1 - (x * fx + y_ * fy) / 2)
        dr = (dx, dy, -(fx * dx + fy * dy))
        one = _cross((ix * w0, iy * w1, iz * w2), w)
        a, b = _cross(dr, w), _cross(w, _cross(r, w))
        two = _cross(r, (a[0] + b[0] + u0, a[1] + b[1] + u1, a[2] + b[2] + u2))
        t0, t1, t2 = one[0] + two[0], one[1] + two[1], one[2] + two[2]
        z = r[2]
        m00, m11, m22 = ix + y_ * y_ + z * z, iy + x * x + z * z, iz + x * x + y_ * y_
        m01, m02, m12 = -x * y_, -x * z, -y_ * z
        c00, c01, c02 = m11 * m22 - m12 * m12, m02 * m12 - m01 * m22, m01 * m12 - m02 * m11
        c11, c12, c22 = m00 * m22 - m02 * m02, m01 * m02 - m00 * m12, m00 * m11 - m01 * m01
        det = m00 * c00 + m01 * c01 + m02 * c02
        return [
            *du,
            (c00 * t0 + c01 * t1 + c02 * t2) / det,
            (c01 * t0 + c11 * t1 + c12 * t2) / det,
            (c02 * t0 + c12 * t1 + c22 * t2) / det,
        ]

    return derivatives


def _spin(t: float, y: Floats) -> float:
    return float(y[0] * y[3] + y[1] * y[4] + y[2] * y[5])


_spin.terminal = True  # type: ignore[attr-defined]


def independent_reversal(
    body: dict[str, float], n_i: float, omega_xy0: float, psi: float, t_end: float
) -> float:
    """Time of the first reversal by SciPy's DOP853 and equations of its own; NaN without one."""
    from scipy.integrate import solve_ivp

    start = [0.0, 0.0, -1.0, omega_xy0 * np.cos(psi), omega_xy0 * np.sin(psi), -n_i]
    found = solve_ivp(
        _equations(body),
        (0.0, t_end),
        start,
        method="DOP853",
        events=_spin,
        rtol=RTOL,
        atol=1e-2 * RTOL * omega_xy0,
    )
    times = found.t_events
    return float(times[0][0]) if times is not None and len(times[0]) else float("nan")


@dataclass(frozen=True)
class Confirmation:
    """Runs integrated by a third, independent integrator, and how far off the reference is."""

    runs: int
    largest: float
    missed: int


def confirm(runs: Runs, reference: Reference, *, units: float) -> Confirmation:
    """Check the reference on a few cheap runs of each direction and amplitude.

    Parameters
    ----------
    runs, reference
    units : float
        Time to integrate in all; plain Python takes about 1 ms for a unit.
    """
    launches = runs.launches
    t_r = np.where(reference.both, reference.solution.t_r, np.inf)
    picks: list[int] = []
    for sign in (-1, 1):
        for omega in np.unique(launches.omega_xy0):
            group = np.flatnonzero(
                (np.sign(launches.n_i) == sign) & (launches.omega_xy0 == omega) & np.isfinite(t_r)
            )
            picks += group[np.argsort(t_r[group], kind="stable")][:2].tolist()
    picks.sort(key=lambda k: t_r[k])
    # As many as the time allows, and at least one.
    affordable = max(1, int((np.cumsum(t_r[picks]) <= units).sum()))
    apart = []
    for k in picks[:affordable]:
        body = {name: float(getattr(launches.bodies, name)[k]) for name in PARAMETERS}
        n_i, omega_xy0, psi = (
            float(x[k]) for x in (launches.n_i, launches.omega_xy0, launches.psi)
        )
        found = independent_reversal(body, n_i, omega_xy0, psi, 1.01 * float(t_r[k]))
        apart.append(abs(found / float(t_r[k]) - 1))
    good = [value for value in apart if value == value]
    return Confirmation(len(apart), float(max(good, default=np.nan)), len(apart) - len(good))
