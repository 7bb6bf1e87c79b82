"""Pictures of a sweep: fractions of types, times, maps, histograms, scatter plots."""

import textwrap
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from itertools import product
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from rattlesweep.analysis import style
from rattlesweep.analysis.layout import LAUNCH, TARGETS, Axis, Layout, fill
from rattlesweep.analysis.style import SERIES, THEORY, TYPE_STYLE, label, value_text
from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.columns import floats
from rattlesweep.sweeps.summary import Counts
from rattlesweep.sweeps.types import codes, share, wilson

MOST_PANELS, MOST_BINS = 40, 150
PER_INCH = 11  # letters of a heading in an inch of width
MOST_MARKERS = 40  # more markers would hide the curve
WIDE = 30.0  # values whose largest ratio exceeds this are shown on a logarithmic scale
ENOUGH, SIDE = (
    3,
    8,
)  # values that make an axis long enough for an abscissa, for a side of a map
FEW = 6  # with fewer values than this, each value of an abscissa has a tick
MAP_ENDS = (0.5, 99.5)  # percentiles at which the colour scale of a map ends
BONDI = "Bondi's threshold"
BEYOND = "beyond Bondi's threshold"
# The states of a cell of a map, with colour and label: its most common type, or why it
# has none.
CELLS = {
    **{name: (mark.colour, mark.label) for name, mark in TYPE_STYLE.items()},
    "failed": (style.FAILED, "failed"),
    "missing": (style.MISSING, "not run yet"),
}
# Columns that count turns, with the label of none.
NO_TURNS = {"n_turns": "no turns", "reversals_sure": "no confirmed turns"}
CODES = {name: code for code, name in enumerate(CELLS)}
Names = tuple[list[str], list[str], list[str]]
# The Axes of each panel, with the indices of its values on the axes of rows and
# columns.
Panels = list[tuple[Any, tuple[int, ...]]]


class Picture(ABC):
    """A picture of a sweep over `axes`; drawing it fills `notes`, the sentences of the
    caption.
    """

    panel: ClassVar[tuple[float, float]]  # width and height of a panel in inches
    parts = 1  # panels side by side for each combination of values
    ylabel: str  # of all panels, set by drawing
    shows = "of those selected"  # which runs the picture shows
    more: tuple[str, ...] = ()  # columns that are averaged in each cell

    def __init__(
        self, layout: Layout, name: str, x: str | None, quantity: str | None
    ) -> None:
        self.layout, self.name, self.x, self.quantity = layout, name, x, quantity
        own, self.rows, self.columns = (
            [layout.axes[k] for k in part] for part in self._arrange()
        )
        self.axes = [*own, *self.rows, *self.columns]
        self.notes: list[str] = []

    def _arrange(self) -> Names:
        """Return the axes inside a panel, those of the rows and those of the columns of
        panels.
        """
        return [], [], []

    @abstractmethod
    def _draw(self, panels: Panels, log: bool | None) -> list[Any]:
        """Draw the panels and return the legend entries; `log` None means as suits the
        values.
        """

    @cached_property
    def counted(self) -> tuple[Counts, dict[str, Floats]]:
        """The runs counted by cell, and the means of the columns `more`."""
        return self.layout.count(self.more)

    def __len__(self) -> int:
        return int(self.counted[0]["runs"].sum())

    def grid(self, flat: NDArray[Any]) -> NDArray[Any]:
        """Reshape an array over the cells to the shape of `axes`."""
        every = [axis.name for axis in self.layout.axes.values()]
        order = [every.index(axis.name) for axis in self.axes]
        whole = flat.reshape([*self.layout.lengths.values()])
        others = [k for k in range(len(every)) if k not in order]
        return whole.transpose(order + others).squeeze(
            tuple(range(len(order), len(every)))
        )

    def table(self) -> pd.DataFrame:
        """Return the numbers of the picture, one row for each cell that holds runs."""
        (cells, more), axes, name = (
            self.counted,
            self.layout.axes.values(),
            self.layout.name,
        )
        values = np.meshgrid(*(axis.values for axis in axes), indexing="ij")
        found: dict[str, Any] = {
            a.name: v.ravel() for a, v in zip(axes, values, strict=True)
        }
        found |= {"runs": cells["runs"], "failed": cells["failed"]}
        found |= {
            f"fraction_{kind}": share(n, cells["ok"]) for kind, n in cells.types.items()
        }
        found["fraction_bondi"] = share(cells["bondi"], cells["steady"])
        for own, moments in ((name("t_r"), cells.t_r), ("ratio", cells.ratio)):
            found |= {
                f"{own}_mean": moments.means(),
                f"{own}_std": moments.deviations(),
                f"{own}_sem": moments.errors(),
            }
        found |= {f"{name('t_rgh')}_mean": cells.t_rgh.means()}
        found |= {f"{name(column)}_mean": mean for column, mean in more.items()}
        if "sensitive" in cells:
            found |= {"sensitive": cells["sensitive"], "unsure": cells["unsure"]}
        return pd.DataFrame(found)[cells["runs"] > 0].reset_index(drop=True)

    def read(self, *columns: str) -> Floats:
        """Return cells and columns of the runs with status ok, shape (1 + columns,
        runs).
        """
        parts = [np.empty((1 + len(columns), 0))]
        for rows in self.layout.rows(("case", "sample", "status", *columns)):
            cells = self.layout.cells(rows)
            found = np.stack([cells, *(floats(rows.column(name)) for name in columns)])
            parts.append(
                found[:, (codes(rows.column("status"), ("ok",)) == 0) & (cells >= 0)]
            )
        return np.concatenate(parts, axis=1)

    def figure(
        self,
        *,
        title: str | None = None,
        log: bool | None = None,
        captioned: bool = True,
        size: tuple[float, float] | None = None,
        xlim: tuple[float, float] | None = None,
        ylim: tuple[float, float] | None = None,
    ) -> Figure:
        """Return the figure; None stands for what suits the values."""
        layout = self.layout
        if not len(self):
            raise OutputError(f"{layout.stored.directory} holds no run {self.shows}")
        down, across = (
            [*product(*(range(len(axis.values)) for axis in axes))]
            for axes in (self.rows, self.columns)
        )
        if (count := len(down) * len(across)) > MOST_PANELS:
            names = " and ".join(axis.name for axis in (*self.rows, *self.columns))
            raise ConfigError(
                f"there would be {count} panels, one for each {names}; choose some "
                "with select, as in n_i=-0.3,-0.5"
            )
        across = [column for column in across for _ in range(self.parts)]
        needed = np.array(self.panel) * (len(across), len(down)) + (1.6, 1.4)
        figure = style.new_figure(*(size or np.clip(needed, (6.4, 3.4), 14)))
        grid = figure.subplots(
            len(down), len(across), sharex=True, sharey=True, squeeze=False
        )
        for axes, column in zip(grid[0], across, strict=True):
            axes.set_title(texts(self.columns, column), fontsize="medium")
        fontsize = "medium" if figure.get_figheight() > 1.6 * len(down) else "x-small"
        for axes, row in zip(grid[:, -1], down, strict=True):
            axes.annotate(
                texts(self.rows, row),
                (1.02, 0.5),
                xycoords="axes fraction",
                rotation=270,
                va="center",
                ha="left",
                fontsize=fontsize,
            )
        for axes, axis in product(grid[-1], self.axes[:1]):
            axes.set_xlabel(label(axis.name))
        self.notes.clear()
        places = [r + c for r, c in product(down, across)]
        handles = self._draw([*zip(grid.flat, places, strict=True)], log)
        figure.supylabel(self.ylabel, fontsize="medium")
        for axes, (which, limits) in product(grid.flat, (("x", xlim), ("y", ylim))):
            if (
                limits
                and limits[0] <= 0
                and getattr(axes, f"get_{which}scale")() == "log"
            ):
                raise ConfigError(
                    f"{which}lim: a logarithmic axis is positive; take a linear one"
                )
            getattr(axes, f"set_{which}lim")(limits)
        # A value selected alone appears nowhere else in the picture.
        pinned = [
            a for a in layout.axes.values() if len(a.values) == 1 and -1 in a.rank
        ]
        # A dollar sign in a condition does not begin a formula.
        condition = layout.where.text.replace("$", "\\$") if layout.where else ""
        condition = textwrap.fill(condition, int(PER_INCH * figure.get_figwidth()))
        heading = title, texts(pinned, [0] * len(pinned)), condition
        style.add_legend(figure, handles, [*filter(None, heading)])
        if captioned:
            style.add_caption(figure, " ".join(self.notes), grow=size is None)
        return figure


def texts(axes: Sequence[Axis], places: Sequence[int]) -> str:
    """Return the values at some places of axes as text: ``n_i = -0.1, K_r = 0.02``."""
    shown = zip(axes, places, strict=True)
    return ", ".join(value_text(axis.name, axis.values[k]) for axis, k in shown)


def ordered(
    layout: Layout, first: str | None, enough: int, prefer: str = ""
) -> list[str]:
    """Return the axes of several values, `first` before all others, then by length."""
    size = layout.lengths
    names = sorted(
        size, key=lambda n: (-min(size[n], enough), n != prefer, n in LAUNCH)
    )
    first = first or names[0]
    return [first, *(name for name in names if name != first and size[name] > 1)]


def scale(axes: Any, which: str, axis: Axis, log: bool | None) -> None:
    """Make an axis logarithmic if `log`, or with None if its values are spaced so."""
    style.scale_axis(axes, which, axis.values, axis.logarithmic(log), axis.name)


class Fractions(Picture):
    """Fractions of the types against the first axis, in panels by the others."""

    panel = (1.7, 1.6)

    def _arrange(self) -> Names:
        first, *rest = ordered(self.layout, self.x, ENOUGH)
        rest.sort(key=lambda name: (name != "omega_xy0", name not in LAUNCH))
        down = 1 if len(rest) > 1 or rest == ["omega_xy0"] else 0
        return [first], rest[:down], rest[down:]

    def _draw(self, panels: Panels, log: bool | None) -> list[Any]:
        x, cells = self.axes[0], self.counted[0]
        bondi = self.grid(share(cells["bondi"], cells["steady"]))
        known: dict[str, Any] = {}
        for axes, where in panels:
            here: Any = (slice(None), *where)
            ok, part = self.grid(cells["ok"])[here], np.zeros(len(x.values))
            for name, mark in TYPE_STYLE.items():
                if name not in cells.types:
                    continue
                below, part = share(part, ok), part + self.grid(cells.types[name])[here]
                above = share(part, ok)
                known[mark.label] = axes.stairs(
                    above,
                    x.edges,
                    baseline=below,
                    fill=True,
                    label=mark.label,
                    facecolor=mark.colour,
                    hatch=mark.hatch,
                    linewidth=0,
                )
                # Wilson's interval of the upper border, which is a fraction of the
                # runs, too.
                low, high = wilson(part, ok)
                real = (part > 0) & (part < ok)
                bars = (above - low)[real], (high - above)[real]
                axes.errorbar(
                    x.values[real],
                    above[real],
                    bars,
                    fmt="none",
                    ecolor="#000000",
                    elinewidth=0.9,
                    capsize=1.6,
                    zorder=4,
                )
            if np.isfinite(bondi).any():
                look: dict[str, Any] = {
                    "ms": 4,
                    "mec": "white",
                    "mew": 0.5,
                    "zorder": 5,
                }
                (known[BEYOND],) = axes.plot(
                    x.values, 1 - bondi[here], "k^", label=BEYOND, clip_on=False, **look
                )
            scale(axes, "x", x, log)
            if len(x.values) < FEW:
                shown = [f"{value:.4g}".replace("-", "−") for value in x.values]
                width = 72 * axes.figure.get_figwidth() / axes.get_gridspec().ncols
                crowded = 7 * len("  ".join(shown)) > width
                axes.set_xticks(x.values, shown, rotation=90 if crowded else 0)
            axes.set(xlim=x.edges[[0, -1]], ylim=(0, 1), yticks=[0, 0.5, 1])
        self.ylabel = "fraction of bodies"
        self.notes.append(
            "Fractions of the runs with status ok, with 95 % intervals (Wilson)."
        )
        if BEYOND in known:
            self.notes.append(
                "The fraction above a triangle is that of the bodies whose steady "
                "spin theory finds stable: |n_c1| < |n_i|."
            )
        return [*known.values()]


class Times(Picture):
    """The mean of ``t_r``, or of ``t_r/t_rGH``, over the runs of type R, and theory
    dashed.
    """

    panel = (2.6, 2.8)

    def _arrange(self) -> Names:
        order = ordered(
            self.layout, self.x, ENOUGH, "n_i" if self.name == "ratio" else ""
        )
        first, *rest = order
        rest.sort(key=lambda name: -self.layout.lengths[name])
        return [first, *rest[:1]], [], rest[1:]

    def _draw(self, panels: Panels, log: bool | None) -> list[Any]:
        x, *curves = self.axes[: len(self.axes) - len(self.columns)]
        cells, relative = self.counted[0], self.name == "ratio"
        moments = cells.ratio if relative else cells.t_r
        # The axis of ratios is linear and begins at 0.
        log_y = bool(log) if relative else log is not False
        # No more curves than there are colours.
        count = len(curves[0].values) if curves else 1
        shown = np.linspace(0, count - 1, min(count, len(SERIES))).astype(int)
        looks = [(place, *look) for place, look in zip(shown, SERIES, strict=False)]
        mean, spread, theory = (
            np.expand_dims(self.grid(part), [] if curves else 1)
            for part in (
                moments.means(),
                np.nan_to_num(moments.deviations()),
                cells.t_rgh.means(),
            )
        )
        # Do not join the curves of the two directions of spin.
        ends = [int(np.searchsorted(x.values, 0.0))] if x.name.startswith("n_i") else []
        pieces = np.split(np.arange(len(x.values)), ends)
        for (axes, where), (place, colour, marker) in product(panels, looks):
            here: Any = (slice(None), place, *where)
            middle, half = mean[here], spread[here]
            # A logarithmic axis has no zero: there the band ends at a tenth of the
            # mean.
            low, high = (
                middle - (np.minimum(half, 0.9 * middle) if log_y else half),
                middle + half,
            )
            for part in pieces:
                at = x.values[part]
                axes.plot(
                    at,
                    middle[part],
                    color=colour,
                    linewidth=1.1,
                    ms=4,
                    marker=marker if len(x.values) <= MOST_MARKERS else None,
                )
                # A single abscissa has no line: the width of an edge and a dash are
                # visible there.
                single = len(at) == 1
                axes.fill_between(
                    at,
                    low[part],
                    high[part],
                    color=colour,
                    alpha=0.12,
                    linewidth=4 if single else 0,
                )
                if not relative:
                    axes.plot(
                        at,
                        theory[here][part],
                        **THEORY | {"color": colour, "zorder": 1.5},
                        marker="_" if single else None,
                        ms=12,
                    )
        for axes, _ in panels:
            scale(axes, "x", x, log)
            style.light_grid(axes)
            if relative:
                axes.axhline(1, **THEORY, zorder=1.5)
            if log_y:
                axes.set_yscale("log")
                style.plain_ticks(axes, "y", *axes.get_ylim())
            elif relative:
                axes.set_ylim(0, 1.08 * float(np.nanmax(mean + spread, initial=1.0)))
        self.ylabel = label("ratio" if relative else self.layout.name("t_r"))
        what = "t_r/t_rGH" if relative else "the time t_r of the first reversal"
        self.notes += [
            f"Mean of {what} over the runs that reverse (type R); bands: its standard deviation.",
            "Theory: Garcia and Hubbard's t_rGH"
            + ("." if relative else ", mean over all runs."),
        ]
        if len(shown) < count:
            self.notes.append(f"{len(shown)} of {count} values are shown.")
        handles = [
            style.entry(texts(curves, [k]), color=own, marker=mark, ms=4, ls="-")
            for k, own, mark in (looks if curves else [])
        ]
        return [*handles, style.entry("theory", **THEORY)]


class Map(Picture):
    """Types and ``t_r/t_rGH`` side by side, or one column, as means over the runs of a
    cell.
    """

    panel = (3.7, 3.4)

    def _arrange(self) -> Names:
        layout, order = self.layout, ordered(self.layout, self.x, SIDE)
        if layout.lengths[order[0]] < 2:
            raise ConfigError(
                f"kind map: only one value of {order[0]} is left; it needs two"
            )
        self.parts = 2 if self.quantity is None else 1
        # Bondi's line needs one body in a cell, and a steady spin that lasts.
        self.theory = bool(layout.bodies) and not layout.stored.config.dissipation
        names = [self.quantity, *(("n_c1", "n_i") if self.theory else ())]
        self.more = tuple(dict.fromkeys(filter(None, names)))
        return order[:2], order[2:], []

    def shown(self) -> tuple[Integers, Floats, Floats]:
        """Return of each cell the state in `CELLS`, the value, and ``n_c1 - n_i``."""
        layout, (cells, more) = self.layout, self.counted
        counts = np.stack(
            [cells.types.get(name, 0 * cells["runs"]) for name in TYPE_STYLE]
        )
        code = np.where(cells["ok"] == 0, CODES["failed"], np.argmax(counts, axis=0))
        code = self.grid(np.where(cells["runs"] == 0, CODES["missing"], code))
        value = self.grid(more[self.quantity] if self.quantity else cells.ratio.means())
        none = np.full(code.shape, np.nan)
        beyond = self.grid(more["n_c1"] - more["n_i"]) if self.theory else none
        if layout.refined:
            # Fill where no run was integrated, not where a condition excludes the run.
            runs = (
                cells["runs"]
                if layout.where is None
                else layout.chosen(None).count()[0]["runs"]
            )
            done = self.grid(runs) > 0
            code, value, beyond = (fill(array, done) for array in (code, value, beyond))
        return code, value, beyond

    def _draw(self, panels: Panels, log: bool | None) -> list[Any]:
        x, y, *_ = self.axes
        bondi, several = False, bool(self.counted[0]["runs"].max() > 1)
        every, mean = [axes for axes, _ in panels], "mean " if several else ""
        self.ylabel = label(y.name)
        code, value, beyond = self.shown()
        turns = self.quantity in NO_TURNS
        value = np.where(
            turns & (value == 0), np.nan, value
        )  # drawn in the colour of no turns
        known = (
            value[np.isfinite(value)]
            if np.isfinite(value).any()
            else np.array([0.0, 2.0])
        )
        low, high = (float(end) for end in np.percentile(known, MAP_ENDS))
        wide = low > 0 and high > (WIDE if self.quantity else 4) * low
        norm = (LogNorm if wide else Normalize)(low, high)
        mesh: Any = None
        for k, (axes, where) in enumerate(panels):
            here: Any = (..., *where)
            of_types = self.quantity is None and k % 2 == 0
            colours = [colour for colour, _ in CELLS.values()]
            if not of_types:  # cells that have a type but no value
                colours[: len(TYPE_STYLE)] = [style.NO_REVERSAL] * len(TYPE_STYLE)
            axes.pcolormesh(
                x.edges,
                y.edges,
                code[here].T,
                rasterized=True,
                vmin=-0.5,
                vmax=len(CELLS) - 0.5,
                cmap=ListedColormap(colours),
            )
            if not of_types:
                mesh = axes.pcolormesh(
                    x.edges,
                    y.edges,
                    np.ma.masked_invalid(value[here].T),
                    rasterized=True,
                    norm=norm,
                )
            if (
                np.nanmin(beyond[here], initial=0)
                < 0
                < np.nanmax(beyond[here], initial=0)
            ):
                bondi = True
                # A dark line with a light rim is visible on every colour.
                for colour, width in (("#FFFFFF", 2.8), ("#000000", 1.3)):
                    axes.contour(
                        x.values,
                        y.values,
                        beyond[here].T,
                        [0],
                        colors=colour,
                        linewidths=width,
                        linestyles="solid",
                    )
            scale(axes, "x", x, log)
            scale(axes, "y", y, log)
            axes.set(xlim=x.edges[[0, -1]], ylim=y.edges[[0, -1]])
        if self.quantity is None:
            name, unit = "ratio", None
            words = "t_r is the time of the first reversal, t_rGH that of Garcia and Hubbard."
            every[0].set_title(
                "most common type" if several else "type", fontsize="medium"
            )
            every[1].set_title(mean + label("ratio"), fontsize="medium")
        else:
            name, (unit, words) = (
                self.quantity,
                self.layout.column(self.quantity, "quantity"),
            )
            # the legend names missing values
            words = f"{name}: {words.partition('; null')[0]}."
        self.notes.append(words)
        extend = {(True, True): "both", (True, False): "min", (False, True): "max"}
        ends = bool(known.min() < low), bool(known.max() > high)
        bar = every[0].figure.colorbar(
            mesh, ax=every, pad=0.03, aspect=35, extend=extend.get(ends, "neither")
        )
        bar.set_label(mean + label(name, unit))
        if wide:
            style.plain_ticks(bar.ax, "y", low, high)
        elif low == high:
            bar.set_ticks([low])  # a scale around the only value would be invented
        nothing = "no reversal" if unit is None else NO_TURNS.get(name, "no value")
        entries = CELLS | {"none": (style.NO_REVERSAL, nothing)}
        if self.layout.where is not None:
            entries["missing"] = (style.MISSING, "not selected")
        present = {name for name in CELLS if CODES[name] in code}
        present -= set() if self.quantity is None else {*TYPE_STYLE}
        if ((code < len(TYPE_STYLE)) & np.isnan(value)).any():
            present.add("none")
        handles: list[Any] = [
            Patch(facecolor=colour, label=text, edgecolor=style.GREY, linewidth=0.5)
            for name, (colour, text) in entries.items()
            if name in present
        ]
        if bondi:
            handles.append(
                style.entry(BONDI, color="#000000", linestyle="-", linewidth=1.3)
            )
            self.notes.append("Bondi's threshold of the steady spin: |n_i| = |n_c1|.")
        return handles


class Distribution(Picture):
    """A histogram of ``t_r/t_rGH`` of type R, or of a column of all runs."""

    panel = (4.8, 2.2)

    @cached_property
    def values(self) -> Floats:
        """The quantity of each run with status ok, NaN where it has no value."""
        names = ("t_r", "t_rgh") if self.quantity is None else (self.quantity,)
        _, values, *t_rgh = self.read(*names)
        with np.errstate(divide="ignore", invalid="ignore"):
            found: Floats = values / t_rgh[0] if t_rgh else values
        return found

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def bins(self) -> tuple[Floats, bool]:
        """Edges of bins that hold every value, and whether they are evenly spaced
        logarithms.
        """
        values = self.values[np.isfinite(self.values)]
        low, high = (values.min(), values.max()) if len(values) else (0.0, 1.0)
        if (values == values.round()).all() and high - low < MOST_BINS:
            return np.arange(low, high + 2) - 0.5, False
        log = bool(low > 0 and (self.quantity is None or high > WIDE * low))
        v = np.log(values) if log else values
        distinct = np.unique(v)
        spacing = np.diff(distinct).min() if len(distinct) > 1 else abs(low) / 5 or 1.0
        if len(distinct) <= SIDE and np.ptp(distinct) < MOST_BINS * spacing:
            # A bar around each value, between margins.
            bars = np.ravel(
                distinct[:, None] + spacing * np.array([-0.4, -0.25, 0.25, 0.4])
            )
            return np.exp(bars) if log else bars, log
        # The rule of Freedman and Diaconis, within limits.
        width = 2 * np.ptp(np.percentile(v, (25, 75))) / np.cbrt(len(v))
        count = int(np.clip(np.ptp(v) / max(width, 1e-300), 8, MOST_BINS))
        edges = (np.geomspace if log else np.linspace)(low, high, count + 1)
        edges[[0, -1]] = low, np.nextafter(high, np.inf)
        return edges, log

    def table(self) -> pd.DataFrame:
        """Return the histogram."""
        name = "ratio" if self.quantity is None else self.layout.name(self.quantity)
        edges, values = self.bins[0], self.values[np.isfinite(self.values)]
        counts = np.histogram(values, edges)[0]
        return pd.DataFrame(
            {f"{name}_low": edges[:-1], f"{name}_high": edges[1:], "runs": counts}
        )

    def _draw(self, panels: Panels, log: bool | None) -> list[Any]:
        (axes, _), (edges, log_x), runs = panels[0], self.bins, self.table()["runs"]
        low, high = edges[[0, -1]]
        axes.stairs(runs, edges, fill=True, facecolor=style.BLUE)
        if self.quantity is None:
            low, high = min(low, 0.95), max(high, 1.05)
            axes.axvline(1, **THEORY)
            axes.set_xlabel(label("ratio"))
            meaning = "t_r/t_rGH of those that reverse; dashed: theory"
        else:
            unit, meaning = self.layout.column(self.quantity, "quantity")
            axes.set_xlabel(label(self.quantity, unit))
        style.scale_axis(axes, "x", (low, high), log_x)
        self.ylabel = "number of runs"
        axes.set(xlim=(low, high), yscale="log" if log else "linear")
        if not log:
            axes.yaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
        style.light_grid(axes)
        self.notes.append(f"{runs.sum():,} of {len(self.values):,} runs: {meaning}.")
        return []


class Scatter(Picture):
    """The time of the first reversal against another column, one point a run."""

    panel = (4.8, 3.2)

    def _arrange(self) -> Names:
        self.column = self.x or "t_rgh"
        if self.column == "t_r":
            raise ConfigError(
                "x t_r: it is the ordinate of a scatter; choose another column"
            )
        self.unit, _ = self.layout.column(self.column, "x")
        self.shows = f"that has values of {self.column} and t_r"
        return super()._arrange()

    @cached_property
    def points(self) -> pd.DataFrame:
        """The column and ``t_r`` of the runs that have both."""
        names = [self.layout.name(name) for name in (self.column, "t_r")]
        return pd.DataFrame(self.read(self.column, "t_r")[1:].T, columns=names).dropna()

    def __len__(self) -> int:
        return len(self.points)

    def table(self) -> pd.DataFrame:
        """Return the points."""
        return self.points.reset_index(drop=True)

    def _draw(self, panels: Panels, log: bool | None) -> list[Any]:
        axes, (x, t_r) = panels[0][0], self.points.to_numpy().T
        axes.plot(
            x, t_r, "o", color=style.BLUE, ms=2.6, alpha=0.6, mew=0, rasterized=True
        )
        against_theory = self.column == "t_rgh"
        wide = against_theory or bool(0 < WIDE * x.min() < x.max())
        style.scale_axis(axes, "x", x, wide if log is None else log, self.column)
        style.scale_axis(axes, "y", t_r, log is not False)
        axes.set_xlabel(label(self.column, self.unit))
        style.light_grid(axes)
        self.ylabel = label(self.layout.name("t_r"))
        self.notes.append(
            f"Times of the first reversal of {len(x):,} runs that reverse."
        )
        if not against_theory:
            return []
        ends = axes.get_xlim()
        axes.plot(ends, ends, **THEORY, scalex=False, scaley=len(x) == 1)
        return [style.entry("theory", **THEORY)]


KINDS: dict[str, type[Picture]] = {
    "fractions": Fractions,
    "times": Times,
    "ratio": Times,
    "map": Map,
    "reversals": Map,
    "distribution": Distribution,
    "scatter": Scatter,
}


def choose_picture(
    layout: Layout,
    kind: str | None = None,
    *,
    x: str | None = None,
    quantity: str | None = None,
    select: Sequence[str] = (),
    where: str | None = None,
) -> Picture:
    """Return the picture of a kind, by default the one that suits the sweep."""
    # A name with a unit, such as n_i_rpm, selects values in this unit, which follow
    # from in_si.
    natural = [text for text in select if text.partition("=")[0].strip() in layout.axes]
    others = [text for text in select if text not in natural]
    layout = layout.chosen(where).select(natural).in_si().select(others)
    fitting, suited = fitting_kinds(layout), default_kind(layout)
    if kind is None and x in layout.stored.schema.names and x not in layout.axes:
        kind = "scatter"
    if kind is None and quantity is not None:
        kind = "map" if suited in ("map", "reversals") else "distribution"
    kind = kind or suited
    if x is not None and kind != "scatter":
        x = layout.key(x, f"x {x}")
    if kind not in fitting:
        needs = (
            " (it needs record: [reversals] and two parameters)"
            if kind == "reversals"
            else ""
        )
        raise ConfigError(
            f"kind {kind}: does not fit this sweep{needs}; {', '.join(fitting)} fit"
        )
    if quantity is not None and kind not in ("map", "distribution"):
        raise ConfigError(f"quantity: goes with kind map or distribution, not {kind}")
    if kind == "reversals":  # only confirmed turns, where the runs have error estimates
        sure = "reversals_sure" in layout.stored.schema.names
        quantity = "reversals_sure" if sure else "n_turns"
    if quantity is not None:
        layout.column(quantity, "quantity")
    return KINDS[kind](layout, kind, x, quantity)


def fitting_kinds(layout: Layout) -> list[str]:
    """Return the kinds for which enough parameters vary and the columns are
    recorded.
    """
    line, plane = bool(layout.axes), len(layout.several) >= 2
    population = line and not layout.bodies and layout.stored.samples > 1
    turns = plane and "reversals" in layout.stored.config.record
    fits = population, line, line, plane, turns, True, True
    return [name for name, fit in zip(KINDS, fits, strict=True) if fit]


def default_kind(layout: Layout) -> str:
    """Return the kind that suits a sweep, such as a map for two long axes."""
    fitting, spin = fitting_kinds(layout), layout.stored.config.spin
    population = "fractions" in fitting
    if sum(count >= SIDE for count in layout.lengths.values()) >= 2 and not population:
        return "reversals" if "reversals" in fitting else "map"
    if not layout.several:
        return "distribution"
    if population and spin is not None and min(spin.n_i) < 0:
        return "fractions"
    return "times" if set(TARGETS) & set(layout.several) else "ratio"
