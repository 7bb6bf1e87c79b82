"""Compiled calls in their own threads, so that Ctrl-C reaches the main thread.

Each call receives the :class:`Control` that stops it, and passes it on to kernels.
Other compiled loops check ``control.flag[0]`` regularly.
"""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Floats
from rattlesweep.system.processors import start_thread

_T = TypeVar("_T")
# Seconds between two checks of a running call, in every wait of the package.
POLL = 0.05
# Seconds for which a stop waits.  A compilation may go on longer, in its daemon thread.
PATIENCE = 0.5


@dataclass
class Control:
    """Link to a running kernel, or several in turn: reports progress, and stops it."""

    # Next place in the queue of the present kernel, and the stop flag.
    shared: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(2, dtype=np.int64)
    )
    # A row for each thread of the present kernel: the expected cost of its runs that
    # have ended, the part done of those in its lanes, and the number of runs that have
    # ended (the columns COST_DONE, ... of `kernel.turn`).  The others are not used.
    progress: Floats = field(default_factory=lambda: np.zeros((1, 8)))
    _cost: float = 0.0  # expected cost of all runs of the present kernel
    _most: float = 0.0  # largest share of the work done so far
    _ended: int = 0  # runs that count as done, from before the present kernel
    # Shares of the work between which the present kernel works.
    _span: tuple[float, float] = (0.0, 1.0)
    _counts: bool = True  # whether runs that it ends count as done

    def stop(self) -> None:
        """Ask the kernel to stop, which it does within 256 turns of a thread."""
        self.shared[1] = 1

    def stage(self, low: float, high: float, *, ends: bool = False) -> None:
        """Announce a kernel that does the work between the shares ``low`` and ``high``.

        ``ends`` says whether its runs count as done when they end.
        """
        self._ended = self.runs_done
        self.progress = np.zeros((1, 8))
        self._cost = 0.0
        self._span = low, high
        self._counts = ends

    def repeat(self) -> None:
        """Announce a kernel that repeats runs which the last one has counted."""
        self.stage(self._span[1], self._span[1])

    def divided(self, shares: Sequence[float]) -> Iterator[None]:
        """Divide the present stage by shares of its work; announce each, then yield."""
        if len(shares) == 1:
            yield
            return
        low, high = self._span
        counts = self._counts
        begin = low
        for share in shares:
            end = begin + share * (high - low)
            self.stage(begin, end, ends=counts)
            yield
            begin = end

    def count_ended(self, runs: int) -> None:
        """Count runs as done because no further kernel integrates them."""
        self._ended += runs

    def start(self, threads: int, cost: Floats) -> None:
        """Announce the start of a kernel: its threads, the expected cost of runs."""
        self._cost = float(cost.sum())
        self.progress = np.zeros((threads, 8))
        self.shared[0] = 0

    @property
    def flag(self) -> NDArray[np.int64]:
        """Return an array of one element, which a stop request makes nonzero."""
        return self.shared[1:]

    @property
    def stopping(self) -> bool:
        """Return whether a stop was requested."""
        return bool(self.shared[1])

    @property
    def done(self) -> float:
        """Return the share of the work done so far, from 0 to 1, which never falls."""
        # A run that has just ended counts twice until its thread next reports on its
        # lanes.
        now = min(self._cost, float(self.progress[:, :2].sum()))
        low, high = self._span
        share = low
        if self._cost:
            share += (high - low) * now / self._cost
        self._most = max(self._most, share)
        return self._most

    @property
    def runs_done(self) -> int:
        """Return the number of runs that have ended."""
        if not self._counts:
            return self._ended
        return self._ended + int(self.progress[:, 2].sum())


class Task(threading.Thread, Generic[_T]):
    """One call in a daemon thread, which starts at once."""

    def __init__(
        self, call: Callable[[Control], _T], control: Control | None = None
    ) -> None:
        super().__init__(daemon=True)
        self.control = control or Control()
        self.seconds = 0.0  # how long the call took, once it has returned
        self._call = call
        # After Ctrl-C in `join`, Python 3.11 reports a running thread as ended; a
        # future is safe.
        self._future: futures.Future[_T] = futures.Future()
        start_thread(self)

    def run(self) -> None:
        """Make the call, in the thread."""
        start = time.perf_counter()
        try:
            value = self._call(self.control)
        except BaseException as error:
            self._future.set_exception(error)
        else:
            self.seconds = time.perf_counter() - start
            self._future.set_result(value)

    def stop(self, patience: float = PATIENCE) -> None:
        """Ask the call to stop, and wait up to `patience` seconds until it does."""
        self.control.stop()
        futures.wait([self._future], patience)

    def value(self) -> _T:
        """Return the result of the call, or raise its error.

        Raises a TimeoutError while it runs.
        """
        return self._future.result(timeout=0)

    def wait(self, tick: Callable[[Control], None] = lambda control: None) -> _T:
        """Wait for the result; call `tick` every `POLL` seconds, which may raise."""
        try:
            while not futures.wait([self._future], POLL).done:
                tick(self.control)
        except BaseException:
            self.stop()
            raise
        return self.value()


def side_by_side(calls: Sequence[Callable[[Control], _T]], threads: int) -> list[_T]:
    """Make calls in a number of threads, and return their results in their order.

    All share one control.  Ctrl-C or the first error stops all of them and is raised
    here.
    """
    control = Control()
    # All threads take from this one; `enumerate` hands out each call once.
    waiting = iter(enumerate(calls))
    results = dict[int, _T]()
    errors: list[BaseException] = []

    def work(control: Control) -> None:
        try:
            for place, call in waiting:
                if control.stopping:
                    return
                results[place] = call(control)
        except BaseException as error:
            errors.append(error)
            control.stop()

    for task in [Task(work, control) for _ in range(min(threads, len(calls)))]:
        task.wait()
    if errors:
        raise errors[0]
    return [results[place] for place in range(len(calls))]
