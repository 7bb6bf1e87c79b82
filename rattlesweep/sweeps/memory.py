"""Runs in memory: all of a plan, or stored ones once more, to be compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.arrays import Flags, Integers
from rattlesweep.integrate.batch import Control
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import compute, load_kernel, prepare_runs
from rattlesweep.sweeps.plan import Plan

AT_ONCE = 100_000
"""Runs that are prepared and integrated at a time: 100 MB, and some seconds of a kernel."""


def integrate_runs(
    plan: Plan,
    case: Integers,
    sample: Integers,
    threads: int | None = None,
    tick: Callable[[Control], None] = lambda control: None,
) -> pa.Table:
    """Return the rows of some runs.

    `tick` is called some twenty times a second, and what it raises stops the kernel.
    """
    prepared = prepare_runs(plan, case, sample)
    task = Task(partial(compute, plan.config, plan.schema, prepared, threads))
    return task.wait(tick)[0]


def integrate_plan(
    plan: Plan,
    threads: int | None = None,
    report: Callable[[float], None] = lambda fraction: None,
) -> pa.Table:
    """Return the rows of all runs of a plan, as the files of a sweep would hold them.

    `report` is called with the share that is done; what it raises stops the kernel, and so does
    Ctrl-C.
    """
    load_kernel(plan.config)
    tables = [plan.schema.remove_metadata().empty_table()]
    for start in range(0, plan.runs, AT_ONCE):
        places = np.arange(start, min(start + AT_ONCE, plan.runs))

        def tick(control: Control, start: int = start, runs: int = len(places)) -> None:
            share = control.done / control.total if control.total > 0 else 0.0
            report((start + runs * min(1.0, share)) / plan.runs)

        tables.append(integrate_runs(plan, *np.divmod(places, plan.samples), threads, tick))
    report(1.0)
    return pa.concat_tables(tables)


def differing_rows(
    plan: Plan, rows: pa.Table, threads: int | None = None
) -> Iterator[tuple[int, int, list[str]]]:
    """Integrate stored runs again, and yield case, sample and columns of those that differ."""
    rows = rows.select(plan.schema.names)
    case, sample = (rows.column(name).to_numpy().astype(np.int64) for name in ("case", "sample"))
    again = integrate_runs(plan, case, sample, threads)
    if same_bits(again, rows):
        return
    for k in range(len(rows)):
        one, other = again.slice(k, 1), rows.slice(k, 1)
        names = [n for n in rows.schema.names if not same_bits(one.select([n]), other.select([n]))]
        if names:
            yield int(case[k]), int(sample[k]), names


def same_bits(one: pa.Table, other: pa.Table) -> bool:
    """Return whether two tables hold the same values, zeros of different sign told apart."""
    return one.schema.names == other.schema.names and all(
        a.equals(b) and np.array_equal(_signs(a), _signs(b))
        for a, b in zip(one.columns, other.columns, strict=True)
    )


def _signs(column: pa.ChunkedArray) -> Flags:
    """Return which numbers of a column are below zero or its negative twin."""
    values = column.combine_chunks()
    if pa.types.is_list(values.type):
        values = values.flatten()
    if not pa.types.is_floating(values.type):
        return np.zeros(0, bool)
    signs: Flags = np.signbit(pc.fill_null(values, 0.0).to_numpy(zero_copy_only=False))
    return signs
