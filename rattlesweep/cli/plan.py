"""`rattlesweep plan`: what a sweep will take."""

from __future__ import annotations

from pathlib import Path

import click
from click import option

from rattlesweep.cli.common import command, options, say, to_json, types


@command(
    "Sweeps",
    "rattlesweep plan configs/steady.yaml",
    "rattlesweep plan configs/steady.yaml --set bodies.samples=100000 --shards 16 --budget 10s",
)
@options.config
@options.output("Where the sweep would be written; nothing is written now.")
@options.overrides
@option("-j", "--threads", type=click.IntRange(1),
        help="Number of threads of the kernel; may be more than there are here.")  # fmt: skip
@option("--shards", type=click.IntRange(1), help="Also forecast the longest of N shares.")
@option("--budget", type=types.TIME, default="2s", help="Time spent on the sample of runs.")
@options.as_json
def plan(
    config: Path,
    output: Path | None,
    overrides: tuple[str, ...],
    threads: int | None,
    shards: int | None,
    budget: float,
    as_json: bool,
) -> None:
    """Forecast the time, disk space and memory of a sweep.

    Integrates a sample of its runs for about two seconds and writes nothing. The interval is a 95 %
    confidence interval, for a machine as busy as it is now.
    """
    from rattlesweep.sweeps.old.footprint import shortages
    from rattlesweep.sweeps.old.forecast import describe, forecast

    loaded = options.load_sweep(config, overrides, output)
    made = options.planned(loaded, config)
    found = forecast(made, threads, budget=budget, shards=shards)
    click.echo(to_json(found.as_data()) if as_json else describe(found))
    if made.stages:
        say(f"note: that is at most; {made.stages_by} leaves runs out")
    for line in shortages(found.memory, found.bytes, Path(loaded.directory)):
        say(f"warning: {line}")
