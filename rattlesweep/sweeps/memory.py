"""Runs in memory: all of a plan, or stored ones once more, to be compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pyarrow as pa

from rattlesweep.integrate.batch import Control
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import compute, load_kernel, prepare_runs
from rattlesweep.sweeps.plan import Plan

AT_ONCE = 100_000
"""Runs that are prepared and integrated at a time: 100 MB, and some seconds of a kernel."""


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

        prepared = prepare_runs(plan, *np.divmod(places, plan.samples))
        task = Task(partial(compute, plan.config, plan.schema, prepared, threads))
        tables.append(task.wait(tick)[0])
    report(1.0)
    return pa.concat_tables(tables)


def differing_rows(
    plan: Plan, rows: pa.Table, threads: int | None = None
) -> Iterator[tuple[int, int, list[str]]]:
    """Integrate stored runs again, and yield case, sample and columns of those that differ."""
    rows = rows.select(plan.schema.names)
    case, sample = (rows.column(name).to_numpy().astype(np.int64) for name in ("case", "sample"))
    prepared = prepare_runs(plan, case, sample)
    again = Task(partial(compute, plan.config, plan.schema, prepared, threads)).wait()[0]
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
        a.equals(b) and _bits(a).equals(_bits(b))
        for a, b in zip(one.columns, other.columns, strict=True)
    )


def _bits(column: pa.ChunkedArray) -> pa.Array:
    """Return floating numbers as whole ones of the same bits, and others as they are."""
    values = column.combine_chunks()
    if pa.types.is_list(values.type):
        values = values.flatten()
    return values.view(pa.int64()) if pa.types.is_float64(values.type) else values
