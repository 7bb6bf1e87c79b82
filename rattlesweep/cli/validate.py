"""`rattlesweep validate`: whether a config is right."""

from __future__ import annotations

from pathlib import Path

import click

from rattlesweep.cli.common import command, options, say
from rattlesweep.errors import one_line


@command(
    "Sweeps",
    "rattlesweep validate configs/steady.yaml",
    "rattlesweep validate configs/steady.yaml --set integrator.tol=1e-8",
)
@options.config
@options.overrides
def validate(config: Path, overrides: tuple[str, ...]) -> None:
    """Check a config without running it.

    Prints how many runs it makes, or everything that is wrong, each with its line and column.
    """
    from rattlesweep.sweeps.config.load import load_config
    from rattlesweep.sweeps.sense import checked_plan

    plan, warnings = checked_plan(load_config(config, overrides), config.resolve().parent)
    for warning in warnings:
        say(f"warning: {warning}")
    count = f"{len(plan.cases)} cases x {plan.samples} samples = {plan.runs} runs"
    click.echo(f"{one_line(str(config), 200)} is valid: {count}")
