"""Compiled calls in threads of their own, so that the main thread hears Ctrl-C and can stop them.

One call is a :class:`Task`; several at a time are :func:`side_by_side`. Each call is given the
:class:`Control` through which it is stopped: the lane kernels take it as it is, other loops look at
``control.flag[0]`` now and then.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from rattlesweep.integrate.batch import Control

T = TypeVar("T")

# Seconds between two looks at what is under way: every wait of the package uses it.
POLL = 0.05
# Seconds for which a stop waits; a kernel answers within a millisecond, a compilation does not.
PATIENCE = 0.5
# Begins the name of every thread that may outlive a stop: the process then ends without it.
THREAD = "rattlesweep-kernel"


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
        """What the call came to, or raised.

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
