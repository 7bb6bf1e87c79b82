"""Parquet files whose every byte is covered by a checksum.

Parquet itself has checksums for pages, but none for the footer, in which a flipped bit
may rename a column. So the four bytes before the footer hold the checksum of the
footer. Readers that do not know of it skip these bytes, as they skip any gap.
"""

import io
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.errors import DamagedError, OutputError
from rattlesweep.sweeps.files import open_regular, reason, streamed_file

# Columns with few distinct values, which dictionary encoding makes smaller.
REPEATING = {
    "case",
    "n_i",
    "omega_xy0",
    "type",
    "status",
    "near_tangencies",
    "window_t",
}
# Rows in a group: about 30 MB decoded, so that readers can stream a large file.
ROW_GROUP = 1 << 17
MARK = b"footer's crc32: "  # precedes the checksum
ENDING = 8  # bytes after the footer: its length, and Parquet's own mark


def write_parquet(
    table: pa.Table,
    path: Path,
    metadata: Mapping[str, str] | None = None,
    staging: Path | None = None,
) -> None:
    """Write a table with metadata; equal tables give equal files.

    The file is written in the folder `staging`, by default its own, before it appears.
    """
    # Page boundaries depend on those of chunks.
    table = table.combine_chunks().replace_schema_metadata(dict(metadata or {}) or None)
    data = encode(table)
    with streamed_file(path, staging) as file:
        file.write(data)


def encode(table: pa.Table) -> bytes:
    """Return a table as the bytes of a Parquet file with checksums."""
    repeating = [name for name in table.schema.names if name in REPEATING]
    sink = io.BytesIO()
    pq.write_table(
        table,
        sink,
        row_group_size=ROW_GROUP,
        version="2.6",
        compression="zstd",
        use_dictionary=repeating,
        write_page_checksum=True,
    )
    data = sink.getvalue()
    footer = len(data) - ENDING - _footer_length(data[-ENDING:])
    checksum = zlib.crc32(data[footer:]).to_bytes(4, "little")
    return data[:footer] + MARK + checksum + data[footer:]


def read_parquet(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Return the rows of a Parquet file, with its metadata.

    Raise a DamagedError if its contents contradict their checksums, and an OutputError
    if the system cannot read it.
    """
    try:
        # Python's own file tells errors of the system by their numbers. Arrow would
        # tell some without one, as it tells damage.
        with open_regular(path) as file:
            _check_footer(file)
            parquet = pq.ParquetFile(file, page_checksum_verification=True)
            rows = parquet.read(None if columns is None else list(columns))
            if len(rows) != parquet.metadata.num_rows:
                raise pa.ArrowInvalid("its footer contradicts itself")
            return rows
    except MemoryError:
        # Arrow's own is also an ArrowException, but does not mean the file is damaged.
        raise
    except (pa.ArrowException, OSError, EOFError, UnicodeDecodeError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise OutputError(f"cannot read {path}: {reason(error)}") from error
        raise DamagedError(f"{path} is damaged: {reason(error)}") from error


def _check_footer(file: BinaryIO) -> None:
    """Raise an ArrowInvalid if the footer contradicts its checksum, if it has one."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - ENDING))
    ending = file.read()
    before = ENDING + _footer_length(ending) + len(MARK) + 4
    # What is no Parquet file, or was written by others, is left to Arrow.
    if before <= size:
        file.seek(size - before)
        if file.read(len(MARK)) == MARK:
            checksum = int.from_bytes(file.read(4), "little")
            if zlib.crc32(file.read()) != checksum:
                raise pa.ArrowInvalid("its footer contradicts its checksum")
    file.seek(0)


def _footer_length(ending: bytes) -> int:
    """Return the length of the footer, from the bytes that follow it."""
    return int.from_bytes(ending[:4], "little")
