"""Run a sweep: find what is left to do, have it done, sum it up."""

from __future__ import annotations

import contextlib
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.errors import OutputError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.sweeps.engines import local
from rattlesweep.sweeps.engines.progress import Meter, Progress
from rattlesweep.sweeps.engines.session import Session, open_session
from rattlesweep.sweeps.forecast.forecast import expectation
from rattlesweep.sweeps.inspect.retype import retype_blocks
from rattlesweep.sweeps.inspect.summary import summarise

if TYPE_CHECKING:
    import pyarrow as pa

    from rattlesweep.sweeps.cases.plan import Plan
    from rattlesweep.sweeps.cases.shards import Shard
    from rattlesweep.sweeps.store.receipts import Receipt


# Seconds for which a session in which no run has ended yet goes on after its time is up, so that
# the same command again and again comes to an end, however short the time.
GRACE = 5.0


@dataclass
class Report:
    """What a sweep came to.

    Attributes
    ----------
    directory : Path
    runs, resumed_runs, blocks : int
        Runs of the sweep or of the share that are in place, those of them found on disk, and
        the blocks written by this session.
    done, retried : int
        Runs that this session has integrated, and those of them that had failed before.
    lost : int
        Runs that were under way when it was stopped.
    stopped : str or None
        Why it ended before all was done; None if all is.
    remarks : list of str
        What the user should know.
    failed : Counter
        Runs in place by status, other than ``ok``.
    summary : pa.Table or None
        One row a case; None unless the whole sweep is in place.
    missing : int
        Blocks of the whole sweep that are not in place.
    """

    directory: Path
    runs: int = 0
    resumed_runs: int = 0
    blocks: int = 0
    done: int = 0
    retried: int = 0
    lost: int = 0
    seconds: float = 0.0
    kernel_seconds: float = 0.0
    load_seconds: float = 0.0
    stopped: str | None = None
    remarks: list[str] = field(default_factory=list)
    failed: Counter[str] = field(default_factory=Counter)
    summary: pa.Table | None = None
    missing: int = 0

    @property
    def kept(self) -> str:
        """What is left after a stop, for the user."""
        return f"{self.runs:,} runs are kept, {self.lost:,} in flight were lost"


@dataclass
class Job:
    """What an engine is given to work off: the pending blocks of a session.

    Attributes
    ----------
    deadline : float or None
        Of :func:`time.monotonic`, after which no work is to be done.
    """

    session: Session
    meter: Meter
    report: Report
    threads: int
    deadline: float | None
    _begun: float = 0.0

    def begin(self) -> None:
        """Say that the engine is ready to integrate."""
        self._begun = time.monotonic()

    def wrote(self, index: int, receipt: Receipt, rows: int, seconds: float | None) -> None:
        """Count a block into which so many new rows were written; not all, if it was stopped."""
        self.report.blocks += self.session.wrote(index, receipt, seconds)
        self.report.done += rows
        self.report.kernel_seconds += seconds or 0.0
        if index in self.session.retry:
            self.report.retried += rows

    def tick(self, *where: Any) -> None:
        """Report progress, and note it down now and then."""
        self.session.note(self.meter.tick(*where))

    def too_late(self, some_done: bool = True) -> bool:
        """Whether to stop; a session in which no run has ended yet is given a little longer."""
        if self.deadline is None or time.monotonic() < self.deadline:
            return False
        return some_done or (self._begun > 0 and time.monotonic() >= self._begun + GRACE)

    def why_stopped(self) -> str:
        """What to say when the time was up."""
        if self.report.done:
            return "the time is up"
        return "the time was up before one run had ended, give more"


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
) -> Report:
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

    Returns
    -------
    Report

    Raises
    ------
    ConfigError, OutputError
        As :func:`rattlesweep.sweeps.engines.session.open_session`, or if a file cannot be written.
    KeyboardInterrupt
        On Ctrl-C; the kernel is stopped first, and the runs that have ended are kept.
    """
    start = time.perf_counter()
    deadline = None if max_time is None else time.monotonic() + max_time
    threads = threads or available_threads()
    result = Report(directory)
    with open_session(
        plan, directory, base, threads, shard=shard, fresh=fresh, retry_failed=retry_failed
    ) as session:
        session.scan()
        session.check_shared()
        result.remarks += session.opened.remarks
        result.resumed_runs = session.kept
        meter = Meter(session.costs, session.blocks, report)
        pending = {block.index for block in session.pending}
        for block in session.blocks:
            meter.skip(block, session.begun.get(block.index, 0 if block.index in pending else None))
        session.begin()
        try:
            if session.pending and engine is local.work_off:
                session.expect(lambda: expectation(session.plan, threads, max_time))
            job = Job(session, meter, result, threads, deadline)
            retype_blocks(session.store, session.retype, plan.config.classify, session)
            meter.tick()
            engine(job)
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


def _end(session: Session, result: Report, start: float, state: str) -> None:
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


def _sum_up(session: Session, result: Report) -> None:
    result.runs = session.runs
    for receipt in session.receipts.values():
        result.failed.update(receipt.failed)
    if result.stopped is not None:
        return
    result.missing = len(session.missing())
    if not result.missing:
        result.summary = summarise(session.store, session.plan.cases)
        session.store.write_summary(result.summary)


def _peak_memory() -> int | None:
    """Most memory this process has held, in bytes; None where the system does not say."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


__all__ = ["Job", "Progress", "Report", "run_sweep"]
