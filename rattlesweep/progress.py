"""Progress as a bar: text in a terminal, a widget in a notebook, a line a minute elsewhere."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rattlesweep.durations import clock

if TYPE_CHECKING:
    from typing import Self

    from rattlesweep.sweeps.run import Progress

COMPILING = "compiling the kernel for this machine, once (about 15 s)"
DELAY = 0.5  # seconds after which a call from Python shows a bar: most are over by then
LINE_EVERY = 60.0  # seconds between lines where standard error is no terminal


class Bar:
    """A bar on standard error for as long as a ``with`` lasts, or lines if there is none."""

    def __init__(self, shown: bool, delay: float = 0.0, lines: bool = False) -> None:
        self._shown, self._delay, self._lines, self._compiled = shown, delay, lines, False
        self._start = self._last = time.monotonic()
        self._bar: Any = None

    @classmethod
    def of_call(cls, progress: bool | None) -> Bar:
        """Return the bar of a call from Python, by default where somebody looks at it."""
        if progress is None:
            progress = "ipykernel" in sys.modules or sys.stderr.isatty()
        return cls(progress, DELAY)

    @classmethod
    def of_command(cls, quiet: bool = False) -> Bar:
        """Return the bar of a command: in a terminal, unless it is to be quiet."""
        return cls(sys.stderr.isatty() and not quiet, lines=not quiet)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, progress: Progress) -> None:
        """Show how far a sweep is."""
        runs = f"{progress.runs:,} of {progress.total:,} runs"
        self.show(progress.fraction, runs, progress.elapsed, progress.left)

    def show(self, fraction: float, text: str, elapsed: float, left: float | None) -> None:
        """Show how far something is, and what it is doing; `elapsed` and `left` are seconds."""
        text += f", {clock(elapsed)}" + ("" if left is None else f", {clock(left)} left")
        if self._shown:
            self._open().set_description_str(text, refresh=False)
            self._bar.update(100 * fraction - self._bar.n)
        elif self._minute_is_over():
            print(f"{100 * fraction:.1f} %, {text}", file=sys.stderr, flush=True)

    def counting(self, what: str) -> Callable[[float], None]:
        """Return a function that shows the fraction done of work that goes on evenly."""
        begun: tuple[float, float] | None = None

        def report(fraction: float) -> None:
            nonlocal begun
            now = time.monotonic()
            # A kernel may have been compiled before the first report, which is no rate.
            begun = begun or (now, fraction)
            done = fraction - begun[1]
            left = (now - begun[0]) * (1 - fraction) / done if done > 0 else None
            self.show(fraction, what, now - self._start, left)

        return report

    def stage(self, text: str) -> None:
        """Write what is done now, in a terminal always and elsewhere once a minute."""
        if self._shown or self._minute_is_over():
            print(f"{time.monotonic() - self._start:4.0f} s  {text}", file=sys.stderr, flush=True)

    @contextmanager
    def compiling(self, kernel: str) -> Iterator[None]:
        """Tell that a kernel is being compiled, once, however many there are."""
        if self._lines and not self._compiled:
            print(COMPILING, file=sys.stderr, flush=True)
        elif self._shown and not self._lines:
            self._delay = 0.0
            self._open().set_description_str(COMPILING)
        self._compiled = True
        yield

    def _open(self) -> Any:
        if self._bar is None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # in notebooks without ipywidgets, which get text
                from tqdm.auto import tqdm

            # tqdm's own estimate of the time left would count compilation as work.
            form = "{percentage:3.0f}%|{bar}| {desc}"
            self._bar = tqdm(total=100.0, bar_format=form, file=sys.stderr, delay=self._delay)
        return self._bar

    def _minute_is_over(self) -> bool:
        now = time.monotonic()
        over = self._lines and now >= self._last + LINE_EVERY
        self._last = now if over else self._last
        return over
