"""Maps of a plane of parameters: types and times, or a column."""

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.patches import Patch
from numpy.typing import NDArray

from rattlesweep.analysis import style
from rattlesweep.analysis.layout import fill
from rattlesweep.analysis.plots.picture import (
    SIDE,
    WIDE,
    Arrangement,
    Handle,
    Panel,
    Picture,
    scale,
    within,
)
from rattlesweep.analysis.style import REGIME_STYLE, TYPE_STYLE, LabelLook, label
from rattlesweep.arrays import Floats
from rattlesweep.words.errors import ConfigError

_ENDS = (0.5, 99.5)  # percentiles at which the colour scale ends
MOST_DRAWN = 1200  # values along a side; a panel has fewer pixels
WIDE_RATIO = 4.0  # ratios are nearer to each other than other quantities
TYPES_SIDE = "types"
VALUES = "values"
# Columns that count turns, with the label of none.
NO_TURNS = {"n_turns": "no turns", "reversals_sure": "no confirmed turns"}


class Cells(NamedTuple):
    """Of each cell its state, its value, and ``n_c1 - n_i``."""

    code: NDArray[np.int8]  # of `Map.states`
    value: Floats
    beyond: Floats


class Colours(NamedTuple):
    """The scale of colours of the values."""

    norm: Normalize
    low: float
    high: float
    wide: bool  # whether it is logarithmic
    extend: str  # which ends leave values out, as Matplotlib says it


class Map(Picture):
    """Types and ``t_r/t_rGH`` side by side, or one column, as means over each cell."""

    panel = (3.7, 3.4)
    # What most runs of a cell are, by the names in `Counts`.
    marks: ClassVar[Mapping[str, LabelLook]] = TYPE_STYLE
    without = "failed"  # what a cell is called that has none of these

    @property
    def states(self) -> dict[str, tuple[str, str]]:
        """The states of a cell: one of `marks`, or why it has none."""
        states = {name: (mark.colour, mark.label) for name, mark in self.marks.items()}
        states["failed"] = style.FAILED_COLOUR, self.without
        states["missing"] = style.MISSING_COLOUR, "not run yet"
        return states

    def arrange(self) -> Arrangement:
        """Make the two longest axes the plane."""
        layout = self.layout
        # Bondi's line needs one body in a cell, and a steady spin that lasts.
        self.has_theory = bool(layout.bodies) and not layout.stored.config.acting
        means = []
        if self.quantity is not None:
            means.append(self.quantity)
        if self.has_theory:
            means += ["n_c1", "n_i"]
        self.more = tuple(dict.fromkeys(means))
        return self._plane()

    def _plane(self) -> Arrangement:
        """Return the two longest axes as the plane."""
        order = self.ordered(SIDE)
        if self.layout.lengths[order[0]] < 2:
            raise ConfigError(
                f"kind {self.name}: only one value of {order[0]} is left; it needs two"
            )
        if len(order) < 2:
            raise ConfigError(
                f"panels {self.panels}: one axis is left for a map; it needs two"
            )
        return Arrangement(order[:2], [*self.wished, *order[2:]], [])

    def shown(self) -> Cells:
        """Return what is drawn of each cell."""
        layout = self.layout
        cells, means = self.counted
        runs = cells["runs"]
        failed = len(self.marks)
        most = np.zeros(len(runs), runs.dtype)
        of_cells = np.where(runs == 0, failed + 1, failed).astype(np.int8)
        for mark, name in enumerate(self.marks):
            of_cells[cells[name] > most] = mark
            np.maximum(most, cells[name], out=most)
        code = self.grid(of_cells)
        if self.quantity is None:
            value = self.grid(cells.ratio.means())
        else:
            value = self.grid(means[self.quantity])
        beyond = np.full(code.shape, np.nan)
        if self.has_theory:
            beyond = self.grid(means["n_c1"] - means["n_i"])
        if not layout.refined:
            return Cells(code, value, beyond)
        # Fill where no run was integrated, not where a condition excludes the run.
        if layout.where is not None:
            runs = layout.chosen(None).count()[0]["runs"]
        done = self.grid(runs) > 0
        return Cells(fill(code, done), fill(value, done), fill(beyond, done))

    @property
    def parts(self) -> int:
        """The number of panels side by side for each combination of values."""
        return len(self.sides)

    @cached_property
    def sides(self) -> tuple[str, ...]:
        """What the panels show, without those that would have a single colour."""
        if self.quantity is not None:
            return (VALUES,)
        cells = self.shown()
        known = cells.value[np.isfinite(cells.value)]
        sides = []
        if len(np.unique(cells.code)) > 1 or not len(known):
            sides.append(TYPES_SIDE)
        if len(np.unique(known)) > 1 or not sides:
            sides.append(VALUES)
        return tuple(sides)

    def told(self) -> tuple[str, str]:
        """Return the words and the column for what reverses, or for the quantity."""
        if self.quantity is None:
            return "Map of types and times; fraction that reverses", "fraction_R"
        name = self.layout.name(self.quantity)
        return f"Map of the mean {name}", f"{name}_mean"

    def draw(self, panels: list[Panel], log: bool | None) -> list[Handle]:
        """Colour the cells, and draw Bondi's threshold between them."""
        self._thin()
        self.ylabel = label(self.axes[1].name)
        cells = self.shown()
        if self.quantity in NO_TURNS:
            # Cells without a turn are drawn in the colour of no turns.
            value = np.where(cells.value == 0, np.nan, cells.value)
            cells = cells._replace(value=value)
        colours = self._colours(cells.value)
        mesh: QuadMesh | None = None
        has_bondi = False
        for k, (axes, place, _) in enumerate(panels):
            here = Cells(
                within(cells.code, place)[self.drawn],
                within(cells.value, place)[self.drawn],
                within(cells.beyond, place)[self.drawn],
            )
            of_types = self.sides[k % self.parts] == TYPES_SIDE
            self._draw_states(axes, here, of_types)
            if not of_types:
                mesh = axes.pcolormesh(
                    *self.edges,
                    np.ma.masked_invalid(here.value.T),
                    rasterized=True,
                    norm=colours.norm,
                )
            has_bondi |= self._draw_bondi(axes, here.beyond)
            self._scale(axes, log)
        if TYPES_SIDE not in self.sides and self.quantity is None:
            name = list(self.states)[int(cells.code.flat[0])]
            self.notes.append(f"All cells are of one type, {self.states[name][1]}.")
        self._add_bar([panel.axes for panel in panels], mesh, colours)
        return self._entries(cells, has_bondi)

    def _thin(self) -> None:
        """Choose the cells that are drawn, at most `MOST_DRAWN` along each side."""
        self.drawn: tuple[slice, ...] = ()
        self.edges: list[Floats] = []
        for axis in self.axes[:2]:
            count = len(axis.values)
            step = math.ceil(count / MOST_DRAWN)
            self.drawn += (slice(None, None, step),)
            self.edges.append(np.append(axis.edges[:-1:step], axis.edges[-1]))
            if step > 1:
                self.notes.append(
                    f"Of the {count:,} values of {axis.name}, one in {step} is drawn."
                )

    def _scale(self, axes: Axes, log: bool | None) -> None:
        """Scale and limit the axes of a panel."""
        x, y = self.axes[:2]
        scale(axes, "x", x, log)
        scale(axes, "y", y, log)
        axes.set(xlim=x.edges[[0, -1]], ylim=y.edges[[0, -1]])

    def _colours(self, value: Floats) -> Colours:
        """Return the scale of colours, from a low to a high percentile."""
        known = value[np.isfinite(value)]
        if not len(known):
            known = np.array([0.0, 2.0])
        low, high = (float(end) for end in np.percentile(known, _ENDS))
        widest = WIDE_RATIO if self.quantity is None else WIDE
        wide = low > 0 and high > widest * low
        norm = LogNorm(low, high) if wide else Normalize(low, high)
        below = bool(known.min() < low)
        above = bool(known.max() > high)
        extend = "neither"
        if below and above:
            extend = "both"
        elif below:
            extend = "min"
        elif above:
            extend = "max"
        return Colours(norm, low, high, wide, extend)

    def _draw_states(self, axes: Axes, here: Cells, of_types: bool) -> None:
        """Colour the cells by their states."""
        colours = [colour for colour, _ in self.states.values()]
        if not of_types:
            # What shows between the values is a type without a value.
            count = len(self.marks)
            colours[:count] = [style.NO_REVERSAL] * count
        axes.pcolormesh(
            *self.edges,
            here.code.T,
            rasterized=True,
            vmin=-0.5,
            vmax=len(colours) - 0.5,
            cmap=ListedColormap(colours),
        )

    def _draw_bondi(self, axes: Axes, beyond: Floats) -> bool:
        """Draw Bondi's threshold, and return whether it crosses the panel."""
        lowest = np.nanmin(beyond, initial=0)
        highest = np.nanmax(beyond, initial=0)
        if not lowest < 0 < highest:
            return False
        x, y = (
            axis.values[drawn]
            for axis, drawn in zip(self.axes[:2], self.drawn, strict=True)
        )
        # A dark line with a light rim is visible on every colour.
        for colour, width in (("#FFFFFF", 2.8), (style.BLACK, 1.3)):
            axes.contour(
                x,
                y,
                beyond.T,
                [0],
                colors=colour,
                linewidths=width,
                linestyles="solid",
            )
        return True

    def _add_bar(
        self, every: list[Axes], mesh: QuadMesh | None, colours: Colours
    ) -> None:
        """Add the bar of colours, the titles and the meaning of the values."""
        several = bool(self.counted[0]["runs"].max() > 1)
        mean = "mean " if several else ""
        if self.quantity is None:
            types = "most common type" if several else "type"
            titles = {TYPES_SIDE: types, VALUES: mean + label("ratio")}
            for axes, side in zip(every, self.sides, strict=False):
                axes.set_title(titles[side], fontsize="medium")
            bar_label = mean + label("ratio")
            meaning = (
                "t_r is the time of the first reversal, t_rGH that of Garcia and "
                "Hubbard."
            )
        else:
            unit, description = self.layout.column(self.quantity, "quantity")
            bar_label = mean + label(self.quantity, unit)
            meaning = f"{self.quantity}: {description}."
        if mesh is None:
            return
        self.notes.append(meaning)
        figure: Any = every[0].figure
        bar = figure.colorbar(
            mesh, ax=every, pad=0.03, aspect=35, extend=colours.extend
        )
        bar.set_label(bar_label)
        if colours.wide:
            style.plain_ticks(bar.ax, "y", colours.low, colours.high)
        elif colours.low == colours.high:
            # A scale around the only value would be invented.
            bar.set_ticks([colours.low])

    def _entries(self, cells: Cells, has_bondi: bool) -> list[Handle]:
        """Return the legend entries of the states that occur."""
        nothing = "no reversal"
        if self.quantity is not None:
            nothing = NO_TURNS.get(self.quantity, "no value")
        entries = self.states | {"none": (style.NO_REVERSAL, nothing)}
        if self.layout.where is not None:
            entries["missing"] = (style.MISSING_COLOUR, "not selected")
        present = {name for k, name in enumerate(self.states) if k in cells.code}
        if TYPES_SIDE not in self.sides:
            present -= self.marks.keys()
        is_typed = cells.code < len(self.marks)
        if VALUES in self.sides and (is_typed & np.isnan(cells.value)).any():
            present.add("none")
        handles: list[Handle] = [
            Patch(facecolor=colour, label=text, edgecolor=style.GREY, linewidth=0.5)
            for name, (colour, text) in entries.items()
            if name in present
        ]
        if has_bondi:
            handles.append(
                style.entry(
                    style.BONDI, color=style.BLACK, linestyle="-", linewidth=1.3
                )
            )
            self.notes.append("Bondi's threshold of the steady spin: |n_i| = |n_c1|.")
        return handles


class Regimes(Map):
    """The regime of most runs of each cell."""

    marks: ClassVar[Mapping[str, LabelLook]] = {
        f"regime_{name}": mark for name, mark in REGIME_STYLE.items()
    }
    without = "unknown"
    sides = (TYPES_SIDE,)

    def arrange(self) -> Arrangement:
        """Make the two longest axes the plane, without Bondi's line."""
        self.has_theory = False
        return self._plane()

    def told(self) -> tuple[str, str]:
        """Return the words and the column for strange attractors."""
        return "Map of regimes; fraction of strange attractors", "fraction_attractor"

    def draw(self, panels: list[Panel], log: bool | None) -> list[Handle]:
        """Colour the cells."""
        self._thin()
        self.ylabel = label(self.axes[1].name)
        # Every regime has a value, so the legend names no missing ones.
        cells = self.shown()
        cells = cells._replace(value=np.ones(cells.code.shape))
        for axes, place, _ in panels:
            here = cells._replace(code=within(cells.code, place)[self.drawn])
            self._draw_states(axes, here, of_types=True)
            self._scale(axes, log)
        self.notes.append(
            "Regimes follow from the Lyapunov exponents of the second half of each "
            "run; where that is too short, they are undecided."
        )
        return self._entries(cells, has_bondi=False)
