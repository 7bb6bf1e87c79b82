"""Commands that show the results of a sweep: figures, tables, reports, comparisons."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from click import option

from rattlesweep.cli import options
from rattlesweep.cli.options import DONE, command, print_result, probe_files, say, tell
from rattlesweep.system.console import counted
from rattlesweep.words.defaults import FIGURE_DPI


@command(
    "Results of a sweep",
    "rattlesweep plot out/steady --kind ratio --select n_i=-0.1,-0.3 "
    "--output ratio.pdf",
    "rattlesweep plot out/steady --kind scatter --x K_r "
    "--where 'type == \"R\" and t_r < 2e3'",
    "rattlesweep plot out/steady --kind fractions --x xi --data xi.csv",
    "rattlesweep plot out/steady --kind times --panels n_i --labels german.yaml",
    "rattlesweep plot out/map-theta-spin --select theta=0.84:0.99 --select n_i=-0.45:0",
)
@options.directory
@option(
    "--kind", type=options.PLOTS, help="Kind of plot; by default what suits the sweep."
)
@option(
    "--x",
    metavar="NAME",
    help="Abscissa: what the config varies; for a scatter or fractions any column.",
)
@option(
    "--quantity",
    metavar="COLUMN",
    help="Numeric column for a map, a distribution or the ordinate of a scatter.",
)
@option("--colour", metavar="COLUMN", help="Numeric column that colours a scatter.")
@option(
    "--panels",
    metavar="COLUMN",
    help="What the config varies, each value in a panel of its own, as in n_i.",
)
@option(
    "--select",
    metavar="NAME=VALUES",
    multiple=True,
    help="Only runs with these values, as "
    "in n_i=-0.3,-0.5 or theta=0.6:0.7; may be repeated.",
)
@options.where
@option(
    "--log/--linear",
    default=None,
    help="Logarithmic or linear axes; by default by range.",
)
@option("--xlim", type=options.LOW_HIGH, help="Limits of the abscissa.")
@option("--ylim", type=options.LOW_HIGH, help="Limits of the ordinate.")
@option("--size", type=options.FIGURE_SIZE, help="Width and height in inches.")
@option(
    "--dpi",
    type=options.DPI_VALUE,
    default=FIGURE_DPI,
    help="Dots per inch of a PNG, 20 to 600.",
)
@option(
    "--style",
    metavar="STYLE",
    help="A style of Matplotlib: a file (.mplstyle), or a name such as ggplot.",
)
@option(
    "--no-caption",
    "caption",
    flag_value=False,
    default=True,
    show_default=False,
    help="Leave out the sentences below the figure.",
)
@option(
    "--labels",
    type=options.FILE,
    help="A YAML file with other texts for the figure, as in 'ylabel: Anteil'.",
)
@option("--title", help="Title of the figure; may hold formulas, as in '$n_i$'.")
@options.file(
    "--output",
    *options.PICTURES,
    multiple=True,
    help="May be repeated; by default DIRECTORY/KIND.svg and .png.",
)
@options.data
def plot(
    directory: Path,
    dpi: float,
    style: str | None,
    output: tuple[Path, ...],
    data: Path | None,
    labels: Path | None,
    **given: Any,
) -> None:
    """Plot a sweep: fractions of types, reversal times, a map of a grid.

    Works at any time, even while the sweep is running. A map shows the mean of a column
    by colours, a distribution its histogram. Prints the paths of the files it writes.
    """
    from rattlesweep.analysis.labels import read_labels
    from rattlesweep.analysis.layout import read_layout
    from rattlesweep.analysis.plots import choose_picture
    from rattlesweep.analysis.style import (
        local_numbers,
        save_figure,
        save_table,
        styled,
    )

    probe_files(*output, data)
    names = ("title", "log", "size", "xlim", "ylim", "caption")
    looks = {name: given.pop(name) for name in names}
    looks["labels"] = read_labels(labels)
    paths = list(output)
    with styled(style):
        picture = choose_picture(read_layout(directory), **given)
        if not paths:
            paths = [directory / f"{picture.name}{end}" for end in (".svg", ".png")]
        with local_numbers():
            save_figure(picture.figure(**looks), paths, dpi)
    if data is not None:
        save_table(picture.table(), data)
        paths.append(data)
    tell(*paths)
    say(f"{picture.name}: {counted(len(picture), 'run')}")


@command(
    "Results of a sweep",
    "rattlesweep table out/steady --output runs.csv",
    "rattlesweep table out/steady --columns n_i,t_r,type --where 'type == \"R\"'",
    "rattlesweep table out/steady --output runs.arrow",
)
@options.directory
@option(
    "--columns",
    type=options.NAME_LIST,
    help="Columns in this order, as in n_i,t_r,type; by default all.",
)
@options.where
@option(
    "--units",
    is_flag=True,
    help="Write units into the head of a CSV, as in 't_r [sqrt(a/g)]'.",
)
@options.file(
    "--output",
    ".csv",
    ".parquet",
    ".arrow",
    help="File to write; without it, CSV goes to standard output.",
)
def table(
    directory: Path,
    columns: tuple[str, ...] | None,
    where: str | None,
    units: bool,
    output: Path | None,
) -> None:
    """Write the runs of a sweep as one table: CSV, Parquet, or Arrow.

    A row is a run, in order of case and sample; docs/columns.md lists the columns. In
    CSV a null is an empty cell. Works at any time, even while the sweep is running, and
    with little memory. Prints the path of the file.
    """
    from rattlesweep.analysis.one_table import chosen_batches, schema_of, write_rows
    from rattlesweep.store.rows import open_stored

    probe_files(output)
    stored = open_stored(directory)
    schema = schema_of(stored, columns)
    batches = chosen_batches(stored, schema, where)
    rows = write_rows(batches, schema, output, sys.stdout.buffer, units)
    if output is not None:
        tell(output)
    say(counted(rows, "run"))


@command(
    "Results of a sweep", "rattlesweep report out/steady --title 'Steady direction'"
)
@options.directory
@options.file(
    "--output", ".html", ".htm", help="File to write; by default DIRECTORY/report.html."
)
@options.title
def report(directory: Path, output: Path | None, title: str | None) -> None:
    """Write one self-contained HTML page about a sweep.

    It holds the config, cases, figures, failures, cost and provenance. Works at any
    time, even while the sweep is running. Prints the path of the page.
    """
    from rattlesweep.api import load

    probe_files(output)
    page = load(directory).report(output, title=title)
    tell(page.path)
    say(f"{len(page.content) / 1e6:.2f} MB")


@command(
    "Results of a sweep",
    "rattlesweep compare out/here out/there --figure differences.svg",
)
@options.path("a")
@options.path("b")
# t_r_error should cover 99.5 % of the runs.
@option(
    "--allow",
    type=options.SHARE,
    default=0.005,
    help="Share of runs that may be beyond.",
)
@options.figure
@options.data
@options.as_json
def compare(
    a: Path,
    b: Path,
    allow: float,
    figure: Path | None,
    data: Path | None,
    as_json: bool,
) -> int:
    """Compare two output directories of the same runs.

    A and B may differ in tolerance, method, machine or version. Differences of t_r are
    relative to their mean. "beyond" counts runs whose t_r differ by more than their
    errors, "types_sure" those whose types differ although both are sure. Exits with 1
    if there are such types, or if the share of runs beyond is larger than --allow.

    If A and B differ in model or dissipation, the differences are said to be of models:
    ratios of t_r (B over A), and a table of types against types.
    """
    from rattlesweep.analysis import compare as compared
    from rattlesweep.analysis.style import save_table

    probe_files(figure, data)
    result = compared.compare(a, b)
    if data is not None:
        save_table(result.runs, data)
    if figure is not None:
        compared.save_comparison(result, figure)
    text = compared.comparison_text(result, options.PRINTED_ROWS)
    print_result(as_json, result.data, text)
    if result.disagree(allow):
        say("the directories disagree")
        return options.EXIT_FAILED
    return DONE


@command(
    "Results of a sweep", "rattlesweep sensitivity out/design --figure indices.svg"
)
@options.directory
@options.figure
@options.as_json
def sensitivity(directory: Path, figure: Path | None, as_json: bool) -> None:
    """Estimate which parameters of the bodies t_r and the types depend on.

    Prints first-order and total Sobol' indices for each case, with 95 % bootstrap
    intervals. The sweep's config must have bodies.draw: saltelli. Indices of t_r need a
    case in which nearly all runs reverse.
    """
    from rattlesweep.analysis import sensitivity as estimate

    probe_files(figure)
    indices = estimate.sensitivity(directory)
    if figure is not None:
        estimate.save_sensitivity(indices, figure)
    text = estimate.sensitivity_text(indices, options.PRINTED_ROWS)
    print_result(as_json, indices, text)
