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

    from rattlesweep.integrate.batch import Control
    from rattlesweep.sweeps.cases.plan import Plan
    from rattlesweep.sweeps.store.stored import Stored

# Runs that are integrated at a time.
AT_ONCE = 10_000


def compute_rows(
    plan: Plan,
    case: NDArray[np.int64],
    sample: NDArray[np.int64],
    threads: int | None = None,
    control: Control | None = None,
) -> Mapping[str, Any]:
    """Columns of any runs of a plan, given by (case, sample) in order: the bits of the sweep's.

    Raises
    ------
    Interrupted
        If ``control`` asked the kernel to stop.
    """
    launches, batch = prepare_runs(plan, case, sample)
    return finish_block(plan.config, launches, batch, threads=threads, control=control)


def differing_rows(
    stored: Stored, numbers: NDArray[np.int64], threads: int | None = None
) -> Iterator[tuple[int, int, list[str]]]:
    """Integrate stored runs again.

    Parameters
    ----------
    numbers : ndarray of int64
        Run numbers, ascending; their blocks must be in place.

    Yields
    ------
    case, sample : int
        Of a run that differs in any bit.
    columns : list of str
        Names of the columns that do.
    """
    plan = stored.plan
    size = plan.block_size
    for start in range(0, len(numbers), AT_ONCE):
        part = numbers[start : start + AT_ONCE]
        case, sample = np.divmod(part, plan.samples)
        pieces = []
        for index in np.unique(part // size):
            rows = part[part // size == index] - index * size
            pieces.append(stored.store.read_block(int(index)).take(pa.array(rows)))
        found = pa.concat_tables(pieces)
        task: Task[Mapping[str, Any]] = Task(
            lambda control, case=case, sample=sample: compute_rows(  # type: ignore[misc]
                plan, case, sample, threads, control
            )
        )
        again = build_table(task.wait(), found.schema)
        if again.equals(found) and _same_bits(again, found):
            continue
        for row in range(len(part)):
            one, other = again.slice(row, 1), found.slice(row, 1)
            names = [
                name
                for name in found.schema.names
                if not _same_bits(one.select([name]), other.select([name]))
            ]
            if names:
                yield int(case[row]), int(sample[row]), names


def _same_bits(one: pa.Table, other: pa.Table) -> bool:
    """Equality that tells zeros of different sign apart."""
    digests = []
    for table in (one, other):
        digest = ContentHash(table.schema)
        digest.update(table)
        digests.append(digest.hexdigest())
    return digests[0] == digests[1]
