"""Reversal times against what varies: mean, spread, and the theory of Garcia and Hubbard."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rattlesweep.analysis.plots.layout import Axis, Layout
from rattlesweep.analysis.plots.picture import (
    Picture,
    abscissa,
    draw_panels,
    entry,
    legend_above,
    plain_ticks,
    scale_axis,
)
from rattlesweep.analysis.style import GREY, SERIES, THEORY, label, light_grid, symbol, value_text
from rattlesweep.sweeps.counts import share

# With more points than this, markers and bars hide the curve.
MOST_MARKERS = 40


class Times(Picture):
    """The mean of ``t_r`` over type R with its spread, and theory, dashed.

    The first axis is the abscissa, the second makes curves, the others panels. By default the
    abscissa is logarithmic if its values are spread so, and the ordinate always.
    """

    name = "times"
    caption = (
        "Times t_r of the first reversal (the first zero of the spin) of type R: mean, standard "
        "deviation and standard error of the mean; theory is the mean of Garcia and Hubbard's time."
    )
    relative = False
    """Whether times are in units of theory's; their ordinate is then linear and begins at 0."""

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Tell whether there is something to plot against."""
        return bool(layout.axes)

    @classmethod
    def order(cls, layout: Layout, x: str | None) -> Sequence[str]:
        """Return the abscissa, then what becomes curves, the longest, then what becomes panels."""
        left = layout.lengths
        names = [*layout.targets, *layout.bodies, *layout.launch]
        if cls.relative:
            names = [*(n for n in names if n == "n_i"), *(n for n in names if n != "n_i")]
        along = abscissa(layout, names, x)
        rest = [n for n in (*layout.launch, *layout.targets, *layout.bodies) if n != along]
        curves = sorted((n for n in rest if left[n] > 1), key=lambda name: -left[name])
        return (along, *(curves or [n for n in left if n != along][:1]))

    def size(self) -> tuple[float, float]:
        """Return a size by the number of panels."""
        return float(np.clip(1.6 + 2.6 * np.prod(self.shape[2:]), 6.0, 13)), 4.2

    def draw(self, figure: Any, log: bool | None) -> None:
        """Draw curves with markers and bars, or with bands where points are many."""
        x, *rest = self.axes
        curves, panes = (rest or [Axis("", np.zeros(1), np.zeros(1, int))])[0], rest[1:]
        shape = (len(x.values), len(curves.values), *(len(axis.values) for axis in panes))
        cells, relative = self.cells, self.relative
        moments = cells.ratio if relative else cells.t_r
        log_x = x.logarithmic(log)
        log_y = bool(log) if relative else log is not False
        marked = len(x.values) <= MOST_MARKERS
        count = len(curves.values)  # of which as many are shown as the eye tells apart
        shown = np.unique(np.linspace(0, count - 1, min(count, len(SERIES))).round().astype(int))
        errors = np.nan_to_num(moments.errors())
        if not relative:  # and what the runs add by their own errors, where these are recorded
            errors += np.nan_to_num(cells.t_r_error.means())
        mean, spread, error, theory, kept = (
            part.reshape(shape)
            for part in (moments.means(), np.nan_to_num(moments.deviations()), errors,
                         cells.t_rgh.means(), share(moments.count, cells.ok))
        )  # fmt: skip
        panels = draw_panels(figure, (), panes)
        for axes, where in panels:
            for place, (colour, marker) in zip(shown, SERIES, strict=False):
                here: Any = (slice(None), place, *where)
                middle, half = mean[here], spread[here]
                # On a logarithmic axis a bar that reaches zero has no end; it stops at a tenth.
                low = np.minimum(half, 0.9 * middle) if log_y else half
                for part in _pieces(x):
                    axes.plot(x.values[part], middle[part], color=colour, linewidth=1.1)
                    if not relative:
                        axes.plot(x.values[part], theory[here][part], zorder=1.5,
                                  **{**THEORY, "color": colour})  # fmt: skip
                if marked:
                    bars = {"fmt": "none", "ecolor": colour, "capsize": 0}
                    axes.errorbar(x.values, middle, (low, half), elinewidth=0.8, **bars)
                    axes.errorbar(x.values, middle, error[here], elinewidth=2.4, **bars)
                    # Hollow where most runs do not reverse: the mean is then that of a few.
                    few = kept[here] < 0.5
                    for which, face in ((~few, colour), (few, "white")):
                        axes.plot(x.values[which], middle[which], marker, color=colour, ms=4.5,
                                  mfc=face, mew=1)  # fmt: skip
                elif (half > 0).any():
                    axes.fill_between(x.values, middle - low, middle + half, color=colour,
                                      alpha=0.18, linewidth=0)  # fmt: skip
            if relative:
                axes.axhline(1, **THEORY, zorder=1.5)
            scale_axis(axes, "x", x.values, log_x, x.name)
            light_grid(axes)
            if log_y:
                axes.set_yscale("log")
                plain_ticks(axes, "y", axes.get_ylim())
            elif relative:
                axes.set_ylim(0, 1.08 * float(np.nanmax(mean + spread, initial=1.0)))
        figure.supxlabel(label(x.name), fontsize="medium")
        panels[0][0].set_ylabel(label("ratio" if relative else "t_r"))

        handles = [
            entry(value_text(curves.name, float(curves.values[place])), color=colour, ms=4.5,
                  marker=marker if marked else "", linestyle="-")
            for place, (colour, marker) in zip(shown, SERIES, strict=False) if count > 1
        ]  # fmt: skip
        theory_text = r"$t_r = t_{rGH}$" if relative else r"mean $t_{rGH}$"
        handles.append(entry(f"theory: {theory_text}", **THEORY))
        if (cells.t_r.count > 1).any():
            bars_text = "bars: standard deviation;\nthick: error of the mean"
            bars_text = bars_text if marked else "band: standard deviation"
            handles.append(entry(bars_text, color=GREY, linestyle="-", linewidth=0.9))
        if marked and (share(cells.t_r.count, cells.ok) < 0.5).any():
            words = "hollow: fewer than half reverse"
            handles.append(entry(words, color=GREY, marker="o", mfc="white", ms=4.5))
        some = f"{len(shown)} of {count} values of {symbol(curves.name)}"
        legend_above(figure, handles, 1.95, some if len(shown) < count else None)


class Ratio(Times):
    """The mean of ``t_r/t_rGH``, run by run."""

    name = "ratio"
    caption = "Times of the first reversal of type R in units of Garcia and Hubbard's, run by run."
    relative = True


def _pieces(x: Axis) -> list[slice]:
    """Return the parts in which a curve is whole: the two directions of spin are not joined."""
    border = int(np.searchsorted(x.values, 0.0))
    if x.name != "n_i" or border in (0, len(x.values)):
        return [slice(None)]
    return [slice(0, border), slice(border, None)]
