"""Maps over two axes: which type each cell is, and how long its reversal takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize
from matplotlib.patches import Patch

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.analysis.boundaries import Boundaries, boundaries
from rattlesweep.analysis.plots.bondi import threshold
from rattlesweep.analysis.plots.counts import Counted
from rattlesweep.analysis.plots.layout import Axis, Layout
from rattlesweep.analysis.plots.panels import (
    Panel,
    draw_panels,
    entry,
    legend_above,
    plain_ticks,
    scale_axis,
)
from rattlesweep.analysis.style import FAILED, MISSING, TYPE_STYLE, label
from rattlesweep.sweeps.config.schema import GridSource

# From this many values on along both sides, a grid is a map.
SIDE = 8
# Points along each axis at which theory is known.
FINE = 500
# Neither the grey of a type nor the white of what is missing.
NO_REVERSAL = "#D0D0D0"
# A dark line with a light rim is seen on every colour.
LINES: tuple[dict[str, Any], ...] = (
    {"colors": "#FFFFFF", "linewidths": 2.8, "zorder": 5.5},
    {"colors": "#000000", "linewidths": 1.3, "zorder": 6},
)
BONDI_LABEL = r"Bondi's threshold, $|n_i| = |n_{c1}|$"
GROWTH = "growth"
BALANCE_LABEL = "growth at the launch balances damping"
BALANCE: dict[str, Any] = {"color": "#000000", "linestyle": "--", "linewidth": 1.3}
# Ratios beyond these are drawn in the end colours; within them most of a map lies.
TAILS = (0.5, 99.5)
# What a cell is: its most common type, or none of them.
CELLS = {
    **{name: (mark.colour, mark.label) for name, mark in TYPE_STYLE.items()},
    "failed": (FAILED, "failed"),
    "missing": (MISSING, "not run yet"),
}
CODES = {name: code for code, name in enumerate(CELLS)}


class Map(Counted):
    """Types on the left and ``t_r/t_rGH`` on the right, one row for each further value."""

    name = "map"
    caption = "Types, and reversal times in units of Garcia and Hubbard's."

    def __init__(self, layout: Layout, x: str | None, more: Sequence[str] = ()) -> None:
        super().__init__(layout, x, (*more, *([GROWTH] if layout.config.dissipation else [])))
        for axis in self.axes[:2]:
            if len(axis.values) < 2:
                raise ConfigError(
                    f"--kind map: only one value of {axis.name} is left; a map needs two or more"
                )

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Where there are two axes."""
        return sum(count > 1 for count in layout.lengths.values()) >= 2

    @staticmethod
    def order(layout: Layout, x: str | None) -> Sequence[str]:
        """The longest; of equal length, bodies along the abscissa and spins along the ordinate."""
        names = [*layout.targets, *layout.bodies, *layout.launch]
        names.sort(key=lambda name: -min(layout.lengths[name], SIDE))
        first = x or names[0]
        return (first, *(n for n in names if n != first and layout.lengths[n] > 1))

    def size(self) -> tuple[float, float]:
        """By the number of rows."""
        return 9.0, float(np.clip(1.2 + 3.4 * np.prod(self.shape[2:]), 4.6, 14))

    def draw(self, figure: Any, log: bool | None) -> None:
        """Cells as they are, and Bondi's line where theory knows it."""
        x, y, *rows = self.axes
        panels = draw_panels(figure, rows, (), parts=2)
        titles = ("type", r"$t_r/t_{rGH}$")
        if self.cells.runs.max() > 1:
            titles = ("most common type", r"mean $t_r/t_{rGH}$")
        code, ratio = self.shown()
        norm, extend = _ratio_norm(ratio)
        bondi = balance = False
        for panel in panels:
            self._paint_types(panel, code, grey=panel.part == 1)
            if panel.part:
                mesh = self._paint(panel, ratio, cmap="viridis", norm=norm)
            else:
                panel.axes.set_ylabel(label(y.name))
            bondi |= self._bondi(panel)
            balance |= self._balance(panel)
            self._scale(panel, log)
            if panel.row == 0:
                panel.axes.set_title(titles[panel.part], fontsize="medium")
        figure.supxlabel(label(x.name), fontsize="medium")
        if extend:
            bar = figure.colorbar(mesh, ax=[p.axes for p in panels], extend=extend, pad=0.03,
                                  aspect=30 if len(panels) < 4 else 45)  # fmt: skip
            bar.set_label(r"$t_r/t_{rGH}$ of runs that reverse")
            if isinstance(norm, LogNorm):
                plain_ticks(bar.ax, "y", (float(norm.vmin or 1), float(norm.vmax or 1)))
        for panel, found in zip((p for p in panels if not p.part), self.boundaries(), strict=True):
            if np.isfinite(found.exponent):
                panel.axes.set_title(found.symbols, loc="right", fontsize="x-small")
        self._legend(figure, set(np.unique(code)), bondi, balance)

    def _paint(self, panel: Panel, values: Any, **look: Any) -> Any:
        """Cells of a panel by a number, over what is there where there is none."""
        x, y, *_ = self.axes
        shown = np.ma.masked_invalid(values[(slice(None), slice(None), *panel.where)].T)
        return panel.axes.pcolormesh(_edges(x), _edges(y), shown, rasterized=True, **look)

    def _paint_types(self, panel: Panel, code: Integers, *, grey: bool) -> None:
        """Cells of a panel by what they are; in `grey` all those that have a type."""
        colours = [colour for colour, _ in CELLS.values()]
        if grey:
            colours[: len(TYPE_STYLE)] = [NO_REVERSAL] * len(TYPE_STYLE)
        norm = BoundaryNorm(np.arange(len(CELLS) + 1) - 0.5, len(CELLS))
        self._paint(panel, code, cmap=ListedColormap(colours), norm=norm)

    def _scale(self, panel: Panel, log: bool | None) -> None:
        """Scales and ends of a panel's axes."""
        for which, axis in zip("xy", self.axes, strict=False):
            scale_axis(panel.axes, which, axis.values, axis.logarithmic(log), axis.name)
            ends = _edges(axis)
            getattr(panel.axes, f"set_{which}lim")(ends[0], ends[-1])

    def shown(self) -> tuple[Integers, Floats]:
        """Codes and ratios of all cells; of those that a refined map has left out, as inferred."""
        code, ratio = self._codes(), self.grid(self.cells.ratio.means())
        bodies = self.layout.config.bodies
        if isinstance(bodies, GridSource) and bodies.refine is not None:
            for row in np.ndindex(*code.shape[2:]):
                here = (slice(None), slice(None), *row)
                code[here], ratio[here] = inferred(code[here], ratio[here])
        return code, ratio

    def boundaries(self) -> list[Boundaries]:
        """How ragged the boundaries between types are, in each row of panels."""
        code, _ = self.shown()
        rows = np.ndindex(*code.shape[2:])
        return [boundaries(code[(slice(None), slice(None), *row)]) for row in rows]

    def words(self) -> str:
        """How much is shown, and what its boundaries are like."""
        bodies, lines = self.layout.config.bodies, [super().words()]
        if isinstance(bodies, GridSource) and bodies.refine is not None:
            lines[0] += f" of {self.layout.manifest.samples * len(self.layout.manifest.cases):,}"
        if self.name == Map.name:
            lines += [found.words for found in self.boundaries() if np.isfinite(found.exponent)]
        return "; ".join(lines)

    def _codes(self) -> Integers:
        """What each cell is, as a place in `CELLS`."""
        none = np.zeros(self.cells.runs.shape, dtype=np.int64)
        found = self.cells.types
        counts = np.stack([self.grid(found.get(name, none)) for name in TYPE_STYLE])
        code = np.argmax(counts, axis=0)
        code = np.where(counts.sum(axis=0) == 0, CODES["failed"], code)
        return np.where(self.grid(self.cells.runs) == 0, CODES["missing"], code)

    def _bondi(self, panel: Panel) -> bool:
        """Draw Bondi's line where theory knows it; whether it did."""
        if self.layout.config.dissipation:
            return False  # no spin stays beyond it
        x, y, *rest = self.axes
        at = {a.name: a.values for a in self.layout.axes.values() if len(a.values) == 1}
        at |= {a.name: a.values[[k]] for a, k in zip(rest, panel.where, strict=True)}
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
            panel.axes.contour(at[x.name], at[y.name], np.broadcast_to(beyond, (FINE, FINE)), [0],
                               linestyles="solid", **line)  # fmt: skip
        return True

    def _balance(self, panel: Panel) -> bool:
        """Draw where the relevant oscillation, at the launch, neither grows nor decays; whether it
        did.
        """
        if GROWTH not in self.moments:
            return False
        x, y, *_ = self.axes
        here: Any = (slice(None), slice(None), *panel.where)
        mean = self.grid(self.moments[GROWTH].means())[here]
        if not (np.nanmin(mean, initial=0) < 0 < np.nanmax(mean, initial=0)):
            return False
        for line in LINES:
            panel.axes.contour(x.values, y.values, mean.T, [0], linestyles=["--"], **line)
        return True

    def _legend(self, figure: Any, codes: set[int], bondi: bool, balance: bool) -> None:
        handles: list[Any] = [patch(*look) for name, look in CELLS.items() if CODES[name] in codes]
        if codes & {CODES[name] for name in TYPE_STYLE if name != "R"}:
            handles.append(patch(NO_REVERSAL, "right: no reversal"))
        if bondi:
            handles.append(entry(BONDI_LABEL, color="#000000", linestyle="-", linewidth=1.3))
        handles += [entry(BALANCE_LABEL, **BALANCE)] if balance else []
        legend_above(figure, handles, 1.9)


def patch(colour: str, words: str) -> Patch:
    """Cells of a colour in a legend."""
    return Patch(facecolor=colour, label=words, edgecolor="#555555", linewidth=0.5)


def inferred(code: Integers, ratio: Floats) -> tuple[Integers, Floats]:
    """Types and ratios of a plane, with those of the nearest run, or of a line between runs, where
    none was done.
    """
    from scipy.interpolate import LinearNDInterpolator
    from scipy.ndimage import distance_transform_edt

    missing = code == CODES["missing"]
    if not missing.any() or missing.all():
        return code, ratio
    nearest = tuple(distance_transform_edt(missing, return_distances=False, return_indices=True))
    code, near = code[nearest], ratio[nearest]
    wanted, known = missing & (code == CODES["R"]), ~missing & np.isfinite(ratio)
    if wanted.any() and all(len(np.unique(place)) > 1 for place in np.nonzero(known)):
        between = LinearNDInterpolator(np.argwhere(known), ratio[known])(np.argwhere(wanted))
        near[wanted] = np.where(np.isfinite(between), between, near[wanted])
    return code, np.where(missing & (code != CODES["R"]), np.nan, near)


def _edges(axis: Axis) -> Floats:
    """Borders of the cells around an axis's values."""
    values = np.log(axis.values) if axis.logarithmic() else axis.values
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middle = (values[1:] + values[:-1]) / 2
    edges = np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])
    return np.exp(edges) if axis.logarithmic() else edges


def _ratio_norm(ratio: Floats) -> tuple[Normalize, str]:
    """Colours of the ratio, logarithmic where it spans a factor of four, and which ends are cut."""
    known = ratio[np.isfinite(ratio) & (ratio > 0)]
    if not len(known):
        return Normalize(0, 2), ""
    low, high = (float(end) for end in np.percentile(known, TAILS))
    if low == high:
        low, high = low * 0.9, high * 1.1
    cut = {(True, True): "both", (True, False): "min", (False, True): "max"}
    extend = cut.get((bool(known.min() < low), bool(known.max() > high)), "neither")
    return (LogNorm if high > 4 * low else Normalize)(low, high), extend
