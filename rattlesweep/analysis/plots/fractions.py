"""How often bodies reverse, wobble or spin steadily: stacked shares with their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.picture import (
    Picture,
    abscissa,
    draw_panels,
    legend_above,
    scale_axis,
)
from rattlesweep.analysis.style import INK, TYPE_STYLE, label
from rattlesweep.arrays import Floats
from rattlesweep.sweeps.counts import share, wilson

# With fewer values along the axis, areas between them would say nothing: bars.
FEWEST_FOR_AREAS = 4
UNSURE: dict[str, Any] = {"facecolor": "#FFFFFFB0", "edgecolor": INK, "hatch": "xxxxxx",
                          "linewidth": 0, "label": "type not sure"}  # fmt: skip
BONDI_LABEL = r"$|n_{c1}| < |n_i|$ above (Bondi)"


class Fractions(Picture):
    """Shares of the types against the first axis; the second makes rows, the others columns."""

    name = "fractions"
    caption = (
        "Shares of the types. Bars are 95 % Wilson intervals. The share above a triangle is "
        "that of the bodies whose steady spin is linearly stable according to theory."
    )

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Tell whether there are many bodies, and something to plot their shares against."""
        return bool(layout.axes) and layout.population

    @classmethod
    def order(cls, layout: Layout, x: str | None) -> Sequence[str]:
        """Make rows of the oscillation, as in the paper, and columns of the others."""
        first = abscissa(layout, [*layout.targets, *layout.bodies, *layout.launch], x)
        others = [n for n in (*layout.launch, *layout.targets, *layout.bodies)
                  if n not in (first, "omega_xy0") and layout.lengths[n] > 1]  # fmt: skip
        if first != "omega_xy0":
            return (first, *(n for n in layout.launch if n == "omega_xy0"), *others)
        # An axis of a single value takes the row, so that the rest makes columns.
        single = [n for n, count in layout.lengths.items() if count == 1 and len(others) == 1]
        return (first, *single[:1], *others)

    def size(self) -> tuple[float, float]:
        """Return a size by the number of panels."""
        _, down, *across = (*self.shape, 1)
        width = np.clip(2.2 + 1.6 * np.prod(across), 6.4, 14)
        return float(width), 1.5 + 1.35 * max(down, 1.4)

    def side_by_side(self) -> bool:
        """Tell whether there are bars instead of areas."""
        return self.shape[0] < FEWEST_FOR_AREAS

    def draw(self, figure: Any, log: bool | None) -> None:
        """Draw areas, or bars where values are few, and Bondi's share, which no area shows."""
        x, cells, bars = self.axes[0], self.cells, self.side_by_side()
        panels = draw_panels(figure, self.axes[1:2], self.axes[2:])
        at = np.arange(len(x.values), dtype=float) if bars else x.values
        marks = [(name, mark) for name, mark in TYPE_STYLE.items() if name in cells.types]
        bondi = self.bondi()

        def stack(axes: Any, below: Floats, above: Floats, **look: Any) -> None:
            if bars:
                axes.bar(at, above - below, 0.7, below, **look)
            else:
                axes.fill_between(at, below, above, **look)

        for axes, where in panels:
            here: Any = (slice(None), *where)
            ok = self.grid(cells.ok)[here]
            part = np.zeros_like(ok)
            for name, mark in marks:
                below, part = share(part, ok), part + self.grid(cells.types[name])[here]
                middle = share(part, ok)
                stack(axes, below, middle, label=mark.label, facecolor=mark.colour,
                      hatch=mark.hatch, linewidth=0)  # fmt: skip
                unsure = share(self.grid(cells.unsure_types[name])[here], ok)
                if (unsure > 0).any():
                    stack(axes, middle - unsure, middle, **UNSURE)
                # Wilson's interval of the border above, itself a share of the runs.
                low, high = wilson(part, ok)
                real = (part > 0) & (part < ok)
                drawn = axes.errorbar(
                    at[real], middle[real], [(middle - low)[real], (high - middle)[real]],
                    fmt="none", ecolor="#000000", elinewidth=0.9, capsize=1.6, capthick=0.9,
                    zorder=4,
                )  # fmt: skip
                for artist in drawn.get_children():
                    artist.set_clip_on(False)
            if np.isfinite(bondi).any():
                axes.plot(at, 1 - bondi[here], "k^", ms=4, mec="white", mew=0.5, zorder=5,
                          label=BONDI_LABEL, clip_on=False)  # fmt: skip
            axes.set(ylim=(0, 1), yticks=[0, 0.5, 1])
            if bars:
                axes.set_xticks(at, [f"{value:g}".replace("-", "−") for value in x.values])
                axes.set_xlim(-0.6, len(at) - 0.4)
            else:
                scale_axis(axes, "x", x.values, x.logarithmic(log), x.name)
                axes.set_xlim(x.values[0], x.values[-1])
        figure.supxlabel(label(x.name), fontsize="medium")
        figure.supylabel("share of bodies", fontsize="medium")
        known: dict[str, Any] = {}
        for axes, _ in panels:
            handles, words = axes.get_legend_handles_labels()
            known |= zip(words, handles, strict=True)
        for word in (UNSURE["label"], BONDI_LABEL):  # last, in whatever order they were drawn
            known |= {word: known.pop(word)} if word in known else {}
        legend_above(figure, [*known.values()], 1.75)
