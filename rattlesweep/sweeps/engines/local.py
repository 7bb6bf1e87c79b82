"""The engine of one machine: block after block through the kernel.

The kernel runs in a thread of its own, without the interpreter's lock. Meanwhile the main
thread writes the block before, prepares the one after, reports progress and hears Ctrl-C.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rattlesweep.integrate.lanes.build import kernel
from rattlesweep.integrate.model import MODELS, WITH_TANGENT
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.blocks.block import Interrupted, finish_block
from rattlesweep.sweeps.engines.head_start import Work, prepare_work, write_work

if TYPE_CHECKING:
    from rattlesweep.sweeps.cases.plan import Block
    from rattlesweep.sweeps.config.schema import Config
    from rattlesweep.sweeps.engines.engine import Job

    Columns = Mapping[str, Any]

# Seconds for which a stop waits for the runs that have ended: to be typed, not integrated.
GATHER = 10.0


class _Late(Exception):
    """The deadline has come while a block was under way."""


def load_kernel(config: Config) -> float:
    """Load the kernel, compiled if need be; in the main thread, so that Ctrl-C is heard.

    Returns
    -------
    float
        Seconds.
    """
    begin = time.perf_counter()
    if config.model != "gh":
        model = MODELS[config.model]
        carried = WITH_TANGENT[model.name] if "lyapunov" in config.record else model
        kernel(config.integrator.method, carried.name)
    return time.perf_counter() - begin


def work_off(job: Job) -> None:
    """Integrate the pending blocks and write them, each while the next one runs."""
    pending = job.session.pending
    if not pending:
        return
    opened, begun = job.session.opened, job.session.begun
    job.report.load_seconds = load_kernel(opened.plan.config)
    job.begin()
    ready = prepare_work(opened, pending[0], pending[0].index in begun)
    task: Task[Columns] | None = None
    done: tuple[Work, Columns, float] | None = None
    try:
        for place, block in enumerate(pending):
            if job.too_late(place > 0):
                raise _Late
            work = ready
            task = _start(job, work)
            if done is not None:
                _write(job, *done)
                done = None
            if place + 1 < len(pending):
                after = pending[place + 1]
                ready = prepare_work(opened, after, after.index in begun)
            columns = task.wait(lambda control, block=block: _tick(job, block, control))  # type: ignore[misc]
            done, task = (work, columns, task.seconds), None
            job.meter.finish(block)
        if done is not None:
            _write(job, *done)
    except BaseException as error:
        if task is not None:
            task.stop()
        if isinstance(error, Exception) and not isinstance(error, _Late):
            raise
        # A request, not an error: what has ended is kept.
        if done is not None:
            _write(job, *done)
        if task is not None and (done is None or done[0] is not work):
            _keep(job, work, task)
        if not isinstance(error, _Late):
            raise
        job.report.stopped = job.why_stopped()
    job.tick()


def _start(job: Job, work: Work) -> Task[Columns]:
    config = job.session.plan.config
    return Task(
        lambda control: finish_block(
            config, work.launches, work.batch, threads=job.threads, control=control
        )
    )


def _tick(job: Job, block: Block, control: Any) -> None:
    job.tick(block, control)
    if job.too_late(job.report.done > 0 or control.runs_done > 0):
        raise _Late


def _keep(job: Job, work: Work, task: Task[Columns]) -> None:
    """Write the runs of a stopped kernel that have ended."""
    task.stop(GATHER)
    try:
        _write(job, work, task.value(), task.seconds)
    except Interrupted as stopped:
        job.report.lost += stopped.lost
        if stopped.columns is not None:
            _write(job, work, stopped.columns, task.seconds)
    except TimeoutError:
        job.report.lost += task.control.runs_begun


def _write(job: Job, work: Work, columns: Columns, seconds: float) -> None:
    job.session.replaces(work.block.index)
    receipt = write_work(job.session.opened, work, columns)
    job.wrote(work.block.index, receipt, len(columns["case"]), seconds)


__all__ = ["load_kernel", "work_off"]
