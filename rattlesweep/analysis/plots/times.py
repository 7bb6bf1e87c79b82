"""Reversal times against what varies: mean, spread, and the theory of Garcia and Hubbard."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from rattlesweep.arrays import Floats
from rattlesweep.analysis.plots.counts import Counted
from rattlesweep.analysis.plots.layout import Axis, Layout
from rattlesweep.analysis.plots.panels import (
    draw_panels,
    entry,
    legend_above,
    plain_ticks,
    scale_axis,
)
from rattlesweep.analysis.plots.picture import abscissa
from rattlesweep.analysis.style import (
    GREY,
    SERIES,
    THEORY,
    TIME,
    label,
    light_grid,
    symbol,
    value_text,
)
from rattlesweep.sweeps.counts import share

# With more points than this, markers and bars hide the curve.
MOST_MARKERS = 40
# Width over which curves stand side by side: shares of the distance of two points and of all.
DODGE, DODGE_MOST = 0.34, 0.06


class Times(Counted):
    """The mean of ``t_r`` over type R with its spread, and theory, dashed.

    The first axis is the abscissa, the second makes curves, the others panels. Unless told
    otherwise, the abscissa is logarithmic as its values are spread, and the ordinate always.
    """

    name = "times"
    caption = (
        "Reversal times of type R: mean, standard deviation and standard error of the mean; "
        "theory is the mean of Garcia and Hubbard's time."
    )
    relative = False
    """Whether times are in units of theory's; their ordinate is then linear, and begins at 0."""
    first: Sequence[str] = ()
    """What is the abscissa before all else."""

    @classmethod
    def fits(cls, layout: Layout) -> bool:
        """Where there is something to plot against."""
        return bool(layout.axes)

    @classmethod
    def order(cls, layout: Layout, x: str | None) -> Sequence[str]:
        """The abscissa, then what becomes curves, the longest, then what becomes panels."""
        left = layout.lengths
        names = [*layout.targets, *layout.bodies, *layout.launch]
        along = abscissa(layout, [*(n for n in cls.first if n in left), *names], x)
        rest = [n for n in (*layout.launch, *layout.targets, *layout.bodies) if n != along]
        curves = sorted((n for n in rest if left[n] > 1), key=lambda name: -left[name])
        # Curves there must be, if only one.
        return (along, *(curves or [n for n in left if n != along][:1]))

    def size(self) -> tuple[float, float]:
        """By the number of panels."""
        return float(np.clip(1.6 + 2.6 * np.prod(self.shape[2:]), 6.0, 13)), 4.2

    def draw(self, figure: Any, log: bool | None) -> None:
        """Curves with markers and bars, or with bands where points are many."""
        x, curves, *panes = self.axes
        moments = self.cells.ratio if self.relative else self.cells.t_r
        log_x = x.logarithmic(log)
        log_y = bool(log) if self.relative else log is not False
        # Evenly chosen where there are more than the eye tells apart.
        count = len(curves.values)
        shown = np.unique(np.linspace(0, count - 1, min(count, len(SERIES))).round().astype(int))
        # Theory stands aside like the means: a step aside must not look like a disagreement.
        at = _side_by_side(x.values, len(shown), log_x)
        errors = np.nan_to_num(moments.errors())
        if not self.relative:  # what the runs add by their own, where it is recorded
            errors += np.nan_to_num(self.cells.t_r_error.means())
        mean, spread, error, theory, kept = (
            self.grid(part)
            for part in (moments.means(), np.nan_to_num(moments.deviations()),
                         errors, self.cells.t_rgh.means(),
                         share(moments.count, self.cells.ok))
        )  # fmt: skip
        panels = draw_panels(figure, (), panes)
        for panel in panels:
            axes = panel.axes
            for abscissas, place, (colour, marker) in zip(at, shown, SERIES, strict=False):
                here: Any = (slice(None), place, *panel.where)
                middle, half = mean[here], spread[here]
                # On a logarithmic axis a bar that reaches zero has no end; it stops at a tenth.
                low = np.minimum(half, 0.9 * middle) if log_y else half
                for part in _pieces(x):
                    axes.plot(abscissas[part], middle[part], color=colour, linewidth=1.1)
                    if not self.relative:
                        axes.plot(abscissas[part], theory[here][part], zorder=1.5,
                                  **{**THEORY, "color": colour})  # fmt: skip
                if self._marked:
                    bars = {"fmt": "none", "ecolor": colour, "capsize": 0}
                    axes.errorbar(abscissas, middle, (low, half), elinewidth=0.8, **bars)
                    axes.errorbar(abscissas, middle, error[here], elinewidth=2.4, **bars)
                    # Hollow where most runs do not reverse: the mean is then one of a few.
                    few = kept[here] < 0.5
                    for which, face in ((~few, colour), (few, "white")):
                        axes.plot(abscissas[which], middle[which], marker, color=colour, ms=4.5,
                                  mfc=face, mew=1)  # fmt: skip
                elif (half > 0).any():
                    axes.fill_between(abscissas, middle - low, middle + half, color=colour,
                                      alpha=0.18, linewidth=0)  # fmt: skip
            if self.relative:
                axes.axhline(1, **THEORY, zorder=1.5)
            scale_axis(axes, "x", x.values, log_x, x.name)
            light_grid(axes)
            if log_y:
                axes.set_yscale("log")
                plain_ticks(axes, "y", axes.get_ylim())
            elif self.relative:
                axes.set_ylim(0, 1.08 * float(np.nanmax(mean + spread, initial=1.0)))
        figure.supxlabel(label(x.name), fontsize="medium")
        panels[0].axes.set_ylabel(r"$t_r/t_{rGH}$" if self.relative else f"$t_r$ ({TIME})")
        title = None
        if len(shown) < count:
            title = f"{len(shown)} of {count} values of {symbol(curves.name)}"
        legend_above(figure, self._legend(shown), 1.95, title)

    @property
    def _marked(self) -> bool:
        return self.shape[0] <= MOST_MARKERS

    def _legend(self, shown: Any) -> list[Line2D]:
        curves = self.axes[1]
        handles = [
            entry(value_text(curves.name, float(curves.values[place])), color=colour, ms=4.5,
                  marker=marker if self._marked else "", linestyle="-")
            for place, (colour, marker) in zip(shown, SERIES, strict=False)
            if len(curves.values) > 1
        ]  # fmt: skip
        theory = r"$t_r = t_{rGH}$" if self.relative else r"mean $t_{rGH}$"
        handles.append(entry(f"theory: {theory}", **THEORY))
        reversed_ = self.cells.t_r.count
        if (reversed_ > 1).any():
            bars = "bars: standard deviation;\nthick: error of the mean"
            bars = bars if self._marked else "band: standard deviation"
            handles.append(entry(bars, color=GREY, linestyle="-", linewidth=0.9))
        if len(shown) > 1 and self._marked and self.shape[0] > 1:
            handles.append(entry("points moved sideways\nto stay apart"))
        if self._marked and (share(reversed_, self.cells.ok) < 0.5).any():
            words = "hollow: fewer than half reverse"
            handles.append(entry(words, color=GREY, marker="o", mfc="white", ms=4.5))
        return handles


class Ratio(Times):
    """The mean of ``t_r/t_rGH``, run by run."""

    name = "ratio"
    caption = "Reversal times of type R in units of Garcia and Hubbard's, run by run."
    relative = True
    first = ("n_i",)


def _pieces(x: Axis) -> list[slice]:
    """Where a curve is whole: the two directions of the spin are not joined."""
    border = int(np.searchsorted(x.values, 0.0))
    if x.name != "n_i" or border in (0, len(x.values)):
        return [slice(None)]
    return [slice(0, border), slice(border, None)]


def _side_by_side(values: Floats, count: int, logarithmic: bool) -> Floats:
    """Abscissas of each curve, shape (curves, points), so that bars do not cover each other."""
    if len(values) < 2 or len(values) > MOST_MARKERS:
        return np.tile(values, (count, 1))
    at = np.log(values) if logarithmic else values
    places = (np.arange(count) - (count - 1) / 2) / max(count, 1)
    width = min(DODGE * float(np.diff(at).min()), DODGE_MOST * float(np.ptp(at)))
    moved = at + width * places[:, None]
    return np.exp(moved) if logarithmic else moved
