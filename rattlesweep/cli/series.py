"""A trajectory on its way out: files, figures, the terminal, and what is said of it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rattlesweep.cli.common import DONE, SOME_FAILED, say

if TYPE_CHECKING:
    from rattlesweep.study.trajectory import Course


def print_channels() -> None:
    """Print every channel with its unit and its words."""
    from rattlesweep.study.channels import CHANNELS

    for c in CHANNELS.values():
        models = "" if "gh" in c.models else f" ({', '.join(c.models)})"
        click.echo(f"{c.name:<12}  {c.unit:<9}  {c.description}{models}")


def names_of(channels: str) -> list[str]:
    """Names of channels, from a list with commas."""
    return [name.strip() for name in channels.split(",") if name.strip()]


def check_targets(output: Path | None, figure: Path | None) -> None:
    """See before the work begins that the files can be written."""
    from rattlesweep.study import trajectory_figure as figures
    from rattlesweep.study import trajectory_file as files

    if output is not None:
        files.check_target(output, "--output", files.ENDINGS)
    if figure is not None:
        files.check_target(figure, "--figure", figures.ENDINGS)


def deliver(
    table: Callable[[], Course],
    drawing: Callable[[], Course],
    output: Path | None,
    figure: Path | None,
) -> Course:
    """Integrate and write what is asked for, or print CSV if nothing is; the last course.

    Parameters
    ----------
    table, drawing : callable
        Begin a course with the rows asked for, and one with those of the figure.
    output, figure : Path or None
    """
    from rattlesweep.study import trajectory_figure as figures
    from rattlesweep.study import trajectory_file as files

    if output is not None or figure is None:
        course = table()
        if output is not None:
            files.save(course, output)
        else:
            out = sys.stdout.buffer
            files.write_csv(course, out.write)
            out.flush()
    if figure is not None:
        course = drawing()
        figures.save(course, figure)
    return course


def close(course: Course, quiet: bool) -> int:
    """Say what became of a run; the exit code."""
    if not quiet:
        say(_closing(course.reversals, course.t, course.n_steps))
    if course.status.label != "ok":
        say(f"the run is not ok: {course.status.label}, {course.status.meaning}")
        return SOME_FAILED
    return DONE


def _closing(reversals: list[float], t: float, steps: int) -> str:
    shown = ", ".join(f"{time:.10g}" for time in reversals[:8])
    more = f" and {len(reversals) - 8} more" if len(reversals) > 8 else ""
    word = "reversal" if len(reversals) == 1 else "reversals"
    at = f" at {shown}{more}" if reversals else ""
    return f"{len(reversals) or 'no'} {word}{at}; {steps} steps to t = {t:g}"


class Share:
    """Progress: a bar on a terminal, unless the data goes there too."""

    def __init__(self, quiet: bool, *, files: bool) -> None:
        self._shown = not quiet and sys.stderr.isatty() and (files or not sys.stdout.isatty())
        self._bar: Any = None

    def __enter__(self) -> Share:
        if self._shown:
            from tqdm import tqdm

            self._bar = tqdm(total=100.0, bar_format="{percentage:3.0f}%|{bar}|", file=sys.stderr)
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, share: float) -> None:
        if self._bar is not None:
            self._bar.n = 100.0 * share
            self._bar.refresh()
