"""How the paper's figures look: colours, markers, frames."""

from __future__ import annotations

from typing import Any

from rattlesweep.study.style import SERIES, TYPE_STYLE, new_figure

__all__ = ["MARKERS", "TYPES", "decade_ticks", "frame", "new_figure"]

MARKERS = SERIES[:6]
TYPES = {
    name: (TYPE_STYLE[name].colour, TYPE_STYLE[name].marker, TYPE_STYLE[name].label)
    for name in ("R", "SW", "SS", "unclassified")
}


def frame(axis: Any) -> None:
    """Thin frame and ticks inward on all sides, as in the paper."""
    axis.set_axisbelow(True)
    axis.tick_params(which="both", direction="in", top=True, right=True, width=0.6, labelsize=9)
    for side in axis.spines.values():
        side.set_linewidth(0.7)


def decade_ticks(axis: Any) -> None:
    """Label decades only; on a short logarithmic axis the minor labels run into each other."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(base=10))
    axis.set_minor_formatter(NullFormatter())
