"""A trajectory on its way out: files, figures, the terminal, and what is said of it."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rattlesweep.cli.common import DONE, SOME_FAILED, say

if TYPE_CHECKING:
    from rattlesweep.study.onerun.course import Course, PreparedRun
    from rattlesweep.study.onerun.rows import Rows
    from rattlesweep.sweeps.blocks.single import Launch


def print_channels() -> None:
    """Print every channel with its unit and its words."""
    from rattlesweep.study.onerun.channels import CHANNELS

    for c in CHANNELS.values():
        models = "" if "gh" in c.models else f" ({', '.join(c.models)})"
        click.echo(f"{c.name:<12}  {c.unit:<9}  {c.description}{models}")


def names_of(channels: str) -> list[str]:
    """Names of channels, from a list with commas."""
    return [name.strip() for name in channels.split(",") if name.strip()]


def shown_of(channels: str) -> list[str] | None:
    """Channels that a figure is to show; None where the command line does not say."""
    source = click.get_current_context().get_parameter_source("channels")
    return None if source is click.core.ParameterSource.DEFAULT else names_of(channels)


def check_targets(output: Path | None, figure: Path | None) -> None:
    """See before the work begins that the files can be written."""
    from rattlesweep.study.onerun import files

    if output is not None:
        files.check_target(output, "--output", files.ENDINGS)
    if figure is not None:
        # Matplotlib is loaded for figures alone.
        from rattlesweep.study.onerun import figure as figures

        files.check_target(figure, "--figure", figures.ENDINGS)


def deliver(
    run: Launch | PreparedRun,
    channels: str,
    rows: Rows,
    output: Path | None,
    figure: Path | None,
    watch: Callable[[float], None],
) -> Course:
    """Integrate and write what is asked for, or print CSV if nothing is; the last course.

    Of a long table only the head and the tail are printed, unless standard output is a file.  A
    figure has rows of its own.
    """
    from rattlesweep.study.onerun import files
    from rattlesweep.study.onerun.course import Course

    if output is not None or figure is None:
        course = Course(run, channels=names_of(channels), rows=rows, watch=watch)
        if output is not None:
            files.save(course, output)
        else:
            out = sys.stdout.buffer
            cut = False
            if _is_file(sys.stdout):
                files.write_csv(course, out.write)
            else:
                cut = files.write_ends(course, out.write)
            out.flush()
            if cut:
                say(f"only the first and the last {files.ENDS} rows are printed; for all of them "
                    "give --output FILE, a .csv or .parquet")  # fmt: skip
    if figure is not None:
        from rattlesweep.study.onerun import figure as figures

        course = figures.course_of(run, shown_of(channels), watch)
        figures.save(course, figure)
    return course


def _is_file(stream: Any) -> bool:
    """Whether a stream goes into a regular file."""
    try:
        return stat.S_ISREG(os.fstat(stream.fileno()).st_mode)
    except (OSError, ValueError):  # no descriptor: a stream in memory
        return False


def close(course: Course, quiet: bool) -> int:
    """Say what became of a run; the exit code."""
    if not quiet:
        say(_closing(course))
        if course.observer.warning:
            say(f"warning: {course.observer.warning}")
    if course.status.label != "ok":
        say(f"the run is not ok: {course.status.label}, {course.status.meaning}")
        return SOME_FAILED
    return DONE


def _closing(course: Course) -> str:
    text = _times(course.reversals, "reversal")
    if course.zeros != course.reversals:
        text += f" ({_times(course.zeros, 'zero crossing')})"
    return f"{text}; {course.n_steps} steps to t = {course.t:g}"


def _times(times: list[float], word: str) -> str:
    """Such as ``2 reversals at 112.1, 387.5``."""
    shown = ", ".join(f"{time:.10g}" for time in times[:8])
    more = f" and {len(times) - 8} more" if len(times) > 8 else ""
    at = f" at {shown}{more}" if times else ""
    return f"{len(times) or 'no'} {word}{'' if len(times) == 1 else 's'}{at}"


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
