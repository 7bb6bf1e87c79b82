"""Maps over two axes: the type of each cell, its reversal time, its turns, or any column."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize
from matplotlib.patches import Patch

from rattlesweep.analysis.grids import Boundaries, boundaries, fill
from rattlesweep.analysis.plots.layout import Axis, Layout
from rattlesweep.analysis.plots.picture import (
    WIDE,
    Picture,
    draw_panels,
    entry,
    plain_ticks,
    scale_axis,
)
from rattlesweep.analysis.style import FAILED, MISSING, NO_REVERSAL, TYPE_STYLE, label
from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.physics.theory import bondi_threshold
from rattlesweep.sweeps.bodies.sources import make_source
from rattlesweep.sweeps.config.read import parse_config, resolved

# From this many values on along both sides, a grid is a map.
SIDE = 8
# Points along each axis at which theory is evaluated.
FINE = 500
# A dark line with a light rim is seen on every colour.
LINES: tuple[dict[str, Any], ...] = (
    {"colors": "#FFFFFF", "linewidths": 2.8, "zorder": 5.5},
    {"colors": "#000000", "linewidths": 1.3, "zorder": 6},
)
BONDI_LABEL = "Bondi's threshold"
BALANCE_LABEL = "balanced damping"
GROWTH = "growth"
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
TURNS, SURE_TURNS = "n_turns", "reversals_sure"


class Map(Picture):
    """Types and ``t_r/t_rGH`` side by side, or one column; a row for each further value.

    A cell of several runs has their most common type and their mean. The cells that a refined grid
    has left out are filled from those that were run.
    """

    name = "map"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        super().__init__(layout, x, quantity)
        for axis in self.axes[:2]:
            if len(axis.values) < 2:
                raise ConfigError(
                    f"--kind map: only one value of {axis.name} is left; a map needs two or more"
                )
        # The column that is shown, and what the line of balanced damping needs.
        growth = (GROWTH,) if layout.config.dissipation else ()
        self.more = tuple(dict.fromkeys((*filter(None, [quantity]), *growth)))

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Tell whether there are two axes."""
        return sum(count > 1 for count in layout.lengths.values()) >= 2

    @classmethod
    def order(cls, layout: Layout, x: str | None) -> Sequence[str]:
        """Return the longest; of equal length, bodies are the abscissa and spins the ordinate."""
        names = [*layout.targets, *layout.bodies, *layout.launch]
        names.sort(key=lambda name: -min(layout.lengths[name], SIDE))
        first = x or names[0]
        return (first, *(n for n in names if n != first and layout.lengths[n] > 1))

    def size(self) -> tuple[float, float]:
        """Return a size by the number of rows."""
        high = float(np.clip(1.2 + 3.4 * np.prod(self.shape[2:]), 4.6, 14))
        return (9.0 if self.quantity is None else 6.4), high

    # -- numbers -------------------------------------------------------------------------------

    def shown(self) -> tuple[Integers, Floats]:
        """Return what each cell is (a place in `CELLS`), and its ratio or column."""
        cells = self.cells
        none = np.zeros(cells.runs.shape, dtype=np.int64)
        counts = np.stack([self.grid(cells.types.get(name, none)) for name in TYPE_STYLE])
        code = np.argmax(counts, axis=0)
        code = np.where(counts.sum(axis=0) == 0, CODES["failed"], code)
        runs, name = self.grid(cells.runs), self.quantity
        code = np.where(runs == 0, CODES["missing"], code)
        value = self.grid(cells.ratio.means()) if name is None else self.mean(name)
        if self.layout.refined:
            code, value = fill(code, self.done), fill(value, self.done)
        return code, value

    @cached_property
    def done(self) -> Flags:
        """Cells that hold runs, whether a condition chooses them or not."""
        runs = self.grid(self.cells.runs)
        if self.layout.where is not None:
            runs = np.zeros(self.shape, np.int64)
            for rows in self.layout.stored.batches(["case", "sample"]):
                cell = self.layout.cells(rows, self.axes)
                runs.ravel()[cell[cell >= 0]] = 1
        return runs > 0

    def boundaries(self) -> list[Boundaries]:
        """Return how ragged the boundaries between types are, in each row of panels."""
        code, _ = self.shown()
        rows = np.ndindex(*code.shape[2:])
        return [boundaries(code[(slice(None), slice(None), *row)]) for row in rows]

    def words(self) -> str:
        """Return how much is shown, and what its boundaries are like."""
        lines = [super().words()]
        if self.layout.refined:
            stored = self.layout.stored
            lines[0] += f", which fill a grid of {stored.samples * len(stored.cases):,}"
        if self.quantity is None:
            lines += [found.words for found in self.boundaries() if np.isfinite(found.exponent)]
        return "; ".join(lines)

    # -- the figure ----------------------------------------------------------------------------

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw the cells, and Bondi's line where theory gives it."""
        x, y, *rows = self.axes
        types_too = self.quantity is None
        panels = draw_panels(figure, rows, (), label(x.name), parts=2 if types_too else 1)
        several = self.cells.runs.max() > 1
        code, value = self.shown()
        look, extend, set_ticks = self.colours(value)
        bondi = balance = False
        mesh: Any = None
        for k, (axes, where) in enumerate(panels):
            here: Any = (slice(None), slice(None), *where)
            on_types = types_too and k % 2 == 0
            colours = [colour for colour, _ in CELLS.values()]
            if not on_types:  # where there is a type and no value
                colours[: len(TYPE_STYLE)] = [NO_REVERSAL] * len(TYPE_STYLE)
            norm = BoundaryNorm(np.arange(len(CELLS) + 1) - 0.5, len(CELLS))
            self._paint(axes, code[here], cmap=ListedColormap(colours), norm=norm)
            if not on_types:
                mesh = self._paint(axes, value[here], **look)
            if on_types or not types_too:
                axes.set_ylabel(label(y.name))
            bondi |= self._bondi(axes, where)
            balance |= self._balance(axes, here)
            for which, axis in (("x", x), ("y", y)):
                scale_axis(axes, which, axis.values, axis.logarithmic(log), axis.name)
                ends = _edges(axis)
                getattr(axes, f"set_{which}lim")(ends[0], ends[-1])
        mean = "mean " if several else ""
        if types_too:
            titles = "most common type" if several else "type", mean + label("ratio")
            for (axes, _), title in zip(panels, titles, strict=False):
                axes.set_title(title, fontsize="medium")
        if np.isfinite(value).any():
            bar = figure.colorbar(mesh, ax=[axes for axes, _ in panels], pad=0.03, extend=extend,
                                  aspect=30 if len(panels) < 4 else 45)  # fmt: skip
            bar.set_label(mean + label(self.quantity or "ratio", self.unit or None))
            set_ticks(bar)
        self.notes += self.remarks()

        present = set(np.unique(code))
        if not types_too:  # types are not told apart
            present -= {CODES[name] for name in TYPE_STYLE}
        looks = CELLS | ({"missing": (MISSING, "not selected")} if self.layout.where else {})
        handles: list[Any] = [patch(*looks[name]) for name in CELLS if CODES[name] in present]
        if ((code < len(TYPE_STYLE)) & np.isnan(value)).any():
            timed = self.quantity in (None, "t_r", "t_r_s", "t_r_error")
            handles.append(patch(NO_REVERSAL, "no reversal" if timed else "no value"))
        if bondi:
            handles.append(entry(BONDI_LABEL, color="#000000", linestyle="-", linewidth=1.3))
            self.notes.append("Bondi's threshold of the steady spin: |n_i| = |n_c1|.")
        if balance:
            handles.append(entry(BALANCE_LABEL, color="#000000", linestyle="--", linewidth=1.3))
            self.notes.append("Dashed: the oscillation's growth at the launch balances damping.")
        if extend != "neither":
            self.notes.append("Values beyond the ends of the colour bar have its end colours.")
        return handles

    def remarks(self) -> list[str]:
        """Return what the caption says first."""
        if self.quantity is None:
            return ["t_r is the time of the first reversal (the first zero of the spin), t_rGH "
                    "that of Garcia and Hubbard's theory."]  # fmt: skip
        words = self.layout.stored.schema.field(self.quantity).metadata[b"description"].decode()
        return [f"{self.quantity}: {words}."]

    def colours(self, value: Floats) -> tuple[dict[str, Any], str, Callable[[Any], None]]:
        """Return the colours of values, logarithmic where they spread, and the colour bar's ends.

        The last is what sets the bar's ticks.
        """
        known = value[np.isfinite(value)]
        if not len(known):
            return {"norm": Normalize(0, 2)}, "neither", lambda bar: None
        low, high = (float(end) for end in np.percentile(known, TAILS))
        if low == high:
            low, high = sorted((low * 0.9, high * 1.1)) if low else (-1.0, 1.0)
        cut = {(True, True): "both", (True, False): "min", (False, True): "max"}
        extend = cut.get((bool(known.min() < low), bool(known.max() > high)), "neither")
        log = low > 0 and high > (4 if self.quantity is None else WIDE) * low
        norm = (LogNorm if log else Normalize)(low, high)

        def set_ticks(bar: Any) -> None:
            if log:
                plain_ticks(bar.ax, "y", (low, high))

        return {"cmap": "viridis", "norm": norm}, extend, set_ticks

    def _paint(self, axes: Any, values: Any, **look: Any) -> Any:
        """Colour cells by a number; those without one stay as they are."""
        x, y, *_ = self.axes
        shown = np.ma.masked_invalid(values.T)
        return axes.pcolormesh(_edges(x), _edges(y), shown, rasterized=True, **look)

    def _bondi(self, axes: Any, where: tuple[int, ...]) -> bool:
        """Draw Bondi's line where theory gives it; return whether it did."""
        if self.layout.config.dissipation:
            return False  # no spin stays beyond it
        x, y, *rest = self.axes
        at = {a.name: a.values for a in self.layout.axes.values() if len(a.values) == 1}
        at |= {a.name: a.values[[k]] for a, k in zip(rest, where, strict=True)}
        ends = [a.values if a.name in self.layout.bodies else _edges(a) for a in (x, y)]
        at |= {a.name: np.linspace(e[0], e[-1], FINE) for a, e in zip((x, y), ends, strict=True)}
        along = [name for name in self.layout.bodies if name in (x.name, y.name)]
        if not along or not {"n_i", *self.layout.bodies} <= at.keys():
            return False  # bodies of several thresholds share a cell
        # Over both of these axes, or over one of them for all values of the other.
        n_c1 = threshold(self.layout, at).reshape(FINE, -1)
        n_c1 = n_c1.T if along[0] == x.name else n_c1
        # No threshold is one beyond all spins.
        beyond = np.maximum(n_c1 - (at["n_i"][:, None] if y.name == "n_i" else at["n_i"]), -1e3)
        if not beyond.min() < 0 < beyond.max():
            return False
        for line in LINES:
            axes.contour(at[x.name], at[y.name], np.broadcast_to(beyond, (FINE, FINE)), [0],
                         linestyles="solid", **line)  # fmt: skip
        return True

    def _balance(self, axes: Any, here: tuple[Any, ...]) -> bool:
        """Draw where the relevant oscillation neither grows nor decays at the launch."""
        if GROWTH not in self.more:
            return False
        x, y, *_ = self.axes
        mean = self.mean(GROWTH)[here]
        if not (np.nanmin(mean, initial=0) < 0 < np.nanmax(mean, initial=0)):
            return False
        for line in LINES:
            axes.contour(x.values, y.values, mean.T, [0], linestyles=["--"], **line)
        return True


class Reversals(Map):
    """Number of turns by cell, the mean of several runs, in steps of one while it is small.

    Where the runs tell how many of their turns are sure, these are shown.
    """

    name = "reversals"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        there = SURE_TURNS in layout.stored.schema.names
        super().__init__(layout, x, SURE_TURNS if there else TURNS)

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Tell whether turns are recorded, and there are two axes."""
        return "reversals" in layout.config.record and Map.fits(layout)

    def remarks(self) -> list[str]:
        """Return what is counted."""
        found = [
            "Turns by the horizon: the spin goes from beyond a quarter of the launch's to beyond a "
            "quarter on the other side. A run of type R may have a zero of the spin and no turn."
        ]
        if self.quantity == SURE_TURNS:
            return [*found, "Shown are the first turns that the error estimate confirms; the runs "
                    f"may have more ({TURNS})."]  # fmt: skip
        return [*found, "Not all of many turns need be sure: record: [reversals, error] counts "
                "those that are."]  # fmt: skip

    def colours(self, value: Floats) -> tuple[dict[str, Any], str, Callable[[Any], None]]:
        """Return one colour for each of the first numbers and for ranges of larger ones."""
        most = int(np.nanmax(value, initial=0).round())
        borders = list(range(min(most, SINGLE) + 1))
        while (following := round(1.4 * borders[-1])) <= most and following > borders[-1]:
            borders.append(following)
        borders.append(most + 1)
        shades = colormaps["viridis"](np.linspace(0.1, 1, max(1, len(borders) - 2)))
        colours = ListedColormap([NO_REVERSAL, *shades][: len(borders) - 1])
        norm = BoundaryNorm(np.array(borders) - 0.5, len(borders) - 1)

        def set_ticks(bar: Any) -> None:
            pairs = list(pairwise(borders))
            bar.set_ticks(
                [(a + b - 1) / 2 for a, b in pairs],
                labels=[str(a) if b == a + 1 else f"{a} to {b - 1}" for a, b in pairs],
            )
            bar.ax.tick_params(which="both", length=0)

        return {"cmap": colours, "norm": norm}, "neither", set_ticks


def patch(colour: str, words: str) -> Patch:
    """Make an entry of a legend for cells of a colour."""
    return Patch(facecolor=colour, label=words, edgecolor="#555555", linewidth=0.5)


def threshold(layout: Layout, values: Mapping[str, Floats]) -> Floats:
    """Return Bondi's ``n_c1`` of a grid of bodies with other `values` along its axes.

    The first of `layout.bodies` varies slowest; where there is no threshold, it is -infinity. It
    comes from theory and not from the runs, so it is known between the cells too.
    """
    data = resolved(layout.config)
    if "c" in layout.bodies:  # among the axes or beside them
        data["bodies"].pop("c", None)
    data["bodies"]["axes"] = {name: values[name].tolist() for name in layout.bodies}
    source = make_source(parse_config(data))
    body = source.bodies(np.nan, np.arange(source.samples))
    n_c1 = bondi_threshold(body.alpha, body.beta, body.gamma, body.theta, body.phi)
    return np.nan_to_num(n_c1, nan=-np.inf)


def _edges(axis: Axis) -> Floats:
    """Return the borders of the cells around an axis's values."""
    values = np.log(axis.values) if axis.logarithmic() else axis.values
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middle = (values[1:] + values[:-1]) / 2
    edges = np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])
    return np.exp(edges) if axis.logarithmic() else edges
