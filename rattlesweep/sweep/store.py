"""The output directory: where blocks come to rest, and how they prove whole.

A file appears under its name in one step, complete, or not at all. It is written beside its
place under a name no reader's pattern matches, forced to the disk, read back, renamed. Whatever
kills the process, at whatever moment, `runs/*.parquet` matches whole blocks only.
"""

from __future__ import annotations

import errno
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from rattlesweep.sweep.errors import ConfigError, OutputError
from rattlesweep.sweep.files import probe_directory, reason, remove_temporaries, replace_file
from rattlesweep.sweep.tables import (
    ContentHash,
    DamagedError,
    build_table,
    encode,
    open_sealed,
    same_schema,
)

_BLOCK = re.compile(r"block-(\d{6,})\.parquet")


class Store:
    """The files of one output directory.

    Parameters
    ----------
    directory
        Need not exist until `prepare`.
    """

    def __init__(self, directory: Path | str) -> None:
        self.directory = Path(directory)
        self.runs = self.directory / "runs"
        self.manifest_path = self.directory / "manifest.json"
        self.summary_path = self.directory / "summary.parquet"

    def prepare(self) -> None:
        """Create the directories and try out that files can be written there.

        Raises
        ------
        OutputError
            They cannot: read-only, a file in the way, no space.
        """
        probe_directory(self.directory)
        probe_directory(self.runs)

    def remove_stale_temporaries(self, older_than: float = 0.0) -> int:
        """Remove what killed processes left half-written.

        Parameters
        ----------
        older_than
            Age in seconds below which a file may still be in the hands of another process.

        Returns
        -------
        int
            Number of files removed.
        """
        return sum(remove_temporaries(f, older_than) for f in (self.directory, self.runs))

    # ------------------------------------------------------------------ blocks

    def block_path(self, index: int) -> Path:
        """Where block `index` has its place."""
        return self.runs / f"block-{index:06d}.parquet"

    def block_indices(self) -> list[int]:
        """Numbers of the blocks in place, ascending; other files in `runs` are ignored.

        Raises
        ------
        OutputError
            The directory exists but cannot be listed.
        """
        try:
            names = os.listdir(self.runs)
        except FileNotFoundError:
            return []
        except NotADirectoryError as error:
            raise OutputError(f"cannot use {self.directory}: a file is in the way") from error
        except OSError as error:
            raise OutputError(f"cannot read {self.runs}: {reason(error)}") from error
        return sorted(int(match[1]) for name in names if (match := _BLOCK.fullmatch(name)))

    def write_block(self, index: int, columns: Mapping[str, Any], schema: pa.Schema) -> None:
        """Write one block from plain arrays; see `tables.build_table` for what they may be.

        Raises
        ------
        OutputError
            The file cannot be written; what was there before still is.
        ValueError
            The columns do not make a table of `schema`: a mistake of the calling code.
        """
        self._write_table(self.block_path(index), build_table(columns, schema))

    def rewrite_block(self, index: int, table: pa.Table) -> None:
        """Put `table` in the place of block `index`, as safely as `write_block`.

        Raises
        ------
        OutputError
            The file cannot be written; the old block is still there.
        ValueError
            A column that must have a value in every row lacks one.
        """
        columns = {name: table.column(name) for name in table.schema.names}
        self._write_table(self.block_path(index), build_table(columns, table.schema))

    def block_is_whole(self, index: int, schema: pa.Schema, rows: int) -> bool:
        """Whether block `index` is in place, undamaged to the bit, and has these columns and rows.

        Raises
        ------
        OutputError
            The file may not be read, which says nothing about what it holds.
        """
        try:
            file = open_sealed(self.block_path(index).read_bytes())
        except PermissionError as error:
            raise OutputError(f"cannot read {self.block_path(index)}: {reason(error)}") from error
        except (DamagedError, OSError):
            return False
        return file.metadata.num_rows == rows and same_schema(file.schema_arrow, schema)

    def read_block(self, index: int, columns: Sequence[str] | None = None) -> pa.Table:
        """Read a block, having proved that it is whole.

        Raises
        ------
        OutputError
            It is missing, unreadable or damaged.
        """
        path = self.block_path(index)
        try:
            table = open_sealed(path.read_bytes()).read(columns=_listed(columns))
        except OSError as error:
            raise OutputError(f"cannot read {path}: {reason(error)}") from error
        except (DamagedError, pa.ArrowException) as error:
            raise OutputError(f"{path} is damaged: {error}") from error
        return table.replace_schema_metadata(None)

    def iter_blocks(self, columns: Sequence[str] | None = None) -> Iterator[tuple[int, pa.Table]]:
        """Yield (number, table) of the blocks in place, in order; errors as for `read_block`."""
        for index in self.block_indices():
            yield index, self.read_block(index, columns)

    def iter_batches(self, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield all rows in order, in pieces of bounded size, reading only these columns.

        Page checksums are verified; the seal of the whole file, which takes a read of all of
        it, is not.

        Raises
        ------
        OutputError
            A block is unreadable or damaged, or lacks one of the columns.
        """
        for index in self.block_indices():
            path = self.block_path(index)
            try:
                with pq.ParquetFile(path, page_checksum_verification=True) as file:
                    absent = set(columns or ()).difference(file.schema_arrow.names)
                    if absent:
                        raise OutputError(f"{path} has no column {', '.join(sorted(absent))}")
                    # One row group at a time: ParquetFile.iter_batches holds a whole block.
                    for group in range(file.num_row_groups):
                        yield from file.read_row_group(group, _listed(columns)).to_batches()
            except (pa.ArrowException, OSError) as error:
                raise OutputError(f"cannot read {path}: {reason(error)}") from error

    # -------------------------------------------------- summary and manifest

    def write_summary(self, table: pa.Table) -> None:
        """Write `summary.parquet`, as safely as a block.

        Raises
        ------
        OutputError
            The file cannot be written.
        """
        self._write_table(self.summary_path, table)

    def read_summary(self) -> pa.Table:
        """Read `summary.parquet`.

        Raises
        ------
        OutputError
            It is missing, unreadable or damaged.
        """
        try:
            table = open_sealed(self.summary_path.read_bytes()).read()
        except OSError as error:
            raise OutputError(f"cannot read {self.summary_path}: {reason(error)}") from error
        except (DamagedError, pa.ArrowException) as error:
            raise OutputError(f"{self.summary_path} is damaged: {error}") from error
        return table.replace_schema_metadata(None)

    def write_manifest(self, manifest: Mapping[str, Any]) -> None:
        """Write `manifest.json`, as safely as a block, keys in the order given.

        Floats come back bit for bit. NumPy scalars and paths are written as what they mean.

        Raises
        ------
        OutputError
            The file cannot be written.
        ValueError, TypeError
            It holds NaN, infinity, or something JSON has no word for.
        """
        text = json.dumps(
            dict(manifest), indent=2, allow_nan=False, ensure_ascii=False, default=_plain
        )
        replace_file(self.manifest_path, text.encode() + b"\n")

    def read_manifest(self) -> dict[str, Any]:
        """Read `manifest.json`.

        Raises
        ------
        ConfigError
            There is none, so this is no output directory.
        OutputError
            It cannot be read or is not what `write_manifest` writes.
        """
        try:
            manifest = json.loads(self.manifest_path.read_bytes())
        except (FileNotFoundError, NotADirectoryError):
            raise ConfigError(
                f"{self.directory} is not an output directory: it has no manifest.json"
            ) from None
        except OSError as error:
            raise OutputError(f"cannot read {self.manifest_path}: {reason(error)}") from error
        except (ValueError, RecursionError) as error:
            raise OutputError(f"{self.manifest_path} is damaged: {error}") from error
        if not isinstance(manifest, dict):
            raise OutputError(f"{self.manifest_path} is damaged: it holds no object")
        return manifest

    def _write_table(self, path: Path, table: pa.Table) -> None:
        def reads_back(temporary: Path) -> None:
            try:
                with pq.ParquetFile(temporary) as file:
                    rows = file.metadata.num_rows
            except pa.ArrowException as error:
                raise OSError(errno.EIO, f"does not read back: {reason(error)}") from error
            if rows != table.num_rows:
                raise OSError(errno.EIO, f"reads back {rows} of {table.num_rows} rows")

        replace_file(path, encode(table), reads_back)


def content_hash(directory: Path | str) -> str:
    """SHA-256 of all rows in order of (case, sample), however they are cut into blocks.

    Column by column in the order of the schema, raw bits: two sweeps have equal hashes when
    every value of every run is equal to the last bit. Memory does not grow with the rows.

    Raises
    ------
    OutputError
        A block is unreadable or damaged, blocks differ in their columns, or rows are out of
        order or there twice.
    """
    store = Store(directory)
    digest: ContentHash | None = None
    schema: pa.Schema | None = None
    last = (-1, -1)
    for batch in store.iter_batches():
        if schema is None or digest is None:
            schema = batch.schema
            digest = ContentHash(schema)
        elif not same_schema(schema, batch.schema):
            raise OutputError(f"the blocks in {store.runs} differ in their columns")
        last = _check_order(batch, last, store.runs)
        digest.update(batch)
    return (digest or ContentHash(pa.schema([]))).hexdigest()


def _check_order(batch: pa.RecordBatch, last: tuple[int, int], where: Path) -> tuple[int, int]:
    """Check that rows ascend strictly by (case, sample); the last row's keys."""
    if batch.num_rows == 0:
        return last
    case = _with_first(last[0], batch.column("case"))
    sample = _with_first(last[1], batch.column("sample"))
    step = np.diff(case)
    if not np.all((step > 0) | ((step == 0) & (np.diff(sample) > 0))):
        raise OutputError(f"the rows in {where} are not in the order of (case, sample), each once")
    return int(case[-1]), int(sample[-1])


def _with_first(first: int, column: pa.Array) -> npt.NDArray[np.int64]:
    values = pc.fill_null(column, -1).to_numpy(zero_copy_only=False).astype(np.int64)
    return np.concatenate([np.array([first], dtype=np.int64), values])


def _listed(columns: Sequence[str] | None) -> list[str] | None:
    return None if columns is None else list(columns)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"internal error: {type(value).__name__} in the manifest")
