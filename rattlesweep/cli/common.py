"""What the commands share: exit codes, errors in one sentence, progress."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

from rattlesweep.integrate import SettingError, check_settings

if TYPE_CHECKING:
    from pathlib import Path

    import pyarrow as pa

    from rattlesweep.sweeps.config.load import Config
    from rattlesweep.sweeps.engines.progress import Progress

DONE, FAILED, WRONG, SOME_FAILED, EARLY, INTERRUPTED, TERMINATED = 0, 1, 2, 3, 75, 130, 143
# Seconds between lines of progress where there is no terminal.
LINE_EVERY = 60.0
# Rows of a table on the terminal.
MOST_ROWS = 20


class Terminated(BaseException):
    """SIGTERM arrived."""


def say(text: str) -> None:
    """Write a line to standard error."""
    from rattlesweep.errors import printable

    click.echo(printable(text), err=True)


def leave(code: int) -> None:
    """End the process; at once where a kernel still compiles and would hold up the exit."""
    sys.stdout.flush()
    sys.stderr.flush()
    # Ours by name: an embedding program, such as a test runner, may have daemons of its own.
    if any(t.name.startswith("rattlesweep-") for t in threading.enumerate()):
        os._exit(code)
    raise SystemExit(code)


def guarded(command: Callable[..., Any], *, resumes: bool = False) -> Callable[..., Any]:
    """Turn what can go wrong into one sentence and an exit code.

    Parameters
    ----------
    resumes
        Whether the same command resumes where it was stopped.
    """

    @wraps(command)
    def guarded(*args: Any, **kwargs: Any) -> None:
        def terminate(number: int, frame: Any) -> None:
            raise Terminated

        signal.signal(signal.SIGTERM, terminate)
        try:
            check_settings()
            code = command(*args, **kwargs)
        except (KeyboardInterrupt, Terminated) as error:
            # A second Ctrl-C is obeyed at once.
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            term = isinstance(error, Terminated)
            what = "terminated" if term else "interrupted"
            kept = "; ".join(getattr(error, "__notes__", ())) or "completed work is kept"
            say(f"{what}; {kept}, and the same command resumes from there" if resumes else what)
            leave(TERMINATED if term else INTERRUPTED)
        except BrokenPipeError:
            # The reader of standard output has gone; there is nobody to tell.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise SystemExit(FAILED) from None
        except Exception as error:
            from rattlesweep.errors import ConfigError, OutputError

            if isinstance(error, ConfigError):
                for line in error.messages:
                    say(f"error: {line}")
                leave(WRONG)
            if isinstance(error, SettingError):
                say(f"error: {error}")
                leave(WRONG)
            if isinstance(error, OutputError):
                say(f"error: {error}")
                leave(FAILED)
            if isinstance(error, OSError):
                # Such as a full disk behind standard output.
                say(f"error: {error.filename or 'cannot write'}: {error.strerror or error}")
                leave(FAILED)
            raise
        if code:
            leave(code)

    return guarded


def resumable(command: Callable[..., Any]) -> Callable[..., Any]:
    """As `guarded`, for commands that resume where they were stopped."""
    return guarded(command, resumes=True)


def print_summary(summary: pa.Table, directory: Path) -> None:
    """Print the table of a summary: all of its cases, or the first of many."""
    from rattlesweep.sweeps.inspect.summary import closing_table

    click.echo(closing_table(summary.slice(0, MOST_ROWS)))
    if (more := len(summary) - MOST_ROWS) > 0:
        say(f"{more} more cases are in {directory / 'summary.parquet'}")


OVERRIDES = click.option(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    multiple=True,
    help="Override a key of the config, such as bodies.samples=10; may be repeated.",
)


def most_threads() -> int:
    """Threads that the kernels can use at most."""
    from rattlesweep.integrate.batch import most_threads

    return most_threads()


def check_threads(threads: int | None) -> None:
    """Refuse more threads than there are processors.

    Raises
    ------
    click.BadParameter
        There are too many.
    """
    if threads is not None and threads > (most := most_threads()):
        raise click.BadParameter(f"{threads} is more than the {most} processors there are")


def check_output(output: str | None) -> None:
    """Refuse a directory without a name, or with one that the files in it cannot hold.

    Raises
    ------
    ConfigError
        It has none, or it is not UTF-8.
    """
    from rattlesweep.errors import ConfigError, one_line

    if output is not None and not output:
        raise ConfigError("--output: the directory has no name; give one")
    if output is not None and output != output.encode(errors="replace").decode():
        raise ConfigError(f"--output {one_line(output)}: the name is not UTF-8; give one that is")


def load_sweep(config: str, overrides: tuple[str, ...], output: str | None) -> Config:
    """The config of a sweep, with what the command line says instead.

    Raises
    ------
    ConfigError
        The config or an option is wrong.
    """
    from rattlesweep.sweeps.config.load import load_config

    loaded = load_config(config, overrides)
    check_output(output)
    return loaded if output is None else loaded.model_copy(update={"output": output})


class Meter:
    """Progress: a bar on a terminal, one line a minute elsewhere, nothing if quiet."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        self._bar: Any = None
        self._last = time.monotonic()

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
        from rattlesweep.durations import clock

        text = f"{text}, {clock(elapsed)}" + ("" if left is None else f", {clock(left)} left")
        if self._bar is not None:
            self._bar.n = 100.0 * fraction
            self._bar.set_description_str(text)
        elif not self._quiet and time.monotonic() - self._last >= LINE_EVERY:
            self._last = time.monotonic()
            say(f"{100 * fraction:.1f} %, {text}")

    def counting(self, what: str) -> Callable[[float], None]:
        """What shows a fraction of work that takes equally long all the way."""
        start = time.monotonic()

        def report(fraction: float) -> None:
            elapsed = time.monotonic() - start
            left = elapsed * (1 - fraction) / fraction if fraction > 0 else None
            self.show(fraction, what, elapsed, left)

        return report


def stages(start: float) -> Callable[[str], None]:
    """Say what is being done: each on a terminal, elsewhere no more than a line a minute."""
    last = start

    def stage(text: str) -> None:
        nonlocal last
        if sys.stderr.isatty() or time.monotonic() - last >= LINE_EVERY:
            last = time.monotonic()
            say(f"{last - start:4.0f} s  {text}")

    return stage
