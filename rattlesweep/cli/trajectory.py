"""`rattlesweep trajectory`: one run as a time series, in a file, a figure or the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rattlesweep.cli import options
from rattlesweep.cli.common import DONE, guarded
from rattlesweep.cli.series import Share, check_targets, close, deliver, print_channels


@click.command(
    epilog="\b\nExamples:\n  rattlesweep trajectory --preset GH --n-i -0.1 --t-end 1500 "
    "--figure spin.svg\n  rattlesweep trajectory --preset GH --theta 0.82 --t-end 2e4 --dt 0.5 "
    "--channels t,n,E_p,E_r --output run.parquet"
)
@options.body_options
@options.spin_options
@options.psi_option
@click.option("--t-end", type=float, help="Horizon, in sqrt(a/g); by default 5 t_rGH.")
@options.rows_options
@options.integrator_options
@click.option(
    "--model",
    type=click.Choice(["full", "reduced", "gh"]),
    default="full",
    show_default=True,
    help="Equations of motion.",
)
@click.option("--e-p0", type=float, help="Energy of the pitch at the start of the reduced model.")
@click.option("--e-r0", type=float, help="Energy of the roll at the start of the reduced model.")
@click.option(
    "--output", metavar="FILE", help="A .parquet or .csv file, instead of CSV on standard output."
)
@click.option("--figure", metavar="FILE", help="Plot to an .svg, .png or .pdf file.")
@options.quiet_option
@guarded
def trajectory(
    channels: str,
    output: str | None,
    figure: str | None,
    quiet: bool,
    points: int | None,
    dt: float | None,
    steps: bool,
    **given: Any,
) -> int:
    """Integrate one launch, past its reversals, and write it as a time series.

    Prints CSV unless a file or a figure is requested, of a long series only its head and tail; the
    reversal times go to standard error. A reversal is counted once the spin has gone from beyond a
    quarter of its initial value to beyond a quarter of it on the other side.
    """
    from rattlesweep.study.derived import make_body
    from rattlesweep.study.onerun.rows import Rows
    from rattlesweep.sweeps.blocks.single import Launch

    if channels == "list":
        print_channels()
        return DONE
    body = make_body({name: given.pop(name) for name in options.BODY})
    integrator = options.integrator_of(given)
    psi = options.psi_of(given.pop("psi"))
    launch = Launch(body, psi=psi, integrator=integrator, **given)
    table, drawing = (None if name is None else Path(name) for name in (output, figure))
    check_targets(table, drawing)
    with Share(quiet, files=table is not None or drawing is not None) as bar:
        course = deliver(launch, channels, Rows(points, dt, steps), table, drawing, bar)
    return close(course, quiet)
