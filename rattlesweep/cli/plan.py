"""`rattlesweep plan`: what a sweep will take."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rattlesweep.cli.common import DONE, OVERRIDES, guarded, say

if TYPE_CHECKING:
    from rattlesweep.sweeps.forecast.forecast import Forecast


@click.command(
    epilog="\b\nExamples:\n  rattlesweep plan configs/steady.yaml\n"
    "  rattlesweep plan configs/steady.yaml --set bodies.samples=100000 --shards 16 --budget 10s"
)
@click.argument("config", type=click.Path())
@click.option(
    "--output", metavar="DIR", help="Where the sweep would be written; nothing is written now."
)
@OVERRIDES
@click.option(
    "--threads",
    type=click.IntRange(1),
    help="Number of threads of the kernel; may be more than there are here.",
)
@click.option("--shards", type=click.IntRange(1), help="Also forecast the longest of N shares.")
@click.option(
    "--budget",
    metavar="TIME",
    default="2s",
    show_default=True,
    help="Time spent on the sample of runs.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@guarded
def plan(
    config: str,
    output: str | None,
    overrides: tuple[str, ...],
    threads: int | None,
    shards: int | None,
    budget: str,
    as_json: bool,
) -> int:
    """Forecast the time, disk space and memory of a sweep.

    Integrates a sample of its runs for about two seconds and writes nothing. The interval is a 95 %
    confidence interval, for a machine as busy as it is now.
    """
    from rattlesweep.durations import seconds_of
    from rattlesweep.sweeps.config.load import load_config
    from rattlesweep.sweeps.forecast.forecast import describe, forecast
    from rattlesweep.sweeps.sense.sense import checked_plan

    seconds = seconds_of(budget, "--budget")
    loaded = load_config(config, overrides)
    made, doubts = checked_plan(loaded, Path(config).resolve().parent)
    for doubt in doubts:
        say(f"warning: {doubt}")
    found = forecast(made, threads, budget=seconds, shards=shards)
    click.echo(json.dumps(found.as_data(), indent=2) if as_json else describe(found))
    for line in warnings(found, Path(output or loaded.directory)):
        say(f"warning: {line}")
    return DONE


def warnings(forecast: Forecast, directory: Path) -> list[str]:
    """What this machine is too small for."""
    lines = []
    free = free_memory()
    if free is not None and forecast.memory > free:
        lines.append(
            f"it needs {forecast.memory / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are "
            "free; a smaller block_size needs less"
        )
    place = directory.resolve()
    while not place.exists() and place != place.parent:
        place = place.parent
    space = shutil.disk_usage(place).free
    if forecast.bytes > space:
        lines.append(
            f"it needs {forecast.bytes / 1e9:.1f} GB on disk, and {place} has "
            f"{space / 1e9:.1f} GB free; choose another --output"
        )
    return lines


def free_memory() -> int | None:
    """Bytes of memory that can be had; None where the system does not say."""
    try:
        with open("/proc/meminfo") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return 1024 * int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None
