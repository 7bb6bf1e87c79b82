"""The figure of the trade: cost against error, with energy drift and changes of type."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from rattlesweep.analysis import style
from rattlesweep.analysis.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION
from rattlesweep.analysis.tradeoff.measure import Study
from rattlesweep.analysis.tradeoff.table import SCHEMA, number
from rattlesweep.sweeps.files import probe_directory, replace_file
from rattlesweep.sweeps.provenance import machine, package_version
from rattlesweep.sweeps import arrow

WIDTH, HEIGHT, DPI = 8.4, 8.0, 150
# Colour, shape, and where beside its points a method's settings are written.
STYLE: dict[str, tuple[str, str, tuple[int, int, str]]] = {
    "rk4": (VERMILION, "s", (6, 3, "left")),
    "dopri5": (PURPLE, "^", (8, -1, "left")),
    "dop853": (BLUE, "o", (-4, -11, "right")),
    "verner98": (GREEN, "D", (4, 6, "left")),
    # What stands alone: plain RK4, models without the full dynamics, an error that is asked for.
    "plain": (GREY, "x", (8, -3, "left")),
    "reduced": (GREY, "*", (-8, -3, "right")),
    "gh": (GREY, "h", (-8, -3, "right")),
    "accuracy": (GREY, "p", (8, 6, "left")),
}
# Of a method without an entry.
SPARE = tuple((*look, (6, 3, "left")) for look in ((ORANGE, "v"), (SKY, "P"), (GREY, "X")))
# What is written beside those that stand alone; they have no place in the panel of the drift.
SINGLES = {"plain": "plain scalar rk4, dt 0.002", "reduced": "reduced", "gh": "gh",
           "accuracy": "accuracy {t_r: 1e-6}"}  # fmt: skip
# Abscissas of the panels, the large one first; all but the last are logarithmic.
LABELS = {
    "error_median": "relative error of the time of reversal, median of the runs",
    "error_p99": "the same, 99th percentile",
    "energy_drift_median": "energy drift, relative, median",
    "type_flips": "runs whose type changes",
}


def save(study: Study, directory: Path) -> list[Path]:
    """Write ``tradeoff.parquet``, ``.svg`` and ``.png``, each in one step; gives their paths."""
    probe_directory(directory)
    table, *pictures = (directory / f"tradeoff.{kind}" for kind in ("parquet", "svg", "png"))
    columns = {name: study.rows[name].to_numpy() for name in SCHEMA.names}
    replace_file(table, arrow.encode(arrow.build_table(columns, SCHEMA)))
    caption = (
        f"{study.facts['runs']} runs of {study.name}, {study.facts['compared']} with a sure "
        f"reversal; {machine()['cpu']}, rattlesweep {package_version()}"
    )
    with style.styled():
        style.save(draw(study.rows, caption), pictures, DPI)
    return [table, *pictures]


def draw(rows: pd.DataFrame, caption: str = "") -> Figure:
    """Draw rows with the columns of `SCHEMA`; the caption says which runs, which machine."""
    figure = style.new_figure(WIDTH, HEIGHT)
    grid = figure.add_gridspec(2, 3, height_ratios=(2.4, 1))
    main = figure.add_subplot(grid[0, :])
    small = [figure.add_subplot(grid[1, k], sharey=main) for k in range(3)]
    panels: dict[str, Any] = dict(zip(LABELS, (main, *small), strict=True))
    rows = rows.assign(type_flips=100 * rows.type_flips)
    flips = np.nan_to_num(rows.type_flips, nan=0.5).max()
    for name in [*LABELS][:-1]:
        # What a logarithmic axis can show.
        rows[name] = rows[name].where(np.isfinite(rows[name]) & (rows[name] > 0))
    alone = np.where(rows.setting == "accuracy", "accuracy", rows.model)
    named = rows.method.where(alone == "full", alone)
    spare = iter(SPARE * len(rows))
    for series, own in rows.groupby(named, sort=False):
        colour, marker, (x, y, side) = STYLE.get(str(series)) or next(spare)
        word = SINGLES.get(str(series))
        for name, axes in panels.items():
            if word and name == "energy_drift_median":
                continue
            large = axes is main
            look: dict[str, Any] = (
                {"markersize": 8 if large else 6, "linestyle": "none"} if word else
                {"markersize": 5.5 if large else 4, "linewidth": 1.8 if large else 1,
                 "label": series}
            )  # fmt: skip
            shown = own[np.isfinite(own[name])]
            axes.plot(shown[name], shown.us_per_unit, color=colour, marker=marker, zorder=3, **look)
        for row in own[np.isfinite(own.error_median)].itertuples():
            value = f"{'' if row.setting == 'tol' else 'dt '}{number(row.value)}"
            main.annotate(word or value, (row.error_median, row.us_per_unit), xytext=(x, y),
                          textcoords="offset points", ha=side, zorder=4, color=colour,
                          fontsize=8 if word else 7.5)  # fmt: skip
    for axes in (main, *small[:2]):
        if not any(np.isfinite(line.get_xdata()).any() for line in axes.lines):
            # Nothing to show, which a logarithmic axis does not take.
            axes.plot([1e-9], [0.1], linestyle="none")
        axes.set_xscale("log")
    main.set_yscale("log")
    for name, axes in panels.items():
        style.light_grid(axes)
        axes.set_xlabel(LABELS[name], fontsize=None if axes is main else 9)
    for axes in small:
        axes.tick_params(labelsize=8, labelleft=axes is small[0])
        axes.minorticks_off()
        axes.set_yticks([1e-2, 1e-1, 1, 10])
    main.set_ylabel("cost: µs for a run and a unit of time, one thread")
    small[0].set_ylabel("cost")
    # Rare flips are what matters: linear up to 0.1 %, logarithmic above.
    small[2].set_xscale("symlog", linthresh=0.1)
    small[2].set_xticks([0, 0.1, 1, 10, 100], ["0", "0.1 %", "1 %", "10 %", "100 %"])
    small[2].set_xlim(-0.02, max(2.0, 2 * flips))
    if main.get_legend_handles_labels()[1]:
        main.legend(loc="upper right", frameon=False)
    if caption:
        figure.supxlabel(caption, fontsize=7.5, color=GREY)
    return figure
