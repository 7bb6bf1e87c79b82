"""The kinds of pictures of a sweep but maps, and the choice of the one that suits it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.ticker import MaxNLocator

from rattlesweep.analysis import style
from rattlesweep.analysis.plots.layout import LAUNCH, TARGETS, Layout
from rattlesweep.analysis.plots.map import SIDE, Map, Reversals
from rattlesweep.analysis.plots.picture import WIDE, Picture, draw_panels, ordered
from rattlesweep.analysis.style import SERIES, THEORY, TYPE_STYLE, label, value_text
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.columns import floats
from rattlesweep.sweeps.config import not_one_of
from rattlesweep.sweeps.types import codes, share, wilson

# Axes of so many values are long enough for an abscissa; of fewer than these each has a tick.
ENOUGH, FEW = 3, 6
MOST_MARKERS = 40  # with more they hide the curve
UNSURE: dict[str, Any] = {"facecolor": "#FFFFFFB0", "edgecolor": style.INK, "hatch": "xxxxxx",
                          "linewidth": 0, "label": "type not sure"}  # fmt: skip
BONDI_LABEL = "beyond Bondi's threshold"
# As few and as many bins as a histogram of some runs and of very many can do with; where a few
# values lie far out, its axis ends at these percentiles.
FEWEST, MOST, TAILS = 8, 150, (1, 99)


class Fractions(Picture):
    """Shares of the types against the first axis, in rows and columns of panels for the others."""

    name = "fractions"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        first = x or ordered(layout, ENOUGH)[0]
        # Rows of the oscillation, as in the paper.
        rest = sorted((n for n in layout.several if n != first), key=lambda n: n != "omega_xy0")
        down = 1 if len(rest) > 1 or rest == ["omega_xy0"] else 0
        high = layout.lengths[rest[0]] if down else 1
        wide = np.prod([layout.lengths[name] for name in rest[down:]])
        width = float(np.clip(2.2 + 1.6 * wide, 6.4, 14))
        super().__init__(layout, [first, *rest], width, 1.5 + 1.35 * max(high, 1.4))
        self.rows, self.columns = self.axes[1 : 1 + down], self.axes[1 + down :]

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw the fractions stacked, with that beyond Bondi's threshold, which no area shows."""
        x, cells = self.axes[0], self.cells
        marks = {name: mark for name, mark in TYPE_STYLE.items() if name in cells.types}
        bondi = self.grid(share(cells.bondi, cells.steady))
        known: dict[str, Any] = {}
        for axes, where in draw_panels(figure, self.rows, self.columns, label(x.name)):
            here: Any = (slice(None), *where)
            ok = self.grid(cells.ok)[here]
            part = np.zeros_like(ok)
            for name, mark in marks.items():
                below, part = share(part, ok), part + self.grid(cells.types[name])[here]
                above = share(part, ok)
                known[mark.label] = axes.stairs(
                    above, x.edges, baseline=below, fill=True, label=mark.label,
                    facecolor=mark.colour, hatch=mark.hatch, linewidth=0,
                )  # fmt: skip
                unsure = share(self.grid(cells.unsure_types[name])[here], ok)
                if (unsure > 0).any():
                    known[UNSURE["label"]] = axes.stairs(
                        above, x.edges, baseline=above - unsure, fill=True, **UNSURE
                    )
                # Wilson's interval of the border above, itself a share of the runs.
                low, high = wilson(part, ok)
                real = (part > 0) & (part < ok)
                axes.errorbar(
                    x.values[real], above[real], [(above - low)[real], (high - above)[real]],
                    fmt="none", ecolor="#000000", elinewidth=0.9, capsize=1.6, zorder=4,
                )  # fmt: skip
            if np.isfinite(bondi).any():
                (known[BONDI_LABEL],) = axes.plot(
                    x.values, 1 - bondi[here], "k^", ms=4, mec="white", mew=0.5, zorder=5,
                    label=BONDI_LABEL, clip_on=False,
                )  # fmt: skip
            style.scale_axis(axes, "x", x.values, x.logarithmic(log), x.name)
            if len(x.values) < FEW:
                axes.set_xticks(x.values, [f"{value:g}" for value in x.values])
            axes.set(xlim=x.edges[[0, -1]], ylim=(0, 1), yticks=[0, 0.5, 1])
        figure.supylabel("fraction of bodies", fontsize="medium")
        self.notes.append("Shares of the runs with status ok, with 95 % intervals (Wilson).")
        if BONDI_LABEL in known:
            self.notes.append("Above a triangle: bodies whose steady spin is linearly stable "
                              "according to theory, |n_c1| < |n_i|.")  # fmt: skip
        words = [*(mark.label for mark in marks.values()), UNSURE["label"], BONDI_LABEL]
        return [known[word] for word in words if word in known]


class Times(Picture):
    """The mean of ``t_r`` over type R with its spread, and theory, dashed.

    The first axis is the abscissa, the second makes curves, the others panels.
    """

    name = "times"
    relative = False
    """Whether times are in units of theory's; their ordinate is then linear and begins at 0."""

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        first = x or ordered(layout, ENOUGH, "n_i" if self.relative else "")[0]
        rest = [name for name in layout.several if name != first]
        rest.sort(key=lambda name: -layout.lengths[name])
        panels = np.prod([layout.lengths[name] for name in rest[1:]])
        super().__init__(layout, [first, *rest], float(np.clip(1.6 + 2.6 * panels, 6, 13)), 4.2)

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw curves with markers and bars, unless points are many, and bands."""
        x, *rest = self.axes
        curves, panes = rest[:1], rest[1:]
        cells, relative = self.cells, self.relative
        moments = cells.ratio if relative else cells.t_r
        log_y = bool(log) if relative else log is not False
        # As many curves as the eye tells apart.
        count = len(curves[0].values) if curves else 1
        shown = np.unique(np.linspace(0, count - 1, min(count, len(SERIES))).round().astype(int))
        looks = [(place, *look) for place, look in zip(shown, SERIES, strict=False)]
        mean, spread, error, theory = (
            np.expand_dims(self.grid(part), [] if curves else 1)
            for part in (moments.means(), np.nan_to_num(moments.deviations()),
                         np.nan_to_num(moments.errors()), cells.t_rgh.means())
        )  # fmt: skip
        # The two directions of spin are not joined.
        ends = [int(np.searchsorted(x.values, 0.0))] if x.name == "n_i" else []
        pieces = np.split(np.arange(len(x.values)), ends)
        marked = len(x.values) <= MOST_MARKERS
        panels = draw_panels(figure, (), panes, label(x.name))
        for axes, where in panels:
            for place, colour, marker in looks:
                here: Any = (slice(None), place, *where)
                middle, half = mean[here], spread[here]
                # On a logarithmic axis a band that reaches zero has no end; it stops at a tenth.
                low = np.minimum(half, 0.9 * middle) if log_y else half
                for part in pieces:
                    axes.plot(x.values[part], middle[part], color=colour, linewidth=1.1)
                    axes.fill_between(x.values[part], (middle - low)[part], (middle + half)[part],
                                      color=colour, alpha=0.12, linewidth=0)  # fmt: skip
                    if not relative:
                        axes.plot(x.values[part], theory[here][part], zorder=1.5,
                                  **{**THEORY, "color": colour})  # fmt: skip
                if marked:
                    axes.errorbar(x.values, middle, error[here], color=colour, elinewidth=1.2,
                                  fmt=marker, ms=4)  # fmt: skip
            if relative:
                axes.axhline(1, **THEORY, zorder=1.5)
            style.scale_axis(axes, "x", x.values, x.logarithmic(log), x.name)
            style.light_grid(axes)
            if log_y:
                axes.set_yscale("log")
                style.plain_ticks(axes, "y", axes.get_ylim())
            elif relative:
                axes.set_ylim(0, 1.08 * float(np.nanmax(mean + spread, initial=1.0)))
        panels[0][0].set_ylabel(label("ratio" if relative else "t_r"))

        what = "t_r/t_rGH, taken run by run," if relative else "the time t_r of the first reversal"
        self.notes.append(f"Mean of {what} over the runs that reverse (type R).")
        if not relative:
            self.notes.append("Theory: the mean of Garcia and Hubbard's time over all runs.")
        if (moments.count > 1).any():
            self.notes.append("Bands: standard deviation; bars: error of the mean.")
        if len(shown) < count:
            self.notes.append(f"Shown are {len(shown)} of {count} values of {curves[0].name}.")
        handles = [
            style.entry(value_text(axis.name, axis.values[k]), color=own, marker=mark, ms=4, ls="-")
            for axis in curves for k, own, mark in looks
        ]  # fmt: skip
        return [*handles, style.entry("theory", **THEORY)]


class Ratio(Times):
    """The mean of ``t_r/t_rGH``, run by run."""

    name = "ratio"
    relative = True


def read_values(layout: Layout, *columns: str) -> Floats:
    """Return the cell and columns of the runs with status ok, of shape (1 + columns, runs)."""
    parts = [np.empty((1 + len(columns), 0))]
    for rows in layout.rows(("case", "sample", "status", *columns)):
        found = np.stack([layout.cells(rows), *(floats(rows.column(name)) for name in columns)])
        parts.append(found[:, (codes(rows.column("status"), ("ok",)) == 0) & (found[0] >= 0)])
    return np.concatenate(parts, axis=1)


class Distribution(Picture):
    """A histogram of ``t_r/t_rGH`` of type R, or of a column of all runs."""

    name = "distribution"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        super().__init__(layout, [], 6.4, 3.6)
        self.quantity, self.unit = quantity or "ratio", ""
        self.meaning = "t_r/t_rGH of the runs that reverse, 1 at the dashed line"
        if quantity is not None:
            self.unit, self.meaning = layout.column(quantity, "--quantity")

    @cached_property
    def found(self) -> tuple[Floats, int]:
        """Values of the runs that have one, and the number of all with status ok."""
        names = ("t_r", "t_rgh") if self.quantity == "ratio" else (self.quantity,)
        _, found, *t_rgh = read_values(self.layout, *names)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = found / t_rgh[0] if t_rgh else found
        return found[np.isfinite(found)], len(found)

    def __len__(self) -> int:
        return self.found[1]

    @cached_property
    def bins(self) -> tuple[Floats, tuple[float, float], bool]:
        """Borders of bins that hold every value, the ends of the axis, whether it is logarithmic.

        A column of few values has a bin around each of them; others follow Freedman and Diaconis.
        Where a few values lie far out, the outermost bins hold them and reach beyond the axis.
        """
        values, _ = self.found
        least, most = values.min(initial=np.inf), values.max(initial=0)
        log = bool(least > 0 and (self.quantity == "ratio" or most > WIDE * least))
        v = np.log(values) if log else values
        exact = np.unique(v)
        if len(exact) <= MOST // 3:
            exact = exact if len(exact) else np.zeros(1)
            half = np.diff(exact)[[0, -1]] / 2 if len(exact) > 1 else [0.5, 0.5]
            middle = (exact[1:] + exact[:-1]) / 2
            edges = np.array([exact[0] - half[0], *middle, exact[-1] + half[-1]])
            low, high = edges[[0, -1]]
        else:
            low, quarter, median, high = np.percentile(v, (0, 25, 50, 100))
            width = 4 * (median - quarter or high - low) / np.cbrt(len(v))
            if high - low > MOST * width:
                low, high = np.percentile(v, TAILS)
            number = int(np.clip((high - low) / width, FEWEST, MOST))
            edges = np.unique([v.min(), *np.linspace(low, high, number + 1), v.max()])
        if log:
            edges, low, high = np.exp(edges), np.exp(low), np.exp(high)
        # Rounding must leave no value outside.
        edges[0], edges[-1] = min(edges[0], least), max(edges[-1], most)
        return edges, (float(low), float(high)), log

    def table(self) -> pa.Table:
        """Return the histogram."""
        edges, name = self.bins[0], self.quantity
        counts = np.histogram(self.found[0], edges)[0]
        return pa.table({f"{name}_low": edges[:-1], f"{name}_high": edges[1:], "runs": counts})

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw the histogram, its ordinate logarithmic if asked for."""
        axes, (values, total) = figure.subplots(), self.found
        edges, (low, high), log_x = self.bins
        axes.stairs(self.table()["runs"].to_numpy(), edges, fill=True, facecolor=style.BLUE)
        if self.quantity == "ratio":
            low, high = min(low, 0.95), max(high, 1.05)
            axes.axvline(1, **THEORY)
        if log_x:
            axes.set_xscale("log")
            style.plain_ticks(axes, "x", (low, high))
        if log:
            axes.set_yscale("log")
        else:
            axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set(xlabel=label(self.quantity, self.unit), ylabel="number of runs", xlim=(low, high))
        style.light_grid(axes)
        self.notes.append(f"{len(values):,} of {total:,} runs: {self.meaning}.")
        return []


class Scatter(Picture):
    """Times of the first reversal, run by run, in colours of an axis if it is short."""

    name = "scatter"

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        self.column = x or "t_rgh"
        if self.column == "t_r":
            raise ConfigError("--x t_r: it is the ordinate of a scatter; choose another column")
        short = [n for n in layout.several if n in LAUNCH and layout.lengths[n] <= len(SERIES)]
        super().__init__(layout, [name for name in short if name != x][:1], 6.4, 4.6)
        self.unit, _ = layout.column(self.column, "--x")

    @cached_property
    def points(self) -> Floats:
        """Column, ``t_r`` and place along the axis of the runs that have both."""
        names = [self.column, "t_r", *(axis.name for axis in self.axes)]
        _, *found = read_values(self.layout, *names)
        return np.array(found)[:, np.isfinite(found).all(axis=0)]

    def __len__(self) -> int:
        return int(self.points.shape[1])

    def table(self) -> pa.Table:
        """Return the points."""
        names = [self.column, "t_r", *(axis.name for axis in self.axes)]
        return pa.table(dict(zip(names, self.points, strict=True)))

    def words(self) -> str:
        """Return how many they are."""
        return f"{len(self):,} runs that reverse"

    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw points, and theory where it is the abscissa."""
        axes, handles = figure.subplots(), []
        x, t_r, *along = self.points
        own = along[0] if along else np.zeros(len(x))
        for value, (colour, marker) in zip(np.unique(own), SERIES, strict=False):
            here = own == value
            look: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": "", "mew": 0}
            axes.plot(x[here], t_r[here], ms=2.6, alpha=0.6, rasterized=True, **look)
            handles += [style.entry(value_text(a.name, value), ms=5, **look) for a in self.axes]
        wide = bool(0 < WIDE * x.min() < x.max())
        style.scale_axis(axes, "x", x, wide if log is None else log, self.column)
        style.scale_axis(axes, "y", t_r, log is not False)
        if self.column == "t_rgh":
            # In small steps: where one axis alone is logarithmic, the line is curved.
            theory = np.linspace(max(0, axes.get_xlim()[0]), axes.get_xlim()[1], 400)[1:]
            axes.plot(theory, theory, **THEORY, scalex=False, scaley=len(x) == 1)
            handles.append(style.entry("theory", **THEORY))
        axes.set(xlabel=label(self.column, self.unit), ylabel=label("t_r"))
        style.light_grid(axes)
        self.notes.append(f"Times of the first reversal of {self.words()}.")
        return handles


KINDS: dict[str, Callable[[Layout, str | None, str | None], Picture]] = {
    "fractions": Fractions, "times": Times, "ratio": Ratio, "map": Map, "reversals": Reversals,
    "distribution": Distribution, "scatter": Scatter,
}  # fmt: skip


def choose_picture(
    layout: Layout,
    kind: str | None = None,
    *,
    x: str | None = None,
    quantity: str | None = None,
    select: Sequence[str] = (),
    where: str | None = None,
) -> Picture:
    """Choose the picture that suits a sweep, or take the kind that is asked for.

    Raises a ConfigError if the kind does not suit the sweep, or a name or a text cannot be read.
    """
    layout = layout.chosen(where).select(select)
    fitting, suited = fitting_kinds(layout), default_kind(layout)
    if kind is None and x in layout.stored.schema.names and x not in layout.axes:
        kind = "scatter"
    if x is not None and kind != "scatter":
        layout.named(x, f"--x {x}")
    if kind is None and quantity is not None:
        kind = "map" if suited in ("map", "reversals") else "distribution"
    kind = kind or suited
    if kind not in KINDS:
        raise ConfigError(f"--kind: {not_one_of(kind, fitting)}")
    if kind not in fitting:
        raise ConfigError(f"--kind {kind}: does not fit this sweep; {', '.join(fitting)} fit")
    if quantity is not None and kind not in ("map", "distribution"):
        raise ConfigError(f"--quantity: goes with --kind map or distribution, not {kind}")
    return KINDS[kind](layout, x, quantity)


def fitting_kinds(layout: Layout) -> list[str]:
    """Return the kinds for which enough varies, and is recorded."""
    line, plane = bool(layout.axes), len(layout.several) >= 2
    fits = {
        "fractions": line and not layout.bodies and layout.stored.samples > 1,
        "times": line, "ratio": line, "map": plane,
        "reversals": plane and "reversals" in layout.stored.config.record,
    }  # fmt: skip
    return [name for name in KINDS if fits.get(name, True)]


def default_kind(layout: Layout) -> str:
    """Return the kind that suits a sweep: a map for two long axes, fractions for many bodies."""
    fitting, spin = fitting_kinds(layout), layout.stored.config.spin
    population = "fractions" in fitting
    if sum(count >= SIDE for count in layout.lengths.values()) >= 2 and not population:
        return "reversals" if "reversals" in fitting else "map"
    if not layout.several:
        return "distribution"
    if population and spin is not None and min(spin.n_i) < 0:
        return "fractions"
    return "times" if set(TARGETS) & set(layout.several) else "ratio"
