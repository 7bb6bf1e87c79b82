"""Fig. 7: fractions of the types R, SS and SW in the steady direction, and examples of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rattlesweep.analysis.style import BLUE, TYPE_STYLE, new_figure
from rattlesweep.paper.frames import (
    ABOVE,
    N_AXIS,
    T_AXIS,
    decade_ticks,
    follow,
    frame,
    launch,
    thinned,
)
from rattlesweep.paper.workspace import Tables, Workspace, evenly, records
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.sweeps.types import is_chaotic, wilson

# In the order of the legend.
SHOWN = ("R", "SW", "SS", "unclassified")
BONDI = r"$|n_{c1}| < |n_i|$ (Bondi)"
# Examples: the runs among which each is chosen, and its title.  The paper says of the chaotic run
# only where it lies.
EXAMPLES = {
    "spin_ss": ("type == 'SS' and n_i == -0.5 and omega_xy0 == 0.1", "(b-1) SS"),
    "spin_sw": ("type == 'SW' and n_i == -0.4 and omega_xy0 == 0.01", "(b-2) SW"),
    "spin_chaotic": ("chaotic and K_r == 0.0041 and n_i == -0.5", "(b-3) SW, chaotic"),
}
# Longest time of an example, in sqrt(a/g), and stretches of its curve.
LONGEST, BINS = 20_000.0, 1100


def data(ws: Workspace) -> Tables:
    """Return the tables of the figure and of what its claims need."""
    runs = ws.sweep("steady")
    found = chaos(ws, runs)
    return {
        "fractions": fractions(runs),
        "settled": settled(runs),
        "chaos": found,
        **examples(runs.assign(chaotic=False), found),
    }


def fractions(runs: pd.DataFrame) -> pd.DataFrame:
    """Count the types of every case, with 95 % intervals of their shares (Wilson)."""
    past, steady = runs["n_c1"].abs() < runs["n_i"].abs(), runs["type"] == "SS"
    found = runs[["K_r", "n_i", "omega_xy0"]].assign(
        runs=1, bondi=past, ss_only=steady & ~past, bondi_only=past & ~steady,
        **{name: runs["type"] == name for name in SHOWN},
    )  # fmt: skip
    rows = found.groupby(["K_r", "n_i", "omega_xy0"], sort=False).sum().reset_index()
    for name in ("bondi", *SHOWN):
        rows[f"fraction_{name}"] = rows[name] / rows["runs"]
        rows[f"low_{name}"], rows[f"high_{name}"] = wilson(rows[name], rows["runs"])
    return rows


def settled(runs: pd.DataFrame) -> pd.DataFrame:
    """Return where runs of type SS end; ``gain`` is 1 if all energy is in the spin."""
    # Within 1 % of Bondi's threshold the oscillation is still there at the horizon.
    own = runs[runs["type"] == "SS"]
    near = own["n_c1"].abs() > 0.99 * own["n_i"].abs()
    beyond = (own["n_end"] / own["n_i"] - 1).where(~near)
    gain = ((own["n_end"] - own["n_i"]) / (-own["n_0"] - own["n_i"])).where(~near)
    found = own.assign(near=near, beyond=beyond, gain=gain, faster=beyond > 0)
    groups = found.groupby(["n_i", "omega_xy0"], sort=False)
    return groups.agg(
        SS=("gain", "count"), near=("near", "sum"), faster=("faster", "sum"),
        gain_median=("gain", "median"), beyond_median=("beyond", "median"),
        beyond_max=("beyond", "max"),
    ).reset_index()  # fmt: skip


def chaos(ws: Workspace, runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs of type SW with Lyapunov exponents and whether they are chaotic."""
    runs = evenly(runs[runs["type"] == "SW"], ws.sizes.lyapunov)
    found = ws.again(runs, record=["lyapunov"]).reindex(columns=["lyapunov", "lyapunov_late"])
    found = runs.join(found)
    return found.assign(chaotic=is_chaotic(found["lyapunov_late"], found["t_end"]))


def examples(runs: pd.DataFrame, wobbling: pd.DataFrame) -> Tables:
    """Return the table ``examples`` and the spin of each, thinned, where there are such runs."""
    order = {"spin_ss": (runs, "n_end"), "spin_sw": (runs, "n_departure")}
    rows, tables = [], {}
    for name, (condition, _) in EXAMPLES.items():
        among, by = order.get(name, (wobbling, "lyapunov_late"))
        chosen = among.query(condition).sort_values([by, "K_r", "sample"])
        if chosen.empty:
            continue
        # The one in the middle, the lower one of two.
        run = chosen.iloc[-1 if name == "spin_chaotic" else (len(chosen) - 1) // 2]
        shown = min(LONGEST, run["t_end"])
        found = follow(Rattleback(*map(float, run[list(PARAMETERS)])), "n", n_i=run["n_i"],
                       omega_xy0=run["omega_xy0"], t_end=shown)  # fmt: skip
        tables[name] = thinned(found.table, n=BINS)
        kept = run.reindex(["K_r", "n_i", "omega_xy0", "sample", "t_end", "lyapunov_late"])
        rows.append({"example": name, **kept, "shown": shown})
    return tables | {"examples": pd.DataFrame(rows)}


def draw(tables: Tables) -> Figure:
    """Draw (a), a column a spin and a row an oscillation, and (b) examples, if there are any."""
    values, shown = tables["fractions"], records(tables["examples"])
    spins, sizes = sorted(values["n_i"].unique(), key=abs), sorted(values["omega_xy0"].unique())
    figure = new_figure(2.1 * len(spins) + 0.6, 1.75 * len(sizes) + 0.7 + 2.4 * bool(shown))
    heights = (1.75 * len(sizes) + 0.7, 2.4) if shown else (1,)
    upper, *lower = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    if shown:
        draw_examples(lower[0], shown, tables)
    axes = upper.subplots(len(sizes), len(spins), sharex=True, sharey=True, squeeze=False)
    for row, size in zip(axes, sizes, strict=True):
        for axis, spin in zip(row, spins, strict=True):
            own = values[(values["n_i"] == spin) & (values["omega_xy0"] == size)]
            draw_fractions(axis, own.sort_values("K_r"))
        row[0].set_ylabel(launch({"omega_xy0": size}, "omega_xy0") + "\nfraction")
    for axis, spin in zip(axes[0], spins, strict=True):
        frame(axis, launch({"n_i": spin}, "n_i"))
    frame(axes[0, 0], "(a)", loc="left")
    for axis in axes[-1]:
        axis.set_xlabel("$K_r$")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    marks = dict(zip(labels, handles, strict=True))
    # Bondi's marks have no bars and would come first.
    marks[BONDI] = marks.pop(BONDI)
    upper.legend(marks.values(), marks, ncols=len(marks), **ABOVE)
    return figure


def draw_fractions(axis: Axes, rows: pd.DataFrame) -> None:
    """Draw the fractions of the types of one spin and oscillation."""
    x = rows["K_r"].to_numpy()
    for name in SHOWN:
        mark, share = TYPE_STYLE[name], rows[f"fraction_{name}"]
        bars = np.array([share - rows[f"low_{name}"], rows[f"high_{name}"] - share])
        axis.errorbar(
            x, share, yerr=np.maximum(bars, 0), color=mark.colour, marker=mark.marker,
            markersize=5, markerfacecolor=mark.colour if mark.marker == "x" else "white",
            markeredgewidth=1.1, linewidth=0.9, elinewidth=0.8, label=mark.label, zorder=3,
        )  # fmt: skip
    axis.plot(x, rows["fraction_bondi"], color="black", marker="^", markersize=3.4,
              linestyle="none", label=BONDI, zorder=4)  # fmt: skip
    axis.set(xscale="log", ylim=(-0.04, 1.04), yticks=[0, 0.5, 1])
    axis.set_xlim(x.min() / 1.3, x.max() * 1.3)
    decade_ticks(axis.xaxis)
    frame(axis, grid="y")


def draw_examples(figure: Any, rows: list[dict[str, Any]], tables: Tables) -> None:
    """Draw the spin of the examples beside each other."""
    axes = figure.subplots(1, len(rows), squeeze=False)[0]
    for axis, row in zip(axes, rows, strict=True):
        spin = tables[row["example"]]
        axis.plot(spin["t"], spin["n"], color=BLUE, linewidth=0.7)
        axis.set_xlabel(T_AXIS)
        axis.locator_params(axis="x", nbins=5)
        title = EXAMPLES[row["example"]][1]
        frame(axis, f"{title}\n{launch(row, 'n_i', 'omega_xy0', 'K_r')}")
        axis.title.set_fontsize(9.5)
    axes[0].set_ylabel(N_AXIS)
