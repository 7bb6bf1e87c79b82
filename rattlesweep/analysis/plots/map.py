"""Maps over two axes: the type of each cell, its reversal time, its turns, or any column."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.patches import Patch

from rattlesweep.analysis import style
from rattlesweep.analysis.plots.layout import Layout, fill
from rattlesweep.analysis.plots.picture import WIDE, Picture, draw_panels, ordered
from rattlesweep.analysis.style import FAILED, MISSING, NO_REVERSAL, TYPE_STYLE, label
from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError

# From this many values on along both sides, a grid is a map.
SIDE = 8
BONDI_LABEL = "Bondi's threshold"
# Values beyond these percentiles are drawn in the end colours; within them most of a map lies.
TAILS = (0.5, 99.5)
# What a cell is: its most common type, or none of them.
CELLS = {
    **{name: (mark.colour, mark.label) for name, mark in TYPE_STYLE.items()},
    "failed": (FAILED, "failed"),
    "missing": (MISSING, "not run yet"),
}
CODES = {name: code for code, name in enumerate(CELLS)}
TURNS = ("reversals_sure", "n_turns")


class Map(Picture):
    """Types and ``t_r/t_rGH`` side by side, or one column; a row for each further value.

    A cell of several runs has their most common type and their mean. The cells that a refined grid
    has left out are filled from those that were run.
    """

    name = "map"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        self.quantity, self.unit, self.meaning = quantity, "", ""
        if quantity is not None:
            self.unit, self.meaning = layout.column(quantity, "--quantity")
        names = ordered(layout, SIDE)
        order = [x or names[0], *(n for n in names if n != (x or names[0]))]
        if layout.lengths[order[0]] < 2:
            raise ConfigError(f"--kind map: only one value of {x} is left; a map needs two or more")
        order = [name for name in order if layout.lengths[name] > 1]
        rows = np.prod([layout.lengths[name] for name in order[2:]])
        height = float(np.clip(1.2 + 3.4 * rows, 4.6, 14))
        super().__init__(layout, order, 9.0 if quantity is None else 6.4, height)
        # Of one body a cell, and of spins that stay beyond it.
        self.theory = bool(layout.bodies) and not layout.stored.config.dissipation
        theory = ("n_c1", "n_i") if self.theory else ()
        self.more = tuple(dict.fromkeys([*filter(None, [quantity]), *theory]))

    def shown(self) -> tuple[Integers, Floats, Floats]:
        """Return what each cell is (a place in `CELLS`), its value, how far beyond Bondi's line.

        The value is ``t_r/t_rGH`` or the mean of the column; the last is NaN without theory.
        """
        layout = self.layout
        cells, more = layout.count(self.more)
        counts = np.stack([cells.types.get(name, 0 * cells.runs) for name in TYPE_STYLE])
        code = np.where(cells.ok == 0, CODES["failed"], np.argmax(counts, axis=0))
        code = self.grid(np.where(cells.runs == 0, CODES["missing"], code))
        value = self.grid(more[self.quantity] if self.quantity else cells.ratio.means())
        beyond = np.full(code.shape, np.nan)
        if self.theory:
            beyond = self.grid(more["n_c1"] - more["n_i"])
        if layout.refined:
            # Runs that a condition does not choose are missing, and no gap.
            every = layout if layout.where is None else layout.chosen(None)
            done = self.grid(every.count()[0].runs) > 0
            code, value, beyond = (fill(array, done) for array in (code, value, beyond))
        return code, value, beyond

    def words(self) -> str:
        """Return how much is shown."""
        filled = f", which fill {self.shown()[0].size:,} cells" if self.layout.refined else ""
        return super().words() + filled

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw the cells, and Bondi's line where theory gives it."""
        x, y, *rows = self.axes
        types_too, bondi = self.quantity is None, False
        panels = draw_panels(figure, rows, (), label(x.name), parts=2 if types_too else 1)
        code, value, beyond = self.shown()
        known = value[np.isfinite(value)] if np.isfinite(value).any() else np.array([0.0, 2.0])
        low, high = (float(end) for end in np.percentile(known, TAILS))
        wide = low > 0 and high > (4 if types_too else WIDE) * low
        norm = (LogNorm if wide else Normalize)(low, high if high > low else low + 1)
        mesh: Any = None
        for k, (axes, where) in enumerate(panels):
            here: Any = (..., *where)
            on_types = types_too and k % 2 == 0
            colours = [colour for colour, _ in CELLS.values()]
            if not on_types:  # where there is a type and no value
                colours[: len(TYPE_STYLE)] = [NO_REVERSAL] * len(TYPE_STYLE)
            axes.pcolormesh(x.edges, y.edges, code[here].T, rasterized=True, vmin=-0.5,
                            vmax=len(CELLS) - 0.5, cmap=ListedColormap(colours))  # fmt: skip
            if not on_types:
                mesh = axes.pcolormesh(x.edges, y.edges, np.ma.masked_invalid(value[here].T),
                                       rasterized=True, norm=norm)  # fmt: skip
            if on_types or not types_too:
                axes.set_ylabel(label(y.name))
            if np.nanmin(beyond[here], initial=0) < 0 < np.nanmax(beyond[here], initial=0):
                bondi = True
                # A dark line with a light rim is seen on every colour.
                for colour, width in (("#FFFFFF", 2.8), ("#000000", 1.3)):
                    axes.contour(x.values, y.values, beyond[here].T, [0], colors=colour,
                                 linewidths=width, linestyles="solid")  # fmt: skip
            for which, axis in (("x", x), ("y", y)):
                style.scale_axis(axes, which, axis.values, axis.logarithmic(log), axis.name)
            axes.set(xlim=x.edges[[0, -1]], ylim=y.edges[[0, -1]])
        several = self.cells.runs.max() > 1
        mean = "mean " if several else ""
        if types_too:
            titles = "most common type" if several else "type", mean + label("ratio")
            for (axes, _), title in zip(panels, titles, strict=False):
                axes.set_title(title, fontsize="medium")
        bar = figure.colorbar(mesh, ax=[axes for axes, _ in panels], pad=0.03, extend="both",
                              aspect=30 if len(panels) < 4 else 45)  # fmt: skip
        bar.set_label(mean + label(self.quantity or "ratio", self.unit or None))
        if wide:
            style.plain_ticks(bar.ax, "y", (low, high))

        words = "t_r is the time of the first reversal, t_rGH that of Garcia and Hubbard's theory."
        self.notes.append(words if types_too else f"{self.quantity}: {self.meaning}.")
        looks = CELLS | ({"missing": (MISSING, "not selected")} if self.layout.where else {})
        entries = [looks[name] for name in CELLS
                   if CODES[name] in code and (types_too or name not in TYPE_STYLE)]  # fmt: skip
        if ((code < len(TYPE_STYLE)) & np.isnan(value)).any():
            entries.append((NO_REVERSAL, "no reversal" if types_too else "no value"))
        handles: list[Any] = [
            Patch(facecolor=colour, label=text, edgecolor="#555555", linewidth=0.5)
            for colour, text in entries
        ]
        if bondi:
            handles.append(style.entry(BONDI_LABEL, color="#000000", linestyle="-", linewidth=1.3))
            self.notes.append("Bondi's threshold of the steady spin: |n_i| = |n_c1|.")
        return handles


class Reversals(Map):
    """Number of turns by cell; where runs tell how many of them are sure, only these."""

    name = "reversals"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        there = [name for name in TURNS if name in layout.stored.schema.names]
        super().__init__(layout, x, there[0])
