"""`rattlesweep schema`: the JSON Schema of the config."""

from __future__ import annotations

import click

from rattlesweep.cli.common import command, to_json


@command("Study", "rattlesweep schema > rattlesweep.schema.json")
def schema() -> None:
    """Print the JSON Schema of the config."""
    from rattlesweep.sweeps.config.read import config_json_schema

    click.echo(to_json(config_json_schema()))
