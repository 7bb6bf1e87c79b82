"""Commands of studies: the figures of the paper, and the price of accuracy."""

from __future__ import annotations

import time
from pathlib import Path

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.options import COUNT, DONE, command, print_result, say
from rattlesweep.system.console import Bar, counted


@command(
    "Studies",
    "rattlesweep paper --quick",
    "rattlesweep paper --only fig7,fig8",
    "rattlesweep paper --set bodies.ranges.theta=[0.7,0.8] --output out/narrow",
)
@options.output("Output directory; by default out/paper, or out/paper-quick.")
@option("--quick", is_flag=True, help="Fewer samples: faster, with wide intervals.")
@option(
    "--only", metavar="NAMES", help="Only these parts, such as fig7,fig8 or theory."
)
@options.overrides
@option("--size", type=options.FIGURE_SIZE, help="Size of each figure, in inches.")
@option("--style", metavar="STYLE", help="A style of Matplotlib, as of `plot`.")
@options.threads
@options.quiet
def paper(
    output: Path | None,
    quick: bool,
    only: str | None,
    overrides: tuple[str, ...],
    size: tuple[float, float] | None,
    style: str | None,
    threads: int | None,
    quiet: bool,
) -> int:
    """Reproduce the figures of Kondo and Nakanishi (2017) and check their claims.

    Prints a verdict on each claim. Writes data and pictures of the figures, and
    report.html, a self-contained page. After a stop the same command resumes. Bodies
    of other ranges (--set bodies.ranges.theta=[0.7,0.8]) need an --output of their own.
    """
    from rattlesweep.paper.reproduce import (
        choose_figures,
        reproduce,
        tally,
        verdict_table,
    )
    from rattlesweep.paper.workspace import FULL_SIZES, QUICK_SIZES, Workspace

    start = time.monotonic()
    names = choose_figures(only)
    directory = output or Path("out/paper-quick" if quick else "out/paper")
    sizes = QUICK_SIZES if quick else FULL_SIZES
    progress = False if quiet else None
    workspace = Workspace(
        directory, sizes, overrides, threads=threads, progress=progress
    )
    with Bar.of_command(quiet) as bar:
        claims = reproduce(workspace, names, bar.stage, style=style, size=size)
    if not quiet:
        if claims:
            click.echo(verdict_table(claims))
            say(f"{len(claims)} claims: {tally(claims)}")
        say(f"{directory / 'report.html'}; {time.monotonic() - start:.1f} s")
    if workspace.failed:
        runs = counted(workspace.failed, "run")
        say(f"{runs} of the sweeps failed; see their column status")
        return options.SOME_FAILED
    return DONE


@command(
    "Studies",
    "rattlesweep tradeoff --quick",
    "rattlesweep tradeoff configs/tradeoff.yaml",
)
@options.path("config", required=False)
@options.output()
@option(
    "--samples", type=COUNT, help="Number of bodies; by default enough for 2000 runs."
)
@option("--quick", is_flag=True, help="Fewer runs and methods: faster, but rough.")
@options.overrides
@options.threads
@options.as_json
def tradeoff(
    config: Path | None,
    output: Path | None,
    samples: int | None,
    quick: bool,
    overrides: tuple[str, ...],
    threads: int | None,
    as_json: bool,
) -> None:
    """Measure speed against accuracy on this machine.

    Integrates the same runs by several methods, settings and models. The runs are drawn
    from CONFIG, by default shell-dumbbell bodies in both directions. Prints a table
    with the costs on one thread and the cheapest setting for some errors of t_r; writes
    tradeoff.parquet, .svg, .png.
    """
    from rattlesweep.analysis import tradeoff as study
    from rattlesweep.config.read import load_config, parse_config
    from rattlesweep.kernel.threads import available_threads
    from rattlesweep.system.files import as_path, probe_directory

    start = time.monotonic()
    base: Path | None = None
    if config is None:
        loaded = parse_config(study.DEFAULT, overrides)
    else:
        loaded = load_config(config, overrides)
        base = config.resolve().parent
    directory = output or as_path(loaded.directory, "output")
    probe_directory(directory)
    measured = study.measure(
        loaded,
        base,
        settings=study.QUICK_SETTINGS if quick else study.FULL_SETTINGS,
        samples=samples,
        least=300 if quick else 2000,
        threads=threads or available_threads(),
        report=Bar.of_command().stage,
    )
    files = study.save_tradeoff(measured, directory)
    print_result(as_json, study.as_data(measured), study.tradeoff_text(measured))
    names = ", ".join(path.name for path in files)
    say(f"{names} in {directory}; {time.monotonic() - start:.1f} s")
