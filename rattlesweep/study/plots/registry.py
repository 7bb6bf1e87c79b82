"""`plot`: the right picture of any output directory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pyarrow as pa

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.study.plots.counts import Counts
from rattlesweep.study.plots.distribution import DISTRIBUTION
from rattlesweep.study.plots.fractions import FRACTIONS
from rattlesweep.study.plots.kind import Data, Kind
from rattlesweep.study.plots.layout import Layout, read_rows, selection
from rattlesweep.study.plots.map import MAP, SIDE
from rattlesweep.study.plots.panels import BESIDE, head, plain_ticks
from rattlesweep.study.plots.scatter import SCATTER, columns_of
from rattlesweep.study.plots.times import RATIO, TIMES
from rattlesweep.study.style import new_figure, value_text
from rattlesweep.sweeps.config.messages import not_one_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = {kind.name: kind for kind in (FRACTIONS, TIMES, RATIO, MAP, DISTRIBUTION, SCATTER)}
"""Every kind of picture; a new one is a `Kind` in a file of its own, and a word here."""


@dataclass(frozen=True)
class Picture:
    """What is to be drawn.

    Attributes
    ----------
    kind : Kind
    names : tuple of str
        Axes of the sweep in the order that the kind wants them: the abscissa first.
    layout : Layout
    data : Data
    fixed : dict
        Value of each axis of which only one is left.
    """

    kind: Kind
    names: tuple[str, ...]
    layout: Layout
    data: Data
    fixed: dict[str, float]

    def table(self) -> pa.Table:
        """The numbers that are drawn."""
        table = self.data.table()
        if not self.names or not isinstance(self.data, Counts):
            return table
        for name, value in self.fixed.items():
            if name not in self.names:
                table = table.add_column(0, name, pa.array([value] * len(table)))
        return table

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
        OutputError
            There is nothing to draw.
        """
        if not len(self.data):
            raise OutputError(f"{self.layout.store.directory} holds no run of those selected")
        figure = new_figure(*(size or self.kind.size(self.data)))
        self.kind.draw(figure, self.data, log)
        for which, limits in (("x", xlim), ("y", ylim)):
            if limits is not None:
                self._limit(figure, which, limits)
        # What a selection has pinned is nowhere else in the picture.
        pinned = ", ".join(
            value_text(name, value)
            for name, value in self.fixed.items()
            if self.layout.lengths[name] > 1
        )
        head(figure, [line for line in (title, pinned) if line])
        return figure

    def _limit(self, figure: Figure, which: str, limits: tuple[float, float]) -> None:
        """Let every panel end there."""
        option = f"--{which}lim {limits[0]:g},{limits[1]:g}"
        if which == "x" and not self.kind.x_limits(self.data):
            raise ConfigError(f"{option}: so few values stand side by side; choose with --select")
        for axes in figure.axes:
            if axes.get_label() in (BESIDE, "<colorbar>"):
                continue
            if getattr(axes, f"get_{which}scale")() == "log":
                if limits[0] <= 0:
                    raise ConfigError(
                        f"{option}: a logarithmic axis has no such end; add --linear, or give a "
                        "positive one"
                    )
                plain_ticks(axes, which, limits)
            getattr(axes, f"set_{which}lim")(limits)


def choose_picture(
    layout: Layout,
    kind: str | None = None,
    *,
    x: str | None = None,
    select: Sequence[str] = (),
) -> Picture:
    """Choose the picture that a sweep asks for, or take the one that is asked for.

    It is of no run yet: `read_rows` gives its data the rows.

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
    """
    chosen = selection(layout, select)
    if kind is None and x is not None and x not in layout.axes and x in columns_of(layout):
        kind = SCATTER.name
    if x is not None and kind != SCATTER.name:
        layout.named(x, f"--x {x}")
    left = layout.lengths | {name: len(places) for name, places in chosen.items()}
    fits = fitting(layout, left)
    if kind is not None and kind not in KINDS:
        raise ConfigError(f"--kind: {not_one_of(kind, fits)}")
    if kind is not None and kind not in fits:
        raise ConfigError(
            f"--kind {kind}: does not fit this sweep, {_why(layout, left)}; {', '.join(fits)} fit"
        )
    wanted = KINDS[kind or default_kind(layout, left)]
    fixed = {
        name: float(axis.values[chosen[name][0] if name in chosen else 0])
        for name, axis in layout.axes.items()
        if left[name] == 1
    }
    names = wanted.order(layout, left, x)
    return Picture(wanted, names, layout, wanted.gather(layout, names, chosen), fixed)


def read_picture(
    layout: Layout, kind: str | None = None, *, x: str | None = None, select: Sequence[str] = ()
) -> Picture:
    """As `choose_picture`, of all runs."""
    picture = choose_picture(layout, kind, x=x, select=select)
    read_rows(layout, picture.data)
    return picture


def fitting(layout: Layout, left: Mapping[str, int]) -> list[str]:
    """Kinds that suit what varies; `left` is the number of values along each axis."""
    return [name for name, kind in KINDS.items() if kind.fits(layout, left)]


def default_kind(layout: Layout, left: Mapping[str, int]) -> str:
    """The kind that suits a sweep best; `left` as for `fitting`."""
    long = [name for name, count in left.items() if count >= SIDE]
    if len(long) >= 2 and (layout.grid or not layout.population):
        return MAP.name
    if max(left.values(), default=1) < 2:
        return DISTRIBUTION.name
    if layout.population and layout.config.spin is not None and min(layout.config.spin.n_i) < 0:
        return FRACTIONS.name
    return (TIMES if any(left[name] > 1 for name in layout.targets) else RATIO).name


def _why(layout: Layout, left: Mapping[str, int]) -> str:
    varying = [name for name, count in left.items() if count > 1]
    what = " and ".join(varying) if varying else "nothing"
    many = "" if layout.population else ", one run each"
    return f"in which {what} var{'y' if len(varying) > 1 else 'ies'}{many}"
