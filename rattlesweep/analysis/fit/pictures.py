"""Figures of films with the runs that are fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.analysis.fit.film import Film
from rattlesweep.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MANY_ROWS = 30  # more are drawn as points, fewer as circles
WIDTHS = 7.2, 4.2  # of a figure of one film, and of each of several


def draw_films(
    films: Sequence[Film], expected: Sequence[Floats], path: str | Path | None = None
) -> Figure:
    """Draw data, fit and residuals of films side by side; write them to a `path`."""
    from rattlesweep.analysis import room, style
    from rattlesweep.analysis.onerun.figure import shown

    count = len(films)
    width = WIDTHS[0] if count == 1 else WIDTHS[1] * count
    with style.styled():
        figure = room.usual_figure(width, 4.6)
        panels = figure.subplots(
            2, count, sharex="col", height_ratios=(3, 1), squeeze=False
        )
        for place, (film, run) in enumerate(zip(films, expected, strict=True)):
            _draw_film(film, run, *panels[:, place])
            if count > 1:
                panels[0, place].set_title(f"film {place + 1}", fontsize=9)
        figure.align_ylabels(panels)
        return shown(figure, path)


def _draw_film(film: Film, run: Floats, top: Axes, bottom: Axes) -> None:
    from rattlesweep.analysis import style

    value_unit = film.value_column.unit
    value = film.value / value_unit.size
    expected = run / value_unit.size
    line: dict[str, Any] = {"color": style.VERMILION, "linewidth": 1.2}
    if film.kind == "reversal":
        # Single times, which no line joins.
        t = np.arange(1.0, len(value) + 1)
        t_label = "number of the reversal"
        line |= {"linestyle": "none", "marker": "x"}
    else:
        t = film.t / film.t_column.unit.size
        t_label = style.label("time", film.t_column.unit.name)
    marker = "." if len(t) > MANY_ROWS else "o"
    dots: dict[str, Any] = {
        "color": style.BLUE,
        "linestyle": "none",
        "marker": marker,
        "markersize": 2.5,
    }
    top.plot(t, value, label="measured", **dots)
    top.plot(t, expected, label="fit", **line)
    bottom.plot(t, value - expected, **dots)
    bottom.axhline(0, color=style.VERMILION, linewidth=1.0)
    top.set_ylabel(style.label(film.kind, value_unit.name))
    bottom.set_ylabel(style.label("residual", value_unit.name))
    bottom.set_xlabel(t_label)
    top.legend(loc="best")
    if film.kind == "reversal":
        bottom.set_xticks(t)
    for axes in (top, bottom):
        style.light_grid(axes)
