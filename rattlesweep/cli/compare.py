"""`rattlesweep compare`: how far two directories of the same runs differ."""

from __future__ import annotations

from pathlib import Path

import click
from click import argument, option

from rattlesweep.cli.common import command, options, probe, say, to_json
from rattlesweep.cli.common.output import DONE, FAILED, MOST_ROWS


@command(
    "Sweeps",
    "rattlesweep compare out/tol-1e-9 out/tol-1e-11",
    "rattlesweep compare out/here out/there --figure differences.svg --data differences.parquet",
)
@argument("a", type=click.Path(path_type=Path))
@argument("b", type=click.Path(path_type=Path))
# t_r_error is to cover 99.5 % of the runs.
@option("--allow", metavar="SHARE", type=click.FloatRange(0, 1), default=0.005,
        help="Share of the runs that reverse in both which may be beyond.")  # fmt: skip
@options.figure
@options.file("--data", ".csv", ".parquet",
              help="Also write the differences of each run, as .csv or .parquet.")  # fmt: skip
@options.as_json
def compare(
    a: Path, b: Path, allow: float, figure: Path | None, data: Path | None, as_json: bool
) -> int:
    """Compare two output directories of the same runs.

    A and B may be of another tolerance, method, machine or version; other bodies, launches,
    horizons or models are refused with exit code 2. Where runs are missing, those that both have
    are compared. Differences of t_r are relative to the mean of both.

    In the table, "beyond" counts runs whose t_r differ by more than sqrt(e_A^2 + e_B^2), where e
    is t_r_error, and "types_sure" counts differing types of which both directories are sure
    (type_sure). Both need record: [error]. Exits with 1 if a larger share than --allow is beyond,
    or if types that are sure differ, and with 0 else; without stored errors always with 0.
    """
    from rattlesweep.analysis.compare import as_text, save
    from rattlesweep.analysis.compare import compare as compared

    probe(figure, data)
    result = compared(a, b)
    if data is not None:
        result.write_runs(data)
    if figure is not None:
        save(result, figure)
    click.echo(to_json(result.data()) if as_json else as_text(result, MOST_ROWS))
    if result.disagree(allow):
        say("the directories disagree")
        return FAILED
    return DONE
