"""Fractions of the types over bins of any columns."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.analysis.layout import SweepLayout
from rattlesweep.arrays import Floats, Integers
from rattlesweep.rows.arrow import floats
from rattlesweep.rows.types import CODE_DEAD, TYPES, codes
from rattlesweep.statistics.intervals import wilson
from rattlesweep.store.decide import nearest_rows
from rattlesweep.words.errors import OutputError

_BINS = 10
MOST_OF_AXIS = 50  # values of an axis that are never put together


@dataclass(frozen=True)
class Points:
    """The runs that are ok, by point; a refined sweep also has points without a run.

    Such a point is the nearest run, at its own place on the axes of the sweep.
    """

    run: Integers  # index of the run, which several points may share
    type: Integers  # index in TYPES, -1 for none
    values: dict[str, Floats]  # by name of a column or of an axis


class ColumnBins(NamedTuple):
    """Bins along a column: their ends, and the bin of each point."""

    low: Floats
    high: Floats
    rank: Integers


def fractions_by(
    layout: SweepLayout, by: Sequence[str], bins: int = _BINS
) -> pd.DataFrame:
    """Return the fractions of the types over bins of columns; see `fractions_of`."""
    points = read_points(layout, by)
    if not len(points.run):
        raise OutputError(
            f"{layout.stored.directory} holds no run that has values of "
            f"{' and '.join(by)}"
        )
    return fractions_of(layout, points, by, bins)


def fractions_of(
    layout: SweepLayout, points: Points, by: Sequence[str], bins: int
) -> pd.DataFrame:
    """Return the fractions of the types of some points, a row for each bin.

    A column of at most `bins` values, or an axis of at most 50, has a bin for each of
    them; otherwise the bins hold equal numbers of points.  Several columns make a grid
    of bins, of which those without a point are left out.
    """
    all_bins: list[ColumnBins] = []
    for name in by:
        count = max(bins, MOST_OF_AXIS) if name in layout.axes else bins
        all_bins.append(bin_equally(points.values[name], count))
    shape = [len(each.low) for each in all_bins]
    cell = np.ravel_multi_index([each.rank for each in all_bins], shape)
    names = _types(layout, points)
    rows: list[dict[str, float]] = []
    order = np.argsort(cell, kind="stable")
    borders = np.flatnonzero(np.diff(cell[order])) + 1
    for chosen in np.split(order, borders):
        row: dict[str, float] = {}
        places = np.unravel_index(cell[chosen[0]], shape)
        for name, each, place in zip(by, all_bins, places, strict=True):
            column = _name(layout, name)
            row[column] = float(np.median(points.values[name][chosen]))
            row[f"{column}_low"] = each.low[place]
            row[f"{column}_high"] = each.high[place]
        weights = np.unique(points.run[chosen], return_counts=True)[1]
        # Kish's effective number of runs, of which each stands for several points.
        effective = weights.sum() ** 2 / (weights**2).sum()
        row["runs"] = len(weights)
        row["runs_effective"] = float(effective)
        for name in names:
            fraction = float(np.mean(points.type[chosen] == TYPES.index(name)))
            low, high = wilson([fraction * effective], [effective])
            row[f"fraction_{name}"] = fraction
            row[f"fraction_{name}_low"] = low[0]
            row[f"fraction_{name}_high"] = high[0]
        rows.append(row)
    return pd.DataFrame(rows)


def read_points(layout: SweepLayout, names: Sequence[str]) -> Points:
    """Read the points that are ok and have a value of each column or axis."""
    axes = [name for name in names if name in layout.axes]
    columns = [name for name in names if name not in layout.axes]
    for name in columns:
        layout.column(name, "by")  # raises if there is no such column of numbers
    needed = ("case", "sample", "status", "type", *columns)
    batches = list(layout.rows(needed))
    rows = pa.Table.from_batches(batches).select(list(dict.fromkeys(needed)))
    run = np.arange(len(rows))
    if layout.refined and layout.where is None:
        rows, run = _all_points(layout, rows)
    cell = layout.cells(rows)
    places = np.unravel_index(np.maximum(cell, 0), list(layout.lengths.values()) or [1])
    rank = dict(zip(layout.axes, places, strict=False))
    values = {name: floats(rows.column(name)) for name in columns}
    values |= {name: layout.axes[name].values[rank[name]] for name in axes}
    kept = (codes(rows.column("status"), ("ok",)) == 0) & (cell >= 0)
    for each in values.values():
        kept &= np.isfinite(each)
    return Points(
        run[kept],
        codes(rows.column("type"))[kept],
        {name: each[kept] for name, each in values.items()},
    )


def _all_points(layout: SweepLayout, rows: pa.Table) -> tuple[pa.Table, Integers]:
    """Return a row for each point of a refined grid, and the index of its run."""
    cases: list[Integers] = []
    samples: list[Integers] = []
    runs: list[Integers] = []
    for case, nearest in nearest_rows(layout.stored):
        known = np.flatnonzero(nearest >= 0)
        cases.append(np.full(len(known), case))
        samples.append(known)
        runs.append(nearest[known])
    run = np.concatenate(runs)
    # The indices count the runs in the order of their keys.
    ordered = rows.sort_by([("case", "ascending"), ("sample", "ascending")])
    points = ordered.take(pa.array(run))
    for name, keys in (("case", cases), ("sample", samples)):
        place = points.schema.get_field_index(name)
        column = pa.array(np.concatenate(keys), points.schema.field(name).type)
        points = points.set_column(place, name, column)
    return points, run


def bin_equally(values: Floats, count: int) -> ColumnBins:
    """Return bins with equal numbers of values, or one for each if they are few."""
    distinct, index = np.unique(values, return_inverse=True)
    if len(distinct) <= count:
        return ColumnBins(distinct, distinct, index)
    # Equal values stay together, so that there may be fewer bins.
    edges = np.unique(np.quantile(values, np.linspace(0, 1, count + 1)))
    index = np.searchsorted(edges, values, side="right") - 1
    return ColumnBins(edges[:-1], edges[1:], np.minimum(index, len(edges) - 2))


def _types(layout: SweepLayout, points: Points) -> list[str]:
    """Return the types of the table: those of the paper, and D where runs may die."""
    names = list(TYPES)
    if not layout.stored.config.dissipation and CODE_DEAD not in points.type:
        names.remove(TYPES[CODE_DEAD])
    return names


def _name(layout: SweepLayout, name: str) -> str:
    """Return the name of a column or of an axis in tables."""
    if name in layout.axes:
        return layout.axes[name].name
    return layout.name(name)
