"""Reversal times, run by run, against any column of the runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.study.plots.panels import legend_above, plain_ticks
from rattlesweep.study.style import (
    RATE,
    SERIES,
    SYMBOLS,
    THEORY,
    TIME,
    label,
    light_grid,
    value_text,
)
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.tables.columns import runs_schema

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.study.plots.layout import Axis, Layout

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

# More points than this cover each other, and make a file large.
MOST_POINTS = 20_000
# Abscissas that spread over more than this ratio are shown by their logarithms.
WIDE = 30.0
UNITS = {"1": "", "sqrt(a/g)": TIME, "sqrt(g/a)": RATE}


@dataclass(frozen=True)
class Points:
    """Runs that reverse.

    Attributes
    ----------
    name, unit : str
        Column along the abscissa.
    x, t_r : array
    colour : Axis or None
        What tells the points apart by colour.
    place : array of int
        Place of each point's run along it.
    total : int
        Runs that could be shown, of which these are every so many-th.
    """

    name: str
    unit: str
    x: Floats
    t_r: Floats
    colour: Axis | None
    place: Integers
    total: int

    def table(self) -> pa.Table:
        """What is drawn."""
        columns = {self.name: self.x, "t_r": self.t_r}
        if self.colour is not None:
            columns[self.colour.name] = self.colour.values[self.place]
        return pa.table(columns)


def columns_of(layout: Layout) -> dict[str, str]:
    """Columns that can lie along the abscissa, with their units."""
    schema = runs_schema(layout.config.record, layout.config.model)
    numbers = [f for f in schema if pa.types.is_floating(f.type) or pa.types.is_integer(f.type)]
    return {f.name: f.metadata[b"unit"].decode() for f in numbers if f.name != "t_r"}


def gather(layout: Layout, name: str, chosen: Mapping[str, Integers]) -> Points:
    """Read the runs that reverse, evenly thinned where they are many.

    Parameters
    ----------
    layout
    name
        Column along the abscissa.
    chosen
        Places along any axes of the sweep that are taken; others are left out.

    Raises
    ------
    ConfigError
        There is no such column of numbers.
    OutputError
        A block is unreadable, or no run of those chosen reverses.
    """
    units = columns_of(layout)
    if name not in units:
        raise ConfigError(f"--x: {not_one_of(name, units)}")
    colour = _colour(layout, name, chosen)
    parts: list[NDArray[np.float64]] = []
    stride, total, kept = 1, 0, 0
    read = list(dict.fromkeys(("case", "sample", "t_r", "status", name)))
    for batch in layout.store.iter_batches(read):
        x, t_r = (
            np.asarray(pc.cast(batch.column(n), pa.float64()).to_numpy(zero_copy_only=False))
            for n in (name, "t_r")
        )
        case, sample = (batch.column(n).to_numpy().astype(np.int64) for n in ("case", "sample"))
        ranks = layout.ranks(case, sample)
        ok = pc.equal(batch.column("status").cast(pa.string()), "ok")
        shown = np.asarray(ok.to_numpy(zero_copy_only=False)) & np.isfinite(x) & np.isfinite(t_r)
        for axis, places in chosen.items():
            shown &= np.isin(ranks[axis], places)
        place = np.zeros(len(x)) if colour is None else ranks[colour.name].astype(float)
        found = np.stack([x, t_r, place])[:, shown]
        # The first, and every stride-th after it.
        parts.append(found[:, -total % stride :: stride])
        total += found.shape[1]
        kept += parts[-1].shape[1]
        while kept > MOST_POINTS:
            parts = [np.concatenate(parts, axis=1)[:, ::2]]
            kept, stride = parts[0].shape[1], 2 * stride
    if not kept:
        raise OutputError(f"{layout.store.directory} holds no run of those selected that reverses")
    x, t_r, place = np.concatenate(parts, axis=1)
    return Points(name, units[name], x, t_r, colour, place.astype(np.int64), total)


def _colour(layout: Layout, name: str, chosen: Mapping[str, Integers]) -> Axis | None:
    """What varies over no more values than there are colours, launches before bodies."""
    launch = [n for n in ("n_i", "omega_xy0") if n in layout.axes]
    for other in (*launch, *(n for n in layout.axes if n not in launch)):
        axis = layout.axes[other]
        if other != name and 1 < len(chosen.get(other, axis.values)) <= len(SERIES):
            return axis
    return None


def draw_scatter(figure: Any, points: Points, log: bool | None) -> None:
    """Draw ``t_r`` of each run against a column.

    Parameters
    ----------
    figure
    points : Points
    log : bool or None
        Whether both axes are logarithmic; None: the ordinate is, the abscissa if its values are
        positive and spread widely.
    """
    from matplotlib.lines import Line2D

    axes = figure.subplots()
    low, high = float(points.x.min()), float(points.x.max())
    if log and low <= 0:
        raise ConfigError(f"--log: {points.name} has values that are not positive; leave it out")
    handles: list[Any] = []
    places = np.unique(points.place)
    for place, (colour, marker) in zip(places, SERIES, strict=False):
        own = points.place == place
        look: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": "", "mew": 0}
        axes.plot(points.x[own], points.t_r[own], ms=2.6, alpha=0.6, rasterized=True, **look)
        if points.colour is not None:
            words = value_text(points.colour.name, float(points.colour.values[place]))
            handles.append(Line2D([], [], ms=5, label=words, **look))
    if log or (log is None and low > 0 and high > WIDE * low):
        axes.set_xscale("log")
        plain_ticks(axes, "x", (low, high))
    if log is not False:
        axes.set_yscale("log")
        plain_ticks(axes, "y", (float(points.t_r.min()), float(points.t_r.max())))
    if points.name == "t_rgh":
        axes.plot([low, high], [low, high], **THEORY)
        handles.append(Line2D([], [], **THEORY, label=r"theory: $t_r = t_{rGH}$"))
    unit = UNITS.get(points.unit, points.unit)
    plain = points.name + (f" ({unit})" if unit else "")
    axes.set_xlabel(label(points.name) if points.name in SYMBOLS else plain)
    axes.set_ylabel(f"$t_r$ ({TIME})")
    light_grid(axes)
    if len(points.x) < points.total:
        handles.append(Line2D([], [], linestyle="",
                              label=f"{len(points.x):,} of {points.total:,} runs"))  # fmt: skip
    if handles:
        legend_above(figure, handles, 1.6)
