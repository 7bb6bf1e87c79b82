"""All rows of a directory as one number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import OutputError
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.arrow import ContentHash, same_schema


class RowsHash:
    """SHA-256 of all rows in order of (case, sample), however they are cut into blocks.

    Those of a sweep in stages are in this order within each.

    Column by column in the order of the schema, raw bits: two sweeps have equal hashes when
    every value of every run is equal to the last bit. Memory does not grow with the rows.
    `where` is the directory of the runs, for complaints.
    """

    columns = None  # all of them

    def __init__(self, where: Path, stages: bool = False) -> None:
        self._where, self._stages = where, stages
        self._schema: pa.Schema | None = None
        self._digest = ContentHash(pa.schema([]))
        self._last = (-1, -1)

    def add(self, rows: pa.RecordBatch) -> None:
        """Take more rows: of the same columns as those before, in order, and each once."""
        if self._schema is None:
            self._schema = rows.schema
            self._digest = ContentHash(rows.schema)
        elif not same_schema(self._schema, rows.schema):
            raise OutputError(f"the blocks in {self._where} differ in their columns")
        if rows.num_rows and not self._stages:
            self._check_order(rows)
        self._digest.update(rows)

    def _check_order(self, rows: pa.RecordBatch) -> None:
        case, sample = (
            np.append(last, pc.fill_null(rows.column(name), -1).to_numpy(zero_copy_only=False))
            for name, last in zip(("case", "sample"), self._last, strict=True)
        )
        step = np.diff(case)
        if not np.all((step > 0) | ((step == 0) & (np.diff(sample) > 0))):
            raise OutputError(
                f"the rows in {self._where} are not in the order of (case, sample), each once"
            )
        self._last = int(case[-1]), int(sample[-1])

    def hexdigest(self) -> str:
        """The hash of all rows so far."""
        return self._digest.hexdigest()


def content_hash(directory: Path | str) -> str:
    """The `RowsHash` of a directory."""
    store = Store(directory)
    digest = RowsHash(store.runs, store.has_manifest() and bool(store.read_manifest().stages))
    for rows in store.iter_batches():
        digest.add(rows)
    return digest.hexdigest()
