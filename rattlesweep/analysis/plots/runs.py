"""Run by run: how a quantity is distributed, and reversal times against any column."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.ticker import MaxNLocator

from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.picture import WIDE, Picture, entry, plain_ticks, scale_axis
from rattlesweep.analysis.style import BLUE, SERIES, THEORY, label, light_grid, value_text
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.counts import codes, floats

# As few and as many bins as a histogram of some runs and of very many can do with.
FEWEST, MOST = 8, 150
# Where a few values lie far out, the axis ends at these percentiles.
TAILS = (1, 99)
RATIO = "ratio"
# More points than this cover each other, and make a file large.
MOST_POINTS = 20_000


class Distribution(Picture):
    """A histogram of ``t_r/t_rGH`` of type R, or of a column of all runs."""

    name = "distribution"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        super().__init__(layout, (), (6.4, 3.6))
        self.quantity, self.unit = quantity or RATIO, ""
        self.meaning = "t_r/t_rGH of the runs that reverse, 1 at the dashed line"
        if quantity is not None:
            self.unit, self.meaning = layout.column(quantity, "--quantity")

    @cached_property
    def runs(self) -> tuple[Floats, int]:
        """Values of the runs that have one, and the number of all."""
        names = ("t_r", "t_rgh", "type") if self.quantity == RATIO else (self.quantity,)
        parts, total = [np.empty(0)], 0
        for rows in self.layout.rows(["case", "sample", "status", *names]):
            shown = self.layout.cells(rows) >= 0
            total += int(shown.sum())
            shown &= codes(rows.column("status"), ("ok",)) == 0
            values = floats(rows.column(names[0]))
            if self.quantity == RATIO:
                shown &= codes(rows.column("type"), ("R",)) == 0
                with np.errstate(divide="ignore", invalid="ignore"):
                    values = values / floats(rows.column("t_rgh"))
            parts.append(values[shown & np.isfinite(values)])
        return np.concatenate(parts), total

    def __len__(self) -> int:
        return self.runs[1]

    @cached_property
    def bins(self) -> tuple[Floats, tuple[float, float], bool]:
        """Borders of bins that hold every value, the ends of the axis, whether it is logarithmic.

        A column of few values has a bin around each of them. Other bins follow the data (Freedman
        and Diaconis), over logarithms where values are positive and spread widely, or are ratios.
        Where a few values lie far out, the outermost bins hold them and reach beyond the axis.
        """
        values = self.runs[0]
        if not len(values):
            return np.zeros(1), (0.0, 1.0), False
        log = bool(values.min() > 0)
        log &= self.quantity == RATIO or bool(values.max() > WIDE * values.min())
        v = np.log(values) if log else values
        exact = np.unique(v)
        if len(exact) <= MOST // 3:
            middle = (exact[1:] + exact[:-1]) / 2
            half = np.diff(exact)[[0, -1]] / 2 if len(exact) > 1 else [0.5, 0.5]
            edges = np.array([exact[0] - half[0], *middle, exact[-1] + half[-1]])
            low, high = edges[[0, -1]]
        else:
            low, quarter, half, high = np.percentile(v, (0, 25, 75, 100))
            width = 2 * (half - quarter or high - low) / np.cbrt(len(v))
            if high - low > MOST * width:
                low, high = np.percentile(v, TAILS)
            number = int(np.clip((high - low) / width, FEWEST, MOST))
            edges = np.unique([v.min(), *np.linspace(low, high, number + 1), v.max()])
        if log:
            edges, low, high = np.exp(edges), np.exp(low), np.exp(high)
        # Rounding must leave no value outside.
        edges[0], edges[-1] = min(edges[0], values.min()), max(edges[-1], values.max())
        return edges, (float(low), float(high)), log

    def table(self) -> pa.Table:
        """Return the histogram."""
        (values, _), (edges, _, _), name = self.runs, self.bins, self.quantity
        counts = np.histogram(values, edges)[0] if len(values) else np.zeros(0, int)
        return pa.table({f"{name}_low": edges[:-1], f"{name}_high": edges[1:], "runs": counts})

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw the histogram, its ordinate logarithmic if asked for."""
        axes, (values, total) = figure.subplots(), self.runs
        edges, (low, high), log_x = self.bins
        if len(values):
            axes.stairs(self.table()["runs"].to_numpy(), edges, fill=True, facecolor=BLUE)
            if self.quantity == RATIO:  # theory's 1 in sight
                low, high = min(low, 0.95), max(high, 1.05)
                axes.axvline(1, **THEORY)
            if log_x:
                axes.set_xscale("log")
                plain_ticks(axes, "x", (low, high))
            axes.set_xlim(low, high)
        else:
            axes.text(0.5, 0.5, "no run has a value", transform=axes.transAxes, ha="center")
        if log:
            axes.set_yscale("log")
        else:
            axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set(xlabel=label(self.quantity, self.unit), ylabel="number of runs")
        light_grid(axes)
        self.notes.append(f"{len(values):,} of {total:,} runs: {self.meaning}.")
        if beyond := int(((values < low) | (values > high)).sum()):
            self.notes.append(f"Beyond the ends of the abscissa: {beyond:,}.")
        return []


class Scatter(Picture):
    """Runs that reverse, evenly thinned where they are many, in colours of a short axis."""

    name = "scatter"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        self.column = x or "t_rgh"
        if self.column == "t_r":
            raise ConfigError("--x t_r: it is the ordinate of a scatter; choose another column")
        short = [n for n in layout.several if n != x and layout.lengths[n] <= len(SERIES)]
        super().__init__(layout, short[:1], (6.4, 4.6))
        self.unit, _ = layout.column(self.column, "--x")

    @cached_property
    def points(self) -> tuple[Floats, int]:
        """Column, ``t_r`` and cell, shape (3, points), and the number of runs before thinning."""
        parts = [np.empty((3, 0))]
        for rows in self.layout.rows(("case", "sample", "t_r", "status", self.column)):
            x, t_r = floats(rows.column(self.column)), floats(rows.column("t_r"))
            found = np.stack([x, t_r, self.layout.cells(rows)])
            shown = (codes(rows.column("status"), ("ok",)) == 0) & (found[2] >= 0)
            parts.append(found[:, shown & np.isfinite(found).all(axis=0)])
        found = np.concatenate(parts, axis=1)
        return found[:, :: max(1, -(-found.shape[1] // MOST_POINTS))], found.shape[1]

    def __len__(self) -> int:
        return int(self.points[0].shape[1])

    def table(self) -> pa.Table:
        """Return the points, with their values along the axis."""
        (x, t_r, cell), lengths = self.points[0], self.layout.lengths
        own = {}
        for axis in self.axes:
            place = np.unravel_index(cell.astype(int), [*lengths.values()])
            own[axis.name] = axis.values[place[[*lengths].index(axis.name)]]
        return pa.table({self.column: x, "t_r": t_r} | own)

    def words(self) -> str:
        """Return how many they are."""
        return f"{len(self):,} of {self.points[1]:,} runs that reverse"

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw points, and theory where it is the abscissa.

        By default the ordinate is logarithmic, and the abscissa if it is positive and spreads
        widely.
        """
        axes, handles = figure.subplots(), []
        x, t_r, *along = (column.to_numpy() for column in self.table().columns)
        own = along[0] if along else np.zeros(len(x))
        for value, (colour, marker) in zip(np.unique(own), SERIES, strict=False):
            here = own == value
            look: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": "", "mew": 0}
            axes.plot(x[here], t_r[here], ms=2.6, alpha=0.6, rasterized=True, **look)
            handles += [entry(value_text(a.name, value), ms=5, **look) for a in self.axes]
        wide = bool(0 < WIDE * x.min() < x.max())
        scale_axis(axes, "x", x, wide if log is None else log, self.column)
        scale_axis(axes, "y", t_r, log is not False)
        if self.column == "t_rgh":
            # In small steps: where one axis alone is logarithmic, the line is curved.
            low, high = axes.get_xlim()
            theory = np.linspace(max(low, 0.0), high, 400)[1:]
            axes.plot(theory, theory, **THEORY, scalex=False, scaley=len(x) == 1)
            handles.append(entry("theory", **THEORY))
        axes.set(xlabel=label(self.column, self.unit), ylabel=label("t_r"))
        light_grid(axes)
        self.notes.append(f"Times of the first reversal, {self.words()}.")
        return handles
