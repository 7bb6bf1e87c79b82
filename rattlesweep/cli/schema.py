"""`rattlesweep schema`: the JSON Schema of the config."""

from __future__ import annotations

import json

import click

from rattlesweep.cli.common import DONE, guarded


@click.command(epilog="\b\nExample:\n  rattlesweep schema > rattlesweep.schema.json")
@guarded
def schema() -> int:
    """Print the JSON Schema of the config."""
    from rattlesweep.sweeps.config.load import config_json_schema

    click.echo(json.dumps(config_json_schema(), indent=2))
    return DONE
