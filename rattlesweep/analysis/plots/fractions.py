"""How often bodies reverse, wobble or spin on, as stacked shares with their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.analysis.plots.counts import Counted
from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.panels import draw_panels, legend_above, scale_axis
from rattlesweep.analysis.plots.picture import abscissa
from rattlesweep.analysis.style import INK, TYPE_STYLE, Mark, label
from rattlesweep.sweeps.counts import share, wilson

# With fewer values along the axis, areas between them say nothing: bars.
FEWEST_FOR_AREAS = 4
UNSURE_LABEL = "type not sure"
UNSURE: dict[str, Any] = {"facecolor": "#FFFFFFB0", "edgecolor": INK, "hatch": "xxxxxx",
                          "linewidth": 0, "label": UNSURE_LABEL}  # fmt: skip
BONDI_LABEL = r"$|n_{c1}| < |n_i|$ above (Bondi)"


class Fractions(Counted):
    """Shares of the types against the first axis; the second makes rows, the others columns."""

    name = "fractions"
    caption = (
        "Shares of the types. Bars are 95 % Wilson intervals. The share above a triangle is "
        "that of the bodies whose steady spin is linearly stable according to theory."
    )

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Where there are shares to speak of, and something to plot them against."""
        return bool(layout.axes) and layout.population

    @staticmethod
    def order(layout: Layout, x: str | None) -> Sequence[str]:
        """Rows for the oscillation, as in the paper, columns for the others."""
        first = abscissa(layout, [*layout.targets, *layout.bodies, *layout.launch], x)
        others = [n for n in (*layout.launch, *layout.targets, *layout.bodies)
                  if n not in (first, "omega_xy0") and layout.lengths[n] > 1]  # fmt: skip
        if first != "omega_xy0":
            return (first, *(n for n in layout.launch if n == "omega_xy0"), *others)
        # One of a single value keeps the row, so that the rest makes columns.
        single = [n for n, count in layout.lengths.items() if count == 1 and len(others) == 1]
        return (first, *single[:1], *others)

    def size(self) -> tuple[float, float]:
        """By the number of panels."""
        _, down, *across = (*self.shape, 1)
        width = np.clip(2.2 + 1.6 * np.prod(across), 6.4, 14)
        return float(width), 1.5 + 1.35 * max(down, 1.4)

    def side_by_side(self) -> bool:
        """Whether there are bars instead of areas."""
        return self.shape[0] < FEWEST_FOR_AREAS

    def draw(self, figure: Any, log: bool | None) -> None:
        """Areas, or bars where values are few, and Bondi's share, which no area shows."""
        x, rows, columns = self.axes[0], self.axes[1:2], self.axes[2:]
        panels = draw_panels(figure, rows, columns)
        at = np.arange(len(x.values), dtype=float) if self.side_by_side() else x.values
        ok, bondi = self.grid(self.cells.ok), self.bondi()
        for panel in panels:
            here: Any = (slice(None), *panel.where)
            seen = ok[here] > 0
            below = np.zeros(int(seen.sum()))
            for name, mark in self._marks():
                own = share(self.grid(self.cells.types[name])[here], ok[here])[seen]
                style = {"facecolor": mark.colour, "hatch": mark.hatch, "linewidth": 0}
                self._stack(panel.axes, at[seen], below, own, label=mark.label, **style)
                below = below + own
                unsure = share(self.grid(self.cells.unsure_types[name])[here], ok[here])[seen]
                if unsure.any():
                    self._stack(panel.axes, at[seen], below - unsure, unsure, **UNSURE)
            self._intervals(panel.axes, here, at)
            if np.isfinite(bondi).any():
                panel.axes.plot(at, 1 - bondi[here], "k^", ms=4, mec="white", mew=0.5, zorder=5,
                                label=BONDI_LABEL, clip_on=False)  # fmt: skip
            panel.axes.set(ylim=(0, 1), yticks=[0, 0.5, 1])
            if self.side_by_side():
                panel.axes.set_xticks(at, [f"{value:g}".replace("-", "−") for value in x.values])
                panel.axes.set_xlim(-0.6, len(at) - 0.4)
            else:
                scale_axis(panel.axes, "x", x.values, x.logarithmic(log), x.name)
                panel.axes.set_xlim(x.values[0], x.values[-1])
        figure.supxlabel(label(x.name), fontsize="medium")
        figure.supylabel("share of bodies", fontsize="medium")
        known: dict[str, Any] = {}
        for panel in panels:
            handles, words = panel.axes.get_legend_handles_labels()
            known |= zip(words, handles, strict=True)
        # Marks come last, whatever order they were drawn in.
        for word in (UNSURE_LABEL, BONDI_LABEL):
            known |= {word: known.pop(word)} if word in known else {}
        legend_above(figure, [*known.values()], 1.75)

    def _stack(self, axes: Any, at: Floats, below: Floats, own: Floats, **style: Any) -> None:
        """Lay shares on those below."""
        if self.side_by_side():
            axes.bar(at, own, 0.7, below, **style)
        else:
            axes.fill_between(at, below, below + own, **style)

    def _marks(self) -> list[tuple[str, Mark]]:
        """Types that there can be, from below, and how they are drawn."""
        return [(name, mark) for name, mark in TYPE_STYLE.items() if name in self.cells.types]

    def _intervals(self, axes: Any, here: Any, at: Floats) -> None:
        """Wilson's interval of each border between areas, itself a share of the runs."""
        ok = self.grid(self.cells.ok)[here]
        part = np.zeros_like(ok)
        for name, _ in self._marks()[:-1]:
            part = part + self.grid(self.cells.types[name])[here]
            low, high = wilson(part, ok)
            middle = share(part, ok)
            # A border at the rim is no border.
            real = (part > 0) & (part < ok)
            bars = axes.errorbar(
                at[real], middle[real], [(middle - low)[real], (high - middle)[real]], fmt="none",
                ecolor="#000000", elinewidth=0.9, capsize=1.6, capthick=0.9, zorder=4,
            )  # fmt: skip
            for part_of_bar in bars.get_children():
                part_of_bar.set_clip_on(False)
