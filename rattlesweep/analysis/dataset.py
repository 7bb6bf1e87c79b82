"""The runs of a sweep along its axes, as an xarray Dataset."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.analysis.layout import TARGETS, SweepLayout, fill
from rattlesweep.arrays import Floats, Integers
from rattlesweep.rows.arrow import unit_and_meaning
from rattlesweep.rows.columns import COLUMNS, define
from rattlesweep.words.errors import ConfigError, OutputError, not_one_of

if TYPE_CHECKING:
    import xarray


def make_dataset(
    layout: SweepLayout,
    columns: Sequence[str] | None = None,
    *,
    fill_refined: bool = False,
) -> xarray.Dataset:
    """Return the runs along the axes of their sweep, as ``Sweep.to_xarray`` promises.

    With `fill_refined`, the points that a refined sweep skips are filled.
    """
    names = _data_columns(layout, columns)
    table = _read(layout, names)
    place = layout.cells(table)
    selected = place >= 0
    axes: dict[str, Floats | Integers] = {
        name: axis.values for name, axis in layout.axes.items()
    }
    if not layout.bodies:
        # The samples of a case are a population, which is the last axis.
        axes["sample"] = np.arange(layout.stored.samples)
        place = place * layout.stored.samples + table["sample"].to_numpy()
    index = pd.MultiIndex.from_product(list(axes.values()), names=list(axes))
    frame = table.select(names).to_pandas()[selected]
    frame = frame.set_index(index[place[selected]]).reindex(index)
    # The axis of a target holds the requested values, the column those of the bodies.
    frame = frame.rename(columns={name: f"{name}_body" for name in axes})
    try:
        dataset: xarray.Dataset = frame.to_xarray()
    except ImportError:
        raise OutputError(
            "to_xarray needs xarray, which is not installed; run "
            "pip install 'rattlesweep[xarray]'"
        ) from None
    done = np.isin(np.arange(len(index)), place[selected])
    done = done.reshape(list(dataset.sizes.values()))
    for key, variable in dataset.items():
        column = layout.stored.schema.field(str(key).removesuffix("_body"))
        values = variable.to_numpy()
        if pa.types.is_string(column.type):
            values = variable.fillna("").to_numpy().astype(str)
        elif not pa.types.is_integer(column.type):
            values = values.astype(float)
        if fill_refined and layout.refined:
            values = fill(values, done)
        about = _described(*unit_and_meaning(column))
        dataset[key] = (variable.dims, values, about)
    for name in axes:
        unit = "degree"
        meaning = define(name).meaning
        if name in COLUMNS:
            unit, meaning = unit_and_meaning(COLUMNS[name].field)
        dataset[name].attrs = _described(unit, meaning)
    dataset.attrs = {
        "title": layout.stored.config.name,
        "source": f"rattlesweep {version('rattlesweep')}",
        "comment": "units: mass M, height a of the centre of mass at rest, and "
        "gravity g are 1",
        "references": "Kondo and Nakanishi, Phys. Rev. E 95, 062207 (2017)",
        "config_hash": layout.stored.hash,
    }
    return dataset


def _described(unit: str, meaning: str) -> dict[str, str]:
    """Return unit and meaning by the names that xarray shows."""
    return {"units": unit, "long_name": meaning}


def _data_columns(layout: SweepLayout, columns: Sequence[str] | None) -> list[str]:
    """Return the columns that are data and no axis; raise for unknown ones."""
    schema = layout.stored.schema
    single = [name for name in schema.names if name not in layout.lists]
    if columns is None:
        columns = single
    for name in columns:
        if name in layout.lists:
            raise ConfigError(f"columns: {name} has a list for each run; see read()")
        if name not in single:
            raise ConfigError(f"columns: {not_one_of(name, single)}")
    coordinates = {"case", "sample", *layout.axes} - set(TARGETS)
    return [name for name in columns if name not in coordinates]


def _read(layout: SweepLayout, names: Sequence[str]) -> pa.Table:
    """Return the keys and some columns of the runs, of which there may be none."""
    schema = pa.schema(
        [layout.stored.schema.field(name) for name in ("case", "sample", *names)]
    )
    empty = schema.remove_metadata().empty_table()
    batches = layout.rows(schema.names)
    tables = [pa.table(rows.select(schema.names)) for rows in batches]
    return pa.concat_tables([empty, *tables])
