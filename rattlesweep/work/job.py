"""The work of a session: which runs come next, and how far it is.

Blocks of runs are cut so that they take about the same time and keep all lanes busy.
The first samples of every case come before the rest, so that a sweep that is stopped
is a preview of all of it.
"""

from __future__ import annotations

import contextlib
import math
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.design.plan import Plan
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.kernel.state.fields import LANES
from rattlesweep.kernel.task import Control
from rattlesweep.rows.arrow import floats
from rattlesweep.store.merging import Writer
from rattlesweep.store.rows import Found, Stored, keys_of
from rattlesweep.work.cost import case_costs

Keys = tuple[Integers, Integers]  # cases and samples of some runs

# Duration of a block, and so what a kill or a lost worker costs.
BLOCK_SECONDS = 3.0
# Duration that is allowed where a shorter block would leave lanes idle.
MAX_BLOCK_SECONDS = 30.0
FIRST_BLOCK_SECONDS = 1.0  # until blocks have been timed, by the rates below
# Expected cost that a thread does in a second, by methods with adaptive or fixed steps.
ADAPTIVE_RATE = 5e7
FIXED_RATE = 2e5
SLIDING_COST = 12.0  # of a step with mu 0.3 over one without, in the paper's ranges
MAX_BLOCK_RUNS = 50_000  # a run takes a few hundred bytes while its block is computed
RUNS_PER_LANE = 16  # in a block: at its end lanes wait for the last runs
RECENT_BLOCKS = 8  # whose rate sets the size of the next
SCANNED_RUNS = 1 << 20  # runs scanned at a time for work left to do
GRACE = 5.0  # seconds past the deadline that a session may take to end its first run
# Samples of each case in the first pass over the cases. A later pass has BLOCK_GROWTH
# times as many samples before it. These are powers of 2, so that bodies that are drawn
# by chunks are drawn once.
FIRST_PASS = 4
BLOCK_GROWTH = 4
PRIOR_RUNS = 8  # runs of a case after which its measured cost outweighs the expected


class OutOfTime(BaseException):
    """The time limit of a session has passed."""


@dataclass(frozen=True)
class Progress:
    """How far a sweep is."""

    # Of the expected cost, including rows that were on disk before; of all runs where
    # `stop` or `bodies.refine` may yet want them.
    fraction: float
    runs: int  # done
    left: float | None  # estimate in seconds; None before there is a base for it


def todo_in_order(todo: Flags, spread: bool = False) -> Iterator[Integers]:
    """Yield cases and samples of runs to do, (2, runs), in passes over all cases.

    A pass takes the cases in turn. Passes take consecutive samples, or every `step`-th
    one if `spread`, for bodies that vary from sample to sample as those of a grid. As
    the keys of each pass are in order, reading files in the order of their keys holds
    few of them at a time.
    """
    cases, samples = todo.shape
    for first, stop, step, known in _passes(samples, spread):
        # A piece has about SCANNED_RUNS runs: many cases, or one in part.
        width = max(1, SCANNED_RUNS // BLOCK_GROWTH) * BLOCK_GROWTH * step
        at_once = max(1, SCANNED_RUNS // max(1, (stop - first) // step))
        for case in range(0, cases, at_once):
            for start in range(first, stop, width):
                end = min(start + width, stop)
                piece = todo[case : case + at_once, start:end:step].copy()
                if known:  # the pass before had every BLOCK_GROWTH-th of these
                    piece[:, ::BLOCK_GROWTH] = False
                row, column = np.nonzero(piece)
                if len(row):
                    yield np.stack([case + row, start + column * step])


def _passes(samples: int, spread: bool) -> Iterator[tuple[int, int, int, bool]]:
    """Yield first, stop and step of the samples of each pass, and if part is known."""
    if not spread:
        first = 0
        stop = FIRST_PASS
        while first < samples:
            yield first, min(stop, samples), 1, False
            first = stop
            stop *= BLOCK_GROWTH
        return
    step = 1
    while samples // step > FIRST_PASS:
        step *= BLOCK_GROWTH
    known = False
    while step:
        yield 0, samples, step, known
        known = True
        step //= BLOCK_GROWTH


@dataclass
class SessionTally:
    """What a session has done so far."""

    # When the kernel was loaded, so that the rate leaves out compile time.
    begun: float | None = None
    on_disk: int = 0  # wanted runs, with those of earlier sessions
    computed: int = 0  # runs
    kernel_seconds: float = 0.0


@dataclass
class Job:
    """The work of a session: what it is given, and the :attr:`tally` of what it did."""

    plan: Plan
    stored: Stored  # where rows are written
    found: Found  # what is on disk
    threads: int
    # Called a few times a second.
    report: Callable[[Progress], None] = lambda progress: None
    deadline: float = math.inf  # of `time.monotonic`
    began: Callable[[], None] = lambda: None  # called when the kernel is loaded

    def __post_init__(self) -> None:
        self.tally = SessionTally()
        self._costs = Costs(case_costs(self.plan))
        self._writer = Writer(self.stored, self.plan.config.classify.as_text)
        method = METHODS[self.plan.config.integrator.method]
        self._first_rate = ADAPTIVE_RATE if method.adaptive else FIXED_RATE
        if self.plan.config.dissipation.slides:
            self._first_rate /= SLIDING_COST
        # Steps and seconds of the last blocks.
        self._recent: deque[tuple[float, float]] = deque(maxlen=RECENT_BLOCKS)
        # Runs of each case that are wanted, and those of them that are not on disk.
        self._wanted = np.zeros(len(self._costs.each), np.int64)
        self._left = self._wanted
        self._fraction = 0.0  # reported last

    def begin(self) -> None:
        """Note that the kernel is loaded, if that is new."""
        if self.tally.begun is None:
            self.tally.begun = time.monotonic()
            self.began()

    def blocks(self, wanted: Flags) -> Iterator[Keys]:
        """Yield the wanted runs that are not on disk, in blocks of about equal time."""
        todo = wanted & ~self.found.done
        self._wanted = wanted.sum(axis=1)
        self._left = todo.sum(axis=1)
        is_spread = self.plan.config.bodies.source in ("grid", "table")
        pieces = todo_in_order(todo, is_spread)
        keys = np.zeros((2, 0), np.int64)  # of the next runs
        is_end = False
        while True:
            while not is_end and keys.shape[1] < MAX_BLOCK_RUNS:
                piece = next(pieces, None)
                if piece is None:
                    is_end = True
                else:
                    keys = np.concatenate([keys, piece], axis=1)
            runs = keys.shape[1]
            if not runs:
                return
            most = min(runs, MAX_BLOCK_RUNS)
            count = min(self._block_size(self._costs.each[keys[0, :most]]), most)
            rest = runs - count
            if is_end and rest < min(count // 4, MAX_BLOCK_RUNS - count):
                count = runs  # no small block at the end
            block = keys[:, :count]
            keys = keys[:, count:]
            # The rows of a file are in the order of their keys.
            case, sample = block[:, np.lexsort(block[::-1])]
            yield case, sample

    def _block_size(self, cost: Floats) -> int:
        """Return how many of the next runs, which have these costs, make a block."""
        rate = self._first_rate * self.threads
        seconds = FIRST_BLOCK_SECONDS
        if self._recent:
            steps, spent = np.sum(self._recent, axis=0)
            rate = steps / max(spent, 1e-6)
            seconds = BLOCK_SECONDS
        total = np.cumsum(cost)
        target = int(np.searchsorted(total, seconds * rate, "right"))
        most = int(np.searchsorted(total, MAX_BLOCK_SECONDS * rate, "right"))
        lanes = LANES * self.threads
        return max(target, min(RUNS_PER_LANE * lanes, max(most, lanes)))

    def write(self, table: pa.Table, seconds: float | None = None) -> None:
        """Write rows to disk, and count them and the seconds of the kernel for them."""
        with _signals_deferred():
            self._writer.write(table)
            self.found.add(table)
            self.tally.on_disk += len(table)
            self.tally.computed += len(table)
            case, _ = keys_of(table)
            self._left = self._left - np.bincount(case, minlength=len(self._left))
            steps = self._costs.learn(case, floats(table["n_steps"]))
            if seconds is not None:
                self.tally.kernel_seconds += seconds
                self._recent.append((steps, seconds))

    def tick(self, keys: Keys | None = None, control: Control | None = None) -> None:
        """Report progress with the block under way; raise OutOfTime at the deadline."""
        now = time.monotonic()
        under_way = 0.0
        ended = 0
        if keys is not None and control is not None:
            under_way = control.done * float(self._costs.each[keys[0]].sum())
            ended = control.runs_done
        left = max(0.0, float(self._left @ self._costs.each) - under_way)
        wanted = float(self._wanted @ self._costs.each)
        most = wanted
        if self.plan.config.deciding_key:
            # Later waves may want all runs.
            most = float(self._costs.each.sum()) * self.plan.samples
        if most:
            # Neither a new wave nor a better estimate lowers what was reported.
            self._fraction = max(self._fraction, (wanted - left) / most)
        spent = 0.0
        if self.tally.begun is not None:
            spent = now - self.tally.begun
        done = self._costs.done + under_way
        seconds_left = None
        if spent > 0 and done > 0:
            seconds_left = left * spent / done
        runs = self.tally.on_disk + ended
        self.report(Progress(self._fraction, runs, seconds_left))
        has_some = self.tally.computed or ended
        if now >= self.deadline and (has_some or spent >= GRACE):
            raise OutOfTime


class Costs:
    """The cost of one run of each case: as theory expects it, then as measured."""

    def __init__(self, expected: Floats) -> None:
        self._expected = expected
        self._steps = np.zeros(len(expected))  # of the runs of each case so far
        self._runs = np.zeros(len(expected))
        self.each = expected  # of one run, in any unit; in steps once some are known

    @property
    def done(self) -> float:
        """Cost of all runs so far."""
        return float(self._steps.sum())

    def learn(self, case: Integers, n_steps: Floats) -> float:
        """Count the steps of runs, and return their sum."""
        steps = np.maximum(n_steps, 1.0)  # the closed form takes none
        count = len(self._expected)
        self._steps = self._steps + np.bincount(case, steps, count)
        self._runs = self._runs + np.bincount(case, minlength=count)
        # A case without runs is expected to differ from theory as the others do.
        scale = self._steps.sum() / (self._runs @ self._expected)
        prior = PRIOR_RUNS * scale * self._expected
        self.each = (prior + self._steps) / (PRIOR_RUNS + self._runs)
        return float(steps.sum())


@contextlib.contextmanager
def _signals_deferred() -> Iterator[None]:
    """Defer Ctrl-C and SIGTERM to the end of the body."""
    received: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        received.append(number)

    handlers = {}
    # Only the main thread receives signals.
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            handlers[number] = signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for late in received:
            signal.raise_signal(late)
