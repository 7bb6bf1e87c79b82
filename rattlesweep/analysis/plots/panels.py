"""Panels, one for each value of what a picture has no axis for; their axes, legend and title."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from rattlesweep.analysis.plots.layout import Axis
from rattlesweep.analysis.style import value_text
from rattlesweep.errors import ConfigError

MOST_PANELS = 40
BESIDE = "<beside>"
"""Label of Axes, like "<colorbar>", whose limits are their own."""
# Shares of a figure that a legend may take, and the smallest type that can be read.
WIDEST, HIGHEST, SMALLEST = 0.98, 0.35, 5.0
# Inches of an abscissa on which no more than a few numbers have room.
NARROW = 1.1


class Panel(NamedTuple):
    """A panel: its Axes, its row, the places of its values, and which part it is."""

    axes: Any
    row: int
    where: tuple[int, ...]
    part: int = 0


def draw_panels(
    figure: Any, rows: Sequence[Axis], columns: Sequence[Axis], *, parts: int = 1
) -> list[Panel]:
    """Make panels: a row for each combination of some axes' values, columns likewise.

    Values are written above each column and at the right of each row. Each combination has `parts`
    panels, side by side. Too many are a ConfigError.
    """
    down = list(product(*(range(len(axis.values)) for axis in rows)))
    across = list(product(*(range(len(axis.values)) for axis in columns)))
    if len(down) * len(across) > MOST_PANELS:
        names = " and ".join(axis.name for axis in (*rows, *columns) if len(axis.values) > 1)
        raise ConfigError(
            f"there would be {len(down) * len(across)} panels, one for each {names}; choose some "
            "with --select, as in --select n_i=-0.3,-0.5"
        )
    wide = list(product(across, range(parts)))
    grid = figure.subplots(len(down), len(wide), sharex=True, sharey=True, squeeze=False)
    panels = []
    for (i, row), (j, (column, part)) in product(enumerate(down), enumerate(wide)):
        axes = grid[i, j]
        if i == 0 and _text(columns, column):
            axes.set_title(_text(columns, column), fontsize="medium")
        if j == len(wide) - 1 and _text(rows, row):
            axes.annotate(
                _text(rows, row), (1.02, 0.5), xycoords="axes fraction", rotation=270, va="center",
                ha="left",
            )  # fmt: skip
        panels.append(Panel(axes, i, (*row, *column), part))
    return panels


def _text(axes: Sequence[Axis], places: Sequence[int]) -> str:
    return ", ".join(
        value_text(axis.name, float(axis.values[place]))
        for axis, place in zip(axes, places, strict=True)
        if len(axis.values) > 1
    )


def add_heading(figure: Figure, lines: list[str]) -> None:
    """Write lines at the top, above the legend where there is one."""
    if not lines:
        return
    if not figure.legends:
        title: Any = figure.suptitle("", fontsize="medium")
    else:
        title = figure.legends[0].get_title()
        old = title.get_text()
        figure.legends[0].set_title(" ")
        lines = [*lines, *([old] if old not in ("", "None") else [])]
    title.set_multialignment("center")
    # Lines wider than the figure are broken; formulas cannot be, and are made smaller.
    title.set_text("\n".join(lines))
    if (wide := title.get_window_extent().width / figure.bbox.width) > 0.95:
        most = max(10, int(0.9 * max(map(len, lines)) / wide))
        title.set_text("\n".join(t if "$" in t else textwrap.fill(t, most) for t in lines))
        wide = max(0.95, title.get_window_extent().width / figure.bbox.width)
        title.set_fontsize(0.95 / wide * float(title.get_fontsize()))


def entry(words: str, **look: Any) -> Line2D:
    """Make an entry of a legend; without a look it is a remark."""
    return Line2D([], [], label=words, **{"linestyle": "", **look})


def legend_above(figure: Any, handles: list[Any], each: float, title: str | None = None) -> None:
    """Put a legend above all panels, in as many columns of a width in inches as fit.

    Smaller type makes it fit where one column is too wide, or all of it too high.
    """
    base = size = FontProperties(size=mpl.rcParams["legend.fontsize"]).get_size_in_points()
    columns = most = max(2, min(len(handles), int(figure.get_figwidth() / each)))
    while handles:
        legend = figure.legend(handles=handles, loc="outside upper center", ncols=columns,
                               title=title, columnspacing=1.4, fontsize=size)  # fmt: skip
        box = legend.get_window_extent()
        wide, high = box.width / figure.bbox.width, box.height / figure.bbox.height
        if (wide <= WIDEST and high <= HIGHEST) or size <= SMALLEST:
            return
        legend.remove()
        if wide > WIDEST and columns > 1:
            columns -= 1
        else:
            size *= 0.9
            columns = min(len(handles), int(most * base / size))


def scale_axis(axes: Any, which: str, values: Any, log: bool, name: str = "t_r") -> None:
    """Make an axis for values of some name logarithmic if `log`."""
    if not log:
        return
    ends = float(np.min(values)), float(np.max(values))
    if ends[0] <= 0:
        raise ConfigError(f"--log: {name} has values that are not positive; leave it out")
    getattr(axes, f"set_{which}scale")("log")
    plain_ticks(axes, which, ends)


def plain_ticks(axes: Any, which: str, ends: tuple[float, float]) -> None:
    """Set ticks of a logarithmic axis in plain numbers, enough of them over half a decade too."""
    span = ends[1] / ends[0] if ends[0] > 0 else 1.0
    axis = getattr(axes, f"{which}axis")
    subs: tuple[float, ...] = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
    for least, coarser in ((4, (1.0, 2.0, 5.0)), (40, (1.0, 3.0)), (300, (1.0,))):
        if span > least:
            subs = coarser
    if which == "x" and axes.get_position().width * axes.get_figure().get_figwidth() < NARROW:
        subs = (1.0,) if span > 8 else (1.0, 3.0)
    axis.set_major_locator(MaxNLocator(4) if span < 2 else LogLocator(subs=subs, numticks=20))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
