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
from rattlesweep.study.plots.panels import Panel, draw_panels, legend_above, plain_ticks, scale_axis
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
from rattlesweep.sweeps.tables.cells import Moments, share

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# With more points than this, markers and bars hide the curve.
MOST_MARKERS = 40
# Width over which curves stand side by side: shares of the distance of two points and of all.
DODGE, DODGE_MOST = 0.34, 0.06


def draw_times(figure: Any, counted: Counts, log: bool | None) -> None:
    """The mean of ``t_r`` over type R with its spread, and the mean of ``t_rGH`` as theory.

    Unless told otherwise, the ordinate is logarithmic, the abscissa as its values are spread.
    """
    panels = _draw(figure, counted, counted.cells.t_r, log, floor=log is not False)
    x, places = counted.axes[0], _shown(counted)
    # Beside each other like the means: a step aside must not look like a disagreement.
    at = _side_by_side(x.values, len(places), x.logarithmic if log is None else log)
    for panel in panels:
        for k, (place, (colour, _)) in enumerate(zip(places, SERIES, strict=False)):
            theory = counted.grid(counted.cells.t_rgh.means())[(slice(None), place, *panel.where)]
            for part in _pieces(x.name, x.values):
                panel.axes.plot(at[k][part], theory[part], zorder=1.5,
                                **{**THEORY, "color": colour})  # fmt: skip
        if log is not False:
            _log_ordinate(panel.axes)
    _finish(figure, panels, counted, f"$t_r$ ({TIME})", r"theory: mean $t_{rGH}$")


def draw_ratio(figure: Any, counted: Counts, log: bool | None) -> None:
    """The mean of ``t_r/t_rGH`` over type R with its spread."""
    panels = _draw(figure, counted, counted.cells.ratio, log, floor=bool(log))
    mean, spread = counted.cells.ratio.means(), np.nan_to_num(counted.cells.ratio.deviations())
    top = float(np.nanmax(mean + spread)) if np.isfinite(mean).any() else 1.0
    for panel in panels:
        panel.axes.axhline(1, **THEORY, zorder=1.5)
        if log:
            _log_ordinate(panel.axes)
        else:
            panel.axes.set_ylim(0, 1.08 * max(top, 1.0))
    _finish(figure, panels, counted, r"$t_r/t_{rGH}$", r"theory: $t_r = t_{rGH}$")


def _log_ordinate(axes: Any) -> None:
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    plain_ticks(axes, "y", (float(low), float(high)))


def _shown(counted: Counts) -> NDArray[np.int64]:
    """Places of the curves: evenly chosen where there are more than the eye tells apart."""
    count = len(counted.axes[1].values)
    return np.unique(np.linspace(0, count - 1, min(count, len(SERIES))).round().astype(np.int64))


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


def _draw(
    figure: Any, counted: Counts, moments: Moments, log: bool | None, *, floor: bool
) -> list[Panel]:
    x = counted.axes[0]
    places = _shown(counted)
    mean, spread, error = (
        counted.grid(part) for part in (moments.means(), moments.deviations(), moments.errors())
    )
    kept = counted.grid(share(moments.count, counted.cells.ok))
    panels = draw_panels(figure, (), counted.axes[2:])
    at = _side_by_side(x.values, len(places), x.logarithmic if log is None else log)
    for panel in panels:
        for k, (place, (colour, marker)) in enumerate(zip(places, SERIES, strict=False)):
            here: Any = (slice(None), place, *panel.where)
            m, half = mean[here], np.nan_to_num(spread[here])
            # On a logarithmic axis a bar that reaches zero has no end; it stops at a tenth.
            low = np.minimum(half, 0.9 * m) if floor else half
            for part in _pieces(x.name, x.values):
                panel.axes.plot(at[k][part], m[part], color=colour, linewidth=1.1)
            if len(x.values) > MOST_MARKERS:
                if (half > 0).any():
                    panel.axes.fill_between(at[k], m - low, m + half, color=colour, alpha=0.18,
                                            linewidth=0)  # fmt: skip
                continue
            bars = {"fmt": "none", "ecolor": colour, "capsize": 0}
            panel.axes.errorbar(at[k], m, [low, half], elinewidth=0.8, **bars)
            panel.axes.errorbar(at[k], m, np.nan_to_num(error[here]), elinewidth=2.4, **bars)
            # Hollow where most runs do not reverse: the mean is then one of a few.
            few = kept[here] < 0.5
            for which, face in ((~few, colour), (few, "white")):
                panel.axes.plot(at[k][which], m[which], marker, color=colour, ms=4.5, mfc=face,
                                mew=1)  # fmt: skip
        scale_axis(panel.axes, "x", x, log)
        light_grid(panel.axes)
    return panels


def _finish(figure: Any, panels: list[Panel], counted: Counts, ordinate: str, theory: str) -> None:
    x, curves = counted.axes[:2]
    figure.supxlabel(label(x.name), fontsize="medium")
    panels[0].axes.set_ylabel(ordinate)
    handles: list[Any] = []
    places = _shown(counted)
    if len(curves.values) > 1:
        handles += [
            Line2D([], [], color=colour, ms=4.5,
                   marker=marker if len(x.values) <= MOST_MARKERS else "",
                   label=value_text(curves.name, float(curves.values[place])))
            for place, (colour, marker) in zip(places, SERIES, strict=False)
        ]  # fmt: skip
    handles.append(Line2D([], [], **THEORY, label=theory))
    if (counted.cells.t_r.count > 1).any():
        text = "bars: standard deviation;\nthick: error of the mean"
        if len(x.values) > MOST_MARKERS:
            text = "band: standard deviation"
        handles.append(Line2D([], [], color=GREY, linewidth=0.9, label=text))
    if len(places) > 1 and 2 <= len(x.values) <= MOST_MARKERS:
        handles.append(Line2D([], [], linestyle="", label="points moved sideways\nto stay apart"))
    kept = share(counted.cells.t_r.count, counted.cells.ok)
    if len(x.values) <= MOST_MARKERS and (kept < 0.5).any():
        handles.append(Line2D([], [], color=GREY, marker="o", mfc="white", ms=4.5, linestyle="",
                              label="hollow: fewer than half reverse"))  # fmt: skip
    title = None
    if len(places) < len(curves.values):
        title = f"{len(places)} of {len(curves.values)} values of {symbol(curves.name)}"
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
    draw=draw_times,
)
RATIO = replace(
    TIMES,
    name="ratio",
    caption="Reversal times of type R in units of Garcia and Hubbard's, run by run.",
    order=partial(_order, ("n_i",)),
    draw=draw_ratio,
)
