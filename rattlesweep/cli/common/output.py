"""What goes to the two streams: data to standard output, everything else to standard error."""

from __future__ import annotations

import json
import os
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rattlesweep.cli.common.exits import DONE, SOME_FAILED
from rattlesweep.errors import printable

if TYPE_CHECKING:
    import pyarrow as pa

    from rattlesweep.study.onerun.course import Course

# Rows of a table on the terminal.
MOST_ROWS = 20


def say(text: str) -> None:
    """Write a line to standard error."""
    click.echo(printable(text), err=True)


def to_json(data: Any) -> str:
    """Data as JSON that every reader takes."""
    return json.dumps(data, indent=2, allow_nan=False)


def print_summary(summary: pa.Table, directory: Path) -> None:
    """Print the table of a summary: all of its cases, or the first of many."""
    from rattlesweep.sweeps.inspect.summary import closing_table

    click.echo(closing_table(summary.slice(0, MOST_ROWS)))
    if (more := len(summary) - MOST_ROWS) > 0:
        say(f"{more} more cases are in {directory / 'summary.parquet'}")


def write_course(
    table: Callable[[], Course],
    drawing: Callable[[], Course],
    output: Path | None,
    figure: Path | None,
) -> Course:
    """Integrate and write what is asked for, or print CSV if nothing is; the last course.

    Of a long table only the head and the tail are printed, unless standard output is a file.

    Parameters
    ----------
    table, drawing : callable
        Begin a course with the rows asked for, and one with those of the figure.
    output, figure : Path or None
    """
    from rattlesweep.study.onerun import files

    if output is not None or figure is None:
        course = table()
        if output is not None:
            files.save(course, output)
        else:
            out = sys.stdout.buffer
            cut = (files.write_csv if _into_a_file() else files.write_ends)(course, out.write)
            out.flush()
            if cut:
                say(f"only the first and the last {files.ENDS} rows are printed; for all of them "
                    "give --output FILE, a .csv or .parquet")  # fmt: skip
    if figure is not None:
        # Matplotlib is loaded for figures alone.
        from rattlesweep.study.onerun import figure as figures

        course = drawing()
        figures.save(course, figure)
    return course


def _into_a_file() -> bool:
    """Whether standard output goes into a regular file."""
    try:
        return stat.S_ISREG(os.fstat(sys.stdout.fileno()).st_mode)
    except (OSError, ValueError):  # no descriptor: a stream in memory
        return False


def say_outcome(course: Course, quiet: bool) -> int:
    """Say what became of a run; the exit code."""
    if not quiet:
        text = _times(course.reversals, "reversal")
        if course.zeros != course.reversals:
            text += f" ({_times(course.zeros, 'zero crossing')})"
        say(f"{text}; {course.n_steps} steps to t = {course.t:g}")
        if course.seen.warning:
            say(f"warning: {course.seen.warning}")
    if course.status.label != "ok":
        say(f"the run is not ok: {course.status.label}, {course.status.meaning}")
        return SOME_FAILED
    return DONE


def _times(times: list[float], word: str) -> str:
    """Such as ``2 reversals at 112.1, 387.5``."""
    shown = ", ".join(f"{time:.10g}" for time in times[:8])
    more = f" and {len(times) - 8} more" if len(times) > 8 else ""
    at = f" at {shown}{more}" if times else ""
    return f"{len(times) or 'no'} {word}{'' if len(times) == 1 else 's'}{at}"
