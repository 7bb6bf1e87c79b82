"""`rattlesweep paper`: every figure and every claim of the paper."""

from __future__ import annotations

import time
from pathlib import Path

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.command import DONE, SOME_FAILED, command, say
from rattlesweep.progress import Bar


@command(
    "Studies",
    "rattlesweep paper --quick",
    "rattlesweep paper --only fig6,fig7 --output out/paper",
)
@options.output("Output directory; by default out/paper, or out/paper-quick.")
@option("--quick", is_flag=True, help="Fewer samples: faster, with wide intervals.")
@option("--only", metavar="NAMES", help="Figures to make, such as fig6,fig7, or theory.")
@options.threads
@options.quiet
def paper(
    output: Path | None, quick: bool, only: str | None, threads: int | None, quiet: bool
) -> int:
    """Reproduce the figures of Kondo and Nakanishi (2017) and check their claims.

    Writes each figure's data (Parquet) and picture (SVG, PNG), claims.parquet and report.html, a
    self-contained page. After a stop the same command resumes: finished figures and blocks of
    runs are kept, and only the counts of fig3 (half a minute at most) are lost. Prints the
    verdicts on standard output, with the number of checks that hold.
    """
    from rattlesweep.integrate.batch import available_threads
    from rattlesweep.paper.registry import choose
    from rattlesweep.paper.report import closing_table, tally
    from rattlesweep.paper.run import reproduce
    from rattlesweep.paper.workspace import FULL, QUICK

    names = choose(only)
    directory = output or Path("out/paper-quick" if quick else "out/paper")
    start = time.monotonic()
    with Bar.of_command(quiet) as bar:
        done = reproduce(
            directory,
            names,
            sizes=QUICK if quick else FULL,
            threads=threads or available_threads(),
            show=bar.show,
        )
    if not quiet:
        if done.claims:
            click.echo(closing_table(done.claims))
            say(f"{len(done.claims)} claims: {tally(done.claims)}")
        say(f"{directory / 'report.html'}; {time.monotonic() - start:.1f} s")
    if done.failed:
        say(f"{done.failed} runs of the sweeps are not ok; see their column status")
        return SOME_FAILED
    return DONE
