"""Behind Fig. 6: the paper's integrator beside ours."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.paper.columns import number, schema, table, word
from rattlesweep.paper.workspace import Progress, Workspace, between
from rattlesweep.sweeps.columns import TIME
from rattlesweep.sweeps.config.schema import Classify

PAPERS: dict[str, Any] = {"method": "rk4", "dt": 0.002}
# Judges where the two disagree.
REFERENCE = {"method": "dop853", "tol": 1e-12}
# Two times of reversal are the same if they differ by less than this, relatively.
SAME = 1e-6

RK4 = schema(
    "K_r n_i omega_xy0 sample",
    word("type", "with the sweep's own integrator"),
    word("type_rk4", "with fourth-order Runge-Kutta"),
    number("t_r", "time of reversal with the sweep's own integrator", TIME),
    number("t_r_rk4", "time of reversal with fourth-order Runge-Kutta", TIME),
    number("t_r_reference", "at tol 1e-12, for the exceptions only", TIME),
    number("difference", "t_r_rk4 / t_r - 1"),
    word("exception", "why they differ; null where they do not"),
)


def rk4(ws: Workspace, progress: Progress) -> pa.Table:
    """The first samples of every case with RK4: one row a run, exceptions with their cause."""
    sweep = ws.sweep("steady", progress)
    chosen = f"sample < {ws.sizes.rk4} and K_r >= {ws.sizes.rk4_least_K_r}"
    ours = sweep.runs.query(chosen).reset_index(drop=True)
    if ours.empty:
        return table([], RK4)
    theirs = ws.again("rk4", ours, between(progress, 0.0, 0.97), integrator=PAPERS)
    rows = ours.join(theirs[["t_r", "type"]].add_suffix("_rk4"))
    rows["difference"] = rows["t_r_rk4"] / rows["t_r"] - 1
    odd = (rows["type"] != rows["type_rk4"]) | (rows["difference"].abs() > SAME)
    if odd.any():
        few, last = ours[odd], between(progress, 0.97, 1.0)
        exact = ws.again("rk4-exceptions", few, last, integrator=REFERENCE)
        rows["t_r_reference"] = exact["t_r"]
        trios = zip(*(f.to_dict("records") for f in (few, theirs[odd], exact)), strict=True)
        causes = [cause(one, other, judge, sweep.config.classify) for one, other, judge in trios]
        rows["exception"] = pd.Series(causes, few.index)
    return table(rows, RK4)


def cause(
    ours: dict[str, Any], rk4: dict[str, Any], exact: dict[str, Any], thresholds: Classify
) -> str:
    """Why two integrators part on a run, judged by a third one that is far more accurate."""
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
    """Whether two integrations of a run agree on its type and its time of reversal."""
    if one["type"] != other["type"]:
        return False
    return one["type"] != "R" or bool(abs(one["t_r"] / other["t_r"] - 1) <= SAME)
