"""Evaluations of Adams methods and of DOP853 at equal error of the state.

``python benchmarks/adams.py``: VODE's Adams methods change step and order as they go.
The paper's body GH and six random bodies start at three spins, with a push of 0.1, and
are followed for 60 units of time.  Printed is the number of evaluations that VODE
takes over that of SciPy's DOP853, both with an absolute tolerance alone.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from peer_plain import derivatives
from scipy.integrate import DOP853, ode

import rattlesweep as rs

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    # Integrates constants from a state with a tolerance: the last state, evaluations;
    # None if it fails.
    Solver = Callable[[Floats, Floats, float], tuple[Floats, int] | None]

PUSH = 0.1
T_END = 60.0
SPINS = -0.1, 0.1, -0.4
ERRORS = 1e-5, 1e-6, 1e-7
TOLERANCES = 10.0 ** np.arange(-4.0, -10.1, -0.5)
REFERENCE = 1e-13


@njit(error_model="numpy")
def rhs(y, q):  # type: ignore[no-untyped-def]
    """Return the derivatives of the six variables (u, omega)."""
    ux, uy, uz, wx, wy, wz = y
    ix, iy, iz, xx, xy, yy = q
    dy = derivatives(ux, uy, uz, wx, wy, wz, ix, iy, iz, xx, xy, yy)
    return np.array(dy)


def constants_of(body: rs.Rattleback) -> Floats:
    """Return the inertia about the contact and the radii beyond 1."""
    c = np.cos(body.xi)
    s = np.sin(body.xi)
    radii = np.array([1 / body.theta, 1 / body.phi])
    xx = c * c * radii[0] + s * s * radii[1] - 1
    xy = c * s * (radii[0] - radii[1])
    yy = s * s * radii[0] + c * c * radii[1] - 1
    return np.array([body.alpha - 1, body.beta - 1, body.gamma, xx, xy, yy])


def by_dop853(q: Floats, y0: Floats, tol: float) -> tuple[Floats, int]:
    """Integrate with SciPy's DOP853."""
    solver = DOP853(lambda t, y: rhs(y, q), 0.0, y0, T_END, rtol=3e-14, atol=tol)
    while solver.status == "running":
        solver.step()
    return solver.y, solver.nfev


def by_adams(q: Floats, y0: Floats, tol: float) -> tuple[Floats, int] | None:
    """Integrate with VODE's Adams methods of orders 1 to 12."""
    evaluations = 0

    def counted(t: float, y: Floats) -> Floats:
        nonlocal evaluations
        evaluations += 1
        return rhs(y, q)  # type: ignore[no-any-return]

    solver = ode(counted)
    solver.set_integrator("vode", method="adams", rtol=0.0, atol=tol, nsteps=10**7)
    solver.set_initial_value(y0, 0.0)
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        y = solver.integrate(T_END)
    return (y, evaluations) if solver.successful() else None


def cost(solver: Solver, q: Floats, y0: Floats, exact: Floats) -> Floats:
    """Return the evaluations at the errors wanted, between those of tolerances."""
    logs = []
    for tol in TOLERANCES:
        ended = solver(q, y0, tol)
        if ended is not None:
            error = np.abs(ended[0] - exact).max() / PUSH
            logs.append((np.log(error), np.log(ended[1])))
    errors, evaluations = np.transpose(sorted(logs))
    return np.exp(np.interp(np.log(ERRORS), errors, evaluations))


def main() -> None:
    """Print the ratio of evaluations: median, least and largest over the bodies."""
    drawn = rs.draw_bodies(6, seed=3)
    names = "alpha", "beta", "gamma", "theta", "phi", "xi"
    bodies = [rs.Rattleback(**row) for row in drawn[list(names)].to_dict("records")]
    bodies.append(rs.Rattleback.gh())
    for spin in SPINS:
        y0 = np.array([0.0, 0.0, 1.0, PUSH, 0.0, spin])
        ratios = []
        for body in bodies:
            q = constants_of(body)
            exact, _ = by_dop853(q, y0, REFERENCE)
            ratios.append(cost(by_adams, q, y0, exact) / cost(by_dop853, q, y0, exact))
        for error, row in zip(ERRORS, np.transpose(ratios), strict=True):
            print(
                f"spin {spin:5.1f}, error {error:.0e}: median {np.median(row):.2f}, "
                f"{row.min():.2f} to {row.max():.2f}"
            )


if __name__ == "__main__":
    main()
