"""A sweep as an xarray Dataset: one dimension for each thing that varies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.analysis.plots.layout import TARGETS, Layout, fill
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.columns import RUNS
from rattlesweep.sweeps.config import not_one_of
from rattlesweep.sweeps.config.schema import PARAMETERS
from rattlesweep.sweeps.provenance import package_version

if TYPE_CHECKING:
    import xarray

UNITS = "mass M, height of the centre of mass at rest a and gravity g are 1"


def make_dataset(
    layout: Layout, columns: Sequence[str] | None = None, *, fill_refined: bool = False
) -> xarray.Dataset:
    """Return the runs along the axes of their sweep, as ``Sweep.to_xarray`` promises.

    Raises a ConfigError if xarray is not installed or there is no such column.
    """
    try:
        import xarray
    except ImportError as error:
        raise ConfigError(
            f"to_xarray needs xarray ({error}); install it with `pip install 'rattlesweep[xarray]'`"
        ) from None
    schema = layout.stored.schema
    single = [column.name for column in schema if not pa.types.is_list(column.type)]
    for name in columns or ():
        if name not in single:
            raise ConfigError(f"columns: {not_one_of(name, single)}")
    # An axis is a coordinate already; of a target it is what was asked for, and not each body's.
    axes = {"case", "sample", *layout.axes} - set(TARGETS)
    names = [name for name in (single if columns is None else columns) if name not in axes]
    wanted = pa.schema([schema.field(name) for name in ("case", "sample", *names)])
    batches = [pa.table(rows.select(wanted.names)) for rows in layout.rows(wanted.names)]
    table = pa.concat_tables([wanted.remove_metadata().empty_table(), *batches])

    known = {column.name: column for part in RUNS.values() for column in part}
    coordinates: dict[str, Any] = {}
    for name, axis in layout.axes.items():
        about = (_about(known[name]) if name in known
                 else {"units": "degree", "long_name": PARAMETERS[name][2]})  # fmt: skip
        coordinates[name] = name, axis.values, about
    place, shape = layout.cells(table), [*layout.lengths.values()]
    if not layout.bodies:
        samples = layout.stored.samples
        coordinates["sample"] = "sample", np.arange(samples), _about(schema.field("sample"))
        place = np.where(place >= 0, place * samples + table["sample"].to_numpy(), -1)
        shape.append(samples)
    done = np.bincount(place[place >= 0], minlength=int(np.prod(shape))) > 0
    variables = {}
    for name in names:
        column = table[name].to_pandas()[place >= 0].set_axis(place[place >= 0])
        column = column.reindex(np.arange(done.size))
        if pa.types.is_string(table[name].type):
            values = column.fillna("").to_numpy(str)
        else:  # whole numbers stay so unless any is missing
            whole = pa.types.is_integer(table[name].type) and not column.hasnans
            values = column.to_numpy(None if whole else float)
        values = values.reshape(shape)
        if fill_refined and layout.refined:
            values = fill(values, done.reshape(shape))
        own = f"{name}_body" if name in coordinates else name
        variables[own] = tuple(coordinates), values, _about(schema.field(name))
    return xarray.Dataset(variables, coordinates, {
        "title": layout.stored.config.name,
        "source": f"rattlesweep {package_version()}",
        "comment": UNITS,
        "references": "Kondo and Nakanishi, Phys. Rev. E 95, 062207 (2017)",
        "config_hash": layout.stored.hash,
    })  # fmt: skip


def _about(column: pa.Field) -> dict[str, str]:
    metadata = column.metadata
    return {"units": metadata[b"unit"].decode(), "long_name": metadata[b"description"].decode()}
