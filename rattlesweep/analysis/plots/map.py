"""Maps over two axes: the type of each cell, its reversal time, its turns, or any column."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize
from matplotlib.patches import Patch

from rattlesweep.analysis.grids import boundaries, fill
from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.picture import (
    WIDE,
    Picture,
    draw_panels,
    entry,
    ordered,
    plain_ticks,
    scale_axis,
)
from rattlesweep.analysis.style import FAILED, MISSING, NO_REVERSAL, TYPE_STYLE, label
from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError

# From this many values on along both sides, a grid is a map.
SIDE = 8
# Lines of theory: their words in the legend and the caption, and their dashes.
BONDI_LABEL, BALANCE_LABEL = "Bondi's threshold", "balanced damping"
LINES = {
    BONDI_LABEL: ("Bondi's threshold of the steady spin: |n_i| = |n_c1|.", "solid"),
    BALANCE_LABEL: ("Dashed: the oscillation's growth at the launch balances damping.", "dashed"),
}
# Values beyond these percentiles are drawn in the end colours; within them most of a map lies.
TAILS = (0.5, 99.5)
# What a cell is: its most common type, or none of them.
CELLS = {
    **{name: (mark.colour, mark.label) for name, mark in TYPE_STYLE.items()},
    "failed": (FAILED, "failed"),
    "missing": (MISSING, "not run yet"),
}
CODES = {name: code for code, name in enumerate(CELLS)}
# So many numbers of turns have a colour each; beyond, a colour is for more and more of them.
SINGLE = 6
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
        size = 9.0 if quantity is None else 6.4, float(np.clip(1.2 + 3.4 * rows, 4.6, 14))
        theory = ["n_c1", "n_i"] if layout.bodies else []  # of one body a cell
        lines = ["growth"] if layout.config.dissipation else theory
        more = [*lines, quantity] if quantity and quantity not in lines else lines
        super().__init__(layout, order, size, more)

    def shown(self) -> tuple[Integers, Floats, dict[str, Floats]]:
        """Return what each cell is (a place in `CELLS`), its value, and lines of theory.

        The value is ``t_r/t_rGH`` or the mean of the column; a line is where its array is zero.
        """
        cells, layout = self.cells, self.layout
        counts = np.stack([cells.types.get(name, 0 * cells.runs) for name in TYPE_STYLE])
        code = np.where(cells.ok == 0, CODES["failed"], np.argmax(counts, axis=0))
        code = self.grid(np.where(cells.runs == 0, CODES["missing"], code))
        value = (
            self.grid(cells.ratio.means()) if self.quantity is None else self.mean(self.quantity)
        )
        lines = {}
        if layout.config.dissipation:
            lines[BALANCE_LABEL] = self.mean("growth")
        elif layout.bodies:
            lines[BONDI_LABEL] = self.mean("n_c1") - self.mean("n_i")
        if layout.refined:
            # Runs that a condition does not choose are missing, and no gap.
            every = layout if layout.where is None else layout.chosen(None)
            done = self.grid(every.count()[0].runs) > 0
            code, value = fill(code, done), fill(value, done)
            lines = {name: fill(line, done) for name, line in lines.items()}
        return code, value, lines

    def words(self) -> str:
        """Return how much is shown, and what the boundaries between types are like."""
        lines, stored = [super().words()], self.layout.stored
        if self.layout.refined:
            lines[0] += f", which fill a grid of {stored.samples * len(stored.cases):,}"
        if self.quantity is None:
            code = self.shown()[0]
            found = [boundaries(code[(..., *row)]) for row in np.ndindex(*code.shape[2:])]
            lines += [each.words for each in found if np.isfinite(each.exponent)]
        return "; ".join(lines)

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw the cells, and Bondi's line where theory gives it."""
        x, y, *rows = self.axes
        types_too = self.quantity is None
        panels = draw_panels(figure, rows, (), label(x.name), parts=2 if types_too else 1)
        code, value, lines = self.shown()
        look, extend, ticks = self.colours(value)
        norm = BoundaryNorm(np.arange(len(CELLS) + 1) - 0.5, len(CELLS))
        drawn = set()
        mesh: Any = None
        for k, (axes, where) in enumerate(panels):
            here: Any = (..., *where)
            on_types = types_too and k % 2 == 0
            colours = [colour for colour, _ in CELLS.values()]
            if not on_types:  # where there is a type and no value
                colours[: len(TYPE_STYLE)] = [NO_REVERSAL] * len(TYPE_STYLE)
            axes.pcolormesh(x.edges, y.edges, code[here].T, rasterized=True, norm=norm,
                            cmap=ListedColormap(colours))  # fmt: skip
            if not on_types:
                mesh = axes.pcolormesh(x.edges, y.edges, np.ma.masked_invalid(value[here].T),
                                       rasterized=True, **look)  # fmt: skip
            if on_types or not types_too:
                axes.set_ylabel(label(y.name))
            for name, line in lines.items():
                if np.nanmin(line[here], initial=0) < 0 < np.nanmax(line[here], initial=0):
                    drawn.add(name)
                    # A dark line with a light rim is seen on every colour.
                    for colour, width in (("#FFFFFF", 2.8), ("#000000", 1.3)):
                        axes.contour(x.values, y.values, line[here].T, [0], colors=colour,
                                     linewidths=width, linestyles=LINES[name][1])  # fmt: skip
            for which, axis in (("x", x), ("y", y)):
                scale_axis(axes, which, axis.values, axis.logarithmic(log), axis.name)
            axes.set(xlim=x.edges[[0, -1]], ylim=y.edges[[0, -1]])
        several = self.cells.runs.max() > 1
        mean = "mean " if several else ""
        if types_too:
            titles = "most common type" if several else "type", mean + label("ratio")
            for (axes, _), title in zip(panels, titles, strict=False):
                axes.set_title(title, fontsize="medium")
        if np.isfinite(value).any():
            bar = figure.colorbar(mesh, ax=[axes for axes, _ in panels], pad=0.03, extend=extend,
                                  aspect=30 if len(panels) < 4 else 45)  # fmt: skip
            bar.set_label(mean + label(self.quantity or "ratio", self.unit or None))
            if isinstance(look["norm"], LogNorm):
                plain_ticks(bar.ax, "y", bar.ax.get_ylim())
            if ticks:
                bar.set_ticks([*ticks], labels=[*ticks.values()])
                bar.ax.tick_params(which="both", length=0)

        words = "t_r is the time of the first reversal, t_rGH that of Garcia and Hubbard's theory."
        self.notes.append(words if types_too else f"{self.quantity}: {self.meaning}.")
        self.notes += [LINES[name][0] for name in drawn]
        if extend != "neither":
            self.notes.append("Values beyond the ends of the colour bar have its end colours.")
        looks = CELLS | ({"missing": (MISSING, "not selected")} if self.layout.where else {})
        entries = [looks[name] for name in CELLS
                   if CODES[name] in code and (types_too or name not in TYPE_STYLE)]  # fmt: skip
        if ((code < len(TYPE_STYLE)) & np.isnan(value)).any():
            entries.append((NO_REVERSAL, "no reversal" if types_too else "no value"))
        return [
            *(Patch(facecolor=colour, label=text, edgecolor="#555555", linewidth=0.5)
              for colour, text in entries),
            *(entry(name, color="#000000", linestyle=LINES[name][1], linewidth=1.3)
              for name in drawn),
        ]  # fmt: skip

    def colours(self, value: Floats) -> tuple[dict[str, Any], str, dict[float, str]]:
        """Return the colours of values, the ends of the colour bar that go on, and its ticks."""
        known = value[np.isfinite(value)]
        if not len(known):
            return {"norm": Normalize(0, 2)}, "neither", {}
        if self.quantity in TURNS:  # one colour for each of the first numbers, then for ranges
            most = int(known.max().round())
            borders = list(range(min(most, SINGLE) + 1))
            while borders[-1] >= SINGLE and (following := round(1.4 * borders[-1])) <= most:
                borders.append(following)
            spans = list(pairwise([*borders, most + 1]))
            shades = colormaps["viridis"](np.linspace(0.1, 1, max(1, len(spans) - 1)))
            colours = ListedColormap([NO_REVERSAL, *shades][: len(spans)])
            norm = BoundaryNorm(np.array([*borders, most + 1]) - 0.5, len(spans))
            ticks = {(a + b - 1) / 2: f"{a}" if b == a + 1 else f"{a} to {b - 1}" for a, b in spans}
            return {"cmap": colours, "norm": norm}, "neither", ticks
        low, high = (float(end) for end in np.percentile(known, TAILS))
        if low == high:
            low, high = sorted((low * 0.9, high * 1.1)) if low else (-1.0, 1.0)
        cut = {(True, True): "both", (True, False): "min", (False, True): "max"}
        extend = cut.get((bool(known.min() < low), bool(known.max() > high)), "neither")
        log = low > 0 and high > (4 if self.quantity is None else WIDE) * low
        return {"cmap": "viridis", "norm": (LogNorm if log else Normalize)(low, high)}, extend, {}


class Reversals(Map):
    """Number of turns by cell; where runs tell how many of them are sure, only these."""

    name = "reversals"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        there = [name for name in TURNS if name in layout.stored.schema.names]
        super().__init__(layout, x, there[0])
