"""Command line: load, call, save.  One module a command, found by its name, imported when called.

A command is `rattlesweep.cli.NAME:NAME`.  `--help` reads all of them, so they import what they call
inside their functions.
"""

from __future__ import annotations

import pkgutil
from importlib import import_module
from typing import Any, get_args

import click

from rattlesweep.cli.common import Command, Section
from rattlesweep.text import align

COMMANDS = tuple(sorted(found.name for found in pkgutil.iter_modules(__path__) if not found.ispkg))


class _Commands(click.Group):
    """A group that imports a command when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> Command | None:
        if cmd_name not in COMMANDS:
            return None
        command: Command = getattr(import_module(f"rattlesweep.cli.{cmd_name}"), cmd_name)
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """The command of a command line; what is nearly one is told."""
        name = args[0]
        if name not in COMMANDS and name[:1] != "-" and not ctx.resilient_parsing:
            from difflib import get_close_matches

            near = get_close_matches(name, COMMANDS, n=1)
            hint = f"did you mean {near[0]}?" if near else "--help lists those there are"
            ctx.fail(f"no such command: {name}; {hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands by section."""
        commands = [c for c in (self.get_command(ctx, name) for name in COMMANDS) if c]
        width = max(map(len, COMMANDS))
        for section in get_args(Section):
            with formatter.section(section):
                formatter.write_dl(
                    [
                        (f"{c.name:<{width}}", c.get_short_help_str(formatter.width - 6 - width))
                        for c in commands
                        if c.section == section
                    ]
                )


def _print_version(context: click.Context, option: click.Parameter, asked: bool) -> None:
    """Print the version, and if asked for what the numbers and the speed depend on."""
    if not asked or context.resilient_parsing:
        return
    from importlib.metadata import version

    click.echo(f"rattlesweep, version {version('rattlesweep')}")
    if context.params["verbose"]:
        from rattlesweep.integrate.batch import available_threads
        from rattlesweep.integrate.processor import vector_bits
        from rattlesweep.sweeps.provenance import machine, versions

        told = {name: str(text) for name, text in {**versions(), **machine()}.items()}
        del told["rattlesweep"]
        told["vectors"] = f"{vector_bits()} bits"
        told["threads"] = str(available_threads())
        click.echo(align(list(told.items()), "<"))
    context.exit()


@click.group(
    cls=_Commands,
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
)
@click.option("--verbose", is_flag=True, is_eager=True, help="With --version: of all that counts.")
@click.option("--version", is_flag=True, expose_value=False, callback=_print_version,
              help="Show the version and exit.")  # fmt: skip
def main(verbose: bool) -> None:
    """Parameter sweeps of rattlebacks: sample bodies, integrate, classify the runs, write Parquet.

    Exit codes: 0 done, 1 failed, 2 the command or the config is wrong, 3 done but some runs have
    a status other than ok, 75 stopped early on purpose, 130 interrupted, 143 terminated.
    """
