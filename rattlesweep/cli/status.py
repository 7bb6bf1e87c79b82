"""`rattlesweep status`: how far a sweep is."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from rattlesweep.cli.common import command, options, to_json
from rattlesweep.cli.common.output import DONE, SOME_FAILED


@command("Sweeps", "rattlesweep status out/quickstart")
@options.directory
@options.as_json
def status(directory: Path, as_json: bool) -> int:
    """Show the progress of a sweep: runs done, left and failed, expected end.

    Works at any time, even while the sweep is running. Exits with 3 if some runs have a status
    other than ok.
    """
    from rattlesweep.sweeps.old.status import describe, status_of

    found = status_of(directory)
    click.echo(to_json(asdict(found)) if as_json else describe(found))
    return SOME_FAILED if found.failed else DONE
