"""Why there is no single precision: reversal times of plain RK4 in float32 and float64.

    python benchmarks/single_precision.py [--runs 400] [--longest 600]

Both use the equations in (u, omega), written by hand in peer_plain.py, as NumPy
formulas over all runs at once, with the same steps.  In float32 no intermediate result
is a float64. Errors are against DOP853 at tol 1e-13.  Bodies are those of
configs/quickstart.yaml.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from peer_plain import derivatives

import rattlesweep as rs
from rattlesweep.physics import full
from rattlesweep.physics.body import PARAMETERS

CONFIG = Path(__file__).parents[1] / "configs" / "quickstart.yaml"
STEPS = (0.02, 0.01, 0.005)
rhs = derivatives.py_func


def moved(y, h, k):
    """Return ``y + h k`` for lists of arrays."""
    return [a + h * b for a, b in zip(y, k, strict=True)]


def spin(y):
    """Return ``u . omega``."""
    return y[0] * y[3] + y[1] * y[4] + y[2] * y[5]


def reversal_times(y, body, longest, dt):
    """Return the first zeros of the spin, interpolated linearly; NaN where there is
    none.
    """
    n = spin(y)
    t_r = np.full(len(n), np.nan)
    for step in range(int(longest / dt)):
        k1 = rhs(*y, *body)
        k2 = rhs(*moved(y, dt / 2, k1), *body)
        k3 = rhs(*moved(y, dt / 2, k2), *body)
        k4 = rhs(*moved(y, dt, k3), *body)
        y = [
            a + dt / 6 * (one + 2 * two + 2 * three + four)
            for a, one, two, three, four in zip(y, k1, k2, k3, k4, strict=True)
        ]
        n1 = spin(y)
        # In float32 `step * dt` itself is right to 6e-8.
        new = np.isnan(t_r) & (n * n1 <= 0)
        t_r[new] = (step + n[new] / (n[new] - n1[new])) * dt
        n = n1
    return t_r


@click.command()
@click.option("--runs", default=400)
@click.option(
    "--longest", default=600.0, help="Runs that reverse by this time are taken."
)
def main(runs: int, longest: float) -> None:
    """Print the errors of both precisions."""
    table = rs.sweep(CONFIG, output=None).read(
        [*PARAMETERS, "n_i", "omega_xy0", "psi", "t_r"]
    )
    table = table[table["t_r"] < longest].head(runs)
    true = rs.simulate(table, t_end=longest * 1.5, tol=1e-13)["t_r"].to_numpy()
    constants = full.constants(*(table[name].to_numpy() for name in PARAMETERS))
    rates = (table["omega_xy0"] * f(table["psi"]) for f in (np.cos, np.sin))
    none = 0 * table["n_i"]
    start = [none, none, none - 1, *rates, -table["n_i"]]
    print(f"{len(table)} runs; relative error of t_r")
    print(
        f"{'':10}{'dt':>7}{'median':>10}{'90 %':>10}{'largest':>10}{'above 1e-3':>12}"
    )
    for kind in (np.float64, np.float32):
        y = [np.asarray(column, dtype=kind) for column in start]
        body = list(np.asarray(constants, dtype=kind))
        for dt in STEPS:
            off = np.abs(reversal_times(y, body, longest * 1.2, dt) / true - 1)
            off[np.isnan(off)] = np.inf
            shown = (*np.quantile(off, [0.5, 0.9]), off.max())
            print(
                f"{kind.__name__:10}{dt:7}"
                + "".join(f"{value:10.1e}" for value in shown)
                + f"{np.mean(off > 1e-3):12.1%}"
            )


if __name__ == "__main__":
    main()
