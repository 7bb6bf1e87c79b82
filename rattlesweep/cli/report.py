"""`rattlesweep report`: a sweep on one page."""

from __future__ import annotations

from pathlib import Path

import click

from rattlesweep.cli import options
from rattlesweep.cli.common import DONE, guarded, say


@click.command(
    epilog="\b\nExamples:\n  rattlesweep report out/quickstart\n"
    "  rattlesweep report out/steady --output steady.html --title 'Steady direction'"
)
@click.argument("directory", type=click.Path())
@click.option("--output", metavar="FILE", help="File to write; by default DIRECTORY/report.html.")
@options.title_option
@guarded
def report(directory: str, output: str | None, title: str | None) -> int:
    """Write one self-contained HTML page about a sweep and print its path.

    It holds the config, cases, figures, failures, cost and provenance. Works at any time, even
    while the sweep is running.
    """
    from rattlesweep.errors import ConfigError
    from rattlesweep.study.report.page import make_report
    from rattlesweep.sweeps.store.atomic import replace_file

    if output is not None and not output.lower().endswith((".html", ".htm")):
        raise ConfigError(f"--output {output}: the name must end in .html")
    options.check_title(title)
    path = Path(directory) / "report.html" if output is None else Path(output)
    page = make_report(Path(directory), title)
    replace_file(path, page)
    click.echo(path)
    say(f"{len(page) / 1e6:.2f} MB")
    return DONE
