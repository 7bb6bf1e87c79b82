"""Runs that are stored twice: equal rows can be told from others, and dropped."""

from pathlib import Path

import numpy as np
import pyarrow as pa

from rattlesweep.store.parquet import read_parquet
from rattlesweep.store.rows import (
    TYPED,
    Stored,
    in_order,
    keys_of,
    metadata,
    refuse_again,
    rewrite,
    same_bits,
)
from rattlesweep.words.errors import OutputError


class Copies:
    """Runs of further files that a directory has already, in files of other rows.

    Sources whose small files have been merged have the rows of before in new files.
    """

    def __init__(self, stored: Stored) -> None:
        self.partial: list[Path] = []  # files with such runs
        self._stored = stored
        self.files = {path: place for place, path in enumerate(stored.files())}
        # Of each run, the place of its first file among these, or -1.
        self._place = np.full(stored.shape, -1, np.int32)

    def see(self, path: Path, rows: pa.Table) -> None:
        """Note the rows of a file of the directory."""
        if path in self.files:
            case, sample = keys_of(rows)
            is_first = self._place[case, sample] < 0
            self._place[case[is_first], sample[is_first]] = self.files[path]

    def note(self, path: Path, rows: pa.Table) -> None:
        """Note a further file with rows that are there; refuse those of another."""
        if path in self.files or (self._place[keys_of(rows)] < 0).any():
            refuse_again(path, rows)
        self.partial.append(path)

    def note_own(self, path: Path, rows: pa.Table) -> None:
        """Note a file of the directory with rows that an earlier one has."""
        self.partial.append(path)

    def check(self, path: Path) -> None:
        """Raise an OutputError if a row of a file has other values where it is."""
        rows = in_order(read_parquet(path))
        place = self._place[keys_of(rows)]
        own = self.files.get(path, -1)
        files = list(self.files)
        for index in np.unique(place[(place >= 0) & (place != own)]):
            twin = files[index]
            copies = rows.filter(place == index)
            is_copy = np.zeros(self._stored.shape, bool)
            is_copy[keys_of(copies)] = True
            twins = in_order(read_parquet(twin))
            if not same_bits(copies, twins.filter(is_copy[keys_of(twins)])):
                raise OutputError(
                    f"{path} and {twin} hold other values of the same runs; move one "
                    "away, or use another output"
                )

    def add_rest(self, path: Path) -> None:
        """Write the rows of a further file that are not there yet."""
        rows = read_parquet(path)
        rest = rows.filter(self._place[keys_of(rows)] < 0)
        if len(rest):
            typed = metadata(rows).get(TYPED, "")
            self._stored.append(rest.replace_schema_metadata(None), typed)

    def drop(self, path: Path) -> None:
        """Remove the rows of a file of the directory that an earlier one has."""
        rows = read_parquet(path)
        rest = rows.filter(self._place[keys_of(rows)] == self.files[path])
        rewrite(path, rest, metadata(rows).get(TYPED, ""))


def drop_copies(stored: Stored) -> int:
    """Remove rows that equal others of the same runs; return from how many files.

    Two processes write each run twice where they do not see each other's locks.  Rows
    of other values are refused, and then nothing is removed.
    """
    copies = Copies(stored)
    stored.find(list(copies.files), copies.see, copies.note_own)
    for path in copies.partial:
        copies.check(path)
    for path in copies.partial:
        copies.drop(path)
    return len(copies.partial)
