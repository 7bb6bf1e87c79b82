"""The engine of one machine: block after block through the kernel.

The kernel runs in a thread of its own, without the interpreter's lock. Meanwhile the main
thread writes the block before, prepares the one after, reports progress and hears Ctrl-C.
"""

from __future__ import annotations

import time
from typing import Any

from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import load_kernel
from rattlesweep.sweeps.plan import Block
from rattlesweep.sweeps.old.remainder import Columns, Remainder, gather
from rattlesweep.sweeps.old.session import Session
from rattlesweep.sweeps.old.forecast import expectation


class _Late(Exception):
    """The deadline has come while a block was under way."""


def work_off(session: Session) -> None:
    """Integrate the pending blocks and write them, each while the next one runs."""
    left = None if session.deadline is None else session.deadline - time.monotonic()
    session.expect(lambda: expectation(session.plan, session.threads, left))
    # Bodies are drawn while the kernel is compiled.
    loading = Task(lambda _: load_kernel(session.plan.config))
    pending = session.pending
    ready = session.prepare(pending[0])
    session.result.load_seconds = loading.wait()
    session.tracker.begin()
    task: Task[Columns] | None = None
    done: tuple[Remainder, Columns, float] | None = None
    try:
        for place, block in enumerate(pending):
            if session.too_late(place > 0):
                raise _Late
            under_way = ready
            task = under_way.integrate(session.threads)
            if done is not None:
                _write(session, *done)
                done = None
            if place + 1 < len(pending):
                ready = session.prepare(pending[place + 1])
            columns = task.wait(lambda control, block=block: _tick(session, block, control))  # type: ignore[misc]
            done, task = (under_way, columns, task.seconds), None
        if done is not None:
            _write(session, *done)
    except BaseException as error:
        if task is not None:
            task.stop()
        if isinstance(error, Exception) and not isinstance(error, _Late):
            raise
        # A request, not an error: what has ended is kept.
        if done is not None:
            _write(session, *done)
        if task is not None and (done is None or done[0] is not under_way):
            some, lost = gather(task)
            session.result.lost += lost
            if some is not None:
                _write(session, under_way, some, task.seconds)
        if not isinstance(error, _Late):
            raise
        session.stop()


def _tick(session: Session, block: Block, control: Any) -> None:
    session.tick(block, control)
    if session.too_late(session.result.done > 0 or control.runs_done > 0):
        raise _Late


def _write(session: Session, part: Remainder, columns: Columns, seconds: float) -> None:
    session.forget([part.block.index])
    session.wrote(part.block, part.write(columns), len(columns["case"]), seconds)
