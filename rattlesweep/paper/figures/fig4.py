"""Fig. 4: (a) to the left, (b) to the right, spin above the oscillations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
import pyarrow as pa
from matplotlib.figure import Figure

from rattlesweep.paper.figures.style import ABOVE, DASHES, SPIN, TIME, ZERO, frame, launch
from rattlesweep.study.style import BLUE, INK, VERMILION, new_figure

COMPONENTS = ("omega_x", "omega_y")


def draw(tables: Mapping[str, pa.Table]) -> Figure:
    """Draw the figure from its data."""
    figure = new_figure(9.2, 6.0)
    axes = figure.subplots(3, 2, sharex="col")
    runs = {row["run"]: row for row in tables["runs"].to_pylist()}
    for column, letter, name in zip(axes.T, "ab", ("unsteady", "steady"), strict=True):
        _column(column, letter, runs[name], tables[name].to_pandas())
    # omega_x and omega_y share their scale, so that (a) and (b) can be compared.
    most = max(max(map(abs, axis.get_ylim())) for axis in axes[1:].ravel())
    for axis in axes[1:].ravel():
        axis.set_ylim(-most, most)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), ncols=3, **ABOVE)
    return figure


def _column(axes: Any, letter: str, run: dict[str, Any], data: pd.DataFrame) -> None:
    t, t_r = data["t"], run["t_r"]
    spin, *oscillations = axes
    spin.plot(t, data["n"], color=BLUE, linewidth=1.1, label="full dynamics")
    spin.plot(t, data["n_gh"], color=INK, linewidth=1.1, linestyle=DASHES,
              label=r"Garcia and Hubbard, $\overline{n}(t)$")  # fmt: skip
    spin.axhline(0, **ZERO)
    spin.set_ylabel(SPIN)
    for axis, name in zip(oscillations, COMPONENTS, strict=True):
        axis.plot(t, data[name], color=BLUE, linewidth=0.5)
        axis.set_ylabel(rf"$\omega_{name[-1]}$ / $\tilde\omega$")
    for k, axis in enumerate(axes, start=1):
        if t_r is not None:
            axis.axvline(t_r, color=VERMILION, linewidth=0.9, linestyle=":",
                         label="first reversal" if k == 1 else None)  # fmt: skip
        axis.set_xlim(0, t.iloc[-1])
        frame(axis, f"({letter}-{k})", loc="left")
    if t_r is not None:
        # Where the spin is not: after a reversal it is of the other sign.
        symbol = f"t_{{r{'u' if run['n_i'] > 0 else 's'}}}"
        spin.text(t_r + 0.02 * t.iloc[-1], 0.85 * run["n_i"], f"${symbol} = {t_r:.1f}$",
                  color="#A33B00", fontsize=9.5, va="center")  # fmt: skip
    frame(spin, f"GH, {launch(run, 'n_i', 'omega_xy0')}")
    axes[-1].set_xlabel(TIME)
