"""How reversal times are distributed about the theory, and how many runs never reverse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.study.plots.counts import Counts
from rattlesweep.study.plots.kind import Kind
from rattlesweep.study.plots.panels import BESIDE, plain_ticks
from rattlesweep.study.style import FAILED, THEORY, TYPE_STYLE, Mark
from rattlesweep.sweeps.tables.cells import codes, floats

# Edges of t_r/t_rGH: 40 a decade.
EDGES = 10.0 ** (np.arange(-80, 81) / 40)


class Distribution(Counts):
    """Runs, and those of type R by ``t_r/t_rGH`` between `EDGES`, all cells together."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.histogram = np.zeros(len(EDGES) - 1, np.int64)

    def add(self, rows: pa.RecordBatch) -> None:
        """Count more rows."""
        super().add(rows)
        t_r, t_rgh = floats(rows.column("t_r")), floats(rows.column("t_rgh"))
        timed = (codes(rows.column("type"), ("R",)) == 0) & (t_rgh > 0) & np.isfinite(t_r)
        timed &= self._places.cells(rows) >= 0
        # What lies outside is counted at the edge.
        place = np.searchsorted(EDGES, t_r[timed] / t_rgh[timed], "right") - 1
        np.add.at(self.histogram, np.clip(place, 0, len(EDGES) - 2), 1)

    def table(self) -> pa.Table:
        """The histogram."""
        return pa.table({"ratio_low": EDGES[:-1], "ratio_high": EDGES[1:], "runs": self.histogram})


def draw(figure: Any, counted: Distribution, log: bool | None) -> None:
    """The distribution of ``t_r/t_rGH``, its ordinate logarithmic if asked for; types as bars."""
    main, side = figure.subplots(1, 2, width_ratios=(2.6, 1))
    seen = np.flatnonzero(counted.histogram)
    if len(seen):
        # Two empty bins on either side, and the theory's 1 in sight.
        first = max(min(seen[0], len(EDGES) // 2) - 2, 0)
        last = min(max(seen[-1], len(EDGES) // 2) + 3, len(EDGES) - 1)
        own = TYPE_STYLE["R"]
        main.stairs(counted.histogram[first:last], EDGES[first : last + 1], fill=True,
                    facecolor=own.colour, hatch=own.hatch, linewidth=0)  # fmt: skip
        main.set_xscale("log")
        plain_ticks(main, "x", (float(EDGES[first]), float(EDGES[last])))
        main.set_xlim(EDGES[first], EDGES[last])
    else:
        main.text(0.5, 0.5, "no run reverses", transform=main.transAxes, ha="center")
        main.set_xticks([])
    if log:
        main.set_yscale("log")
    main.axvline(1, **THEORY)
    main.set_xlabel(r"$t_r/t_{rGH}$ of runs that reverse (dashed: theory)")
    main.set_ylabel("runs")
    totals = {name: int(part.sum()) for name, part in counted.cells.types.items()}
    if counted.cells.failed.any():
        totals["failed"] = int(counted.cells.failed.sum())
    place = np.arange(len(totals))
    for at, (name, total) in zip(place, totals.items(), strict=True):
        colour, _, hatch, _ = TYPE_STYLE.get(name, Mark(FAILED, "", "", ""))
        side.barh(at, total, facecolor=colour, hatch=hatch, height=0.62, linewidth=0)
        side.annotate(f"{total:,}", (total, at), xytext=(4, 0), textcoords="offset points",
                      va="center", fontsize="small")  # fmt: skip
    side.set_label(BESIDE)
    side.set_yticks(place, list(totals))
    side.invert_yaxis()
    side.set_xlim(0, 1.35 * max(totals.values()))
    side.set_xticks([])
    side.set_xlabel("runs by type")
    for axes in (main, side):
        axes.spines[["top", "right"]].set_visible(False)


DISTRIBUTION = Kind(
    name="distribution",
    caption="All runs together: reversal times about the theory, and types.",
    fits=lambda layout, left: True,
    order=lambda layout, left, x: (),
    gather=Distribution,
    size=lambda counted: (8.0, 3.6),
    draw=draw,
)
