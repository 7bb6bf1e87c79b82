"""Panels, one for each value of what a picture has no axis for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from rattlesweep.errors import ConfigError
from rattlesweep.study.plots.layout import Axis
from rattlesweep.study.style import value_text

MOST_PANELS = 40


@dataclass(frozen=True)
class Panel:
    """A panel: its Axes, its row, the place of its values in the tally, and which part it is."""

    axes: Any
    row: int
    where: tuple[int, ...]
    part: int = 0


def draw_panels(
    figure: Any, rows: Sequence[Axis], columns: Sequence[Axis], *, parts: int = 1
) -> list[Panel]:
    """Lay out panels: one row for each combination of some axes' values, columns likewise.

    Values stand above each column and at the right of each row. Of each combination there are
    `parts` panels, side by side.

    Raises
    ------
    ConfigError
        There would be too many.
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
