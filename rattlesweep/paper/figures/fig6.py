"""Fig. 6: (a) a column a spin, a row an oscillation; (b) examples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rattlesweep.paper.data.fig6 import TYPES
from rattlesweep.paper.figures.style import ABOVE, SPIN, TIME, decade_ticks, frame, launch
from rattlesweep.study.style import BLUE, TYPE_STYLE, new_figure

BONDI = r"$|n_{c1}| < |n_i|$ (Bondi)"
EXAMPLES = {"spin_ss": "(b-1) SS", "spin_sw": "(b-2) SW", "spin_chaotic": "(b-3) SW, chaotic"}


def draw(tables: Mapping[str, pa.Table]) -> Figure:
    """Draw the figure from its data; part (b) if there are tables of spins."""
    data = tables["fractions"].to_pandas()
    spins, sizes = sorted(data["n_i"].unique(), key=abs), sorted(data["omega_xy0"].unique())
    shown = [name for name in EXAMPLES if name in tables]
    height = 1.75 * len(sizes) + 0.7
    figure = new_figure(2.1 * len(spins) + 0.6, height + (2.4 if shown else 0.0))
    upper: Any = figure
    if shown:
        parts: Any = figure.subfigures(2, 1, height_ratios=(height, 2.4))
        upper = parts[0]
        _examples(parts[1], shown, tables)
    axes = upper.subplots(len(sizes), len(spins), sharex=True, sharey=True, squeeze=False)
    for row, size in zip(axes, sizes, strict=True):
        for axis, spin in zip(row, spins, strict=True):
            own = data[(data["n_i"] == spin) & (data["omega_xy0"] == size)]
            _fractions(axis, own.sort_values("K_r"))
        row[0].set_ylabel(launch({"omega_xy0": size}, "omega_xy0") + "\nfraction")
    for axis, spin in zip(axes[0], spins, strict=True):
        frame(axis, launch({"n_i": spin}, "n_i"))
    if shown:
        frame(axes[0, 0], "(a)", loc="left")
    for axis in axes[-1]:
        axis.set_xlabel("$K_r$")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    marks = dict(zip(labels, handles, strict=True))
    # Its line comes first, as it has no bars.
    marks[BONDI] = marks.pop(BONDI)
    upper.legend(marks.values(), marks, ncols=len(marks), **ABOVE)
    return figure


def _fractions(axis: Axes, rows: pd.DataFrame) -> None:
    x = rows["K_r"].to_numpy()
    for name in TYPES:
        mark, share = TYPE_STYLE[name], rows[f"fraction_{name}"].to_numpy()
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


def _examples(figure: Any, names: list[str], tables: Mapping[str, pa.Table]) -> None:
    rows = tables["examples"].to_pylist() if "examples" in tables else []
    runs = {row["example"]: row for row in rows}
    axes = figure.subplots(1, len(names), squeeze=False)[0]
    for axis, name in zip(axes, names, strict=True):
        spin, title = tables[name].to_pandas(), EXAMPLES[name]
        axis.plot(spin["t"], spin["n"], color=BLUE, linewidth=0.7)
        if name in runs:
            title += "\n" + launch(runs[name], "n_i", "omega_xy0", "K_r")
        axis.set_xlabel(TIME)
        axis.locator_params(axis="x", nbins=5)
        frame(axis, title)
        axis.title.set_fontsize(9.5)
    axes[0].set_ylabel(SPIN)
