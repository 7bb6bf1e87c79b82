"""Run a sweep: what is wanted, minus what is on disk, goes through an engine into files."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.compute as pc

from rattlesweep.arrays import Flags
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.sweeps.decide import decides, decision
from rattlesweep.sweeps.files import explained
from rattlesweep.sweeps.job import Engine, Job, OutOfTime, Progress, Result, local
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.provenance import Session, hold
from rattlesweep.sweeps.rows import Found, free_path
from rattlesweep.sweeps.stored import (
    Stored,
    begin,
    check_removable,
    examine,
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
        if not match or int(match[1]) >= int(match[2]):
            raise ValueError("is not I/N; write it as in --shard 0/4, with I from 0 to N-1")
        return cls(int(match[1]), int(match[2]))

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

    Rows of the same sweep, or of a smaller one, are kept unless `fresh`; rows whose status is not
    ``ok`` are done again if `retry_failed`.  `base` is where a table's relative path is looked up
    besides the working directory, `max_time` is in seconds.  `report` is called some times a
    second.  Whatever stops it, the rows of the runs that have ended are kept.
    """
    start = time.monotonic()
    threads = threads or available_threads()
    if shard is not None and retry_failed:
        raise ConfigError("--retry-failed: takes rows of other shards too; run it without --shard")
    if shard is not None and (key := decides(plan.config)):
        raise ConfigError(f"{key}: what is run next depends on all runs, so there are no shards")
    if fresh:
        check_removable(directory)
    else:
        examine(plan, directory)  # before anything is made there
    with explained(f"cannot write in {directory}"):
        directory.mkdir(parents=True, exist_ok=True)
    name, how = None if shard is None else shard.name, "failed"
    result = Result(directory)
    with hold(directory, name):
        if fresh:
            start_over(directory)
        stored = begin(plan, directory, base, name)
        plan = plan.with_cases(stored.cases)
        session = Session(directory, name, threads)

        def told(progress: Progress) -> None:
            report(progress)
            session.note(progress=vars(progress))

        job: Job | None = None
        try:
            found = _find(plan, stored, shard, retry_failed, result)
            decide = decision(plan.config, plan.cases, plan.samples)
            if decide is not None:
                decide.read(stored)
            deadline = None if max_time is None else start + max_time
            job = Job(plan, stored, found, result, threads, told, decide, deadline)
            with job.resources:
                _work(job, shard, engine)
            result.failed = found.status - Counter(ok=found.status["ok"])
            how = "stopped"
            if result.stopped is None:
                how = "complete"
                if shard is not None:  # others have gone on meanwhile
                    result.missing = plan.runs - stored.count()
                if not result.missing:
                    result.summary = summarise(stored)
                    write_summary(stored, result.summary)
        except BaseException as error:
            if not isinstance(error, Exception):
                how = "interrupted"
                if job is not None:
                    error.add_note(result.kept)
            raise
        finally:
            result.seconds = time.monotonic() - start
            seconds, kernel = round(result.seconds, 3), round(result.kernel_seconds, 3)
            session.end(how, runs=result.done, seconds=seconds, kernel_seconds=kernel)
    return result


def _find(
    plan: Plan, stored: Stored, shard: Shard | None, retry_failed: bool, result: Result
) -> Found:
    """Read what is on disk, put damaged files aside, renew types, and take out what failed."""
    runs, what = stored.runs, (plan.cases, plan.samples, stored.hash, plan.schema)
    found, thresholds = runs.find(*what), plan.config.classify
    for path in found.damaged:
        aside = free_path(path.with_suffix(".damaged"))
        with explained(f"cannot rename {path}"):
            path.rename(aside)
        result.remarks.append(f"a file was damaged and is now {aside}; its runs are done again")
    stale = {p for text in found.typed.keys() - {thresholds.as_text} for p in found.typed[text]}
    if stale and shard is not None:
        raise ConfigError(
            f"{stored.directory}: its runs are typed by other thresholds than those of the config; "
            "run `rattlesweep classify` there before its shards go on"
        )
    retry = retry_failed and found.rows > found.status["ok"]
    if retry or stale:
        remove_summary(stored.directory)
    for path in runs.files() if retry else stale:
        rows = with_types(runs.table(path), thresholds)
        kept = rows.filter(pc.equal(rows.column("status"), "ok")) if retry else rows
        result.retried += len(rows) - len(kept)
        if path in stale or len(kept) < len(rows):
            runs.rewrite(path, kept, thresholds.as_text)
    return runs.find(*what) if retry else found


def _work(job: Job, shard: Shard | None, engine: Engine) -> None:
    """Do what is left, wave by wave where the sweep decides what to run next."""
    result, done, shape = job.result, job.found.done, job.plan.shape
    while True:
        wanted = np.ones(shape, dtype=bool) if shard is None else shard.runs(shape)
        if job.decide is not None:
            wanted = job.decide.wanted()
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
