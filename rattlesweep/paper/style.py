"""How the paper's figures look: colours, markers, frames."""

from __future__ import annotations

from typing import Any

# Okabe and Ito's colours, told apart by shape as well; one for each size of the oscillation.
MARKERS = (("#0072B2", "o"), ("#D55E00", "s"), ("#009E73", "^"), ("#CC79A7", "D"),
           ("#E69F00", "v"), ("#56B4E9", "P"))  # fmt: skip
TYPES = {
    "R": ("#0072B2", "o", "R: reverses"),
    "SW": ("#E69F00", "s", "SW: wobbles"),
    "SS": ("#009E73", "^", "SS: spins on"),
    "unclassified": ("#777777", "x", "unclassified"),
}


def new_figure(width: float, height: float) -> Any:
    """A figure of this size in inches, without a window and without state that outlives it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


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
