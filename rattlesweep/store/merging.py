"""Few large files of rows instead of many small ones.

While a session writes, its newest file grows: the file with the new rows takes the
place of the one without them in one step.  So a row stays in its file, and whoever
lists the files and then reads them finds each row once.

What many short sessions leave is merged when the next one begins:

1. The merged file is written to the folder ``merging``, whole or not at all. From then
   on it stands for its sources, whose names and checksums are in its metadata.
2. The sources are removed.
3. The merged file is renamed into ``runs``, to a name that no source had.

Whoever opens the directory applies this rule, and the next writer finishes what a kill
has left.  Other programs, which know only ``runs``, may find a file gone that they have
listed, or miss its rows between the second step and the third, but find none twice.
"""

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Flags, Integers
from rattlesweep.store.rows import (
    KEY,
    SWEEP,
    TYPED,
    Found,
    Stored,
    checksum,
    in_order,
    keys_of,
    metadata,
    replaced_by,
)
from rattlesweep.system.files import check_place, explained, sync_folder
from rattlesweep.words.errors import DamagedError, GoneError, OutputError

# Bytes in memory from which on a file is large: about 30,000 rows, 5 MB on disk.
FILE_BYTES = 1 << 23
MANY_FILES = 16  # small files that are merged when a session begins

# Which runs, by case and sample, are those of the session, so that no other process
# writes or moves their rows.
Mine = Callable[[Integers, Integers], Flags]


def all_runs(case: Integers, sample: Integers) -> Flags:
    """Return that all runs are those of a session that holds a whole directory."""
    return np.ones(len(case), bool)


class Writer:
    """Writes the rows of a session to disk, until they are many to one file."""

    def __init__(self, stored: Stored, typed: str) -> None:
        self._stored = stored
        self._typed = typed
        self._path: Path | None = None  # of the newest file, while it is small
        self._rows: pa.Table | None = None  # its rows

    def write(self, table: pa.Table) -> None:
        """Write rows, none of which is on disk."""
        rows = table.replace_schema_metadata(None)
        path = self._path
        if path is not None and self._rows is not None:
            joined = in_order(pa.concat_tables([self._rows, rows]))
            try:
                self._stored.write(path, joined, self._typed)
                rows = joined
            except OutputError as error:
                # Windows replaces no file that another program has open.
                if not isinstance(error.__cause__, PermissionError):
                    raise
                path = None
        if path is None:
            path = self._stored.append(rows, self._typed)
        self._path = None
        if rows.nbytes < FILE_BYTES:
            self._path = path
            self._rows = rows


def find_merged(stored: Stored, mine: Mine) -> Found:
    """Return what is on disk, where the many small files of some runs are merged."""
    _finish(stored, mine)
    if not _can_rename(stored):
        return stored.find()

    def look(files: list[Path]) -> Found:
        small = 0
        for path in files:
            with explained(f"cannot read {path}"), suppress(FileNotFoundError):
                small += path.stat().st_size < FILE_BYTES
        if small < MANY_FILES:
            return stored.find(files)
        merging = _Merging(stored, mine)
        found = stored.find(files, merging.see)
        merging.end()
        found.typed = merging.typed
        return found

    return stored.steadily(look)


def _can_rename(stored: Stored) -> bool:
    """Return whether a file can move into the folder of rows in one step.

    This folder may be a mount or a link, which leads to another file system.
    """
    if stored.folder.is_symlink():
        return False
    with suppress(OSError):
        return stored.folder.stat().st_dev == stored.directory.stat().st_dev
    return False


class _Merging:
    """Merges small files as they are read, neighbours in the order of their names."""

    def __init__(self, stored: Stored, mine: Mine) -> None:
        self.typed: dict[str, list[Path]] = {}  # files by thresholds
        self._stored = stored
        self._mine = mine
        # By thresholds, the files that are to become one, and their rows.
        self._groups: dict[str, dict[Path, pa.Table]] = {}

    def see(self, path: Path, rows: pa.Table) -> None:
        """Take a file and its rows."""
        typed = metadata(rows).get(TYPED, "")
        is_mine = (
            path.parent == self._stored.folder and self._mine(*keys_of(rows)).all()
        )
        if rows.nbytes >= FILE_BYTES or not is_mine:
            self.typed.setdefault(typed, []).append(path)
            return
        group = self._groups.setdefault(typed, {})
        group[path] = rows.replace_schema_metadata(None)
        if sum(rows.nbytes for rows in group.values()) >= FILE_BYTES:
            self._merge(typed)

    def end(self) -> None:
        """Merge the rest."""
        for typed in list(self._groups):
            self._merge(typed)

    def _merge(self, typed: str) -> None:
        group = self._groups.pop(typed)
        files = self.typed.setdefault(typed, [])
        if len(group) == 1:
            files += group
            return
        stored = self._stored
        rows = in_order(pa.concat_tables(group.values()))
        replaces = {path.name: checksum(path) for path in group}
        with explained(f"cannot write in {stored.directory}"):
            stored.merging.mkdir(exist_ok=True)
        target = stored.new_path(rows)
        merged = stored.merging / target.name
        stored.write(merged, rows, typed, json.dumps(replaces), new=True)
        _take_place(stored, merged, list(group))
        files.append(target)


def _finish(stored: Stored, mine: Mine) -> None:
    """Finish the merges of some runs that a kill has interrupted."""
    for merged in stored.files():
        if merged.parent != stored.merging:
            continue
        # A damaged file is found again, and set aside.  One that is gone was the merge
        # of another shard, which has finished it.
        with suppress(DamagedError, GoneError):
            rows = stored.rows_of(merged)
            if metadata(rows).get(SWEEP) != stored.hash:
                continue
            if mine(*keys_of(rows.select(KEY))).all():
                present = {path.name: path for path in stored.folder.iterdir()}
                names = replaced_by(merged, present)
                _take_place(stored, merged, [present[name] for name in names])


def _take_place(stored: Stored, merged: Path, sources: list[Path]) -> None:
    """Replace files of rows by the merged one."""
    # Names of files are never used again, so this may be late and harms no other.
    check_place(stored.folder)
    with explained(f"cannot merge files of {stored.folder}"):
        for path in sources:
            path.unlink(missing_ok=True)
        # After a power failure, too, the sources are gone before the rename.
        sync_folder(stored.folder)
        # A name that a source had would give a slow reader its rows twice.
        merged.rename(stored.folder / merged.name)
