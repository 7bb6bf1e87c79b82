"""Any runs of a sweep once more, and how they compare with the stored ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.blocks.block import finish_block, prepare_runs
from rattlesweep.sweeps.tables.arrow import ContentHash, build_table

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.sweeps.store.stored import Stored

# Runs that are integrated at a time.
AT_ONCE = 10_000


def differing_rows(
    stored: Stored, numbers: NDArray[np.int64], threads: int | None = None
) -> Iterator[tuple[int, int, list[str]]]:
    """Integrate stored runs again, given by their places, ascending; their blocks are in place.

    Yields
    ------
    case, sample : int
        Of a run that differs in any bit.
    columns : list of str
        Names of the columns that do.
    """
    plan = stored.plan
    for start in range(0, len(numbers), AT_ONCE):
        part = numbers[start : start + AT_ONCE]
        block = np.array([plan.block_of(place) for place in part.tolist()])
        row = part - np.array([plan.block(index).first for index in block.tolist()])
        found = pa.concat_tables(
            stored.store.read_block(int(index)).table().take(pa.array(row[block == index]))
            for index in np.unique(block)
        )
        case, sample = plan.runs_at(part)
        launches, batch = prepare_runs(plan, case, sample)
        task: Task[Mapping[str, Any]] = Task(
            lambda control, launches=launches, batch=batch: finish_block(  # type: ignore[misc]
                plan.config, launches, batch, threads=threads, control=control
            )
        )
        again = build_table(task.wait(), found.schema)
        if _same_bits(again, found):
            continue
        for k in range(len(part)):
            one, other = again.slice(k, 1), found.slice(k, 1)
            names = [n for n in found.schema.names if not _same_bits(one, other, [n])]
            if names:
                yield int(case[k]), int(sample[k]), names


def _same_bits(one: pa.Table, other: pa.Table, columns: list[str] | None = None) -> bool:
    """Equality that tells zeros of different sign apart."""
    digests = set()
    for table in (one, other):
        digest = ContentHash(table.schema if columns is None else table.select(columns).schema)
        digest.update(table)
        digests.add(digest.hexdigest())
    return len(digests) == 1
