"""Run a sweep: what is wanted, minus what is on disk, goes through an engine into files."""

from __future__ import annotations

import contextlib
import re
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Flags
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.sweeps.cost import case_costs
from rattlesweep.sweeps.decide import Refining, Stopping, decides, decision
from rattlesweep.sweeps.files import explained
from rattlesweep.sweeps.job import Engine, Job, OutOfTime, Progress
from rattlesweep.sweeps.local import local
from rattlesweep.sweeps.locks import hold
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.rows import Found, Runs
from rattlesweep.sweeps.sessions import Session
from rattlesweep.sweeps.stored import (
    MANIFEST,
    SUMMARY,
    Stored,
    begin,
    check_removable,
    examine,
    note_thresholds,
)
from rattlesweep.sweeps.summary import summarise, write_summary
from rattlesweep.sweeps.types import with_types


@dataclass(frozen=True)
class Shard:
    """Share ``index`` of ``count``, counted from 0 as job arrays count."""

    index: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read ``I/N``; raise a ValueError that says what is wrong with it."""
        match = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
        if not match:
            raise ValueError("is not I/N; write it as in --shard 0/4")
        index, count = int(match[1]), int(match[2])
        if index >= count:
            last = f", so from 0 to {count - 1}" if count else ""
            raise ValueError(f"there is no such share; I runs from 0 to N-1{last}")
        return cls(index, count)

    @property
    def name(self) -> str:
        """Name of the share's lock."""
        return f"shard-{self.index}-of-{self.count}"

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"

    def runs(self, shape: tuple[int, int]) -> Flags:
        """Return which runs are those of the share.

        Neighbours go to different shares, so that all shares cost about the same.
        """
        case, sample = (np.arange(n) % self.count for n in shape)
        mine: Flags = (case[:, None] + sample) % self.count == self.index
        return mine


@dataclass
class Result:
    """What a session came to."""

    directory: Path
    counted: bool = False  # whether the rows on disk have been
    runs: int = 0  # rows of the share on disk
    resumed_runs: int = 0  # of these, found there
    done: int = 0  # runs integrated in this session
    retried: int = 0  # runs that had failed and were done again
    lost: int = 0  # runs that were under way when it was stopped
    seconds: float = 0.0
    kernel_seconds: float = 0.0
    load_seconds: float = 0.0
    stopped: str | None = None  # why it ended before all was done
    remarks: list[str] = field(default_factory=list)  # what the user should know
    failed: Counter[str] = field(default_factory=Counter)  # runs on disk by status, if not ok
    summary: pa.Table | None = None  # one row a case; None unless the whole sweep is done
    missing: int = 0  # runs of other shares that are not on disk

    @property
    def kept(self) -> str:
        """What is left after a stop, for the user."""
        return f"{self.runs:,} runs are kept, {self.lost:,} in flight were lost"


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
    engine: Engine = local,
) -> Result:
    """Do the runs that a plan asks for and that are not on disk.

    Parameters
    ----------
    plan : Plan
    directory : Path
        Output directory.  Rows of the same sweep, or of a smaller one, are kept unless `fresh`;
        rows whose status is not ``ok`` are done again if `retry_failed`.
    base : Path, optional
        Directory in which a table's relative path is looked up besides the working directory.
    threads : int, optional
        Threads of the kernel; by default one for each processor.
    report : callable
        Called some times a second with a :class:`Progress`.
    shard : Shard, optional
        The share to do; by default everything.
    max_time : float, optional
        Seconds after which to stop.
    engine : callable
        Where the blocks are computed.

    Raises
    ------
    ConfigError, OutputError
        If the directory holds something else, is in use, or a file cannot be read or written.
    KeyboardInterrupt
        On Ctrl-C; the rows of the runs that have ended are kept.
    """
    start = time.monotonic()
    share = None if shard is None else shard.name
    threads = threads or available_threads()
    if shard is not None and retry_failed:
        raise ConfigError(
            "--retry-failed: takes rows out of files that other shares may have written; run it "
            "without --shard"
        )
    if shard is not None and decides(plan.config):
        raise ConfigError(
            f"{decides(plan.config)}: what is run next depends on all runs before, so there are no "
            "shares that know nothing of each other; use all cores, or --engine dask"
        )
    if fresh:
        check_removable(directory)
    else:
        held = examine(plan, directory)  # before anything is made there
        if held is not None and shard is not None and plan.config.classify.as_text != held.typed:
            raise ConfigError(
                f"{directory}: its runs are typed by other thresholds than those of the config; "
                "run `rattlesweep classify` there before its shares go on"
            )
    with explained(f"cannot write in {directory}", folder=True):
        directory.mkdir(parents=True, exist_ok=True)
    result = Result(directory)
    with hold(directory, share):
        if fresh:
            _start_over(directory)
        stored = begin(plan, directory, base, share)
        plan = plan.with_cases(stored.cases)
        session = Session(directory, share, threads)
        try:
            decide = decision(plan.config, plan.cases, plan.samples)
            work = _Sweep(plan, stored, shard, decide, result, session)
            deadline = None if max_time is None else start + max_time
            job = Job(plan, threads, case_costs(plan), work.progress(report), deadline)
            job.waves = decide is not None
            work.find(retry_failed)
            with job.resources:
                work.work_off(job, engine)
            result.seconds = time.monotonic() - start
            work.close()
        except BaseException as error:
            result.seconds = time.monotonic() - start
            how = "failed" if isinstance(error, Exception) else "interrupted"
            session.end(how, runs=result.done, seconds=round(result.seconds, 3))
            if not isinstance(error, Exception) and result.counted:
                error.add_note(result.kept)
            raise
    return result


@dataclass
class _Sweep:
    """A sweep, or a share of it, while a process works on it."""

    plan: Plan
    stored: Stored
    shard: Shard | None
    decide: Stopping | Refining | None
    result: Result
    session: Session
    found: Found | None = None

    @property
    def runs(self) -> Runs:
        return self.stored.runs

    @property
    def done(self) -> Flags:
        """Which runs are on disk."""
        assert self.found is not None
        flags: Flags = self.found.done
        return flags

    def find(self, retry_failed: bool) -> None:
        """Read what is on disk, renew its types, and take out what is to be done again."""
        plan, stored = self.plan, self.stored
        self.found = self._find()
        for path in self.found.aside:
            self.result.remarks.append(
                f"a file was damaged and is now {path}; its runs are done again"
            )
        typed = plan.config.classify.as_text
        other = [
            path for text, paths in self.found.typed.items() if text != typed for path in paths
        ]
        if other and self.shard is not None:
            raise ConfigError(
                f"{stored.directory}: its runs were typed by other thresholds than those of the "
                "config; run `rattlesweep classify` there before its shares go on"
            )
        for path in other:
            self.runs.rewrite(path, with_types(self.runs.table(path), plan.config.classify), typed)
        if self.shard is None:
            note_thresholds(stored, None)
        if retry_failed and self.found.failed:
            self._remove_summary()
            self.result.retried = sum(map(self.runs.drop_failed, self.found.failed))
            self.found = self._find()

    def _find(self) -> Found:
        return self.runs.find(
            self.plan.cases, self.plan.samples, self.stored.hash, self.plan.schema
        )

    def work_off(self, job: Job, engine: Engine) -> None:
        """Do what is left, wave by wave where the sweep decides what to run next."""
        assert self.found is not None
        result, first = self.result, True
        if self.decide is not None:
            self.decide.read(self.stored)
        while True:
            wanted = self._wanted()
            todo = wanted & ~self.done
            if first:
                result.resumed_runs = int((wanted & self.done).sum())
                result.runs, result.counted, first = result.resumed_runs, True, False
            job.count(int(wanted.sum()), todo)
            if not todo.any():
                job.complete()
                break
            self._remove_summary()  # it is of fewer runs
            try:
                self._drain(job, engine(job, job.blocks(todo)))
                if left := int((todo & ~self.done).sum()):
                    raise OutputError(
                        f"{left} runs did not come back from the engine; run it again"
                    )
            except OutOfTime:
                # It may be up when the last run has ended.
                if (todo & ~self.done).any():
                    result.stopped = (
                        "the time is up"
                        if job.done
                        else "the time was up before one run had ended, give more"
                    )
            finally:
                result.done, result.lost = job.done, job.lost
                result.kernel_seconds, result.load_seconds = job.kernel_seconds, job.load_seconds
                result.remarks += [line for line in job.remarks if line not in result.remarks]
            if result.stopped is not None:
                break

    def _remove_summary(self) -> None:
        path = self.stored.directory / SUMMARY
        with explained(f"cannot remove {path}"):
            path.unlink(missing_ok=True)

    def _wanted(self) -> Flags:
        if self.decide is not None:
            return self.decide.wanted()
        if self.shard is not None:
            return self.shard.runs(self.plan.shape)
        return np.ones(self.plan.shape, dtype=bool)

    def _drain(self, job: Job, tables: Iterator[pa.Table]) -> None:
        """Write the tables of an engine; after a stop, also those that it still has."""
        try:
            for table in tables:
                self._write(job, table)
                job.tick()
        except BaseException as error:
            if isinstance(error, Exception) and not isinstance(error, OutOfTime):
                tables.close()  # type: ignore[attr-defined]
                raise
            # An engine that has raised this itself has ended, and raises it again at once.
            with contextlib.suppress(StopIteration):
                table = tables.throw(error)  # type: ignore[attr-defined]
                while True:
                    self._write(job, table)
                    table = next(tables)
            raise

    def _write(self, job: Job, table: pa.Table) -> None:
        if not len(table):
            return
        with _undisturbed():
            self.runs.append(
                table, self.stored.hash, self.plan.config.classify.as_text, self.plan.cases
            )
            case, sample = (table.column(name).to_numpy() for name in ("case", "sample"))
            self.done[case, sample] = True
            assert self.found is not None
            for entry in table.column("status").value_counts().to_pylist():
                self.found.status[entry["values"]] += entry["counts"]
            self.found.rows += len(table)
            self.result.runs += len(table)
            if self.decide is not None:
                self.decide.add(table)
            job.wrote(table)

    def close(self) -> None:
        """Sum up, if all of the sweep is done, and say how the session ended."""
        assert self.found is not None
        result = self.result
        result.failed = Counter({k: n for k, n in self.found.status.items() if k != "ok"})
        if result.stopped is None:
            if self.shard is not None:
                # Others have gone on meanwhile.
                result.missing = self.plan.runs - self.runs.count()
            if not result.missing:
                result.summary = summarise(self.stored)
                write_summary(self.stored, result.summary)
        how = "complete" if result.stopped is None else "stopped"
        self.session.end(
            how,
            runs=result.done,
            seconds=round(result.seconds, 3),
            kernel_seconds=round(result.kernel_seconds, 3),
        )

    def progress(self, report: Callable[[Progress], None]) -> Callable[[Progress], None]:
        """Return what reports progress and notes it in the session's record."""

        def told(progress: Progress) -> None:
            report(progress)
            left = progress.left
            self.session.note(
                progress={
                    "fraction": round(progress.fraction, 4),
                    "runs": progress.runs,
                    "total": progress.total,
                    "seconds": round(progress.elapsed, 1),
                    "left": None if left is None else round(left, 1),
                }
            )

        return told


def _start_over(directory: Path) -> None:
    """Remove a sweep, its rows first, so that a kill leaves a sweep and no foreign files."""
    runs = Runs(directory)
    with explained(f"cannot remove the runs of {directory}"):
        for path in [*runs.files(), *runs.folder.glob("*.damaged*")]:
            path.unlink()
        for name in (SUMMARY, MANIFEST):
            (directory / name).unlink(missing_ok=True)


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait until the body has ended."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    heard: list[int] = []
    before = {n: signal.signal(n, lambda number, _: heard.append(number)) for n in numbers}
    try:
        yield
    finally:
        for signal_, handler in before.items():
            signal.signal(signal_, signal.SIG_DFL if handler is None else handler)
        for number in heard:
            signal.raise_signal(number)
