"""`rattlesweep plot`: the right picture of any output directory."""

from __future__ import annotations

from pathlib import Path

import click

from rattlesweep.cli import options
from rattlesweep.cli.common import DONE, guarded, say


@click.command(
    epilog="\b\nExamples:\n  rattlesweep plot out/quickstart\n"
    "  rattlesweep plot out/steady --kind ratio --select n_i=-0.1,-0.3 --output ratio.pdf\n"
    "  rattlesweep plot out/steady --kind scatter --x K_r --ylim 10,1e4\n"
    "  rattlesweep plot out/map-theta-spin --select theta=0.84:0.99 --select n_i=-0.45:0"
)
@click.argument("directory", type=click.Path())
@click.option(
    "--kind",
    metavar="KIND",
    help="fractions, times (t_r), ratio (t_r/t_rGH), map, distribution or scatter; by default the "
    "one that suits the sweep.",
)
@click.option(
    "--x",
    metavar="NAME",
    help="Quantity along the abscissa: something that the config varies, such as n_i, or any "
    "column of the runs, such as K_p or n_0, for a scatter of t_r.",
)
@click.option(
    "--select",
    metavar="NAME=VALUES",
    multiple=True,
    help="Only these values, as in n_i=-0.3,-0.5 or theta=0.6:0.7; may be repeated.",
)
@click.option(
    "--log/--linear", default=None, help="Logarithmic or linear axes; by default by range."
)
@click.option("--xlim", metavar="LOW,HIGH", help="Limits of the abscissa.")
@click.option("--ylim", metavar="LOW,HIGH", help="Limits of the ordinate.")
@click.option("--size", metavar="W,H", help="Width and height in inches.")
@click.option(
    "--dpi", type=click.FloatRange(20, 1200), default=150.0, help="Dots per inch of a PNG."
)
@click.option("--style", metavar="FILE", help="A Matplotlib style file (.mplstyle).")
@options.title_option
@click.option(
    "--output",
    metavar="FILE",
    multiple=True,
    help="An .svg, .png or .pdf file; may be repeated. By default DIRECTORY/KIND.svg and .png.",
)
@click.option("--data", metavar="FILE", help="Also write the plotted numbers, as .csv or .parquet.")
@guarded
def plot(
    directory: str,
    kind: str | None,
    x: str | None,
    select: tuple[str, ...],
    log: bool | None,
    xlim: str | None,
    ylim: str | None,
    size: str | None,
    dpi: float,
    style: str | None,
    title: str | None,
    output: tuple[str, ...],
    data: str | None,
) -> int:
    """Plot a sweep: fractions of types, reversal times against theory, or a map of a grid.

    Works at any time, even while the sweep is running. Prints the paths of what it writes.
    """
    from rattlesweep.study.plots import files as plot_files
    from rattlesweep.study.plots.layout import read_layout
    from rattlesweep.study.plots.registry import read_picture
    from rattlesweep.study.style import styled

    paths, table = plot_files.named_outputs(output), plot_files.named_data(data)
    inches = plot_files.parse_size(size)
    limits = [plot_files.parse_limits(*each) for each in (("--xlim", xlim), ("--ylim", ylim))]
    options.check_title(title, formulas=True)
    with styled(None if style is None else Path(style)):
        picture = read_picture(read_layout(Path(directory)), kind, x=x, select=select)
        name = picture.kind.name
        paths = paths or [Path(directory) / f"{name}.{ending}" for ending in ("svg", "png")]
        figure = picture.figure(title=title, log=log, size=inches, xlim=limits[0], ylim=limits[1])
        plot_files.write_figure(figure, paths, dpi)
    if table is not None:
        plot_files.write_data(picture.table(), table)
        paths.append(table)
    for path in paths:
        click.echo(path)
    say(f"{name}: {picture.data.words()}")
    return DONE
