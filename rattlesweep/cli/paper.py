"""`rattlesweep paper`: every figure and every claim of the paper."""

from __future__ import annotations

import time
from pathlib import Path

import click
from click import option

from rattlesweep.cli.common import DONE, SOME_FAILED, Meter, command, options, say, types


@command(
    section="Study",
    resumes=True,
    examples=(
        "rattlesweep paper --quick",
        "rattlesweep paper --only fig6,fig7 --output out/paper",
    ),
)
@option(
    "-o",
    "--output",
    type=types.DIRECTORY,
    help="Output directory; by default out/paper, or out/paper-quick.",
)
@option("--quick", is_flag=True, help="Fewer samples: faster, with wide intervals.")
@option("--only", metavar="NAMES", help="Figures to make, such as fig6,fig7, or theory.")
@option("--config", metavar="FILE", type=click.Path(), help="Settings to replace.")
@option("--print-config", is_flag=True, help="Print the default settings and exit.")
@options.threads
@options.quiet
def paper(
    output: Path | None,
    quick: bool,
    only: str | None,
    config: str | None,
    print_config: bool,
    threads: int | None,
    quiet: bool,
) -> int:
    """Reproduce the figures of Kondo and Nakanishi (2017) and check their claims.

    Writes each figure's data (Parquet) and picture (SVG, PNG), claims.parquet and report.html, a
    self-contained page. After a stop the same command resumes: finished figures and blocks of
    runs are kept, and only the counts of fig3 (half a minute at most) are lost. Prints the
    verdicts on standard output, with the number of checks that hold.
    """
    from rattlesweep.paper.settings import load_paper, shipped

    if print_config:
        click.echo(shipped(), nl=False)
        return DONE
    settings = load_paper(config)

    from rattlesweep.integrate.batch import available_threads
    from rattlesweep.paper.figures.registry import choose
    from rattlesweep.paper.report import closing_table, tally
    from rattlesweep.paper.run import make_paper

    names = choose(only)
    directory = output or Path("out/paper-quick" if quick else "out/paper")
    start = time.monotonic()
    with Meter(quiet) as meter:
        done = make_paper(
            settings.quick() if quick else settings,
            directory,
            names,
            quick=quick,
            threads=threads or available_threads(),
            report=lambda p: meter.show(p.fraction, p.text, p.elapsed, p.left),
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
