"""One block's file: what it says of itself, and what it holds once that is proved undamaged.

A session that is stopped leaves the runs of its block that have ended in the block's own file: with
the same note, but fewer rows than that speaks of. `Note.is_whole` is what tells.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from rattlesweep.errors import OutputError
from rattlesweep.sweeps.config.load import resolved
from rattlesweep.sweeps.store.atomic import read_file, reason
from rattlesweep.sweeps.store.manifest import Manifest, Receipt
from rattlesweep.sweeps.tables.arrow import NOTE, DamagedError, open_hashed

MOST_ROWS = 200_000
"""Rows that a block can have."""
# Bytes that its file can have, for each row and for the rest.
_ROW, _REST = 1 << 14, 1 << 20


@dataclass(frozen=True)
class Note:
    """Written into a block's file: which runs of which sweep it is to hold.

    Attributes
    ----------
    sweep : str
        Hash of what determines the numbers (`provenance.identity`).
    first, stop : int
        Numbers of its runs, ``first <= run < stop``.
    classify : dict
        Thresholds behind its types.
    max_steps : int
        Limit under which its runs were done.
    """

    sweep: str
    first: int
    stop: int
    classify: dict[str, float]
    max_steps: int

    @classmethod
    def of(cls, manifest: Manifest, index: int) -> Note:
        """What block `index` of a directory with this manifest has to say."""
        config = manifest.config
        thresholds, limit = resolved(config)["classify"], config.integrator.max_steps
        return cls(manifest.config_hash, *manifest.borders(index), thresholds, limit)

    @classmethod
    def load(cls, file: pq.ParquetFile) -> Note | None:
        """From a file's metadata; None if there is none that makes sense."""
        try:
            return cls(**json.loads((file.schema_arrow.metadata or {}).get(NOTE, b"")))
        except (ValueError, TypeError):
            return None

    def dump(self) -> bytes:
        """As text for a file's metadata."""
        return json.dumps(asdict(self), sort_keys=True).encode()

    def same_runs(self, other: Note | None) -> bool:
        """Whether another block is to hold the same numbers, types and limit aside."""
        return other is not None and (self.sweep, self.first, self.stop) == (
            other.sweep,
            other.first,
            other.stop,
        )

    def is_whole(self, rows: int) -> bool:
        """Whether so many rows are all that it speaks of."""
        return rows >= self.stop - self.first


@dataclass(frozen=True)
class BlockFile:
    """A block's file, read once and undamaged to the bit; its bytes stay in memory with this.

    Attributes
    ----------
    note : Note or None
        None if the file is no block's.
    receipt : Receipt
        What the manifest keeps of it, but for the time it took.
    """

    note: Note | None
    receipt: Receipt
    _file: pq.ParquetFile

    @property
    def schema(self) -> pa.Schema:
        """Names, types and units of its columns."""
        return self._file.schema_arrow

    @property
    def complete(self) -> bool:
        """Whether it has all its rows."""
        return self.note is None or self.note.is_whole(self.receipt.rows)

    def table(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Its rows."""
        names = None if columns is None else list(columns)
        try:
            return self._file.read(columns=names).replace_schema_metadata(None)
        except (pa.ArrowException, OSError) as error:
            raise DamagedError(reason(error)) from error


def read_block_file(path: Path, rows: int = MOST_ROWS) -> BlockFile:
    """Read the file of a block of so many rows at most, by whatever name.

    Raises
    ------
    DamagedError
        It is not there, or not whole.
    OutputError
        It may not be read, which says nothing about what it holds.
    """
    try:
        data = read_file(path, _REST + rows * _ROW)
        file, sha256 = open_hashed(data)
        status = file.read(columns=["status"]).column("status")
    except PermissionError as error:
        raise OutputError(f"cannot read {path}: {reason(error)}") from error
    except OSError as error:
        raise DamagedError(reason(error)) from error
    except (pa.ArrowException, KeyError) as error:
        raise DamagedError(f"it has no status: {reason(error)}") from error
    return BlockFile(Note.load(file), receipt_of(data, sha256, status), file)


def receipt_of(data: bytes, sha256: str, status: pa.ChunkedArray) -> Receipt:
    """The receipt of a file of these bytes, whose runs have these words in `status`."""
    counts = pc.value_counts(status).to_pylist()
    failed = {str(each["values"]): each["counts"] for each in counts if each["values"] != "ok"}
    return Receipt(
        sha256=sha256, rows=len(status), bytes=len(data), failed=dict(sorted(failed.items()))
    )
