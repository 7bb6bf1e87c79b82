"""How reversal times are distributed about the theory, or any column, and how many runs do what."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.ticker import MaxNLocator

from rattlesweep.analysis.plots.picture import BESIDE, Picture, plain_ticks
from rattlesweep.analysis.plots.scatter import WIDE
from rattlesweep.analysis.style import BLUE, FAILED, THEORY, TYPE_STYLE, Mark, label
from rattlesweep.arrays import Floats
from rattlesweep.sweeps.counts import codes, floats

# As few and as many bins as a histogram of some runs and of very many can do with.
FEWEST, MOST = 8, 150
RATIO = "ratio"


class Distribution(Picture):
    """A histogram of ``t_r/t_rGH`` of type R, or of a column of all runs, and all runs by type.

    Bins follow the data (Freedman and Diaconis); they are equal on a logarithmic axis where values
    are positive and spread widely, or are times. Counts have bins around whole numbers.
    """

    name = "distribution"

    @property
    def caption(self) -> str:  # type: ignore[override]
        """What is shown."""
        if self.quantity is None:
            return "All runs together: times of the first reversal about the theory, and types."
        return f"All runs together: {self.quantity}, and types."

    @cached_property
    def values(self) -> Floats:
        """Values of all runs that have one."""
        names = ("t_r", "t_rgh") if self.quantity is None else (self.quantity,)
        found = [np.empty(0)]
        for rows in self.layout.rows(["case", "sample", "type", "status", *names]):
            kept = codes(rows.column("status"), ("ok",)) == 0
            kept &= self.layout.cells(rows, self.axes) >= 0
            own = floats(rows.column(names[0]))
            if self.quantity is None:
                t_rgh = floats(rows.column("t_rgh"))
                kept &= (codes(rows.column("type"), ("R",)) == 0) & (t_rgh > 0)
                own = np.divide(own, t_rgh, out=np.full(len(own), np.nan), where=t_rgh > 0)
            found.append(own[kept & np.isfinite(own)])
        return np.concatenate(found)

    def logarithmic(self) -> bool:
        """Tell whether the abscissa is logarithmic."""
        low, high = self.values.min(initial=np.inf), self.values.max(initial=0.0)
        return bool(low > 0 and (self.quantity is None or high > WIDE * low))

    @cached_property
    def edges(self) -> Floats:
        """Borders of the bins."""
        v = self.values
        if not len(v):
            return np.array([0.0, 1.0])
        log = self.logarithmic()
        v = np.log(v) if log else v
        low, high = float(v.min()), float(v.max())
        if self.quantity is not None and not log and (v == np.round(v)).all() and high - low < MOST:
            return np.arange(low, high + 2) - 0.5
        if high - low <= 1e-12 * max(abs(low), abs(high), 1e-300):
            low, high = low - 0.1 * (abs(low) or 1.0), high + 0.1 * (abs(high) or 1.0)
            edges = np.linspace(low, high, 4)
        else:
            quarter = float(np.subtract(*np.percentile(v, [75, 25])))
            width = 2 * (quarter or (high - low)) / np.cbrt(len(v))
            edges = np.linspace(low, high, int(np.clip((high - low) / width, FEWEST, MOST)) + 1)
        edges = np.exp(edges) if log else edges
        # Rounding must leave no value outside.
        edges[0], edges[-1] = min(edges[0], self.values.min()), max(edges[-1], self.values.max())
        return edges

    def size(self) -> tuple[float, float]:
        """Return the size of two panels."""
        return 8.0, 3.6

    def table(self) -> pa.Table:
        """Return the histogram."""
        name = self.quantity or RATIO
        counts = np.histogram(self.values, self.edges)[0]
        return pa.table(
            {f"{name}_low": self.edges[:-1], f"{name}_high": self.edges[1:], "runs": counts}
        )

    def draw(self, figure: Any, log: bool | None) -> None:
        """Draw the histogram, its ordinate logarithmic if asked for, and bars of the types."""
        main, side = figure.subplots(1, 2, width_ratios=(2.6, 1))
        mark = TYPE_STYLE["R"] if self.quantity is None else Mark(BLUE, "", "", "")
        if len(self.values):
            counts, edges = self.table().column("runs").to_numpy(), self.edges
            main.stairs(counts, edges, fill=True, facecolor=mark.colour, linewidth=0)
            if self.logarithmic():
                main.set_xscale("log")
                ends = float(edges[0]), float(edges[-1])
                if self.quantity is None:  # theory's 1 in sight
                    ends = min(ends[0], 0.95), max(ends[1], 1.05)
                plain_ticks(main, "x", ends)
                main.set_xlim(*ends)
        else:
            words = "no run reverses" if self.quantity is None else "no run has a value"
            main.text(0.5, 0.5, words, transform=main.transAxes, ha="center")
            main.set_xticks([])
        if log:
            main.set_yscale("log")
        else:
            main.yaxis.set_major_locator(MaxNLocator(integer=True))
        if self.quantity is None:
            main.axvline(1, **THEORY)
            main.set_xlabel(f"{label(RATIO)} of runs that reverse (dashed: theory)")
        else:
            main.set_xlabel(label(self.quantity, self.unit))
        main.set_ylabel("runs")

        totals = {name: int(part.sum()) for name, part in self.cells.types.items()}
        if self.cells.failed.any():
            totals["failed"] = int(self.cells.failed.sum())
        for at, (name, total) in enumerate(totals.items()):
            own = TYPE_STYLE.get(name, Mark(FAILED, "", "", ""))
            side.barh(at, total, facecolor=own.colour, hatch=own.hatch, height=0.62, linewidth=0)
            side.annotate(f"{total:,}", (total, at), xytext=(4, 0), textcoords="offset points",
                          va="center", fontsize="small")  # fmt: skip
        side.set_label(BESIDE)
        side.set_yticks(range(len(totals)), list(totals))
        side.invert_yaxis()
        side.set_xlim(0, 1.35 * max(1, *totals.values()))
        side.set_xticks([])
        side.set_xlabel("runs by type")
        for axes in (main, side):
            axes.spines[["top", "right"]].set_visible(False)
