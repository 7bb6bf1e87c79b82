"""`rattlesweep slurm`: a job script for a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click import option

from rattlesweep.cli.common import command, options, say, types
from rattlesweep.errors import ConfigError


@command(
    "Sweeps",
    "rattlesweep slurm configs/steady.yaml --shards 100 --cpus 16 --time 4:00:00 > steady.sh",
    "sbatch steady.sh",
)
@options.config
@option("--shards", type=click.IntRange(1), required=True, help="Number of tasks in the array.")
@option("--time", "limit", type=types.SLURM_TIME, default="4:00:00", help="Time limit of a task.")
@option("--cpus", type=click.IntRange(1), default=1, help="CPUs per task.")
@option("--mem", "memory", type=types.SLURM_MEMORY,
        help="Memory per task; by default estimated from a short pilot.")  # fmt: skip
@option("--partition", metavar="NAME", help="Partition of the cluster.")
@options.output()
@options.overrides
@option("--own-directories", "own", is_flag=True,
        help="Give each task a directory of its own, DIR-I.")  # fmt: skip
@option("--restarts", type=click.IntRange(0), default=20,
        help="How often a task that runs out of time requeues itself.")  # fmt: skip
def slurm(
    config: Path,
    shards: int,
    cpus: int,
    memory: int | None,
    output: Path | None,
    overrides: tuple[str, ...],
    own: bool,
    **task: Any,
) -> None:
    """Print the script of a Slurm job array that runs the sweep, one share per task.

    Tasks stop shortly before the time limit and resume after a restart. The config is checked now;
    the script checks its environment when it runs.
    """
    from rattlesweep.integrate.batch import available_threads
    from rattlesweep.sweeps.old.forecast import forecast
    from rattlesweep.sweeps.old.output import examine
    from rattlesweep.sweeps.plan import make_plan
    from rattlesweep.sweeps.slurm import MOST_SHARDS, job_script

    loaded = options.load_sweep(config, overrides, output)
    path = config.resolve()
    plan = make_plan(loaded, path.parent)
    directory = Path(loaded.directory).absolute()
    if not own:
        plan = examine(plan, directory, path.parent).plan
    if shards > plan.n_blocks:
        raise ConfigError(
            f"--shards {shards}: is more than the {plan.n_blocks} blocks there are; take fewer"
        )
    if shards > MOST_SHARDS:
        say(f"note: Slurm takes arrays of {MOST_SHARDS} tasks unless MaxArraySize says otherwise")
    expected = None
    if memory is None:
        guess = forecast(plan, min(cpus, available_threads()), budget=1.0, shards=shards)
        # Half as much again, and what an interpreter may need elsewhere.
        memory = round(1.5 * guess.memory) + 256 * 1024**2
        expected = guess.shard_seconds
    script = job_script(
        plan, path, directory, overrides,
        shards=shards, own=own, cpus=cpus, memory=memory, expected=expected, **task,
    )  # fmt: skip
    click.echo(script, nl=False)
