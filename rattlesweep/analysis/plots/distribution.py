"""Histograms of the runs."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator

from rattlesweep.analysis import style
from rattlesweep.analysis.plots.picture import SIDE, WIDE, Handle, Panel, Picture
from rattlesweep.analysis.style import THEORY, label
from rattlesweep.arrays import Floats

FEWEST_BINS = 8
MOST_BINS = 150


class HistogramBins(NamedTuple):
    """Edges of bins that hold every value, and whether they are logarithmic."""

    edges: Floats
    log: bool


class Distribution(Picture):
    """A histogram of ``t_r/t_rGH`` of type R, or of a column of all runs."""

    panel = (4.8, 2.2)

    @cached_property
    def values(self) -> Floats:
        """The quantity of each run with status ok, NaN where it has no value."""
        if self.quantity is not None:
            return self.read(self.quantity)[1]
        _, t_r, t_rgh = self.read("t_r", "t_rgh")
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio: Floats = t_r / t_rgh
        return ratio

    @property
    def known(self) -> Floats:
        """The values of the runs that have one."""
        return self.values[np.isfinite(self.values)]

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def bins(self) -> HistogramBins:
        """The bins."""
        values = self.known
        low = 0.0
        high = 1.0
        if len(values):
            low = values.min()
            high = values.max()
        if (values == values.round()).all() and high - low < MOST_BINS:
            # Around whole numbers.
            return HistogramBins(np.arange(low, high + 2) - 0.5, log=False)
        log = bool(low > 0 and (self.quantity is None or high > WIDE * low))
        places = np.log(values) if log else values
        distinct = np.unique(places)
        spacing = abs(low) / 5 or 1.0
        if len(distinct) > 1:
            spacing = np.diff(distinct).min()
        if len(distinct) <= SIDE and np.ptp(distinct) < MOST_BINS * spacing:
            # A bar around each value, between margins.
            around = spacing * np.array([-0.4, -0.25, 0.25, 0.4])
            bars = np.ravel(distinct[:, None] + around)
            return HistogramBins(np.exp(bars) if log else bars, log)
        # The rule of Freedman and Diaconis, within limits.
        width = 2 * np.ptp(np.percentile(places, (25, 75))) / np.cbrt(len(places))
        count = np.ptp(places) / max(width, 1e-300)
        count = int(np.clip(count, FEWEST_BINS, MOST_BINS))
        if log:
            edges = np.geomspace(low, high, count + 1)
        else:
            edges = np.linspace(low, high, count + 1)
        # The last bin holds the highest value in spite of rounding.
        edges[0] = low
        edges[-1] = np.nextafter(high, np.inf)
        return HistogramBins(edges, log)

    def table(self) -> pd.DataFrame:
        """Return the histogram."""
        name = "ratio"
        if self.quantity is not None:
            name = self.layout.name(self.quantity)
        edges = self.bins.edges
        counts, _ = np.histogram(self.known, edges)
        return pd.DataFrame(
            {f"{name}_low": edges[:-1], f"{name}_high": edges[1:], "runs": counts}
        )

    def alt(self) -> str:
        """Return between which values the middle half of the runs is."""
        name = "t_r/t_rGH"
        if self.quantity is not None:
            name = self.layout.name(self.quantity)
        sentence = f"Histogram of {name} of {len(self.known):,} runs"
        if not len(self.known):
            return sentence
        low, high = np.percentile(self.known, (25, 75))
        return f"{sentence}, half of them between {low:.3g} and {high:.3g}"

    def draw(self, panels: list[Panel], log: bool | None) -> list[Handle]:
        """Draw the bars, for ratios with a line where theory is."""
        axes = panels[0].axes
        edges, log_x = self.bins
        runs = self.table()["runs"]
        low, high = edges[[0, -1]]
        axes.stairs(runs, edges, fill=True, facecolor=style.BLUE)
        if self.quantity is None:
            low = min(low, 0.95)
            high = max(high, 1.05)
            axes.axvline(1, **THEORY)
            axes.set_xlabel(label("ratio"))
            meaning = "t_r/t_rGH of those that reverse; dashed: theory"
        else:
            unit, meaning = self.layout.column(self.quantity, "quantity")
            axes.set_xlabel(label(self.quantity, unit))
        style.scale_axis(axes, "x", (low, high), log_x)
        self.ylabel = "number of runs"
        axes.set_xlim(low, high)
        if log:
            axes.set_yscale("log")
        else:
            axes.yaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
        style.light_grid(axes)
        self.notes.append(f"{runs.sum():,} of {len(self.values):,} runs: {meaning}.")
        return []
