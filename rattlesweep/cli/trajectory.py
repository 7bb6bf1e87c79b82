"""`rattlesweep trajectory`: one run as a time series, in a file, a figure or the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from click import option

from rattlesweep.cli.common import command, options, probe, types
from rattlesweep.cli.common.series import say_outcome, write_course


@command(
    "One run",
    "rattlesweep trajectory --preset GH --n-i -0.1 --t-end 1500 --figure spin.svg",
    "rattlesweep trajectory --preset GH --theta 0.82 --t-end 2e4 --dt 0.5 "
    "--channels t,n,E_p,E_r --output run.parquet",
    "rattlesweep trajectory --preset GH --omega 0.02,0,-0.3 --u 0.01,0,-1 --t-end 500",
)
@options.body
@options.launch
@options.dissipation
@options.t_end
@options.rows
@options.channels
@options.integrator
@option("--model", type=types.MODELS, default="full", help="Equations of motion.")
@option("--e-p0", type=float, help="Energy of the pitch at the start of the reduced model.")
@option("--e-r0", type=float, help="Energy of the roll at the start of the reduced model.")
@options.file("--output", ".parquet", ".csv",
              help="A .parquet or .csv file, instead of CSV on standard output.")  # fmt: skip
@options.figure
@options.quiet
def trajectory(
    rows: dict[str, Any],
    channels: tuple[str, ...] | None,
    output: Path | None,
    figure: Path | None,
    quiet: bool,
    **run: Any,
) -> int:
    """Integrate one launch, past its reversals, and write it as a time series.

    Prints CSV unless a file or a figure is requested, of a long series only its head and tail; the
    reversal times go to standard error. A reversal is counted once the spin has gone from beyond a
    quarter of its initial value to beyond a quarter of it on the other side; of a launch without
    spin (--n-i 0), a quarter of the spin that would hold all its energy.
    """
    from rattlesweep.analysis.onerun.rows import Rows

    launch = options.launched(**run)
    probe(output, figure)
    course = write_course(launch, channels, Rows(**rows), output, figure, quiet)
    return say_outcome(course, quiet, launch.body.units)
