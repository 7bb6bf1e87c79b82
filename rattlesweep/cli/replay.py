"""`rattlesweep replay`: stored runs again, as trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rattlesweep.cli.common import command, options, probe, say, types
from rattlesweep.cli.common.series import say_outcome, write_course


@command(
    "One run",
    "rattlesweep replay out/quickstart --case 3 --sample 17 --figure run.svg",
    "rattlesweep replay out/quickstart --where \"type = 'SW' and K_r < 0.005\" --first 3 "
    "--output run-{case}-{sample}.parquet",
)
@options.directory
@options.which_runs
@options.t_end
@options.rows
@options.channels
@options.file("--output", ".parquet", ".csv",
              help="A .parquet or .csv file; {case} and {sample} are substituted.")  # fmt: skip
@options.file("--figure", *types.PICTURES,
              help="Plot to an .svg, .png or .pdf file; likewise.")  # fmt: skip
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
    from rattlesweep.analysis.derived import in_units_of
    from rattlesweep.analysis.onerun.replay import Replay, targets
    from rattlesweep.analysis.onerun.rows import Rows

    in_units_of(None, {"t_end": t_end})
    source = Replay(directory)
    runs = source.select(**which)
    outputs = targets(output, runs, "--output", printed=figure is None)
    drawings = targets(figure, runs, "--figure")
    probe(*outputs, *drawings)
    codes = []
    for run, out, drawing in zip(runs, outputs, drawings, strict=True):
        source.prove(run)
        prepared = source.prepare(run, t_end)
        course = write_course(prepared, channels, Rows(**rows), out, drawing, quiet)
        run.check(course)
        if not quiet:
            say(run.proof)
            if cause := source.cause(run):
                say(cause)
        codes.append(say_outcome(course, quiet))
    return max(codes)
