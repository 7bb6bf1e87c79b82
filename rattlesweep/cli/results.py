"""Commands that show the results of sweeps, and studies: the paper, speed against accuracy."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.command import (
    DONE,
    FAILED,
    MOST_ROWS,
    SOME_FAILED,
    command,
    probe,
    say,
    to_json,  # fmt: skip
)
from rattlesweep.progress import Bar
from rattlesweep.text import counted


@command(
    "Results of a sweep",
    "rattlesweep plot out/steady --kind ratio --select n_i=-0.1,-0.3 --output ratio.pdf",
    "rattlesweep plot out/steady --kind scatter --x K_r --where 'type == \"R\" and t_r < 2e3'",
    "rattlesweep plot out/map-theta-spin --select theta=0.84:0.99 --select n_i=-0.45:0",
)
@options.directory
@option("--kind", type=options.KINDS, help="What to draw; times are t_r, and ratio is t_r/t_rGH. "
        "By default what suits the sweep.")  # fmt: skip
@option("--x", metavar="NAME", help="Quantity along the abscissa: one that the config varies, such "
        "as n_i, or any column of the runs, such as K_p, for a scatter of t_r.")  # fmt: skip
@option("--quantity", metavar="COLUMN", help="Any numeric column of the runs that a map shows as "
        "colours (the mean of a cell), or a distribution as a histogram.")  # fmt: skip
@option("--select", metavar="NAME=VALUES", multiple=True, help="Only these values, as in "
        "n_i=-0.3,-0.5 or theta=0.6:0.7; may be repeated.")  # fmt: skip
@options.where
@option("--log/--linear", default=None, help="Logarithmic or linear axes; by default by range.")
@option("--xlim", type=options.LIMITS, help="Limits of the abscissa.")
@option("--ylim", type=options.LIMITS, help="Limits of the ordinate.")
@option("--size", type=options.SIZE, help="Width and height in inches.")
@option("--dpi", type=click.FloatRange(20, 600), default=150.0, help="Dots per inch of a PNG.")
@option("--style", metavar="FILE", type=click.Path(path_type=Path),
        help="A Matplotlib style file (.mplstyle).")  # fmt: skip
@option("--title", help="Title of the picture, perhaps with a formula, as in '$n_i$'.")
@options.file("--output", *options.PICTURES, multiple=True, help="An .svg, .png or .pdf file; may "
              "be repeated. By default DIRECTORY/KIND.svg and .png.")  # fmt: skip
@options.data
def plot(
    directory: Path, dpi: float, style: Path | None, output: tuple[Path, ...], data: Path | None,
    **given: Any,
) -> None:  # fmt: skip
    """Plot a sweep: shares of types, reversal times, a map of a grid.

    Works at any time, even while the sweep is running. Prints the paths of what it writes.
    """
    from rattlesweep.analysis.layout import read_layout
    from rattlesweep.analysis.plots import choose_picture
    from rattlesweep.analysis.style import save, save_table, styled

    looks = {name: given.pop(name) for name in ("title", "log", "size", "xlim", "ylim")}
    with styled(style):
        picture = choose_picture(read_layout(directory), **given)
        paths = list(output) or [directory / f"{picture.name}{end}" for end in (".svg", ".png")]
        save(picture.figure(**looks), paths, dpi)
    if data is not None:
        save_table(picture.table(), data)
        paths.append(data)
    click.echo("\n".join(map(str, paths)))
    say(f"{picture.name}: {counted(len(picture), 'run')}")


@command(
    "Results of a sweep",
    "rattlesweep report out/steady --output steady.html --title 'Steady direction'",
)
@options.directory
@options.file("--output", ".html", ".htm", help="File to write; by default DIRECTORY/report.html.")
@options.title
def report(directory: Path, output: Path | None, title: str | None) -> None:
    """Write one self-contained HTML page about a sweep.

    It holds the config, cases, figures, failures, cost and provenance. Works at any time, even
    while the sweep is running. Prints the path of the page.
    """
    from rattlesweep.analysis.report import make_report
    from rattlesweep.sweeps.files import replace_file

    path = output or directory / "report.html"
    page = make_report(directory, title)
    replace_file(path, page)
    click.echo(path)
    say(f"{len(page) / 1e6:.2f} MB")


@command(
    "Results of a sweep",
    "rattlesweep compare out/here out/there --figure differences.svg --data differences.parquet",
)
@options.path("a")
@options.path("b")
# t_r_error is to cover 99.5 % of the runs.
@option("--allow", metavar="SHARE", type=click.FloatRange(0, 1), default=0.005,
        help="Share of the runs that reverse in both which may differ by more.")  # fmt: skip
@options.figure
@options.data
@options.as_json
def compare(
    a: Path, b: Path, allow: float, figure: Path | None, data: Path | None, as_json: bool
) -> int:
    """Compare two output directories of the same runs.

    A and B may be of another tolerance, method, machine or version. Differences of t_r are relative
    to the mean of both. "beyond" counts runs whose t_r differ by more than their errors, and
    "types_sure" differing types that are sure in both: exits with 1 if a larger share than --allow
    is beyond, or if such types differ.
    """
    from rattlesweep.analysis import compare as compared
    from rattlesweep.analysis.style import save_table

    probe(figure, data)
    result = compared.compare(a, b)
    if data is not None:
        save_table(result.runs, data)
    if figure is not None:
        compared.save(result, figure)
    click.echo(to_json(result.data) if as_json else compared.as_text(result, MOST_ROWS))
    if result.disagree(allow):
        say("the directories disagree")
        return FAILED
    return DONE


@command(
    "Results of a sweep",
    "rattlesweep sensitivity out/design --json --figure indices.svg",
)
@options.directory
@options.figure
@options.as_json
def sensitivity(directory: Path, figure: Path | None, as_json: bool) -> None:
    """Estimate which parameters of the bodies t_r and the types depend on.

    Prints Sobol' indices by case, first-order and total ones, with 95 % intervals (bootstrap). They
    need bodies.draw: saltelli in the sweep's config; those of t_r are told where nearly all runs
    reverse.
    """
    from rattlesweep.analysis import sensitivity as estimate

    probe(figure)
    found = estimate.sensitivity(directory)
    if figure is not None:
        estimate.save(found, figure)
    click.echo(to_json(found) if as_json else estimate.as_text(found, MOST_ROWS))


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

    Writes the data and the picture of each figure, the verdicts on the claims, which it also
    prints, and report.html, a self-contained page. After a stop the same command resumes.
    """
    from rattlesweep.paper.report import closing_table, tally
    from rattlesweep.paper.reproduce import choose, reproduce
    from rattlesweep.paper.workspace import FULL, QUICK, Workspace

    names, start = choose(only), time.monotonic()
    directory = output or Path("out/paper-quick" if quick else "out/paper")
    workspace = Workspace(directory, QUICK if quick else FULL, threads, False if quiet else None)
    with Bar.of_command(quiet) as bar:
        done = reproduce(workspace, names, bar.stage)
    if not quiet:
        if done.claims:
            click.echo(closing_table(done.claims))
            say(f"{len(done.claims)} claims: {tally(done.claims)}")
        say(f"{directory / 'report.html'}; {time.monotonic() - start:.1f} s")
    if workspace.failed:
        say(f"{counted(workspace.failed, 'run')} of the sweeps failed; see their column status")
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

    Integrates the same runs by several methods, settings and models, drawn from CONFIG, by default
    shell-dumbbell bodies in both directions. Prints a table and the cheapest settings for some
    errors of t_r, and writes tradeoff.parquet, .svg and .png. Costs are those of one thread.
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
        settings=QUICK if quick else FULL, least=300 if quick else 2000,
        threads=threads or available_threads(), report=Bar.of_command().stage,
    )  # fmt: skip
    files = save(study, directory)
    click.echo(to_json(as_data(study)) if as_json else as_text(study))
    say(f"{', '.join(p.name for p in files)} in {directory}; {time.monotonic() - start:.1f} s")
