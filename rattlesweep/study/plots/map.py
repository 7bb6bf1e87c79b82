"""Maps over two axes: which type each cell is, and how long its reversal takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from rattlesweep.errors import ConfigError
from rattlesweep.study.plots.bondi import threshold_line, threshold_plane
from rattlesweep.study.plots.counts import Counts
from rattlesweep.study.plots.kind import Kind, Lengths
from rattlesweep.study.plots.layout import Axis, Layout
from rattlesweep.study.plots.panels import draw_panels, legend_above, scale_axis
from rattlesweep.study.style import FAILED, MISSING, TYPE_STYLE, label

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# From this many values on along both sides, a grid is a map.
SIDE = 8
# Neither the grey of a type nor the white of what is missing.
NO_REVERSAL = "#D0D0D0"
# A dark line with a light rim is seen on every colour.
LINE: dict[str, Any] = {"color": "#000000", "linewidth": 1.3, "zorder": 6}
RIM: dict[str, Any] = {"color": "#FFFFFF", "linewidth": 2.8, "zorder": 5.5}
BONDI_LABEL = r"Bondi's threshold, $|n_i| = |n_{c1}|$"
# Ratios beyond these are drawn in the end colours; within them most of a map lies.
TAILS = (0.5, 99.5)


def draw(figure: Any, counted: Counts, log: bool | None) -> None:
    """Types on the left and ``t_r/t_rGH`` on the right, one row for each further value."""
    x, y, *rows = counted.axes
    panels = draw_panels(figure, rows, (), parts=2)
    titles = ("type", r"$t_r/t_{rGH}$")
    if counted.cells.runs.max() > 1:
        titles = ("most common type", r"mean $t_r/t_{rGH}$")
    code = _codes(counted)
    ratio = counted.grid(counted.cells.ratio.means())
    kinds = np.unique(code)
    norm, shown = _ratio_norm(ratio)
    mesh = None
    bondi = False
    for panel in panels:
        here: Any = (slice(None), slice(None), *panel.where)
        if panel.part == 0:
            _types(panel.axes, x, y, code[here].T)
        else:
            mesh = _ratios(panel.axes, x, y, ratio[here].T, code[here].T, norm)
        bondi |= _bondi(panel.axes, counted, panel.where)
        scale_axis(panel.axes, "x", x, log)
        scale_axis(panel.axes, "y", y, log)
        panel.axes.set_xlim(*_edges(x)[[0, -1]])
        panel.axes.set_ylim(*_edges(y)[[0, -1]])
        if panel.row == 0:
            panel.axes.set_title(titles[panel.part], fontsize="medium")
    for panel in panels:
        if panel.part == 0:
            panel.axes.set_ylabel(label(y.name))
    figure.supxlabel(label(x.name), fontsize="medium")
    if mesh is not None and shown:
        bar = figure.colorbar(mesh, ax=[p.axes for p in panels], extend=shown, pad=0.03,
                              aspect=30 if len(panels) < 4 else 45)  # fmt: skip
        bar.set_label(r"$t_r/t_{rGH}$ of runs that reverse")
        _bar_ticks(bar, norm)
    _legend(figure, kinds, bondi, gaps=bool((code == _CODES["missing"]).any()))


_CODES = {**{name: code for code, name in enumerate(TYPE_STYLE)}, "failed": 4, "missing": 5}


def _codes(counted: Counts) -> NDArray[np.int64]:
    """The most common type of each cell, or failed, or missing."""
    counts = np.stack([counted.grid(counted.cells.types[name]) for name in TYPE_STYLE])
    code = np.argmax(counts, axis=0)
    code = np.where(counts.sum(axis=0) == 0, _CODES["failed"], code)
    return np.where(counted.grid(counted.cells.runs) == 0, _CODES["missing"], code)


def _edges(axis: Axis) -> Floats:
    """Borders of the cells around an axis's values."""
    values = np.log(axis.values) if axis.logarithmic else axis.values
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middle = (values[1:] + values[:-1]) / 2
    edges = np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])
    return np.exp(edges) if axis.logarithmic else edges


def _types(axes: Any, x: Axis, y: Axis, code: NDArray[np.int64]) -> None:
    colours = ListedColormap([*(style[0] for style in TYPE_STYLE.values()), FAILED, MISSING])
    axes.pcolormesh(_edges(x), _edges(y), code, cmap=colours, rasterized=True,
                    norm=BoundaryNorm(np.arange(7) - 0.5, 6))  # fmt: skip


def _ratios(
    axes: Any, x: Axis, y: Axis, ratio: Floats, code: NDArray[np.int64], norm: Normalize
) -> Any:
    ground = np.where(code == _CODES["failed"], 1.0, np.where(code == _CODES["missing"], 2.0, 0.0))
    axes.pcolormesh(_edges(x), _edges(y), ground, rasterized=True,
                    cmap=ListedColormap([NO_REVERSAL, FAILED, MISSING]),
                    norm=BoundaryNorm(np.arange(4) - 0.5, 3))  # fmt: skip
    return axes.pcolormesh(_edges(x), _edges(y), np.ma.masked_invalid(ratio), cmap="viridis",
                           norm=norm, rasterized=True)  # fmt: skip


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


def _bar_ticks(bar: Any, norm: Normalize) -> None:
    if isinstance(norm, LogNorm):
        low, high = float(norm.vmin or 1), float(norm.vmax or 1)
        ticks = [m * 10.0**e for e in range(-6, 7) for m in (1, 2, 5)]
        bar.ax.yaxis.set_major_locator(FixedLocator([t for t in ticks if low <= t <= high]))
        bar.ax.yaxis.set_minor_locator(NullLocator())
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _bondi(axes: Any, counted: Counts, where: Sequence[int]) -> bool:
    """Draw Bondi's line where theory knows it; whether it did."""
    layout = counted.layout
    x, y, *rest = counted.axes
    at = {axis.name: float(axis.values[place]) for axis, place in zip(rest, where, strict=True)}
    grid = {axis.name for axis in layout.grid}
    fixed: dict[str, float] = {}
    for axis in layout.grid:
        if axis.name in (x.name, y.name):
            continue
        if axis.name not in at and len(axis.values) > 1:
            return False  # bodies of several thresholds share a cell
        fixed[axis.name] = at.get(axis.name, float(axis.values[0]))
    for along, spin, swap in ((x, y, False), (y, x, True)):
        if spin.name == "n_i" and along.name in grid:
            values, n_c1 = threshold_line(layout, along, fixed)
            for style in (RIM, LINE):
                axes.plot(*((n_c1, values) if swap else (values, n_c1)), **style)
            return bool((n_c1 >= spin.values[0]).any())
    if {x.name, y.name} <= grid:
        n_i = at.get("n_i", float(layout.axes["n_i"].values[0]))
        if n_i > 0 or ("n_i" not in at and len(layout.axes["n_i"].values) > 1):
            return False
        a, b, plane = threshold_plane(layout, x, y, fixed)
        # No threshold is one at infinite spin.
        plane = np.nan_to_num(plane, nan=-1e3)
        if not plane.min() < n_i < plane.max():
            return False
        for style in (RIM, LINE):
            axes.contour(a, b, plane, [n_i], colors=style["color"], linewidths=style["linewidth"],
                         linestyles="solid", zorder=style["zorder"])  # fmt: skip
        return True
    return False


def _legend(figure: Any, kinds: NDArray[np.int64], bondi: bool, *, gaps: bool) -> None:
    edge: dict[str, Any] = {"edgecolor": "#555555", "linewidth": 0.5}
    handles: list[Any] = [
        Patch(facecolor=style[0], label=style[3], **edge)
        for name, style in TYPE_STYLE.items()
        if _CODES[name] in kinds
    ]
    if _CODES["failed"] in kinds:
        handles.append(Patch(facecolor=FAILED, label="failed", **edge))
    if gaps:
        handles.append(Patch(facecolor=MISSING, label="not run yet", **edge))
    if any(code in kinds for code in (1, 2, 3)):
        handles.append(Patch(facecolor=NO_REVERSAL, label="right: no reversal", **edge))
    if bondi:
        handles.append(Line2D([], [], color="#000000", linewidth=1.3, label=BONDI_LABEL))
    legend_above(figure, handles, 1.9)


class MapCounts(Counts):
    """Runs by pixel."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        for axis in self.axes[:2]:
            if len(axis.values) < 2:
                raise ConfigError(
                    f"--kind map: only one value of {axis.name} is left; a map needs two or more"
                )


def _order(layout: Layout, left: Lengths, x: str | None) -> tuple[str, ...]:
    """The longest axes; of equal length, bodies along the abscissa and spins along the ordinate."""
    names = [*layout.targets, *layout.bodies, *layout.launch]
    names.sort(key=lambda name: -min(left[name], SIDE))
    first = x or names[0]
    return (first, *(name for name in names if name != first and left[name] > 1))


def _size(counted: Counts) -> tuple[float, float]:
    return 9.0, float(np.clip(1.2 + 3.4 * np.prod(counted.shape[2:]), 4.6, 14))


MAP = Kind(
    name="map",
    caption="Types, and reversal times in units of Garcia and Hubbard's.",
    fits=lambda layout, left: sum(count > 1 for count in left.values()) >= 2,
    order=_order,
    gather=MapCounts,
    size=_size,
    draw=draw,
)
