"""What an engine is given to work off, how far it is, and what a sweep comes to.

How far it is goes by what runs are expected to cost.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa

from rattlesweep.integrate.batch import Control
from rattlesweep.sweeps.cases.costs import Costs
from rattlesweep.sweeps.cases.plan import Block, Plan
from rattlesweep.sweeps.engines.remainder import Remainder
from rattlesweep.sweeps.engines.session import Session
from rattlesweep.sweeps.store.manifest import Receipt

# Seconds for which a session in which no run has ended yet goes on after its time is up, so that
# the same command again and again comes to an end, however short the time.
GRACE = 5.0


@dataclass
class Result:
    """What a sweep, or a share of it, came to."""

    directory: Path
    runs: int = 0  # in place
    resumed_runs: int = 0  # of these, found on disk
    blocks: int = 0  # written by this session
    done: int = 0  # runs that this session has integrated
    retried: int = 0  # of these, runs that had failed before
    lost: int = 0  # runs that were under way when it was stopped
    seconds: float = 0.0
    kernel_seconds: float = 0.0
    load_seconds: float = 0.0
    stopped: str | None = None  # why it ended before all was done
    remarks: list[str] = field(default_factory=list)  # what the user should know
    failed: Counter[str] = field(default_factory=Counter)  # runs in place by status, if not ok
    summary: pa.Table | None = None  # one row a case; None unless the whole sweep is in place
    missing: int = 0  # blocks of the whole sweep that are not in place

    @property
    def kept(self) -> str:
        """What is left after a stop, for the user."""
        return f"{self.runs:,} runs are kept, {self.lost:,} in flight were lost"


@dataclass(frozen=True)
class Progress:
    """How far a sweep is."""

    fraction: float  # of the expected cost, blocks found on disk included
    runs: int  # done
    total: int  # runs
    elapsed: float  # seconds since the start
    left: float | None  # seconds, estimated; None as long as there is nothing to judge by


class Tracker:
    """Counts what is done of `blocks`, and says how long the rest will take.

    `left` are the runs to integrate, by the numbers of the blocks that are not in place; `report`
    is called with a :class:`Progress` at each tick.
    """

    def __init__(
        self,
        costs: Costs,
        blocks: list[Block],
        left: Mapping[int, int],
        report: Callable[[Progress], None],
    ) -> None:
        self._report, self._rows = report, left
        whole = {block.index: costs.of(block) for block in blocks}
        self._costs = {
            block.index: whole[block.index] * left[block.index] / block.rows
            for block in blocks
            if block.index in left
        }
        self._total, self._left = sum(whole.values()), sum(self._costs.values())
        self._all_runs = sum(block.rows for block in blocks)
        self._runs = self._all_runs - sum(left.values())
        self._done = 0.0
        self._start = time.perf_counter()
        self._begun = 0.0

    def begin(self) -> None:
        """Say that work begins now: what came before, such as compilation, is no rate."""
        self._begun = time.perf_counter() - self._start

    def finish(self, block: Block) -> None:
        """Count a block that is done."""
        self._done += self._costs[block.index]
        self._runs += self._rows[block.index]

    def tick(self, block: Block | None = None, control: Control | None = None) -> Progress:
        """Report, with what the kernel says of the block under way."""
        done, runs = self._done, self._runs
        if block is not None and control is not None and control.total > 0:
            done += self._costs[block.index] * min(1.0, control.done / control.total)
            runs += control.runs_done
        elapsed = time.perf_counter() - self._start
        left = None
        if done > 0:
            # Rounding may have done exceed the whole by a last bit.
            left = max(0.0, self._left - done) * (elapsed - self._begun) / done
        fraction = 1.0
        if self._total > 0:
            fraction = min(1.0, 1.0 - (self._left - done) / self._total)
        progress = Progress(fraction, runs, self._all_runs, elapsed, left)
        self._report(progress)
        return progress


@dataclass
class Job:
    """What an engine is given to work off: the pending blocks of a session."""

    session: Session
    tracker: Tracker
    result: Result
    threads: int
    deadline: float | None  # of time.monotonic, after which no work is to be done
    begun: float = 0.0  # the same, when the engine was ready to integrate; 0 before

    @property
    def plan(self) -> Plan:
        """What is to be done."""
        return self.session.output.plan

    def prepare(self, block: Block) -> Remainder:
        """What is left to do of a pending block."""
        return Remainder.prepare(self.session.output, block, block.index in self.session.begun)

    def begin(self) -> None:
        """Say that the engine is ready to integrate."""
        self.begun = time.monotonic()
        self.tracker.begin()

    def wrote(self, block: Block, receipt: Receipt, rows: int, seconds: float | None) -> None:
        """Count a block into which so many new rows were written; not all, if it was stopped."""
        if self.session.wrote(block.index, receipt, seconds):
            self.result.blocks += 1
            self.tracker.finish(block)
        self.result.done += rows
        self.result.kernel_seconds += seconds or 0.0
        if block.index in self.session.retry:
            self.result.retried += rows

    def tick(self, *where: Any) -> None:
        """Report progress, and note it down now and then."""
        self.session.note(self.tracker.tick(*where))

    def too_late(self, some_done: bool = True) -> bool:
        """Whether to stop; a session in which no run has ended yet is given a little longer."""
        if self.deadline is None or time.monotonic() < self.deadline:
            return False
        return some_done or (self.begun > 0 and time.monotonic() >= self.begun + GRACE)

    def stop(self) -> None:
        """Say that the time was up."""
        if self.result.done:
            self.result.stopped = "the time is up"
        else:
            self.result.stopped = "the time was up before one run had ended, give more"
