"""Figs. 5 and 7: times of reversal, one panel a spin, three oscillations each, and the theory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rattlesweep.paper.figures.style import ABOVE, SPIN, TIME, ZERO, decade_ticks, frame, launch
from rattlesweep.study.style import BLUE, SERIES, new_figure

COLUMNS = 3


def fig5(tables: Mapping[str, pa.Table]) -> Figure:
    """Draw Fig. 5 from its data; part (b) if there is a table ``spin``."""
    if "spin" not in tables:
        return _panels(tables["times"], "K_p", "t_{ru}", "t_{rGH+}")[0]
    figure, first, spare = _panels(tables["times"], "K_p", "t_{ru}", "t_{rGH+}", above=True)
    frame(first, "(a)", loc="left")
    spin, axis = tables["spin"].to_pandas(), spare[0]
    axis.axis("on")
    axis.plot(spin["t"], spin["n"], color=BLUE, linewidth=0.8)
    axis.axhline(0, **ZERO)
    axis.set(xlabel=TIME, ylabel=SPIN)
    frame(axis, "(b) GH, " + launch({"n_i": spin["n"].iloc[0]}, "n_i"))
    return figure


def fig7(tables: Mapping[str, pa.Table]) -> Figure:
    """Draw Fig. 7 from its data."""
    return _panels(tables["times"], "K_r", "t_{rs}", "t_{rGH-}")[0]


def _panels(
    table: pa.Table, coefficient: str, time: str, theory: str, *, above: bool = False
) -> tuple[Figure, Axes, list[Axes]]:
    """The panels: the figure, the first of them, and the axes that are left over, switched off.

    Parameters
    ----------
    table : pyarrow.Table
        Of :func:`rattlesweep.paper.data.fig5.times`.
    coefficient : str
        ``K_p`` or ``K_r``.
    time, theory : str
        Symbols of the time and of the theory's, as mathematics.
    above : bool
        Whether the legend stands above all panels, and not in the last of those left over.
    """
    data = table.to_pandas()
    spins = sorted(data["n_i"].unique(), key=abs)
    rows = -(-(len(spins) + 1) // COLUMNS)
    figure = new_figure(9.2, 2.9 * rows + 0.35)
    axes = list(figure.subplots(rows, COLUMNS, squeeze=False).ravel())
    means = data[["t_r_mean", "t_rgh_line"]].to_numpy()
    ends = (0.1, 1.0) if np.isnan(means).all() else (np.nanmin(means) / 2.5, np.nanmax(means) * 2.5)
    for axis, spin in zip(axes, spins, strict=False):
        own = data[data["n_i"] == spin]
        _points(axis, own, coefficient)
        axis.set(xscale="log", yscale="log", ylim=ends, xlabel=f"${coefficient}$")
        axis.set_xlim(data[coefficient].min() / 1.35, data[coefficient].max() * 1.35)
        decade_ticks(axis.xaxis)
        frame(axis, launch({"n_i": spin}, "n_i"), grid="both")
    for place in range(0, len(spins), COLUMNS):
        axes[place].set_ylabel(rf"${time}$ / $\tilde t$")
    handles, labels = axes[0].get_legend_handles_labels()
    marks = dict(zip(labels, handles, strict=True))
    # The theory's line comes first, as it has no bars.
    marks[rf"${theory}$ at the mean $n_0$"] = marks.pop("theory")
    spare = axes[len(spins) :]
    for axis in spare:
        axis.axis("off")
    if above:
        figure.legend(marks.values(), marks, ncols=len(marks), **ABOVE)
    else:
        spare[-1].legend(marks.values(), marks, loc="center", frameon=False, labelspacing=0.9)
    return figure, axes[0], spare


def _points(axis: Axes, rows: pd.DataFrame, coefficient: str) -> None:
    bars: dict[str, Any] = {"markersize": 5, "markerfacecolor": "white", "markeredgewidth": 1.2,
                            "linestyle": "none", "elinewidth": 0.9, "capsize": 2.2}  # fmt: skip
    for size, (colour, marker) in zip(sorted(rows["omega_xy0"].unique()), SERIES, strict=False):
        own = rows[rows["omega_xy0"] == size].sort_values(coefficient)
        x, mean, std = (own[name].to_numpy() for name in (coefficient, "t_r_mean", "t_r_std"))
        axis.plot(x, own["t_rgh_line"], color=colour, linewidth=1.1, zorder=2)
        # On a logarithmic axis a bar that reaches zero has no lower end.
        down = np.minimum(std, 0.999 * mean)
        axis.errorbar(x, mean, yerr=[down, std], color=colour, marker=marker, zorder=3,
                      label=launch({"omega_xy0": size}, "omega_xy0"), **bars)  # fmt: skip
    axis.plot([], [], color="#555555", linewidth=1.1, label="theory")
