"""Draw docs/viscous.png, the number of turns under viscous slip, and print its counts.

rattlesweep run configs/viscous.yaml
python docs/figures/viscous.py out/viscous docs/viscous.png
"""

import sys

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from rattlesweep.api import load

# A turn counts from a spin beyond this share of the launch to the other side.
COUNTED = 0.25
COLOURS = "#0072b2", "#e69f00", "#d55e00"


def reflections(run: pd.Series) -> int:
    """Return the turns of a spin that is reflected at n_p and -n_r in turn."""
    n = run["n_i"]
    least = COUNTED * abs(n)
    count = 0
    while n > run["n_p"] or n < -run["n_r"]:
        n = 2 * run["n_p"] - n if n > 0 else -2 * run["n_r"] - n
        if abs(n) < least:
            break
        count += 1
    return count


def draw(runs: pd.DataFrame, target: str) -> None:
    """Draw the turns over the launch in units of the width of lasting spins."""
    figure, axis = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for (k, group), colour in zip(runs.groupby("viscous"), COLOURS, strict=True):
        for done, fill, label in ((True, colour, f"$k$ = {k:g}"), (False, "none", "")):
            part = group[group["done"] == done]
            axis.plot(
                part["ratio"],
                part["n_turns"],
                "o",
                ms=4,
                mec=colour,
                mfc=fill,
                label=label,
            )
    axis.plot([], [], "o", ms=4, mec="0.3", mfc="none", label="spin does not last yet")
    ratio = np.geomspace(1 / (1 - COUNTED), runs["ratio"].max(), 100)
    axis.plot(
        ratio,
        (1 - COUNTED) * ratio,
        color="0.3",
        lw=1,
        label=r"reflections: $\frac{3}{4}\,|n_i| / (n_p + n_r)$",
    )
    axis.set_yscale("symlog", linthresh=1)
    axis.set(
        xscale="log",
        ylim=(-0.3, None),
        xlabel=r"launch $|n_i| / (n_p + n_r)$",
        ylabel="turns beyond a quarter of the launch",
    )
    axis.legend(frameon=False)
    figure.savefig(target, dpi=150)


def main(directory: str, target: str) -> None:
    """Draw the figure from a sweep and print how the rule fares."""
    mpl.rcParams["font.size"] = 9
    runs = load(directory).runs
    print(runs["status"].value_counts().to_string())
    runs = runs[runs["status"] == "ok"].copy()
    runs["ratio"] = runs["n_i"].abs() / (runs["n_p"] + runs["n_r"])
    runs["expected"] = runs.apply(reflections, axis=1)
    end = runs["n_end"]
    runs["done"] = end.between(-runs["n_r"], runs["n_p"])
    off = runs["n_turns"] - runs["expected"]
    print(f"{len(runs)} runs, {runs['done'].sum()} done; turns beyond the rule's: ")
    print(f"at most {off.max()}, of all")
    for k, group in runs[runs["done"]].groupby("viscous"):
        apart = off[group.index]
        print(
            f"k {k:g}: {len(group)} runs, {group['n_turns'].min()} to "
            f"{group['n_turns'].max()} turns, median {group['n_turns'].median():g}; "
            f"equal {(apart == 0).mean():.0%}, at most one apart "
            f"{(apart.abs() <= 1).mean():.0%}, least {apart.min()}"
        )
    draw(runs, target)


if __name__ == "__main__":
    main(*sys.argv[1:])
