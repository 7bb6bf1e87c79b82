"""Reversal times, run by run, against any column of the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from matplotlib.lines import Line2D

from rattlesweep.errors import ConfigError
from rattlesweep.study.plots.kind import Kind
from rattlesweep.study.plots.layout import Layout, Places
from rattlesweep.study.plots.panels import legend_above, plain_ticks
from rattlesweep.study.style import (
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
from rattlesweep.sweeps.tables.cells import codes, floats
from rattlesweep.sweeps.tables.columns import runs_schema

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

# More points than this cover each other, and make a file large.
MOST_POINTS = 20_000
# Abscissas that spread over more than this ratio are shown by their logarithms.
WIDE = 30.0


class Points:
    """Runs that reverse, evenly thinned where they are many.

    Parameters
    ----------
    layout
    names
        The column along the abscissa.
    chosen
        Places along any axes of the sweep that are taken; others are left out.

    Attributes
    ----------
    name, unit : str
        Column along the abscissa.
    colour : Axis or None
        What tells the points apart by colour.
    total : int
        Runs that could be shown, of which these are every so many-th.

    Raises
    ------
    ConfigError
        There is no such column of numbers.
    """

    def __init__(
        self, layout: Layout, names: Sequence[str], chosen: Mapping[str, Integers]
    ) -> None:
        (self.name,) = names
        units = columns_of(layout)
        if self.name not in units:
            raise ConfigError(f"--x: {not_one_of(self.name, units)}")
        self.unit = units[self.name]
        self.columns: Sequence[str] = ("case", "sample", "t_r", "status", self.name)
        colour = _colour(layout, self.name, chosen)
        self._places = Places(layout, colour, chosen)
        self.colour = self._places.axes[0] if colour else None
        self.total, self._stride = 0, 1
        self._parts = [np.empty((3, 0))]

    def add(self, rows: pa.RecordBatch) -> None:
        """Take the runs of more rows that reverse."""
        x, t_r = floats(rows.column(self.name)), floats(rows.column("t_r"))
        place = self._places.cells(rows)
        shown = (codes(rows.column("status"), ("ok",)) == 0) & (place >= 0)
        shown &= np.isfinite(x) & np.isfinite(t_r)
        found = np.stack([x, t_r, place])[:, shown]
        # The first, and every stride-th after it.
        self._parts.append(found[:, -self.total % self._stride :: self._stride])
        self.total += found.shape[1]
        while sum(part.shape[1] for part in self._parts) > MOST_POINTS:
            self._parts = [np.concatenate(self._parts, axis=1)[:, ::2]]
            self._stride *= 2

    def points(self) -> tuple[Floats, Floats, Integers]:
        """Abscissa, ``t_r`` and place along `colour` of each point."""
        x, t_r, place = np.concatenate(self._parts, axis=1)
        return x, t_r, place.astype(np.int64)

    def __len__(self) -> int:
        """Return the number of points."""
        return sum(part.shape[1] for part in self._parts)

    def words(self) -> str:
        """How many they are."""
        return f"{len(self):,} of {self.total:,} runs that reverse"

    def table(self) -> pa.Table:
        """What is drawn."""
        x, t_r, place = self.points()
        columns = {self.name: x, "t_r": t_r}
        if self.colour is not None:
            columns[self.colour.name] = self.colour.values[place]
        return pa.table(columns)


def columns_of(layout: Layout) -> dict[str, str]:
    """Columns that can lie along the abscissa, with their units."""
    schema = runs_schema(layout.config.record, layout.config.model)
    numbers = [f for f in schema if pa.types.is_floating(f.type) or pa.types.is_integer(f.type)]
    return {f.name: f.metadata[b"unit"].decode() for f in numbers if f.name != "t_r"}


def _colour(layout: Layout, name: str, chosen: Mapping[str, Integers]) -> list[str]:
    """What varies over no more values than there are colours, launches before bodies."""
    left = layout.lengths | {axis: len(places) for axis, places in chosen.items()}
    names = [*layout.launch, *layout.targets, *layout.bodies]
    return [n for n in names if n != name and 1 < left[n] <= len(SERIES)][:1]


def draw(figure: Any, points: Points, log: bool | None) -> None:
    """``t_r`` of each run against a column.

    Unless told otherwise, the ordinate is logarithmic, and the abscissa if it is positive and
    spreads widely.
    """
    axes = figure.subplots()
    x, t_r, place = points.points()
    low, high = float(x.min()), float(x.max())
    if log and low <= 0:
        raise ConfigError(f"--log: {points.name} has values that are not positive; leave it out")
    handles: list[Any] = []
    for k, (colour, marker) in zip(np.unique(place), SERIES, strict=False):
        own = place == k
        look: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": "", "mew": 0}
        axes.plot(x[own], t_r[own], ms=2.6, alpha=0.6, rasterized=True, **look)
        if points.colour is not None:
            words = value_text(points.colour.name, float(points.colour.values[k]))
            handles.append(Line2D([], [], ms=5, label=words, **look))
    if log or (log is None and low > 0 and high > WIDE * low):
        axes.set_xscale("log")
        plain_ticks(axes, "x", (low, high))
    if log is not False:
        axes.set_yscale("log")
        plain_ticks(axes, "y", (float(t_r.min()), float(t_r.max())))
    if points.name == "t_rgh":
        axes.plot([low, high], [low, high], **THEORY)
        handles.append(Line2D([], [], **THEORY, label=r"theory: $t_r = t_{rGH}$"))
    unit = UNITS.get(points.unit, points.unit)
    plain = points.name + (f" ({unit})" if unit else "")
    axes.set_xlabel(label(points.name) if points.name in SYMBOLS else plain)
    axes.set_ylabel(f"$t_r$ ({TIME})")
    light_grid(axes)
    if len(points) < points.total:
        handles.append(Line2D([], [], linestyle="",
                              label=f"{len(points):,} of {points.total:,} runs"))  # fmt: skip
    if handles:
        legend_above(figure, handles, 1.6)


SCATTER = Kind(
    name="scatter",
    caption="",
    fits=lambda layout, left: True,
    order=lambda layout, left, x: (x or "t_rgh",),
    gather=Points,
    size=lambda points: (6.4, 4.6),
    draw=draw,
)
