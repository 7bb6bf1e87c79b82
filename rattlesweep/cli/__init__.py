"""The command line: all commands, their help, and failures as one sentence and an exit
code.

``--help`` imports the modules of all commands, so these import what they call in their
functions.
"""

import os
import signal
import sys
from typing import Any, NoReturn

import click
from click import option

from rattlesweep.cli import single, sweeps
from rattlesweep.cli.options import COMMANDS, DONE, FAILED, WRONG, say, to_json
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.integrate import SettingError

__all__ = ["main", "single", "sweeps"]


class Program(click.Group):
    """The group of all commands."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command, and keep a Ctrl-C from click, which would print an empty
        line.
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            raise click.Abort from stop

    def main(self, *args: Any, **settings: Any) -> NoReturn:
        """Run a command, and end the process with its exit code."""
        # The next file to be opened would take the place of a closed stream.
        sys.stdout = sys.stdout or os.fdopen(os.open(os.devnull, os.O_RDONLY), "w")
        sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
        signal.signal(signal.SIGTERM, _terminate)
        try:
            code = super().main(*args, **{**settings, "standalone_mode": False})
            sys.stdout.flush()
        except (click.Abort, KeyboardInterrupt) as error:
            signal.signal(
                signal.SIGINT, signal.SIG_DFL
            )  # a second Ctrl-C ends the process
            stop = error.__cause__ or error
            number = stop.args[0] if stop.args else signal.SIGINT
            kept = "; ".join(getattr(stop, "__notes__", []))
            word = "interrupted" if number == signal.SIGINT else "terminated"
            say(
                word
                + (f"; {kept}, and the same command resumes from there" if kept else "")
            )
            code = 128 + number
        except BrokenPipeError:
            code = FAILED  # nobody reads standard output any more
        except click.ClickException as error:
            message = error.format_message().rstrip(".")
            context = getattr(error, "ctx", None)
            more = f" (see `{context.command_path} --help`)" if context else ""
            say(f"error: {message[:1].lower()}{message[1:]}{more}")
            code = WRONG
        except (ConfigError, SettingError, OutputError) as error:
            for line in getattr(error, "messages", [str(error)]):
                say(f"error: {line}")
            code = FAILED if isinstance(error, OutputError) else WRONG
        except OSError as error:
            what = error.filename or "cannot write to standard output"
            say(f"error: {what}: {error.strerror or error}")
            code = FAILED
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
        for section in ("Sweeps", "Results of a sweep", "One run", "Studies"):
            rows = [
                (f"{made.name:<11}", made.get_short_help_str(limit=1000))
                for made in COMMANDS
                if made.section == section
            ]
            with formatter.section(section):
                formatter.write_dl(rows)


def _terminate(number: int, frame: Any) -> NoReturn:
    raise KeyboardInterrupt(number)


SETTINGS = {"help_option_names": ["-h", "--help"], "show_default": True}


@click.group(
    cls=Program,
    commands=COMMANDS,
    invoke_without_command=True,
    context_settings=SETTINGS,
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

    docs/columns.md explains the columns of the tables, docs/types.md the types of runs.
    """
    if version:
        import rattlesweep

        click.echo(f"rattlesweep, version {rattlesweep.__version__}")
        if verbose:
            from rattlesweep.sweeps.provenance import machine, versions

            click.echo(to_json({**versions(), **machine()}))
        context.exit()
    if context.invoked_subcommand is None:
        click.echo(context.get_help(), err=True)
        context.exit(WRONG)
