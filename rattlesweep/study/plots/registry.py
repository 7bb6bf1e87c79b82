"""`plot`: the right picture of any output directory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.errors import ConfigError
from rattlesweep.study.plots.distribution import draw_distribution
from rattlesweep.study.plots.fractions import FEWEST_FOR_AREAS, draw_fractions
from rattlesweep.study.plots.layout import Layout, selection
from rattlesweep.study.plots.map import check_map, draw_map
from rattlesweep.study.plots.panels import head, plain_ticks
from rattlesweep.study.plots.scatter import Points, columns_of, draw_scatter, gather
from rattlesweep.study.plots.table import EDGES, Tally, empty, tally
from rattlesweep.study.plots.times import draw_ratio, draw_times
from rattlesweep.study.style import new_figure, value_text
from rattlesweep.sweeps.config.messages import not_one_of

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Integers = NDArray[np.int64]

KINDS = ("fractions", "times", "ratio", "map", "distribution", "scatter")
# From this many values on along both sides, a grid is a map.
MAP_SIDE = 8


@dataclass(frozen=True)
class Picture:
    """What is to be drawn.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    names : tuple of str
        Axes of the sweep in the order that the kind wants them: the abscissa first.
    layout : Layout
    counted : Tally
    fixed : dict
        Value of each axis of which only one is left.
    points : Points, optional
        Of a scatter, which counts nothing else.
    """

    kind: str
    names: tuple[str, ...]
    layout: Layout
    counted: Tally
    fixed: dict[str, float]
    points: Points | None = None

    def data(self) -> pa.Table:
        """The numbers that are drawn."""
        import pyarrow as pa

        if self.points is not None:
            return self.points.table()
        if self.kind != "distribution":
            table = self.counted.table()
            for name, value in self.fixed.items():
                if name in self.names:
                    continue
                table = table.add_column(0, name, pa.array([value] * table.num_rows))
            return table
        runs = self.counted.histogram.astype(np.int64)
        return pa.table({"ratio_low": EDGES[:-1], "ratio_high": EDGES[1:], "runs": runs})

    def figure(
        self,
        *,
        title: str | None = None,
        log: bool | None = None,
        size: tuple[float, float] | None = None,
        xlim: tuple[float, float] | None = None,
        ylim: tuple[float, float] | None = None,
    ) -> Figure:
        """Draw it.

        Parameters
        ----------
        title
        log
            Whether axes are logarithmic; None: as suits the values.
        size
            Width and height in inches; None: as suits the panels.
        xlim, ylim
            Ends of the axes; None: as suits the values.

        Raises
        ------
        ConfigError
            An axis cannot be so.
        """
        figure = new_figure(*(size or self._size()))
        if self.points is not None:
            draw_scatter(figure, self.points, log)
        elif self.kind == "fractions":
            draw_fractions(figure, self.counted, log)
        elif self.kind == "times":
            draw_times(figure, self.counted, log)
        elif self.kind == "ratio":
            draw_ratio(figure, self.counted, log)
        elif self.kind == "map":
            draw_map(figure, self.layout, self.counted, log)
        else:
            draw_distribution(figure, self.counted, log)
        for which, limits in (("x", xlim), ("y", ylim)):
            if limits is not None:
                self._limit(figure, which, limits)
        # What a selection has pinned is nowhere else in the picture.
        pinned = ", ".join(
            value_text(name, value)
            for name, value in self.fixed.items()
            if len(self.layout.axes[name].values) > 1
        )
        head(figure, [line for line in (title, pinned) if line])
        return figure

    def said(self) -> str:
        """How much is drawn, in a few words."""
        if self.points is not None:
            return f"{len(self.points.x):,} of {self.points.total:,} runs that reverse"
        return f"{int(self.counted.runs.sum()):,} runs"

    def _limit(self, figure: Figure, which: str, limits: tuple[float, float]) -> None:
        """Let every panel end there."""
        option = f"--{which}lim {limits[0]:g},{limits[1]:g}"
        if which == "x" and self.kind == "fractions" and self.counted.shape[0] < FEWEST_FOR_AREAS:
            raise ConfigError(f"{option}: so few values stand side by side; choose with --select")
        panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
        for axes in panels[:1] if self.kind == "distribution" else panels:
            if getattr(axes, f"get_{which}scale")() == "log":
                if limits[0] <= 0:
                    raise ConfigError(
                        f"{option}: a logarithmic axis has no such end; add --linear, or give a "
                        "positive one"
                    )
                plain_ticks(axes, which, limits)
            getattr(axes, f"set_{which}lim")(limits)

    def _size(self) -> tuple[float, float]:
        shape = (*self.counted.shape, 1, 1, 1)
        if self.kind == "fractions":
            across = int(np.prod(shape[2:]))
            return float(np.clip(2.2 + 1.6 * across, 6.4, 14)), float(
                1.5 + 1.35 * max(shape[1], 1.4)
            )
        if self.kind in ("times", "ratio"):
            return float(np.clip(1.6 + 2.6 * np.prod(shape[2:]), 6.0, 13)), 4.2
        if self.kind == "map":
            rows = float(np.prod(shape[2:]))
            return 9.0, float(np.clip(1.2 + 3.4 * rows, 4.6, 14))
        if self.kind == "scatter":
            return 6.4, 4.6
        return 8.0, 3.6


def choose_picture(
    layout: Layout,
    kind: str | None = None,
    *,
    x: str | None = None,
    select: Sequence[str] = (),
) -> Picture:
    """Choose the picture that a sweep asks for, or take the one that is asked for, and count.

    Parameters
    ----------
    layout : Layout
    kind
        One of `KINDS`; None: a map for a grid with two long axes, shares of types where bodies are
        many, else reversal times.
    x
        Axis that becomes the abscissa, or a column of the runs, which asks for a scatter; None: the
        axis with most values, coefficients before spins, and of a scatter ``t_rgh``.
    select
        ``NAME=VALUES`` texts.

    Raises
    ------
    ConfigError
        The kind is unknown or does not fit what varies, or a name or value is none of the sweep's.
    OutputError
        The runs cannot be read.
    """
    chosen = selection(layout, select)
    if kind is None and x is not None and x not in layout.axes and x in columns_of(layout):
        kind = "scatter"
    if x is not None and kind != "scatter":
        layout.named(x, f"--x {x}")
    left = {name: len(chosen.get(name, axis.values)) for name, axis in layout.axes.items()}
    fits = fitting(layout, left)
    if kind is not None and kind not in KINDS:
        raise ConfigError(f"--kind: {not_one_of(kind, fits)}")
    if kind is not None and kind not in fits:
        raise ConfigError(
            f"--kind {kind}: does not fit this sweep, {_why(layout, left)}; {', '.join(fits)} fit"
        )
    kind = kind or default_kind(layout, left)
    fixed = {
        name: float(axis.values[chosen[name][0] if name in chosen else 0])
        for name, axis in layout.axes.items()
        if left[name] == 1
    }
    if kind == "scatter":
        points = gather(layout, x or "t_rgh", chosen)
        return Picture(kind, (points.name,), layout, empty(), fixed, points)
    names = _order(layout, left, kind, x)
    counted = tally(layout, names, chosen)
    if kind == "map":
        check_map(*counted.axes[:2])
    return Picture(kind, names, layout, counted, fixed)


def fitting(layout: Layout, left: dict[str, int]) -> list[str]:
    """Kinds that suit what varies; `left` is the number of values along each axis."""
    fits = []
    if left and layout.population:
        fits.append("fractions")
    if left:
        fits += ["times", "ratio"]
    if sum(count > 1 for count in left.values()) >= 2:
        fits.append("map")
    return [*fits, "distribution", "scatter"]


def _why(layout: Layout, left: dict[str, int]) -> str:
    varying = [name for name, count in left.items() if count > 1]
    what = " and ".join(varying) if varying else "nothing"
    many = "" if layout.population else ", one run each"
    return f"in which {what} var{'y' if len(varying) > 1 else 'ies'}{many}"


def default_kind(layout: Layout, left: dict[str, int] | None = None) -> str:
    """The kind that suits a sweep best; `left` as for `fitting`."""
    if left is None:
        left = {name: len(axis.values) for name, axis in layout.axes.items()}
    fits = fitting(layout, left)
    long = [name for name, count in left.items() if count >= MAP_SIDE]
    if "map" in fits and len(long) >= 2 and (layout.grid or not layout.population):
        return "map"
    if not left or max(left.values()) < 2:
        return "distribution"
    steady = layout.config.spin is not None and min(layout.config.spin.n_i) < 0
    if layout.population and steady:
        return "fractions"
    coefficients = any(left.get(name, 0) > 1 for name in ("K_p", "K_r"))
    return "times" if coefficients else "ratio"


def _order(layout: Layout, left: dict[str, int], kind: str, x: str | None) -> tuple[str, ...]:
    """The axes in the order that a kind wants them."""
    targets = [name for name in ("K_p", "K_r") if name in left]
    bodies = [axis.name for axis in layout.grid]
    launch = [name for name in ("n_i", "omega_xy0") if name in left]
    if kind == "distribution":
        return ()
    if kind == "map":
        # Of equal length, body parameters lie along the abscissa and the spin along the ordinate.
        ranked = sorted([*targets, *bodies, *launch], key=lambda name: -min(left[name], MAP_SIDE))
        first = x or ranked[0]
        rest = [name for name in ranked if name != first and left[name] > 1]
        return (first, *rest)
    if kind == "ratio":
        candidates = ["n_i", *targets, *bodies, "omega_xy0"]
    else:
        candidates = [*targets, *bodies, "n_i", "omega_xy0"]
    candidates = [name for name in candidates if name in left]
    first = x or next((n for n in candidates if left[n] > 2), None) or max(
        candidates, key=lambda name: left[name]
    )  # fmt: skip
    rest = [n for n in (*launch, *targets, *bodies) if n != first and left[n] > 1]
    if kind == "fractions":
        # Rows for the oscillation, as in the paper, columns for the others.
        others = [n for n in rest if n != "omega_xy0"]
        if first == "omega_xy0":
            # One of a single value keeps the row, so that the rest makes columns.
            single = [n for n in left if left[n] == 1][: 1 if len(others) == 1 else 0]
            return (first, *single, *others)
        return (first, "omega_xy0", *others)
    # The longest becomes curves, the others panels; curves there must be, if only one.
    rest.sort(key=lambda name: -left[name])
    return (first, *(rest or [n for n in left if n != first][:1]))


def default_outputs(directory: Path, kind: str) -> list[Path]:
    """Where a picture goes unless told otherwise."""
    return [directory / f"{kind}.svg", directory / f"{kind}.png"]
