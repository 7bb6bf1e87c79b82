"""Arrays to Arrow tables to sealed Parquet bytes, and back. Touches no file.

A block must prove whole before a resumed sweep trusts it. Parquet's page checksums cover pages
but not the footer, and the footer's statistics are what DuckDB and Polars skip row groups by.
In a trial file of 2000 rows, a full read with checksums on missed 145 of some 520 single-bit
flips in the footer. So each file also carries the SHA-256 of itself, written over a placeholder
of the same length.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from rattlesweep.errors import DamagedError
from rattlesweep.sweeps.columns import REPEATING

ROW_GROUP = 1 << 17
"""Rows in a row group: about 30 MB decoded, so that readers can stream a large block."""

_SEAL = b"rattlesweep.sha256"
NOTE = b"rattlesweep.block"
"""Key of the file's metadata under which a block says what it is."""
_BLANK = b"0" * 64
# Thrift's compact protocol puts two bytes between a key and its value: field type and length.
_SEALED = re.compile(re.escape(_SEAL) + rb"\x18\x40([0-9a-f]{64})")


def build_table(columns: Mapping[str, Any], schema: pa.Schema) -> pa.Table:
    """Make a table of `schema` from plain arrays.

    There is one entry for each field of `schema`, in any order. Floats: an array in which NaN and
    infinity mean null. Integers: an array. Text: a list of `str` or `None`, or a tuple of (integer
    codes, categories) in which a negative code means null. Series: see `ragged`. Arrow arrays are
    taken for any of them. A ValueError is a mistake of the calling code: names, lengths or types
    disagree with `schema`, or a column that must have a value in every row lacks one.
    """
    if columns.keys() != {*schema.names}:
        raise ValueError(f"internal error: columns {[*columns]} for a schema of {schema.names}")
    arrays = [_to_arrow(columns[field.name], field.type) for field in schema]
    table = pa.Table.from_arrays(arrays, schema=schema.remove_metadata())
    table.validate()
    for field in table.schema:
        if not field.nullable and (empty := table.column(field.name).null_count):
            raise ValueError(
                f"internal error: column {field.name} has {empty} rows without a finite value, and "
                "may have none"
            )
    return table


def ragged(values: npt.NDArray[np.float64], counts: npt.NDArray[np.integer[Any]]) -> pa.Array:
    """Make a series column: from row i, the first ``counts[i]`` entries of ``values[i]``.

    `values` has shape (runs, most entries); a negative count makes the row null.
    """
    counts = np.asarray(counts, dtype=np.int64)
    offsets = np.zeros(len(counts) + 1, dtype=np.int32)
    np.cumsum(np.maximum(counts, 0), out=offsets[1:])
    kept = values[np.arange(values.shape[1]) < counts[:, None]]
    return pa.ListArray.from_arrays(
        pa.array(offsets), _floats(kept, pa.float64()), mask=pa.array(counts < 0)
    )


def _to_arrow(values: Any, kind: pa.DataType) -> pa.Array:
    if isinstance(values, pa.ChunkedArray):
        values = values.combine_chunks()
    if pa.types.is_floating(kind):
        return _floats(values, kind)
    if isinstance(values, tuple):
        codes, categories = values
        codes = np.asarray(codes)
        indices = pa.array(codes.astype(np.int32), mask=codes < 0)
        return pa.DictionaryArray.from_arrays(indices, pa.array(categories, kind)).cast(kind)
    if isinstance(values, pa.Array):
        return values.cast(kind)
    return pa.array(values, type=kind)


def _floats(values: Any, kind: pa.DataType) -> pa.Array:
    if isinstance(values, pa.Array):
        values = values.cast(kind)
        # A null, like NaN, is not finite: if_else turns both into null.
        return pc.if_else(pc.is_finite(values), values, pa.scalar(None, kind))
    array = np.ascontiguousarray(values, dtype=kind.to_pandas_dtype())
    finite = np.isfinite(array)
    return pa.array(array, type=kind, mask=None if finite.all() else ~finite)


def encode(table: pa.Table) -> bytes:
    """Turn a table into the bytes of a sealed Parquet file; equal tables give equal bytes."""
    return encode_hashed(table)[0]


def encode_hashed(table: pa.Table, note: bytes | None = None) -> tuple[bytes, str]:
    """As `encode`, with the file's SHA-256 in hexadecimal; `note` is kept in its metadata."""
    # Chunk borders would move page borders. The seal goes into the schema's metadata, since
    # ParquetWriter.add_key_value_metadata (merged May 2024) is younger than pyarrow 16.
    noted = {} if note is None else {NOTE: note}
    table = table.combine_chunks().replace_schema_metadata({**noted, _SEAL: _BLANK})
    sink = pa.BufferOutputStream()
    pq.write_table(
        table,
        sink,
        row_group_size=ROW_GROUP,
        version="2.6",
        compression="zstd",
        use_dictionary=[name for name in table.schema.names if name in REPEATING],
        write_statistics=True,
        write_page_checksum=True,
    )
    data = bytearray(sink.getvalue())
    start = _find_seal(data)
    seal, finish = _digests(data, start)
    data[start : start + len(_BLANK)] = seal
    return bytes(data), finish(seal)


def open_sealed(data: bytes) -> pq.ParquetFile:
    """Open the bytes of a file that `encode` made, having proved that no bit has changed."""
    return open_hashed(data)[0]


def open_hashed(data: bytes) -> tuple[pq.ParquetFile, str]:
    """As `open_sealed`, with the SHA-256 of the whole file in hexadecimal."""
    start = _find_seal(data)
    seal, finish = _digests(data, start)
    if seal != data[start : start + len(_BLANK)]:
        raise DamagedError("its checksum does not match")
    try:
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
    except (pa.ArrowException, OSError) as error:
        raise DamagedError(f"it is not Parquet: {error}") from error
    return file, finish(seal)


def read_rows(file: pq.ParquetFile, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows of a file that `open_sealed` has opened, without metadata of the whole."""
    # The bytes are Python's. A thread of Arrow's that lets go of them last, as the interpreter
    # ends, aborts the program ("terminate called without an active exception"): so none reads.
    names = None if columns is None else list(columns)
    return file.read(names, use_threads=False).replace_schema_metadata(None)


def _digests(data: bytes | bytearray, start: int) -> tuple[bytes, Callable[[bytes], str]]:
    """The seal that belongs at `start`, and what tells the file's own digest once it is there.

    What comes before, which is nearly all of it, is hashed once for both.
    """
    view = memoryview(data)
    before = hashlib.sha256(view[:start])

    def digest(seal: bytes) -> str:
        sha = before.copy()
        sha.update(seal)
        sha.update(view[start + len(_BLANK) :])
        return sha.hexdigest()

    return digest(_BLANK).encode(), digest


def _find_seal(data: bytes | bytearray) -> int:
    """Where the digest starts.

    Text in the rows, and so in the footer's statistics, may look like a seal; but the metadata
    come after the row groups, so the last one found is the seal.
    """
    if len(data) < 12 or data[:4] != b"PAR1" or data[-4:] != b"PAR1":
        raise DamagedError("it is cut short, or not Parquet")
    length = int.from_bytes(data[-8:-4], "little")
    if length > len(data) - 12:
        raise DamagedError("its footer is cut short")
    found = list(_SEALED.finditer(data, len(data) - 8 - length))
    if not found:
        raise DamagedError("it carries no checksum of this program")
    return found[-1].start(1)


def same_schema(one: pa.Schema, other: pa.Schema) -> bool:
    """Whether two schemas hold the same data: names, types, nulls, units.

    Descriptions are left out, so that better words do not make finished blocks worthless.
    """

    def key(schema: pa.Schema) -> list[tuple[str, str, bool, bytes]]:
        return [
            (f.name, str(f.type), f.nullable, (f.metadata or {}).get(b"unit", b"")) for f in schema
        ]

    return key(one) == key(other)


class ContentHash:
    """SHA-256 over the rows of a table fed in pieces, independent of how it is cut.

    Each column is hashed on its own, raw bits of its values and, apart from them, which rows
    have one; the digest is that of the names, types and digests of the columns in order.
    """

    def __init__(self, schema: pa.Schema) -> None:
        self._fields: list[tuple[str, pa.DataType]] = [(f.name, f.type) for f in schema]
        self._hashes: dict[tuple[str, str], Any] = {}

    def update(self, piece: pa.Table | pa.RecordBatch) -> None:
        """Add the next rows."""
        for name, kind in self._fields:
            column = piece.column(name)
            chunks: Sequence[pa.Array] = (
                column.chunks if isinstance(column, pa.ChunkedArray) else [column]
            )
            for chunk in chunks:
                self._add(name, chunk, kind)

    def _add(self, path: str, array: pa.Array, kind: pa.DataType) -> None:
        self._feed(path, "valid", array.is_valid().to_numpy(zero_copy_only=False))
        if pa.types.is_list(kind):
            counts = pc.fill_null(pc.list_value_length(array), 0)
            self._feed(path, "counts", counts.to_numpy().astype("<i8"))
            self._add(f"{path}[]", array.flatten(), kind.value_type)
        elif pa.types.is_string(kind):
            text = pc.fill_null(array, "")
            lengths = pc.binary_length(text).to_numpy(zero_copy_only=False)
            self._feed(path, "counts", lengths.astype("<i8"))
            self._feed(path, "values", "".join(text.to_pylist()).encode())
        else:
            # What lies under a null is not data, and need not be equal.
            values = pc.fill_null(array, pa.scalar(0).cast(kind)).to_numpy(zero_copy_only=False)
            self._feed(path, "values", values.astype(values.dtype.newbyteorder("<"), copy=False))

    def _feed(self, path: str, what: str, data: bytes | npt.NDArray[Any]) -> None:
        sha = self._hashes.setdefault((path, what), hashlib.sha256())
        sha.update(data if isinstance(data, bytes) else np.ascontiguousarray(data).tobytes())

    def hexdigest(self) -> str:
        """The digest of all rows so far, in hexadecimal."""
        total = hashlib.sha256()
        for name, kind in self._fields:
            total.update(f"{name}\0{kind}\0".encode())
        for (path, what), sha in sorted(self._hashes.items()):
            total.update(f"{path}\0{what}\0{sha.hexdigest()}\0".encode())
        return total.hexdigest()
