"""Does the plane hold?  Reversals on planes that hold less: figure and tables.

Runs configs/slip.yaml and the same launches without sliding (30,000 runs, minutes), or
reads them if they are there, draws docs/slip.png and prints the numbers of docs/slip.md.

    python benchmarks/slip.py out
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from machine import CONFIGS, ROOT, heading
from matplotlib.figure import Figure
from ruamel.yaml import YAML
from scipy.stats import binomtest

import rattlesweep as rs

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HELD = np.inf  # mu of a plane that holds everything
PLANES = (HELD, 0.5, 0.3, 0.2, 0.1)
EDGES = (1.0, 1.1, 1.3, 1.6, 2.0, 3.0, 5.0, 20.0)
COLUMNS = [
    *("case", "sample", "K_r", "n_i", "omega_xy0", "t_rgh", "t_r", "type"),
    *("contact_ratio_max", "energy_left", "n_slides"),
]


def read_runs(folder: Path) -> pd.DataFrame:
    """Return the runs of all planes, which are integrated where they are missing."""
    config = YAML(typ="safe").load((CONFIGS / "slip.yaml").read_text())
    sliding = rs.sweep(config | {"output": str(folder / "slip")})
    held = {**config, "output": str(folder / "slip-held")}
    del held["dissipation"]
    rolling = rs.sweep(held).read([*COLUMNS[:-2]])
    runs = pd.concat(
        [sliding.read([*COLUMNS, "mu"]), rolling.assign(mu=HELD)], ignore_index=True
    )
    runs["target"] = runs.K_r.round(3)
    return runs


def against_rolling(runs: pd.DataFrame) -> pd.DataFrame:
    """Return sliding runs beside the same launches on a plane that holds everything."""
    launch = ["target", "sample", "n_i", "omega_xy0"]
    held = runs[runs.mu == HELD]
    pairs = runs[runs.mu < HELD].merge(held, on=launch, suffixes=("", "_held"))
    pairs["excess"] = pairs.contact_ratio_max_held / pairs.mu
    pairs["change"] = pairs.t_r / pairs.t_r_held - 1
    pairs["bin"] = pd.cut(pairs.excess, EDGES)
    return pairs


def label(mu: float) -> str:
    """Return the legend of a plane."""
    return "holds everything" if mu == HELD else f"μ = {mu:g}"


def draw_share(axis: Axes, runs: pd.DataFrame, kind: str) -> None:
    """Draw the fraction of a type over the spin, with 95 % Wilson intervals."""
    for mu in PLANES:
        spins = []
        shares = []
        bounds = []
        for n_i, cell in runs[runs.mu == mu].groupby("n_i"):
            count = int((cell.type == kind).sum())
            interval = binomtest(count, len(cell)).proportion_ci(0.95, "wilson")
            share = count / len(cell)
            spins.append(n_i)
            shares.append(share)
            bounds.append((share - interval.low, interval.high - share))
        axis.errorbar(
            spins,
            shares,
            np.abs(bounds).T,
            marker="o",
            ms=3,
            capsize=2,
            label=label(mu),
        )
    axis.set_xlabel("spin $n_i$ (√(g/a))")
    axis.set_ylabel(f"fraction {kind}")


def draw(runs: pd.DataFrame, pairs: pd.DataFrame) -> Figure:
    """Draw fractions, reversal times and the change against rolling."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    pushed = runs[runs.omega_xy0 == 0.1]
    draw_share(axes[0], pushed[pushed.n_i < 0], "SW")
    axes[0].set_title("Steady direction: runs that wobble")
    for mu in PLANES:
        reversing = pushed[(pushed.mu == mu) & (pushed.type == "R")]
        ratio = (reversing.t_r / reversing.t_rgh).groupby(reversing.n_i).median()
        axes[1].plot(ratio.index, ratio, marker="o", ms=3, label=label(mu))
    axes[1].set_title("Median reversal time")
    axes[1].set_xlabel("spin $n_i$ (√(g/a))")
    axes[1].set_ylabel("$t_r / t_{rGH}$")
    axes[1].legend(fontsize=8)
    change = pairs.groupby("bin", observed=True).change.quantile([0.05, 0.5, 0.95])
    change = 100 * change.unstack()
    middle = [np.sqrt(bin.left * bin.right) for bin in change.index]
    axes[2].fill_between(middle, change[0.05], change[0.95], alpha=0.2)
    axes[2].plot(middle, change[0.5], marker="o", ms=3)
    axes[2].axhline(0, color="0.4", lw=0.8)
    axes[2].set_xscale("log")
    axes[2].set_xticks([1, 2, 3, 5, 10], ["1", "2", "3", "5", "10"])
    axes[2].set_yscale("symlog", linthresh=10)
    axes[2].set_title("What rolling gets wrong")
    axes[2].set_xlabel("largest friction that rolling needs, over μ")
    axes[2].set_ylabel("change of $t_r$ (%), median, 5 to 95 %")
    return figure


def report(runs: pd.DataFrame, pairs: pd.DataFrame) -> None:
    """Print the numbers of docs/slip.md."""
    shares = runs.groupby(["n_i", "omega_xy0", "mu"]).type.value_counts(normalize=True)
    print(shares.unstack(fill_value=0).round(3).to_string())
    quantiles = [0.05, 0.5, 0.95]
    change = pairs.groupby("bin", observed=True).change
    print(change.describe(percentiles=quantiles).round(4).to_string())
    slid = pairs[pairs.n_slides > 0]
    print(
        slid.groupby("mu").change.describe(percentiles=quantiles).round(3).to_string()
    )
    reversed_runs = slid[slid.type == "R"]
    left = reversed_runs.groupby("mu").energy_left
    print(left.describe(percentiles=quantiles).round(3).to_string())
    print((pairs.n_slides > 0).groupby(pairs.mu).mean().round(3).to_string())
    fast = pairs[(pairs.n_i <= -0.3) & (pairs.type_held == "SW")]
    print(fast.groupby("mu").type.value_counts(normalize=True).round(3).to_string())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the two sweeps")
    runs = read_runs(parser.parse_args().folder)
    pairs = against_rolling(runs)
    print(heading("matplotlib"))
    report(runs, pairs)
    draw(runs, pairs).savefig(ROOT / "docs" / "slip.png", dpi=110)
