"""Reversal times against what varies: mean, spread, and the theory of Garcia and Hubbard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D

from rattlesweep.study.plots.counts import Counts
from rattlesweep.study.plots.kind import Kind, Lengths, abscissa
from rattlesweep.study.plots.layout import Layout
from rattlesweep.study.plots.panels import draw_panels, legend_above, plain_ticks, scale_axis
from rattlesweep.study.style import (
    GREY,
    SERIES,
    THEORY,
    TIME,
    label,
    light_grid,
    symbol,
    value_text,
)
from rattlesweep.sweeps.tables.cells import share

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# With more points than this, markers and bars hide the curve.
MOST_MARKERS = 40
# Width over which curves stand side by side: shares of the distance of two points and of all.
DODGE, DODGE_MOST = 0.34, 0.06


def draw(ratio: bool, figure: Any, counted: Counts, log: bool | None) -> None:
    """The mean of ``t_r`` or of ``t_r/t_rGH`` over type R with its spread, and theory, dashed.

    Unless told otherwise, the abscissa is logarithmic as its values are spread, and the ordinate
    for times and not for ratios.
    """
    x, curves, *panes = counted.axes
    cells = counted.cells
    moments = cells.ratio if ratio else cells.t_r
    log_y = bool(log) if ratio else log is not False
    # Evenly chosen where there are more than the eye tells apart.
    count = len(curves.values)
    shown = np.unique(np.linspace(0, count - 1, min(count, len(SERIES))).round().astype(np.int64))
    # Theory stands aside like the means: a step aside must not look like a disagreement.
    at = _side_by_side(x.values, len(shown), x.logarithmic if log is None else log)
    mean, spread, error, theory, kept = (
        counted.grid(part)
        for part in (moments.means(), np.nan_to_num(moments.deviations()), moments.errors(),
                     cells.t_rgh.means(), share(moments.count, cells.ok))
    )  # fmt: skip
    panels = draw_panels(figure, (), panes)
    for panel in panels:
        axes = panel.axes
        for abscissas, place, (colour, marker) in zip(at, shown, SERIES, strict=False):
            here: Any = (slice(None), place, *panel.where)
            half = spread[here]
            # On a logarithmic axis a bar that reaches zero has no end; it stops at a tenth.
            low = np.minimum(half, 0.9 * mean[here]) if log_y else half
            for part in _pieces(x.name, x.values):
                axes.plot(abscissas[part], mean[here][part], color=colour, linewidth=1.1)
                if not ratio:
                    axes.plot(abscissas[part], theory[here][part], zorder=1.5,
                              **{**THEORY, "color": colour})  # fmt: skip
            if len(x.values) <= MOST_MARKERS:
                _marks(axes, abscissas, mean[here], (low, half), error[here], kept[here] < 0.5,
                       colour, marker)  # fmt: skip
            elif (half > 0).any():
                axes.fill_between(abscissas, mean[here] - low, mean[here] + half, color=colour,
                                  alpha=0.18, linewidth=0)  # fmt: skip
        if ratio:
            axes.axhline(1, **THEORY, zorder=1.5)
        scale_axis(axes, "x", x, log)
        light_grid(axes)
        if log_y:
            axes.set_yscale("log")
            plain_ticks(axes, "y", axes.get_ylim())
        elif ratio:
            top = float(np.nanmax(mean + spread, initial=1.0))
            axes.set_ylim(0, 1.08 * top)
    figure.supxlabel(label(x.name), fontsize="medium")
    panels[0].axes.set_ylabel(r"$t_r/t_{rGH}$" if ratio else f"$t_r$ ({TIME})")
    _legend(figure, counted, shown, r"$t_r = t_{rGH}$" if ratio else r"mean $t_{rGH}$")


def _marks(
    axes: Any,
    x: Floats,
    mean: Floats,
    spread: tuple[Floats, Floats],
    error: Floats,
    few: NDArray[np.bool_],
    colour: str,
    marker: str,
) -> None:
    """Means with bars, hollow where most runs do not reverse: the mean is then one of a few."""
    bars = {"fmt": "none", "ecolor": colour, "capsize": 0}
    axes.errorbar(x, mean, spread, elinewidth=0.8, **bars)
    axes.errorbar(x, mean, np.nan_to_num(error), elinewidth=2.4, **bars)
    for which, face in ((~few, colour), (few, "white")):
        axes.plot(x[which], mean[which], marker, color=colour, ms=4.5, mfc=face, mew=1)


def _pieces(name: str, values: Floats) -> list[slice]:
    """Where a curve is whole: the two directions of the spin are not joined."""
    border = int(np.searchsorted(values, 0.0))
    if name != "n_i" or border in (0, len(values)):
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


def _legend(figure: Any, counted: Counts, shown: NDArray[np.int64], theory: str) -> None:
    x, curves = counted.axes[:2]
    marked = len(x.values) <= MOST_MARKERS
    handles: list[Any] = []
    if len(curves.values) > 1:
        handles += [
            Line2D([], [], color=colour, ms=4.5, marker=marker if marked else "",
                   label=value_text(curves.name, float(curves.values[place])))
            for place, (colour, marker) in zip(shown, SERIES, strict=False)
        ]  # fmt: skip
    handles.append(Line2D([], [], **THEORY, label=f"theory: {theory}"))
    reversed_ = counted.cells.t_r.count
    if (reversed_ > 1).any():
        text = "bars: standard deviation;\nthick: error of the mean"
        text = text if marked else "band: standard deviation"
        handles.append(Line2D([], [], color=GREY, linewidth=0.9, label=text))
    if len(shown) > 1 and 2 <= len(x.values) <= MOST_MARKERS:
        handles.append(Line2D([], [], linestyle="", label="points moved sideways\nto stay apart"))
    if marked and (share(reversed_, counted.cells.ok) < 0.5).any():
        handles.append(Line2D([], [], color=GREY, marker="o", mfc="white", ms=4.5, linestyle="",
                              label="hollow: fewer than half reverse"))  # fmt: skip
    title = None
    if len(shown) < len(curves.values):
        title = f"{len(shown)} of {len(curves.values)} values of {symbol(curves.name)}"
    legend_above(figure, handles, 1.95, title)


def _order(first: Sequence[str], layout: Layout, left: Lengths, x: str | None) -> tuple[str, ...]:
    """The abscissa, then what becomes curves, then what becomes panels."""
    names = [*layout.targets, *layout.bodies, *layout.launch]
    along = abscissa(left, [*(n for n in first if n in left), *names], x)
    rest = [n for n in (*layout.launch, *layout.targets, *layout.bodies) if n != along]
    # The longest becomes curves; curves there must be, if only one.
    curves = sorted((n for n in rest if left[n] > 1), key=lambda name: -left[name])
    return (along, *(curves or [n for n in left if n != along][:1]))


def _size(counted: Counts) -> tuple[float, float]:
    return float(np.clip(1.6 + 2.6 * np.prod(counted.shape[2:]), 6.0, 13)), 4.2


TIMES = Kind(
    name="times",
    caption="Reversal times of type R: mean, standard deviation and standard error of the mean; "
    "theory is the mean of Garcia and Hubbard's time.",
    fits=lambda layout, left: bool(left),
    order=partial(_order, ()),
    gather=Counts,
    size=_size,
    draw=partial(draw, False),
)
RATIO = replace(
    TIMES,
    name="ratio",
    caption="Reversal times of type R in units of Garcia and Hubbard's, run by run.",
    order=partial(_order, ("n_i",)),
    draw=partial(draw, True),
)
