"""The figure of the trade: cost against error, with energy drift and changes of type."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.study.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    light_grid,
    new_figure,
)
from rattlesweep.study.tradeoff.table import number

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

WIDTH, HEIGHT, DPI = 8.4, 8.0, 150
# A method without an entry takes a spare.
STYLE = {
    "rk4": (VERMILION, "s"),
    "dopri5": (PURPLE, "^"),
    "dop853": (BLUE, "o"),
    "verner98": (GREEN, "D"),
}
SPARE = ((ORANGE, "v"), (SKY, "P"), (GREY, "X"))
# Which points have their setting written beside them, and on which side of the line.
SIDE = {"rk4": (6, 3, "left"), "dopri5": (8, -1, "left"), "dop853": (-4, -11, "right"),
        "verner98": (4, 6, "left")}  # fmt: skip
# What stands alone: plain RK4, and the models without the full dynamics.
SINGLES = {
    "full": ("x", "plain scalar rk4, dt 0.002", "left"),
    "reduced": ("*", "reduced", "right"),
    "gh": ("h", "gh", "right"),
}


def draw(rows: pd.DataFrame, caption: str = "") -> Figure:
    """Draw the figure.

    Parameters
    ----------
    rows : DataFrame
        With the columns of :data:`rattlesweep.study.tradeoff.table.SCHEMA`.
    caption : str
        A line below: which runs, which machine.
    """
    figure = new_figure(WIDTH, HEIGHT)
    grid = figure.add_gridspec(2, 3, height_ratios=(2.4, 1))
    main = figure.add_subplot(grid[0, :])
    tail, drift, flips = (figure.add_subplot(grid[1, k], sharey=main) for k in range(3))
    single = (rows.model != "full") | (rows.method == "plain")
    spare = iter(SPARE * len(rows))
    for method, own in rows[~single].groupby("method", sort=False):
        colour, shape = STYLE.get(str(method)) or next(spare)
        _draw_method(main, own, str(method), colour, shape)
        line: dict[str, Any] = {"color": colour, "marker": shape, "markersize": 4, "linewidth": 1}
        for axes, name in ((tail, "error_p99"), (drift, "energy_drift_median")):
            shown = _positive(own, name)
            axes.plot(shown[name], shown.us_per_unit, **line)
        shown = own[np.isfinite(own.type_flips)]
        flips.plot(100 * shown.type_flips, shown.us_per_unit, **line)
    _draw_singles(main, tail, flips, rows[single])
    for axes in (main, tail, drift):
        if not any(np.size(line.get_xdata()) for line in axes.lines):
            # Nothing to show, which a logarithmic axis does not take.
            axes.plot([1e-9], [0.1], linestyle="none")
        axes.set_xscale("log")
    main.set_yscale("log")
    for axes in (main, tail, drift, flips):
        light_grid(axes)
    for axes in (tail, drift, flips):
        axes.tick_params(labelsize=8)
        axes.minorticks_off()
        axes.set_yticks([1e-2, 1e-1, 1, 10])
    for axes in (drift, flips):
        axes.tick_params(labelleft=False)
    main.set_ylabel("cost: µs for a run and a unit of time, one thread")
    tail.set_ylabel("cost")
    # Rare flips are what matters: linear up to 0.1 %, logarithmic above.
    flips.set_xscale("symlog", linthresh=0.1)
    flips.set_xticks([0, 0.1, 1, 10, 100], ["0", "0.1 %", "1 %", "10 %", "100 %"])
    flips.set_xlim(-0.02, max(2.0, 200 * np.nan_to_num(rows.type_flips, nan=0.005).max()))
    main.set_xlabel("relative error of the time of reversal, median of the runs")
    tail.set_xlabel("the same, 99th percentile", fontsize=9)
    drift.set_xlabel("energy drift, relative, median", fontsize=9)
    flips.set_xlabel("runs whose type changes", fontsize=9)
    if not single.all():
        main.legend(loc="upper right", frameon=False)
    if caption:
        figure.supxlabel(caption, fontsize=7.5, color=GREY)
    return figure


def _positive(rows: pd.DataFrame, name: str) -> pd.DataFrame:
    """Rows that a logarithmic axis can show."""
    shown: pd.DataFrame = rows[np.isfinite(rows[name]) & (rows[name] > 0)]
    return shown


def _draw_method(axes: Any, rows: pd.DataFrame, method: str, colour: str, shape: str) -> None:
    shown = _positive(rows, "error_median")
    axes.plot(shown.error_median, shown.us_per_unit, color=colour, marker=shape, markersize=5.5,
              linewidth=1.8, label=method, zorder=3)  # fmt: skip
    x, y, align = SIDE.get(method, (6, 3, "left"))
    for row in shown.itertuples():
        r: Any = row
        axes.annotate(
            number(r.value) if r.setting == "tol" else f"dt {number(r.value)}",
            (r.error_median, r.us_per_unit),
            xytext=(x, y),
            textcoords="offset points",
            ha=align,
            fontsize=7.5,
            color=colour,
            zorder=4,
        )


def _draw_singles(main: Any, tail: Any, flips: Any, rows: pd.DataFrame) -> None:
    for row in rows.itertuples():
        r: Any = row
        shape, name, align = SINGLES[r.model]
        point: dict[str, Any] = {"color": GREY, "marker": shape, "linestyle": "none"}
        if np.isfinite(r.error_median) and r.error_median > 0:
            main.plot([r.error_median], [r.us_per_unit], **point, markersize=8, zorder=3)
            main.annotate(
                name,
                (r.error_median, r.us_per_unit),
                xytext=(8 if align == "left" else -8, -3),
                textcoords="offset points",
                ha=align,
                fontsize=8,
                color=GREY,
            )
        for axes, value in ((tail, r.error_p99), (flips, 100 * r.type_flips)):
            if np.isfinite(value):
                axes.plot([value], [r.us_per_unit], **point, markersize=6)
