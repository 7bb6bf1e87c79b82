"""Reversal times, run by run, against any column of the runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.panels import entry, legend_above, scale_axis
from rattlesweep.analysis.plots.picture import Picture
from rattlesweep.analysis.style import (
    SERIES,
    SYMBOLS,
    THEORY,
    TIME,
    UNITS,
    label,
    light_grid,
    value_text,
)
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.counts import codes, floats

# More points than this cover each other, and make a file large.
MOST_POINTS = 20_000
# Abscissas that spread over more than this ratio are shown by their logarithms.
WIDE = 30.0


class Scatter(Picture):
    """Runs that reverse, evenly thinned where they are many, in colours of its axis if it has one.

    Of `total` runs that could be shown they are every so many-th.
    """

    name = "scatter"

    def __init__(self, layout: Layout, x: str | None) -> None:
        self.column = x or "t_rgh"
        units = columns_of(layout)
        if self.column not in units:
            raise ConfigError(f"--x: {not_one_of(self.column, units)}")
        super().__init__(layout, self.column)
        self.unit = units[self.column]
        self.columns = ("case", "sample", "t_r", "status", self.column)
        self.total, self._stride = 0, 1
        self._parts = [np.empty((3, 0))]

    @staticmethod
    def order(layout: Layout, x: str | None) -> list[str]:
        """What varies over no more values than there are colours, launches before bodies."""
        names = [*layout.launch, *layout.targets, *layout.bodies]
        return [n for n in names if n != x and 1 < layout.lengths[n] <= len(SERIES)][:1]

    def size(self) -> tuple[float, float]:
        """Of one panel."""
        return 6.4, 4.6

    def add(self, rows: pa.RecordBatch) -> None:
        """Take the runs of more rows that reverse."""
        x, t_r = floats(rows.column(self.column)), floats(rows.column("t_r"))
        place = self.layout.cells(rows, self.axes)
        shown = (codes(rows.column("status"), ("ok",)) == 0) & (place >= 0)
        shown &= np.isfinite(x) & np.isfinite(t_r)
        found = np.stack([x, t_r, place])[:, shown]
        # The first, and every stride-th after it.
        self._parts.append(found[:, -self.total % self._stride :: self._stride])
        self.total += found.shape[1]
        while len(self) > MOST_POINTS:
            self._parts = [np.concatenate(self._parts, axis=1)[:, ::2]]
            self._stride *= 2

    def points(self) -> tuple[Floats, Floats, Integers]:
        """Abscissa, ``t_r`` and place along the axis of colours of each point."""
        x, t_r, place = np.concatenate(self._parts, axis=1)
        return x, t_r, place.astype(np.int64)

    def __len__(self) -> int:
        return sum(part.shape[1] for part in self._parts)

    def words(self) -> str:
        """How many they are."""
        return f"{len(self):,} of {self.total:,} runs that reverse"

    def table(self) -> pa.Table:
        """One row a point."""
        x, t_r, place = self.points()
        colour = {axis.name: axis.values[place] for axis in self.axes}
        return pa.table({self.column: x, "t_r": t_r, **colour})

    def draw(self, figure: Any, log: bool | None) -> None:
        """Points, and theory where it is the abscissa.

        Unless told otherwise, the ordinate is logarithmic, and the abscissa if it is positive and
        spreads widely.
        """
        axes = figure.subplots()
        x, t_r, place = self.points()
        handles = []
        for k, (colour, marker) in zip(np.unique(place), SERIES, strict=False):
            own = place == k
            look: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": "", "mew": 0}
            axes.plot(x[own], t_r[own], ms=2.6, alpha=0.6, rasterized=True, **look)
            for axis in self.axes:
                handles.append(entry(value_text(axis.name, float(axis.values[k])), ms=5, **look))
        wide = bool(0 < WIDE * x.min() < x.max())
        scale_axis(axes, "x", x, wide if log is None else log, self.column)
        scale_axis(axes, "y", t_r, log is not False)
        if self.column == "t_rgh":
            # In small steps: where one axis alone is logarithmic, it is curved.
            low, high = axes.get_xlim()
            theory = np.linspace(max(low, 0.0), high, 400)[1:]
            axes.plot(theory, theory, **THEORY, scalex=False, scaley=len(x) == 1)
            handles.append(entry(r"theory: $t_r = t_{rGH}$", **THEORY))
        unit = UNITS.get(self.unit, self.unit)
        plain = self.column + (f" ({unit})" if unit else "")
        axes.set_xlabel(label(self.column) if self.column in SYMBOLS else plain)
        axes.set_ylabel(f"$t_r$ ({TIME})")
        light_grid(axes)
        if len(self) < self.total:
            handles.append(entry(f"{len(self):,} of {self.total:,} runs"))
        if handles:
            legend_above(figure, handles, 1.6)


def columns_of(layout: Layout) -> dict[str, str]:
    """Columns that can lie along the abscissa, with their units."""
    schema = layout.manifest.schema
    numbers = [f for f in schema if pa.types.is_floating(f.type) or pa.types.is_integer(f.type)]
    return {f.name: f.metadata[b"unit"].decode() for f in numbers if f.name != "t_r"}
