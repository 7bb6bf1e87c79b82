"""Fig. 8: one panel a run; beside it, the running Lyapunov exponents of the same runs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from rattlesweep.paper.figures.style import (
    ABOVE,
    DASHES,
    SPIN,
    TIME,
    ZERO,
    decade_ticks,
    frame,
    launch,
)
from rattlesweep.study.style import BLUE, GREY, SERIES, VERMILION, new_figure

LETTERS = "abcdef"


def draw(tables: Mapping[str, pa.Table]) -> Figure:
    """Draw the figure from its data."""
    runs = list(tables["spin"].to_pandas().groupby("theta"))
    figure = new_figure(8.2, 1.9 * len(runs) + 0.7)
    axes = figure.subplots(len(runs), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axis, (theta, own), letter in zip(axes, runs, LETTERS, strict=False):
        axis.plot(own["t"], own["n"], color=BLUE, linewidth=0.8, label="full dynamics")
        axis.plot(own["t"], own["n_reduced"], color=VERMILION, linewidth=1.2, linestyle=DASHES,
                  label="reduced model")  # fmt: skip
        axis.axhline(0, **ZERO)
        axis.set_ylabel(SPIN)
        axis.set_xlim(0, own["t"].max())
        frame(axis, f"({letter}) {launch({'theta': theta}, 'theta')}", loc="left")
    axes[-1].set_xlabel(TIME)
    figure.legend(*axes[0].get_legend_handles_labels(), ncols=2, **ABOVE)
    return figure


def lyapunov(tables: Mapping[str, pa.Table]) -> Figure:
    """Running exponents on logarithmic axes; the coarser tolerances are dashed."""
    data = tables["growth"].to_pandas()
    first, end, best = data["t"].min(), data["t"].max(), data["tol"].min()
    figure = new_figure(7.2, 4.4)
    axis = figure.add_subplot()
    for (theta, runs), letter, (colour, _) in zip(
        data.groupby("theta"), LETTERS, SERIES, strict=False
    ):
        for tol, own in runs.groupby("tol"):
            axis.plot(
                own["t"], own["exponent"].where(own["exponent"] > 0), color=colour,
                linewidth=1.6 if tol == best else 1.0,
                linestyle="-" if tol == best else DASHES,
                label=f"({letter}) {launch({'theta': theta}, 'theta')}" if tol == best else None,
            )  # fmt: skip
    t = np.geomspace(first, end, 50)
    axis.plot(t, np.log(t) / t, color="#777777", linewidth=1.0, linestyle=":",
              label=r"$\ln(t)/t$: growth like $t$")  # fmt: skip
    for tol in sorted(data["tol"].unique(), reverse=True):
        axis.plot([], [], color=GREY, linewidth=1.2, linestyle="-" if tol == best else DASHES,
                  label=f"tol {tol:g}")  # fmt: skip
    axis.set(xscale="log", yscale="log", xlabel=TIME, xlim=(first, end))
    axis.set_ylabel(r"running Lyapunov exponent / $\tilde\omega$")
    axis.set_ylim(bottom=max(1e-7, 0.3 * data["exponent"][data["exponent"] > 0].min()))
    decade_ticks(axis.xaxis)
    frame(axis, grid="both")
    figure.legend(ncols=3, **ABOVE)
    return figure
