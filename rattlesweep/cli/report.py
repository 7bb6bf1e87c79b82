"""`rattlesweep report`: a sweep on one page."""

from __future__ import annotations

from pathlib import Path

import click

from rattlesweep.cli.common import command, options, say


@command(
    "Pictures and pages",
    "rattlesweep report out/quickstart",
    "rattlesweep report out/steady --output steady.html --title 'Steady direction'",
)
@options.directory
@options.file("--output", ".html", ".htm", help="File to write; by default DIRECTORY/report.html.")
@options.title()
def report(directory: Path, output: Path | None, title: str | None) -> None:
    """Write one self-contained HTML page about a sweep and print its path.

    It holds the config, cases, figures, failures, cost and provenance. Works at any time, even
    while the sweep is running.
    """
    from rattlesweep.analysis.report import make_report
    from rattlesweep.sweeps.files import replace_file

    path = output or directory / "report.html"
    page = make_report(directory, title)
    replace_file(path, page)
    click.echo(path)
    say(f"{len(page) / 1e6:.2f} MB")
