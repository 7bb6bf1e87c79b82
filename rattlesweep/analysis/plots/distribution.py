"""How reversal times are distributed about the theory, and how many runs never reverse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.ticker import MaxNLocator

from rattlesweep.analysis.plots.counts import Counted
from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.panels import BESIDE, plain_ticks
from rattlesweep.analysis.style import FAILED, THEORY, TYPE_STYLE, Mark
from rattlesweep.sweeps.counts import codes, floats

# Edges of t_r/t_rGH: 40 a decade.
EDGES = 10.0 ** (np.arange(-80, 81) / 40)


class Distribution(Counted):
    """Runs of type R by ``t_r/t_rGH`` between `EDGES`, and all runs by type."""

    name = "distribution"
    caption = "All runs together: reversal times about the theory, and types."

    def __init__(self, layout: Layout, x: str | None) -> None:
        super().__init__(layout, x)
        self.histogram = np.zeros(len(EDGES) - 1, np.int64)

    def add(self, rows: pa.RecordBatch) -> None:
        """Count more rows."""
        super().add(rows)
        t_r, t_rgh = floats(rows.column("t_r")), floats(rows.column("t_rgh"))
        timed = (codes(rows.column("type"), ("R",)) == 0) & (t_rgh > 0) & np.isfinite(t_r)
        timed &= self.layout.cells(rows, self.axes) >= 0
        # What lies outside is counted at the edge.
        place = np.searchsorted(EDGES, t_r[timed] / t_rgh[timed], "right") - 1
        np.add.at(self.histogram, np.clip(place, 0, len(EDGES) - 2), 1)

    def size(self) -> tuple[float, float]:
        """Of two panels."""
        return 8.0, 3.6

    def table(self) -> pa.Table:
        """The histogram."""
        return pa.table({"ratio_low": EDGES[:-1], "ratio_high": EDGES[1:], "runs": self.histogram})

    def draw(self, figure: Any, log: bool | None) -> None:
        """The histogram, its ordinate logarithmic if asked for, and beside it bars of the types."""
        main, side = figure.subplots(1, 2, width_ratios=(2.6, 1))
        self._histogram(main)
        if log:
            main.set_yscale("log")
        else:
            main.yaxis.set_major_locator(MaxNLocator(integer=True))
        main.axvline(1, **THEORY)
        main.set_xlabel(r"$t_r/t_{rGH}$ of runs that reverse (dashed: theory)")
        main.set_ylabel("runs")
        self._types(side)
        for axes in (main, side):
            axes.spines[["top", "right"]].set_visible(False)

    def _histogram(self, axes: Any) -> None:
        seen = np.flatnonzero(self.histogram)
        if not len(seen):
            axes.text(0.5, 0.5, "no run reverses", transform=axes.transAxes, ha="center")
            axes.set_xticks([])
            return
        # Two empty bins on either side, and the theory's 1 in sight.
        first = max(min(seen[0], len(EDGES) // 2) - 2, 0)
        last = min(max(seen[-1], len(EDGES) // 2) + 3, len(EDGES) - 1)
        own = TYPE_STYLE["R"]
        axes.stairs(self.histogram[first:last], EDGES[first : last + 1], fill=True,
                    facecolor=own.colour, hatch=own.hatch, linewidth=0)  # fmt: skip
        axes.set_xscale("log")
        plain_ticks(axes, "x", (float(EDGES[first]), float(EDGES[last])))
        axes.set_xlim(EDGES[first], EDGES[last])

    def _types(self, axes: Any) -> None:
        totals = {name: int(part.sum()) for name, part in self.cells.types.items()}
        if self.cells.failed.any():
            totals["failed"] = int(self.cells.failed.sum())
        for at, (name, total) in enumerate(totals.items()):
            mark = TYPE_STYLE.get(name, Mark(FAILED, "", "", ""))
            axes.barh(at, total, facecolor=mark.colour, hatch=mark.hatch, height=0.62, linewidth=0)
            axes.annotate(f"{total:,}", (total, at), xytext=(4, 0), textcoords="offset points",
                          va="center", fontsize="small")  # fmt: skip
        axes.set_label(BESIDE)
        axes.set_yticks(range(len(totals)), list(totals))
        axes.invert_yaxis()
        axes.set_xlim(0, 1.35 * max(totals.values()))
        axes.set_xticks([])
        axes.set_xlabel("runs by type")
