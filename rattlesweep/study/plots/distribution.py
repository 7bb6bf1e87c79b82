"""How reversal times are distributed about the theory, and how many runs never reverse."""

from __future__ import annotations

from typing import Any

import numpy as np

from rattlesweep.study.plots.panels import plain_ticks
from rattlesweep.study.plots.table import EDGES, Tally
from rattlesweep.study.style import FAILED, THEORY, TYPE_STYLE


def draw_distribution(figure: Any, counted: Tally, log: bool | None) -> None:
    """Draw the distribution of ``t_r/t_rGH`` of all runs counted, and their types as bars.

    Parameters
    ----------
    figure
    counted : Tally
        Of any axes; all its cells are taken together.
    log : bool or None
        Whether the number of runs is logarithmic; None: it is not.
    """
    main, side = figure.subplots(1, 2, width_ratios=(2.6, 1))
    seen = np.flatnonzero(counted.histogram)
    if len(seen):
        # Two empty bins on either side, and the theory's 1 in sight.
        first = max(min(seen[0], len(EDGES) // 2) - 2, 0)
        last = min(max(seen[-1], len(EDGES) // 2) + 3, len(EDGES) - 1)
        colour, _, hatch, _ = TYPE_STYLE["R"]
        main.stairs(counted.histogram[first:last], EDGES[first : last + 1], fill=True,
                    facecolor=colour, hatch=hatch, linewidth=0)  # fmt: skip
        main.set_xscale("log")
        plain_ticks(main, "x", (float(EDGES[first]), float(EDGES[last])))
        main.set_xlim(EDGES[first], EDGES[last])
    else:
        main.text(0.5, 0.5, "no run reverses", transform=main.transAxes, ha="center")
        main.set_xticks([])
    if log:
        main.set_yscale("log")
    main.axvline(1, **THEORY)
    main.set_xlabel(r"$t_r/t_{rGH}$ of runs that reverse (dashed: theory)")
    main.set_ylabel("runs")
    totals = {name: float(part.sum()) for name, part in counted.types.items()}
    totals["failed"] = float((counted.runs - counted.ok).sum())
    if not totals["failed"]:
        del totals["failed"]
    place = np.arange(len(totals))
    for at, (name, total) in zip(place, totals.items(), strict=True):
        colour, _, hatch, _ = TYPE_STYLE.get(name, (FAILED, "", "", ""))
        side.barh(at, total, facecolor=colour, hatch=hatch, height=0.62, linewidth=0)
        side.annotate(f"{total:,.0f}", (total, at), xytext=(4, 0), textcoords="offset points",
                      va="center", fontsize="small")  # fmt: skip
    side.set_yticks(place, list(totals))
    side.invert_yaxis()
    side.set_xlim(0, 1.35 * max(totals.values()))
    side.set_xticks([])
    side.set_xlabel("runs by type")
    for axes in (main, side):
        axes.spines[["top", "right"]].set_visible(False)
