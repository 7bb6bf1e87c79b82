"""`rattlesweep replay`: stored runs again, as trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rattlesweep.cli import options
from rattlesweep.cli.common import DONE, guarded, say
from rattlesweep.cli.series import Share, check_targets, close, deliver, print_channels

if TYPE_CHECKING:
    from rattlesweep.study.onerun.replay import StoredRun


@click.command(
    epilog="\b\nExamples:\n  rattlesweep replay out/quickstart --case 3 --sample 17 --figure "
    "run.svg\n  rattlesweep replay out/quickstart --where \"type = 'SW' and K_r < 0.005\" "
    "--first 3 --output run-{case}-{sample}.parquet"
)
@click.argument("directory", type=click.Path())
@options.which_options
@click.option(
    "--first", type=click.IntRange(1), help="Number of runs to take from --where.  [default: 1]"
)
@click.option("--t-end", type=float, help="Horizon, in sqrt(a/g); by default the sweep's.")
@options.rows_options
@click.option(
    "--output", metavar="FILE", help="A .parquet or .csv file; {case} and {sample} are substituted."
)
@click.option("--figure", metavar="FILE", help="Plot to an .svg, .png or .pdf file; likewise.")
@options.quiet_option
@guarded
def replay(
    directory: str,
    case: int | None,
    sample: int | None,
    where: str | None,
    first: int | None,
    t_end: float | None,
    channels: str,
    output: str | None,
    figure: str | None,
    quiet: bool,
    points: int | None,
    dt: float | None,
    steps: bool,
) -> int:
    """Integrate stored runs of DIRECTORY again as time series that continue past their reversals.

    Each run is first integrated as in the sweep, and its row is checked against the stored one, bit
    for bit; so is the first reversal of the series. Exits with 1 if any differs.
    """
    from rattlesweep.study.onerun.replay import Replay, targets
    from rattlesweep.study.onerun.rows import Rows

    if channels == "list":
        print_channels()
        return DONE
    source = Replay(Path(directory))
    runs = source.select(case, sample, where, first)
    outputs = targets(output, runs, "--output", printed=figure is None)
    drawings = targets(figure, runs, "--figure")
    for pair in zip(outputs, drawings, strict=True):
        check_targets(*pair)

    def one(run: StoredRun, out: Path | None, drawing: Path | None) -> int:
        source.prove(run)
        prepared = source.prepare(run, t_end)
        with Share(quiet, files=out is not None or drawing is not None) as bar:
            course = deliver(prepared, channels, Rows(points, dt, steps), out, drawing, bar)
        run.check(course)
        if not quiet:
            say(run.proof)
        return close(course, quiet)

    return max(one(*each) for each in zip(runs, outputs, drawings, strict=True))
