"""`rattlesweep status`: how far a sweep is."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from rattlesweep.cli.common import DONE, SOME_FAILED, guarded


@click.command(epilog="\b\nExample:\n  rattlesweep status out/quickstart")
@click.argument("directory", type=click.Path())
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@guarded
def status(directory: str, as_json: bool) -> int:
    """Show the progress of a sweep: runs done, left and failed, expected end.

    Works at any time, even while the sweep is running. Exits with 3 if some runs have a status
    other than ok.
    """
    from rattlesweep.sweeps.inspect.status import describe, status_of

    found = status_of(Path(directory))
    click.echo(json.dumps(asdict(found), indent=2) if as_json else describe(found))
    return SOME_FAILED if found.failed else DONE
