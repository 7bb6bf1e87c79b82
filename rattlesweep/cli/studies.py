"""Commands that are studies of their own: the paper, and speed against accuracy."""

from __future__ import annotations

import time
from pathlib import Path

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.command import DONE, SOME_FAILED, command, say, to_json
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


@command(
    "Studies",
    "rattlesweep tradeoff --quick",
    "rattlesweep tradeoff configs/tradeoff.yaml --output out/tradeoff",
)
@options.path("config", required=False)
@options.output()
@option("--samples", type=options.COUNT,
        help="Number of bodies; by default enough for 2000 runs.")  # fmt: skip
@option("--quick", is_flag=True, help="Fewer runs, methods and measurements: faster, but rough.")
@options.overrides
@options.threads
@options.as_json
def tradeoff(
    config: Path | None, output: Path | None, samples: int | None, quick: bool,
    overrides: tuple[str, ...], threads: int | None, as_json: bool,
) -> None:  # fmt: skip
    """Measure speed against accuracy on this machine.

    Integrates the same runs by several methods, settings and models. Draws them from CONFIG, by
    default shell-dumbbell bodies in both directions; ignores its model, integrator and record.
    Prints a table and the cheapest settings for some errors of t_r, and writes tradeoff.parquet,
    tradeoff.svg and tradeoff.png. Costs are measured on one thread, whatever --threads says.
    """
    from rattlesweep.analysis.tradeoff import DEFAULT, FULL, QUICK, as_data, as_text, measure, save
    from rattlesweep.integrate.batch import available_threads
    from rattlesweep.sweeps.config.read import load_config, override_config
    from rattlesweep.sweeps.files import probe_directory

    loaded = load_config(config, overrides) if config else override_config(DEFAULT, overrides)
    directory = output or Path(loaded.directory)
    probe_directory(directory)
    start = time.monotonic()
    study = measure(
        loaded, None if config is None else config.resolve().parent, samples=samples,
        scope=QUICK if quick else FULL, threads=threads or available_threads(),
        report=Bar.of_command().stage,
    )  # fmt: skip
    files = save(study, directory)
    click.echo(to_json(as_data(study)) if as_json else as_text(study))
    say(f"{', '.join(p.name for p in files)} in {directory}; {time.monotonic() - start:.1f} s")
