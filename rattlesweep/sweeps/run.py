"""Run a sweep: what is wanted, minus what is on disk, goes through an engine into files.

An engine, such as :func:`local`, takes blocks of keys and writes the rows that come of them.
"""

from __future__ import annotations

import contextlib
import re
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.arrays import Flags, Integers
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.integrate.batch import Control, available_threads
from rattlesweep.integrate.lanes.lane import LANES
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import Prepared, compute, load_kernel, prepare_runs
from rattlesweep.sweeps.cost import case_costs
from rattlesweep.sweeps.decide import Refining, Stopping, decides, decision
from rattlesweep.sweeps.files import explained
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.provenance import Session, hold, manifest_lock
from rattlesweep.sweeps.rows import Found, free_path, keys_of
from rattlesweep.sweeps.stored import (
    Stored,
    begin,
    check_empty,
    examine,
    remove_summary,
    start_over,
)
from rattlesweep.sweeps.summary import summarise, write_summary
from rattlesweep.sweeps.types import with_types

Keys = tuple[Integers, Integers]  # cases and samples of some runs

SECONDS = 3.0  # that a block should take, and so what a kill or a lost worker costs
# That it may take where runs are so long that it would otherwise leave lanes without work.  Fewer
# runs than lanes are no faster: a block then takes as long as its longest run.
MOST_SECONDS = 30.0
FIRST_SECONDS, FIRST_RATE = 0.3, 2e6  # of the first block; cost that a thread does in a second
MOST_ROWS = 50_000  # runs of a block: a few hundred bytes each while it is under way
ROUNDS = 4  # runs of a block for each lane, so that all lanes are in use most of the time
AT_ONCE = 1 << 20  # runs of which it is looked up at a time whether they are left to do
GATHER = 2.0  # seconds for which a stop waits for the rows of the block under way
# Seconds for which a session in which no run has ended goes on after its time is up, so that the
# same command again and again comes to an end, however short the time.
GRACE = 5.0


@dataclass(frozen=True)
class Progress:
    """How far a sweep is."""

    fraction: float  # of the expected cost, rows found on disk included
    runs: int  # done
    total: int  # wanted
    elapsed: float  # seconds since the start
    left: float | None  # seconds, estimated; None as long as there is nothing to judge by


class OutOfTime(BaseException):
    """The time that a session has been given is over."""


@dataclass
class Result:
    """What a session came to."""

    directory: Path
    runs: int = 0  # rows on disk of those that were wanted
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
    missing: int = 0  # runs of other shards that are not on disk

    @property
    def kept(self) -> str:
        """What is left after a stop, for the user."""
        return f"{self.runs:,} runs are kept, {self.lost:,} in flight were lost"


@dataclass
class Job:
    """The work of a session."""

    plan: Plan
    stored: Stored  # where the rows go
    found: Found  # what is there
    result: Result
    threads: int
    report: Callable[[Progress], None] = lambda progress: None  # called some times a second
    decide: Stopping | Refining | None = None  # says by the rows which runs are wanted
    deadline: float | None = None  # of `time.monotonic`
    resources: ExitStack = field(default_factory=ExitStack)  # what an engine keeps between waves

    def __post_init__(self) -> None:
        cases = len(self.plan.cases)
        self._start = time.monotonic()
        self._begun: float | None = None
        self._cost = case_costs(self.plan)
        self._wanted = self._left = np.zeros(cases)  # runs of each case
        self._expected, self._steps = np.zeros(cases), np.zeros(cases)  # of the runs done, by case
        self._recent: deque[tuple[float, float]] = deque(maxlen=8)  # cost and seconds of blocks
        self._shown = 0.0  # fraction that was reported last

    def blocks(self, wanted: Flags) -> Iterator[Keys]:
        """Cut what is left to do of these runs into blocks of about the same expected time."""
        todo = wanted & ~self.found.done
        self._wanted, self._left = wanted.sum(axis=1), todo.sum(axis=1)
        return self._cut(todo)

    def _cut(self, todo: Flags) -> Iterator[Keys]:
        samples, flat, waiting = todo.shape[1], todo.reshape(-1), np.zeros(0, dtype=np.int64)
        for start in range(0, flat.size, AT_ONCE):
            # Places of all runs at once would take eight times the room of `todo`.
            waiting = np.append(waiting, start + np.flatnonzero(flat[start : start + AT_ONCE]))
            last = start + AT_ONCE >= flat.size
            while len(waiting) >= (1 if last else 2 * MOST_ROWS):
                budget = FIRST_RATE * self.threads * FIRST_SECONDS
                if self._recent:
                    cost, seconds = np.sum(self._recent, axis=0)
                    budget = cost / max(seconds, 1e-6) * SECONDS
                sums = np.cumsum(self._cost[waiting[:MOST_ROWS] // samples])
                fit, most = np.searchsorted(
                    sums, [budget, budget * MOST_SECONDS / SECONDS], "right"
                )
                lanes = LANES * self.threads
                least = min(ROUNDS * lanes, max(most, lanes)) if self._recent else ROUNDS * lanes
                count = min(max(fit, least), len(sums))
                if last and len(waiting) - count < count // 4:
                    count = len(waiting)  # no small block at the end
                yield np.divmod(waiting[:count], samples)
                waiting = waiting[count:]

    def worked(self, keys: Keys, seconds: float) -> None:
        """Take note of how long a block has taken."""
        self.result.kernel_seconds += seconds
        self._recent.append((float(self._cost[keys[0]].sum()), seconds))

    def write(self, table: pa.Table) -> None:
        """Write rows to the disk, and count them."""
        if not len(table):
            return
        with _undisturbed():
            typed, stored = self.plan.config.classify.as_text, self.stored
            stored.runs.append(table, stored.hash, typed, stored.cases)
            self.found.add(table)
            self.result.runs += len(table)
            self.result.done += len(table)
            if self.decide is not None:
                self.decide.add(table)
            case, _ = keys_of(table)
            np.subtract.at(self._left, case, 1)
            np.add.at(self._expected, case, self._cost[case])
            np.add.at(self._steps, case, table.column("n_steps").to_numpy())

    def begin(self) -> None:
        """Say that work begins now: what came before, such as compilation, is no rate."""
        self._begun = self._begun or time.monotonic()

    def tick(self, keys: Keys | None = None, control: Control | None = None) -> None:
        """Report progress, with what the kernel says of the block under way; raise OutOfTime if
        the session's time is over.
        """
        # Most runs end before their horizon, and how many do differs from case to case.
        overall = self._steps.sum() / self._expected.sum() if self._steps.any() else 1.0
        factors = np.full(len(self._cost), overall)
        np.divide(self._steps, self._expected, out=factors, where=self._steps > 0)
        cost = self._cost * factors
        whole, left, done = self._wanted @ cost, self._left @ cost, self._expected @ factors
        runs, ended = int((self._wanted - self._left).sum()), self.result.done
        if keys is not None and control is not None and control.total > 0:
            part = cost[keys[0]].sum() * min(1.0, control.done / control.total)
            left, done = left - part, done + part
            runs, ended = runs + control.runs_done, ended + control.runs_done
        now, remaining, fraction = time.monotonic(), None, float(1.0 - left / whole)
        if self._begun is not None and done > 0:
            remaining = max(0.0, float(left * (now - self._begun) / done))
        # Waves, and what is learned of later cases, can make what is done less.
        self._shown = min(1.0, max(self._shown, fraction))
        total = int(self._wanted.sum())
        self.report(Progress(self._shown, runs, total, now - self._start, remaining))
        waited = self._begun is not None and now >= self._begun + GRACE
        if self.deadline is not None and now >= self.deadline and (ended or waited):
            raise OutOfTime

    def complete(self) -> None:
        """Report that nothing is left to do."""
        total = int(self._wanted.sum())
        self.report(Progress(1.0, total, total, time.monotonic() - self._start, 0.0))


Engine = Callable[[Job, Iterator[Keys]], None]
"""Given blocks of keys, writes their rows by :meth:`Job.write`, in any order and cut in any way.
When it is stopped, by Ctrl-C or :class:`OutOfTime`, it writes the rows that it has and raises that
again."""


def local(job: Job, blocks: Iterator[Keys]) -> None:
    """Compute blocks on this machine, one after the other.

    The kernel runs in a thread of its own, without the interpreter's lock.  Meanwhile the main
    thread writes the block before, prepares the one after, reports progress and hears Ctrl-C.
    """
    plan = job.plan
    loading = Task(lambda _: load_kernel(plan.config))
    task: Task[tuple[pa.Table, int]] | None = None
    finished: list[pa.Table] = []

    def write() -> None:
        while finished:
            job.write(finished.pop())
            job.tick()

    def prepare() -> tuple[Keys, Prepared] | None:
        keys = next(blocks, None)
        return None if keys is None else (keys, prepare_runs(plan, *keys))

    try:
        ready = prepare()  # bodies are drawn while the kernel is loaded
        job.result.load_seconds += loading.wait()
        job.begin()
        while ready is not None:
            keys, prepared = ready
            task = Task(partial(compute, plan.config, plan.schema, prepared, job.threads))
            write()
            ready = prepare()
            table, _ = task.wait(partial(job.tick, keys))
            job.worked(keys, task.seconds)
            finished, task = [table], None
        write()
    except BaseException as error:
        if task is not None:
            task.stop(GATHER)
        if isinstance(error, Exception):
            raise
        while finished:
            job.write(finished.pop())
        if task is not None:
            with contextlib.suppress(TimeoutError):
                table, lost = task.value()
                job.result.lost += lost
                job.write(table)
        raise


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait until the body has ended."""
    main = threading.current_thread() is threading.main_thread()  # others hear no signals
    numbers = (signal.SIGINT, signal.SIGTERM) if main else ()
    heard: list[int] = []
    before = {n: signal.signal(n, lambda number, _: heard.append(number)) for n in numbers}
    try:
        yield
    finally:
        for n, handler in before.items():
            signal.signal(n, signal.SIG_DFL if handler is None else handler)
        for number in heard:
            signal.raise_signal(number)


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
        check_empty(directory)
    else:
        examine(plan, directory)  # before anything is made there
    with explained(f"cannot write in {directory}"):
        directory.mkdir(parents=True, exist_ok=True)
    name, how = None if shard is None else shard.name, "failed"
    result = Result(directory)
    with contextlib.ExitStack() as held:
        with manifest_lock(directory):
            held.enter_context(hold(directory, name))
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
