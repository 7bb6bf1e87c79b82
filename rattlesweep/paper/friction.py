"""A supplement on friction, of which the paper has none: which bodies reverse in one direction."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from rattlesweep.analysis.style import BLUE, GREEN, VERMILION, new_figure
from rattlesweep.paper.frames import ABOVE, frame
from rattlesweep.paper.workspace import Tables, Workspace
from rattlesweep.sweeps.types import wilson

N_I, OMEGA_XY0 = 0.3, 0.01
# In units of M a^2 sqrt(g/a).  A spin alone lasts gamma/sigma: 300 to 1500 sqrt(a/g) at 0.01 to
# 0.03, or 10 to 50 s for a stone with a = 1 cm.
SIGMAS = (0.001, 0.002, 0.004, 0.008, 0.015, 0.03, 0.06, 0.12)
SHARES = {
    "one_way": ("in the unsteady direction only", VERMILION, "o"),
    "both": ("in both", BLUE, "s"),
    "neither": ("in neither", GREEN, "^"),
}


def data(ws: Workspace) -> Tables:
    """Return the table ``shares``: one row a sigma, with 95 % intervals (Wilson)."""
    runs = ws.sweep("friction", {
        "name": "friction",
        "seed": 2017,
        "bodies": {"source": "sd", "samples": ws.sizes.friction},
        "spin": {"n_i": [N_I, -N_I], "omega_xy0": OMEGA_XY0},
        "dissipation": {"sigma": list(SIGMAS)},
        "horizon": {"t_decay": 5},
        "record": ["reversals"],
    })  # fmt: skip
    turns = runs.pivot_table("n_turns", ["sigma", "sample"], "n_i").dropna()
    unsteady, steady = turns[N_I] > 0, turns[-N_I] > 0
    found = pd.DataFrame(
        {"runs": 1, "one_way": unsteady & ~steady, "both": unsteady & steady,
         "neither": ~unsteady & ~steady, "steady_only": ~unsteady & steady,
         "unsteady": unsteady, "twice": turns[N_I] > 1}
    )  # fmt: skip
    rows = found.groupby("sigma").sum().reset_index()
    for name in SHARES:
        rows[f"fraction_{name}"] = rows[name] / rows["runs"]
        rows[f"low_{name}"], rows[f"high_{name}"] = wilson(rows[name], rows["runs"])
    return {"shares": rows}


def draw(tables: Tables) -> Figure:
    """Draw the shares of the bodies against sigma."""
    rows = tables["shares"]
    figure = new_figure(5.4, 3.6)
    axis = figure.add_subplot()
    for name, (words, colour, marker) in SHARES.items():
        share = rows[f"fraction_{name}"]
        bars = [(share - rows[f"low_{name}"]).clip(0), (rows[f"high_{name}"] - share).clip(0)]
        axis.errorbar(rows["sigma"], share, yerr=bars, color=colour, marker=marker, markersize=5,
                      markerfacecolor="white", linewidth=0.9, label=words)  # fmt: skip
    axis.set(xscale="log", ylim=(-0.03, 1.03), ylabel="share of the bodies that reverse",
             xlabel=r"$\sigma$ / $M a^2 \tilde\omega$")  # fmt: skip
    frame(axis, grid="both")
    figure.legend(ncols=3, **ABOVE)
    return figure
