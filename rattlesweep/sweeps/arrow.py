"""Arrays to Arrow tables, and tables to Parquet files and back.

Each page of a file carries a checksum, which every reader here verifies.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import DamagedError, OutputError
from rattlesweep.sweeps.columns import REPEATING
from rattlesweep.sweeps.files import reason, streamed_file

ROW_GROUP = 1 << 17  # rows: about 30 MB decoded, so that readers can stream a large file


def build_table(columns: Mapping[str, Any], schema: pa.Schema) -> pa.Table:
    """Make a table of `schema` from one entry for each of its fields.

    Floats: an array in which NaN and infinity mean null.  Text: a list, or a tuple of (integer
    codes, categories) in which a negative code means null.  Series: see :func:`ragged`.  Arrow
    arrays are taken for any of them.
    """
    arrays = [_to_arrow(columns[field.name], field.type) for field in schema]
    table = pa.Table.from_arrays(arrays, schema=schema.remove_metadata())
    table.validate()
    for field in table.schema:
        if not field.nullable and table.column(field.name).null_count:
            raise ValueError(f"internal error: column {field.name} has rows that are not finite")
    return table


def ragged(values: Floats, counts: Integers) -> pa.Array:
    """Make a series column: from row i, the first ``counts[i]`` entries of ``values[i]``.

    `values` has shape (runs, most entries); a negative count makes the row null.
    """
    offsets = np.cumsum(np.append(0, np.maximum(counts, 0)), dtype=np.int32)
    kept = values[np.arange(values.shape[1]) < counts[:, None]]
    floats = _floats(kept, pa.float64())
    return pa.ListArray.from_arrays(pa.array(offsets), floats, mask=pa.array(counts < 0))


def _to_arrow(values: Any, kind: pa.DataType) -> pa.Array:
    if isinstance(values, pa.ChunkedArray):
        values = values.combine_chunks()
    if pa.types.is_floating(kind):
        return _floats(values, kind)
    if isinstance(values, tuple):
        codes, categories = np.asarray(values[0]), values[1]
        indices = pa.array(codes.astype(np.int32), mask=codes < 0)
        return pa.DictionaryArray.from_arrays(indices, pa.array(categories, kind)).cast(kind)
    return values.cast(kind) if isinstance(values, pa.Array) else pa.array(values, type=kind)


def _floats(values: Any, kind: pa.DataType) -> pa.Array:
    if not isinstance(values, pa.Array):
        values = pa.array(np.ascontiguousarray(values, dtype=kind.to_pandas_dtype()))
    values = values.cast(kind)
    # A null, like NaN, is not finite: if_else turns both into null.
    return pc.if_else(pc.is_finite(values), values, pa.scalar(None, kind))


def write_parquet(table: pa.Table, path: Path, metadata: Mapping[str, str] | None = None) -> None:
    """Write a table, and words beside its schema; equal tables give equal files."""
    # Chunk borders would move page borders.
    table = table.combine_chunks().replace_schema_metadata(dict(metadata or {}) or None)
    with streamed_file(path) as file:
        encode(table, file)


def encode(table: pa.Table, sink: Any) -> None:
    """Write a table as Parquet, with page checksums, to an open file."""
    pq.write_table(
        table,
        sink,
        row_group_size=ROW_GROUP,
        version="2.6",
        compression="zstd",
        use_dictionary=[name for name in table.schema.names if name in REPEATING],
        write_page_checksum=True,
    )


@contextmanager
def parquet_file(path: Path) -> Iterator[pq.ParquetFile]:
    """Open a Parquet file whose pages are verified as they are read.

    Raise a DamagedError if it is not what was written, and another OutputError if it cannot be
    read, which says nothing about what it holds.
    """
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            yield file
    except MemoryError:
        raise  # Arrow's own is an ArrowException too, and says nothing about the file
    except (pa.ArrowException, OSError, EOFError, UnicodeDecodeError) as error:
        # Arrow raises OSError, without a number, for pages and footers that are not as they were.
        if isinstance(error, OSError) and error.errno is not None:
            raise OutputError(f"cannot read {path}: {os.strerror(error.errno)}") from error
        raise DamagedError(f"{path} is damaged: {reason(error)}") from error


def read_parquet(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Return the rows of a Parquet file, with its metadata; errors as for :func:`parquet_file`."""
    with parquet_file(path) as file:
        return file.read(None if columns is None else list(columns))


def same_schema(one: pa.Schema, other: pa.Schema) -> bool:
    """Return whether names, types, nulls and units are the same; descriptions may differ."""
    units = [[(f.metadata or {}).get(b"unit", b"") for f in schema] for schema in (one, other)]
    return one.equals(other) and units[0] == units[1]
