"""Run a sweep: what is wanted, minus what is on disk, goes through an engine into files."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rattlesweep.arrays import Flags
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.sweeps.decide import decides, decision
from rattlesweep.sweeps.files import explained
from rattlesweep.sweeps.job import Engine, Job, OutOfTime, Progress, Result, local
from rattlesweep.sweeps.locks import hold
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.provenance import Session
from rattlesweep.sweeps.rows import Found
from rattlesweep.sweeps.stored import (
    Stored,
    begin,
    check_removable,
    examine,
    note_thresholds,
    remove_summary,
    start_over,
)
from rattlesweep.sweeps.summary import summarise, write_summary
from rattlesweep.sweeps.types import with_types


@dataclass(frozen=True)
class Shard:
    """Shard ``index`` of ``count``, counted from 0 as job arrays count."""

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
            raise ValueError(f"there is no such shard; I runs from 0 to N-1{last}")
        return cls(index, count)

    @property
    def name(self) -> str:
        """Name of the shard's lock."""
        return f"shard-{self.index}-of-{self.count}"

    def runs(self, shape: tuple[int, int]) -> Flags:
        """Return which runs are those of the shard.

        Neighbours go to different shards, so that all shards cost about the same.
        """
        case, sample = (np.arange(n) % self.count for n in shape)
        mine: Flags = (case[:, None] + sample) % self.count == self.index
        return mine


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
        The shard to do; by default everything.
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
    threads = threads or available_threads()
    if shard is not None and retry_failed:
        raise ConfigError(
            "--retry-failed: takes rows out of files that other shards may have written; run it "
            "without --shard"
        )
    if shard is not None and (key := decides(plan.config)):
        raise ConfigError(
            f"{key}: what is run next depends on all runs before, so there are no shards that know "
            "nothing of each other; use all cores, or --engine dask"
        )
    if fresh:
        check_removable(directory)
    else:
        held, _ = examine(plan, directory)  # before anything is made there
        if held is not None and shard is not None:
            _check_types(directory, held.typed, plan)
    with explained(f"cannot write in {directory}", folder=True):
        directory.mkdir(parents=True, exist_ok=True)
    name = None if shard is None else shard.name
    result, job = Result(directory), None
    with hold(directory, name):
        if fresh:
            start_over(directory)
        stored = begin(plan, directory, base, name)
        plan = plan.with_cases(stored.cases)
        session = Session(directory, name, threads)

        def told(progress: Progress) -> None:
            report(progress)
            session.note(progress=vars(progress))

        try:
            found = _find(plan, stored, shard, retry_failed, result)
            decide = decision(plan.config, plan.cases, plan.samples)
            if decide is not None:
                decide.read(stored)
            deadline = None if max_time is None else start + max_time
            job = Job(plan, stored, found, result, threads, told, decide, deadline)
            with job.resources:
                _work(job, shard, engine)
            _close(job, shard)
            how = "complete" if result.stopped is None else "stopped"
        except BaseException as error:
            how = "failed" if isinstance(error, Exception) else "interrupted"
            if job is not None and not isinstance(error, Exception):
                error.add_note(result.kept)
            raise
        finally:
            result.seconds = time.monotonic() - start
            session.end(
                how,
                runs=result.done,
                seconds=round(result.seconds, 3),
                kernel_seconds=round(result.kernel_seconds, 3),
            )
    return result


def _find(
    plan: Plan, stored: Stored, shard: Shard | None, retry_failed: bool, result: Result
) -> Found:
    """Read what is on disk, renew its types, and take out what is to be done again."""

    def find() -> Found:
        return stored.runs.find(plan.cases, plan.samples, stored.hash, plan.schema)

    found, runs = find(), stored.runs
    result.remarks += [
        f"a file was damaged and is now {path}; its runs are done again" for path in found.aside
    ]
    typed = plan.config.classify.as_text
    for text, paths in found.typed.items():
        if shard is not None:
            _check_types(stored.directory, text, plan)
        for path in paths if text != typed else ():
            runs.rewrite(path, with_types(runs.table(path), plan.config.classify), typed)
    if shard is None:
        note_thresholds(stored, None)
    if retry_failed and found.failed:
        remove_summary(stored.directory)
        result.retried = sum(map(runs.drop_failed, found.failed))
        found = find()
    return found


def _check_types(directory: Path, typed: str, plan: Plan) -> None:
    if typed != plan.config.classify.as_text:
        raise ConfigError(
            f"{directory}: its runs are typed by other thresholds than those of the config; run "
            "`rattlesweep classify` there before its shards go on"
        )


def _work(job: Job, shard: Shard | None, engine: Engine) -> None:
    """Do what is left, wave by wave where the sweep decides what to run next."""
    result, done, shape = job.result, job.found.done, job.plan.shape
    while True:
        if job.decide is not None:
            wanted = job.decide.wanted()
        else:
            wanted = np.ones(shape, dtype=bool) if shard is None else shard.runs(shape)
        result.runs = int((wanted & done).sum())
        blocks = job.blocks(wanted)
        if done[wanted].all():
            job.complete()
            return
        remove_summary(job.stored.directory)  # it is of fewer runs
        try:
            engine(job, blocks)
        except OutOfTime:
            # It may be up when the last run has ended.
            if not done[wanted].all():
                result.stopped = "the time is up"
                if not result.done:
                    result.stopped = "the time was up before one run had ended, give more"
                return
        if left := int((wanted & ~done).sum()):
            raise OutputError(f"{left} runs did not come back from the engine; run it again")


def _close(job: Job, shard: Shard | None) -> None:
    """Count what failed and, if all of the sweep is done, sum up."""
    result, stored = job.result, job.stored
    result.failed = Counter({k: n for k, n in job.found.status.items() if k != "ok"})
    if result.stopped is not None:
        return
    if shard is not None:
        result.missing = job.plan.runs - stored.count()  # others have gone on meanwhile
    if not result.missing:
        result.summary = summarise(stored)
        write_summary(stored, result.summary)
