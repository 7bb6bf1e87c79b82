"""A kernel at work in a thread of its own, so that the main thread hears Ctrl-C."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from rattlesweep.integrate.batch import Control

T = TypeVar("T")

POLL = 0.1
# How long a stop waits for the kernel; it answers within a millisecond, a compilation does not.
PATIENCE = 0.5


class Task(threading.Thread, Generic[T]):
    """One call, started at once, in a thread that does not keep the process alive.

    Parameters
    ----------
    call
        Given the :class:`Control` through which it is watched and stopped.
    """

    def __init__(self, call: Callable[[Control], T]) -> None:
        super().__init__(daemon=True, name="rattlesweep-kernel")
        self.control = Control()
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
