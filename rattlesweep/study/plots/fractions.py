"""How often bodies reverse, wobble or spin on, as stacked shares with their intervals."""

from __future__ import annotations

from typing import Any

import numpy as np

from rattlesweep.study.plots.panels import draw_panels, legend_above, scale_axis
from rattlesweep.study.plots.table import Tally
from rattlesweep.study.style import TYPE_STYLE, label
from rattlesweep.sweeps.tables.cells import share, wilson

# With fewer values along the axis, areas between them say nothing: bars.
FEWEST_FOR_AREAS = 4
BONDI_LABEL = r"$|n_{c1}| < |n_i|$ above (Bondi)"


def draw_fractions(figure: Any, counted: Tally, log: bool | None) -> None:
    """Draw shares of the types against the first axis; others make rows and columns.

    Parameters
    ----------
    figure
    counted : Tally
        Its axes are the abscissa, then rows, then columns.
    log : bool or None
        Whether the abscissa is logarithmic; None: as its values are spread.
    """
    x, rows, columns = counted.axes[0], counted.axes[1:2], counted.axes[2:]
    panels = draw_panels(figure, rows, columns)
    ok = counted.grid(counted.ok)
    bondi = share(counted.grid(counted.bondi), counted.grid(counted.steady))
    for panel in panels:
        here: Any = (slice(None), *panel.where)
        seen = ok[here] > 0
        at = (
            x.values if len(x.values) >= FEWEST_FOR_AREAS else np.arange(len(x.values), dtype=float)
        )
        below = np.zeros(int(seen.sum()))
        for name, (colour, _, hatch, text) in TYPE_STYLE.items():
            own = share(counted.grid(counted.types[name])[here], ok[here])[seen]
            style = {"facecolor": colour, "hatch": hatch, "label": text, "linewidth": 0}
            if len(x.values) >= FEWEST_FOR_AREAS:
                panel.axes.fill_between(at[seen], below, below + own, **style)
            else:
                panel.axes.bar(at[seen], own, 0.7, below, **style)
            below = below + own
        _intervals(panel.axes, counted, here, at)
        if np.isfinite(bondi).any():
            panel.axes.plot(at, 1 - bondi[here], "k^", ms=4, mec="white", mew=0.5, zorder=5,
                            label=BONDI_LABEL, clip_on=False)  # fmt: skip
        panel.axes.set(ylim=(0, 1), yticks=[0, 0.5, 1])
        if len(x.values) >= FEWEST_FOR_AREAS:
            scale_axis(panel.axes, "x", x, log)
            panel.axes.set_xlim(x.values[0], x.values[-1])
        else:
            panel.axes.set_xticks(at, [f"{value:g}" for value in x.values])
            panel.axes.set_xlim(-0.6, len(at) - 0.4)
    figure.supxlabel(label(x.name), fontsize="medium")
    figure.supylabel("share of bodies", fontsize="medium")
    handles, words = panels[0].axes.get_legend_handles_labels()
    # Marks come last, whatever order they were drawn in.
    order = sorted(range(len(words)), key=lambda place: words[place] == BONDI_LABEL)
    legend_above(figure, [handles[place] for place in order], 1.75)


def _intervals(axes: Any, counted: Tally, here: Any, at: Any) -> None:
    """Wilson's interval of each border between areas, itself a share of the runs."""
    ok = counted.grid(counted.ok)[here]
    part = np.zeros_like(ok)
    for name in list(TYPE_STYLE)[:-1]:
        part = part + counted.grid(counted.types[name])[here]
        low, high = wilson(part, ok)
        middle = share(part, ok)
        # A border at the rim is no border.
        real = (part > 0) & (part < ok)
        axes.errorbar(
            at[real], middle[real], [(middle - low)[real], (high - middle)[real]], fmt="none",
            ecolor="#000000", elinewidth=0.9, capsize=1.6, capthick=0.9, zorder=4,
        )  # fmt: skip
