"""Behind Fig. 6: the paper's integrator, and how large an oscillation SS bears."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.paper.data.columns import count, number, schema, table, word
from rattlesweep.paper.data.progress import Progress, between
from rattlesweep.paper.workspace import LAUNCH, Workspace
from rattlesweep.sweeps.config.schema import Classify, Integrator
from rattlesweep.sweeps.tables.columns import TIME
from rattlesweep.sweeps.tables.types import TYPES

PAPERS = Integrator(method="rk4", dt=0.002)
# Judges where the two disagree.
REFERENCE = Integrator(method="dop853", tol=1e-12)
# Two times of reversal are the same if they differ by less than this, relatively.
SAME = 1e-6
RESULTS = ("t_r", "type", "amp_growth", "n_departure")

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
    runs = sweep.runs((*LAUNCH, "sample", *RESULTS))
    chosen = (runs["sample"] < ws.sizes.rk4) & (runs["K_r"] >= ws.sizes.rk4_least_K_r)
    ours = runs[chosen].reset_index(drop=True)
    if not len(ours):
        return RK4.empty_table()
    theirs = ws.again("rk4", ours, RESULTS, between(progress, 0.0, 0.97), integrator=PAPERS)
    rows = ours.assign(type_rk4=theirs["type"], t_r_rk4=theirs["t_r"], exception=None)
    rows["difference"] = rows["t_r_rk4"] / rows["t_r"] - 1
    odd = (rows["type"] != rows["type_rk4"]) | (rows["difference"].abs() > SAME)
    if odd.any():
        few, last = ours[odd], between(progress, 0.97, 1.0)
        exact = ws.again("rk4-exceptions", few, RESULTS, last, integrator=REFERENCE)
        rows.loc[odd, "t_r_reference"] = exact["t_r"]
        trios = (few, theirs[odd], exact)
        rows.loc[odd, "exception"] = [
            cause(one, other, judge, sweep.config.classify)
            for one, other, judge in zip(*(f.to_dict("records") for f in trios), strict=True)
        ]
    return table(rows.to_dict("records"), RK4)


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
            if min(sides) <= border < max(sides) and max(sides) - min(sides) < 0.1 * border:
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


# ------------------------------------------------------------------ how much SS bears

N_I, SIZES = -0.3, (0.05, 0.06, 0.07, 0.08, 0.09)
BASIN = schema(
    "n_i omega_xy0",
    count("runs", "bodies past Bondi's threshold at this spin"),
    *(count(name, f"of them, type {name}") for name in TYPES),
)


def basin(ws: Workspace, progress: Progress) -> pa.Table:
    """Types of the bodies past Bondi's threshold, launched with larger and larger oscillations.

    The bodies are those of the sweep; empty if none of them is past it.
    """
    runs = ws.sweep("steady", progress).runs((*LAUNCH, "n_c1"))
    # Cases of one target share their bodies.
    one = (runs["n_i"] == N_I) & (runs["omega_xy0"] == runs["omega_xy0"].min())
    bodies = runs[one & (runs["n_c1"].abs() < abs(N_I))]
    if not len(bodies):
        return BASIN.empty_table()
    launches = pd.concat([bodies.assign(omega_xy0=w) for w in SIZES], ignore_index=True)
    launches["type"] = ws.again("basin", launches, ("type",), progress)["type"]
    rows = []
    for size, own in launches.dropna(subset=["type"]).groupby("omega_xy0"):
        counts = {name: np.count_nonzero(own["type"] == name) for name in TYPES}
        rows.append({"n_i": N_I, "omega_xy0": size, "runs": len(own), **counts})
    return table(rows, BASIN)
