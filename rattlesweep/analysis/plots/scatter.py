"""Reversal times against another column."""

from functools import cached_property
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize

from rattlesweep.analysis import style
from rattlesweep.analysis.plots.picture import (
    WIDE,
    Arrangement,
    Handle,
    Panel,
    Picture,
)
from rattlesweep.analysis.style import THEORY, label
from rattlesweep.arrays import Floats
from rattlesweep.words.errors import ConfigError


class Scatter(Picture):
    """The time of the first reversal, or a column, against another, a point a run."""

    panel = (4.8, 3.2)

    def arrange(self) -> Arrangement:
        """Choose the columns, by default t_r against the time of theory."""
        self.column = self.x or "t_rgh"
        self.ordinate = self.quantity or "t_r"
        if self.column == self.ordinate:
            raise ConfigError(
                f"x {self.column}: it is the ordinate of a scatter; choose another "
                "column"
            )
        self.unit, _ = self.layout.column(self.column, "x")
        self.shows = f"that has values of {self.column} and {self.ordinate}"
        return super().arrange()

    @cached_property
    def points(self) -> pd.DataFrame:
        """The columns of the runs that have them all."""
        columns = [self.column, self.ordinate]
        if self.colour is not None:
            columns.append(self.colour)
        columns = list(dict.fromkeys(columns))
        _, *values = self.read(*columns)
        names = [self.layout.name(name) for name in columns]
        return pd.DataFrame(dict(zip(names, values, strict=True))).dropna()

    def __len__(self) -> int:
        return len(self.points)

    def table(self) -> pd.DataFrame:
        """Return the points."""
        return self.points.reset_index(drop=True)

    def alt(self) -> str:
        """Return the ranges of the points."""
        x, y = self.points.columns
        low = self.points.min()
        high = self.points.max()
        return (
            f"{y} of {len(self):,} runs that reverse, from {low[y]:.3g} to "
            f"{high[y]:.3g}, against {x}, from {low[x]:.3g} to {high[x]:.3g}"
        )

    def draw(self, panels: list[Panel], log: bool | None) -> list[Handle]:
        """Draw the points; t_r against t_rGH has the line of theory."""
        axes = panels[0].axes
        name = self.layout.name
        x = self.points[name(self.column)].to_numpy()
        y = self.points[name(self.ordinate)].to_numpy()
        if self.colour is None:
            axes.plot(
                x,
                y,
                "o",
                color=style.BLUE,
                markersize=2.6,
                alpha=0.6,
                markeredgewidth=0,
                rasterized=True,
            )
        else:
            self._draw_coloured(axes, x, y, self.colour)
        against_theory = (self.column, self.ordinate) == ("t_rgh", "t_r")
        style.scale_axis(
            axes, "x", x, _is_log(log, x, against_theory), name(self.column)
        )
        is_time = self.ordinate == "t_r"
        style.scale_axis(axes, "y", y, _is_log(log, y, is_time), name(self.ordinate))
        axes.set_xlabel(label(self.column, self.unit))
        style.light_grid(axes)
        unit, meaning = self.layout.column(self.ordinate, "quantity")
        if is_time:
            self.ylabel = label(name("t_r"))
            meaning = "Times of the first reversal of {} runs that reverse."
        else:
            self.ylabel = label(self.ordinate, unit)
            meaning = meaning[:1].upper() + meaning[1:] + ", of {} runs."
        self.notes.append(meaning.format(f"{len(x):,}"))
        if not against_theory:
            return []
        ends = axes.get_xlim()
        axes.plot(ends, ends, **THEORY, scalex=False, scaley=len(x) == 1)
        return [style.entry(style.OF_THEORY, **THEORY)]

    def _draw_coloured(self, axes: Axes, x: Floats, y: Floats, colour: str) -> None:
        """Draw the points in the colours of a column, with a bar of colours."""
        values = self.points[self.layout.name(colour)].to_numpy()
        low = float(values.min())
        high = float(values.max())
        is_log = bool(low > 0 and high > WIDE * low)
        points = axes.scatter(
            x,
            y,
            s=7,
            c=values,
            norm=LogNorm(low, high) if is_log else Normalize(low, high),
            alpha=0.7,
            linewidths=0,
            rasterized=True,
        )
        figure: Any = axes.figure
        bar = figure.colorbar(points, ax=axes, pad=0.03, aspect=35)
        unit, _ = self.layout.column(colour, "colour")
        bar.set_label(label(colour, unit))
        if is_log:
            style.plain_ticks(bar.ax, "y", low, high)


def _is_log(log: bool | None, values: Floats, usual: bool) -> bool:
    """Return whether an axis is logarithmic; `usual`: unless it shall be linear."""
    if usual:
        return log is not False
    if log is not None:
        return log
    return bool(0 < WIDE * values.min() < values.max())
