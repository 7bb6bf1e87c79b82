"""Output for terminals: tables, counts, durations, progress."""
# ruff: noqa: D102 - the names say what the methods of a bar do

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any

COMPILING = (
    "compiling a kernel for this machine (about 15 s); it is kept for later runs"
)
COMPILING_ONCE = (
    "compiling a kernel for this machine (about 15 s), for this run alone: "
    "no private folder can keep it; NUMBA_CACHE_DIR names one"
)
DELAY = 0.5  # seconds after which a bar appears, so that short work shows none
LINE_EVERY = (
    60.0  # seconds between lines of progress where standard error is not a terminal
)


def align(lines: Sequence[Sequence[str]], sides: str = ">") -> str:
    """Return rows of cells as aligned columns; the last of `sides`, ``<`` or ``>``, is
    repeated.
    """
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    shapes = list(map("{}{}".format, sides.ljust(len(widths), sides[-1]), widths))
    return "\n".join("  ".join(map(format, line, shapes)).rstrip() for line in lines)


def counted(number: int, noun: str) -> str:
    """Return a number with a noun, such as ``1 run`` or ``6,000 runs``."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def clock(seconds: float) -> str:
    """Return seconds as m:ss or h:mm:ss."""
    hours, rest = divmod(round(seconds), 3600)
    return (
        f"{hours}:{rest // 60:02d}:{rest % 60:02d}"
        if hours
        else f"{rest // 60}:{rest % 60:02d}"
    )


class Bar(AbstractContextManager["Bar"]):
    """Progress on standard error, as a bar or as a line per minute; a context
    manager.
    """

    def __init__(self, shown: bool, lines: bool = False) -> None:
        self._shown, self._lines, self._compiled = shown, lines, False
        self._start = self._last = time.monotonic()
        self._bar: Any = None

    @classmethod
    def of_call(cls, progress: bool | None) -> Bar:
        """Return the bar of a Python call, by default shown in notebooks and
        terminals.
        """
        if progress is None:
            progress = "ipykernel" in sys.modules or sys.stderr.isatty()
        return cls(progress)

    @classmethod
    def of_command(cls, quiet: bool = False) -> Bar:
        return cls(sys.stderr.isatty() and not quiet, lines=not quiet)

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, progress: Any) -> None:
        left = "" if progress.left is None else f", {clock(progress.left)} left"
        self._show(
            progress.fraction, f"{progress.runs:,} of {progress.total:,} runs", left
        )

    def counting(self, what: str) -> Callable[[float], None]:
        return lambda fraction: self._show(fraction, what)

    def stage(self, text: str) -> None:
        if self._shown or self._lines:
            print(
                f"{time.monotonic() - self._start:4.0f} s  {text}",
                file=sys.stderr,
                flush=True,
            )

    def compiling(self, stored: bool) -> None:
        """Say once that kernels are being compiled, and whether for later runs, too."""
        if (self._shown or self._lines) and not self._compiled:
            text = COMPILING if stored else COMPILING_ONCE
            print(text, file=sys.stderr, flush=True)
        self._compiled = True

    def _show(self, fraction: float, text: str, left: str = "") -> None:
        now = time.monotonic()
        text = f"{text}, {clock(now - self._start)}{left}"
        if self._shown:
            if self._bar is None:
                with warnings.catch_warnings(
                    action="ignore"
                ):  # tqdm warns without ipywidgets
                    from tqdm.auto import tqdm

                # tqdm's own estimate of the time left would include compilation.
                form = "{percentage:3.0f}%|{bar}| {desc}"
                self._bar = tqdm(
                    total=100.0, bar_format=form, file=sys.stderr, delay=DELAY
                )
            self._bar.set_description_str(text, refresh=False)
            self._bar.update(100 * fraction - self._bar.n)
        elif self._lines and now >= self._last + LINE_EVERY:
            self._last = now
            print(f"{100 * fraction:.1f} %, {text}", file=sys.stderr, flush=True)
