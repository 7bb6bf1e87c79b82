"""Run a sweep: find what is left to do, have it done, sum it up."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from rattlesweep.errors import OutputError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.shards import Shard
from rattlesweep.sweeps.old import local
from rattlesweep.sweeps.old.progress import Progress, Result
from rattlesweep.sweeps.old.session import Session
from rattlesweep.sweeps.summary import summarise
from rattlesweep.sweeps.old.manifest import count_failed
from rattlesweep.sweeps.old.output import open_output
from rattlesweep.sweeps.counts import columns_for


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
    engine: Callable[[Session], None] = local.work_off,
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
        Works off the pending blocks of a :class:`Session`.

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
    share = None if shard is None else shard.name

    def end(state: Literal["complete", "stopped"]) -> None:
        result.seconds = time.perf_counter() - start
        session.end(state)

    with open_output(
        plan, directory, base, share=share, fresh=fresh, retry_failed=retry_failed
    ) as output:
        session = Session(output, shard, threads, result, report, deadline)
        session.scan()
        result.remarks += output.remarks
        session.begin()
        try:
            session.renew_types()
            while True:
                session.track()
                if session.pending:
                    engine(session)
                    session.tick()
                if result.stopped is not None or not session.advance():
                    break
            _sum_up(session)
        except BaseException as error:
            result.runs = session.runs
            if not isinstance(error, Exception):
                error.add_note(result.kept)
            # What stopped it is what the user is to hear of, not that this could not be noted.
            with contextlib.suppress(OutputError):
                end("stopped")
            raise
        end("complete" if result.stopped is None else "stopped")
    return result


def _sum_up(session: Session) -> None:
    result, plan, store = session.result, session.plan, session.store
    result.runs = session.runs
    result.failed.update(count_failed(session.receipts.values()))
    if result.stopped is not None:
        return
    result.missing = session.missing()
    if not result.missing:
        result.summary = summarise(store, plan.cases, columns_for(plan.config))
        store.write_summary(result.summary)
