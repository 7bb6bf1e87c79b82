"""A run as a time series: integrated, written or printed, and what became of it."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rattlesweep.cli.common.output import DONE, SOME_FAILED, say
from rattlesweep.cli.common.progress import Meter

if TYPE_CHECKING:
    from rattlesweep.analysis.onerun.course import Course, PreparedRun
    from rattlesweep.analysis.onerun.rows import Rows
    from rattlesweep.physics.si import Units
    from rattlesweep.sweeps.single import Launch


def write_course(
    run: Launch | PreparedRun,
    channels: Sequence[str] | None,
    rows: Rows,
    output: Path | None,
    figure: Path | None,
    quiet: bool,
) -> Course:
    """Integrate and write what is asked for, or print CSV if nothing is; the last course.

    Of a long table only the head and the tail are printed, unless standard output is a file.  A
    figure has rows of its own, and channels if none are asked for.
    """
    from rattlesweep.analysis.onerun import files
    from rattlesweep.analysis.onerun.course import Course

    # A bar and a table would stand on one terminal.
    on_one = output is None and figure is None and sys.stdout.isatty()
    with Meter(quiet or on_one) as meter:
        watch = meter.counting("integrating")
        if output is not None or figure is None:
            names = ("t", "n") if channels is None else channels
            course = Course(run, channels=names, rows=rows, watch=watch)
            cut = False
            if output is not None:
                files.save(course, output)
            elif _into_a_file():
                files.write_csv(course, sys.stdout.buffer.write)
            else:
                cut = files.write_ends(course, sys.stdout.buffer.write)
            sys.stdout.flush()
            if cut:
                say(f"only the first and the last {files.ENDS} rows are printed; for all of them "
                    "give --output FILE, a .csv or .parquet")  # fmt: skip
        if figure is not None:
            # Matplotlib is loaded for figures alone.
            from rattlesweep.analysis.onerun import figure as figures

            course = figures.course_of(run, channels, watch, rows.from_time)
            figures.save(course, figure)
    return course


def _into_a_file() -> bool:
    """Whether standard output goes into a regular file."""
    try:
        return stat.S_ISREG(os.fstat(sys.stdout.fileno()).st_mode)
    except (OSError, ValueError):  # no descriptor: a stream in memory
        return False


def say_outcome(course: Course, quiet: bool, units: Units | None = None) -> int:
    """Say what became of a run, of a body in SI units in these too; the exit code."""
    if not quiet:
        text = _times(course.reversals, "reversal")
        if units is not None and course.reversals:
            text += f" ({', '.join(f'{t * units.time:.4g} s' for t in course.reversals[:8])})"
        if course.zeros != course.reversals:
            text += f" ({_times(course.zeros, 'zero crossing')})"
        say(f"{text}; {course.n_steps} steps to t = {course.t:g}")
        if course.observer.warning:
            say(f"warning: {course.observer.warning}")
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
