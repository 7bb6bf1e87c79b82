"""Some runs of Fig. 7 once more with the paper's integrator."""

from __future__ import annotations

from typing import Any

import numpy as np

from rattlesweep.paper.workspace import Tables, Workspace, sweep_config
from rattlesweep.sweeps.config.schema import Classify

PAPERS: dict[str, Any] = {"method": "rk4", "dt": 0.002}
# Judges where the two disagree.
REFERENCE = {"method": "dop853", "tol": 1e-12}
# Two times of reversal are the same if they differ by less than this, relatively.
SAME = 1e-6


def data(ws: Workspace) -> Tables:
    """Return the table ``runs``: the first samples of every case, with the cause of exceptions."""
    chosen = f"sample < {ws.sizes.rk4} and K_r >= {ws.sizes.rk4_least_K_r}"
    ours = ws.sweep("steady").query(chosen).reset_index(drop=True)
    theirs = ws.again("rk4", ours, integrator=PAPERS)
    names = ["K_r", "n_i", "omega_xy0", "sample", "type", "t_r"]
    rows = ours[names].join(theirs[["t_r", "type"]].add_suffix("_rk4"))
    rows["difference"] = rows["t_r_rk4"] / rows["t_r"] - 1
    odd = (rows["type"] != rows["type_rk4"]) | (rows["difference"].abs() > SAME)
    rows["t_r_reference"], rows["exception"] = np.nan, None
    if odd.any():
        exact = ws.again("rk4-exceptions", ours[odd], integrator=REFERENCE)
        rows.loc[odd, "t_r_reference"] = exact["t_r"]
        limits = sweep_config("steady", ws.sizes).classify
        trios = zip(*(f.to_dict("records") for f in (ours[odd], theirs[odd], exact)), strict=True)
        rows.loc[odd, "exception"] = [cause(*trio, limits) for trio in trios]
    return {"runs": rows}


def cause(
    ours: dict[str, Any], rk4: dict[str, Any], exact: dict[str, Any], thresholds: Classify
) -> str:
    """Return why two integrators part on a run, judged by a third that is far more accurate."""
    if not isinstance(rk4["type"], str):
        return "RK4 gave no result: its status is not ok"
    if ours["type"] != rk4["type"]:
        for name, border in (
            ("amp_growth", thresholds.ss_growth),
            ("n_departure", thresholds.sw_departure),
        ):
            sides = [run[name] for run in (ours, rk4)]
            if min(sides) <= border < max(sides) and np.ptp(sides) < 0.1 * border:
                return f"threshold: {name} is {sides[0]:.6g} and {sides[1]:.6g} beside {border:g}"
    if same(exact, rk4):
        return "the sweep's tolerance: at tol 1e-12 it is as with RK4"
    if same(exact, ours):
        return "RK4's step: at tol 1e-12 it is as in the sweep"
    return "chaotic: at tol 1e-12 it is a third one; rounding decides"


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Return whether two integrations of a run agree on its type and its time of reversal."""
    if one["type"] != other["type"]:
        return False
    return one["type"] != "R" or bool(abs(one["t_r"] / other["t_r"] - 1) <= SAME)
