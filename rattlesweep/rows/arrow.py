"""Columns as Arrow has them: types, fields with units, tables from values."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Floats, Integers

# A column of words: the number of the word of each run (-1: null), and the words.
Words: TypeAlias = "tuple[NDArray[Any], Sequence[str]]"
# A column before it is written.
Values: TypeAlias = "NDArray[Any] | pa.Array | Words"

F64 = pa.float64()
I32 = pa.int32()
I64 = pa.int64()
FLAG = pa.bool_()
TEXT = pa.string()
# A list of numbers for each run.  Parquet calls its items "element"; with this name,
# the schema of a file that is read equals the schema that was written.
_SERIES = pa.list_(pa.field("element", F64))


def field(
    name: str, kind: pa.DataType, unit: str, words: str, nullable: bool = True
) -> pa.Field:
    """Return a column with its unit (``"1"`` without one) and its meaning."""
    return pa.field(name, kind, nullable, metadata={"unit": unit, "description": words})


def unit_and_meaning(column: pa.Field) -> tuple[str, str]:
    """Return the unit and the meaning of a column of a schema."""
    metadata = column.metadata
    return metadata[b"unit"].decode(), metadata[b"description"].decode()


def same_schema(schema: pa.Schema, expected: pa.Schema) -> bool:
    """Return whether schemas agree in names, types, nullability and units."""
    return schema.equals(expected) and _units(schema) == _units(expected)


def _units(schema: pa.Schema) -> list[bytes]:
    return [(column.metadata or {}).get(b"unit", b"") for column in schema]


def build_table(columns: Mapping[str, Values], schema: pa.Schema) -> pa.Table:
    """Return a table of columns, where NaN and infinity become null."""
    arrays = [_to_arrow(columns[column.name], column.type) for column in schema]
    table = pa.Table.from_arrays(arrays, schema=schema.remove_metadata())
    for column in table.schema:
        if not column.nullable and table.column(column.name).null_count:
            raise ValueError(
                f"internal error: column {column.name} has rows that are not finite"
            )
    return table


def ragged(values: Floats, counts: Integers) -> pa.Array:
    """Return a column of lists ``values[i, :counts[i]]``, null for a negative count."""
    offsets = np.cumsum(np.append(0, np.maximum(counts, 0)), dtype=np.int32)
    is_listed = np.arange(values.shape[1]) < counts[:, None]
    listed = _to_arrow(values[is_listed], F64)
    is_null = pa.array(counts < 0)
    return pa.ListArray.from_arrays(pa.array(offsets), listed, mask=is_null)


def _to_arrow(values: Values, kind: pa.DataType) -> pa.Array:
    if isinstance(values, tuple):
        codes, words = values
        # The index -1 takes the last, which is null.
        values = np.array([*words, None], dtype=object)[codes]
    if isinstance(values, pa.Array | pa.ChunkedArray):
        return values.cast(kind)
    if pa.types.is_floating(kind):
        values = np.where(np.isfinite(values), values, np.nan)
    # from_pandas: NaN becomes null.
    return pa.array(values, kind, from_pandas=True)


def floats(column: pa.Array) -> Floats:
    """Return a column of numbers; null is NaN."""
    return column.to_numpy(zero_copy_only=False).astype(float)
