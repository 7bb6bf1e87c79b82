"""`rattlesweep paper`: every figure and every claim of the paper."""

from __future__ import annotations

import time
from pathlib import Path

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.command import DONE, SOME_FAILED, command, say
from rattlesweep.progress import Bar
from rattlesweep.text import counted


@command(
    "Studies",
    "rattlesweep paper --quick",
    "rattlesweep paper --only fig7,fig8 --output out/paper",
)
@options.output("Output directory; by default out/paper, or out/paper-quick.")
@option("--quick", is_flag=True, help="Fewer samples: faster, with wide intervals.")
@option("--only", metavar="NAMES", help="Parts to make, such as fig7,fig8, or theory.")
@options.threads
@options.quiet
def paper(
    output: Path | None, quick: bool, only: str | None, threads: int | None, quiet: bool
) -> int:
    """Reproduce the figures of Kondo and Nakanishi (2017) and check their claims.

    Writes the data (Parquet) and the picture (SVG, PNG) of each figure, the verdicts on the claims
    (claims.parquet, claims.md) and report.html, a self-contained page. After a stop the same
    command resumes its sweeps; all else takes seconds and is computed anew. Prints each claim, its
    verdict and what was measured on standard output.
    """
    from rattlesweep.paper.report import closing_table, tally
    from rattlesweep.paper.reproduce import choose, reproduce
    from rattlesweep.paper.workspace import FULL, QUICK, Workspace

    names = choose(only)
    directory = output or Path("out/paper-quick" if quick else "out/paper")
    start = time.monotonic()
    sizes = QUICK if quick else FULL
    workspace = Workspace(directory, sizes, threads, False if quiet else None)
    with Bar.of_command(quiet) as bar:
        done = reproduce(workspace, names, bar.stage)
    if not quiet:
        if done.claims:
            click.echo(closing_table(done.claims))
            say(f"{len(done.claims)} claims: {tally(done.claims)}")
        say(f"{directory / 'report.html'}; {time.monotonic() - start:.1f} s")
    if workspace.failed:
        failed = counted(workspace.failed, "run")
        say(f"{failed} of the sweeps failed; see their column status")
        return SOME_FAILED
    return DONE
