"""What an engine works off: the runs that are left to do, in blocks, until it is told to stop."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.integrate.batch import Control
from rattlesweep.integrate.lanes.lane import LANES
from rattlesweep.sweeps.plan import Plan

Keys = tuple[Integers, Integers]
"""Cases and samples of some runs."""

SECONDS = 3.0
"""Time that a block should take, and so what a kill or a lost worker costs."""
FIRST_SECONDS = 0.3
FIRST_RATE = 2e6
"""Expected cost that a thread works off in a second, until blocks have told."""
MOST_ROWS = 50_000
"""Runs of a block: a few hundred bytes each while it is under way."""
ROUNDS = 4
"""Runs of a block for each lane at least, so that all lanes are in use most of the time."""
GRACE = 5.0
"""Seconds for which a session in which no run has ended goes on after its time is up, so that the
same command again and again comes to an end, however short the time."""


@dataclass(frozen=True)
class Progress:
    """How far a sweep is."""

    fraction: float  # of the expected cost, rows found on disk included
    runs: int  # done
    total: int  # wanted
    elapsed: float  # seconds since the start
    left: float | None  # seconds, estimated; None as long as there is nothing to judge by


class OutOfTime(Exception):
    """The time that a session has been given is over."""


@dataclass
class Job:
    """The work of a session.

    Parameters
    ----------
    plan : Plan
    threads : int
    cost : ndarray, shape (cases,)
        Expected cost of a run of each case.
    report : callable
        Called with a :class:`Progress` some times a second.
    deadline : float or None
        Time of ``time.monotonic`` at which to stop.
    """

    plan: Plan
    threads: int
    cost: Floats
    report: Callable[[Progress], None]
    deadline: float | None = None
    seconds: float = SECONDS
    done: int = 0  # runs done in this session
    kernel_seconds: float = 0.0
    load_seconds: float = 0.0
    lost: int = 0  # runs that were under way when it was stopped
    waves: bool = False  # whether more may be wanted once this is done
    remarks: list[str] = field(default_factory=list)
    resources: ExitStack = field(default_factory=ExitStack)  # what an engine keeps between waves
    _start: float = field(default_factory=time.monotonic)
    _begun: float | None = None
    _wanted: int = 0
    _shown: float = 0.0  # what was reported last, and when the wave began
    _base: float = 0.0
    _todo: Any = None  # runs of each case that were to do, and that are left
    _left: Any = None
    _expected: Any = None  # expected cost and steps of the runs done, by case
    _steps: Any = None
    _rate: float | None = None
    _recent: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=8))

    def count(self, wanted: int, todo: Flags) -> None:
        """Say what is wanted and what is left to do of it."""
        cases = len(self.cost)
        if self._steps is None:
            self._expected, self._steps = np.zeros(cases), np.zeros(cases)
        self._base = self._shown
        self._left = todo.sum(axis=1)
        self._wanted, self._todo = wanted, self._left.copy()

    # ----------------------------------------------------------------- blocks

    def blocks(self, todo: Flags) -> Iterator[Keys]:
        """Cut what is left to do into blocks of about the same expected time, in order."""
        least = ROUNDS * LANES * self.threads
        case = np.zeros(0, dtype=np.int64)
        sample = np.zeros(0, dtype=np.int64)
        rows, samples = todo.shape
        step = max(1, 4 * MOST_ROWS // samples)
        for first in range(0, rows, step):
            # A few cases at a time: the keys of a large sweep take eight times the room of `todo`.
            more_case, more_sample = np.nonzero(todo[first : first + step])
            case = np.concatenate([case, more_case + first])
            sample = np.concatenate([sample, more_sample])
            last = first + step >= rows
            while len(case):
                sums = np.cumsum(self.cost[case[:MOST_ROWS]])
                count = max(least, int(np.searchsorted(sums, self._block_cost(), side="right")))
                count = min(count, MOST_ROWS, len(case))
                if not last and count == len(case):
                    break  # the next cases may belong to this block
                if last and len(case) - count < count // 4 and len(case) <= MOST_ROWS:
                    count = len(case)  # no small block at the end
                yield case[:count], sample[:count]
                case, sample = case[count:], sample[count:]

    def _block_cost(self) -> float:
        if self._rate is None:
            return FIRST_RATE * self.threads * FIRST_SECONDS
        return self._rate * self.seconds

    def worked(self, keys: Keys, seconds: float) -> None:
        """Take note of how long a block has taken."""
        self.kernel_seconds += seconds
        self._recent.append((float(self.cost[keys[0]].sum()), seconds))
        cost, time_ = map(sum, zip(*self._recent, strict=True))
        self._rate = cost / max(time_, 1e-6)

    # --------------------------------------------------------------- progress

    def begin(self) -> None:
        """Say that work begins now: what came before, such as compilation, is no rate."""
        self._begun = self._begun or time.monotonic()

    def wrote(self, table: pa.Table) -> None:
        """Count rows that are on disk now."""
        case = table.column("case").to_numpy()
        self.done += len(case)
        np.subtract.at(self._left, case, 1)
        np.add.at(self._expected, case, self.cost[case])
        np.add.at(self._steps, case, table.column("n_steps").to_numpy().astype(float))

    def tick(self, keys: Keys | None = None, control: Control | None = None) -> None:
        """Report progress, with what the kernel says of the block under way.

        Raises
        ------
        OutOfTime
            If the session's time is over.
        """
        factors = self._factors()
        left, done = float((self._left * self.cost) @ factors), float(self._expected @ factors)
        part, runs = 0.0, 0
        if keys is not None and control is not None and control.total > 0:
            part = float((self.cost * factors)[keys[0]].sum()) * min(
                1.0, control.done / control.total
            )
            runs = control.runs_done
        now, remaining = time.monotonic(), None
        if self._begun is not None and done + part > 0:
            remaining = max(0.0, left - part) * (now - self._begun) / (done + part)
        # Rows found on disk are taken to be like the rest.
        todo = int(self._todo.sum())
        whole = float((self._todo * self.cost) @ factors) * self._wanted / max(1, todo)
        there = self._wanted - int(self._left.sum())
        fraction = 1.0 - (left - part) / whole if whole > 0 else there / max(1, self._wanted)
        fraction = min(1.0, max(0.0, fraction))
        if self.waves:  # nobody knows how many follow
            fraction = self._base + (1.0 - self._base) * fraction / 2
        # What is learned of later cases can make what is done less.
        self._shown = max(self._shown, fraction)
        elapsed = now - self._start
        self.report(Progress(self._shown, there + runs, self._wanted, elapsed, remaining))
        if self.over(self.done > 0 or runs > 0):
            raise OutOfTime

    def complete(self) -> None:
        """Report that nothing is left to do."""
        elapsed = time.monotonic() - self._start
        self.report(Progress(1.0, self._wanted, self._wanted, elapsed, 0.0))

    def _factors(self) -> Floats:
        """Return how many steps the runs of each case take for each unit of expected cost.

        Most runs end before their horizon, and how many do differs from case to case.
        """
        factors = np.ones(len(self.cost))
        if self._steps.sum() > 0 and self._expected.sum() > 0:
            factors[:] = self._steps.sum() / self._expected.sum()
            np.divide(
                self._steps, self._expected, out=factors, where=self._steps * self._expected > 0
            )
        return factors

    def over(self, some_done: bool = True) -> bool:
        """Return whether the time is over; a session without a finished run gets a little more."""
        if self.deadline is None or time.monotonic() < self.deadline:
            return False
        return some_done or (self._begun is not None and time.monotonic() >= self._begun + GRACE)


Engine = Callable[[Job, Iterator[Keys]], Iterator[pa.Table]]
"""Given blocks of keys, yields tables of rows, in any order and cut in any way.  What is thrown
into it, such as a KeyboardInterrupt, it raises again after it has yielded the rows that are
done."""
