"""Draw the figures of docs/slip.md and print its tables.

rattlesweep run configs/slip.yaml
rattlesweep run configs/slip.yaml --set dissipation={} --output out/slip-rolling
python docs/figures/slip.py out/slip out/slip-rolling docs/slip.png docs/slip_rule.png
"""

import sys

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from rattlesweep.analysis.style import TYPE_STYLE
from rattlesweep.api import load

PARTS = ("R", "SW", "unclassified", "SS")
BODY = ["alpha", "gamma", "xi", "n_i", "omega_xy0"]
HOLDS = np.inf  # mu of a plane that holds any force
NEEDS = (1, 1.1, 1.3, 1.6, 2, 3, 5, 10)  # edges of contact_ratio_max / mu


def wilson(hits: float, runs: float) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a fraction."""
    z = 1.96
    centre = (hits + z * z / 2) / (runs + z * z)
    half = z / (runs + z * z) * np.sqrt(hits * (1 - hits / runs) + z * z / 4)
    return max(0.0, centre - half), min(1.0, centre + half)


def read(sliding: str, rolling: str) -> pd.DataFrame:
    """Return all runs, with the nominal K_r of their case."""
    tables = []
    for directory in (sliding, rolling):
        sweep = load(directory)
        runs = sweep.runs.drop(columns="K_r")
        runs = runs.merge(sweep.summary[["case", "K_r"]], on="case")
        if "mu" not in runs:
            runs["mu"] = HOLDS
            runs["slide_work"] = 0.0
        tables.append(runs)
    return pd.concat(tables, ignore_index=True)


def draw_types(runs: pd.DataFrame, target: str) -> None:
    """Stack the types over mu, one panel per K_r and n_i in the steady direction."""
    runs = runs[runs["n_i"] < 0]
    torques = sorted(runs["K_r"].unique())
    spins = sorted(runs["n_i"].unique(), reverse=True)
    values = sorted(runs["mu"].unique(), reverse=True)
    figure, axes = plt.subplots(
        len(torques),
        len(spins),
        figsize=(9.0, 4.6),
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    for row, torque in zip(axes, torques, strict=True):
        for axis, spin in zip(row, spins, strict=True):
            case = runs[(runs["K_r"] == torque) & (runs["n_i"] == spin)]
            counts = pd.crosstab(case["mu"], case["type"]).reindex(values)
            stack_types(axis, counts.reindex(columns=list(PARTS), fill_value=0))
            axis.set_xticks(range(len(values)), [label_of(mu) for mu in values])
            axis.set(ylim=(0, 1), yticks=[0, 0.5, 1])
            axis.tick_params(length=2, width=0.6)
        row[0].set_ylabel(f"$K_r$ = {torque:g}\nfraction of bodies")
    for axis, spin in zip(axes[0], spins, strict=True):
        axis.set_title(f"$n_i$ = {spin:g}", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel(r"friction $\mu$")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    figure.savefig(target, dpi=150)


def stack_types(axis: Axes, counts: pd.DataFrame) -> None:
    """Draw one bar a row of a table of counts, with the intervals of its borders."""
    places = np.arange(len(counts))
    runs = counts.sum(axis=1).to_numpy()
    below = np.zeros(len(counts))
    for name in PARTS:
        height = counts[name].to_numpy() / runs
        mark = TYPE_STYLE[name]
        axis.bar(
            places, height, bottom=below, width=0.9, color=mark.colour, label=mark.label
        )
        below = below + height
        if name != PARTS[-1]:
            borders = [wilson(b * n, n) for b, n in zip(below, runs, strict=True)]
            lower, upper = np.transpose(borders)
            axis.vlines(places, lower, upper, color="0.2", lw=0.7)


def label_of(mu: float) -> str:
    return r"$\infty$" if mu == HOLDS else f"{mu:g}"


def pairs_of(runs: pd.DataFrame) -> pd.DataFrame:
    """Return runs that reverse with and without sliding, with both reversal times."""
    held = runs[(runs["mu"] == HOLDS) & (runs["type"] == "R")]
    slid = runs[(runs["mu"] != HOLDS) & (runs["type"] == "R")]
    pairs = slid.merge(
        held[[*BODY, "t_r", "contact_ratio_max"]], on=BODY, suffixes=("", "_held")
    )
    pairs["need"] = pairs["contact_ratio_max_held"] / pairs["mu"]
    pairs["change"] = pairs["t_r"] / pairs["t_r_held"]
    return pairs


def draw_rule(pairs: pd.DataFrame, target: str) -> None:
    """Draw the change of the reversal time against the friction that rolling needs."""
    figure, axis = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
    edges = np.geomspace(1, 16, 17)
    for sign, name, colour in (
        (-1, "steady direction", "#0072b2"),
        (1, "unsteady direction", "#d55e00"),
    ):
        side = pairs[np.sign(pairs["n_i"]) == sign]
        groups = side.groupby(pd.cut(side["need"], edges), observed=False)["change"]
        spread = groups.quantile([0.05, 0.25, 0.5, 0.75, 0.95]).unstack()
        spread[groups.size() < 20] = np.nan
        x = np.sqrt(edges[1:] * edges[:-1])
        axis.fill_between(x, spread[0.05], spread[0.95], color=colour, alpha=0.15, lw=0)
        axis.fill_between(x, spread[0.25], spread[0.75], color=colour, alpha=0.3, lw=0)
        axis.plot(x, spread[0.5], color=colour, label=name)
    axis.axhline(1, color="0.3", lw=0.6)
    axis.set(xscale="log", yscale="log", xlim=(1, 16), ylim=(0.6, 9))
    axis.set_xticks([1, 2, 4, 8, 16], ["1", "2", "4", "8", "16"])
    axis.set_yticks([0.7, 1, 1.5, 2, 3, 5, 8], ["0.7", "1", "1.5", "2", "3", "5", "8"])
    axis.minorticks_off()
    axis.set_xlabel(
        r"friction that rolling needs / friction there is (largest ratio / $\mu$)"
    )
    axis.set_ylabel("reversal time, sliding / rolling")
    axis.legend(frameon=False, loc="upper left")
    figure.savefig(target, dpi=150)


def print_tables(runs: pd.DataFrame, pairs: pd.DataFrame) -> None:
    """Print what the page quotes."""
    for name in ("R", "SW"):
        print(f"\nfraction {name} with 95 % intervals")
        for (spin, mu), case in runs.groupby(["n_i", "mu"]):
            hits = int((case["type"] == name).sum())
            low, high = wilson(hits, len(case))
            share = hits / len(case)
            print(f"{spin:5g} {mu:6g} {share:.3f} [{low:.3f}, {high:.3f}]")
    reversing = runs[runs["type"] == "R"]
    groups = reversing.assign(over=reversing["t_r"] / reversing["t_rgh"]).groupby(
        ["n_i", "mu"]
    )
    print("\nmedian t_r / t_rgh\n", groups["over"].median().unstack())
    left = (1 - reversing["slide_work"]).groupby([reversing["n_i"], reversing["mu"]])
    print("\nmedian energy left at the reversal\n", left.median().unstack())
    groups = pairs.groupby(pd.cut(pairs["need"], [0, *NEEDS, np.inf]), observed=False)
    spread = groups["change"].quantile([0.05, 0.5, 0.95]).unstack()
    print("\nchange of t_r by need\n", spread.assign(runs=groups.size()))
    types = runs[runs["mu"] == HOLDS][[*BODY, "type"]]
    both = runs.merge(types, on=BODY, suffixes=("", "_held"))
    print("\n", pd.crosstab([both["mu"], both["type_held"]], both["type"]))


def main(sliding: str, rolling: str, types: str, rule: str) -> None:
    """Draw both figures and print the tables."""
    mpl.use("Agg")
    plt.rcParams.update({"font.size": 9, "axes.linewidth": 0.6})
    runs = read(sliding, rolling)
    pairs = pairs_of(runs)
    draw_types(runs, types)
    draw_rule(pairs, rule)
    print_tables(runs, pairs)


if __name__ == "__main__":
    main(*sys.argv[1:])
