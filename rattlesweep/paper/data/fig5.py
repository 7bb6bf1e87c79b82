"""Figs. 5 and 7: times of reversal beside Garcia and Hubbard's; Fig. 5(b): a spin that swings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.paper.data.columns import number, schema, table
from rattlesweep.paper.data.follow import FORCE_CHANNELS, FORCES, follow, forces
from rattlesweep.paper.data.progress import Progress
from rattlesweep.paper.workspace import StoredRuns
from rattlesweep.physics.body import Rattleback
from rattlesweep.sweeps.blocks.single import Launch
from rattlesweep.sweeps.tables.columns import RATE, TIME

# Of (b); its length is not named in the paper.
N_I, OMEGA_XY0, T_END = 0.5, 0.01, 150.0
SPIN = schema("t n omega_x")
Z95 = 1.959964


def data(sweep: StoredRuns, progress: Progress) -> dict[str, pa.Table]:
    """Data of Fig. 5.

    Returns
    -------
    dict
        ``times``: one row a point of part (a), see :func:`times`; ``spin``, ``forces``: the run
        of part (b), in the sweep's integrator.
    """
    integrator = sweep.config.integrator.model_dump(exclude_none=True)
    launch = Launch(Rattleback.gh(), N_I, OMEGA_XY0, T_END, integrator=integrator)
    channels = ("t", "n", "omega_x", *FORCE_CHANNELS)
    found, _ = follow(launch, channels, f"GH at n_i = {N_I:g}", progress)
    return {
        "times": times(sweep),
        "spin": pa.Table.from_pandas(found.table[SPIN.names], schema=SPIN, preserve_index=False),
        "forces": table([forces(f"Fig. 5(b), n_i = {N_I:g}", found.table)], FORCES),
    }


def times(sweep: StoredRuns) -> pa.Table:
    """One row a point: the runs that reverse, and the theory's line at the mean ``n_0``."""
    columns = ("n_0", "t_rgh", "t_r", "type")
    rows = [point | of_point(runs, point) for point, runs in sweep.points(columns)]
    return table(
        rows,
        schema(
            f"{sweep.target} n_i omega_xy0 runs reversed",
            number("t_r_mean", "mean time of reversal", TIME),
            number("t_r_std", "its sample standard deviation over the runs", TIME),
            number("t_r_low", "95 % confidence interval of the mean (normal), lower end", TIME),
            number("t_r_high", "the same, upper end", TIME),
            number("t_r_median", "median time of reversal", TIME),
            number("n_0_mean", "mean over all runs of the spin that would hold all energy", RATE),
            number("t_rgh_line", "Garcia and Hubbard's time at the mean n_0", TIME),
            number("ratio_mean", "mean over the runs of t_r / t_rGH of the same run"),
            number("ratio_std", "its sample standard deviation"),
        ),
    )


def of_point(runs: pd.DataFrame, point: dict[str, Any]) -> dict[str, Any]:
    """The rest of the row; not a number where no run, or only one, reverses."""
    back = runs[runs["type"] == "R"]
    t_r, ratio = back["t_r"], back["t_r"] / back["t_rgh"]
    mean, n_0 = t_r.mean(), runs["n_0"].mean()
    half = Z95 * t_r.std() / np.sqrt(max(len(back), 1))
    coefficient, n_i = next(iter(point.values())), point["n_i"]
    return {
        "runs": len(runs),
        "reversed": len(back),
        "t_r_mean": mean,
        "t_r_std": t_r.std(),
        "t_r_low": mean - half,
        "t_r_high": mean + half,
        "t_r_median": t_r.median(),
        "n_0_mean": n_0,
        "t_rgh_line": gh_line(coefficient, n_i, n_0),
        "ratio_mean": ratio.mean(),
        "ratio_std": ratio.std(),
    }


def gh_line(coefficient: float, n_i: float, n_0: float) -> float:
    """Garcia and Hubbard's reversal time from ``n_0`` (Eqs. (56) [trgh-p] and (58) [trgh-m]).

    Twice artanh(n_i/n_0): the logarithm's argument loses no more digits than the mean of n_0 has.
    """
    return 2 * float(np.arctanh(abs(n_i) / n_0)) / (n_0 * coefficient)
