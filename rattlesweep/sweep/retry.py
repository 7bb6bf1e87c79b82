"""Do runs again that failed, under a limit of steps that may have grown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.sweep.blocks import Interrupted
from rattlesweep.sweep.local import load_kernel
from rattlesweep.sweep.recompute import compute_rows
from rattlesweep.sweep.tables import build_table
from rattlesweep.sweep.task import Task

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from rattlesweep.sweep.engine import Job


def retry_blocks(job: Job) -> None:
    """Do the failed runs of the session's blocks again, block by block."""
    session = job.session
    if not session.retry:
        return
    load_kernel(job)
    session.forget(session.retry)
    for index in session.retry:
        table = session.store.read_block(index)
        failed = pc.not_equal(table.column("status"), "ok")
        rows = table.filter(failed)
        case = rows.column("case").to_numpy().astype(np.int64)
        sample = rows.column("sample").to_numpy()
        task: Task[Mapping[str, Any]] = Task(
            lambda control, case=case, sample=sample: compute_rows(  # type: ignore[misc]
                session.plan, case, sample, job.threads, control
            )
        )
        try:
            columns = task.wait(lambda control: job.tick())
        except Interrupted:
            raise KeyboardInterrupt from None
        again = build_table(columns, table.schema)
        merged = pa.concat_tables([table.filter(pc.invert(failed)), again])
        order = pc.sort_indices(merged, [("case", "ascending"), ("sample", "ascending")])
        note = session.opened.note(session.plan.block(index))
        session.wrote(index, session.store.rewrite_block(index, merged.take(order), note))
        job.report.retried += rows.num_rows
