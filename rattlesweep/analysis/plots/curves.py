"""Against one thing that varies: shares of the types, and reversal times beside the theory."""

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
    plain_ticks,
    scale_axis,
)
from rattlesweep.analysis.style import (
    GREY,
    INK,
    SERIES,
    THEORY,
    TYPE_STYLE,
    label,
    light_grid,
    value_text,
)
from rattlesweep.arrays import Floats
from rattlesweep.sweeps.counts import share, wilson

# With fewer values along the axis, areas between them would say nothing: bars.
FEWEST_FOR_AREAS = 4
# With more points than this, markers and bars hide the curve.
MOST_MARKERS = 40
UNSURE: dict[str, Any] = {"facecolor": "#FFFFFFB0", "edgecolor": INK, "hatch": "xxxxxx",
                          "linewidth": 0, "label": "type not sure"}  # fmt: skip
BONDI_LABEL = "Bondi"


class Fractions(Picture):
    """Shares of the types against the first axis; the second makes rows, the others columns."""

    name = "fractions"

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Tell whether there are many bodies, and something to plot their shares against."""
        return bool(layout.axes) and layout.population

    @classmethod
    def order(cls, layout: Layout, x: str | None) -> Sequence[str]:
        """Make rows of the oscillation, as in the paper, and columns of the others."""
        first = abscissa(layout, [*layout.targets, *layout.bodies, *layout.launch], x)
        others = [n for n in (*layout.launch, *layout.targets, *layout.bodies)
                  if n not in (first, "omega_xy0") and layout.lengths[n] > 1]  # fmt: skip
        if first != "omega_xy0":
            return (first, *(n for n in layout.launch if n == "omega_xy0"), *others)
        # An axis of a single value takes the row, so that the rest makes columns.
        single = [n for n, count in layout.lengths.items() if count == 1 and len(others) == 1]
        return (first, *single[:1], *others)

    def size(self) -> tuple[float, float]:
        """Return a size by the number of panels."""
        _, down, *across = (*self.shape, 1)
        width = np.clip(2.2 + 1.6 * np.prod(across), 6.4, 14)
        return float(width), 1.5 + 1.35 * max(down, 1.4)

    def side_by_side(self) -> bool:
        """Tell whether there are bars instead of areas."""
        return self.shape[0] < FEWEST_FOR_AREAS

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw areas, or bars where values are few, and Bondi's share, which no area shows."""
        x, cells, bars = self.axes[0], self.cells, self.side_by_side()
        panels = draw_panels(figure, self.axes[1:2], self.axes[2:], label(x.name))
        at = np.arange(len(x.values), dtype=float) if bars else x.values
        marks = [(name, mark) for name, mark in TYPE_STYLE.items() if name in cells.types]
        bondi = self.grid(share(cells.bondi, cells.steady))

        def stack(axes: Any, below: Floats, above: Floats, **look: Any) -> None:
            if bars:
                axes.bar(at, above - below, 0.7, below, **look)
            else:
                axes.fill_between(at, below, above, **look)

        for axes, where in panels:
            here: Any = (slice(None), *where)
            ok = self.grid(cells.ok)[here]
            part = np.zeros_like(ok)
            for name, mark in marks:
                below, part = share(part, ok), part + self.grid(cells.types[name])[here]
                middle = share(part, ok)
                stack(axes, below, middle, label=mark.label, facecolor=mark.colour,
                      hatch=mark.hatch, linewidth=0)  # fmt: skip
                unsure = share(self.grid(cells.unsure_types[name])[here], ok)
                if (unsure > 0).any():
                    stack(axes, middle - unsure, middle, **UNSURE)
                # Wilson's interval of the border above, itself a share of the runs.
                low, high = wilson(part, ok)
                real = (part > 0) & (part < ok)
                drawn = axes.errorbar(
                    at[real], middle[real], [(middle - low)[real], (high - middle)[real]],
                    fmt="none", ecolor="#000000", elinewidth=0.9, capsize=1.6, capthick=0.9,
                    zorder=4,
                )  # fmt: skip
                for artist in drawn.get_children():
                    artist.set_clip_on(False)
            if np.isfinite(bondi).any():
                axes.plot(at, 1 - bondi[here], "k^", ms=4, mec="white", mew=0.5, zorder=5,
                          label=BONDI_LABEL, clip_on=False)  # fmt: skip
            axes.set(ylim=(0, 1), yticks=[0, 0.5, 1])
            if bars:
                axes.set_xticks(at, [f"{value:g}".replace("-", "−") for value in x.values])
                axes.set_xlim(-0.6, len(at) - 0.4)
            else:
                scale_axis(axes, "x", x.values, x.logarithmic(log), x.name)
                axes.set_xlim(x.values[0], x.values[-1])
        figure.supylabel("share of bodies", fontsize="medium")
        self.notes.append("Shares of the runs with status ok, with 95 % intervals (Wilson).")
        known: dict[str, Any] = {}
        for axes, _ in panels:
            handles, words = axes.get_legend_handles_labels()
            known |= zip(words, handles, strict=True)
        for word, sentence in (
            (UNSURE["label"], "Crossed: the type might change, were the runs more accurate."),
            (BONDI_LABEL, "The share above a triangle is that of the bodies whose steady spin is "
             "linearly stable according to theory, |n_c1| < |n_i|."),
        ):  # fmt: skip
            if word in known:
                known |= {word: known.pop(word)}  # last, in whatever order they were drawn
                self.notes.append(sentence)
        return [*known.values()]


class Times(Picture):
    """The mean of ``t_r`` over type R with its spread, and theory, dashed.

    The first axis is the abscissa, the second makes curves, the others panels. By default the
    abscissa is logarithmic if its values are spread so, and the ordinate always.
    """

    name = "times"
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

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
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
            self.grid(part).reshape(shape)
            for part in (moments.means(), np.nan_to_num(moments.deviations()), errors,
                         cells.t_rgh.means(), share(moments.count, cells.ok))
        )  # fmt: skip
        panels = draw_panels(figure, (), panes, label(x.name))
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
        panels[0][0].set_ylabel(label("ratio" if relative else "t_r"))

        handles = [
            entry(value_text(curves.name, float(curves.values[place])), color=colour, ms=4.5,
                  marker=marker if marked else "", linestyle="-")
            for place, (colour, marker) in zip(shown, SERIES, strict=False) if count > 1
        ]  # fmt: skip
        handles.append(entry("theory", **{**THEORY, "color": INK if relative else GREY}))
        what = "t_r/t_rGH, taken run by run," if relative else "the time t_r of the first reversal"
        self.notes.append(f"Mean of {what} over the runs that reverse (type R).")
        if not relative:
            self.notes.append("Theory: the mean of Garcia and Hubbard's time over all runs.")
        if (cells.t_r.count > 1).any():
            self.notes.append(
                "Thin bars: standard deviation; thick bars: error of the mean." if marked
                else "Band: standard deviation."
            )  # fmt: skip
        if marked and (share(cells.t_r.count, cells.ok) < 0.5).any():
            self.notes.append("Hollow: fewer than half of the runs reverse.")
        if len(shown) < count:
            self.notes.append(f"Shown are {len(shown)} of {count} values of {curves.name}.")
        return handles


class Ratio(Times):
    """The mean of ``t_r/t_rGH``, run by run."""

    name = "ratio"
    relative = True


def _pieces(x: Axis) -> list[slice]:
    """Return the parts in which a curve is whole: the two directions of spin are not joined."""
    border = int(np.searchsorted(x.values, 0.0))
    if x.name != "n_i" or border in (0, len(x.values)):
        return [slice(None)]
    return [slice(0, border), slice(border, None)]
