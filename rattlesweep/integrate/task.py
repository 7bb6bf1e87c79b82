"""Compiled calls in threads of their own, so that the main thread hears Ctrl-C and can stop them.

One call is a :class:`Task`; several at a time are :func:`side_by_side`. Each call is given the
:class:`Control` through which it is stopped: the lane kernels take it as it is, other loops look at
``control.flag[0]`` now and then.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Floats

T = TypeVar("T")
# Seconds between two looks at what is under way: every wait of the package uses it.
POLL = 0.05
# Seconds for which a stop waits; a kernel answers within a millisecond, a compilation does not.
PATIENCE = 0.5
# Begins the name of every thread that may outlive a stop: the process then ends without it.
THREAD = "rattlesweep-kernel"


@dataclass
class Control:
    """Link to a running kernel, or several in turn: hears how far it is and tells it to stop.

    Attributes
    ----------
    total : float
        Expected cost of the batch, in the units of :attr:`done`.
    """

    total: float = 0.0
    _shared: NDArray[np.int64] = field(default_factory=lambda: np.zeros(2, dtype=np.int64))
    _progress: Floats = field(default_factory=lambda: np.zeros((1, 8)))
    _most: float = 0.0
    _runs: int = 0
    # Expected cost of the runs of this kernel, runs of those before, what this one counts for.
    _cost: float = 0.0
    _begun: int = 0
    _ended: int = 0
    _span: tuple[float, float] = (0.0, 1.0)
    _counts: tuple[bool, bool] = (True, True)

    def stop(self) -> None:
        """Ask the kernel to end; it does so within a few hundred steps."""
        self._shared[1] = 1

    def stage(self, low: float, high: float, *, begins: bool = False, ends: bool = False) -> None:
        """Say that the next kernel is one of several for the same runs.

        Parameters
        ----------
        low, high : float
            The part of the whole work that it does, as shares from 0 to 1.
        begins, ends : bool
            Whether the runs that it takes up have then begun, and those that it ends are done.
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

    @property
    def flag(self) -> NDArray[np.int64]:
        """One element, not 0 once a stop was asked for: for compiled loops."""
        return self._shared[1:]

    @property
    def stopping(self) -> bool:
        """Return whether a stop was asked for."""
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
    """One call, started at once, in a thread that does not keep the process alive.

    Parameters
    ----------
    call : callable
        Given the control.
    control : Control, optional
        One that several tasks share; by default its own.
    """

    def __init__(self, call: Callable[[Control], T], control: Control | None = None) -> None:
        super().__init__(daemon=True, name=THREAD)
        self.control = control or Control()
        self.seconds = 0.0
        self._call = call
        self._error: BaseException | None = None
        self._value: list[T] = []
        # After a Ctrl-C in `join`, Python 3.11 takes a thread that runs for one that has ended.
        self._ended = threading.Event()
        self.start()

    def run(self) -> None:
        """Make the call; not to be called by others."""
        start = time.perf_counter()
        try:
            self._value.append(self._call(self.control))
        except BaseException as error:
            self._error = error
        self.seconds = time.perf_counter() - start
        self._ended.set()

    def stop(self, patience: float = PATIENCE) -> None:
        """Ask for an end, and wait for it a little."""
        self.control.stop()
        self._ended.wait(patience)

    def value(self) -> T:
        """Return what the call came to, or raise what it raised.

        Raises
        ------
        TimeoutError
            If it has not ended.
        """
        if not self._ended.is_set():
            raise TimeoutError
        if self._error is not None:
            raise self._error
        return self._value[0]

    def wait(self, tick: Callable[[Control], None] = lambda control: None) -> T:
        """Wait for the value; `tick` is called a few times a second and may raise to stop it."""
        try:
            while not self._ended.wait(POLL):
                tick(self.control)
        except BaseException:
            self.stop()
            raise
        return self.value()


def side_by_side(
    calls: Sequence[Callable[[Control], T]],
    threads: int,
    report: Callable[[float], None] = lambda share: None,
) -> list[T]:
    """Results of calls, so many at a time, in their order.

    Parameters
    ----------
    calls : sequence of callable
        Each is given the control that all share.
    threads : int
    report : callable
        Called in this thread, some twenty times a second, with the share of the calls that is done.
        What it raises, a Ctrl-C, or the first error of a call stops them all and is raised here;
        none is begun after that.
    """
    control = Control()
    left = iter(enumerate(calls))
    results: dict[int, T] = {}
    errors: list[BaseException] = []
    one_at_a_time = threading.Lock()

    def work(control: Control) -> None:
        while not control.stopping:
            with one_at_a_time:
                place, call = next(left, (-1, None))
            if call is None:
                return
            try:
                results[place] = call(control)
            except BaseException as error:
                errors.append(error)
                control.stop()

    team = [Task(work, control) for _ in range(min(threads, len(calls)))]
    for task in team:
        task.wait(lambda _: report(len(results) / len(calls)))
    if errors:
        raise errors[0]
    report(1.0)
    return [results[place] for place in range(len(calls))]


__all__ = ["PATIENCE", "POLL", "Control", "Task", "side_by_side"]
