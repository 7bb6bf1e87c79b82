"""Runs in memory: all of a plan, or stored ones once more, to be compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.arrays import Integers
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

    `report` is called some twenty times a second with the share that is done; what it raises stops
    the kernel, and so does Ctrl-C.
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
    """Integrate stored runs again.

    Yields
    ------
    case, sample : int
        A run that differs in any bit.
    names : list of str
        Columns that do.
    """
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
    if one.schema.names != other.schema.names or len(one) != len(other):
        return False
    return all(
        _same_array(a.combine_chunks(), b.combine_chunks())
        for a, b in zip(one.columns, other.columns, strict=True)
    )


def _same_array(a: pa.Array, b: pa.Array) -> bool:
    if not a.equals(b):
        return False
    if pa.types.is_list(a.type):
        a, b = a.flatten(), b.flatten()
    if not pa.types.is_floating(a.type):
        return True
    x, y = (pc.fill_null(v, 0.0).to_numpy(zero_copy_only=False) for v in (a, b))
    return bool(np.array_equal(np.signbit(x), np.signbit(y)))
