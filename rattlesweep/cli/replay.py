"""`rattlesweep replay`: stored runs again, as trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from click import option

from rattlesweep.cli.common import Meter, command, options, say, types
from rattlesweep.cli.common.output import say_outcome, write_course

if TYPE_CHECKING:
    from rattlesweep.study.onerun.course import Course
    from rattlesweep.study.onerun.replay import StoredRun


@command(
    section="One run",
    examples=(
        "rattlesweep replay out/quickstart --case 3 --sample 17 --figure run.svg",
        "rattlesweep replay out/quickstart --where \"type = 'SW' and K_r < 0.005\" --first 3 "
        "--output run-{case}-{sample}.parquet",
    ),
)
@options.directory
@options.which_runs
@options.t_end
@options.rows
@options.channels
@option(
    "-o",
    "--output",
    type=types.file(".parquet", ".csv"),
    help="A .parquet or .csv file; {case} and {sample} are substituted.",
)
@option(
    "--figure",
    type=types.file(".svg", ".png", ".pdf"),
    help="Plot to an .svg, .png or .pdf file; likewise.",
)
@options.quiet
def replay(
    directory: Path,
    which: dict[str, Any],
    t_end: float | None,
    rows: dict[str, Any],
    channels: tuple[str, ...] | None,
    output: Path | None,
    figure: Path | None,
    quiet: bool,
) -> int:
    """Integrate stored runs of DIRECTORY again as time series that continue past their reversals.

    Each run is first integrated as in the sweep, and its row is checked against the stored one, bit
    for bit; so is the first reversal of the series. Exits with 1 if any differs.
    """
    from rattlesweep.study.onerun.replay import Replay, check_course, find, said, targets
    from rattlesweep.sweeps.store.atomic import probe_directory

    source = Replay(directory)
    model = source.config.model
    runs = find(source, **which)
    outputs = targets(str(output) if output else None, runs, "--output", printed=figure is None)
    drawings = targets(str(figure) if figure else None, runs, "--figure")
    for path in filter(None, (*outputs, *drawings)):
        probe_directory(path.parent)

    def one(run: StoredRun, out: Path | None, drawing: Path | None) -> int:
        source.prove(run)

        def table() -> Course:
            names = ("t", "n") if channels is None else channels
            return source.course(run, t_end=t_end, channels=names, watch=watch, **rows)

        def drawn() -> Course:
            from rattlesweep.study.onerun.figure import at_its_times, channels_of

            names = channels_of(model, shown=channels)
            return at_its_times(source.course(run, t_end=t_end, channels=names, watch=watch))

        with Meter(quiet or not options.bar_fits(out, drawing)) as meter:
            watch = meter.counting("integrating")
            course = write_course(table, drawn, out, drawing)
        check_course(run, course, model)
        if not quiet:
            say(said(run))
        return say_outcome(course, quiet)

    return max(one(*each) for each in zip(runs, outputs, drawings, strict=True))
