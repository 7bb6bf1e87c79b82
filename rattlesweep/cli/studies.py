"""Commands that are studies of their own; the one of the paper has a module."""

from __future__ import annotations

import time
from pathlib import Path

import click
from click import argument, option

from rattlesweep.cli import options
from rattlesweep.cli.command import command, say, to_json
from rattlesweep.progress import Bar


@command(
    "Studies",
    "rattlesweep tradeoff --quick",
    "rattlesweep tradeoff configs/tradeoff.yaml --output out/tradeoff",
)
@argument("config", type=click.Path(path_type=Path), required=False)
@options.output()
@option("--samples", type=click.IntRange(1),
        help="Number of bodies; by default enough for 2000 runs.")  # fmt: skip
@option("--quick", is_flag=True, help="Fewer runs, methods and measurements: faster, but rough.")
@options.overrides
@options.threads
@options.as_json
def tradeoff(
    config: Path | None,
    output: Path | None,
    samples: int | None,
    quick: bool,
    overrides: tuple[str, ...],
    threads: int | None,
    as_json: bool,
) -> None:
    """Measure speed against accuracy on this machine.

    Integrates the same runs by several methods, settings and models. Draws them from CONFIG, by
    default shell-dumbbell bodies in both directions; ignores its model, integrator and record.
    Prints a table and the cheapest settings for some errors of t_r, and writes tradeoff.parquet,
    tradeoff.svg and tradeoff.png. Costs are measured on one thread, whatever --threads says.
    """
    from rattlesweep.analysis.tradeoff import DEFAULT, FULL, QUICK, as_data, as_text, measure, save
    from rattlesweep.integrate.batch import available_threads
    from rattlesweep.sweeps.config.read import load_config, override_config
    from rattlesweep.sweeps.files import probe_directory

    loaded = (
        override_config(DEFAULT, overrides) if config is None else load_config(config, overrides)
    )
    directory = output or Path(loaded.directory)
    probe_directory(directory)
    start = time.monotonic()
    study = measure(
        loaded,
        None if config is None else config.resolve().parent,
        samples=samples,
        scope=QUICK if quick else FULL,
        threads=threads or available_threads(),
        report=Bar.of_command().stage,
    )
    files = save(study, directory)
    click.echo(to_json(as_data(study)) if as_json else as_text(study))
    say(f"{', '.join(p.name for p in files)} in {directory}; {time.monotonic() - start:.1f} s")
