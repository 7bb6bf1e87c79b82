"""What an engine is given to work off, and what a sweep comes to."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.sweeps.engines.remainder import Remainder

if TYPE_CHECKING:
    import pyarrow as pa

    from rattlesweep.sweeps.cases.plan import Block, Plan
    from rattlesweep.sweeps.engines.progress import Tracker
    from rattlesweep.sweeps.engines.session import Session
    from rattlesweep.sweeps.store.manifest import Receipt

# Seconds for which a session in which no run has ended yet goes on after its time is up, so that
# the same command again and again comes to an end, however short the time.
GRACE = 5.0


@dataclass
class Result:
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
    begun : float
        The same, when the engine was ready to integrate; 0 before.
    """

    session: Session
    tracker: Tracker
    result: Result
    threads: int
    deadline: float | None
    begun: float = 0.0

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

    def wrote(self, block: Block, receipt: Receipt, rows: int, seconds: float | None) -> None:
        """Count a block into which so many new rows were written; not all, if it was stopped."""
        self.result.blocks += self.session.wrote(block.index, receipt, seconds)
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
