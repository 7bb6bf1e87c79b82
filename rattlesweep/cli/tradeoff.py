"""`rattlesweep tradeoff`: speed against accuracy on this machine."""

from __future__ import annotations

import json
import time
from pathlib import Path

import click

from rattlesweep.cli.common import (
    DONE,
    OVERRIDES,
    check_output,
    check_threads,
    guarded,
    say,
    stages,
)


@click.command(
    epilog="\b\nExamples:\n  rattlesweep tradeoff --quick\n  rattlesweep tradeoff "
    "configs/tradeoff.yaml --output out/tradeoff"
)
@click.argument("config", type=click.Path(), required=False)
@click.option("--output", metavar="DIR", help="Output directory; overrides the config's.")
@click.option(
    "--samples", type=click.IntRange(1), help="Number of bodies; by default enough for 2000 runs."
)
@click.option(
    "--quick", is_flag=True, help="Fewer runs and measurements: takes seconds, but rough."
)
@OVERRIDES
@click.option(
    "--threads",
    type=click.IntRange(1),
    help="Threads for measuring errors; costs are measured on one.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
@guarded
def tradeoff(
    config: str | None,
    output: str | None,
    samples: int | None,
    quick: bool,
    overrides: tuple[str, ...],
    threads: int | None,
    as_json: bool,
) -> int:
    """Measure speed against accuracy of methods, settings and models on the same runs.

    Draws runs from CONFIG, by default shell-dumbbell bodies in both directions; ignores its model,
    integrator and record. Prints a table and the cheapest settings for some errors of
    t_r, and writes tradeoff.parquet, tradeoff.svg and tradeoff.png.
    """
    from rattlesweep.integrate.batch import available_threads
    from rattlesweep.study.tradeoff.measure import measure
    from rattlesweep.study.tradeoff.report import as_data, as_text, save
    from rattlesweep.study.tradeoff.settings import DEFAULT, FULL, QUICK
    from rattlesweep.sweeps.config.load import load_config, override_config
    from rattlesweep.sweeps.store.atomic import probe_directory

    loaded = (
        override_config(DEFAULT, overrides) if config is None else load_config(config, overrides)
    )
    check_output(output)
    directory = Path(output if output is not None else loaded.directory)
    check_threads(threads)
    probe_directory(directory)
    start = time.monotonic()
    study = measure(
        loaded,
        None if config is None else Path(config).resolve().parent,
        samples=samples,
        scope=QUICK if quick else FULL,
        threads=threads or available_threads(),
        report=stages(start),
    )
    files = save(study, directory)
    if as_json:
        click.echo(json.dumps(as_data(study), indent=2, allow_nan=False))
    else:
        click.echo(as_text(study))
    say(f"{', '.join(p.name for p in files)} in {directory}; {time.monotonic() - start:.1f} s")
    return DONE
