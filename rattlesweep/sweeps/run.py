"""Run a sweep: :func:`run_sweep` reads what is on disk, an engine such as :func:`local`
computes the missing runs block by block, and :class:`Job` cuts the blocks, writes rows
and reports progress.
"""

from __future__ import annotations

import contextlib
import math
import re
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.lanes.lane import LANES
from rattlesweep.integrate.task import Control, Task
from rattlesweep.sweeps.block import load_kernel, prepare_runs, start_block
from rattlesweep.sweeps.columns import read_parquet
from rattlesweep.sweeps.config.schema import Classify
from rattlesweep.sweeps.cost import case_costs
from rattlesweep.sweeps.decide import wanted_runs
from rattlesweep.sweeps.files import explained
from rattlesweep.sweeps.plan import Plan, begin, examine
from rattlesweep.sweeps.provenance import MANIFEST_LOCK, hold, locked, session
from rattlesweep.sweeps.stored import Found, Stored, free_path, keys_of, rewrite
from rattlesweep.sweeps.summary import write_summary
from rattlesweep.sweeps.types import with_types

Keys = tuple[Integers, Integers]  # cases and samples of some runs
Engine = Callable[["Job", Iterator[Keys]], None]
"""Computes blocks of runs, and writes their rows by :meth:`Job.write`, in any order and
grouping. When it is stopped, by Ctrl-C or :class:`OutOfTime`, it writes the rows that
it has and raises the exception again."""

BLOCK_SECONDS = (
    3.0  # target duration of a block, and so what a kill or a lost worker costs
)
MAX_BLOCK_SECONDS = (
    30.0  # duration allowed where a shorter block would leave lanes idle
)
FIRST_BLOCK_SECONDS = 0.3
FIRST_RATE = (
    2e6  # expected cost that a thread does in a second, until blocks have been timed
)
MAX_BLOCK_RUNS = 50_000  # a run takes a few hundred bytes while its block is computed
RUNS_PER_LANE = 4  # in a block, so that all lanes are busy most of the time
SCAN = 1 << 20  # runs scanned at a time for work left to do
RUNS_IN_MEMORY = 100_000  # runs integrated at a time without a directory: about 100 MB
STOP_PATIENCE = 2.0  # seconds for which a stop waits for the rows of the current block
GRACE = 5.0  # seconds past the deadline that a session may take to end its first run


@dataclass(frozen=True)
class Progress:
    """How far a sweep is."""

    fraction: float  # of the expected cost, including rows that were on disk before
    runs: int  # done
    total: int  # wanted
    left: (
        float | None
    )  # estimate in seconds; None before there is anything to base it on


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

    def runs(self, shape: tuple[int, ...]) -> Flags:
        """Return the runs of the shard; neighbours cost alike and go to different
        shards.
        """
        case, sample = (np.arange(n) % self.count for n in shape)
        return np.asarray((case[:, None] + sample) % self.count == self.index)


class OutOfTime(BaseException):
    """The time limit of a session has passed."""


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
    engine: Engine | None = None,
) -> Job:
    """Compute the runs of a plan that are not on disk; a stop or `max_time` keeps ended
    runs.
    """
    start, threads = time.monotonic(), threads or available_threads()
    if shard is not None and retry_failed:
        raise ConfigError(
            "--retry-failed: also repeats runs of other shards; leave out --shard"
        )
    if shard is not None and (key := plan.config.deciding_key):
        raise ConfigError(
            f"{key}: what is run next depends on all runs, so there are no shards"
        )
    examine(plan, directory)  # refuse before anything is created there
    with explained(f"cannot write in {directory}"):
        directory.mkdir(parents=True, exist_ok=True)
    name = None if shard is None else f"shard-{shard.index}-of-{shard.count}"
    with contextlib.ExitStack() as held:
        with locked(
            directory, MANIFEST_LOCK
        ):  # one of several shards that start writes it
            held.enter_context(hold(directory, name))
            stored = begin(plan, directory, base, name)
        plan = replace(plan, cases=stored.cases)
        record = held.enter_context(session(directory, name, threads))
        found = _mend(stored, plan.config.classify, shard, retry_failed)
        deadline = start + (math.inf if max_time is None else max_time)
        job = Job(plan, stored, found, threads, report, deadline)
        try:
            _compute_missing(job, shard, engine or local)
            if job.stopped is None:
                if shard is not None:  # other shards may have ended meanwhile
                    job.missing = plan.runs - stored.count()
                if not job.missing:
                    job.summary = write_summary(stored)
            record["how"] = "stopped" if job.stopped else "complete"
        finally:
            job.seconds = time.monotonic() - start
            record |= {"runs": job.done, "seconds": round(job.seconds, 3)}
            record["kernel_seconds"] = round(job.kernel_seconds, 3)
    return job


def _mend(
    stored: Stored, thresholds: Classify, shard: Shard | None, retry_failed: bool
) -> Found:
    """Rename damaged files, type stale rows again, drop failed runs to retry; return
    the rest.
    """
    found, typed = stored.find(), thresholds.as_text
    with explained(f"cannot rename a file in {stored.folder}"):
        found.damaged = [
            p.rename(free_path(p.with_suffix(".damaged"))) for p in found.damaged
        ]
    stale = {
        path for text, paths in found.typed.items() if text != typed for path in paths
    }
    if stale and shard is not None:
        raise ConfigError(
            f"{stored.directory}: its runs are typed by other thresholds than the config's; run "
            "`rattlesweep classify` there before its shards go on"
        )
    retry = retry_failed and found.rows > found.status["ok"]
    if retry or stale:
        stored.drop_summary()
    for path in stored.files() if retry else sorted(stale):
        rows = with_types(read_parquet(path), thresholds)
        kept = rows.filter(pc.equal(rows.column("status"), "ok")) if retry else rows
        if path in stale or len(kept) < len(rows):
            rewrite(path, kept, typed)
    if not (retry or stale):
        return found
    again = stored.find()
    again.damaged = found.damaged
    return again


def _compute_missing(job: Job, shard: Shard | None, engine: Engine) -> None:
    """Compute the wanted runs until all are on disk or the time is up."""
    plan, found = job.plan, job.found
    while True:  # once, or once for each wave of `stop` and `bodies.refine`
        wanted = wanted_runs(plan, found) if shard is None else shard.runs(plan.shape)
        job.runs = int((wanted & found.done).sum())
        if found.done[wanted].all():
            return
        job.stored.drop_summary()
        try:
            engine(job, job.blocks(wanted))
        except OutOfTime:
            if not found.done[
                wanted
            ].all():  # the last run may end just as the time is up
                early = "the time was up before any run had ended; allow more"
                job.stopped = "the time is up" if job.done else early
                return
        except BaseException as error:
            if not isinstance(error, Exception):
                error.add_note(f"{job.runs:,} runs are kept")
            raise
        if left := int((wanted & ~found.done).sum()):
            raise OutputError(f"the engine left out {left} of the runs; run it again")


def local(job: Job, blocks: Iterator[Keys]) -> None:
    """Compute blocks on this machine; meanwhile, write the block before and prepare the
    next.
    """
    plan = job.plan
    loading = Task(lambda _: load_kernel(plan.config))
    tasks: list[Task[pa.Table]] = []  # blocks not yet written, at most two, in order
    try:
        for before, keys in pairwise(chain([None], blocks, [None])):
            # Meanwhile the kernel is loaded, or the block before is computed.
            prepared = None if keys is None else prepare_runs(plan, *keys)
            loading.wait()
            job.begun = job.begun or time.monotonic()
            if before is not None:
                tasks[0].wait(partial(job.tick, before))
                job.time_block(before, tasks[0].seconds)
            if prepared is not None:
                tasks.append(start_block(plan, prepared, job.threads))
            if before is not None:
                job.write(tasks.pop(0).value())
                job.tick()
    except BaseException as error:
        for task in tasks:
            task.stop(STOP_PATIENCE)
        if isinstance(error, Exception):
            raise
        for task in tasks:
            with contextlib.suppress(TimeoutError):
                if len(rows := task.value()):
                    job.write(rows)
        raise


@dataclass
class Job:
    """The work of a session: its inputs, and what has been done so far."""

    plan: Plan
    stored: Stored  # where rows are written
    found: Found  # what is on disk
    threads: int
    report: Callable[[Progress], None] = lambda progress: (
        None
    )  # called a few times a second
    deadline: float = math.inf  # of `time.monotonic`
    begun: float | None = (
        None  # when the kernel was loaded: the rate leaves out compile time
    )
    runs: int = 0  # wanted runs that are on disk
    done: int = 0  # runs computed in this session
    kernel_seconds: float = 0.0
    seconds: float = 0.0
    stopped: str | None = None  # why the session ended early
    summary: pa.Table | None = (
        None  # one row a case; None unless the whole sweep is done
    )
    missing: int = 0  # runs of other shards that are not on disk

    def __post_init__(self) -> None:
        self._cost = case_costs(self.plan)  # expected, of one run of each case
        self._total = 0  # runs wanted
        self._cost_wanted = self._cost_left = self._cost_done = (
            0.0  # done: in this session
        )
        self._fraction = 0.0  # reported last
        self._recent: deque[tuple[float, float]] = deque(
            maxlen=8
        )  # cost and seconds of blocks

    @property
    def failed(self) -> Counter[str]:
        """Number of runs on disk by status, without those that are ok."""
        return self.found.status - Counter(ok=self.found.status["ok"])

    def blocks(self, wanted: Flags) -> Iterator[Keys]:
        """Yield the wanted runs that are not on disk in blocks of about the same
        duration.
        """
        todo = wanted & ~self.found.done
        self._total = int(wanted.sum())
        self._cost_wanted = float(wanted.sum(axis=1) @ self._cost)
        self._cost_left = float(todo.sum(axis=1) @ self._cost)
        samples, flat, start = todo.shape[1], todo.reshape(-1), 0
        while start < flat.size:
            # The indices of all runs at once would take eight times the memory of
            # `todo`.
            stop = start + SCAN
            index = start + np.flatnonzero(flat[start:stop])[:MAX_BLOCK_RUNS]
            start = stop
            if len(index):
                count = min(self._block_size(self._cost[index // samples]), len(index))
                is_end = stop >= flat.size and len(index) < MAX_BLOCK_RUNS
                if is_end and len(index) - count < count // 4:
                    count = len(index)  # no small block at the end
                start = int(index[count - 1]) + 1
                yield np.divmod(index[:count], samples)

    def _block_size(self, cost: Floats) -> int:
        """Return how many of the next runs, which have these costs, make a block."""
        lanes, total = LANES * self.threads, np.cumsum(cost)
        busy = RUNS_PER_LANE * lanes
        if not self._recent:
            budget = FIRST_BLOCK_SECONDS * FIRST_RATE * self.threads
            return max(int(np.searchsorted(total, budget, "right")), busy)
        recent_cost, seconds = np.sum(self._recent, axis=0)
        rate = recent_cost / max(seconds, 1e-6)
        target = int(np.searchsorted(total, BLOCK_SECONDS * rate, "right"))
        most = int(np.searchsorted(total, MAX_BLOCK_SECONDS * rate, "right"))
        return max(target, min(busy, max(most, lanes)))

    def time_block(self, keys: Keys, seconds: float) -> None:
        """Record how long the kernel took for a block."""
        self.kernel_seconds += seconds
        self._recent.append((float(self._cost[keys[0]].sum()), seconds))

    def write(self, table: pa.Table) -> None:
        """Write rows to disk, and count them."""
        with _signals_deferred():
            self.stored.append(table, self.plan.config.classify.as_text)
            self.found.add(table)
            self.runs += len(table)
            self.done += len(table)
            cost = float(self._cost[keys_of(table)[0]].sum())
            self._cost_left -= cost
            self._cost_done += cost

    def tick(self, keys: Keys | None = None, control: Control | None = None) -> None:
        """Report progress, including the block under way; raise OutOfTime after the
        deadline.
        """
        now = time.monotonic()
        cost, ended = 0.0, 0  # what is done of the block under way
        if keys is not None and control is not None:
            cost, ended = (
                control.done * float(self._cost[keys[0]].sum()),
                control.runs_done,
            )
        left, done = max(0.0, self._cost_left - cost), self._cost_done + cost
        spent = 0.0 if self.begun is None else now - self.begun
        if (
            self._cost_wanted
        ):  # a new wave raises the total, which must not lower the fraction
            self._fraction = max(self._fraction, 1.0 - left / self._cost_wanted)
        seconds_left = left * spent / done if spent and done > 0 else None
        self.report(
            Progress(self._fraction, self.runs + ended, self._total, seconds_left)
        )
        if now >= self.deadline and (self.done or ended or spent >= GRACE):
            raise OutOfTime


@contextlib.contextmanager
def _signals_deferred() -> Iterator[None]:
    """Defer Ctrl-C and SIGTERM to the end of the body."""
    is_main = (
        threading.current_thread() is threading.main_thread()
    )  # only it receives signals
    numbers = (signal.SIGINT, signal.SIGTERM) if is_main else ()
    received: list[int] = []
    handlers = {
        n: signal.signal(n, lambda number, _: received.append(number)) for n in numbers
    }
    try:
        yield
    finally:
        for n, handler in handlers.items():
            signal.signal(n, signal.SIG_DFL if handler is None else handler)
        for number in received:
            signal.raise_signal(number)


def integrate_plan(
    plan: Plan,
    threads: int | None = None,
    report: Callable[[float], None] = lambda fraction: None,
) -> pa.Table:
    """Return the rows of all runs of a plan, without a directory; `report` gets the
    share done.
    """
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
