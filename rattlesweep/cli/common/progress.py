"""How far a command is: on a terminal a bar, elsewhere no more than a line a minute."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rattlesweep.cli.common.output import say
from rattlesweep.progress import COMPILING, Bar, describe, new_bar

# Seconds between lines of progress where there is no terminal.
LINE_EVERY = 60.0


class Meter(Bar):
    """Progress: a bar on a terminal, one line a minute elsewhere, nothing if quiet."""

    def __init__(self, quiet: bool = False) -> None:
        super().__init__(not quiet and sys.stderr.isatty())
        self._quiet, self._last = quiet, self._start

    def show(self, fraction: float, text: str, elapsed: float, left: float | None) -> None:
        """Show how far something is, and what it is doing."""
        super().show(fraction, text, elapsed, left)
        if self._bar is None and not self._quiet and self._minute_is_over():
            say(f"{100 * fraction:.1f} %, {describe(text, elapsed, left)}")

    def stage(self, text: str) -> None:
        """Say what is done now; without a bar, so not for use inside ``with``."""
        if sys.stderr.isatty() or self._minute_is_over():
            say(f"{time.monotonic() - self._start:4.0f} s  {text}")

    def _minute_is_over(self) -> bool:
        over = time.monotonic() - self._last >= LINE_EVERY
        if over:
            self._last = time.monotonic()
        return over


class CompileNotice:
    """Says that kernels are being compiled: on a terminal with a clock, elsewhere in one line."""

    def __init__(self, tick: float = 1.0) -> None:
        self._tick, self._said = tick, False
        self._lock = threading.Lock()
        self._under_way, self._spent = 0, 0.0
        self._end: Callable[[], float] | None = None

    @contextmanager
    def __call__(self, kernel: str) -> Iterator[None]:
        """For as long as a kernel, or a part of one, is being compiled; several have one clock."""
        if not sys.stderr.isatty():
            with self._lock:
                if not self._said:
                    say(COMPILING)
                self._said = True
            yield
            return
        with self._lock:
            self._under_way += 1
            self._end = self._end or self._clock()
        try:
            yield
        finally:
            with self._lock:
                self._under_way -= 1
                if self._end is not None and not self._under_way:
                    self._spent, self._end = self._end(), None

    def _clock(self) -> Callable[[], float]:
        """Begin to tick; what ends it gives the seconds that the clock has shown."""
        ended = threading.Event()
        bar = new_bar(bar_format=f"{COMPILING}: {{elapsed}}", leave=False)
        start = time.monotonic() - self._spent
        bar.start_t -= self._spent
        bar.refresh()

        def run() -> None:
            while not ended.wait(self._tick):
                bar.refresh()

        def end() -> float:
            ended.set()
            clock.join()
            bar.close()
            return time.monotonic() - start

        clock = threading.Thread(target=run, daemon=True)
        clock.start()
        return end
