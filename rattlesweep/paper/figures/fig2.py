"""Fig. 2: four cumulative distributions of frequencies; inset: their ratio."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from rattlesweep.paper.data.sd import BOUND
from rattlesweep.paper.figures.style import DASHES, frame
from rattlesweep.study.style import GREEN, ORANGE, SKY, new_figure


def draw(tables: Mapping[str, pa.Table]) -> Figure:
    """Draw the figure from its data."""
    data = tables["cumulative"].to_pandas()
    level = data["probability"]
    figure = new_figure(4.6, 3.6)
    axes = figure.add_subplot()
    # The approximations lie almost on top, so they are dark, dashed and thin over something pale
    # and broad.
    for mode, colour, dark in (("p", SKY, "#003F66"), ("r", ORANGE, "#7A2E00")):
        axes.plot(data[f"omega_{mode}"], level, color=colour, linewidth=3.2,
                  solid_capstyle="butt", label=rf"$\omega_{mode}$")  # fmt: skip
        axes.plot(data[f"omega_{mode}0"], level, color=dark, linewidth=1.1, linestyle=DASHES,
                  label=rf"$\omega_{{{mode}0}}$")  # fmt: skip
    axes.set(xlim=(0, 1.02 * data["omega_p"].iloc[-1]), ylim=(0, 1.03),
             xlabel=r"$\omega\,/\,\tilde\omega$", ylabel="cumulative distribution")  # fmt: skip
    axes.legend(frameon=False, loc="upper right", bbox_to_anchor=(0.99, 0.9), ncols=2,
                handlelength=1.9, columnspacing=1.0)  # fmt: skip
    inset = axes.inset_axes((0.6, 0.19, 0.36, 0.42))
    inset.plot(data["ratio"], level, color=GREEN, linewidth=1.6)
    inset.axvline(BOUND, color="#444444", linewidth=0.8, linestyle=":")
    inset.annotate(f"{BOUND:g}", (BOUND, 0.93), xytext=(3, 0), textcoords="offset points",
                   fontsize=7.5, color="#444444", va="center")  # fmt: skip
    # The last percent of the ratios would fill half of the axis.
    inset.set(xlim=(0, np.ceil(np.interp(0.995, level, data["ratio"]))), ylim=(0, 1.05))
    inset.set_xlabel(r"$\omega_p/\omega_r$", fontsize=9, labelpad=1)
    for each in (axes, inset):
        frame(each)
    inset.tick_params(labelsize=7.5)
    return figure
