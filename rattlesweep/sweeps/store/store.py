"""The output directory: where blocks come to rest, and how they prove whole.

A file appears under its name in one step, complete, or not at all. It is written beside its
place under a name no reader's pattern matches, forced to the disk, read back, renamed. Whatever
kills the process, at whatever moment, `runs/*.parquet` matches complete blocks only.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.errors import ConfigError, DamagedManifest, OutputError
from rattlesweep.sweeps.store import sealed
from rattlesweep.sweeps.store.atomic import (
    NotAFile,
    probe_directory,
    read_file,
    reason,
    remove_temporaries,
    rename_file,
    replace_file,
)
from rattlesweep.sweeps.store.blockfile import (
    MOST_ROWS,
    BlockFile,
    Note,
    block_name,
    block_number,
    read_block_file,
    receipt_of,
)
from rattlesweep.sweeps.store.locks import manifest_lock
from rattlesweep.sweeps.store.manifest import Manifest, Receipt
from rattlesweep.sweeps.tables.arrow import (
    DamagedError,
    build_table,
    encode,
    encode_hashed,
    open_sealed,
)

MOST_BYTES = 1 << 31
"""Bytes that a file which is no block can have."""
YOUNG = 3600.0
"""Seconds for which another process may have a half-written file in its hands."""
# In every manifest, and in the footer of every table.
_MARKS = (b'"config_hash"', b"rattlesweep.sha256")


class Store:
    """The files of one output directory.

    Parameters
    ----------
    directory
        Need not exist until `prepare`.

    Attributes
    ----------
    rows : int
        Rows that a block can have; set by those who know the sweep, it bounds what is read.
    """

    def __init__(self, directory: Path | str) -> None:
        self.directory = Path(directory)
        self.runs = self.directory / "runs"
        self.manifest_path = self.directory / "manifest.json"
        self.summary_path = self.directory / "summary.parquet"
        self.rows = MOST_ROWS
        self._opened = self._folders()

    def prepare(self) -> None:
        """Create the directories and try out that files can be written there.

        Raises
        ------
        ConfigError
            The directory is somebody else's.
        OutputError
            They cannot: read-only, a file in the way, no space.
        """
        self.check_ours()
        probe_directory(self.directory)
        probe_directory(self.runs)
        self._opened = self._folders()

    def check_ours(self) -> None:
        """Refuse a directory that holds something, but nothing of this program.

        Raises
        ------
        ConfigError
            It does; its files might be overwritten.
        OutputError
            It cannot be listed.
        """
        try:
            names = sorted(os.listdir(self.directory))
        except (FileNotFoundError, NotADirectoryError):
            return
        except OSError as error:
            raise OutputError(f"cannot read {self.directory}: {reason(error)}") from error
        # Hidden files are not in the way, and among them is what a killed process leaves.
        shown = [name for name in names if not name.startswith(".") and name != "runs"]
        if not shown or self.block_indices():
            return
        for name in shown:
            if name == self.manifest_path.name or name.endswith(".parquet"):
                try:
                    data = read_file(self.directory / name, MOST_BYTES)
                except (NotAFile, FileNotFoundError):
                    continue
                except OSError as error:
                    raise OutputError(
                        f"cannot read {self.directory / name}: {reason(error)}"
                    ) from error
                if any(mark in data for mark in _MARKS):
                    return
        raise ConfigError(
            f"{self.directory}: it is not empty, and what it holds ({shown[0]}"
            f"{' and others' if len(shown) > 1 else ''}) is no sweep; choose a new directory"
        )

    def _folders(self) -> dict[Path, os.stat_result]:
        """Which directories there are by these names now."""
        found = {}
        for folder in (self.directory, self.runs):
            with contextlib.suppress(OSError, ValueError):
                found[folder] = os.stat(folder)
        return found

    def _check_in_place(self) -> None:
        """Refuse to write where another directory has taken the place of the one opened."""
        for folder, opened in self._opened.items():
            try:
                same = os.path.samestat(os.stat(folder), opened)
            except (FileNotFoundError, NotADirectoryError):
                same = False
            except OSError as error:
                raise OutputError(f"cannot read {folder}: {reason(error)}") from error
            if not same:
                raise OutputError(
                    f"{folder} has been moved, removed or replaced while it was in use; nothing "
                    "more is written there"
                )

    def remove_stale_temporaries(self, alone: bool) -> int:
        """Remove what killed processes left half-written.

        Parameters
        ----------
        alone
            Whether no other process can be at work there; else young files may be in its hands.

        Returns
        -------
        int
            Number of files removed.
        """
        age = 0.0 if alone else YOUNG
        return sum(remove_temporaries(folder, age) for folder in (self.directory, self.runs))

    # ------------------------------------------------------------------ blocks

    def block_path(self, index: int) -> Path:
        """Where block `index` has its place."""
        return self.runs / block_name(index)

    def is_block(self, path: Path) -> bool:
        """Whether a file has the name of a block."""
        return block_number(path.name) is not None

    def block_indices(self) -> list[int]:
        """Numbers of the blocks in place, ascending; other files in `runs` are ignored."""
        try:
            names = os.listdir(self.runs)
        except FileNotFoundError:
            return []
        except NotADirectoryError as error:
            raise OutputError(f"cannot use {self.directory}: a file is in the way") from error
        except OSError as error:
            raise OutputError(f"cannot read {self.runs}: {reason(error)}") from error
        return sorted(number for name in names if (number := block_number(name)) is not None)

    def strays(self, blocks: int) -> Iterator[Path]:
        """Files that readers of ``runs/*.parquet`` take for runs, but none of so many blocks."""
        for name in sorted(os.listdir(self.runs)):
            if name.startswith(".") or not name.endswith(".parquet"):
                continue
            number = block_number(name)
            if number is None or number >= blocks:
                yield self.runs / name

    def rename(self, path: Path, target: Path) -> None:
        """Move a block to its place."""
        self._check_in_place()
        rename_file(path, target)

    def write_block(
        self,
        index: int,
        columns: Mapping[str, Any],
        schema: pa.Schema,
        note: Note | None = None,
    ) -> Receipt:
        """Write one block from plain arrays; see `tables.build_table` for what they may be.

        Raises
        ------
        OutputError
            The file cannot be written; what was there before still is.
        ValueError
            The columns do not make a table of `schema`: a mistake of the calling code.
        """
        table = build_table(columns, schema)
        data, sha256 = encode_hashed(table, None if note is None else note.dump())
        self._put_table(self.block_path(index), data, table.num_rows)
        return receipt_of(data, sha256, table.column("status"))

    def rewrite_block(self, index: int, table: pa.Table, note: Note | None = None) -> Receipt:
        """Put `table` in the place of block `index`, as `write_block`."""
        columns = {name: table.column(name) for name in table.schema.names}
        return self.write_block(index, columns, table.schema, note)

    def inspect_block(self, index: int) -> BlockFile:
        """Block `index`, proved undamaged to the bit; errors as for `read_block_file`."""
        return read_block_file(self.block_path(index), self.rows)

    def glance(self, index: int) -> tuple[Note | None, bool]:
        """The note of block `index`, and whether it is complete; unproved, but soon known."""
        with self._streamed(index) as file:
            note = Note.load(file)
            return note, note is None or note.is_whole(file.metadata.num_rows)

    def is_complete(self, index: int) -> bool:
        """Whether block `index` is there with all its rows, by its own account."""
        try:
            return self.glance(index)[1]
        except OutputError:
            return False

    def read_block(self, index: int, columns: Sequence[str] | None = None) -> pa.Table:
        """Read a block, having proved that it is whole."""
        path = self.block_path(index)
        try:
            return self.inspect_block(index).table(columns)
        except DamagedError as error:
            if isinstance(error.__cause__, OSError):
                raise OutputError(f"cannot read {path}: {error}") from error
            raise OutputError(f"{path} is damaged: {error}") from error

    def iter_blocks(self, columns: Sequence[str] | None = None) -> Iterator[tuple[int, pa.Table]]:
        """Yield (number, table) of the blocks in place, in order; errors as for `read_block`."""
        for index in self.block_indices():
            yield index, self.read_block(index, columns)

    def iter_batches(
        self, columns: Sequence[str] | None = None, *, complete: bool = False
    ) -> Iterator[pa.RecordBatch]:
        """Yield all rows in order, in pieces of bounded size, reading only these columns.

        With `complete`, blocks of which a stopped session has left only a part are left out.

        Page checksums are verified; the seal of the whole file, which takes a read of all of
        it, is not.
        """
        for index in self.block_indices():
            with self._streamed(index) as file:
                note = Note.load(file)
                if complete and note and not note.is_whole(file.metadata.num_rows):
                    continue
                if absent := sorted(set(columns or ()).difference(file.schema_arrow.names)):
                    raise OutputError(f"{self.block_path(index)} has no column {', '.join(absent)}")
                # One row group at a time: ParquetFile.iter_batches holds a whole block.
                for group in range(file.num_row_groups):
                    yield from file.read_row_group(group, columns and list(columns)).to_batches()

    @contextlib.contextmanager
    def _streamed(self, index: int) -> Iterator[pq.ParquetFile]:
        """A block's file to read parts of, of which the pages alone are proved."""
        path = self.block_path(index)
        try:
            if not stat.S_ISREG(os.stat(path).st_mode):
                raise NotAFile("it is no regular file")
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                yield file
        except (pa.ArrowException, OSError) as error:
            # Arrow's own are without a number.
            if isinstance(error, OSError) and (error.errno or isinstance(error, NotAFile)):
                raise OutputError(f"cannot read {path}: {reason(error)}") from error
            raise OutputError(f"{path} is damaged: {reason(error)}") from error

    # -------------------------------------------------- summary and manifest

    def write_summary(self, table: pa.Table) -> None:
        """Write `summary.parquet`, as safely as a block."""
        self._put_table(self.summary_path, encode(table), table.num_rows)

    def read_summary(self) -> pa.Table:
        """Read `summary.parquet`."""
        try:
            table = open_sealed(read_file(self.summary_path, MOST_BYTES)).read()
        except OSError as error:
            raise OutputError(f"cannot read {self.summary_path}: {reason(error)}") from error
        except (DamagedError, pa.ArrowException) as error:
            raise OutputError(f"{self.summary_path} is damaged: {error}") from error
        return table.replace_schema_metadata(None)

    def has_manifest(self) -> bool:
        """Whether there is a `manifest.json`, damaged or not."""
        try:
            return self.manifest_path.exists()
        except OSError as error:
            raise OutputError(f"cannot read {self.manifest_path}: {reason(error)}") from error

    def read_manifest(self) -> Manifest:
        """Read `manifest.json`, proved whole and checked part by part.

        Raises
        ------
        ConfigError
            There is none, so this is no output directory, or it is of another format.
        DamagedManifest
            It is not what `write_manifest` writes, or says what cannot be.
        OutputError
            It cannot be read.
        """
        try:
            manifest = Manifest.parse(sealed.load(read_file(self.manifest_path, MOST_BYTES)))
        except (FileNotFoundError, NotADirectoryError):
            raise ConfigError(
                f"{self.directory} is not an output directory: it has no manifest.json"
            ) from None
        except ConfigError as error:
            raise ConfigError(f"{self.directory}: {error}") from None
        except (NotAFile, ValueError) as error:
            raise DamagedManifest(f"{self.manifest_path} is damaged: {error}") from error
        except OSError as error:
            raise OutputError(f"cannot read {self.manifest_path}: {reason(error)}") from error
        self.rows = manifest.config.block_size
        return manifest

    def write_manifest(self, manifest: Manifest) -> None:
        """Write `manifest.json`, as safely as a block."""
        self._put(self.manifest_path, sealed.dump(manifest.dump()))

    def update_manifest(
        self, change: Callable[[Manifest], None], blank: Callable[[], Manifest] | None = None
    ) -> None:
        """Change `manifest.json` in one step that no other process can come between.

        Parameters
        ----------
        change
            Called with the manifest as it is now.
        blank
            Makes the one to begin with where there is none.
        """
        self._check_in_place()
        with manifest_lock(self.directory):
            begin = blank is not None and not self.has_manifest()
            manifest = blank() if blank is not None and begin else self.read_manifest()
            change(manifest)
            self.write_manifest(manifest)

    def _put_table(self, path: Path, data: bytes, rows: int) -> None:
        def reads_back(temporary: Path) -> None:
            try:
                with pq.ParquetFile(temporary) as file:
                    found = file.metadata.num_rows
            except pa.ArrowException as error:
                raise OSError(errno.EIO, f"does not read back: {reason(error)}") from error
            if found != rows:
                raise OSError(errno.EIO, f"reads back {found} of {rows} rows")

        self._put(path, data, reads_back)

    def _put(
        self, path: Path, data: bytes, check: Callable[[Path], None] = lambda temporary: None
    ) -> None:
        def checked(temporary: Path) -> None:
            check(temporary)
            # Now that the temporary file is there: after a move from here on, the rename finds
            # nothing to rename.
            self._check_in_place()

        self._check_in_place()
        try:
            replace_file(path, data, checked)
        except OutputError:
            self._check_in_place()  # which says why a file was not found
            raise
