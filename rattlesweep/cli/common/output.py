"""What goes out: data to standard output, everything else to standard error, and exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rattlesweep.errors import printable

if TYPE_CHECKING:
    import pyarrow as pa

DONE, FAILED, WRONG, SOME_FAILED, EARLY, INTERRUPTED, TERMINATED = 0, 1, 2, 3, 75, 130, 143
# Rows of a table on the terminal.
MOST_ROWS = 20


def say(text: str) -> None:
    """Write a line to standard error."""
    click.echo(printable(text), err=True)


def to_json(data: Any) -> str:
    """Data as JSON that every reader takes."""
    return json.dumps(data, indent=2, allow_nan=False)


def probe(*files: Path | None) -> None:
    """See that files can be written where they are asked for, before anything is computed."""
    from rattlesweep.sweeps.files import probe_directory

    for path in filter(None, files):
        probe_directory(path.parent)


def print_summary(summary: pa.Table, directory: Path) -> None:
    """Print the table of a summary: all of its cases, or the first of many."""
    from rattlesweep.sweeps.summary import closing_table

    click.echo(closing_table(summary.slice(0, MOST_ROWS)))
    if (more := len(summary) - MOST_ROWS) > 0:
        say(f"{more} more cases are in {directory / 'summary.parquet'}")
