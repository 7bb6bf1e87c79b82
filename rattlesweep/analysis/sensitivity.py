"""Which parameter matters: as text, and as a figure."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from rattlesweep.analysis import style
from rattlesweep.sweeps.old.sensitivity import QUANTITIES, Indices, Sensitivity
from rattlesweep.text import align

DPI = 150
MOST_CASES = 6
"""Cases in a figure."""
_SPIN = ("n_i", "omega_xy0")
_INDICES = {"first": ("first order", style.BLUE), "total": ("total", style.ORANGE)}
_TITLES = {"t_r": "$t_r$", "log10 t_r": r"$\log\,t_r$"}


def as_text(found: Sensitivity, most_cases: int) -> str:
    """A table of indices with their intervals, of many cases the first."""
    return "\n".join(_lines(found, most_cases))


def _lines(found: Sensitivity, most_cases: int) -> Iterator[str]:
    table = [["case", "n_i", "omega_xy0", "of", "runs", "left out", "index", *found.parameters]]
    for case, of, rows in _grouped(found):
        if case >= most_cases:
            continue
        said = found.cases[case]
        head = [str(case), *(f"{said[k]:.4g}" if k in said else "-" for k in _SPIN)]
        one = rows[0]
        for index in ("first", "total"):
            if not np.isnan(getattr(one, index)):
                by = {row.parameter: _cell(row, index) for row in rows}
                cells = [by.get(name, "-") for name in found.parameters]
                table.append([*head, of, str(one.used), str(one.left_out), index, *cells])
    yield align(table)
    yield "in brackets intervals of 95 %; left out: runs without a value, which did not reverse or"
    yield "failed, and those drawn together with them"
    if found.draw != "saltelli":
        yield "no total indices: they take a sweep with bodies.draw: saltelli"
    if (more := len(found.cases) - most_cases) > 0:
        yield f"{more} more cases are in --json"


def _grouped(found: Sensitivity) -> Iterator[tuple[int, str, list[Indices]]]:
    keys = list(dict.fromkeys((row.case, row.of) for row in found.rows))
    for key in keys:
        yield *key, [row for row in found.rows if (row.case, row.of) == key]


def _cell(row: Indices, index: str) -> str:
    value, low, high = (getattr(row, index + end) for end in ("", "_low", "_high"))
    return f"{value:.2f} ({low:.2f} {high:.2f})"


def save(found: Sensitivity, path: Path) -> None:
    """Write the figure to an .svg, .png or .pdf file."""
    with style.styled():
        style.save(draw(found), [path], DPI)


def draw(found: Sensitivity) -> Figure:
    """A panel for each case and quantity: bars for each parameter, with their intervals."""
    names = [of for of in QUANTITIES if any(row.of == of for row in found.rows)]
    cases = list(dict.fromkeys(row.case for row in found.rows))[:MOST_CASES]
    figure = style.new_figure(1.2 + 2.0 * len(names), 1.0 + 1.9 * len(cases))
    panels: Any = figure.subplots(len(cases), len(names), squeeze=False, sharex=True, sharey=True)
    shown = {(case, of): rows for case, of, rows in _grouped(found)}
    for line, case in zip(panels, cases, strict=True):
        for axes, of in zip(line, names, strict=True):
            _bars(axes, shown.get((case, of), []), found.parameters)
        said = found.cases[case]
        words = [style.value_text(k, said[k]) for k in _SPIN if k in said]
        line[0].set_ylabel("\n".join(words) or f"case {case}")
    for axes, of in zip(panels[0], names, strict=True):
        axes.set_title(_TITLES.get(of, of), fontsize="medium")
    low, high = panels[0, 0].get_ylim()
    panels[0, 0].set_ylim(max(low, -0.2), min(high, 1.4))
    handles = [Patch(color=colour, label=words) for words, colour in _INDICES.values()]
    figure.legend(handles=handles, loc="outside upper right", ncols=2)
    return figure


def _bars(axes: Any, rows: list[Indices], names: tuple[str, ...]) -> None:
    for k, (index, (_, colour)) in enumerate(_INDICES.items()):
        for row in rows:
            value, low, high = (getattr(row, index + end) for end in ("", "_low", "_high"))
            if np.isfinite(value):
                at = names.index(row.parameter) + 0.38 * k - 0.19
                ends = [[max(0.0, value - low)], [max(0.0, high - value)]]
                axes.bar(at, value, 0.36, color=colour, yerr=ends, error_kw={"linewidth": 0.9})
    if not rows:
        axes.text(0.5, 0.5, "too few, or does\nnot vary", transform=axes.transAxes, ha="center")
    axes.set_xticks(range(len(names)), [style.symbol(name) for name in names])
    style.light_grid(axes)
