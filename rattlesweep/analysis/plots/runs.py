"""Run by run: how a quantity is distributed, and reversal times against any column."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from matplotlib.ticker import MaxNLocator

from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.picture import (
    BESIDE,
    WIDE,
    Picture,
    entry,
    plain_ticks,
    scale_axis,
    unit_of,
)
from rattlesweep.analysis.style import (
    BLUE,
    FAILED,
    SERIES,
    THEORY,
    TYPE_STYLE,
    Mark,
    label,
    light_grid,
    value_text,
)
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.counts import codes, floats
from rattlesweep.text import counted

# As few and as many bins as a histogram of some runs and of very many can do with.
FEWEST, MOST = 8, 150
# Where a few values lie far out, the axis ends at these percentiles.
TAILS = (1, 99)
RATIO = "ratio"
# More points than this cover each other, and make a file large.
MOST_POINTS = 20_000


class Bins(NamedTuple):
    """Borders of bins that hold every value."""

    edges: Floats
    ends: tuple[float, float]  # of the axis
    beyond: int  # values beyond them
    few: bool  # whether each is around one value


class Distribution(Picture):
    """A histogram of ``t_r/t_rGH`` of type R, or of a column of all runs, and all runs by type.

    A column of few values has a bin around each of them. Other bins follow the data (Freedman and
    Diaconis), on a logarithmic axis where values are positive and spread widely, or are ratios;
    where a few values lie far out, the outermost bins hold them and reach beyond the axis.
    """

    name = "distribution"

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

    @property
    def logarithmic(self) -> bool:
        """Whether the abscissa is logarithmic."""
        low, high = self.values.min(initial=np.inf), self.values.max(initial=0.0)
        return bool(low > 0 and (self.quantity is None or high > WIDE * low))

    @cached_property
    def bins(self) -> Bins:
        """What the histogram counts by."""
        log = self.logarithmic
        v = np.log(self.values) if log else self.values
        exact = np.unique(v[: 100 * MOST])
        few = len(exact) <= MOST // 3 and len(exact := np.unique(v)) <= MOST // 3
        beyond = 0
        if few and len(exact) > 1:
            between = (exact[1:] + exact[:-1]) / 2
            first, last = 2 * exact[0] - between[0], 2 * exact[-1] - between[-1]
            edges = np.concatenate([[first], between, [last]])
            low, high = first, last
        elif few:
            middle = exact.sum()
            low, high = middle + np.array([-0.5, 0.5]) * (abs(middle) or 1.0)
            edges = np.array([low, high])
        else:
            least, quarter, half, most = np.percentile(v, (0, 25, 75, 100))
            width = 2 * (half - quarter or most - least) / np.cbrt(len(v))
            low, high = least, most
            if most - least > MOST * width:
                # A few values far out would leave all others in a few bins.
                low, high = np.percentile(v, TAILS)
                beyond = int(((v < low) | (v > high)).sum())
            number = int(np.clip((high - low) / width, FEWEST, MOST))
            edges = np.unique([least, *np.linspace(low, high, number + 1), most])
        if log:
            edges, low, high = np.exp(edges), np.exp(low), np.exp(high)
        if len(v):  # rounding must leave no value outside
            edges[0], edges[-1] = (
                min(edges[0], self.values.min()),
                max(edges[-1], self.values.max()),
            )
        return Bins(edges, (float(low), float(high)), beyond, few)

    def size(self) -> tuple[float, float]:
        """Return the size of two panels."""
        return 8.0, 3.6

    def table(self) -> pa.Table:
        """Return the histogram."""
        name, edges = self.quantity or RATIO, self.bins.edges
        counts = np.histogram(self.values, edges)[0]
        return pa.table({f"{name}_low": edges[:-1], f"{name}_high": edges[1:], "runs": counts})

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw the histogram, its ordinate logarithmic if asked for, and bars of the types."""
        main, side = figure.subplots(1, 2, width_ratios=(2.6, 1))
        mark = TYPE_STYLE["R"] if self.quantity is None else Mark(BLUE, "", "", "")
        if len(self.values):
            edges, (low, high), beyond, few = self.bins
            counts = self.table().column("runs").to_numpy()
            if few:
                main.bar(np.unique(self.values), counts, 0.7 * np.diff(edges), color=mark.colour)
            else:
                main.stairs(counts, edges, fill=True, facecolor=mark.colour, linewidth=0)
            if self.quantity is None:  # theory's 1 in sight
                low, high = min(low, 0.95), max(high, 1.05)
            if self.logarithmic:
                main.set_xscale("log")
                plain_ticks(main, "x", (low, high))
            main.set_xlim(low, high)
            if beyond:
                self.notes.append(f"Beyond the ends of the abscissa: {counted(beyond, 'run')}.")
        else:
            words = "no run reverses" if self.quantity is None else "no run has a value"
            main.text(0.5, 0.5, words, transform=main.transAxes, ha="center")
            main.set_xticks([])
        if log:
            main.set_yscale("log")
        else:
            main.yaxis.set_major_locator(MaxNLocator(integer=True))
        main.set_ylabel("number of runs")
        if self.quantity is None:
            main.axvline(1, **THEORY)
            main.set_xlabel(label(RATIO))
            self.notes.insert(
                0, "Left: runs that reverse, by the time of their first reversal over that of "
                "Garcia and Hubbard's theory, which is 1 at the dashed line. Right: all runs by "
                "type.")  # fmt: skip
        else:
            main.set_xlabel(label(self.quantity, self.unit))
            words = self.layout.stored.schema.field(self.quantity).metadata[b"description"].decode()
            self.notes.insert(0, f"Left: {self.quantity}, {words}. Right: all runs by type.")

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
        side.set_xlabel("number of runs")
        for axes in (main, side):
            axes.spines[["top", "right"]].set_visible(False)
        return []


class Scatter(Picture):
    """Runs that reverse, evenly thinned where they are many, in colours of an axis if it is short.

    They are every so many-th of all that could be shown.
    """

    name = "scatter"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        self.column = x or "t_rgh"
        if self.column == "t_r":
            raise ConfigError("--x t_r: it is the ordinate of a scatter; choose another column")
        super().__init__(layout, self.column, quantity)
        self.unit = unit_of(layout, self.column, "--x")

    @classmethod
    def order(cls, layout: Layout, x: str | None) -> Sequence[str]:
        """Colour by what has no more values than there are colours, launches before bodies."""
        names = [*layout.launch, *layout.targets, *layout.bodies]
        return [n for n in names if n != x and 1 < layout.lengths[n] <= len(SERIES)][:1]

    def size(self) -> tuple[float, float]:
        """Return the size of one panel."""
        return 6.4, 4.6

    @cached_property
    def points(self) -> tuple[Floats, int]:
        """Column, ``t_r`` and place along the axis, shape (3, points), and of how many runs."""
        parts, total, stride = [np.empty((3, 0))], 0, 1
        for rows in self.layout.rows(("case", "sample", "t_r", "status", self.column)):
            x, t_r = floats(rows.column(self.column)), floats(rows.column("t_r"))
            place = self.layout.cells(rows, self.axes)
            shown = (codes(rows.column("status"), ("ok",)) == 0) & (place >= 0)
            shown &= np.isfinite(x) & np.isfinite(t_r)
            found = np.stack([x, t_r, place])[:, shown]
            # The first, and every stride-th after it.
            parts.append(found[:, -total % stride :: stride])
            total += found.shape[1]
            while sum(part.shape[1] for part in parts) > MOST_POINTS:
                parts = [np.concatenate(parts, axis=1)[:, ::2]]
                stride *= 2
        return np.concatenate(parts, axis=1), total

    def __len__(self) -> int:
        """Return the number of points."""
        return int(self.points[0].shape[1])

    def table(self) -> pa.Table:
        """Return the points."""
        x, t_r, place = self.points[0]
        own = {axis.name: axis.values[place.astype(int)] for axis in self.axes}
        return pa.table({self.column: x, "t_r": t_r} | own)

    def words(self) -> str:
        """Return how many they are."""
        return f"{len(self):,} of {self.points[1]:,} runs that reverse"

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw points, and theory where it is the abscissa.

        By default the ordinate is logarithmic, and the abscissa if it is positive and spreads
        widely.
        """
        axes = figure.subplots()
        (x, t_r, place), total = self.points
        handles = []
        for k, (colour, marker) in zip(np.unique(place).astype(int), SERIES, strict=False):
            own = place == k
            look: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": "", "mew": 0}
            axes.plot(x[own], t_r[own], ms=2.6, alpha=0.6, rasterized=True, **look)
            for axis in self.axes:
                handles.append(entry(value_text(axis.name, float(axis.values[k])), ms=5, **look))
        wide = bool(0 < WIDE * x.min() < x.max())
        scale_axis(axes, "x", x, wide if log is None else log, self.column)
        scale_axis(axes, "y", t_r, log is not False)
        if self.column == "t_rgh":
            # In small steps: where one axis alone is logarithmic, the line is curved.
            low, high = axes.get_xlim()
            theory = np.linspace(max(low, 0.0), high, 400)[1:]
            axes.plot(theory, theory, **THEORY, scalex=False, scaley=len(x) == 1)
            handles.append(entry("theory", **THEORY))
        axes.set_xlabel(label(self.column, self.unit))
        axes.set_ylabel(label("t_r"))
        light_grid(axes)
        self.notes.append("Times of the first reversal, run by run.")
        if len(self) < total:
            self.notes.append(f"Shown are {len(self):,} of {total:,} runs that reverse.")
        return handles
