"""`rattlesweep slurm`: a job script for a cluster."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from rattlesweep.cli.common import DONE, OVERRIDES, guarded, load_sweep, say


@click.command(
    epilog="\b\nExample:\n  rattlesweep slurm configs/steady.yaml --shards 100 --cpus 16 "
    "--time 4:00:00 > steady.sh\n  sbatch steady.sh"
)
@click.argument("config", type=click.Path())
@click.option(
    "--shards", type=click.IntRange(1), required=True, help="Number of tasks in the array."
)
@click.option("--time", "limit", default="4:00:00", show_default=True, help="Time limit of a task.")
@click.option("--cpus", type=click.IntRange(1), default=1, show_default=True, help="CPUs per task.")
@click.option(
    "--mem", metavar="SIZE", help="Memory per task; by default estimated from a short pilot."
)
@click.option("--partition", metavar="NAME", help="Partition of the cluster.")
@click.option("--output", metavar="DIR", help="Output directory; overrides the config's.")
@OVERRIDES
@click.option(
    "--own-directories", "own", is_flag=True, help="Give each task a directory of its own, DIR-I."
)
@click.option(
    "--restarts",
    type=click.IntRange(0),
    default=20,
    show_default=True,
    help="How often a task that runs out of time requeues itself.",
)
@guarded
def slurm(
    config: str,
    shards: int,
    limit: str,
    cpus: int,
    mem: str | None,
    partition: str | None,
    output: str | None,
    overrides: tuple[str, ...],
    own: bool,
    restarts: int,
) -> int:
    """Print the script of a Slurm job array that runs the sweep, one share per task.

    Tasks stop shortly before the time limit and resume after a restart. The config is checked now;
    the script checks its environment when it runs.
    """
    from rattlesweep.errors import ConfigError
    from rattlesweep.integrate.batch import available_threads
    from rattlesweep.sweeps.cases.plan import make_plan
    from rattlesweep.sweeps.engines.slurm import (
        MOST_SHARDS,
        ArrayJob,
        job_script,
        limit_of,
        memory_of,
    )
    from rattlesweep.sweeps.forecast.forecast import forecast
    from rattlesweep.sweeps.store.output import examine
    from rattlesweep.sweeps.store.provenance import package_version

    seconds = limit_of(limit)
    memory = None if mem is None else memory_of(mem)
    loaded = load_sweep(config, overrides, output)
    path = Path(config).resolve()
    plan = make_plan(loaded, path.parent)
    directory = Path(loaded.directory).absolute()
    if not own:
        plan = examine(plan, directory, path.parent).plan
    if shards > plan.n_blocks:
        raise ConfigError(
            f"--shards {shards}: is more than the {plan.n_blocks} blocks there are; take fewer, or "
            "a smaller block_size"
        )
    if shards > MOST_SHARDS:
        say(f"note: Slurm takes arrays of {MOST_SHARDS} tasks unless MaxArraySize says otherwise")
    expected = None
    if memory is None:
        guess = forecast(plan, min(cpus, available_threads()), budget=1.0, shards=shards)
        # Half as much again, and what an interpreter may need elsewhere.
        memory = round(1.5 * guess.memory) + 256 * 1024**2
        expected = guess.shard_seconds
    job = ArrayJob(
        name=loaded.name,
        version=package_version(),
        program=Path(sys.executable).with_name("rattlesweep"),
        directory=Path.cwd(),
        config=path,
        output=directory,
        overrides=overrides,
        runs=plan.runs,
        blocks=plan.n_blocks,
        shards=shards,
        own=own,
        limit=seconds,
        cpus=cpus,
        memory=memory,
        partition=partition,
        restarts=restarts,
        expected=expected,
    )
    click.echo(job_script(job), nl=False)
    return DONE
