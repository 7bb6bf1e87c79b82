"""Orbits that return: times, a second program, and the ends of runs of type SW.

    python benchmarks/orbits.py            # all; --runs 10 for a first look

The second program is SciPy's `solve_bvp` (collocation): a periodic boundary value
problem for slopes and rates, with the period and an unfolding along the gradient of
the energy as unknowns.
"""

import argparse
import time

import numpy as np
import pandas as pd
from scipy.integrate import solve_bvp, solve_ivp

import rattlesweep as rs

BODY_A = rs.Rattleback(7, 3, 7, 1 / 4, 1 / 9, -0.485)
START = {
    "omega": (1.02, 1.19, -0.28),
    "u": (-0.2898, -0.1618, -0.9433),
    "period": 7.9,
    "energy": 6.52,
}
K_R = [0.0041, 0.00647, 0.0102, 0.0161, 0.0254, 0.0401, 0.0633, 0.1]
STEADY = {
    "name": "orbits",
    "seed": 2017,
    "bodies": {"source": "sd", "samples": 12, "target": {"K_r": K_R, "rel_tol": 1e-3}},
    "spin": {"n_i": [-0.1, -0.2, -0.3, -0.4, -0.5], "omega_xy0": [0.001, 0.01, 0.1]},
    "horizon": {"t_rgh": 5},
}
VECTORS = ("omega_x", "omega_y", "omega_z", "u_x", "u_y", "u_z")
ON_ORBIT = 1e-3  # distance of the last states of a run from an orbit


def times() -> None:
    """Print processor times of one orbit and of a branch of 100 steps."""
    start = rs.orbit(BODY_A, **START)
    begin = time.process_time()
    for _ in range(20):
        rs.orbit(BODY_A, **START)
    middle = time.process_time()
    rs.branch(start, "energy", to=6.3, steps=100)
    end = time.process_time()
    print(f"one orbit {1e3 * (middle - begin) / 20:.1f} ms")
    print(f"100 steps with two special points {end - middle:.2f} s")


def second_program() -> None:
    """Print an orbit of GH by ours and by `solve_bvp`.

    The equations are written anew, for many states ``(p, q, omega)`` at once.
    """
    body = rs.Rattleback.gh()
    found = rs.find_orbits(body, n_i=-0.5, omega_xy0=0.1, t_end=20_000)[0]
    print(found)
    inertia = np.array([body.alpha - 1, body.beta - 1, body.gamma])
    c, s = np.cos(body.xi), np.sin(body.xi)
    turn = np.array([[c, -s], [s, c]])
    radii = turn @ np.diag([1 / body.theta, 1 / body.phi]) @ turn.T

    def place(y):
        slope = y[:2]
        reach = radii @ slope
        r = np.array([*reach, 1 - (slope * reach).sum(0) / 2])
        u = -np.array([*slope, np.ones_like(slope[0])])
        return u / np.linalg.norm(u, axis=0), r

    def energy(y):
        u, r = place(y)
        v = np.cross(r, y[2:], axis=0)
        moving = (inertia[:, None] * y[2:] ** 2).sum(0) + (v * v).sum(0)
        return moving / 2 - (r * u).sum(0) - 1

    def rate(y):
        u, r = place(y)
        w = y[2:]
        du = np.cross(u, w, axis=0)
        slope_rate = (du[:2] * u[2] - u[:2] * du[2]) / u[2] ** 2
        reach = radii @ slope_rate
        dr = np.array([*reach, -(y[:2] * reach).sum(0)])
        turned = np.cross(dr, w, axis=0)
        turned += np.cross(w, np.cross(r, w, axis=0), axis=0)
        torque = np.cross(r, turned, axis=0) + np.cross(r, u, axis=0)
        torque -= np.cross(w, inertia[:, None] * w, axis=0)
        square = (r * r).sum(0)
        matrices = np.einsum("in,jn->nij", -r, r)
        for k in range(3):
            matrices[:, k, k] += inertia[k] + square
        return np.concatenate(
            [slope_rate, np.linalg.solve(matrices, torque.T[:, :, None])[:, :, 0].T]
        )

    def gradient(y, h=1e-5):
        steps = h * np.eye(5)[:, :, None]
        return np.array([energy(y + e) - energy(y - e) for e in steps]) / (2 * h)

    def equations(_, y, p):
        return p[0] * (rate(y) + p[1] * gradient(y))

    u = np.array(found.u)
    y0 = np.array([u[0] / u[2], u[1] / u[2], *found.omega])
    normal = rate(y0[:, None])[:, 0]

    def ends(a, b, p):
        height = energy(a[:, None])[0] - found.energy
        return np.array([*(b - a), normal @ (a - y0), height])

    mesh = np.linspace(0, 1, 161)
    run = solve_ivp(
        lambda _, y: rate(y[:, None])[:, 0],
        (0, found.period),
        y0,
        t_eval=mesh * found.period,
        rtol=1e-7,
        atol=1e-9,
    )
    start = [found.period * 1.001, 0.0]
    solved = solve_bvp(
        equations, ends, mesh, run.y, p=start, tol=1e-9, bc_tol=1e-11, max_nodes=20_000
    )
    print(f"{solved.message}, {solved.x.size} nodes")
    print(f"period {solved.p[0]:.12g}, ours {found.period:.12g}")
    print(f"unfolding {solved.p[1]:.1e}; state {np.abs(solved.y[:, 0] - y0).max():.1e}")


def ends_of_wobbles(runs: int) -> None:
    """Print how many runs of type SW end on an orbit, and of which kind."""
    sweep = rs.sweep(STEADY, progress=False)
    chosen = sweep.read(where='type == "SW"').sample(runs, random_state=1)
    rows = []
    for run in chosen.itertuples():
        body = rs.Rattleback(run.alpha, run.beta, run.gamma, run.theta, run.phi, run.xi)
        launch = {
            "n_i": run.n_i,
            "omega_xy0": run.omega_xy0,
            "psi": float(np.degrees(run.psi)),
            "t_end": run.t_end,
        }
        row = {"K_r": run.K_r, "n_i": run.n_i, "push": run.omega_xy0}
        try:
            orbits = rs.find_orbits(body, **launch)
        except rs.ConfigError:
            rows.append({**row, "kind": "none"})
            continue
        # The nearest of the orbits, over the last times that the run crosses near it.
        late = rs.trajectory(
            body, **launch, section="omega_y=0+", from_time=run.t_end - 100
        ).section
        states = late[list(VECTORS)].to_numpy()
        found = min(orbits, key=lambda o: _distance(o, states))
        rows.append(
            {
                **row,
                "kind": found.kind,
                "distance": _distance(found, states),
                "largest": np.abs(found.multipliers).max(),
                "n_mean": found.n_mean,
            }
        )
    table = pd.DataFrame(rows)
    print(table.to_string())
    on = (table["kind"] == "stable") & (table["distance"] < ON_ORBIT)
    print(f"{on.sum()} of {len(table)} end on a stable orbit")
    print(table.groupby("kind").size())


def _distance(orbit: rs.Orbit, states: np.ndarray) -> float:
    state = np.array([*orbit.omega, *orbit.u])
    return float(np.linalg.norm(states - state, axis=1).min())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    given = parser.parse_args()
    times()
    second_program()
    ends_of_wobbles(given.runs)
