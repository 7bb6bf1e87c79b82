"""How far a sweep is, by what its runs are expected to cost, and what it comes to."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa

from rattlesweep.integrate.batch import Control
from rattlesweep.sweeps.cost import Costs
from rattlesweep.sweeps.plan import Block


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
        self._start = time.monotonic()
        self.begun: float | None = None  # of time.monotonic

    def begin(self) -> None:
        """Say that work begins now: what came before, such as compilation, is no rate."""
        self.begun = time.monotonic()

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
        now, left = time.monotonic(), None
        if done > 0:
            # Rounding may have done exceed the whole by a last bit.
            left = max(0.0, self._left - done) * (now - (self.begun or self._start)) / done
        fraction = 1.0
        if self._total > 0:
            fraction = min(1.0, 1.0 - (self._left - done) / self._total)
        progress = Progress(fraction, runs, self._all_runs, now - self._start, left)
        self._report(progress)
        return progress
