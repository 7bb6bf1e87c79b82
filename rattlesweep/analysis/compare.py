"""How two directories of the same runs differ: as text, and as a figure."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from rattlesweep.analysis import style
from rattlesweep.sweeps.old.compare import COARSE, FINE, HIGHEST, LOWEST, Comparison
from rattlesweep.text import align

DPI = 150
DIFFERENCE = r"$|\Delta t_r|/t_r$"
NO_ERRORS = "no errors stored; add record: [error]"
# Columns of the table, with their headings.
_TABLE = {
    "n_i": "n_i", "omega_xy0": "omega_xy0", "runs": "runs", "reversing": "both R",
    "equal": "equal", "median": "median", "p99": "99 %", "worst": "worst", "beyond": "beyond",
    "types": "types", "types_sure": "sure", "not_ok": "not ok",
}  # fmt: skip
_RUNS = {
    "case": "case", "sample": "sample", "type_a": "type A", "type_b": "type B", "t_r_a": "t_r A",
    "t_r_b": "t_r B", "relative": "|dt_r|/t_r", "over_errors": "over errors",
    "type_sure_a": "sure A", "type_sure_b": "sure B",
}  # fmt: skip
_FORMS = {
    "n_i": ".4g", "omega_xy0": ".4g", "t_r_a": ".10g", "t_r_b": ".10g", "over_errors": ".3g",
}  # fmt: skip


def as_text(result: Comparison, most_cases: int) -> str:
    """All of it to be read, of many cases the first."""
    return "\n".join(_lines(result, most_cases))


def _lines(result: Comparison, most_cases: int) -> Iterator[str]:
    for name, directory, rows in zip("AB", result.directories, result.rows, strict=True):
        missing = result.planned - rows
        yield (
            f"{name}  {directory}: "
            + (f"{missing} of " if missing else "all ")
            + (f"{result.planned} runs" + (" are missing" if missing else ""))
        )
    for words in result.differ:
        yield f"   {words}"
    yield ""
    table = [["case", "target", *_TABLE.values()]]
    for case in [*result.cases[:most_cases], {"case": "all"} | result.row(result.total)]:
        targets = [f"{name}={case[name]:.4g}" for name in ("K_p", "K_r") if name in case]
        cells = [_cell(case.get(name), name) for name in _TABLE]
        table.append([str(case["case"]), *(targets or ["-"]), *cells])
    yield align(table)
    if (more := len(result.cases) - most_cases) > 0:
        yield f"{more} more cases are in --json"
    without = [n for n, stored in zip("AB", result.errors, strict=True) if not stored]
    if without:
        yield f"{' and '.join(without)}: {NO_ERRORS}"
    for title, runs in (("t_r that differ most", result.times),
                        ("types that differ", result.types)):  # fmt: skip
        if runs:
            names = [name for name in _RUNS if any(run[name] is not None for run in runs)]
            yield f"\n{title} (`rattlesweep replay DIR --case CASE --sample SAMPLE` follows one)"
            listed = [[_cell(run[name], name) for name in names] for run in runs]
            yield align([[_RUNS[name] for name in names], *listed])


def _cell(value: Any, name: str) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value == 0:
        return "0"
    return format(value, _FORMS.get(name, ".1e")) if isinstance(value, float) else str(value)


def save(result: Comparison, path: Path) -> None:
    """Write the figure to an .svg, .png or .pdf file."""
    with style.styled():
        style.save(draw(result), [path], DPI)


def draw(result: Comparison) -> Figure:
    """Runs by relative difference, and where both have errors against these too."""
    errors = bool(result.plane.any())
    figure = style.new_figure(8.4 if errors else 5.2, 3.9)
    panels: Any = figure.subplots(1, 2 if errors else 1, squeeze=False)[0]
    edges = 10.0 ** np.linspace(LOWEST, HIGHEST, (HIGHEST - LOWEST) * COARSE + 1)
    counts = result.total.histogram.reshape(-1, FINE // COARSE).sum(axis=1)
    _histogram(panels[0], edges, counts, result.total.counts)
    if errors:
        _against_errors(panels[1], edges, result)
    for axes in panels:
        style.light_grid(axes)
    words = " against ".join(str(directory) for directory in result.directories)
    figure.suptitle(words, fontsize="medium").set_parse_math(False)
    return figure


def _histogram(axes: Any, edges: Any, counts: Any, total: dict[str, int]) -> None:
    seen = np.flatnonzero(counts)
    if len(seen):
        first, last = seen[0], seen[-1] + 1
        axes.stairs(counts[first:last], edges[first : last + 1], fill=True, color=style.BLUE)
        axes.set_xscale("log")
        # The few runs that differ widely are what one looks for.
        axes.set_yscale("log")
        axes.set_ylim(bottom=0.7)
    else:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no run differs in t_r", transform=axes.transAxes, ha="center")
    axes.set_xlabel(DIFFERENCE)
    axes.set_ylabel("runs")
    equal = f", {total['equal']:,} of them equally" if total["equal"] else ""
    axes.set_title(f"{total['reversing']:,} runs reverse in both{equal}", fontsize="medium")


def _against_errors(axes: Any, edges: Any, result: Comparison) -> None:
    plane, total = result.plane, result.total.counts
    shown = axes.pcolormesh(edges, edges, np.where(plane, plane, np.nan).T, norm=LogNorm(),
                            rasterized=True)  # fmt: skip
    axes.figure.colorbar(shown, ax=axes, label="runs")
    ends = [edges[[at.min(), at.max() + 1]] for at in np.nonzero(plane)]
    low, high = min(e[0] for e in ends), max(e[1] for e in ends)
    axes.plot([low, high], [low, high], **style.THEORY)
    axes.set_xlim(*ends[0])
    axes.set_ylim(*ends[1])
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("both errors / $t_r$ (dashed: as large as the difference)")
    axes.set_ylabel(DIFFERENCE)
    axes.set_title(f"{total['beyond']:,} runs beyond both errors", fontsize="medium")
