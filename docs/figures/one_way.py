"""Draw the figure of docs/one_way.md and print its tables.

rattlesweep run configs/one_way.yaml
python docs/figures/one_way.py out/one-way docs/one_way.png
"""

import sys

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from rattlesweep.api import load

PUSH = 0.01  # of the left panel
BODY = ["alpha", "gamma", "xi", "n_i", "omega_xy0"]
# Edges of the spin that there is over the one that is needed.
RATIOS = (0, 0.4, 0.6, 0.8, 1, 2, np.inf)


def wilson(hits: float, runs: float) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a fraction."""
    z = 1.96
    centre = (hits + z * z / 2) / (runs + z * z)
    half = z / (runs + z * z) * np.sqrt(hits * (1 - hits / runs) + z * z / 4)
    return max(0.0, centre - half), min(1.0, centre + half)


def read(directory: str) -> pd.DataFrame:
    """Return the runs that ended well, with the ratio of the rule.

    The averaged equations with one mode of the energy ``E`` are ``dE/dt = K abs(n) E``
    and ``gamma d abs(n)/dt = -K E - l``.  The spin passes zero if the torque ``K E``
    is then above the lever ``l``: if ``K gamma n_i^2 / (2 l) > 1 - e - ln e``, with
    ``e`` the first ``K E / l``.
    """
    sweep = load(directory)
    runs = sweep.runs
    runs = runs.merge(
        sweep.summary[["case", "K_r"]], on="case", suffixes=("", "_target")
    )
    print("status", runs["status"].value_counts().to_dict())
    runs = runs[runs["status"] == "ok"].copy()
    runs["reverses"] = runs["type"] == "R"
    lever = runs["pivot"]
    steady = runs["n_i"] < 0
    torque = runs["K_r"].where(steady, runs["K_p"])
    push = runs["gamma"] * (runs["n_0"] ** 2 - runs["n_i"] ** 2) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        start = torque * push / lever
        have = torque * runs["gamma"] * runs["n_i"] ** 2 / (2 * lever)
        need = 1 - start - np.log(start)
        runs["ratio"] = np.where(start >= 1, np.inf, have / need)
    return runs


def shares(runs: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return the share that reverses, with its interval, for each group."""
    counts = runs.groupby(by, observed=False)["reverses"].agg(["sum", "count"])
    counts = counts[counts["count"] > 0]
    pairs = zip(counts["sum"], counts["count"], strict=True)
    limits = [wilson(hits, total) for hits, total in pairs]
    counts["share"] = counts["sum"] / counts["count"]
    counts["low"], counts["high"] = np.transpose(limits)
    return counts


def draw_levers(axis: Axes, runs: pd.DataFrame) -> None:
    """Draw the share that reverses against the lever, a line for each spin."""
    colours = plt.get_cmap("viridis")
    spins = [n for n in (-0.1, -0.3, -0.5, 0.1, 0.3, 0.5) if n in set(runs["n_i"])]
    for spin in spins:
        rows = shares(runs[runs["n_i"] == spin], ["pivot"]).reset_index()
        colour = colours(0.1 + 1.6 * (abs(spin) - 0.1))
        style = "-" if spin < 0 else "--"
        # A lever of zero is drawn at the left end.
        x = rows["pivot"].where(rows["pivot"] > 0, 2.5e-4)
        axis.plot(x, rows["share"], style, color=colour, marker="o", ms=3)
        axis.fill_between(x, rows["low"], rows["high"], color=colour, alpha=0.15, lw=0)
        axis.plot([], [], style, color=colour, label=f"$n_i$ = {spin:g}")
    axis.set(
        xscale="log", ylim=(-0.02, 1.02), xlabel=f"lever over $a$; push of {PUSH:g}"
    )
    axis.set_ylabel("fraction of bodies that reverse")
    axis.set_xticks([2.5e-4, 1e-3, 1e-2], ["0", "0.001", "0.01"])
    axis.minorticks_off()
    axis.legend(
        frameon=False, fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0, 1)
    )


def draw_rule(axis: Axes, runs: pd.DataFrame) -> None:
    """Draw the share that reverses against the ratio of the rule."""
    runs = runs[(runs["n_i"] < 0) & (runs["pivot"] > 0)]
    edges = np.geomspace(0.1, 10, 21)
    for push, colour in ((0.01, "#0072b2"), (0.1, "#d55e00")):
        side = runs[runs["omega_xy0"] == push]
        rows = shares(side.assign(bin=pd.cut(side["ratio"], edges)), ["bin"])
        x = [np.sqrt(part.left * part.right) for part in rows.index]
        axis.plot(x, rows["share"], color=colour, label=f"push of {push:g}")
        axis.fill_between(x, rows["low"], rows["high"], color=colour, alpha=0.2, lw=0)
    axis.axvline(1, color="0.3", lw=0.6)
    axis.set(xscale="log", xlim=(0.1, 10), ylim=(-0.02, 1.02))
    axis.set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
    axis.set_xlabel(r"$K_r \gamma n_i^2 / 2 l$, over what the reversal needs")
    axis.set_title("steady direction", fontsize=9)
    axis.legend(frameon=False, fontsize=8)


def print_tables(runs: pd.DataFrame) -> None:
    """Print what the page quotes."""
    print(runs.groupby("pivot")["energy_drift_max"].agg(["count", "max"]))
    print(shares(runs, ["omega_xy0", "n_i", "pivot"])[["share", "low", "high"]])
    steady = runs[runs["n_i"] < 0]
    table = shares(steady, ["omega_xy0", "K_r_target", "n_i", "pivot"])["share"]
    print(table.unstack().round(2).to_string())
    rule = steady[steady["pivot"] > 0]
    bins = pd.cut(rule["ratio"], RATIOS)
    print(shares(rule.assign(bin=bins), ["omega_xy0", "bin"]))
    right = (rule["ratio"] > 1) == rule["reverses"]
    print(
        "rule right", right.groupby([rule["omega_xy0"], rule["n_i"]]).mean().unstack()
    )
    free = runs[(runs["pivot"] == 0) & runs["reverses"]][[*BODY, "t_r"]]
    both = runs[runs["reverses"]].merge(free, on=BODY, suffixes=("", "_free"))
    change = (both["t_r"] / both["t_r_free"]).groupby([both["n_i"], both["pivot"]])
    print("t_r over that without", change.median().unstack().round(3).to_string())
    print(pd.crosstab([runs["n_i"] < 0, runs["pivot"]], runs["type"]))


def main(directory: str, target: str) -> None:
    """Draw the figure and print the tables."""
    mpl.use("Agg")
    plt.rcParams.update({"font.size": 9, "axes.linewidth": 0.6})
    runs = read(directory)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    draw_levers(left, runs[runs["omega_xy0"] == PUSH])
    draw_rule(right, runs)
    figure.savefig(target, dpi=150)
    print_tables(runs)


if __name__ == "__main__":
    main(*sys.argv[1:])
