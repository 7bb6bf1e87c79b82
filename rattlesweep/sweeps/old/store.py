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
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.errors import ConfigError, DamagedError, OutputError
from rattlesweep.sweeps.old import sealed
from rattlesweep.sweeps.files import (
    NotAFile,
    explained,
    probe_directory,
    read_file,
    reason,
    remove_temporaries,
    rename_file,
    replace_file,
)
from rattlesweep.sweeps.old.blockfile import (
    MOST_BYTES,
    BlockFile,
    Note,
    block_name,
    block_number,
    read_block_file,
    reading,
    receipt_of,
    rows_of,
)
from rattlesweep.sweeps.old.locks import manifest_lock
from rattlesweep.sweeps.old.manifest import Manifest, Receipt
from rattlesweep.sweeps.arrow import encode_hashed, open_sealed, read_rows
from rattlesweep.sweeps.chaos import with_chaotic_field

# Seconds for which another process may have a half-written file in its hands.
YOUNG = 3600.0
# In every manifest, and in the footer of every table.
_MARKS = (b'"config_hash"', b"rattlesweep.sha256", b"rattlesweep.bodies")


class Store:
    """The files of one output directory, which need not exist until `prepare`."""

    def __init__(self, directory: Path | str) -> None:
        self.directory = Path(directory)
        self.runs = self.directory / "runs"
        self.manifest_path = self.directory / "manifest.json"
        self.summary_path = self.directory / "summary.parquet"
        self._opened = self._folders()

    def prepare(self) -> None:
        """Create the directories and try out that files can be written there."""
        self.check_ours()
        probe_directory(self.directory)
        probe_directory(self.runs)
        self._opened = self._folders()

    def check_ours(self) -> None:
        """Refuse a directory that holds something, but nothing of this program (ConfigError).

        Its files might be overwritten.
        """
        with explained(f"cannot read {self.directory}"):
            try:
                names = sorted(os.listdir(self.directory))
            except (FileNotFoundError, NotADirectoryError):
                return
        # Hidden files are not in the way, and among them is what a killed process leaves.
        shown = [name for name in names if not name.startswith(".") and name != "runs"]
        if not shown or self.block_indices():
            return
        for name in shown:
            if name == self.manifest_path.name or name.endswith(".parquet"):
                path = self.directory / name
                with explained(f"cannot read {path}"):
                    try:
                        data = read_file(path, MOST_BYTES)
                    except (NotAFile, FileNotFoundError):
                        continue
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
            with explained(f"cannot read {folder}"):
                try:
                    same = os.path.samestat(os.stat(folder), opened)
                except (FileNotFoundError, NotADirectoryError):
                    same = False
            if not same:
                raise OutputError(
                    f"{folder} has been moved, removed or replaced while it was in use; nothing "
                    "more is written there"
                )

    def remove_stale_temporaries(self, alone: bool) -> int:
        """Remove what killed processes left half-written; returns how many files.

        Unless `alone`, no other process being at work there, young ones may be in its hands.
        """
        age = 0.0 if alone else YOUNG
        return sum(remove_temporaries(folder, age) for folder in (self.directory, self.runs))

    # ------------------------------------------------------------------ blocks

    def block_path(self, index: int) -> Path:
        """Where block `index` has its place."""
        return self.runs / block_name(index)

    def block_indices(self) -> list[int]:
        """Numbers of the blocks in place, ascending; other files in `runs` are ignored."""
        numbers = map(block_number, self._names_in_runs())
        return sorted(number for number in numbers if number is not None)

    def strays(self, blocks: int) -> list[Path]:
        """Files that readers of ``runs/*.parquet`` take for runs, but none of so many blocks."""
        return [
            self.runs / name
            for name in sorted(self._names_in_runs())
            if name.endswith(".parquet") and not name.startswith(".")
            if (number := block_number(name)) is None or number >= blocks
        ]

    def _names_in_runs(self) -> list[str]:
        with explained(f"cannot read {self.runs}", folder=True):
            try:
                return os.listdir(self.runs)
            except FileNotFoundError:
                return []

    def put_in_place(self, path: Path, index: int) -> None:
        """Give a file the place of block `index`."""
        self._check_in_place()
        rename_file(path, self.block_path(index))

    def write_block(self, index: int, table: pa.Table, note: Note | None = None) -> Receipt:
        """Put `table` in the place of block `index`; if it fails, what was there still is."""
        data, sha256 = encode_hashed(table, None if note is None else note.dump())
        self._put(self.block_path(index), data, table.num_rows)
        return receipt_of(data, sha256, table)

    def read_block(self, index: int) -> BlockFile:
        """Block `index`, proved undamaged to the bit; errors as for `read_block_file`."""
        return read_block_file(self.block_path(index))

    def find_block(self, index: int, runs: tuple[str, int, int]) -> BlockFile | None:
        """Block `index`, if it is undamaged and holds these runs (`Note.runs`) or some of them."""
        try:
            found = self.read_block(index)
        except DamagedError:
            return None
        return found if found.note is not None and found.note.runs == runs else None

    def finished_block(self, index: int, note: Note) -> Receipt | None:
        """The receipt of block `index`, if it is whole and just what `note` speaks of."""
        found = self.find_block(index, note.runs)
        return found.receipt if found and found.note == note and found.complete else None

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

    def iter_batches(
        self, columns: Sequence[str] | None = None, *, complete: bool = False
    ) -> Iterator[pa.RecordBatch]:
        """Yield all rows in order, in pieces of bounded size, reading only these columns.

        With `complete`, blocks of which a stopped session has left only a part are left out. Page
        checksums are verified; the seal of the whole file, which takes a read of all of it, is not.
        """
        for index in self.block_indices():
            with self._streamed(index) as file:
                note = Note.load(file)
                if complete and note and not note.is_whole(file.metadata.num_rows):
                    continue
                schema = file.schema_arrow
                if absent := sorted(
                    set(columns or ()).difference(with_chaotic_field(schema).names)
                ):
                    raise OutputError(f"{self.block_path(index)} has no column {', '.join(absent)}")
                # One row group at a time: ParquetFile.iter_batches holds a whole block.
                for group in range(file.num_row_groups):
                    read = partial(file.read_row_group, group)
                    yield from rows_of(schema, columns or None, read).to_batches()

    @contextlib.contextmanager
    def _streamed(self, index: int) -> Iterator[pq.ParquetFile]:
        """A block's file to read parts of, of which the pages alone are proved."""
        path = self.block_path(index)
        with reading(path):
            if not stat.S_ISREG(os.stat(path).st_mode):
                raise NotAFile("it is no regular file")
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                yield file

    # -------------------------------------------------- summary and manifest

    def write_summary(self, table: pa.Table) -> None:
        """Write `summary.parquet`, as safely as a block."""
        self._put(self.summary_path, encode_hashed(table)[0], table.num_rows)

    def read_summary(self) -> pa.Table:
        """Read `summary.parquet`."""
        with reading(self.summary_path):
            return read_rows(open_sealed(read_file(self.summary_path, MOST_BYTES)))

    def has_manifest(self) -> bool:
        """Whether there is a `manifest.json`, damaged or not."""
        with explained(f"cannot read {self.manifest_path}"):
            return self.manifest_path.exists()

    def read_manifest(self) -> Manifest:
        """Read `manifest.json`, proved whole and checked part by part, or else a DamagedError.

        Where there is none, so that this is no output directory, or one of another format, it is a
        ConfigError.
        """
        if not self.has_manifest():
            raise ConfigError(
                f"{self.directory} is not an output directory: it has no manifest.json"
            )
        try:
            with reading(self.manifest_path):
                return Manifest.parse(sealed.load(read_file(self.manifest_path, MOST_BYTES)))
        except ConfigError as error:
            raise ConfigError(f"{self.directory}: {error}") from None

    def write_manifest(self, manifest: Manifest) -> None:
        """Write `manifest.json`, as safely as a block."""
        self._put(self.manifest_path, sealed.dump(manifest.dump()))

    def update_manifest(
        self, change: Callable[[Manifest], None], blank: Callable[[], Manifest] | None = None
    ) -> None:
        """Change `manifest.json` in one step that no other process can come between.

        `change` is called with the manifest as it is now; `blank` makes the one to begin with where
        there is none that is whole.
        """
        self._check_in_place()
        with manifest_lock(self.directory):
            try:
                begin = blank is not None and not self.has_manifest()
                manifest = blank() if blank is not None and begin else self.read_manifest()
            except DamagedError:
                if blank is None:
                    raise
                manifest = blank()
            change(manifest)
            self.write_manifest(manifest)

    def _put(self, path: Path, data: bytes, rows: int | None = None) -> None:
        """Write a file; one of a table, of so many `rows`, is read back."""

        def check(temporary: Path) -> None:
            if rows is not None:
                _check_rows(temporary, rows)
            # Now that the temporary file is there: after a move from here on, the rename finds
            # nothing to rename.
            self._check_in_place()

        self._check_in_place()
        try:
            replace_file(path, data, check)
        except OutputError:
            self._check_in_place()  # which says why a file was not found
            raise


def _check_rows(path: Path, rows: int) -> None:
    """Refuse a file that has not come onto the disk as it was written."""
    try:
        with pq.ParquetFile(path) as file:
            found = file.metadata.num_rows
    except pa.ArrowException as error:
        raise OSError(errno.EIO, f"does not read back: {reason(error)}") from error
    if found != rows:
        raise OSError(errno.EIO, f"reads back {found} of {rows} rows")
