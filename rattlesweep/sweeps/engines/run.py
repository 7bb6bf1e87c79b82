"""Run a sweep: find what is left to do, have it done, sum it up."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rattlesweep.errors import OutputError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.sweeps.engines import local
from rattlesweep.sweeps.engines.job import Job, Result
from rattlesweep.sweeps.engines.opening import open_session
from rattlesweep.sweeps.engines.progress import Progress, Tracker
from rattlesweep.sweeps.inspect.retype import retype_block
from rattlesweep.sweeps.inspect.summary import summarise
from rattlesweep.sweeps.tables.cells import columns_for

if TYPE_CHECKING:
    from rattlesweep.sweeps.cases.plan import Plan
    from rattlesweep.sweeps.cases.shards import Shard
    from rattlesweep.sweeps.engines.session import Session


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
    plan : Plan
    directory : Path
        Output directory; the blocks of the same config that are whole there are kept.
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
    fresh : bool
        Whether to remove the runs that are there and start over.
    retry_failed : bool
        Whether to do runs again whose status is not ``ok``.
    engine : callable
        Works off the pending blocks of a :class:`Job`.

    Raises
    ------
    ConfigError, OutputError
        As :func:`rattlesweep.sweeps.engines.opening.open_session`, or if a file cannot be written.
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
        session.check_shared()
        result.remarks += session.output.remarks
        result.resumed_runs = session.kept
        session.begin()
        try:
            session.forget(session.retype)
            for index in session.retype:
                file = session.store.read_block(index)
                receipt, _ = retype_block(session.store, index, file, plan.config.classify)
                session.wrote(index, receipt)
            job = Job(session, _tracker(session, report), result, threads, deadline)
            job.tick()
            while True:
                if session.pending:
                    engine(job)
                    job.tick()
                if result.stopped is not None or not session.advance():
                    break
                job.tracker = _tracker(session, report)
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


def _tracker(session: Session, report: Callable[[Progress], None]) -> Tracker:
    there = {block.index: block.rows for block in session.blocks}
    there |= {block.index: session.begun.get(block.index, 0) for block in session.pending}
    return Tracker(session.costs, session.blocks, there, report)


def _end(session: Session, result: Result, start: float, state: str) -> None:
    result.seconds = time.perf_counter() - start
    session.end(
        state,
        result.summary is not None,
        {
            "seconds": round(result.seconds, 3),
            "load_seconds": round(result.load_seconds, 3),
            "kernel_seconds": round(result.kernel_seconds, 3),
            "blocks": result.blocks,
            "peak_memory": _peak_memory(),
        },
    )


def _sum_up(session: Session, result: Result) -> None:
    result.runs = session.runs
    for receipt in session.receipts.values():
        result.failed.update(receipt.failed)
    if result.stopped is not None:
        return
    result.missing = len(session.missing())
    if not result.missing:
        result.summary = summarise(
            session.store, session.plan.cases, columns_for(session.plan.config)
        )
        session.store.write_summary(result.summary)


def _peak_memory() -> int | None:
    """Most memory this process has held, in bytes; None where the system does not say."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak
