"""Compiled calls in threads of their own, so that the main thread hears Ctrl-C and can stop them.

Each is given the :class:`Control` through which it is stopped: the lane kernels take it as it is,
other loops look at ``control.flag[0]`` now and then.
"""

import threading
import time
from collections.abc import Callable, Sequence
from concurrent import futures
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Floats

T = TypeVar("T")
# Seconds between two looks at what is under way: every wait of the package uses it.
POLL = 0.05
PATIENCE = 0.5  # seconds for which a stop waits; a compilation takes longer


@dataclass
class Control:
    """Link to a running kernel, or several in turn: hears how far it is and tells it to stop."""

    total: float = 0.0  # expected cost of the batch, in the units of `done`
    # Next place in the kernel's queue, stop flag; what it reports; cost and number of its runs.
    _shared: NDArray[np.int64] = field(default_factory=lambda: np.zeros(2, dtype=np.int64))
    _progress: Floats = field(default_factory=lambda: np.zeros((1, 8)))
    _cost: float = 0.0
    _runs: int = 0
    # Most that was done so far; runs of the kernels before; what this one counts for.
    _most: float = 0.0
    _begun: int = 0
    _ended: int = 0
    _span: tuple[float, float] = (0.0, 1.0)
    _counts: tuple[bool, bool] = (True, True)

    def stop(self) -> None:
        """Ask the kernel to end; it does so within a few hundred steps."""
        self._shared[1] = 1

    def stage(self, low: float, high: float, *, begins: bool = False, ends: bool = False) -> None:
        """Say that the next kernel does the part from ``low`` to ``high`` of 1 of the whole work.

        ``begins`` and ``ends``: whether runs that it takes up have begun, that it ends are done.
        """
        self._begun, self._ended = self.runs_begun, self.runs_done
        self._progress, self._cost, self._runs = np.zeros((1, 8)), 0.0, 0
        self._span, self._counts = (low, high), (begins, ends)

    def stay(self) -> None:
        """Say that the next kernel does again some runs that the last one has counted."""
        self.stage(self._span[1], self._span[1])

    def settle(self, runs: int) -> None:
        """Count runs as done that no further kernel takes up."""
        self._ended += runs

    def start(self, threads: int, cost: Floats) -> None:
        """Say that a kernel starts, with so many threads and runs of this expected cost."""
        self.total = self._cost = float(cost.sum())
        self._runs, self._progress, self._shared[0] = len(cost), np.zeros((threads, 8)), 0

    @property
    def flag(self) -> NDArray[np.int64]:
        """One element, not 0 once a stop was asked for: for compiled loops."""
        return self._shared[1:]

    @property
    def stopping(self) -> bool:
        """Whether a stop was asked for."""
        return bool(self._shared[1])

    @property
    def done(self) -> float:
        """Cost of what is done so far; it never falls."""
        # A run that has just ended counts twice until its thread looks at its lanes again.
        now = min(self._cost, float(self._progress[:, :2].sum()))
        low, high = self._span
        share = low + (high - low) * (now / self._cost if self._cost else 0.0)
        self._most = max(self._most, share)
        return self._most * self.total

    @property
    def runs_done(self) -> int:
        """Runs that have ended."""
        return self._ended + int(self._progress[:, 2].sum()) * self._counts[1]

    @property
    def runs_begun(self) -> int:
        """Runs that a lane has taken up; once the kernel is stopped, those not done are lost."""
        # Every lane that finds the queue empty counts on.
        return self._begun + min(int(self._shared[0]), self._runs) * self._counts[0]


class Task(threading.Thread, Generic[T]):
    """One call, started at once, in a thread that does not keep the process alive."""

    def __init__(self, call: Callable[[Control], T], control: Control | None = None) -> None:
        super().__init__(daemon=True)
        self.control = control or Control()
        self.seconds = 0.0
        self._call = call
        # After a Ctrl-C in `join`, Python 3.11 takes a thread that runs for one that has ended.
        self._future: futures.Future[T] = futures.Future()
        self.start()

    def run(self) -> None:
        """Make the call; the thread does."""
        start = time.perf_counter()
        try:
            value = self._call(self.control)
        except BaseException as error:
            self._future.set_exception(error)
        else:
            self.seconds = time.perf_counter() - start
            self._future.set_result(value)

    def stop(self, patience: float = PATIENCE) -> None:
        """Ask for an end, and wait for it a little."""
        self.control.stop()
        futures.wait([self._future], patience)

    def value(self) -> T:
        """Return what the call came to, or raise what it raised; TimeoutError before it ends."""
        return self._future.result(timeout=0)

    def wait(self, tick: Callable[[Control], None] = lambda control: None) -> T:
        """Wait for the value; `tick` is called a few times a second and may raise to stop it."""
        try:
            while not futures.wait([self._future], POLL).done:
                tick(self.control)
        except BaseException:
            self.stop()
            raise
        return self.value()


def side_by_side(calls: Sequence[Callable[[Control], T]], threads: int) -> list[T]:
    """Return the results of calls, so many at a time, in their order; they share a control.

    A Ctrl-C, or the first error, stops them all and is raised here.
    """
    control, left, results = Control(), iter(enumerate(calls)), dict[int, T]()
    errors: list[BaseException] = []

    def work(control: Control) -> None:
        try:
            while not control.stopping and (given := next(left, None)):
                results[given[0]] = given[1](control)
        except BaseException as error:
            errors.append(error)
            control.stop()

    for task in [Task(work, control) for _ in range(min(threads, len(calls)))]:
        task.wait()
    if errors:
        raise errors[0]
    return [results[place] for place in range(len(calls))]
