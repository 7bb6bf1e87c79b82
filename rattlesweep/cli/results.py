"""Commands that show the results of sweeps: pictures, pages, comparisons."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.command import DONE, FAILED, MOST_ROWS, command, probe, say, to_json


@command(
    "Results of a sweep",
    "rattlesweep plot out/quickstart",
    "rattlesweep plot out/steady --kind ratio --select n_i=-0.1,-0.3 --output ratio.pdf",
    "rattlesweep plot out/steady --kind scatter --x K_r --ylim 10,1e4",
    "rattlesweep plot out/map-theta-spin --select theta=0.84:0.99 --select n_i=-0.45:0",
    "rattlesweep plot out/steady --kind times --where 'type == \"R\" and t_r < 2 * t_rgh'",
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
@option("--title", type=options.Kind("text", "rattlesweep.analysis.style:check_formula"),
        help="Title of the picture, perhaps with a formula, as in '$n_i$'.")  # fmt: skip
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
    from rattlesweep.analysis.plots.kinds import choose_picture
    from rattlesweep.analysis.plots.layout import read_layout
    from rattlesweep.analysis.style import save, styled

    looks = {name: given.pop(name) for name in ("title", "log", "size", "xlim", "ylim")}
    with styled(style):
        picture = choose_picture(read_layout(directory), **given)
        paths = list(output) or [directory / f"{picture.name}{end}" for end in (".svg", ".png")]
        save(picture.figure(**looks), paths, dpi)
    if data is not None:
        picture.write_data(data)
        paths.append(data)
    click.echo("\n".join(map(str, paths)))
    say(f"{picture.name}: {picture.words()}")


@command(
    "Results of a sweep",
    "rattlesweep report out/quickstart",
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
    "rattlesweep compare out/tol-1e-9 out/tol-1e-11",
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

    A and B may be of another tolerance, method, machine or version; other bodies, launches,
    horizons or models are refused with exit code 2. Runs that only one of them has are left out.
    Differences of t_r are relative to the mean of both.

    In the table, "beyond" counts runs whose t_r differ by more than sqrt(e_A^2 + e_B^2), where e
    is t_r_error, and "types_sure" counts differing types that are sure in both (type_sure). Where
    both record errors, exits with 1 if a larger share than --allow is beyond, or if types that are
    sure differ.
    """
    from rattlesweep.analysis import compare as compared

    probe(figure, data)
    result = compared.compare(a, b)
    if data is not None:
        result.write_runs(data)
    if figure is not None:
        compared.save(result, figure)
    click.echo(to_json(result.data()) if as_json else compared.as_text(result, MOST_ROWS))
    if result.disagree(allow):
        say("the directories disagree")
        return FAILED
    return DONE


@command(
    "Results of a sweep",
    "rattlesweep sensitivity out/design",
    "rattlesweep sensitivity out/design --json --figure indices.svg",
)
@options.directory
@options.figure
@options.as_json
def sensitivity(directory: Path, figure: Path | None, as_json: bool) -> None:
    """Estimate which parameters of the bodies t_r and the types depend on.

    Prints Sobol' indices by case, with 95 % intervals (bootstrap): first-order ones, the share of
    the variance that goes with a parameter alone, and total ones, the share that would be left if
    all others were known. They need bodies.draw: saltelli in the sweep's config. Those of t_r and
    log10 t_r are told where nearly all runs reverse, those of P(R), P(SS), ... always.
    """
    from rattlesweep.analysis import sensitivity as estimate

    probe(figure)
    found = estimate.sensitivity(directory)
    if figure is not None:
        estimate.save(found, figure)
    click.echo(to_json(found.data()) if as_json else estimate.as_text(found, MOST_ROWS))
