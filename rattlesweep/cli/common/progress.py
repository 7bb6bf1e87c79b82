"""How far a command is: on a terminal a bar, elsewhere no more than a line a minute."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rattlesweep.cli.common.output import say
from rattlesweep.durations import clock

if TYPE_CHECKING:
    from rattlesweep.sweeps.engines.progress import Progress

# Seconds between lines of progress where there is no terminal.
LINE_EVERY = 60.0
COMPILING = "compiling the kernel for this machine, once (about 20 s)"


def _bar(**settings: Any) -> Any:
    from tqdm import tqdm

    return tqdm(file=sys.stderr, **settings)


class Meter:
    """Progress: a bar on a terminal, one line a minute elsewhere, nothing if quiet."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        self._bar: Any = None
        self._start = self._last = time.monotonic()

    def __enter__(self) -> Meter:
        if not self._quiet and sys.stderr.isatty():
            # Of expected cost; tqdm's own estimate would count compilation as work.
            self._bar = _bar(total=100.0, bar_format="{percentage:3.0f}%|{bar}| {desc}")
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, progress: Progress) -> None:
        """Show how far a sweep is."""
        runs = f"{progress.runs}/{progress.total} runs"
        self.show(progress.fraction, runs, progress.elapsed, progress.left)

    def show(self, fraction: float, text: str, elapsed: float, left: float | None) -> None:
        """Show how far something is, and what it is doing."""
        text = f"{text}, {clock(elapsed)}" + ("" if left is None else f", {clock(left)} left")
        if self._bar is not None:
            self._bar.n = 100.0 * fraction
            self._bar.set_description_str(text)
        elif not self._quiet and self._minute_is_over():
            say(f"{100 * fraction:.1f} %, {text}")

    def counting(self, what: str) -> Callable[[float], None]:
        """What shows a fraction of work that takes equally long all the way."""
        begun: tuple[float, float] | None = None

        def report(fraction: float) -> None:
            nonlocal begun
            now = time.monotonic()
            # Before the first report a kernel may have been compiled, which is no rate.
            begun = begun or (now, fraction)
            done = fraction - begun[1]
            left = (now - begun[0]) * (1 - fraction) / done if done > 0 else None
            self.show(fraction, what, now - self._start, left)

        return report

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
    """Says that a kernel is being compiled: on a terminal with a clock, elsewhere in one line."""

    def __init__(self, tick: float = 1.0) -> None:
        self._tick, self._said = tick, False

    @contextmanager
    def __call__(self, kernel: str) -> Iterator[None]:
        """For as long as a kernel is being compiled."""
        if not sys.stderr.isatty():
            if not self._said:
                say(COMPILING)
            self._said = True
            yield
            return
        ended = threading.Event()
        with _bar(bar_format=f"{COMPILING}: {{elapsed}}", leave=False) as bar:

            def run() -> None:
                while not ended.wait(self._tick):
                    bar.refresh()

            clock = threading.Thread(target=run, daemon=True)
            clock.start()
            try:
                yield
            finally:
                ended.set()
                clock.join()
