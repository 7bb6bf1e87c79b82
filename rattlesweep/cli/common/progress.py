"""How far a command is: on a terminal a bar, elsewhere no more than a line a minute."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rattlesweep.cli.common.output import say
from rattlesweep.durations import clock

if TYPE_CHECKING:
    from rattlesweep.sweeps.engines.progress import Progress

# Seconds between lines of progress where there is no terminal.
LINE_EVERY = 60.0


class Meter:
    """Progress: a bar on a terminal, one line a minute elsewhere, nothing if quiet."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        self._bar: Any = None
        self._start = self._last = time.monotonic()

    def __enter__(self) -> Meter:
        if not self._quiet and sys.stderr.isatty():
            from tqdm import tqdm

            # Of expected cost; tqdm's own estimate would count compilation as work.
            self._bar = tqdm(
                total=100.0, bar_format="{percentage:3.0f}%|{bar}| {desc}", file=sys.stderr
            )
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

        def report(fraction: float) -> None:
            elapsed = time.monotonic() - self._start
            left = elapsed * (1 - fraction) / fraction if fraction > 0 else None
            self.show(fraction, what, elapsed, left)

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
