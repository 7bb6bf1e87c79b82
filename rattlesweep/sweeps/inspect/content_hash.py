"""All rows of a directory as one number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import OutputError
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.tables.arrow import ContentHash, same_schema


class RowsHash:
    """SHA-256 of all rows in order of (case, sample), however they are cut into blocks.

    Column by column in the order of the schema, raw bits: two sweeps have equal hashes when
    every value of every run is equal to the last bit. Memory does not grow with the rows.

    Parameters
    ----------
    where
        The directory of the runs, for complaints.
    """

    columns = None  # all of them

    def __init__(self, where: Path) -> None:
        self._where = where
        self._schema: pa.Schema | None = None
        self._digest = ContentHash(pa.schema([]))
        self._last = (-1, -1)

    def add(self, rows: pa.RecordBatch) -> None:
        """Take more rows.

        Raises
        ------
        OutputError
            They differ in their columns from those before, or are out of order or there twice.
        """
        if self._schema is None:
            self._schema = rows.schema
            self._digest = ContentHash(rows.schema)
        elif not same_schema(self._schema, rows.schema):
            raise OutputError(f"the blocks in {self._where} differ in their columns")
        self._last = _check_order(rows, self._last, self._where)
        self._digest.update(rows)

    def hexdigest(self) -> str:
        """The hash of all rows so far."""
        return self._digest.hexdigest()


def content_hash(directory: Path | str | Store) -> str:
    """The `RowsHash` of a directory.

    Raises
    ------
    OutputError
        A block is unreadable or damaged, blocks differ in their columns, or rows are out of
        order or there twice.
    """
    store = directory if isinstance(directory, Store) else Store(directory)
    digest = RowsHash(store.runs)
    for rows in store.iter_batches():
        digest.add(rows)
    return digest.hexdigest()


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
