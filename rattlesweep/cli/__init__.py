"""Command line: load, call, save.  One module a command, imported when it is called."""

from __future__ import annotations

from importlib import import_module

import click

# In the order of `--help`; each is `rattlesweep.cli.NAME:NAME`.
COMMANDS = (
    "run",
    "plan",
    "status",
    "verify",
    "merge",
    "slurm",
    "classify",
    "plot",
    "report",
    "body",
    "trajectory",
    "replay",
    "show",
    "paper",
    "tradeoff",
    "schema",
)


class _Lazy(click.Group):
    """A group that imports a command when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names, in the order of `--help`."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of a name."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = getattr(import_module(f"rattlesweep.cli.{cmd_name}"), cmd_name)
        return command


@click.group(cls=_Lazy, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="rattlesweep", prog_name="rattlesweep")
def main() -> None:
    """Parameter sweeps of rattlebacks: sample bodies, integrate, classify the runs, write Parquet.

    Exit codes: 0 done, 1 failed, 2 the command or the config is wrong, 3 done but some runs have
    a status other than ok, 75 stopped early on purpose, 130 interrupted, 143 terminated.
    """
