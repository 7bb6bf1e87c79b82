"""Figs. 6 and 8: times of reversal in the unsteady and in the steady direction.

Late reversals and onsets of wobbling, of which the paper speaks at Fig. 8, are seen in windows of
time: the runs that do not reverse (type SW) and those that reverse late are integrated once more
with the smallest and the largest spin of each of 64 windows recorded.

The onset of wobbling is the middle of the first window in which the loss of spin, 1 - n/n_i,
exceeds half of the largest loss in the run.  A reversal is a loss of 1, of which half is lost at
nearly the same time as all of it, so that the onset and the time of reversal are alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rattlesweep.analysis.style import BLUE, SERIES, new_figure
from rattlesweep.api import growth_rates
from rattlesweep.arrays import Floats
from rattlesweep.paper.frames import (
    ABOVE,
    N_AXIS,
    T_AXIS,
    ZERO,
    decade_ticks,
    follow,
    frame,
    launch,
)
from rattlesweep.paper.workspace import Tables, Workspace, evenly
from rattlesweep.physics.body import Rattleback
from rattlesweep.sweeps.types import Z95

# The run of Fig. 6(b); its length is not named in the paper.
N_I, OMEGA_XY0, T_END = 0.5, 0.01, 150.0
# "Several times" t_rGH: a reversal later than this many is late.
LATE_FROM = 2.0
# The spin has left its plateau when it has lost this much of itself.
PLATEAU = 0.1
# Panels beside each other.
COLUMNS = 3


def unsteady(ws: Workspace) -> Tables:
    """Return the tables ``times`` of Fig. 6(a) and ``spin`` of (b)."""
    found = follow(Rattleback.gh(), "n", "omega_x", n_i=N_I, omega_xy0=OMEGA_XY0, t_end=T_END)
    return {"times": times(ws.sweep("unsteady"), "K_p"), "spin": found.table}


def steady(ws: Workspace) -> Tables:
    """Return the tables ``times`` of Fig. 8, ``late`` and ``onset``, one row a point each."""
    runs = ws.sweep("steady")
    bodies = runs[["alpha", "beta", "gamma", "theta", "phi", "xi"]]
    roll = growth_rates(bodies, runs["n_i"].to_numpy(), exact=True).roll
    back = runs["type"] == "R"
    ratio = (runs["t_r"] / runs["t_rgh"]).where(back)
    late = ratio > LATE_FROM
    chosen = evenly(runs[(runs["type"] == "SW") | late], ws.sizes.windows)
    seen = in_windows(ws.again(chosen, record=["windows"])).reindex(runs.index)
    growth = roll / (runs["n_i"].abs() * runs["K_r_body"] / 2)
    share = (seen["centre"] / runs["n_i"]).where(~back)
    runs = runs.assign(
        late=late, back=runs["t_r"].where(back), ratio=ratio, ratio_prompt=ratio.where(~late),
        growth_late=growth.where(late), growth_prompt=growth.where(back & ~late),
        plateau=seen["kept"] / runs["t_r"].where(back), onset=seen["onset"].where(~back),
        onset_late=~back & (seen["onset"] > LATE_FROM * runs["t_rgh"]),
        centre=share, centre_between=share.between(0, 1, inclusive="neither"),
    )  # fmt: skip
    points = runs.groupby("case")
    place = {name: (name, "first") for name in ("K_r", "n_i", "omega_xy0")}
    return {
        "times": times(ws.sweep("steady"), "K_r"),
        "late": points.agg(
            **place, reversed=("back", "count"), late=("late", "sum"), ratio_std=("ratio", "std"),
            ratio_std_prompt=("ratio_prompt", "std"), growth_late=("growth_late", "median"),
            growth_prompt=("growth_prompt", "median"), followed=("plateau", "count"),
            plateau=("plateau", "median"),
        ),
        "onset": points.agg(
            **place, wobbling=("onset", "count"), onset_median=("onset", "median"),
            onset_late=("onset_late", "sum"), reversed=("back", "count"),
            t_r_median=("back", "median"), centre_between=("centre_between", "sum"),
            centre_median=("centre", "median"), centre_low=("centre", "min"),
            centre_high=("centre", "max"),
        ),
    }  # fmt: skip


def times(runs: pd.DataFrame, target: str) -> pd.DataFrame:
    """Return one row a point: the runs that reverse, and the theory's line at the mean ``n_0``."""
    rows = runs.assign(back=runs["t_r"].where(runs["type"] == "R")).groupby("case").agg(
        **{name: (name, "first") for name in (target, "n_i", "omega_xy0")},
        runs=("n_0", "size"), reversed=("back", "count"), t_r_mean=("back", "mean"),
        t_r_std=("back", "std"), t_r_sem=("back", "sem"), n_0_mean=("n_0", "mean"),
    )  # fmt: skip
    n_0 = rows["n_0_mean"]
    return rows.assign(
        t_r_low=rows["t_r_mean"] - Z95 * rows["t_r_sem"],
        t_r_high=rows["t_r_mean"] + Z95 * rows["t_r_sem"],
        t_rgh_line=2 * np.arctanh(rows["n_i"].abs() / n_0) / (n_0 * rows[target]),
    )


def in_windows(runs: pd.DataFrame) -> pd.DataFrame:
    """Return what the windows of runs show, NaN where it does not happen."""
    found = pd.DataFrame(np.nan, index=runs.index, columns=["onset", "kept", "centre"])
    names = ["n_i", "window_t", "window_n_min", "window_n_max"]
    for place, n_i, step, least, most in runs.reindex(columns=names).dropna().itertuples():
        # The end nearer to zero, or beyond it.
        loss = 1 - (most if n_i < 0 else least) / n_i
        half = loss.max() / 2
        kept = first_above(loss, PLATEAU, step)
        found.loc[place] = (
            first_above(loss, half, step),
            # So abrupt that the run was over before the window was: kept to its beginning.
            len(loss) * step if np.isnan(kept) else kept,
            ((least + most) / 2)[np.argmax(loss > half) :].mean(),
        )
    return found


def first_above(loss: Floats, level: float, step: float) -> float:
    """Return the middle of the first window whose loss is above a level; NaN without one."""
    above = np.flatnonzero(loss > level)
    return (float(above[0]) + 0.5) * step if above.size else np.nan


def draw_unsteady(tables: Tables) -> Figure:
    """Draw a panel for each spin, and Fig. 6(b) in the place that is left."""
    figure, axes, marks = panels(tables["times"], "K_p", "t_{ru}", "t_{rGH+}")
    figure.legend(marks.values(), marks, ncols=len(marks), **ABOVE)
    frame(axes[0], "(a)", loc="left")
    spin, axis = tables["spin"], axes[-1]
    axis.axis("on")
    axis.plot(spin["t"], spin["n"], color=BLUE, linewidth=0.8)
    axis.axhline(0, **ZERO)
    axis.set(xlabel=T_AXIS, ylabel=N_AXIS)
    frame(axis, "(b) GH, " + launch({"n_i": spin["n"].iloc[0]}, "n_i"))
    return figure


def draw_steady(tables: Tables) -> Figure:
    """Draw a panel for each spin, and the legend in the place that is left."""
    figure, axes, marks = panels(tables["times"], "K_r", "t_{rs}", "t_{rGH-}")
    axes[-1].legend(marks.values(), marks, loc="center", frameon=False, labelspacing=0.9)
    return figure


def panels(
    values: pd.DataFrame, coefficient: str, time: str, theory: str
) -> tuple[Figure, list[Axes], dict[str, Any]]:
    """Draw a panel for each spin from the table of :func:`times`."""
    spins = sorted(values["n_i"].unique(), key=abs)
    rows = -(-(len(spins) + 1) // COLUMNS)
    figure = new_figure(9.2, 2.9 * rows + 0.35)
    axes = list(figure.subplots(rows, COLUMNS, squeeze=False).ravel())
    means = values[["t_r_mean", "t_rgh_line"]].to_numpy()
    ends = (np.nanmin(means) / 2.5, np.nanmax(means) * 2.5)
    for axis, spin in zip(axes, spins, strict=False):
        draw_points(axis, values[values["n_i"] == spin], coefficient)
        axis.set(xscale="log", yscale="log", ylim=ends, xlabel=f"${coefficient}$")
        axis.set_xlim(values[coefficient].min() / 1.35, values[coefficient].max() * 1.35)
        decade_ticks(axis.xaxis)
        frame(axis, launch({"n_i": spin}, "n_i"), grid="both")
    for place in range(0, len(spins), COLUMNS):
        axes[place].set_ylabel(rf"${time}$ / $\tilde t$")
    handles, labels = axes[0].get_legend_handles_labels()
    marks = dict(zip(labels, handles, strict=True))
    # The theory's line comes first, as it has no bars.
    marks[rf"${theory}$ at the mean $n_0$"] = marks.pop("theory")
    for axis in axes[len(spins) :]:
        axis.axis("off")
    return figure, axes, marks


def draw_points(axis: Axes, rows: pd.DataFrame, coefficient: str) -> None:
    """Draw means with their deviations and the theory's line, one series an oscillation."""
    for size, (colour, marker) in zip(sorted(rows["omega_xy0"].unique()), SERIES, strict=False):
        own = rows[rows["omega_xy0"] == size].sort_values(coefficient)
        x, mean, std = (own[name].to_numpy() for name in (coefficient, "t_r_mean", "t_r_std"))
        axis.plot(x, own["t_rgh_line"], color=colour, linewidth=1.1, zorder=2)
        # On a logarithmic axis a bar that reaches zero has no lower end.
        axis.errorbar(
            x, mean, yerr=[np.minimum(std, 0.999 * mean), std], color=colour, marker=marker,
            markersize=5, markerfacecolor="white", markeredgewidth=1.2, linestyle="none",
            elinewidth=0.9, capsize=2.2, zorder=3, label=launch({"omega_xy0": size}, "omega_xy0"),
        )  # fmt: skip
    axis.plot([], [], color="#555555", linewidth=1.1, label="theory")
