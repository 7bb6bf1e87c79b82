"""A sweep as an xarray Dataset: one dimension for each thing that varies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.analysis.grids import fill
from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.columns import RUNS, TEXT
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.config.schema import PARAMETERS
from rattlesweep.sweeps.provenance import package_version

if TYPE_CHECKING:
    import xarray

KEYS = ("case", "sample")
UNITS = "mass M, height of the centre of mass at rest a and gravity g are 1"


def make_dataset(
    layout: Layout, columns: Sequence[str] | None = None, *, fill_refined: bool = False
) -> xarray.Dataset:
    """Return the runs along the axes of their sweep.

    Parameters
    ----------
    layout : Layout
        Of the sweep; runs that its condition does not choose are missing.
    columns : sequence of str, optional
        Columns of ``runs``, by default all that hold one value a run.
    fill_refined : bool
        Whether the points that a refined grid has left out are filled
        (:func:`rattlesweep.analysis.grids.fill`).

    Returns
    -------
    xarray.Dataset
        Dimensions are the target, ``n_i`` and ``omega_xy0`` where the config has them, ``sigma``
        and ``rolling`` of several values, then the axes of a grid of bodies, or ``sample`` where
        bodies are drawn or from a table. What is missing is NaN in numbers, which whole ones then
        become, and an empty text.

    Raises
    ------
    ConfigError
        xarray is not installed, or a column is none or holds several values a run.
    """
    try:
        import xarray
    except ImportError as error:
        raise ConfigError(
            f"to_xarray needs xarray ({error}); install it with `pip install 'rattlesweep[xarray]'`"
        ) from None
    fields = {column.name: column for column in layout.stored.schema}
    single = [name for name, column in fields.items() if not pa.types.is_list(column.type)]
    for name in columns or ():
        if name not in single:
            raise ConfigError(f"columns: {not_one_of(name, single)}")
    # An axis is a coordinate already.
    axes = {name for name in layout.axes if name not in layout.targets} | set(KEYS)
    chosen = [name for name in (single if columns is None else columns) if name not in axes]

    wanted = [*KEYS, *chosen]
    batches = list(layout.rows(wanted))
    empty = pa.schema([fields[name] for name in wanted]).empty_table()
    table = pa.concat_tables(
        [empty, *(pa.Table.from_batches([rows]).select(wanted) for rows in batches)]
    )
    cells = [layout.cells(rows, layout.axes.values()) for rows in batches]
    place = np.concatenate([np.zeros(0, np.int64), *cells])
    known = {column.name: column for part in RUNS.values() for column in part}
    coordinates: dict[str, Any] = {}
    for name, axis in layout.axes.items():
        if name in known:
            about = _attributes(known[name])
        else:
            about = {"units": "degree", "long_name": PARAMETERS[name].meaning}
        coordinates[name] = name, axis.values, about
    shape = tuple(layout.lengths.values())
    if not layout.grid:
        samples = layout.stored.samples
        coordinates["sample"] = ("sample", np.arange(samples), _attributes(fields["sample"]))
        place = np.where(place >= 0, place * samples + table.column("sample").to_numpy(), -1)
        shape = (*shape, samples)
    stored = np.isin(np.arange(np.prod(shape)), place[place >= 0]).reshape(shape)
    variables = {}
    for name in chosen:
        values = _spread(table.column(name), place, shape)
        if fill_refined and layout.refined:
            values = fill(values.astype(float) if values.dtype.kind in "iu" else values, stored)
        # Beside an axis of targets stands the coefficient of each body, which is near its target.
        own = f"{name}_body" if name in coordinates else name
        variables[own] = (tuple(coordinates), values, _attributes(fields[name]))
    about = {
        "title": layout.config.name,
        "source": f"rattlesweep {package_version()}",
        "comment": UNITS,
        "references": "Kondo and Nakanishi, Phys. Rev. E 95, 062207 (2017)",
        "config_hash": layout.stored.hash,
    }
    return xarray.Dataset(variables, coordinates, about)


def _attributes(column: pa.Field) -> dict[str, str]:
    metadata = column.metadata
    return {"units": metadata[b"unit"].decode(), "long_name": metadata[b"description"].decode()}


def _spread(column: pa.ChunkedArray, place: Any, shape: tuple[int, ...]) -> Any:
    """Return values in their places, of shape `shape`; the others are missing."""
    shown = place >= 0
    values: pd.Series[Any] = column.to_pandas()[shown].set_axis(place[shown])
    values = values.reindex(np.arange(np.prod(shape)))
    if column.type == TEXT:
        return values.fillna("").to_numpy(str).reshape(shape)
    # Whole numbers stay so unless any is missing.
    kind = None if pa.types.is_integer(column.type) else float
    return values.to_numpy(kind).reshape(shape)
