"""Reversal times, run by run, against any column of the runs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.picture import Picture, entry, legend_above, scale_axis, unit_of
from rattlesweep.analysis.style import SERIES, THEORY, label, light_grid, value_text
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.counts import codes, floats

# More points than this cover each other, and make a file large.
MOST_POINTS = 20_000
# Values that spread over more than this ratio are shown by their logarithms.
WIDE = 30.0


class Scatter(Picture):
    """Runs that reverse, evenly thinned where they are many, in colours of an axis if it is short.

    They are every so many-th of all that could be shown.
    """

    name = "scatter"
    caption = "Times of the first reversal (the first zero of the spin), run by run."

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        self.column = x or "t_rgh"
        if self.column == "t_r":
            raise ConfigError("--x t_r: it is the ordinate of a scatter; choose another column")
        super().__init__(layout, self.column, quantity)
        self.unit = unit_of(layout, self.column, "--x")

    @classmethod
    def order(cls, layout: Layout, x: str | None) -> Sequence[str]:
        """Colour by what has no more values than there are colours, launches before bodies."""
        names = [*layout.launch, *layout.targets, *layout.bodies]
        return [n for n in names if n != x and 1 < layout.lengths[n] <= len(SERIES)][:1]

    def size(self) -> tuple[float, float]:
        """Return the size of one panel."""
        return 6.4, 4.6

    @cached_property
    def points(self) -> tuple[Floats, int]:
        """Column, ``t_r`` and place along the axis, shape (3, points), and of how many runs."""
        parts, total, stride = [np.empty((3, 0))], 0, 1
        for rows in self.layout.rows(("case", "sample", "t_r", "status", self.column)):
            x, t_r = floats(rows.column(self.column)), floats(rows.column("t_r"))
            place = self.layout.cells(rows, self.axes)
            shown = (codes(rows.column("status"), ("ok",)) == 0) & (place >= 0)
            shown &= np.isfinite(x) & np.isfinite(t_r)
            found = np.stack([x, t_r, place])[:, shown]
            # The first, and every stride-th after it.
            parts.append(found[:, -total % stride :: stride])
            total += found.shape[1]
            while sum(part.shape[1] for part in parts) > MOST_POINTS:
                parts = [np.concatenate(parts, axis=1)[:, ::2]]
                stride *= 2
        return np.concatenate(parts, axis=1), total

    def __len__(self) -> int:
        """Return the number of points."""
        return int(self.points[0].shape[1])

    def table(self) -> pa.Table:
        """Return the points."""
        x, t_r, place = self.points[0]
        own = {axis.name: axis.values[place.astype(int)] for axis in self.axes}
        return pa.table({self.column: x, "t_r": t_r} | own)

    def words(self) -> str:
        """Return how many they are."""
        return f"{len(self):,} of {self.points[1]:,} runs that reverse"

    def draw(self, figure: Any, log: bool | None) -> None:
        """Draw points, and theory where it is the abscissa.

        By default the ordinate is logarithmic, and the abscissa if it is positive and spreads
        widely.
        """
        axes = figure.subplots()
        (x, t_r, place), total = self.points
        handles = []
        for k, (colour, marker) in zip(np.unique(place).astype(int), SERIES, strict=False):
            own = place == k
            look: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": "", "mew": 0}
            axes.plot(x[own], t_r[own], ms=2.6, alpha=0.6, rasterized=True, **look)
            for axis in self.axes:
                handles.append(entry(value_text(axis.name, float(axis.values[k])), ms=5, **look))
        wide = bool(0 < WIDE * x.min() < x.max())
        scale_axis(axes, "x", x, wide if log is None else log, self.column)
        scale_axis(axes, "y", t_r, log is not False)
        if self.column == "t_rgh":
            # In small steps: where one axis alone is logarithmic, the line is curved.
            low, high = axes.get_xlim()
            theory = np.linspace(max(low, 0.0), high, 400)[1:]
            axes.plot(theory, theory, **THEORY, scalex=False, scaley=len(x) == 1)
            handles.append(entry(r"theory: $t_r = t_{rGH}$", **THEORY))
        axes.set_xlabel(label(self.column, self.unit))
        axes.set_ylabel(label("t_r"))
        light_grid(axes)
        if len(self) < total:
            handles.append(entry(f"{len(self):,} of {total:,} runs"))
        legend_above(figure, handles, 1.6)
