"""One block's file: what it says of itself, and what it holds once that is proved undamaged.

A session that is stopped leaves the runs of its block that have ended in the block's own file: with
the same note, but fewer rows than that speaks of. `Note.is_whole` is what tells.
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from rattlesweep.arrays import Integers
from rattlesweep.errors import DamagedError, OutputError
from rattlesweep.sweeps.config.schema import Classify, Config
from rattlesweep.sweeps.files import read_file, reason
from rattlesweep.sweeps.old.manifest import Receipt
from rattlesweep.sweeps.arrow import NOTE, open_hashed, read_rows
from rattlesweep.sweeps.counts import is_sensitive
from rattlesweep.sweeps.chaos import (
    columns_to_read,
    lacks_chaotic,
    with_chaotic,
    with_chaotic_field,
)

COUNTED = ("status", "t_r", "t_r_error", "type_sure")
MOST_BYTES = 1 << 32
"""Bytes that a file in an output directory can have: 200,000 rows of 20 kB each."""
_BLOCK = re.compile(r"block-(\d{6,18})\.parquet")


def block_name(index: int) -> str:
    """Name of a block's file."""
    return f"block-{index:06d}.parquet"


def block_number(name: str) -> int | None:
    """Number of the block that has its place by this name."""
    match = _BLOCK.fullmatch(name)
    number = None if match is None else int(match[1])
    return number if number is not None and block_name(number) == name else None


@contextlib.contextmanager
def reading(path: Path, lost: type[OSError] | tuple[()] = ()) -> Iterator[None]:
    """Name a file that cannot be read (OutputError), or is not what was written (DamagedError).

    An error of the system of the type `lost` is damage too: what the file held is to be made anew.
    That it may not be read says nothing about what it holds.
    """
    try:
        yield
    except (DamagedError, pa.ArrowException, OSError) as error:
        # Without a number are our NotAFile, and what Arrow finds wrong.
        if not isinstance(error, OSError) or not error.errno:
            raise DamagedError(f"{path} is damaged: {reason(error)}") from error
        is_lost = isinstance(error, lost) and not isinstance(error, PermissionError)
        kind = DamagedError if is_lost else OutputError
        raise kind(f"cannot read {path}: {reason(error)}") from error


@dataclass(frozen=True)
class Note:
    """Written into a block's file: which runs of which sweep it is to hold."""

    sweep: str  # hash of what determines the numbers (`provenance.identity`)
    first: int  # places of its runs in the sweep, from and up to
    stop: int
    classify: dict[str, float]  # thresholds behind its types
    max_steps: int  # limit under which its runs were done

    @classmethod
    def of(cls, config: Config, sweep: str, borders: tuple[int, int]) -> Note:
        """What the block of these runs has to say."""
        return cls(sweep, *borders, config.classify.thresholds, config.integrator.max_steps)

    @classmethod
    def load(cls, file: pq.ParquetFile) -> Note | None:
        """From a file's metadata; None if there is none that makes sense."""
        try:
            note = json.loads((file.schema_arrow.metadata or {}).get(NOTE, b""))
            # A threshold younger than the file had its default.
            return cls(**note | {"classify": Classify().thresholds | note["classify"]})
        except (ValueError, TypeError, KeyError):
            return None

    def dump(self) -> bytes:
        """As text for a file's metadata."""
        return json.dumps(asdict(self), sort_keys=True).encode()

    @property
    def runs(self) -> tuple[str, int, int]:
        """Which runs it is to hold; their types and limit may be others."""
        return self.sweep, self.first, self.stop

    def is_whole(self, rows: int) -> bool:
        """Whether so many rows are all that it speaks of."""
        return rows >= self.stop - self.first


@dataclass(frozen=True)
class BlockFile:
    """A block's file, read once and undamaged to the bit; its bytes stay in memory with this."""

    path: Path
    note: Note | None  # None if the file is no block's
    receipt: Receipt  # what the manifest keeps of it, but for the time it took
    _file: pq.ParquetFile

    @property
    def schema(self) -> pa.Schema:
        """Names, types and units of its columns, with those that its rows tell."""
        return with_chaotic_field(self._file.schema_arrow)

    @property
    def lacks_columns(self) -> bool:
        """Whether it is of before a column that its rows tell, and that `table` adds."""
        return lacks_chaotic(self._file.schema_arrow)

    @property
    def complete(self) -> bool:
        """Whether it has all its rows."""
        return self.note is None or self.note.is_whole(self.receipt.rows)

    def table(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Its rows."""
        with reading(self.path):
            return rows_of(self._file.schema_arrow, columns, lambda n: read_rows(self._file, n))


def rows_of(
    schema: pa.Schema,
    columns: Sequence[str] | None,
    read: Callable[[list[str] | None], pa.Table],
) -> pa.Table:
    """Rows of a file of this schema with these columns, also those that its rows tell; None: all.

    `read` reads columns that the file has.
    """
    rows = with_chaotic(read(columns_to_read(columns, schema)))
    return rows if columns is None else rows.select(list(dict.fromkeys(columns)))


def numbers_of(rows: pa.Table, samples: int) -> Integers:
    """Numbers of runs in their sweep, which has so many samples of each case."""
    case, sample = (rows.column(key).to_numpy().astype(np.int64) for key in ("case", "sample"))
    numbers: Integers = case * samples + sample
    return numbers


def read_block_file(path: Path) -> BlockFile:
    """Read the file of a block, by whatever name; DamagedError if it is not there, or not whole.

    That it may not be read is another OutputError, and says nothing about what it holds.
    """
    with reading(path, lost=OSError):
        data = read_file(path, MOST_BYTES)
        file, sha256 = open_hashed(data)
        if "status" not in file.schema_arrow.names:
            raise DamagedError("it has no status")
        rows = read_rows(file, [n for n in COUNTED if n in file.schema_arrow.names])
    return BlockFile(path, Note.load(file), receipt_of(data, sha256, rows), file)


def receipt_of(data: bytes, sha256: str, rows: pa.Table) -> Receipt:
    """The receipt of a file of these bytes, which holds these rows, or their columns `COUNTED`."""
    counts = pc.value_counts(rows.column("status")).to_pylist()
    failed = {str(each["values"]): each["counts"] for each in counts if each["values"] != "ok"}
    sensitive = unsure = None
    if "t_r_error" in rows.schema.names:
        errors, times = (rows.column(name).to_numpy() for name in ("t_r_error", "t_r"))
        sensitive = int(is_sensitive(errors, times).sum())
        unsure = pc.sum(pc.invert(rows.column("type_sure")), min_count=0).as_py()
    return Receipt(
        sha256=sha256,
        rows=len(rows),
        bytes=len(data),
        failed=dict(sorted(failed.items())),
        sensitive=sensitive,
        unsure=unsure,
    )
