"""Runs integrated into memory: all of a plan, or stored ones once more, to be compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Integers
from rattlesweep.integrate.batch import Control
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import finish_block, load_kernel, prepare_runs
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.arrow import ContentHash, build_table

if TYPE_CHECKING:
    from rattlesweep.sweeps.old.stored import Stored

# Runs that are prepared and integrated at a time: 100 MB, and some seconds of a kernel.
AT_ONCE = 100_000
# And of those that are compared, of whose blocks each is read for it.
COMPARED_AT_ONCE = 10_000


def integrate_runs(
    plan: Plan,
    case: Integers,
    sample: Integers,
    schema: pa.Schema,
    threads: int | None = None,
    tick: Callable[[Control], None] = lambda control: None,
) -> pa.Table:
    """Rows of some runs; `tick` is called some twenty times a second, and what it raises stops."""
    launches, batch = prepare_runs(plan, case, sample)
    task: Task[Mapping[str, Any]] = Task(
        lambda control: finish_block(plan.config, launches, batch, threads=threads, control=control)
    )
    return build_table(task.wait(tick), schema)


def integrate_plan(
    plan: Plan,
    threads: int | None = None,
    report: Callable[[float], None] = lambda fraction: None,
) -> pa.Table:
    """Rows of ``runs``, as the blocks of a sweep of this plan would hold them.

    `report` is called some twenty times a second with the share that is done; what it raises stops
    the kernel, and so does Ctrl-C.
    """
    load_kernel(plan.config)
    tables = [plan.schema.empty_table()]
    for start in range(0, plan.runs, AT_ONCE):
        places = np.arange(start, min(start + AT_ONCE, plan.runs))

        def tick(control: Control, start: int = start, runs: int = len(places)) -> None:
            share = control.done / control.total if control.total > 0 else 0.0
            report((start + runs * min(1.0, share)) / plan.runs)

        case, sample = plan.runs_at(places)
        tables.append(integrate_runs(plan, case, sample, plan.schema, threads, tick))
    report(1.0)
    return pa.concat_tables(tables)


def differing_rows(
    stored: Stored, numbers: Integers, threads: int | None = None
) -> Iterator[tuple[int, int, list[str]]]:
    """Integrate stored runs again, given by their places, ascending; their blocks are in place.

    Yields case and sample of each run that differs in any bit, and the names of the columns that
    do.
    """
    plan = stored.plan
    for start in range(0, len(numbers), COMPARED_AT_ONCE):
        part = numbers[start : start + COMPARED_AT_ONCE]
        block = np.array([plan.block_of(place) for place in part.tolist()])
        row = part - np.array([plan.block(index).first for index in block.tolist()])
        found = pa.concat_tables(
            stored.store.read_block(int(index)).table().take(pa.array(row[block == index]))
            for index in np.unique(block)
        )
        case, sample = plan.runs_at(part)
        again = integrate_runs(plan, case, sample, found.schema, threads)
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
