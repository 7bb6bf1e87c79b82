"""Run a sweep: find what is left to do, have it done, sum it up."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path

from rattlesweep.errors import OutputError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.sweeps.cases.plan import Plan
from rattlesweep.sweeps.cases.shards import Shard
from rattlesweep.sweeps.engines import local
from rattlesweep.sweeps.engines.job import Job, Progress, Result, Tracker
from rattlesweep.sweeps.engines.session import Session, open_session
from rattlesweep.sweeps.inspect.retype import retype_block
from rattlesweep.sweeps.inspect.summary import summarise
from rattlesweep.sweeps.tables.cells import columns_for


def run_sweep(
    plan: Plan,
    directory: Path,
    *,
    base: Path | None = None,
    threads: int | None = None,
    report: Callable[[Progress], None] = lambda progress: None,
    shard: Shard | None = None,
    max_time: float | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
    engine: Callable[[Job], None] = local.work_off,
) -> Result:
    """Run what a plan asks for and is not yet on disk.

    Parameters
    ----------
    directory : Path
        Output directory; the blocks of the same config that are whole there are kept, unless
        `fresh`, and runs of theirs whose status is not ``ok`` are done again if `retry_failed`.
    base : Path, optional
        Where a table's relative path is looked up besides the working directory.
    threads : int, optional
        Threads of the kernel.
    report : callable
        Called a few times a second with a :class:`Progress`.
    shard : Shard, optional
        The share to do; by default everything.
    max_time : float, optional
        Seconds after which it stops by itself.
    engine : callable
        Works off the pending blocks of a :class:`Job`.

    Raises
    ------
    ConfigError, OutputError
        If the directory holds something else, is in use, or a file cannot be written.
    KeyboardInterrupt
        On Ctrl-C; the kernel is stopped first, and the runs that have ended are kept.
    """
    start = time.perf_counter()
    deadline = None if max_time is None else time.monotonic() + max_time
    threads = threads or available_threads()
    result = Result(directory)
    with open_session(
        plan, directory, base, threads, shard=shard, fresh=fresh, retry_failed=retry_failed
    ) as session:
        session.scan()
        result.remarks += session.output.remarks
        result.resumed_runs = session.kept
        session.begin()
        try:
            session.forget(session.retype)
            for index in session.retype:
                file = session.store.read_block(index)
                receipt, _ = retype_block(session.store, index, file, plan.config.classify)
                session.wrote(index, receipt)
            while True:
                tracker = Tracker(session.costs, session.blocks, session.left, report)
                job = Job(session, tracker, result, threads, deadline)
                job.tick()
                if session.pending:
                    engine(job)
                    job.tick()
                if result.stopped is not None or not session.advance():
                    break
            _sum_up(session, result)
        except BaseException as error:
            result.runs = session.runs
            if not isinstance(error, Exception):
                error.add_note(result.kept)
            # What stopped it is what the user is to hear of, not that this could not be noted.
            with contextlib.suppress(OutputError):
                _end(session, result, start, "stopped")
            raise
        _end(session, result, start, "complete" if result.stopped is None else "stopped")
    return result


def _end(session: Session, result: Result, start: float, state: str) -> None:
    result.seconds = time.perf_counter() - start
    session.end(state, result)


def _sum_up(session: Session, result: Result) -> None:
    result.runs = session.runs
    for receipt in session.receipts.values():
        result.failed.update(receipt.failed)
    if result.stopped is not None:
        return
    result.missing = len(session.missing())
    if not result.missing:
        plan, store = session.plan, session.store
        result.summary = summarise(store, plan.cases, columns_for(plan.config))
        store.write_summary(result.summary)
