"""Fig. 5: times of reversal in the unsteady direction, as Fig. 7 has them in the other; a run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from rattlesweep.analysis.style import BLUE, SERIES, new_figure
from rattlesweep.paper.columns import number, schema, table
from rattlesweep.paper.figures.follow import FORCE_CHANNELS, FORCES, follow, forces
from rattlesweep.paper.figures.style import ABOVE, N_AXIS, T_AXIS, ZERO, decade_ticks, frame, launch
from rattlesweep.paper.workspace import Progress, StoredRuns, Tables, Workspace
from rattlesweep.physics.body import Rattleback
from rattlesweep.sweeps.columns import RATE, TIME
from rattlesweep.sweeps.single import Launch

# Of (b); its length is not named in the paper.
N_I, OMEGA_XY0, T_END = 0.5, 0.01, 150.0
SPIN = schema("t n omega_x")
Z95 = 1.959964
# Panels beside each other.
COLUMNS = 3


def data(ws: Workspace, progress: Progress) -> Tables:
    """Tables ``times`` of part (a); ``spin`` and ``forces`` of part (b), in the sweep's method."""
    sweep = ws.sweep("unsteady", progress)
    integrator = sweep.config.integrator.model_dump(exclude_none=True)
    gh = Launch(Rattleback.gh(), N_I, OMEGA_XY0, T_END, integrator=integrator)
    channels = ("t", "n", "omega_x", *FORCE_CHANNELS)
    found, _ = follow(gh, channels, f"GH at n_i = {N_I:g}", progress)
    return {
        "times": times(sweep),
        "spin": table(found.table, SPIN),
        "forces": table([forces(f"Fig. 5(b), n_i = {N_I:g}", found.table)], FORCES),
    }


def draw(tables: Tables) -> Drawing:
    """A panel a spin, and part (b) in the place that is left."""
    figure, used, (axis, *_) = panels(tables["times"], "K_p", "t_{ru}", "t_{rGH+}", above=True)
    frame(used[0], "(a)", loc="left")
    spin = tables["spin"].to_pandas()
    axis.axis("on")
    axis.plot(spin["t"], spin["n"], color=BLUE, linewidth=0.8)
    axis.axhline(0, **ZERO)
    axis.set(xlabel=T_AXIS, ylabel=N_AXIS)
    frame(axis, "(b) GH, " + launch({"n_i": spin["n"].iloc[0]}, "n_i"))
    return figure


def times(sweep: StoredRuns) -> pa.Table:
    """One row a point: the runs that reverse, and the theory's line at the mean ``n_0``."""
    rows = [point | of_point(runs, point) for point, runs in sweep.points()]
    return table(
        rows,
        schema(
            f"{sweep.target} n_i omega_xy0 runs reversed",
            number("t_r_mean", "mean time of reversal", TIME),
            number("t_r_std", "its sample standard deviation over the runs", TIME),
            number("t_r_low", "95 % confidence interval of the mean (normal), lower end", TIME),
            number("t_r_high", "the same, upper end", TIME),
            number("t_r_median", "median time of reversal", TIME),
            number("n_0_mean", "mean over all runs of the spin that would hold all energy", RATE),
            number("t_rgh_line", "Garcia and Hubbard's time at the mean n_0", TIME),
            number("ratio_mean", "mean over the runs of t_r / t_rGH of the same run"),
            number("ratio_std", "its sample standard deviation"),
        ),
    )


def of_point(runs: pd.DataFrame, point: dict[str, Any]) -> dict[str, Any]:
    """The rest of the row; not a number where no run, or only one, reverses."""
    back = runs[runs["type"] == "R"]
    t_r, ratio = back["t_r"], back["t_r"] / back["t_rgh"]
    mean, n_0 = t_r.mean(), runs["n_0"].mean()
    half = Z95 * t_r.std() / np.sqrt(max(len(back), 1))
    coefficient, n_i = next(iter(point.values())), point["n_i"]
    return {
        "runs": len(runs),
        "reversed": len(back),
        "t_r_mean": mean,
        "t_r_std": t_r.std(),
        "t_r_low": mean - half,
        "t_r_high": mean + half,
        "t_r_median": t_r.median(),
        "n_0_mean": n_0,
        "t_rgh_line": gh_line(coefficient, n_i, n_0),
        "ratio_mean": ratio.mean(),
        "ratio_std": ratio.std(),
    }


def gh_line(coefficient: float, n_i: float, n_0: float) -> float:
    """Garcia and Hubbard's reversal time from ``n_0`` (Eqs. (56) [trgh-p] and (58) [trgh-m]).

    Twice artanh(n_i/n_0): the logarithm's argument loses no more digits than the mean of n_0 has.
    """
    return 2 * float(np.arctanh(abs(n_i) / n_0)) / (n_0 * coefficient)


def panels(
    points: pa.Table, coefficient: str, time: str, theory: str, *, above: bool = False
) -> tuple[Drawing, list[Axes], list[Axes]]:
    """A panel a spin: the figure, its panels, and the axes that are left over, switched off.

    Of the table of :func:`times`; ``time`` and ``theory`` are symbols, as mathematics.  The legend
    stands ``above`` all panels, or in the last of those left over.
    """
    values = points.to_pandas()
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
