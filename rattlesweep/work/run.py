"""Run a sweep: wanted runs minus those on disk are computed and written.

:func:`run_sweep` reads what is on disk, an executor such as :func:`local` computes the
missing runs block by block, and a :class:`Job` says which come next and writes rows.
"""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.arrays import Flags, Integers
from rattlesweep.config.schema import Classify
from rattlesweep.design.plan import Plan
from rattlesweep.kernel.task import Control, Task
from rattlesweep.kernel.threads import available_threads
from rattlesweep.rows.types import with_types
from rattlesweep.store.copies import drop_copies
from rattlesweep.store.decide import wanted_runs
from rattlesweep.store.locks import MANIFEST_LOCK, hold, locked
from rattlesweep.store.manifest import begin_sweep, examine
from rattlesweep.store.merging import all_runs, find_merged
from rattlesweep.store.parquet import read_parquet
from rattlesweep.store.rows import Found, Stored, rewrite
from rattlesweep.store.sessions import session
from rattlesweep.store.summary import write_summary
from rattlesweep.system.files import explained
from rattlesweep.words.errors import ConfigError, OutputError, TwiceError
from rattlesweep.work.block import (
    check_computable,
    load_kernel,
    prepare_runs,
    start_block,
)
from rattlesweep.work.job import Job, Keys, OutOfTime, Progress

Executor = Callable[[Job, Iterator[Keys]], None]
"""Computes blocks of runs, and writes their rows by :meth:`Job.write`, in any order and
grouping. When it is stopped, by Ctrl-C or :class:`OutOfTime`, it writes the rows that
it has and raises the exception again."""

RUNS_IN_MEMORY = 100_000  # runs integrated at a time without a directory: about 100 MB
STOP_PATIENCE = 2.0  # seconds for which a stop waits for the rows of the current block


@dataclass(frozen=True)
class Shard:
    """Shard ``index`` of ``count``, counted from 0 as job arrays count."""

    index: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read ``I/N``, or raise a ValueError."""
        match = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
        if not match or int(match[1]) >= int(match[2]):
            raise ValueError(
                "is not I/N; write it as in --shard 0/4, with I from 0 to N-1"
            )
        return cls(int(match[1]), int(match[2]))

    @property
    def name(self) -> str:
        """Return the name of the shard's lock."""
        return f"shard-{self.index}-of-{self.count}"

    def runs(self, shape: tuple[int, ...]) -> Flags:
        """Return the runs of the shard; neighbours cost alike and are in others."""
        case, sample = (np.arange(n) % self.count for n in shape)
        return self.has(case[:, None], sample)

    def has(self, case: Integers, sample: Integers) -> Flags:
        """Return which keys are those of runs of the shard."""
        return (case + sample) % self.count == self.index


@dataclass(frozen=True)
class Swept:
    """What a session has done, and what is then on disk."""

    stored: Stored
    found: Found
    runs: int  # wanted runs that are on disk
    done: int  # runs computed in the session
    seconds: float
    kernel_seconds: float
    stopped: str | None  # why it ended early
    missing: int  # runs of other shards that are not on disk
    summary: pa.Table | None  # one row a case; None unless the whole sweep is done

    @property
    def failed(self) -> Counter[str]:
        """Number of runs on disk by status, without those that are ok."""
        return self.found.status - Counter(ok=self.found.status["ok"])


def run_sweep(
    plan: Plan,
    directory: Path,
    *,
    base: Path | None = None,
    threads: int | None = None,
    report: Callable[[Progress], None] = lambda progress: None,
    shard: Shard | None = None,
    max_time: float | None = None,
    retry_failed: bool = False,
    executor: Executor | None = None,
) -> Swept:
    """Compute the runs of a plan that are not on disk; a stop keeps what has ended."""
    start = time.monotonic()
    threads = threads or available_threads()
    _check_shard(plan, shard, retry_failed)
    # Refuse before anything is created there.
    check_computable(plan)
    examine(plan, directory)
    with explained(f"cannot write in {directory}"):
        directory.mkdir(parents=True, exist_ok=True)
    name = None if shard is None else shard.name
    with contextlib.ExitStack() as held:
        # Of several shards that start at once, one writes the manifest.
        with locked(directory, MANIFEST_LOCK):
            held.enter_context(hold(directory, name))
            stored = begin_sweep(plan, directory, base, name)
        plan = replace(plan, cases=stored.cases)
        record, began = held.enter_context(session(directory, name, threads))
        on_disk = _mend(stored, plan.config.classify, shard, retry_failed)
        deadline = math.inf if max_time is None else start + max_time
        job = Job(plan, stored, on_disk, threads, report, deadline, began)
        missing = 0
        summary = None
        try:
            stopped = _compute_missing(job, shard, executor or local)
            if stopped is None:
                if shard is not None:  # other shards may have ended meanwhile
                    missing = plan.runs - stored.count()
                if not missing:
                    summary = write_summary(stored)
            record["how"] = "stopped" if stopped else "complete"
        finally:
            seconds = time.monotonic() - start
            record["runs"] = job.tally.computed
            record["seconds"] = round(seconds, 3)
            record["kernel_seconds"] = round(job.tally.kernel_seconds, 3)
    return Swept(
        stored=stored,
        found=on_disk,
        runs=job.tally.on_disk,
        done=job.tally.computed,
        seconds=seconds,
        kernel_seconds=job.tally.kernel_seconds,
        stopped=stopped,
        missing=missing,
        summary=summary,
    )


def _check_shard(plan: Plan, shard: Shard | None, retry_failed: bool) -> None:
    """Refuse what shards cannot do."""
    if shard is None:
        return
    if retry_failed:
        raise ConfigError(
            "--retry-failed: also repeats runs of other shards; leave out --shard"
        )
    key = plan.config.deciding_key
    if key is not None:
        raise ConfigError(
            f"{key}: what is run next depends on all runs, so there are no shards"
        )


def _mend(
    stored: Stored, thresholds: Classify, shard: Shard | None, retry_failed: bool
) -> Found:
    """Make the rows on disk those to start from.

    Small files are merged, damaged ones set aside, stale types are made anew, and
    failed runs are dropped if they are to be repeated. Return what is then on disk, and
    the damaged files where they now are.
    """
    mine = all_runs if shard is None else shard.has
    try:
        on_disk = find_merged(stored, mine)
    except TwiceError:
        if shard is not None:  # another shard may be writing one of the files
            raise
        stored.drop_summary()
        drop_copies(stored)
        on_disk = find_merged(stored, mine)
    on_disk.damaged = stored.set_aside(on_disk.damaged)
    typed = thresholds.as_text
    stale: set[Path] = set()
    for text, paths in on_disk.typed.items():
        if text != typed:
            stale.update(paths)
    if stale and shard is not None:
        raise ConfigError(
            f"{stored.directory}: its runs are typed by other thresholds than the "
            "config's; run `rattlesweep classify` there before its shards go on"
        )
    retry = retry_failed and on_disk.rows > on_disk.status["ok"]
    if not stale and not retry:
        return on_disk
    stored.drop_summary()
    for path in stored.files():
        if retry or path in stale:
            rows = with_types(read_parquet(path), thresholds)
            ok_rows = rows
            if retry:
                ok_rows = rows.filter(pc.equal(rows.column("status"), "ok"))
            if path in stale or len(ok_rows) < len(rows):
                rewrite(path, ok_rows, typed)
    # Look again: what the first look found is not what is there now.
    again = stored.find()
    again.damaged = on_disk.damaged + stored.set_aside(again.damaged)
    return again


def _compute_missing(job: Job, shard: Shard | None, executor: Executor) -> str | None:
    """Compute the wanted runs until all are on disk or the time is up.

    Return why they were not all computed, or None.
    """
    plan = job.plan
    on_disk = job.found
    while True:  # once, or once for each wave of `stop` and `bodies.refine`
        wanted = wanted_runs(plan, on_disk)
        if shard is not None:
            wanted = shard.runs(plan.shape)
        job.tally.on_disk = int((wanted & on_disk.done).sum())
        if on_disk.done[wanted].all():
            if job.tally.computed:
                job.report(Progress(1.0, job.tally.on_disk, 0.0))
            return None
        job.stored.drop_summary()
        try:
            executor(job, job.blocks(wanted))
        except OutOfTime:
            # The last run may end just as the time is up.
            if not on_disk.done[wanted].all():
                if not job.tally.computed:
                    return "the time is up before any run had ended; allow more"
                return "the time is up"
        except BaseException as error:
            if not isinstance(error, Exception):
                error.add_note(f"{job.tally.on_disk:,} runs are kept")
            raise
        left = int((wanted & ~on_disk.done).sum())
        if left:
            raise OutputError(f"the executor left out {left} of the runs; run it again")


def local(job: Job, blocks: Iterator[Keys]) -> None:
    """Compute blocks on this machine.

    While a block is computed, the one before is written and the next is prepared.
    """
    plan = job.plan
    loading = Task(lambda _: load_kernel(plan.config))
    tasks: list[Task[pa.Table]] = []  # blocks not yet written, at most two, in order
    try:
        for before, keys in pairwise(chain([None], blocks, [None])):
            # Meanwhile the kernel is loaded, or the block before is computed.
            prepared = None if keys is None else prepare_runs(plan, *keys)
            loading.wait()
            job.begin()
            if before is not None:
                tasks[0].wait(partial(job.tick, before))
            if prepared is not None:
                tasks.append(start_block(plan, prepared, job.threads))
            if before is not None:
                job.write(tasks[0].value(), tasks.pop(0).seconds)
                job.tick()
    except BaseException as error:
        for task in tasks:
            task.stop(STOP_PATIENCE)
        if isinstance(error, Exception):
            raise
        for task in tasks:
            with contextlib.suppress(TimeoutError):
                rows = task.value()
                if len(rows):
                    job.write(rows)
        raise


def integrate_plan(
    plan: Plan,
    threads: int | None = None,
    report: Callable[[float], None] = lambda fraction: None,
) -> pa.Table:
    """Return the rows of a plan, without a directory; `report` gets the share done."""
    load_kernel(plan.config)
    tables = [plan.schema.remove_metadata().empty_table()]
    for start in range(0, plan.runs, RUNS_IN_MEMORY):
        index = np.arange(start, min(start + RUNS_IN_MEMORY, plan.runs))

        def tick(control: Control, start: int = start, runs: int = len(index)) -> None:
            report((start + runs * control.done) / plan.runs)

        prepared = prepare_runs(plan, *np.divmod(index, plan.samples))
        tables.append(start_block(plan, prepared, threads).wait(tick))
    report(1.0)
    return pa.concat_tables(tables)
