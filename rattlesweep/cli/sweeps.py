"""Commands that plan, run and look after sweeps."""

from __future__ import annotations

import json
import secrets
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.command import (
    DONE,
    EARLY,
    FAILED,
    MOST_ROWS,
    SOME_FAILED,
    command,
    say,
    to_json,  # fmt: skip
)
from rattlesweep.cli.options import COUNT, Kind
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.progress import Bar
from rattlesweep.text import counted

if TYPE_CHECKING:
    import pyarrow as pa

    from rattlesweep.sweeps.config.schema import Config
    from rattlesweep.sweeps.cost import Forecast
    from rattlesweep.sweeps.plan import Plan
    from rattlesweep.sweeps.run import Result


@command("Sweeps", "rattlesweep init mine.yaml")
@options.path("config", default="sweep.yaml")
def init(config: Path) -> None:
    """Write a commented config to begin with.

    It is a small sweep that runs as it is. Nothing is overwritten. Prints its path.
    """
    from importlib.resources import files

    from rattlesweep.sweeps.config.read import parse_config, read_yaml
    from rattlesweep.sweeps.files import replace_file

    shown = one_line(str(config), 200)
    if config.suffix not in (".yaml", ".yml"):
        raise ConfigError(f"{shown}: the name of a config ends in .yaml; write {config.stem}.yaml")
    if config.exists():
        raise ConfigError(f"{shown}: is there already; choose another name, or remove it first")
    text = (files("rattlesweep.sweeps.config") / "starter.yaml").read_text(encoding="utf-8")
    # In quotes, as YAML would take some names for numbers.
    text = text.replace("name: NAME", f"name: {json.dumps(config.stem)}")
    text = text.replace("NAME", config.stem)
    parse_config(read_yaml(text)[0])  # the name of a file need not be one of a directory
    replace_file(config, text.encode())
    click.echo(config)
    say(f"run it: rattlesweep plan {shown}, rattlesweep run {shown}")


@command(
    "Sweeps",
    "rattlesweep plan configs/steady.yaml --check",
    "rattlesweep plan configs/steady.yaml --set bodies.samples=100000 --budget 10s",
)
@options.config
@options.output("Where the sweep would be written; nothing is written now.")
@options.overrides
@options.threads
@option("--budget", type=options.TIME, default="2s", help="Time spent on the sample of runs.")
@option("--check", is_flag=True, help="Only check the config, and integrate nothing.")
@options.as_json
def plan(
    config: Path, output: Path | None, overrides: tuple[str, ...], threads: int | None,
    budget: float, check: bool, as_json: bool,
) -> None:  # fmt: skip
    """Check a config and forecast the time and disk space of its sweep.

    Prints how many runs it makes, or everything that is wrong with it, each with its line.
    Integrates a sample of the runs for about two seconds and writes nothing.
    """
    loaded, made = _planned(config, overrides, output)
    found = None if check else _forecast(made, loaded, threads, budget)
    if as_json:
        size = {"cases": len(made.cases), "samples": made.samples, "runs": made.runs}
        click.echo(to_json(size | ({} if found is None else vars(found))))
        return
    cases, samples = counted(len(made.cases), "case"), counted(made.samples, "sample")
    click.echo(f"{one_line(str(config), 200)} is valid: {cases} x {samples} = "
               f"{counted(made.runs, 'run')}")  # fmt: skip
    if found is not None:
        click.echo(found.words)


@command(
    "Sweeps",
    "rattlesweep run configs/quickstart.yaml --set bodies.samples=100",
    "rattlesweep run configs/steady.yaml --shard 0/4 --output out/steady-0",
)
@options.config
@options.output()
@options.overrides
@options.threads
@option("--engine", type=click.Choice(["local", "dask"]), default="local",
        help="Compute blocks of runs here, or by workers of a Dask cluster.")  # fmt: skip
@option("--scheduler", metavar="ADDRESS", is_eager=True,
        help="Address of an existing Dask scheduler.")  # fmt: skip
@option("--shard", type=Kind("i/n", "rattlesweep.sweeps.run:Shard.parse"),
        help="Compute shard I of N only, with I from 0 to N-1.")  # fmt: skip
@option("--max-time", type=options.TIME, help="Stop after this much time, such as 3h50m.")
@option("--retry-failed", is_flag=True, help="Repeat the runs whose status is not ok.")
@option("--dry-run", is_flag=True, help="Print the forecast, as `plan` does, and stop.")
@option("--compile-only", is_flag=True,
        help="Compile the kernels, as for an image or on a login node, and stop.")  # fmt: skip
@options.quiet
@option("-v", "--verbose", is_flag=True, help="Report where the time went.")
def run(
    config: Path, output: Path | None, overrides: tuple[str, ...], threads: int | None, engine: str,
    scheduler: str | None, dry_run: bool, compile_only: bool, quiet: bool,
    verbose: bool, **how: Any,
) -> int:  # fmt: skip
    """Run a sweep, or resume one that was stopped.

    Prints one row per case on standard output.
    """
    if (engine == "dask") != (scheduler is not None):
        raise ConfigError("--engine dask: goes with --scheduler ADDRESS; give both, or neither")
    import numpy as np

    from rattlesweep.sweeps.block import load_kernel, prepare_runs
    from rattlesweep.sweeps.plan import examine
    from rattlesweep.sweeps.run import run_sweep

    loaded, made = _planned(config, overrides, output, quiet)
    where = Path(loaded.directory)
    if compile_only:
        load_kernel(made.config)
        prepare_runs(made, np.zeros(1, np.int64), np.zeros(1, np.int64))  # draws a body
        say("the kernels are compiled")
        return DONE
    if dry_run:
        examine(made, where)
        click.echo(_forecast(made, loaded, threads).words)
        return DONE
    if scheduler is not None:
        from rattlesweep.sweeps.dask import make_engine

        how["engine"] = make_engine(scheduler, threads)
    with Bar.of_command(quiet) as bar:
        base = config.resolve().parent
        result = run_sweep(made, where, base=base, threads=threads, report=bar, **how)
    return _close(result, quiet, verbose)


def _close(result: Result, quiet: bool, verbose: bool) -> int:
    """Tell what became of a sweep and return the exit code."""
    where = result.directory
    for remark in result.remarks:
        say(f"note: {remark}")
    if not quiet:
        if result.summary is not None:
            print_summary(result.summary, where)
        done = "all of them" if result.done == result.runs else f"{result.done:,} of them"
        again = f" ({result.retried:,} again)" if result.retried else ""
        now = f"{done} done now{again} in {result.seconds:.1f} s"
        say(
            f"{counted(result.runs, 'run')} in {where}, {now if result.done else 'all done before'}"
        )
    if verbose:
        say(f"{result.seconds:.2f} s in all, {result.kernel_seconds:.2f} s of integration")
    if result.stopped is not None:
        say(f"stopped: {result.stopped}; {result.kept}, and the same command resumes from there")
        return EARLY
    if not quiet and result.missing:
        say(f"{counted(result.missing, 'run')} of other shards not in {where} yet")
    if not quiet and result.summary is not None:
        say(f"see them: rattlesweep plot {where}, rattlesweep report {where}")
    if result.failed:
        words = ", ".join(f"{count:,} {word}" for word, count in sorted(result.failed.items()))
        say(f"{counted(sum(result.failed.values()), 'run')} failed: {words}")
        return SOME_FAILED
    return DONE


@command("Sweeps", "rattlesweep status out/quickstart")
@options.directory
@options.as_json
def status(directory: Path, as_json: bool) -> int:
    """Show the progress of a sweep.

    Works at any time. Exits with 3 if some runs have a status other than ok.
    """
    from rattlesweep.sweeps.verify import status as count_rows

    found = count_rows(directory)
    click.echo(to_json(found.data) if as_json else found.words)
    return SOME_FAILED if set(found.data["status"]) - {"ok"} else DONE


@command("Sweeps", "rattlesweep verify out/quickstart --recompute 100")
@options.directory
@option("--recompute", type=click.IntRange(0), metavar="N", default=0,
        help="Integrate N random runs again and compare them bit for bit.")  # fmt: skip
@option("--seed", type=click.IntRange(0),
        help="Seed for choosing these runs; by default a new one each time.")  # fmt: skip
@options.threads
@options.as_json
def verify(
    directory: Path, recompute: int, seed: int | None, threads: int | None, as_json: bool
) -> int:
    """Verify every bit of an output directory.

    Prints one line per problem and exits with 1 if there is any. `rattlesweep run` repairs what it
    finds by computing the runs of damaged files again.
    """
    from rattlesweep.sweeps.verify import verify as check

    seed = secrets.randbelow(2**32) if seed is None else seed
    with Bar.of_command() as bar:
        found = check(directory, recompute, seed, threads, report=bar.counting("verifying"))
    click.echo(to_json(asdict(found)) if as_json else found.words)
    return FAILED if found.problems else DONE


@command("Sweeps", "rattlesweep classify out/quickstart --set classify.sw_departure=0.1")
@options.directory
@options.overrides
def classify(directory: Path, overrides: tuple[str, ...]) -> None:
    """Classify stored runs by other thresholds, without integrating.

    Rewrites the types and the summary. Prints one row per case on standard output.
    """
    from rattlesweep.sweeps.merge import classify_stored

    done = classify_stored(directory, overrides)
    print_summary(done.summary, directory)
    files = counted(done.files, "file")
    say(f"{counted(done.changed, 'type')} changed; {files} and the summary written in {directory}")
    say(f"thresholds: {', '.join(f'{key} {value:g}' for key, value in done.now.items())}")
    if done.now != done.own:
        say("`rattlesweep run` would put back those of the config; to keep these, set them there")


@command("Sweeps", "rattlesweep merge out/steady-0 out/steady-1 --output out/steady")
@options.path("directories", metavar="DIR...", nargs=-1, required=True)
@options.output("The directory to write.", required=True)
@options.quiet
def merge(directories: tuple[Path, ...], output: Path, quiet: bool) -> int:
    """Merge the directories of one sweep's shards into one.

    Exits with 75 if runs are missing then: merge other shards into the same output, or let
    `rattlesweep run CONFIG --output DIR` compute the rest.
    """
    from rattlesweep.sweeps.merge import merge as join

    merged = join(list(directories), output)
    if not quiet:
        if merged.summary is not None:
            print_summary(merged.summary, output)
        say(f"{counted(merged.runs, 'run')} in {counted(merged.files, 'file')} in {output}")
    if merged.missing:
        say(f"{counted(merged.missing, 'run')} missing; merge the other shards too, with the same "
            f"--output, or `rattlesweep run CONFIG --output {output}`")  # fmt: skip
        return EARLY
    if merged.failed:
        say(f"{counted(merged.failed, 'run')} failed; see their column status")
        return SOME_FAILED
    return DONE


@command(
    "Sweeps",
    "rattlesweep slurm configs/steady.yaml --shards 100 --cpus 16 --time 4:00:00 > steady.sh",
    "sbatch steady.sh",
)
@options.config
@option("--shards", type=COUNT, required=True, help="Number of tasks in the array.")
@option("--time", "limit", type=Kind("time", "rattlesweep.sweeps.slurm:limit_of"),
        default="4:00:00", help="Time limit of a task.")  # fmt: skip
@option("--cpus", type=COUNT, default=1, help="CPUs per task.")
@option("--mem", "memory", metavar="SIZE", default="2G", help="Memory per task.")
@option("--partition", metavar="NAME", help="Partition of the cluster.")
@options.output()
@options.overrides
@option("--own-directories", "own", is_flag=True,
        help="Give each task a directory of its own, DIR-I.")  # fmt: skip
@option("--restarts", type=click.IntRange(0), default=20,
        help="How often a task that runs out of time requeues itself.")  # fmt: skip
def slurm(
    config: Path, shards: int, output: Path | None, overrides: tuple[str, ...], own: bool,
    **job: Any,
) -> None:  # fmt: skip
    """Print the script of a Slurm job array that runs a sweep, one shard per task.

    Tasks stop shortly before the time limit and resume after a restart.
    """
    from rattlesweep.sweeps.plan import examine
    from rattlesweep.sweeps.slurm import job_script

    loaded, made = _planned(config, overrides, output)
    where = Path(loaded.directory).absolute()
    if not own:
        examine(made, where)
    if shards > made.runs:
        raise ConfigError(f"--shards {shards}: there are only {counted(made.runs, 'run')}")
    script = job_script(made, config.resolve(), where, overrides, shards=shards, own=own, **job)
    click.echo(script, nl=False)


@command("Sweeps", "rattlesweep schema > rattlesweep.schema.json")
def schema() -> None:
    """Print the JSON Schema of the config."""
    from rattlesweep.sweeps.config.read import config_json_schema

    click.echo(to_json(config_json_schema()))


def print_summary(summary: pa.Table, directory: Path) -> None:
    """Print the table of a summary: all of its cases, or the first of many."""
    from rattlesweep.sweeps.summary import closing_table

    click.echo(closing_table(summary.slice(0, MOST_ROWS)))
    if (more := len(summary) - MOST_ROWS) > 0:
        say(f"{counted(more, 'more case')} in {directory / 'summary.parquet'}")


def _planned(
    path: Path, overrides: tuple[str, ...], output: Path | None, quiet: bool = False
) -> tuple[Config, Plan]:
    """Return the config of a sweep and its plan, and say what is doubtful about it."""
    from rattlesweep.sweeps.config.read import load_config
    from rattlesweep.sweeps.plausible import checked_plan

    loaded = load_config(path, overrides)
    if output is not None:
        loaded = loaded.model_copy(update={"output": str(output)})
    made, doubts = checked_plan(loaded, path.resolve().parent)
    for doubt in () if quiet else doubts:
        say(f"warning: {doubt}")
    return loaded, made


def _forecast(made: Plan, config: Config, threads: int | None, seconds: float = 2.0) -> Forecast:
    """Return what a sweep will take, and say if the disk has too little room for it."""
    from rattlesweep.sweeps.cost import forecast

    found = forecast(made, threads, seconds)
    place = Path(config.directory).absolute()
    while not place.exists():
        place = place.parent
    if found.bytes > (free := shutil.disk_usage(place).free):
        say(f"warning: {place} has only {free / 1e9:.1f} GB free")
    return found
