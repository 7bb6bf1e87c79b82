"""Some runs of Fig. 7 once more with the paper's integrator."""

from __future__ import annotations

from typing import Any

from rattlesweep.paper.workspace import Tables, Workspace

PAPERS: dict[str, Any] = {"method": "rk4", "dt": 0.002}
# Integrates those on which the two differ once more.
REFERENCE = {"method": "dop853", "tol": 1e-12}
# Two times of reversal are the same if they differ by less than this, relatively.
SAME = 1e-6


def data(ws: Workspace) -> Tables:
    """Return the table ``runs``: the first samples of every case, with both integrators.

    Where the type or the time of reversal differs, by more than :data:`SAME`, a third integration
    at a tolerance of 1e-12 is beside.
    """
    chosen = f"sample < {ws.sizes.rk4} and K_r >= {ws.sizes.rk4_least_K_r}"
    ours = ws.sweep("steady").query(chosen).reset_index(drop=True)
    theirs = ws.again("rk4", ours, integrator=PAPERS)
    names = ["K_r", "n_i", "omega_xy0", "sample", "type", "t_r"]
    rows = ours[names].join(theirs[["type", "t_r"]].add_suffix("_rk4"))
    rows["difference"] = rows["t_r_rk4"] / rows["t_r"] - 1
    odd = (rows["type"] != rows["type_rk4"]) | (rows["difference"].abs() > SAME)
    exact = ws.again("rk4-exceptions", ours[odd], integrator=REFERENCE)
    return {"runs": rows.join(exact.reindex(columns=["type", "t_r"]).add_suffix("_reference"))}
