"""How far something is, as a bar: in a terminal of text, in a notebook a widget."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rattlesweep.durations import clock

if TYPE_CHECKING:
    from typing import Self

    from rattlesweep.sweeps.old.progress import Progress

COMPILING = "compiling the kernel for this machine, once (about 15 s)"
# Seconds after which a call from Python shows a bar: most are over by then.
DELAY = 0.5


def new_bar(**settings: Any) -> Any:
    """A bar of tqdm, on standard error where it is text."""
    from tqdm.auto import tqdm

    return tqdm(file=sys.stderr, **settings)


class Bar:
    """A bar for as long as a ``with`` lasts.

    Parameters
    ----------
    shown : bool
        Whether there is one at all.
    delay : float
        Seconds before it appears.
    """

    def __init__(self, shown: bool, delay: float = 0.0) -> None:
        self._shown, self._delay = shown, delay
        self._bar: Any = None
        self._start = time.monotonic()

    @classmethod
    def of_call(cls, progress: bool | None) -> Bar:
        """For a call from Python: as asked, by default where somebody looks at it."""
        if progress is None:
            progress = "ipykernel" in sys.modules or sys.stderr.isatty()
        return cls(progress, DELAY)

    def __enter__(self) -> Self:
        if not self._delay:
            self._appear()
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def _appear(self) -> None:
        if self._shown and self._bar is None and time.monotonic() >= self._start + self._delay:
            # Of expected cost; tqdm's own estimate would count compilation as work.
            self._bar = new_bar(total=100.0, bar_format="{percentage:3.0f}%|{bar}| {desc}")

    def __call__(self, progress: Progress) -> None:
        """Show how far a sweep is."""
        runs = f"{progress.runs}/{progress.total} runs"
        self.show(progress.fraction, runs, progress.elapsed, progress.left)

    def show(self, fraction: float, text: str, elapsed: float, left: float | None) -> None:
        """Show how far something is, and what it is doing."""
        self._appear()
        if self._bar is not None:
            self._bar.n = 100.0 * fraction
            self._bar.set_description_str(describe(text, elapsed, left))

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

    @contextmanager
    def compiling(self, kernel: str) -> Iterator[None]:
        """Say so for as long as a kernel is being compiled."""
        if self._shown:
            self._delay = 0.0
            self._appear()
            self._bar.set_description_str(COMPILING)
        yield


def describe(text: str, elapsed: float, left: float | None) -> str:
    """What is done, for how long, and for how long still."""
    return f"{text}, {clock(elapsed)}" + ("" if left is None else f", {clock(left)} left")
