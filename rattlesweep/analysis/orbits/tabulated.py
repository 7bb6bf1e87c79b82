"""Tables of orbits, with units, in memory and as files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.analysis.orbits.orbit import Orbit, row_of
from rattlesweep.rows.arrow import field
from rattlesweep.rows.columns import define
from rattlesweep.system.files import as_path, replace_file, streamed_file
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import ENERGY, RATE, TIME

if TYPE_CHECKING:
    import pandas as pd

_UNITS = {
    "energy": ENERGY,
    "period": TIME,
    "period_s": "s",
    "n_mean": RATE,
    "omega": RATE,
    "turn_deg": "deg",
    "angle": "rad",
}


def table_of_orbits(orbits: Iterable[Orbit]) -> pd.DataFrame:
    """Return orbits as a table, a row each."""
    import pandas as pd

    rows = [{**row_of(orbit), "kind": orbit.kind} for orbit in orbits]
    return with_units(pd.DataFrame(rows))


def with_units(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of orbits with units in ``attrs``, ``"1"`` for none."""
    table.attrs["units"] = {name: _unit_of(str(name)) for name in table}
    return table


def _unit_of(column: str) -> str:
    # Components and multipliers are numbered.
    stem = column.rpartition("_")[0]
    return _UNITS.get(column) or _UNITS.get(stem) or define(column).unit


def save_orbits(table: pd.DataFrame, path: str | Path) -> None:
    """Write a table of orbits to a .parquet file, with units, or to a .csv file."""
    path = as_path(path, "path")
    if path.suffix.lower() == ".csv":
        replace_file(path, table.to_csv(index=False).encode())
        return
    if path.suffix.lower() != ".parquet":
        raise ConfigError(f"path {path}: the name must end in .parquet or .csv")
    plain = pa.Table.from_pandas(table, preserve_index=False)
    units = {str(name): _unit_of(str(name)) for name in table}
    fields = [
        field(each.name, each.type, units[each.name], "") for each in plain.schema
    ]
    with streamed_file(path) as file:
        pq.write_table(plain.cast(pa.schema(fields)), file)
