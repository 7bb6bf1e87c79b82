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


def content_hash(directory: Path | str | Store) -> str:
    """SHA-256 of all rows in order of (case, sample), however they are cut into blocks.

    Column by column in the order of the schema, raw bits: two sweeps have equal hashes when
    every value of every run is equal to the last bit. Memory does not grow with the rows.
    """
    store = directory if isinstance(directory, Store) else Store(directory)
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
