"""The figure of the trade: cost against error, with energy drift and changes of type."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.study.style import (
    BLUE,
    FAINT,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    new_figure,
)
from rattlesweep.study.tradeoff.table import Row, number

if TYPE_CHECKING:
    from collections.abc import Sequence

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


def _style(method: str, methods: list[str]) -> tuple[str, str]:
    if method in STYLE:
        return STYLE[method]
    others = [name for name in methods if name not in STYLE]
    return SPARE[others.index(method) % len(SPARE)]


def _finite(rows: Sequence[Row], name: str) -> list[Row]:
    return [row for row in rows if math.isfinite(v := getattr(row, name)) and v > 0]


def draw(rows: Sequence[Row], caption: str = "") -> Any:
    """Draw the figure.

    Parameters
    ----------
    rows : sequence of Row
    caption : str
        A line below: which runs, which machine.
    """
    figure = new_figure(WIDTH, HEIGHT)
    grid = figure.add_gridspec(2, 3, height_ratios=(2.4, 1))
    main = figure.add_subplot(grid[0, :])
    tail, drift, flips = (figure.add_subplot(grid[1, k], sharey=main) for k in range(3))
    methods = list(
        dict.fromkeys(r.method for r in rows if r.model == "full" and r.method != "plain")
    )
    for method in methods:
        colour, shape = _style(method, methods)
        own = [row for row in rows if row.model == "full" and row.method == method]
        _curve(main, own, method, colour, shape)
        line: dict[str, Any] = {"color": colour, "marker": shape, "markersize": 4, "linewidth": 1}
        for axes, name in ((tail, "error_p99"), (drift, "energy_drift_median")):
            shown = _finite(own, name)
            axes.plot([getattr(r, name) for r in shown], [r.us_per_unit for r in shown], **line)
        shown = [row for row in own if math.isfinite(row.type_flips)]
        flips.plot([100 * r.type_flips for r in shown], [r.us_per_unit for r in shown], **line)
    _singles(main, tail, flips, rows)
    for axes in (main, tail, drift):
        if not any(np.size(line.get_xdata()) for line in axes.lines):
            # Nothing to show, which a logarithmic axis does not take.
            axes.plot([1e-9], [0.1], linestyle="none")
        axes.set_xscale("log")
    main.set_yscale("log")
    for axes in (main, tail, drift, flips):
        axes.grid(visible=True, color=FAINT, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
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
    most = max((100 * r.type_flips for r in rows if math.isfinite(r.type_flips)), default=1.0)
    flips.set_xlim(-0.02, max(2.0, 2 * most))
    main.set_xlabel("relative error of the time of reversal, median of the runs")
    tail.set_xlabel("the same, 99th percentile", fontsize=9)
    drift.set_xlabel("energy drift, relative, median", fontsize=9)
    flips.set_xlabel("runs whose type changes", fontsize=9)
    if methods:
        main.legend(loc="upper right", frameon=False)
    if caption:
        figure.supxlabel(caption, fontsize=7.5, color=GREY)
    return figure


def _curve(axes: Any, rows: list[Row], method: str, colour: str, shape: str) -> None:
    shown = _finite(rows, "error_median")
    axes.plot(
        [row.error_median for row in shown],
        [row.us_per_unit for row in shown],
        color=colour,
        marker=shape,
        markersize=5.5,
        linewidth=1.8,
        label=method,
        zorder=3,
    )
    x, y, align = SIDE.get(method, (6, 3, "left"))
    for row in shown:
        axes.annotate(
            number(row.value) if row.setting == "tol" else f"dt {number(row.value)}",
            (row.error_median, row.us_per_unit),
            xytext=(x, y),
            textcoords="offset points",
            ha=align,
            fontsize=7.5,
            color=colour,
            zorder=4,
        )


def _singles(main: Any, tail: Any, flips: Any, rows: Sequence[Row]) -> None:
    """Single markers: plain RK4 and the models without the full dynamics."""
    for row in rows:
        if row.model == "full" and row.method != "plain":
            continue
        shape = {"full": "x", "reduced": "*", "gh": "h"}[row.model]
        name = "plain scalar rk4, dt 0.002" if row.model == "full" else row.model
        if math.isfinite(row.error_median) and row.error_median > 0:
            main.plot([row.error_median], [row.us_per_unit], color=GREY, marker=shape,
                      markersize=8, linestyle="none", zorder=3)  # fmt: skip
            right = row.model == "full"
            main.annotate(
                name,
                (row.error_median, row.us_per_unit),
                xytext=(8 if right else -8, -3),
                textcoords="offset points",
                ha="left" if right else "right",
                fontsize=8,
                color=GREY,
            )
        for axes, value in ((tail, row.error_p99), (flips, 100 * row.type_flips)):
            if math.isfinite(value):
                axes.plot([value], [row.us_per_unit], color=GREY, marker=shape, markersize=6,
                          linestyle="none")  # fmt: skip
