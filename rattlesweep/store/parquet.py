"""Parquet files whose every byte is covered by a checksum.

Parquet itself has checksums for pages, but none for the footer, in which a flipped bit
may rename a column. So the four bytes before the footer hold the checksum of the
footer. Readers that do not know of it skip these bytes, as they skip any gap.
"""

import errno
import io
import os
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.system.files import open_regular, reason, streamed_file
from rattlesweep.words.errors import DamagedError, GoneError, OutputError

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
# Most rows in a group, the least that is read at once: about 30 MB in memory, so that
# readers can stream a large file.
ROW_GROUP = 1 << 17
MARK = b"footer's crc32: "  # precedes the checksum
GONE = (errno.ENOENT, errno.ESTALE)  # errors of a file that others have replaced
ENDING = 8  # bytes after the footer: its length, and Parquet's own mark
# Words of Arrow about memory and threads that it did not get, for which it has no
# number and no class.
SYSTEM = re.compile(r"(?i)memory|alloc|thread|temporarily unavailable|too many open")


def write_parquet(
    table: pa.Table,
    path: Path,
    metadata: Mapping[str, str] | None = None,
    staging: Path | None = None,
    new: bool = False,
) -> None:
    """Write a table with metadata; equal tables give equal files.

    The file is written in the folder `staging`, by default that of `path`, and appears
    at `path` when it is complete. A file that is `new` takes no other's place.
    """
    new_metadata = None
    if metadata:
        new_metadata = dict(metadata)
    # Where pages of the file end depends on the chunks of the table, which equal tables
    # need not share.
    table = table.combine_chunks().replace_schema_metadata(new_metadata)
    data = encode(table)
    with streamed_file(path, staging, new) as file:
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
    footer_start = len(data) - ENDING - _footer_length(data[-ENDING:])
    footer = data[footer_start:]  # and the ending
    checksum = zlib.crc32(footer).to_bytes(4, "little")
    return data[:footer_start] + MARK + checksum + footer


def read_parquet(
    path: Path,
    columns: Sequence[str] | None = None,
    check: Callable[[pa.Schema, pq.FileMetaData], None] = lambda schema, footer: None,
) -> pa.Table:
    """Return the rows of a Parquet file, with its metadata.

    Raise a DamagedError if its contents contradict their checksums, and an OutputError
    if the system cannot read it, a GoneError if there is no such file.  `check` is
    called with the schema and the footer before rows are read, and may raise.
    """
    try:
        # A file opened by Python raises errors of the system with their numbers. Arrow
        # raises some without a number, which could not be told from damage. It reads
        # without threads: a process may be allowed none, and they would outlive the
        # file.
        with open_regular(path) as file:
            _check_footer(file)
            # All in this thread: one of Arrow's might be the last to use the file, and
            # destroying a Python file while the interpreter ends aborts the process.
            parquet = pq.ParquetFile(
                file, page_checksum_verification=True, pre_buffer=False
            )
            check(parquet.schema_arrow, parquet.metadata)
            names = None if columns is None else list(columns)
            rows = parquet.read(names, use_threads=False)
            if len(rows) != parquet.metadata.num_rows:
                raise pa.ArrowInvalid("its footer contradicts itself")
            return rows
    except MemoryError:
        # Arrow's MemoryError is also an ArrowException, but the file is not damaged.
        raise
    except (pa.ArrowException, OSError, EOFError, UnicodeDecodeError) as error:
        if isinstance(error, OSError) and error.errno in GONE:
            raise GoneError(f"cannot read {path}: {reason(error)}") from error
        has_number = isinstance(error, OSError) and error.errno is not None
        if has_number or SYSTEM.search(str(error)):
            raise OutputError(f"cannot read {path}: {reason(error)}") from error
        raise DamagedError(f"{path} is damaged: {reason(error)}") from error


def _check_footer(file: BinaryIO) -> None:
    """Raise an ArrowInvalid if the footer contradicts its checksum, if it has one."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - ENDING))
    ending = file.read()
    from_mark = len(MARK) + 4 + _footer_length(ending) + ENDING  # bytes, to the end
    # What is no Parquet file, or was written by others, is left to Arrow.
    if from_mark <= size:
        file.seek(size - from_mark)
        if file.read(len(MARK)) == MARK:
            checksum = int.from_bytes(file.read(4), "little")
            if zlib.crc32(file.read()) != checksum:
                raise pa.ArrowInvalid("its footer contradicts its checksum")
    file.seek(0)


def _footer_length(ending: bytes) -> int:
    """Return the length of the footer, from the bytes that follow it."""
    return int.from_bytes(ending[:4], "little")
