"""Which parameter matters: as text, and as a figure."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rattlesweep.study import style
from rattlesweep.sweeps.inspect.sensitivity import PARAMETERS, Indices, Sensitivity
from rattlesweep.text import align

DPI = 150
MOST_CASES = 6
"""Cases in a figure."""


def as_text(found: Sensitivity, most_cases: int) -> str:
    """A table of indices with their intervals, of many cases the first."""
    return "\n".join(_lines(found, most_cases))


def _lines(found: Sensitivity, most_cases: int) -> Iterator[str]:
    table = [["case", "n_i", "omega_xy0", "of", "runs", "left out", "index", *PARAMETERS]]
    for case, of, rows in _grouped(found):
        if case >= most_cases:
            continue
        said = found.cases[case]
        head = [str(case), *(f"{said[k]:.4g}" if k in said else "-" for k in ("n_i", "omega_xy0"))]
        one = rows[0]
        for index in ("first", "total"):
            if not np.isnan(getattr(one, index)):
                by = {row.parameter: _cell(row, index) for row in rows}
                cells = [by.get(name, "-") for name in PARAMETERS]
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
    return f"{value:.3f} ({low:.3f} {high:.3f})"


def save(found: Sensitivity, path: Path) -> None:
    """Write the figure to an .svg, .png or .pdf file."""
    with style.styled():
        style.save(draw(found), [path], DPI)


def draw(found: Sensitivity) -> Figure:
    """A panel for each case and quantity: bars for each parameter, with their intervals."""
    names = list(dict.fromkeys(row.of for row in found.rows))
    cases = list(dict.fromkeys(row.case for row in found.rows))[:MOST_CASES]
    figure = style.new_figure(1.2 + 2.2 * len(names), 0.9 + 1.9 * len(cases))
    panels: Any = figure.subplots(len(cases), len(names), squeeze=False, sharex=True, sharey=True)
    shown = {(case, of): rows for case, of, rows in _grouped(found)}
    place = np.arange(len(PARAMETERS))
    for line, case in zip(panels, cases, strict=True):
        for axes, of in zip(line, names, strict=True):
            rows = {row.parameter: row for row in shown.get((case, of), [])}
            for k, (index, colour) in enumerate((("first", style.BLUE), ("total", style.ORANGE))):
                at, value, low, high = np.array([
                    (place[p] + 0.38 * k - 0.19, *(getattr(rows[name], index + end)
                                                   for end in ("", "_low", "_high")))
                    for p, name in enumerate(PARAMETERS) if name in rows
                ]).reshape(-1, 4).T  # fmt: skip
                known = np.isfinite(value)
                if known.any():
                    ends = np.maximum(0, [value - low, high - value])[:, known]
                    axes.bar(at[known], value[known], 0.36, color=colour, yerr=ends,
                             error_kw={"linewidth": 0.9}, label=f"{index} order"
                             if index == "first" else index)  # fmt: skip
            if not rows:
                axes.text(0.5, 0.5, "does not vary", transform=axes.transAxes, ha="center")
            axes.set_xticks(place, [style.symbol(name) for name in PARAMETERS])
            style.light_grid(axes)
        said = found.cases[case]
        words = [style.value_text(k, said[k]) for k in ("n_i", "omega_xy0") if k in said]
        line[0].set_ylabel("\n".join(words) or f"case {case}")
    for axes, of in zip(panels[0], names, strict=True):
        axes.set_title(of.replace("log10 t_r", r"$\log\,t_r$").replace("t_r", r"$t_r$")
                       if "$" not in of and "log" not in of else r"$\log\,t_r$",
                       fontsize="medium")  # fmt: skip
    low, high = panels[0, 0].get_ylim()
    panels[0, 0].set_ylim(max(low, -0.2), min(high, 1.4))
    panels[0, -1].legend(fontsize="small")
    return figure
