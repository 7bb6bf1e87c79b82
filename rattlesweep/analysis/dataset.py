"""A sweep as an xarray Dataset: one dimension for each thing that varies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.errors import ConfigError
from rattlesweep.analysis.plots.layout import Axis, Layout, iter_rows
from rattlesweep.sweeps.config.schema import PARAMETERS
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.provenance import package_version
from rattlesweep.sweeps.columns import RUNS, TEXT

if TYPE_CHECKING:
    import xarray

KEYS = ("case", "sample")
UNITS = "mass M, height of the centre of mass at rest a and gravity g are 1"


def make_dataset(layout: Layout, columns: Sequence[str] | None = None) -> xarray.Dataset:
    """The runs along the axes of their sweep: these columns, or all that hold one value a run.

    Dimensions are targets, ``n_i`` and ``omega_xy0`` where the config has them, ``sigma`` and
    ``rolling`` of several values, then the axes of a grid of bodies, or ``sample`` where bodies are
    drawn or from a table.  What is not stored yet, or not chosen, is missing: NaN in numbers, which
    whole ones then become, and no text in words.
    """
    try:
        import xarray
    except ImportError as error:
        raise ConfigError(
            f"to_xarray needs xarray ({error}); install it with `pip install 'rattlesweep[xarray]'`"
        ) from None
    fields = {column.name: column for column in layout.manifest.schema}
    chosen = _chosen(fields, layout, columns)
    wanted = [*KEYS, *chosen]
    rows = list(iter_rows(layout, wanted))
    table = pa.Table.from_batches(rows, None if rows else pa.schema([fields[n] for n in wanted]))
    coordinates: dict[str, Any] = {axis.name: _coordinate(axis) for axis in layout.axes.values()}
    shape = tuple(layout.lengths.values())
    place = np.zeros(len(table), np.int64)
    if layout.axes:
        cells = [layout.cells(part, layout.axes.values()) for part in table.to_batches()]
        place = np.concatenate([place[:0], *cells])
    if not layout.grid:
        samples = layout.manifest.samples
        coordinates["sample"] = ("sample", np.arange(samples), _attributes(fields["sample"]))
        shown = place >= 0
        place = np.where(shown, place * samples + table.column("sample").to_numpy(), -1)
        shape = (*shape, samples)
    dims = tuple(coordinates)
    variables = {}
    for name in chosen:
        values = _spread(table.column(name), place, shape)
        # Beside an axis of targets the coefficient of each body, which is near its target.
        own = f"{name}_body" if name in dims else name
        variables[own] = (dims, values, _attributes(fields[name]))
    return xarray.Dataset(
        variables,
        coordinates,
        {
            "title": layout.config.name,
            "source": f"rattlesweep {package_version()}",
            "comment": UNITS,
            "references": "Kondo and Nakanishi, Phys. Rev. E 95, 062207 (2017)",
            "config_hash": layout.manifest.config_hash,
        },
    )


def _chosen(
    fields: dict[str, pa.Field], layout: Layout, columns: Sequence[str] | None
) -> list[str]:
    """Columns that become variables: an axis is a coordinate already."""
    single = [name for name, column in fields.items() if not pa.types.is_list(column.type)]
    for name in columns or ():
        if name not in fields:
            raise ConfigError(f"columns: {not_one_of(name, single)}")
        if name not in single:
            raise ConfigError(f"columns: {name} holds several values a run; .read() has it")
    axes = {name for name in layout.axes if name not in layout.targets} | set(KEYS)
    return [name for name in (single if columns is None else columns) if name not in axes]


def _coordinate(axis: Axis) -> tuple[str, Any, dict[str, str]]:
    columns = {column.name: column for part in RUNS.values() for column in part}
    if axis.name in columns:
        return axis.name, axis.values, _attributes(columns[axis.name])
    words = {"units": "degree", "long_name": PARAMETERS[axis.name].meaning}
    return axis.name, axis.values, words


def _attributes(column: pa.Field) -> dict[str, str]:
    metadata = column.metadata
    return {"units": metadata[b"unit"].decode(), "long_name": metadata[b"description"].decode()}


def _spread(column: pa.ChunkedArray, place: Any, shape: tuple[int, ...]) -> Any:
    """Values in their places, of shape `shape`; the others are missing."""
    shown = place >= 0
    values = column.to_pandas()[shown].set_axis(place[shown]).reindex(np.arange(np.prod(shape)))
    if column.type == TEXT:
        return values.fillna("").to_numpy(str).reshape(shape)
    # Whole numbers stay so unless any is missing.
    kind = None if pa.types.is_integer(column.type) else float
    return values.to_numpy(kind).reshape(shape)
