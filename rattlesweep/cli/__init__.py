"""The command line: all commands, their help, and failures as sentences and exit codes.

``--help`` imports the modules of all commands, so these import what they call in their
functions.
"""

import errno
import os
import signal
import sys
from types import FrameType
from typing import Any, NoReturn

import click
from click import option

from rattlesweep.cli import (  # noqa: F401 - they register their commands
    bodies,
    courses,
    exports,
    fits,
    orbits,
    studies,
    sweeps,
    verdict,
    views,
)
from rattlesweep.cli.options import (
    COMMANDS,
    DONE,
    EXIT_FAILED,
    SECTIONS,
    WRONG,
    say,
    to_json,
)
from rattlesweep.system.processors import SettingError
from rattlesweep.words.errors import ConfigError, OutputError

FIRST_LINES = """\
  rattlesweep init --example quickstart     writes configs/quickstart.yaml
  rattlesweep run configs/quickstart.yaml   integrates 6,000 rattlebacks
  rattlesweep plot out/quickstart           draws out/quickstart/fractions.png
"""


# What may go wrong with an open stream, which has no file name.
OF_STREAMS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EBADF, errno.EIO}


class Program(click.Group):
    """The group of all commands."""

    def invoke(self, ctx: click.Context) -> object:
        """Run a command; click would print an empty line at a Ctrl-C."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            raise click.Abort from stop

    def main(self, *args: Any, **settings: Any) -> NoReturn:
        """Run a command, and end the process with its exit code."""
        # The next file to be opened would take the place of a closed stream.
        if sys.stdout is None:
            sys.stdout = os.fdopen(os.open(os.devnull, os.O_RDONLY), "w")
        if sys.stderr is None:
            sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
        # OpenBLAS reserves memory for a thread of its own on each processor, for which
        # small matrices have no use.  Where an address space is limited, it may wait
        # for that memory for ever.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        signal.signal(signal.SIGTERM, _terminate)
        settings["standalone_mode"] = False
        try:
            code = super().main(*args, **settings)
            sys.stdout.flush()
        except (click.Abort, KeyboardInterrupt) as error:
            # A second Ctrl-C ends the process.
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            code = _interrupted(error)
        except BrokenPipeError:
            code = EXIT_FAILED  # nobody reads standard output any more
        except click.ClickException as error:
            _say_usage(error)
            code = WRONG
        except (ConfigError, SettingError) as error:
            for line in getattr(error, "messages", [str(error)]):
                say(f"error: {line}")
            code = WRONG
        except OutputError as error:
            say(f"error: {error}")
            code = EXIT_FAILED
        except MemoryError:
            say("error: there is not enough memory; see `ulimit -v`, or ask for less")
            code = EXIT_FAILED
        except OSError as error:
            say(f"error: {_in_words(error)}")
            code = EXIT_FAILED
        try:
            sys.stdout.flush()
        except OSError:
            # Python would fail when it flushes standard output once more at its end.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.stderr.flush()
        raise SystemExit(code or DONE)

    def format_commands(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """List the commands by section, each with its first sentence in full."""
        for section in SECTIONS:
            rows = [
                (f"{command.name:<11}", command.get_short_help_str(limit=1000))
                for command in COMMANDS
                if command.section == section
            ]
            with formatter.section(section):
                formatter.write_dl(rows)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write three lines to begin with."""
        with formatter.section("To begin with"):
            formatter.write(FIRST_LINES)


def _in_words(error: OSError) -> str:
    """Return what the system refused, and of which file, if it is known."""
    reason = error.strerror or str(error) or type(error).__name__
    if error.filename:
        return f"{error.filename}: {reason}"
    if isinstance(error, FileNotFoundError) and _has_no_folder():
        return "the current folder is gone; change to one that exists"
    if error.errno in OF_STREAMS:
        return f"cannot write to standard output: {reason}"
    return f"the system refused: {reason}"


def _has_no_folder() -> bool:
    try:
        os.getcwd()
    except OSError:
        return True
    return False


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt(number)


def _interrupted(error: BaseException) -> int:
    """Say which signal stopped the command and what is kept; return the exit code."""
    stop = error.__cause__ or error
    number = signal.SIGINT
    if stop.args:
        number = stop.args[0]
    text = "interrupted" if number == signal.SIGINT else "terminated"
    # Notes of the exception say what is kept.
    notes = "; ".join(getattr(stop, "__notes__", []))
    if notes:
        text += f"; {notes}, and the same command resumes from there"
    say(text)
    return 128 + number


def _say_usage(error: click.ClickException) -> None:
    """Say in our style what click found wrong with the command."""
    message = error.format_message().rstrip(".")
    message = message[:1].lower() + message[1:]
    context = getattr(error, "ctx", None)
    if context is not None:
        message += f" (see `{context.command_path} --help`)"
    say(f"error: {message}")


_SETTINGS = {"help_option_names": ["-h", "--help"], "show_default": True}


@click.group(
    cls=Program,
    commands=COMMANDS,
    invoke_without_command=True,
    context_settings=_SETTINGS,
)
@option(
    "--verbose",
    is_flag=True,
    help="With --version: also show libraries and the processor.",
)
@option("--version", is_flag=True, help="Show the version and exit.")
@click.pass_context
def main(context: click.Context, verbose: bool, version: bool) -> None:
    """Parameter sweeps of rattlebacks: sample bodies, integrate, classify the runs,
    write Parquet.

    Exit codes: 0 done, 1 failed, 2 the command or the config is wrong, 3 done but some
    runs have a status other than ok, 75 stopped early on purpose, 130 interrupted, 143
    terminated.
    """
    if version:
        import rattlesweep

        click.echo(f"rattlesweep, version {rattlesweep.__version__}")
        if verbose:
            from rattlesweep.store.provenance import machine, versions

            click.echo(to_json({**versions(), **machine()}))
        context.exit()
    if context.invoked_subcommand is None:
        click.echo(context.get_help(), err=True)
        context.exit(WRONG)
