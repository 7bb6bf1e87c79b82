"""The runs of a sweep as one table for other programs, in pieces that fit into memory.

:func:`chosen_batches` reads chosen rows and columns; a writer for each kind of file
takes them one piece after another.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import BinaryIO, Protocol

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from rattlesweep.analysis.where import parse_where
from rattlesweep.rows.arrow import unit_and_meaning
from rattlesweep.store.parquet import ROW_GROUP
from rattlesweep.store.rows import Stored
from rattlesweep.system.files import streamed_file
from rattlesweep.words.errors import ConfigError, check_names

DIMENSIONLESS = "1"


class RowWriter(AbstractContextManager["RowWriter"], Protocol):
    """What takes batches of rows, and completes a file when it is left."""

    def write_batch(self, rows: pa.RecordBatch) -> None:
        """Write some rows after those before."""


def schema_of(stored: Stored, columns: Sequence[str] | None) -> pa.Schema:
    """Return the schema of chosen columns, by default of all."""
    if columns is None:
        return stored.schema
    check_names("columns", columns, stored.schema.names)
    return pa.schema([stored.schema.field(name) for name in columns])


def chosen_batches(
    stored: Stored, schema: pa.Schema, where: str | None = None
) -> Iterator[pa.RecordBatch]:
    """Return the columns of a schema of the runs that meet a condition, in order.

    A wrong condition is refused at once, before rows are read.
    """
    if where is None:
        return (rows.cast(schema) for rows in stored.batches(schema.names))
    condition = parse_where(where, stored.schema)
    needed = list(dict.fromkeys((*schema.names, *condition.columns)))
    return (
        condition.filter(rows).select(schema.names).cast(schema)
        for rows in stored.batches(needed)
    )


def write_rows(
    batches: Iterator[pa.RecordBatch],
    schema: pa.Schema,
    path: Path | None,
    stream: BinaryIO,
    units: bool = False,
) -> int:
    """Write rows to a file, or as CSV to a stream; return how many there are.

    The file is whole or not there. With `units`, the head of a CSV has them; other
    files always have them in the metadata of their columns.
    """
    if not schema.names:
        raise ConfigError("columns: none is named; name one, as in t_r")
    for name in schema.names:
        if schema.names.count(name) > 1:
            raise ConfigError(f"columns: {name} is named twice; name it once")
    if path is None:
        with _CsvWriter(stream, schema, units) as writer:
            return _write_all(batches, schema, writer)
    ending = path.suffix.lower()
    if units and ending != ".csv":
        raise ConfigError(
            f"units: they are for the head of a CSV; a {ending} has them in the "
            "metadata of its columns, so leave --units out"
        )
    with streamed_file(path) as file:
        if ending == ".csv":
            chosen: RowWriter = _CsvWriter(file, schema, units)
        else:
            chosen = _ARROW_WRITERS[ending](file, schema)
        with chosen:
            return _write_all(batches, schema, chosen)


def _write_all(
    batches: Iterator[pa.RecordBatch], schema: pa.Schema, writer: RowWriter
) -> int:
    """Write batches, joined to groups of rows that readers can take one by one."""
    rows = 0
    held: list[pa.RecordBatch] = []

    def write_held() -> None:
        if held:
            table = pa.Table.from_batches(held, schema).combine_chunks()
            for group in table.to_batches(max_chunksize=ROW_GROUP):
                writer.write_batch(group)
            held.clear()

    for batch in batches:
        rows += len(batch)
        held.append(batch)
        if sum(map(len, held)) >= ROW_GROUP:
            write_held()
    write_held()
    return rows


class _CsvWriter(AbstractContextManager["_CsvWriter"]):
    """A writer of CSV: nulls are empty cells, lists are texts such as ``[1.5,2.0]``."""

    def __init__(self, stream: BinaryIO, schema: pa.Schema, units: bool) -> None:
        self._lists = [field.name for field in schema if pa.types.is_list(field.type)]
        head = io.StringIO()
        names = [_head(field, units) for field in schema]
        csv.writer(head, lineterminator="\n").writerow(names)
        stream.write(head.getvalue().encode())
        plain = [
            pa.field(field.name, pa.string()) if field.name in self._lists else field
            for field in schema
        ]
        self._schema = pa.schema(plain)
        options = pyarrow.csv.WriteOptions(include_header=False)
        self._writer = pyarrow.csv.CSVWriter(
            stream, self._schema, write_options=options
        )

    def write_batch(self, rows: pa.RecordBatch) -> None:
        """Write some rows."""
        columns = []
        for name, column in zip(rows.schema.names, rows.columns, strict=True):
            if name in self._lists:
                column = pa.array(map(_list_text, column.to_pylist()), pa.string())
            columns.append(column)
        self._writer.write_batch(
            pa.RecordBatch.from_arrays(columns, schema=self._schema)
        )

    def __exit__(self, *error: object) -> None:
        """Write what is left; the stream stays open."""
        self._writer.close()


def _head(field: pa.Field, units: bool) -> str:
    """Return the head of a column in CSV, perhaps as in ``t_r [sqrt(a/g)]``."""
    unit, _ = unit_and_meaning(field)
    if units and unit != DIMENSIONLESS:
        return f"{field.name} [{unit}]"
    return str(field.name)


def _list_text(values: list[float] | None) -> str | None:
    if values is None:
        return None
    return json.dumps(values, separators=(",", ":"))


_ARROW_WRITERS: dict[str, Callable[[BinaryIO, pa.Schema], RowWriter]] = {
    ".parquet": partial(pq.ParquetWriter, version="2.6", compression="zstd"),
    ".arrow": pa.ipc.new_file,
}
