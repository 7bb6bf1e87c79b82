"""Draw the picture in the README: what random rattlebacks do when spun in the steady
direction.

rattlesweep run configs/steady.yaml
python docs/figures/steady.py out/steady docs/steady.png
"""

import sys
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

from rattlesweep.analysis.style import TYPE_STYLE
from rattlesweep.api import load

PARTS = {name: TYPE_STYLE[name] for name in ("R", "SW", "unclassified", "SS")}


def main(directory: str, target: str) -> None:
    """Draw fractions of the types against K_r, one panel per n_i and omega_xy0."""
    mpl.use("Agg")
    plt.rcParams.update({"font.size": 9, "axes.linewidth": 0.6})
    summary = load(directory).summary
    spins = sorted(summary["n_i"].unique(), reverse=True)
    sizes = sorted(summary["omega_xy0"].unique())
    figure, axes = plt.subplots(
        len(sizes),
        len(spins),
        figsize=(9.0, 4.9),
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    for row, size in zip(axes, sizes, strict=True):
        for axis, spin in zip(row, spins, strict=True):
            case = summary[(summary["n_i"] == spin) & (summary["omega_xy0"] == size)]
            case = case.sort_values("K_r")
            axis.stackplot(
                case["K_r"],
                [case[f"fraction_{name}"] for name in PARTS],
                colors=[mark.colour for mark in PARTS.values()],
                labels=[mark.label for mark in PARTS.values()],
            )
            axis.plot(
                case["K_r"],
                1 - case["fraction_bondi"],
                "k^",
                ms=3.5,
                label="Bondi's threshold",
            )
            axis.set(xscale="log", xlim=(0.0041, 0.1), ylim=(0, 1), yticks=[0, 0.5, 1])
            axis.set_xticks([0.01, 0.1], ["0.01", "0.1"])
            axis.tick_params(which="both", length=2, width=0.6)
        row[0].set_ylabel(f"$|\\omega_{{xy0}}|$ = {size:g}\nfraction of bodies")
    for axis, spin in zip(axes[0], spins, strict=True):
        axis.set_title(f"$n_i$ = {spin:g}", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("$K_r$")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, frameon=False)
    figure.savefig(Path(target), dpi=150)


if __name__ == "__main__":
    main(*sys.argv[1:])
