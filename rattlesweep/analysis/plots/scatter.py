"""Reversal times against another column."""

from functools import cached_property

import pandas as pd

from rattlesweep.analysis import style
from rattlesweep.analysis.plots.picture import (
    WIDE,
    Arrangement,
    Handle,
    Panel,
    Picture,
)
from rattlesweep.analysis.style import THEORY, label
from rattlesweep.errors import ConfigError


class Scatter(Picture):
    """The time of the first reversal against another column, one point a run."""

    panel = (4.8, 3.2)

    def arrange(self) -> Arrangement:
        """Choose the column, by default the time of theory."""
        self.column = self.x or "t_rgh"
        if self.column == "t_r":
            raise ConfigError(
                "x t_r: it is the ordinate of a scatter; choose another column"
            )
        self.unit, _ = self.layout.column(self.column, "x")
        self.shows = f"that has values of {self.column} and t_r"
        return super().arrange()

    @cached_property
    def points(self) -> pd.DataFrame:
        """The column and ``t_r`` of the runs that have both."""
        names = [self.layout.name(name) for name in (self.column, "t_r")]
        _, *columns = self.read(self.column, "t_r")
        return pd.DataFrame(dict(zip(names, columns, strict=True))).dropna()

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
        """Draw the points, against t_rGH with the line of theory."""
        axes = panels[0].axes
        x, t_r = self.points.to_numpy().T
        axes.plot(
            x,
            t_r,
            "o",
            color=style.BLUE,
            markersize=2.6,
            alpha=0.6,
            markeredgewidth=0,
            rasterized=True,
        )
        against_theory = self.column == "t_rgh"
        log_x = log
        if log is None:
            log_x = against_theory or bool(0 < WIDE * x.min() < x.max())
        style.scale_axis(axes, "x", x, bool(log_x), self.column)
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
