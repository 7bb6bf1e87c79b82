"""Changes to the rows of output directories."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq


def edited(source: Path, target: Path, change: Callable[[pa.Table], pa.Table]) -> Path:
    """Copy a directory without its summary and change the rows of each file."""
    shutil.copytree(source, target)
    (target / "summary.parquet").unlink(missing_ok=True)
    for path in sorted((target / "runs").glob("*.parquet")):
        table = pq.ParquetFile(path).read()
        rows = change(table).replace_schema_metadata(table.schema.metadata)
        if len(rows):
            pq.write_table(rows, path, write_page_checksum=True)
        else:
            path.unlink()
    return target


def replaced(table: pa.Table, name: str, values: list[object]) -> pa.Table:
    """Replace the values of a column."""
    place = table.schema.get_field_index(name)
    field = table.schema.field(name)
    return table.set_column(place, field, pa.array(values, field.type))
