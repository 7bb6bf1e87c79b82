"""Maps of how often the spin reverses by the horizon."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib import colormaps
from matplotlib.colors import BoundaryNorm, ListedColormap

from rattlesweep.arrays import Floats
from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.map import (
    BALANCE,
    BALANCE_LABEL,
    CELLS,
    CODES,
    NO_REVERSAL,
    Map,
    patch,
)
from rattlesweep.analysis.plots.panels import draw_panels, entry, legend_above
from rattlesweep.analysis.style import label

# So many numbers have a colour each; beyond, a colour is of more and more of them.
SINGLE = 6
COLUMN = "n_reversals"


class Reversals(Map):
    """Number of reversals by cell, the mean of several runs, one panel for each further value."""

    name = "reversals"
    caption = "Numbers of reversals by the horizon."

    def __init__(self, layout: Layout, x: str | None) -> None:
        super().__init__(layout, x, (COLUMN,))

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Where they are recorded, and there are two axes."""
        return "reversals" in layout.config.record and Map.fits(layout)

    def table(self) -> pa.Table:
        """One row a cell that holds runs."""
        mean = pa.array(self.moments[COLUMN].means()[self.cells.runs > 0], from_pandas=True)
        return super().table().append_column(f"{COLUMN}_mean", mean)

    def size(self) -> tuple[float, float]:
        """By the number of panels."""
        return 6.4, float(np.clip(1.2 + 3.4 * np.prod(self.shape[2:]), 4.4, 14))

    def draw(self, figure: Any, log: bool | None) -> None:
        """Cells by their number, in steps of one while it is small."""
        x, y, *rows = self.axes
        panels = draw_panels(figure, rows, ())
        mean, code = self.grid(self.moments[COLUMN].means()), self._codes()
        borders = _borders(mean)
        shades = colormaps["viridis"](np.linspace(0.1, 1, max(1, len(borders) - 2)))
        norm = BoundaryNorm(np.array(borders) - 0.5, len(borders) - 1)
        colours = ListedColormap([NO_REVERSAL, *shades][: len(borders) - 1])
        balance = False
        for panel in panels:
            self._paint_types(panel, code, grey=True)
            mesh = self._paint(panel, mean, cmap=colours, norm=norm)
            panel.axes.set_ylabel(label(y.name))
            balance |= self._balance(panel)
            self._scale(panel, log)
        figure.supxlabel(label(x.name), fontsize="medium")
        bar = figure.colorbar(mesh, ax=[panel.axes for panel in panels], pad=0.03, aspect=30)
        bar.set_ticks(
            [(a + b - 1) / 2 for a, b in pairwise(borders)],
            labels=[str(a) if b == a + 1 else f"{a} to {b - 1}" for a, b in pairwise(borders)],
        )
        bar.ax.tick_params(which="both", length=0)
        several = self.cells.runs.max() > 1
        bar.set_label("mean number of reversals" if several else "number of reversals")
        lost = [name for name in ("failed", "missing") if (code == CODES[name]).any()]
        handles: list[Any] = [patch(*CELLS[name]) for name in lost]
        handles += [entry(BALANCE_LABEL, **BALANCE)] if balance else []
        if handles:
            legend_above(figure, handles, 1.9)


def _borders(mean: Floats) -> list[int]:
    """First numbers of the colours, and one behind the last."""
    most = int(np.nanmax(mean, initial=0).round())
    borders = list(range(min(most, SINGLE) + 1))
    while (following := round(1.4 * borders[-1])) <= most and following > borders[-1]:
        borders.append(following)
    return [*borders, most + 1]
