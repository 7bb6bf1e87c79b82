"""Fig. 3: cumulative distributions of K_p and K_r, and their density in the plane."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rattlesweep.paper.data.fig3 import DECADES, counts_of, grid_of
from rattlesweep.paper.figures.style import frame
from rattlesweep.study.style import BLUE, VERMILION, new_figure


def draw(tables: Mapping[str, pa.Table]) -> Figure:
    """Draw the figure from its data."""
    figure = new_figure(4.6, 7.2)
    upper, lower = figure.subplots(2, 1, height_ratios=(1, 1.25))
    data, grid = tables["cumulative"].to_pandas(), grid_of(tables)
    _cumulative(upper, data, (grid.K_r[0], grid.K_p[1]))
    upper.set(xlabel="$K_p$,  $K_r$", ylabel="cumulative distribution")
    upper.legend(frameon=False, loc="upper right", bbox_to_anchor=(1, 0.93), ncols=2)
    # K_r is steep on the axis of K_p: the same again over decades.
    inset = upper.inset_axes((0.47, 0.18, 0.5, 0.52))
    inset.set_xscale("log")
    _cumulative(inset, data, (1e-4, 10.0))
    inset.tick_params(labelsize=7.5)
    inset.minorticks_off()

    counts = counts_of(tables)
    shown = np.full(counts.shape, np.nan)
    total = tables["summary"]["density_samples"][0].as_py()
    np.log10(counts / total, where=counts > 0, out=shown)
    picture = lower.pcolormesh(
        grid.edges("K_p"), grid.edges("K_r"), shown.T, cmap=colormaps["viridis"],
        vmin=-DECADES, vmax=0, rasterized=True,
    )  # fmt: skip
    lower.set(xlabel="$K_p$", ylabel="$K_r$")
    bar = figure.colorbar(picture, ax=lower, ticks=range(-DECADES, 1), pad=0.02)
    bar.set_label(r"$\log_{10} P(K_p, K_r)$")
    frame(lower)
    for axes, letter in ((upper, "(a)"), (lower, "(b)")):
        axes.set_title(letter, loc="left", fontsize=11)
    return figure


def _cumulative(axes: Axes, data: pd.DataFrame, ends: tuple[float, float]) -> None:
    for name, colour, style in (("K_p", BLUE, "-"), ("K_r", VERMILION, (0, (5, 1.5)))):
        axes.plot(data[name], data["probability"], color=colour, linestyle=style,
                  linewidth=1.8, label=f"${name}$")  # fmt: skip
    axes.set(xlim=ends, ylim=(0, 1.03))
    frame(axes)
