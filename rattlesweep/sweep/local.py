"""The engine of one machine: block after block through the kernel.

The kernel runs in a thread of its own, without the interpreter's lock. Meanwhile the main
thread writes the block before, prepares the one after, reports progress and hears Ctrl-C.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rattlesweep.integrate.kernels import kernel
from rattlesweep.sweep.blocks import Interrupted, finish_block, prepare_block
from rattlesweep.sweep.columns import runs_schema
from rattlesweep.sweep.task import Task

if TYPE_CHECKING:
    from rattlesweep.sweep.engine import Job
    from rattlesweep.sweep.plan import Block
    from rattlesweep.sweep.receipts import Receipt
    from rattlesweep.sweep.session import Opened

    Columns = Mapping[str, Any]


class _Late(Exception):
    """The deadline has come while a block was under way."""


def load_kernel(job: Job) -> None:
    """Load the kernel, compiled if need be; in the main thread, so that Ctrl-C is heard."""
    begin = time.perf_counter()
    config = job.session.plan.config
    if config.model != "gh":
        kernel(config.integrator.method, config.model)
    job.report.load_seconds = time.perf_counter() - begin


def work_off(job: Job) -> None:
    """Integrate the pending blocks and write them, each while the next one runs."""
    pending = job.session.pending
    if not pending:
        return
    load_kernel(job)
    plan = job.session.plan
    ready = prepare_block(plan, pending[0])
    written: tuple[Block, Columns, float] | None = None
    done = 0
    for place, block in enumerate(pending):
        # A block is begun only if it can be finished; the first one tries.
        if job.too_late(job.meter.seconds(block) if done else None):
            break
        launches, batch = ready
        task: Task[Columns] = Task(
            lambda control, launches=launches, batch=batch: finish_block(  # type: ignore[misc]
                plan.config, launches, batch, threads=job.threads, control=control
            )
        )
        try:
            if written is not None:
                _write(job, *written)
                written = None
            if place + 1 < len(pending):
                ready = prepare_block(plan, pending[place + 1])
            written = block, task.wait(lambda control, block=block: _tick(job, block, control)), 0.0  # type: ignore[misc]
        except _Late:
            break
        except Interrupted:
            raise KeyboardInterrupt from None
        except BaseException:
            task.stop()
            raise
        job.report.kernel_seconds += task.seconds
        written = (*written[:2], task.seconds)
        job.meter.finish(block)
        done += 1
    if written is not None:
        _write(job, *written)
    if done < len(pending):
        job.report.stopped = why_stopped(done)
    job.tick()


def _tick(job: Job, block: Block, control: Any) -> None:
    job.tick(block, control)
    if job.too_late():
        raise _Late


def write_block(opened: Opened, block: Block, columns: Columns) -> Receipt:
    """Write an integrated block; every engine does it so."""
    schema = runs_schema(opened.plan.config.record, opened.plan.config.model)
    return opened.store.write_block(block.index, columns, schema, opened.note(block))


def _write(job: Job, block: Block, columns: Columns, seconds: float) -> None:
    job.session.wrote(block.index, write_block(job.session.opened, block, columns), seconds)
    job.report.blocks += 1


def why_stopped(done: int) -> str:
    """What to say when the time was up after so many blocks."""
    if done:
        return "the time is up"
    return (
        "the time was up before one block was done; give more, or choose a smaller block_size in "
        "a new output"
    )


__all__ = ["load_kernel", "why_stopped", "work_off", "write_block"]
