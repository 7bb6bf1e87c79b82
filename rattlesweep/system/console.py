"""Output for terminals: tables, counts, durations, progress."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import cache
from typing import TYPE_CHECKING, Protocol

from rattlesweep.words.errors import printable

if TYPE_CHECKING:
    from tqdm import tqdm

COMPILING = "compiling a kernel for this machine (5 to 40 s); it is kept for later runs"
COMPILING_ONCE = (
    "compiling a kernel for this machine (5 to 40 s), for this run alone: kernels are "
    "kept where nobody else can write, in the folder or in one above it; run "
    "`chmod go-w ~/.cache`, or name such a folder by NUMBA_CACHE_DIR"
)
DELAY = 0.5  # seconds after which a bar appears, so that short work shows none
LINE_EVERY = 60.0  # seconds between lines of progress where there is no terminal


class HasProgress(Protocol):
    """How far a sweep is, as its job reports it."""

    @property
    def fraction(self) -> float:
        """Fraction of the expected cost that is done."""

    @property
    def runs(self) -> int:
        """Number of runs that are done."""

    @property
    def left(self) -> float | None:
        """Seconds that are left, None if they cannot be told yet."""


def align(lines: Sequence[Sequence[str]], sides: str = ">") -> str:
    """Return rows of cells as aligned columns, each to the ``<`` or ``>`` of `sides`.

    The last of the sides is repeated for the columns after it.
    """
    lines = [[printable(cell) for cell in line] for line in lines]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    sides = sides.ljust(len(widths), sides[-1])
    formats = [f"{side}{width}" for side, width in zip(sides, widths, strict=True)]
    return "\n".join("  ".join(map(format, line, formats)).rstrip() for line in lines)


def counted(number: int, noun: str) -> str:
    """Return a number with a noun, such as ``1 run`` or ``6,000 runs``."""
    if number == 1:
        return f"1 {noun}"
    return f"{number:,} {noun}s"


def shortened(texts: Sequence[str], most: int) -> str:
    """Return texts between commas, at most so many; dots stand for the others."""
    shown = list(texts[:most])
    if len(texts) > most:
        shown.append("...")
    return ", ".join(shown)


def joined(texts: Sequence[str], word: str = "and") -> str:
    """Return texts as in ``rolling, pivot and mu``; a comma in one asks for another."""
    *others, last = texts
    if not others:
        return last
    comma = "," if any("," in text for text in others) else ""
    return f"{', '.join(others)}{comma} {word} {last}"


def clock(seconds: float) -> str:
    """Return seconds as m:ss or h:mm:ss."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours}:{minutes:02d}:{seconds:02d}"
    return f"{minutes}:{seconds:02d}"


class Bar(AbstractContextManager["Bar"]):
    """Progress on standard error, as a bar or as a line per minute."""

    def __init__(self, shown: bool, lines: bool = False, warns: bool = True) -> None:
        self._shown = shown
        self._lines = lines
        self._warns = warns
        self._compiled = False
        self._staged = False
        self._start = time.monotonic()
        self._last = self._start
        self._bar: tqdm | None = None

    @classmethod
    def of_call(cls, progress: bool | None) -> Bar:
        """Return the bar of a Python call; None shows it in notebooks and terminals."""
        if progress is None:
            progress = "ipykernel" in sys.modules or sys.stderr.isatty()
        return cls(progress)

    @classmethod
    def of_command(cls, quiet: bool = False) -> Bar:
        """Return the bar of a command, or lines where there is no terminal."""
        return cls(sys.stderr.isatty() and not quiet, not quiet, warns=not quiet)

    def __exit__(self, *error: object) -> None:
        """Close the bar."""
        if self._bar is not None:
            self._bar.close()

    def __call__(self, progress: HasProgress) -> None:
        """Show the progress of a sweep."""
        left = ""
        if progress.left is not None:
            left = f", {clock(progress.left)} left"
        # Without their total, which would make a second share: runs differ in cost.
        self._show(progress.fraction, f"{progress.runs:,} runs done", left)

    def counting(self, what: str) -> Callable[[float], None]:
        """Return a function that shows how much of some work is done."""
        return lambda fraction: self._show(fraction, what)

    def working(self, what: str) -> Callable[[int], None]:
        """Return a function that shows the runs of work whose end is not known."""
        start = time.process_time()

        def show(runs: int) -> None:
            used = clock(time.process_time() - start)
            self._show(None, f"{what}, {counted(runs, 'run')}, processor {used}")

        return show

    def stage(self, text: str) -> None:
        """Say what begins now; without a terminal at most once in `LINE_EVERY`."""
        now = time.monotonic()
        is_due = self._lines and (not self._staged or now >= self._last + LINE_EVERY)
        if self._shown or is_due:
            self._staged = True
            self._last = now
            self._say(f"{now - self._start:4.0f} s  {text}")

    def compiling(self, stored: bool) -> None:
        """Say that kernels are being compiled, and each minute that they still are.

        That later runs cannot have them is said once a process, with or without a bar.
        """
        if not stored and self._warns:
            _warn_once(COMPILING_ONCE)
        now = time.monotonic()
        if self._compiled and now >= self._last + LINE_EVERY:
            if self._shown or self._lines:
                self._say(f"still compiling, {clock(now - self._start)}")
            self._last = now
        elif not self._compiled:
            if stored and (self._shown or self._lines):
                self._say(COMPILING)
            self._last = now
        self._compiled = True

    def _show(self, fraction: float | None, text: str, left: str = "") -> None:
        """Show text and the time since the start; a fraction of None is not known."""
        now = time.monotonic()
        text = f"{text}, {clock(now - self._start)} so far{left}"
        if self._shown:
            if self._bar is None:
                self._bar = _new_bar(fraction is not None)
            self._bar.set_description_str(text, refresh=False)
            done = self._bar.n + 1.0
            if fraction is not None:
                done = 100 * fraction
            self._bar.update(done - self._bar.n)
        elif self._lines and now >= self._last + LINE_EVERY:
            self._last = now
            if fraction is not None:
                text = f"{100 * fraction:.1f} %, {text}"
            self._say(text)

    @staticmethod
    def _say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)


@cache
def _warn_once(line: str) -> None:
    """Print a line on standard error, unless this process has printed it."""
    print(line, file=sys.stderr, flush=True)


def _new_bar(has_end: bool) -> tqdm:
    """Return a bar of percents, or a text alone where the end is not known.

    tqdm's own estimate would include compilation.
    """
    with warnings.catch_warnings(action="ignore"):  # tqdm warns without ipywidgets
        from tqdm.auto import tqdm

    form = "{desc}"
    total = None
    if has_end:
        form = "{percentage:3.0f}%|{bar}| {desc}"
        total = 100.0
    return tqdm(total=total, bar_format=form, file=sys.stderr, delay=DELAY)
