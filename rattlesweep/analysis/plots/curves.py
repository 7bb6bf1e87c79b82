"""Against one thing that varies: shares of the types, and reversal times beside the theory."""

from __future__ import annotations

from typing import Any

import numpy as np

from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.picture import (
    Picture,
    draw_panels,
    entry,
    ordered,
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
from rattlesweep.sweeps.counts import share, wilson

# Axes of so many values are long enough for an abscissa.
ENOUGH = 3
# With more points than this, markers and bars hide the curve.
MOST_MARKERS = 40
UNSURE: dict[str, Any] = {"facecolor": "#FFFFFFB0", "edgecolor": INK, "hatch": "xxxxxx",
                          "linewidth": 0, "label": "type not sure"}  # fmt: skip
BONDI_LABEL = "Bondi"


class Fractions(Picture):
    """Shares of the types against the first axis, in rows and columns of panels for the others."""

    name = "fractions"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        first = x or ordered(layout, ENOUGH)[0]
        # Rows of the oscillation, as in the paper.
        rest = sorted((n for n in layout.several if n != first), key=lambda n: n != "omega_xy0")
        down = 1 if len(rest) > 1 or rest == ["omega_xy0"] else 0
        high = layout.lengths[rest[0]] if down else 1
        wide = np.prod([layout.lengths[name] for name in rest[down:]])
        size = float(np.clip(2.2 + 1.6 * wide, 6.4, 14)), 1.5 + 1.35 * max(high, 1.4)
        super().__init__(layout, [first, *rest], size)
        self.rows, self.columns = self.axes[1 : 1 + down], self.axes[1 + down :]

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw the shares stacked, with Bondi's share, which no area shows."""
        x, cells = self.axes[0], self.cells
        marks = {name: mark for name, mark in TYPE_STYLE.items() if name in cells.types}
        bondi = self.grid(share(cells.bondi, cells.steady))
        known: dict[str, Any] = {}
        for axes, where in draw_panels(figure, self.rows, self.columns, label(x.name)):
            here: Any = (slice(None), *where)
            ok = self.grid(cells.ok)[here]
            part = np.zeros_like(ok)
            for name, mark in marks.items():
                below, part = share(part, ok), part + self.grid(cells.types[name])[here]
                above = share(part, ok)
                known[mark.label] = axes.stairs(
                    above, x.edges, baseline=below, fill=True, label=mark.label,
                    facecolor=mark.colour, hatch=mark.hatch, linewidth=0,
                )  # fmt: skip
                unsure = share(self.grid(cells.unsure_types[name])[here], ok)
                if (unsure > 0).any():
                    known[UNSURE["label"]] = axes.stairs(
                        above, x.edges, baseline=above - unsure, fill=True, **UNSURE
                    )
                # Wilson's interval of the border above, itself a share of the runs.
                low, high = wilson(part, ok)
                real = (part > 0) & (part < ok)
                axes.errorbar(
                    x.values[real], above[real], [(above - low)[real], (high - above)[real]],
                    fmt="none", ecolor="#000000", elinewidth=0.9, capsize=1.6, zorder=4,
                )  # fmt: skip
            if np.isfinite(bondi).any():
                (known[BONDI_LABEL],) = axes.plot(
                    x.values, 1 - bondi[here], "k^", ms=4, mec="white", mew=0.5, zorder=5,
                    label=BONDI_LABEL, clip_on=False,
                )  # fmt: skip
            scale_axis(axes, "x", x.values, x.logarithmic(log), x.name)
            axes.set(xlim=x.edges[[0, -1]], ylim=(0, 1), yticks=[0, 0.5, 1])
        figure.supylabel("share of bodies", fontsize="medium")
        self.notes.append("Shares of the runs with status ok, with 95 % intervals (Wilson).")
        if UNSURE["label"] in known:
            self.notes.append("Crossed: the type might change, were the runs more accurate.")
        if BONDI_LABEL in known:
            self.notes.append("Above a triangle: bodies whose steady spin is linearly stable "
                              "according to theory, |n_c1| < |n_i|.")  # fmt: skip
        words = [*(mark.label for mark in marks.values()), UNSURE["label"], BONDI_LABEL]
        return [known[word] for word in words if word in known]


class Times(Picture):
    """The mean of ``t_r`` over type R with its spread, and theory, dashed.

    The first axis is the abscissa, the second makes curves, the others panels. By default the
    abscissa is logarithmic if its values are spread so, and the ordinate always.
    """

    name = "times"
    relative = False
    """Whether times are in units of theory's; their ordinate is then linear and begins at 0."""

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        first = x or ordered(layout, ENOUGH, "n_i" if self.relative else "")[0]
        rest = [name for name in layout.several if name != first]
        rest.sort(key=lambda name: -layout.lengths[name])
        panels = np.prod([layout.lengths[name] for name in rest[1:]])
        size = float(np.clip(1.6 + 2.6 * panels, 6.0, 13)), 4.2
        super().__init__(layout, [first, *rest], size)

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw curves with markers and bars, or with bands where points are many."""
        x, *rest = self.axes
        curves, panes = rest[:1], rest[1:]
        cells, relative = self.cells, self.relative
        moments = cells.ratio if relative else cells.t_r
        log_y = bool(log) if relative else log is not False
        marked = len(x.values) <= MOST_MARKERS
        # As many curves as the eye tells apart.
        count = len(curves[0].values) if curves else 1
        shown = np.unique(np.linspace(0, count - 1, min(count, len(SERIES))).round().astype(int))
        looks = [(place, *look) for place, look in zip(shown, SERIES, strict=False)]
        errors = np.nan_to_num(moments.errors())
        if not relative:  # and what the runs add by their own errors, where these are recorded
            errors += np.nan_to_num(cells.t_r_error.means())
        mean, spread, error, theory, kept = (
            np.expand_dims(self.grid(part), [] if curves else 1)
            for part in (moments.means(), np.nan_to_num(moments.deviations()), errors,
                         cells.t_rgh.means(), share(moments.count, cells.ok))
        )  # fmt: skip
        # The two directions of spin are not joined.
        ends = [int(np.searchsorted(x.values, 0.0))] if x.name == "n_i" else []
        pieces = np.split(np.arange(len(x.values)), ends)

        panels = draw_panels(figure, (), panes, label(x.name))
        for axes, where in panels:
            for place, colour, marker in looks:
                here: Any = (slice(None), place, *where)
                middle, half = mean[here], spread[here]
                # On a logarithmic axis a bar that reaches zero has no end; it stops at a tenth.
                low = np.minimum(half, 0.9 * middle) if log_y else half
                for part in pieces:
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
            scale_axis(axes, "x", x.values, x.logarithmic(log), x.name)
            light_grid(axes)
            if log_y:
                axes.set_yscale("log")
                plain_ticks(axes, "y", axes.get_ylim())
            elif relative:
                axes.set_ylim(0, 1.08 * float(np.nanmax(mean + spread, initial=1.0)))
        panels[0][0].set_ylabel(label("ratio" if relative else "t_r"))

        what = "t_r/t_rGH, taken run by run," if relative else "the time t_r of the first reversal"
        self.notes.append(f"Mean of {what} over the runs that reverse (type R).")
        if not relative:
            self.notes.append("Theory: the mean of Garcia and Hubbard's time over all runs.")
        if (moments.count > 1).any():
            thick = "Thin bars: standard deviation; thick bars: error of the mean."
            self.notes.append(thick if marked else "Band: standard deviation.")
        if marked and (kept < 0.5).any():
            self.notes.append("Hollow: fewer than half of the runs reverse.")
        if len(shown) < count:
            self.notes.append(f"Shown are {len(shown)} of {count} values of {curves[0].name}.")
        handles = [
            entry(value_text(axis.name, axis.values[place]), color=colour, ms=4.5,
                  marker=marker if marked else "", linestyle="-")
            for axis in curves for place, colour, marker in looks
        ]  # fmt: skip
        return [*handles, entry("theory", **{**THEORY, "color": INK if relative else GREY})]


class Ratio(Times):
    """The mean of ``t_r/t_rGH``, run by run."""

    name = "ratio"
    relative = True
