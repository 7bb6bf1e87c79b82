"""Run a sweep: what is wanted, minus what is on disk, goes through an engine into files."""

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
from rattlesweep.integrate.batch import Control, available_threads
from rattlesweep.integrate.lanes.lane import LANES
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import compute, load_kernel, prepare_runs
from rattlesweep.sweeps.columns import read_parquet
from rattlesweep.sweeps.config.schema import Classify
from rattlesweep.sweeps.cost import case_costs
from rattlesweep.sweeps.decide import Refining, Stopping, decides, decision
from rattlesweep.sweeps.files import explained
from rattlesweep.sweeps.plan import Plan, begin, examine
from rattlesweep.sweeps.provenance import MANIFEST_LOCK, hold, locked, session
from rattlesweep.sweeps.stored import Found, Stored, free_path, keys_of, rewrite
from rattlesweep.sweeps.summary import summarise, write_summary
from rattlesweep.sweeps.types import with_types

Keys = tuple[Integers, Integers]  # cases and samples of some runs

SECONDS = 3.0  # that a block should take, and so what a kill or a lost worker costs
MOST_SECONDS = 30.0  # that it may take where it would otherwise leave lanes without work
FIRST_SECONDS, FIRST_RATE = 0.3, 2e6  # of the first block; cost that a thread does in a second
MOST_ROWS = 50_000  # runs of a block: a few hundred bytes each while it is under way
ROUNDS = 4  # runs of a block for each lane, so that all lanes are in use most of the time
AT_ONCE = 1 << 20  # runs of which it is looked up at a time whether they are left to do
IN_MEMORY = 100_000  # runs that are integrated at a time without a directory: 100 MB
GATHER = 2.0  # seconds for which a stop waits for the rows of the block under way
GRACE = 5.0  # seconds after its time is up for which a session goes on until a first run has ended


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
class Job:
    """The work of a session, and what it has come to."""

    plan: Plan
    stored: Stored  # where the rows go
    found: Found  # what is there
    threads: int
    report: Callable[[Progress], None] = lambda progress: None  # called some times a second
    decide: Stopping | Refining | None = None  # says by the rows which runs are wanted
    deadline: float = math.inf  # of `time.monotonic`
    begun: float | None = None  # set by engines once the kernel is loaded, which is no rate
    runs: int = 0  # rows on disk of those that are wanted
    done: int = 0  # runs integrated in this session
    kernel_seconds: float = 0.0
    seconds: float = 0.0
    stopped: str | None = None  # why it ended before all was done
    summary: pa.Table | None = None  # one row a case; None unless the whole sweep is done
    missing: int = 0  # runs of other shards that are not on disk

    def __post_init__(self) -> None:
        self._start, self._cost = time.monotonic(), case_costs(self.plan)
        self._whole = self._left = self._did = 0.0  # cost wanted, left to do, and done by this job
        self._total, self._shown = 0, 0.0  # runs wanted; fraction that was reported last
        self._recent: deque[tuple[float, float]] = deque(maxlen=8)  # cost and seconds of blocks

    @property
    def failed(self) -> Counter[str]:
        """Runs on disk by status, if not ok."""
        return self.found.status - Counter(ok=self.found.status["ok"])

    def blocks(self, wanted: Flags) -> Iterator[Keys]:
        """Cut what is left to do of these runs into blocks of about the same expected time."""
        todo = wanted & ~self.found.done
        samples, flat, at = todo.shape[1], todo.reshape(-1), 0
        self._total = int(wanted.sum())
        self._whole, self._left = (float(runs.sum(axis=1) @ self._cost) for runs in (wanted, todo))
        while at < flat.size:
            # Places of all runs at once would take eight times the room of `todo`.
            places = at + np.flatnonzero(flat[at : at + AT_ONCE])[:MOST_ROWS]
            last = at + AT_ONCE >= flat.size and len(places) < MOST_ROWS
            at += AT_ONCE
            if len(places):
                count = min(self._size(np.cumsum(self._cost[places // samples])), len(places))
                if last and len(places) - count < count // 4:
                    count = len(places)  # no small block at the end
                at = int(places[count - 1]) + 1
                yield np.divmod(places[:count], samples)

    def _size(self, costs: Floats) -> int:  # of a block of runs of these costs up to each
        lanes = LANES * self.threads
        if not self._recent:
            few = np.searchsorted(costs, FIRST_RATE * self.threads * FIRST_SECONDS, "right")
            return max(int(few), ROUNDS * lanes)
        cost, seconds = np.sum(self._recent, axis=0)
        times = np.array([SECONDS, MOST_SECONDS]) * cost / max(seconds, 1e-6)
        fit, most = np.searchsorted(costs, times, "right")
        return int(max(fit, min(ROUNDS * lanes, max(most, lanes))))

    def worked(self, keys: Keys, seconds: float) -> None:
        """Take note of how long a block has taken."""
        self.kernel_seconds += seconds
        self._recent.append((float(self._cost[keys[0]].sum()), seconds))

    def write(self, table: pa.Table) -> None:
        """Write rows to the disk, and count them."""
        if not len(table):
            return
        with _undisturbed():
            self.stored.append(table, self.plan.config.classify.as_text)
            self.found.add(table)
            if self.decide is not None:
                self.decide.add(table)
            self.runs, self.done = self.runs + len(table), self.done + len(table)
            cost = float(self._cost[keys_of(table)[0]].sum())
            self._left, self._did = self._left - cost, self._did + cost

    def tick(self, keys: Keys | None = None, control: Control | None = None) -> None:
        """Report progress, also of the block under way; raise OutOfTime if the time is over."""
        part, ended, now = 0.0, 0, time.monotonic()
        if keys is not None and control is not None and control.total > 0:
            part = self._cost[keys[0]].sum() * min(1.0, control.done / control.total)
            ended = control.runs_done
        left, did = max(0.0, self._left - part), self._did + part
        spent = 0.0 if self.begun is None else now - self.begun
        remaining = float(left * spent / did) if spent and did > 0 else None
        if self._whole:  # a wave may make what is done less
            self._shown = max(self._shown, float(1.0 - left / self._whole))
        elapsed, waited = now - self._start, spent >= GRACE
        self.report(Progress(self._shown, self.runs + ended, self._total, elapsed, remaining))
        if now >= self.deadline and (self.done or ended or waited):
            raise OutOfTime


Engine = Callable[[Job, Iterator[Keys]], None]
"""Given blocks of keys, writes their rows by :meth:`Job.write`, in any order and cut in any way.
When it is stopped, by Ctrl-C or :class:`OutOfTime`, it writes the rows that it has and raises that
again."""


def local(job: Job, blocks: Iterator[Keys]) -> None:
    """Compute blocks on this machine; meanwhile, write the one before and prepare the next."""
    plan = job.plan
    loading = Task(lambda _: load_kernel(plan.config))
    tasks: list[Task[tuple[pa.Table, int]]] = []  # the one whose rows are to be written comes first
    try:
        for before, keys in pairwise(chain([None], blocks, [None])):
            # While the kernel is loaded, or the block before is computed.
            prepared = None if keys is None else prepare_runs(plan, *keys)
            loading.wait()
            job.begun = job.begun or time.monotonic()
            if before is not None:
                tasks[0].wait(partial(job.tick, before))
                job.worked(before, tasks[0].seconds)
            if prepared is not None:
                tasks += [Task(partial(compute, plan.config, plan.schema, prepared, job.threads))]
            if before is not None:
                job.write(tasks.pop(0).value()[0])
                job.tick()
    except BaseException as error:
        for task in tasks:
            task.stop(GATHER)
        if isinstance(error, Exception):
            raise
        for task in tasks:
            with contextlib.suppress(TimeoutError):
                job.write(task.value()[0])
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
        """Read ``I/N``; a ValueError says what is wrong with it."""
        match = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
        if not match or int(match[1]) >= int(match[2]):
            raise ValueError("is not I/N; write it as in --shard 0/4, with I from 0 to N-1")
        return cls(int(match[1]), int(match[2]))

    def runs(self, shape: tuple[int, ...]) -> Flags:
        """Return which runs are the shard's: neighbours go to different ones, which cost alike."""
        case, sample = (np.arange(n) % self.count for n in shape)
        mine: Flags = (case[:, None] + sample) % self.count == self.index
        return mine


def run_sweep(
    plan: Plan, directory: Path, *, base: Path | None = None, threads: int | None = None,
    report: Callable[[Progress], None] = lambda progress: None, shard: Shard | None = None,
    max_time: float | None = None, retry_failed: bool = False, engine: Engine = local,
) -> Job:  # fmt: skip
    """Do the runs of a plan that are not on disk; a stop, or `max_time`, keeps what has ended."""
    start, threads = time.monotonic(), threads or available_threads()
    if shard is not None and retry_failed:
        raise ConfigError("--retry-failed: takes rows of other shards too; run it without --shard")
    if shard is not None and (key := decides(plan.config)):
        raise ConfigError(f"{key}: what is run next depends on all runs, so there are no shards")
    examine(plan, directory)  # before anything is made there
    with explained(f"cannot write in {directory}"):
        directory.mkdir(parents=True, exist_ok=True)
    name = None if shard is None else f"shard-{shard.index}-of-{shard.count}"
    with contextlib.ExitStack() as held:
        with locked(directory, MANIFEST_LOCK):  # shards that begin at once begin or grow it once
            held.enter_context(hold(directory, name))
            stored = begin(plan, directory, base, name)
        plan = replace(plan, cases=stored.cases)
        record = held.enter_context(session(directory, name, threads))
        found = _find(stored, plan.config.classify, shard, retry_failed)
        decide = decision(plan.config, plan.cases, plan.samples)
        if decide is not None:
            decide.read(stored)
        deadline = start + (math.inf if max_time is None else max_time)
        job = Job(plan, stored, found, threads, report, decide, deadline)
        try:
            _work(job, shard, engine)
            if job.stopped is None:
                if shard is not None:  # others have gone on meanwhile
                    job.missing = plan.runs - stored.count()
                if not job.missing:
                    job.summary = summarise(stored)
                    write_summary(stored, job.summary)
            record["how"] = "stopped" if job.stopped else "complete"
        finally:
            job.seconds = time.monotonic() - start
            record |= {"runs": job.done, "seconds": round(job.seconds, 3)}
            record["kernel_seconds"] = round(job.kernel_seconds, 3)
    return job


def _find(stored: Stored, thresholds: Classify, shard: Shard | None, retry: bool) -> Found:
    found = stored.find()
    with explained(f"cannot rename a file in {stored.folder}"):
        found.damaged = [p.rename(free_path(p.with_suffix(".damaged"))) for p in found.damaged]
    stale = {p for text in found.typed.keys() - {thresholds.as_text} for p in found.typed[text]}
    if stale and shard is not None:
        told = "its runs are typed by other thresholds than those of the config"
        then = "run `rattlesweep classify` there before its shards go on"
        raise ConfigError(f"{stored.directory}: {told}; {then}")
    retry = retry and found.rows > found.status["ok"]
    if retry or stale:
        stored.drop_summary()
    for path in stored.files() if retry else stale:
        rows = with_types(read_parquet(path), thresholds)
        kept = rows.filter(pc.equal(rows.column("status"), "ok")) if retry else rows
        if path in stale or len(kept) < len(rows):
            rewrite(path, kept, thresholds.as_text)
    return replace(stored.find(), damaged=found.damaged) if retry else found


def _work(job: Job, shard: Shard | None, engine: Engine) -> None:
    done = job.found.done
    while True:  # once, or for each wave where the sweep decides what to run next
        wanted = np.ones_like(done) if shard is None else shard.runs(done.shape)
        if job.decide is not None:
            wanted = job.decide.wanted()
        job.runs = int((wanted & done).sum())
        if done[wanted].all():
            return
        job.stored.drop_summary()
        try:
            engine(job, job.blocks(wanted))
        except OutOfTime:
            if not done[wanted].all():  # it may be up when the last run has ended
                few = "the time was up before one run had ended, give more"
                job.stopped = "the time is up" if job.done else few
                return
        except BaseException as error:
            if not isinstance(error, Exception):
                error.add_note(f"{job.runs:,} runs are kept")
            raise
        if left := int((wanted & ~done).sum()):
            raise OutputError(f"{left} runs did not come back from the engine; run it again")


def integrate_plan(
    plan: Plan, threads: int | None = None, report: Callable[[float], None] = lambda fraction: None
) -> pa.Table:
    """Return the rows of all runs of a plan; `report` is called with the share that is done."""
    load_kernel(plan.config)
    tables = [plan.schema.remove_metadata().empty_table()]
    for start in range(0, plan.runs, IN_MEMORY):
        places = np.arange(start, min(start + IN_MEMORY, plan.runs))

        def tick(control: Control, start: int = start, runs: int = len(places)) -> None:
            share = control.done / control.total if control.total > 0 else 0.0
            report((start + runs * min(1.0, share)) / plan.runs)

        prepared = prepare_runs(plan, *np.divmod(places, plan.samples))
        task = Task(partial(compute, plan.config, plan.schema, prepared, threads))
        tables.append(task.wait(tick)[0])
    report(1.0)
    return pa.concat_tables(tables)
