"""`rattlesweep validate`: whether a config is right."""

from __future__ import annotations

from pathlib import Path

import click

from rattlesweep.cli.common import command, options
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

    Prints how many runs it makes, or everything that is wrong, each with its line.
    """
    plan = options.planned(options.load_sweep(config, overrides), config)
    count = f"{len(plan.cases)} cases x {plan.samples} samples = {plan.runs} runs"
    click.echo(f"{one_line(str(config), 200)} is valid: {count}")
