"""The engine of one machine: block after block through the kernel.

The kernel runs in a thread of its own, without the interpreter's lock.  Meanwhile the main thread
writes the block before, prepares the one after, reports progress and hears Ctrl-C.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import pyarrow as pa

from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import Prepared, compute, load_kernel, prepare_runs
from rattlesweep.sweeps.job import Job, Keys, OutOfTime

GATHER = 2.0
"""Seconds for which a stop waits for the kernel and for the table of its rows."""


def local(job: Job, blocks: Iterator[Keys]) -> Iterator[pa.Table]:
    """Yield the rows of blocks as they come out of the kernel.

    Whatever stops it, a Ctrl-C, the end of the time or an exception thrown into it, it yields the
    rows of the runs that have ended before it ends.
    """
    plan = job.plan
    loading = Task(lambda _: load_kernel(plan.config))
    task: Task[tuple[pa.Table, int]] | None = None
    finished: pa.Table | None = None
    try:
        # Bodies are drawn while the kernel is loaded.
        ready = _prepare(job, blocks)
        job.load_seconds += loading.wait()
        job.begin()
        while ready is not None:
            keys, prepared = ready
            task = Task(partial(compute, plan.config, plan.schema, prepared, job.threads))
            if finished is not None:
                table, finished = finished, None
                yield table
            ready = _prepare(job, blocks)
            finished, _ = task.wait(partial(job.tick, keys))
            job.worked(keys, task.seconds)
            task = None
    except GeneratorExit:
        if task is not None:
            task.stop()
        raise
    except BaseException as error:
        if isinstance(error, Exception) and not isinstance(error, OutOfTime):
            if task is not None:
                task.stop()
            raise
        if finished is not None:
            yield finished
        if task is not None:
            yield from _ended(job, task)
        raise
    if finished is not None:
        yield finished


def _prepare(job: Job, blocks: Iterator[Keys]) -> tuple[Keys, Prepared] | None:
    """Return the keys of the next block and what the kernel needs for it; None behind the last."""
    keys = next(blocks, None)
    return None if keys is None else (keys, prepare_runs(job.plan, *keys))


def _ended(job: Job, task: Task[tuple[pa.Table, int]]) -> Iterator[pa.Table]:
    """Stop a block and yield the rows of its runs that have ended."""
    task.stop(patience=GATHER)
    try:
        table, lost = task.value()
    except TimeoutError:
        return
    job.lost += lost
    if len(table):
        yield table
