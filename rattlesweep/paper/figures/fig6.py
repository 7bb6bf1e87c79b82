"""Fig. 6: times of reversal in the unsteady direction, as Fig. 8 has them in the other; a run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from rattlesweep.analysis.style import BLUE, SERIES, new_figure
from rattlesweep.paper.figures.frames import (
    ABOVE,
    N_AXIS,
    T_AXIS,
    ZERO,
    decade_ticks,
    frame,
    launch,
)
from rattlesweep.paper.figures.single import FORCES, follow, forces
from rattlesweep.paper.workspace import Tables, Workspace
from rattlesweep.physics.body import Rattleback
from rattlesweep.sweeps.counts import Z95

# The run of (b); its length is not named in the paper.
N_I, OMEGA_XY0, T_END = 0.5, 0.01, 150.0
# Panels beside each other.
COLUMNS = 3


def data(ws: Workspace) -> Tables:
    """Return the tables ``times`` of part (a), ``spin`` and ``forces`` of part (b)."""
    found = follow(Rattleback.gh(), f"GH at n_i = {N_I:g}", "n", "omega_x", *FORCES,
                   n_i=N_I, omega_xy0=OMEGA_XY0, t_end=T_END)  # fmt: skip
    return {
        "times": times(ws.sweep("unsteady"), "K_p"),
        "spin": found.table[["t", "n", "omega_x"]],
        "forces": pd.DataFrame([forces(f"Fig. 6(b), n_i = {N_I:g}", found.table)]),
    }


def times(runs: pd.DataFrame, target: str) -> pd.DataFrame:
    """Return one row a point: the runs that reverse, and the theory's line at the mean ``n_0``.

    The spread of one run and the mean of none are NaN.
    """
    rows = []
    for _, own in runs.groupby("case"):
        back = own[own["type"] == "R"]
        t_r, n_0, point = back["t_r"], own["n_0"].mean(), own.iloc[0]
        mean, half = t_r.mean(), Z95 * t_r.std() / np.sqrt(max(len(back), 1))
        rows.append(
            {name: point[name] for name in (target, "n_i", "omega_xy0")}
            | {"runs": len(own), "reversed": len(back), "t_r_mean": mean, "t_r_std": t_r.std(),
               "t_r_low": mean - half, "t_r_high": mean + half, "n_0_mean": n_0,
               "t_rgh_line": gh_line(point[target], point["n_i"], n_0)}
        )  # fmt: skip
    return pd.DataFrame(rows)


def gh_line(coefficient: float, n_i: float, n_0: float) -> float:
    """Return Garcia and Hubbard's time by ``n_0`` (Eqs. (56) [trgh-p] and (58) [trgh-m]).

    It is twice artanh(n_i/n_0), whose argument has as many digits as the mean of n_0.
    """
    return 2 * float(np.arctanh(abs(n_i) / n_0)) / (n_0 * coefficient)


def draw(tables: Tables) -> Drawing:
    """Draw a panel for each spin, and part (b) in the place that is left."""
    figure, used, (axis, *_) = panels(tables["times"], "K_p", "t_{ru}", "t_{rGH+}", above=True)
    frame(used[0], "(a)", loc="left")
    spin = tables["spin"]
    axis.axis("on")
    axis.plot(spin["t"], spin["n"], color=BLUE, linewidth=0.8)
    axis.axhline(0, **ZERO)
    axis.set(xlabel=T_AXIS, ylabel=N_AXIS)
    frame(axis, "(b) GH, " + launch({"n_i": spin["n"].iloc[0]}, "n_i"))
    return figure


def panels(
    values: pd.DataFrame, coefficient: str, time: str, theory: str, *, above: bool = False
) -> tuple[Drawing, list[Axes], list[Axes]]:
    """Draw a panel for each spin from the table of :func:`times`.

    ``time`` and ``theory`` are symbols, as mathematics.  The legend stands ``above`` all panels, or
    in the last place that is left over.  Returns the figure, its panels, and the axes that are left
    over, switched off.
    """
    spins = sorted(values["n_i"].unique(), key=abs)
    rows = -(-(len(spins) + 1) // COLUMNS)
    figure = new_figure(9.2, 2.9 * rows + 0.35)
    axes = list(figure.subplots(rows, COLUMNS, squeeze=False).ravel())
    means = values[["t_r_mean", "t_rgh_line"]].to_numpy()
    ends = (0.1, 1.0) if np.isnan(means).all() else (np.nanmin(means) / 2.5, np.nanmax(means) * 2.5)
    for axis, spin in zip(axes, spins, strict=False):
        _points(axis, values[values["n_i"] == spin], coefficient)
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
    used, spare = axes[: len(spins)], axes[len(spins) :]
    for axis in spare:
        axis.axis("off")
    if above:
        figure.legend(marks.values(), marks, ncols=len(marks), **ABOVE)
    else:
        spare[-1].legend(marks.values(), marks, loc="center", frameon=False, labelspacing=0.9)
    return figure, used, spare


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
