"""`rattlesweep plot`: the right picture of any output directory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click import option

from rattlesweep.cli.common import command, options, say, types


@command(
    "Pictures and pages",
    "rattlesweep plot out/quickstart",
    "rattlesweep plot out/steady --kind ratio --select n_i=-0.1,-0.3 --output ratio.pdf",
    "rattlesweep plot out/steady --kind scatter --x K_r --ylim 10,1e4",
    "rattlesweep plot out/map-theta-spin --select theta=0.84:0.99 --select n_i=-0.45:0",
    "rattlesweep plot out/steady --kind times --where 'type == \"R\" and t_r < 2 * t_rgh'",
)
@options.directory
@option("--kind", type=types.KINDS, help="What to draw; times are t_r, and ratio is t_r/t_rGH. By "
        "default what suits the sweep.")  # fmt: skip
@option("--x", metavar="NAME", help="Quantity along the abscissa: something that the config "
        "varies, such as n_i, or any column of the runs, such as K_p or n_0, for a scatter of "
        "t_r.")  # fmt: skip
@option("--quantity", metavar="COLUMN", help="Any numeric column of the runs that a map shows as "
        "colours (the mean of a cell), or a distribution as a histogram.")  # fmt: skip
@option("--select", metavar="NAME=VALUES", multiple=True, help="Only these values, as in "
        "n_i=-0.3,-0.5 or theta=0.6:0.7; may be repeated.")  # fmt: skip
@options.where
@option("--log/--linear", default=None, help="Logarithmic or linear axes; by default by range.")
@option("--xlim", type=types.LIMITS, help="Limits of the abscissa.")
@option("--ylim", type=types.LIMITS, help="Limits of the ordinate.")
@option("--size", type=types.SIZE, help="Width and height in inches.")
@option("--dpi", type=click.FloatRange(20, 1200), default=150.0, help="Dots per inch of a PNG.")
@option("--style", metavar="FILE", type=click.Path(path_type=Path),
        help="A Matplotlib style file (.mplstyle).")  # fmt: skip
@options.title(types.FORMULA)
@options.file("--output", *types.PICTURES, multiple=True, help="An .svg, .png or .pdf file; may "
              "be repeated. By default DIRECTORY/KIND.svg and .png.")  # fmt: skip
@options.file("--data", ".csv", ".parquet",
              help="Also write the plotted numbers, as .csv or .parquet.")  # fmt: skip
def plot(
    directory: Path,
    kind: str | None,
    x: str | None,
    quantity: str | None,
    select: tuple[str, ...],
    where: str | None,
    dpi: float,
    style: Path | None,
    output: tuple[Path, ...],
    data: Path | None,
    **looks: Any,
) -> None:
    """Plot a sweep: fractions of types, reversal times against theory, or a map of a grid.

    Works at any time, even while the sweep is running. Prints the paths of what it writes.
    """
    from rattlesweep.analysis.plots.kinds import choose_picture
    from rattlesweep.analysis.plots.layout import read_layout
    from rattlesweep.analysis.style import save, styled

    with styled(style):
        picture = choose_picture(
            read_layout(directory), kind, x=x, quantity=quantity, select=select, where=where
        )
        name = picture.name
        paths = list(output) or [directory / f"{name}.{ending}" for ending in ("svg", "png")]
        figure = picture.figure(**looks)
        save(figure, paths, dpi)
    if data is not None:
        picture.write_data(data)
        paths.append(data)
    for path in paths:
        click.echo(path)
    say(f"{name}: {picture.words()}")
