"""Figures of orbits: one period over time, and families along a parameter."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.analysis import room, style
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.analysis.onerun.figure import draw, shown
from rattlesweep.analysis.style import BLUE, INK, ORANGE, PURPLE, VERMILION
from rattlesweep.design.launch import Launch
from rattlesweep.system.files import as_path
from rattlesweep.words.errors import check_names

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CHANNELS = ("t", "n", "omega_x", "omega_y")
_ROWS = 401
_MARKS = {
    "fold": ("o", INK),
    "doubling": ("D", VERMILION),
    "torus": ("s", PURPLE),
    "branching": ("^", ORANGE),
}


def draw_period(run: Launch, path: str | Path | None = None) -> Figure:
    """Return a figure of one period over time, which is the run."""
    course = Course(PreparedRun.of(run), _CHANNELS, points=_ROWS)
    return draw(course.columns(), course, path)


def draw_family(
    table: pd.DataFrame, x: str, y: str, path: str | Path | None, ax: Axes | None
) -> Figure:
    """Return a figure of one column of the table of a branch over another."""
    check_names("y", [y], [str(name) for name in table if table[name].dtype == float])
    is_stable = (table["kind"] == "stable").to_numpy()
    with style.styled():
        figure = room.usual_figure(6.4, 4.2)
        axes = ax or figure.subplots()
        units = table.attrs["units"]
        axes.set_xlabel(style.label(x, units[x]))
        axes.set_ylabel(style.label(y, units[y]))
        style.light_grid(axes)
        places = table[x].to_numpy()
        values = table[y].to_numpy()
        # Of a step that begins at a special point, the other end tells what it is.
        begins = np.where(table["point"].notna(), np.roll(is_stable, -1), is_stable)
        changes = np.flatnonzero(np.diff(begins[:-1])) + 1
        for first, last in pairwise([0, *changes.tolist(), len(table) - 1]):
            line = "-" if begins[first] else "--"
            part = slice(first, last + 1)
            axes.plot(places[part], values[part], line, color=BLUE)
        handles = [
            style.entry("stable", color=BLUE, linestyle="-"),
            style.entry("not stable", color=BLUE, linestyle="--"),
        ]
        for name, (marker, colour) in _MARKS.items():
            marked = table[table["point"] == name]
            if len(marked):
                axes.plot(marked[x], marked[y], marker, color=colour, zorder=3)
                handles.append(style.entry(name, color=colour, marker=marker))
        if ax is None:
            style.add_legend(figure, handles)
            shown(figure)
        else:
            ax.legend(handles=handles)
        whole = axes.get_figure(root=True)
        assert whole is not None
        if path is not None:
            style.save_figure(whole, [as_path(path, "path")])
        return whole
