"""All runs of a plan, integrated into memory: no directory, nothing to resume."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.blocks.block import finish_block, load_kernel, prepare_runs
from rattlesweep.sweeps.tables.arrow import build_table

if TYPE_CHECKING:
    from rattlesweep.integrate.batch import Control
    from rattlesweep.sweeps.cases.plan import Plan

# Runs that are prepared and integrated at a time: 100 MB, and some seconds of a kernel.
AT_ONCE = 100_000


def integrate_plan(
    plan: Plan,
    threads: int | None = None,
    report: Callable[[float], None] = lambda fraction: None,
) -> pa.Table:
    """Rows of ``runs``, as the blocks of a sweep of this plan would hold them.

    Parameters
    ----------
    plan : Plan
    threads : int, optional
        Threads of the kernel; by default all there are.
    report : callable
        Called some twenty times a second with the share that is done; what it raises stops the
        kernel, and so does Ctrl-C.
    """
    config, total = plan.config, plan.runs
    schema = plan.schema
    load_kernel(config)
    tables = [schema.empty_table()]
    for start in range(0, total, AT_ONCE):
        case, sample = np.divmod(np.arange(start, min(start + AT_ONCE, total)), plan.samples)
        launches, batch = prepare_runs(plan, case, sample)
        task: Task[Mapping[str, Any]] = Task(
            lambda control, launches=launches, batch=batch: finish_block(  # type: ignore[misc]
                config, launches, batch, threads=threads, control=control
            )
        )

        def tick(control: Control, start: int = start, runs: int = len(case)) -> None:
            share = control.done / control.total if control.total > 0 else 0.0
            report((start + runs * min(1.0, share)) / total)

        tables.append(build_table(task.wait(tick), schema))
    report(1.0)
    return pa.concat_tables(tables)
