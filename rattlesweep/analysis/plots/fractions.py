"""Fractions of the types against one axis."""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from rattlesweep.analysis import style
from rattlesweep.analysis.layout import LAUNCH, Axis
from rattlesweep.analysis.plots.picture import (
    ENOUGH,
    Arrangement,
    Handle,
    Panel,
    Picture,
    ordered,
    scale,
    within,
)
from rattlesweep.analysis.style import TYPE_STYLE
from rattlesweep.arrays import Floats, Integers
from rattlesweep.sweeps.types import share, wilson

FEW = 6  # with fewer values than this, each value of an abscissa has a tick
BEYOND = "beyond Bondi's threshold"


class Fractions(Picture):
    """Fractions of the types against the first axis, in panels by the others."""

    panel = (1.7, 1.6)

    def arrange(self) -> Arrangement:
        """Make the oscillation, or else one of several further axes, the rows."""
        first, *rest = ordered(self.layout, self.x, ENOUGH)
        rest.sort(key=lambda name: (name != "omega_xy0", name not in LAUNCH))
        rows = 0
        if len(rest) > 1 or rest == ["omega_xy0"]:
            rows = 1
        return Arrangement([first], rest[:rows], rest[rows:])

    def told(self) -> tuple[str, str]:
        """Return the words and the column for what reverses."""
        return "Fraction that reverses", "fraction_R"

    def draw(self, panels: list[Panel], log: bool | None) -> list[Handle]:
        """Stack the types on each other, with the intervals of their borders."""
        x = self.axes[0]
        cells = self.counted[0]
        bondi = self.grid(share(cells["bondi"], cells["steady"]))
        entries: dict[str, Handle] = {}
        for axes, place in panels:
            self._stack(axes, place, entries)
            if np.isfinite(bondi).any():
                # Measured from the top, where steady spinning is stacked.
                [triangles] = axes.plot(
                    x.values,
                    1 - within(bondi, place),
                    "k^",
                    label=BEYOND,
                    clip_on=False,
                    markersize=4,
                    markeredgecolor="white",
                    markeredgewidth=0.5,
                    zorder=5,
                )
                entries[BEYOND] = triangles
            scale(axes, "x", x, log)
            if len(x.values) < FEW:
                _tick_each(axes, x)
            axes.set(xlim=x.edges[[0, -1]], ylim=(0, 1), yticks=[0, 0.5, 1])
        self.ylabel = "fraction of bodies"
        self.notes.append(
            "Fractions of the runs with status ok, with 95 % intervals (Wilson)."
        )
        if BEYOND in entries:
            self.notes.append(
                "The fraction above a triangle is that of the bodies whose steady "
                "spin theory finds stable: |n_c1| < |n_i|."
            )
        return list(entries.values())

    def _stack(
        self, axes: Axes, place: tuple[int, ...], entries: dict[str, Handle]
    ) -> None:
        """Draw the types of one panel, and note their legend entries."""
        x = self.axes[0]
        cells = self.counted[0]
        ok = within(self.grid(cells["ok"]), place)
        count = np.zeros(len(x.values))
        for name, mark in TYPE_STYLE.items():
            if name not in cells.types:
                continue
            below = share(count, ok)
            count = count + within(self.grid(cells.types[name]), place)
            above = share(count, ok)
            entries[mark.label] = axes.stairs(
                above,
                x.edges,
                baseline=below,
                fill=True,
                label=mark.label,
                facecolor=mark.colour,
                hatch=mark.hatch,
                linewidth=0,
            )
            _draw_intervals(axes, x.values, count, ok)


def _draw_intervals(axes: Axes, x: Floats, count: Floats, ok: Integers) -> None:
    """Draw Wilson's interval of an upper border, a fraction of the runs itself."""
    border = share(count, ok)
    low, high = wilson(count, ok)
    inside = (count > 0) & (count < ok)
    lengths = np.stack([border - low, high - border])[:, inside]
    axes.errorbar(
        x[inside],
        border[inside],
        lengths,
        fmt="none",
        ecolor=style.BLACK,
        elinewidth=0.9,
        capsize=1.6,
        zorder=4,
    )


def _tick_each(axes: Axes, x: Axis) -> None:
    """Write each value at the abscissa, upright if there is not enough room."""
    texts = [f"{value:.4g}".replace("-", "−") for value in x.values]
    grid: Any = axes.get_gridspec()
    # In points; a letter is about 7 points wide.
    width = 72 * grid.figure.get_figwidth() / grid.ncols
    letter = 0.75 * float(mpl.rcParams["font.size"])
    crowded = letter * len("  ".join(texts)) > width
    axes.set_xticks(x.values, texts, rotation=90 if crowded else 0)
