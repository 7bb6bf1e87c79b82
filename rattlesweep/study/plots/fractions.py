"""How often bodies reverse, wobble or spin on, as stacked shares with their intervals."""

from __future__ import annotations

from typing import Any

import numpy as np

from rattlesweep.study.plots.counts import Counts
from rattlesweep.study.plots.kind import Kind, Lengths, abscissa
from rattlesweep.study.plots.layout import Layout
from rattlesweep.study.plots.panels import draw_panels, legend_above, scale_axis
from rattlesweep.study.style import TYPE_STYLE, label
from rattlesweep.sweeps.tables.cells import share, wilson

# With fewer values along the axis, areas between them say nothing: bars.
FEWEST_FOR_AREAS = 4
BONDI_LABEL = r"$|n_{c1}| < |n_i|$ above (Bondi)"


def draw(figure: Any, counted: Counts, log: bool | None) -> None:
    """Shares of the types against the first axis; the second makes rows, the others columns."""
    x, rows, columns = counted.axes[0], counted.axes[1:2], counted.axes[2:]
    panels = draw_panels(figure, rows, columns)
    areas = len(x.values) >= FEWEST_FOR_AREAS
    at = x.values if areas else np.arange(len(x.values), dtype=float)
    ok, bondi = counted.grid(counted.cells.ok), counted.bondi()
    for panel in panels:
        here: Any = (slice(None), *panel.where)
        seen = ok[here] > 0
        below = np.zeros(int(seen.sum()))
        for name, (colour, _, hatch, text) in TYPE_STYLE.items():
            own = share(counted.grid(counted.cells.types[name])[here], ok[here])[seen]
            style = {"facecolor": colour, "hatch": hatch, "label": text, "linewidth": 0}
            if areas:
                panel.axes.fill_between(at[seen], below, below + own, **style)
            else:
                panel.axes.bar(at[seen], own, 0.7, below, **style)
            below = below + own
        _intervals(panel.axes, counted, here, at)
        if np.isfinite(bondi).any():
            panel.axes.plot(at, 1 - bondi[here], "k^", ms=4, mec="white", mew=0.5, zorder=5,
                            label=BONDI_LABEL, clip_on=False)  # fmt: skip
        panel.axes.set(ylim=(0, 1), yticks=[0, 0.5, 1])
        if areas:
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


def _intervals(axes: Any, counted: Counts, here: Any, at: Any) -> None:
    """Wilson's interval of each border between areas, itself a share of the runs."""
    ok = counted.grid(counted.cells.ok)[here]
    part = np.zeros_like(ok)
    for name in list(TYPE_STYLE)[:-1]:
        part = part + counted.grid(counted.cells.types[name])[here]
        low, high = wilson(part, ok)
        middle = share(part, ok)
        # A border at the rim is no border.
        real = (part > 0) & (part < ok)
        axes.errorbar(
            at[real], middle[real], [(middle - low)[real], (high - middle)[real]], fmt="none",
            ecolor="#000000", elinewidth=0.9, capsize=1.6, capthick=0.9, zorder=4,
        )  # fmt: skip


def _order(layout: Layout, left: Lengths, x: str | None) -> tuple[str, ...]:
    """Rows for the oscillation, as in the paper, columns for the others."""
    names = [*layout.targets, *layout.bodies, *layout.launch]
    first = abscissa(left, names, x)
    others = [n for n in ("n_i", *layout.targets, *layout.bodies) if left.get(n, 1) > 1]
    others = [n for n in others if n not in (first, "omega_xy0")]
    if first != "omega_xy0":
        return (first, "omega_xy0", *others)
    # One of a single value keeps the row, so that the rest makes columns.
    single = [n for n in left if left[n] == 1][: 1 if len(others) == 1 else 0]
    return (first, *single, *others)


def _size(counted: Counts) -> tuple[float, float]:
    _, down, *across = (*counted.shape, 1)
    width = np.clip(2.2 + 1.6 * np.prod(across), 6.4, 14)
    return float(width), 1.5 + 1.35 * max(down, 1.4)


FRACTIONS = Kind(
    name="fractions",
    caption="Shares of the types. Bars are 95 % Wilson intervals. The share above a triangle is "
    "that of the bodies whose steady spin is linearly stable according to theory.",
    fits=lambda layout, left: bool(left) and layout.population,
    order=_order,
    gather=Counts,
    size=_size,
    draw=draw,
    x_limits=lambda counted: counted.shape[0] >= FEWEST_FOR_AREAS,
)
