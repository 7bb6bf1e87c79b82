"""Commands that plan, run and check sweeps, and the pages of documentation."""

from __future__ import annotations

import secrets
import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import option

from rattlesweep.cli import options
from rattlesweep.cli.options import (
    COUNT,
    DONE,
    Kind,
    command,
    print_result,
    say,
    tell,
    to_json,
    warn,
)
from rattlesweep.system.console import Bar, counted
from rattlesweep.system.shipped import documentation, example_names
from rattlesweep.words.errors import ConfigError, check_names

if TYPE_CHECKING:
    import pyarrow as pa

    from rattlesweep.design.plan import Plan
    from rattlesweep.work.forecast import Forecast
    from rattlesweep.work.run import Executor, Swept

SHARD = Kind("i/n", "rattlesweep.work.run:Shard.parse")
LIMIT = Kind("time", "rattlesweep.work.slurm:limit_of")


@command(
    "Sweeps",
    "rattlesweep init mine.yaml",
    "rattlesweep init --example quickstart",
    "rattlesweep init --example fit mine/stone.yaml",
)
@options.path("config", required=False)
@option(
    "--example",
    type=click.Choice(example_names()),
    help="Write a config of the documentation instead, by default in configs/.",
)
def init(config: Path | None, example: str | None) -> None:
    """Write a commented config to begin with.

    It describes a small sweep, ready to run, and is called sweep.yaml by default.
    Prints the paths that it writes. No file is overwritten.
    """
    from rattlesweep.config.read import parse_config, read_yaml
    from rattlesweep.system.files import probe_directory, replace_file
    from rattlesweep.system.shipped import example_files, starter

    if config is not None and config.suffix not in (".yaml", ".yml"):
        raise ConfigError(f"{config}: the name of a config ends in .yaml")
    if example is not None:
        texts = example_files(example, config)
    else:
        config = config or Path("sweep.yaml")
        texts = {config: starter(config.stem)}
        data, _, _ = read_yaml(texts[config])
        assert isinstance(data, dict)
        parse_config(data)  # the stem may not be a valid name of a sweep
    for path in texts:
        if path.exists():
            raise ConfigError(
                f"{path}: exists already; choose another name, or remove it first"
            )
    for path, text in texts.items():
        probe_directory(path.parent)
        replace_file(path, text.encode())
        tell(path)


@command(
    "Sweeps",
    "rattlesweep plan configs/steady.yaml --check",
    "rattlesweep plan configs/steady.yaml --set bodies.samples=100000",
)
@options.sweep_options
@options.threads
@option("--check", is_flag=True, help="Only check the config, without a forecast.")
@options.as_json
def plan(
    config: Path,
    output: Path | None,
    overrides: tuple[str, ...],
    threads: int | None,
    check: bool,
    as_json: bool,
) -> None:
    """Check a config and forecast the time and disk space of its sweep.

    Prints the number of runs, or each mistake in the config with its line. Integrates a
    sample of the runs for about two seconds and writes nothing.
    """
    from rattlesweep.store.manifest import examine

    planned, directory = _planned(config, overrides, output)
    examine(planned, directory)
    forecast = None
    if not check:
        forecast = _forecast(planned, directory, threads)
    if as_json:
        data = {
            "cases": len(planned.cases),
            "samples": planned.samples,
            "runs": planned.runs,
        }
        if forecast is not None:
            data |= vars(forecast)
        click.echo(to_json(data))
        return
    cases = counted(len(planned.cases), "case")
    samples = counted(planned.samples, "sample")
    runs = counted(planned.runs, "run")
    tell(f"{config} is valid: {cases} x {samples} = {runs}")
    if forecast is not None:
        click.echo(forecast.words)


@command(
    "Sweeps",
    "rattlesweep run configs/quickstart.yaml --set bodies.samples=100",
    "rattlesweep run configs/steady.yaml --shard 0/4 --output out/steady-0",
)
@options.sweep_options
@options.threads
@option(
    "--executor",
    "--engine",
    type=click.Choice(["local", "dask"]),
    default="local",
    help="Where to compute; its earlier name is --engine.",
)
@option(
    "--scheduler", metavar="ADDRESS", help="Dask scheduler; by default one is started."
)
@option("--shard", type=SHARD, help="Compute shard I of N only, with I from 0 to N-1.")
@option(
    "--max-time",
    type=options.TIME_VALUE,
    help="Stop after this much time, such as 3h50m.",
)
@option("--retry-failed", is_flag=True, help="Repeat runs whose status is not ok.")
@option("--dry-run", is_flag=True, help="Print the forecast, as `plan` does, and stop.")
@option(
    "--compile-only",
    is_flag=True,
    help="Compile the kernels, as in an image, and stop.",
)
@options.quiet
@option("-v", "--verbose", is_flag=True, help="Report where the time went.")
def run(
    config: Path,
    output: Path | None,
    overrides: tuple[str, ...],
    threads: int | None,
    executor: str,
    scheduler: str | None,
    dry_run: bool,
    compile_only: bool,
    quiet: bool,
    verbose: bool,
    **session: Any,
) -> int:
    """Run a sweep, or resume one that was stopped.

    Prints one row per case.
    """
    if scheduler is not None and executor != "dask":
        raise ConfigError(
            "--scheduler ADDRESS: works only with --executor dask; give that too"
        )
    from rattlesweep.store.manifest import examine
    from rattlesweep.work.run import run_sweep

    planned, directory = _planned(config, overrides, output)
    if compile_only:
        _compile(planned)
        return DONE
    if dry_run:
        examine(planned, directory)
        click.echo(_forecast(planned, directory, threads).words)
        return DONE
    workers: Executor | None = None
    if executor == "dask":
        from rattlesweep.work.dask import make_executor

        workers = make_executor(scheduler, threads)
    with Bar.of_command(quiet) as bar:
        result = run_sweep(
            planned,
            directory,
            base=config.resolve().parent,
            executor=workers,
            threads=threads,
            report=bar,
            **session,
        )
    return _say_result(result, quiet, verbose)


def _compile(planned: Plan) -> None:
    """Compile the kernels of a sweep: those that integrate, and those that launch."""
    import numpy as np

    from rattlesweep.work.block import load_kernel, prepare_runs

    load_kernel(planned.config)
    first = np.zeros(1, np.int64)
    prepare_runs(planned, first, first)
    say("the kernels are compiled")


def _say_result(result: Swept, quiet: bool, verbose: bool) -> int:
    """Print what became of the runs of a sweep, and return the exit code."""
    directory = result.stored.directory
    for path in result.found.damaged:
        say(f"note: a file was damaged and is now {path}; its runs were repeated")
    if not quiet:
        _print_summary(result.summary, directory)
        say(
            f"{counted(result.runs, 'run')} in {directory}, {result.done:,} of them "
            f"done now in {result.seconds:.1f} s"
        )
    if verbose:
        say(
            f"{result.seconds:.2f} s in all, {result.kernel_seconds:.2f} s of "
            "integration"
        )
    if result.stopped is not None:
        say(
            f"stopped: {result.stopped}; {result.runs:,} runs are kept, and the same "
            "command resumes from there"
        )
        return options.EARLY
    if not quiet and result.missing:
        missing = counted(result.missing, "run")
        say(f"{missing} of other shards are not in {directory} yet")
    if result.failed:
        total = counted(sum(result.failed.values()), "run")
        by_status = sorted(result.failed.items())
        counts = ", ".join(f"{count:,} {status}" for status, count in by_status)
        say(f"{total} failed: {counts}")
        return options.SOME_FAILED
    return DONE


@command("Sweeps", "rattlesweep status out/quickstart")
@options.directory
@option("--complete", is_flag=True, help="Exit with 75 if runs are missing.")
@options.as_json
def status(directory: Path, complete: bool, as_json: bool) -> int:
    """Show the progress of a sweep, at any time.

    Exits with 3 if some runs have a status other than ok.
    """
    from rattlesweep.store.progress import status as count_rows

    counts = count_rows(directory)
    print_result(as_json, counts.data, counts.words)
    if complete and counts.data["runs"] < counts.data["wanted"]:
        return options.EARLY
    if set(counts.data["status"]) - {"ok"}:
        return options.SOME_FAILED
    return DONE


@command("Sweeps", "rattlesweep verify out/quickstart --recompute 100")
@options.directory
@option(
    "--recompute", type=options.NUMBER, default=0, help="Also repeat N random runs."
)
@option("--complete", is_flag=True, help="Missing runs are a problem, too.")
@options.threads
@options.as_json
def verify(
    directory: Path,
    recompute: int,
    complete: bool,
    threads: int | None,
    as_json: bool,
) -> int:
    """Check that an output directory is consistent, and say whether runs are missing.

    Prints one line per problem and exits with 1 if there is any. Repeated runs are
    compared bit for bit. To repair a directory, use `rattlesweep run`, which repeats
    damaged runs and does missing ones.
    """
    from rattlesweep.work.verify import verify as check

    seed = secrets.randbelow(2**32)
    with Bar.of_command() as bar:
        report = bar.counting("verifying")
        verified = check(directory, recompute, seed, threads, report, complete)
    print_result(as_json, verified, verified.words)
    if verified.problems:
        return options.EXIT_FAILED
    return DONE


@command(
    "Sweeps", "rattlesweep classify out/quickstart --set classify.sw_departure=0.1"
)
@options.directory
@option(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    multiple=True,
    help="Set a threshold, as in classify.sw_departure=0.1; may be repeated.",
)
def classify(directory: Path, overrides: tuple[str, ...]) -> None:
    """Classify stored runs by other thresholds, without integrating.

    Rewrites the types and the summary, and prints one row per case. Without --set, or
    by `rattlesweep run`, the thresholds of the config are restored.
    """
    from rattlesweep.store.classify import classify_stored

    classified = classify_stored(directory, overrides)
    _print_summary(classified.summary, directory)
    types = counted(classified.changed, "type")
    files = counted(classified.files, "file")
    say(f"{types} changed; {files} and the summary written in {directory}")
    thresholds = [f"{key} {value:g}" for key, value in classified.now.items()]
    say(f"thresholds: {', '.join(thresholds)}")


@command("Sweeps", "rattlesweep merge out/steady-0 out/steady-1 --output out/steady")
@options.path("directories", metavar="DIR...", nargs=-1, required=True)
@options.output("The directory to write.", required=True)
@option(
    "--link",
    is_flag=True,
    help="Make hard links, which save space: damage of one file then damages both.",
)
@options.quiet
def merge(directories: tuple[Path, ...], output: Path, link: bool, quiet: bool) -> int:
    """Merge the directories of one sweep's shards into one.

    Files are copied; where the file system can, copies share their blocks on disk.

    Exits with 75 if runs are still missing: merge other shards into the same output, or
    let `rattlesweep run CONFIG --output DIR` compute the rest.
    """
    from rattlesweep.store.merge import merge as join

    merged = join(list(directories), output, link)
    if not quiet:
        _print_summary(merged.summary, output)
        runs = counted(merged.runs, "run")
        say(f"{runs} in {counted(merged.files, 'file')} in {output}")
    if merged.missing:
        missing = counted(merged.missing, "run")
        say(
            f"{missing} missing; merge the other shards into the same output, or "
            f"`rattlesweep run CONFIG --output {output}`"
        )
        return options.EARLY
    if merged.failed:
        say(f"{counted(merged.failed, 'run')} failed; see their column status")
        return options.SOME_FAILED
    return DONE


@command(
    "Sweeps",
    "rattlesweep slurm configs/steady.yaml --shards 100 --cpus 16 --time 4:00:00 "
    "> steady.sh",
    "sbatch steady.sh",
)
@options.sweep_options
@option(
    "--shards", type=COUNT, required=True, help="Number of tasks, one for each shard."
)
@option("--time", "limit", type=LIMIT, default="4:00:00", help="Time limit of a task.")
@option("--cpus", type=COUNT, default=1, help="CPUs per task.")
@option("--mem", "memory", metavar="SIZE", default="2G", help="Memory per task.")
@option("--partition", metavar="NAME", help="Partition of the cluster.")
@option(
    "--own-directories", "own", is_flag=True, help="Give each task a directory, DIR-I."
)
@option(
    "--restarts",
    type=options.NUMBER,
    default=20,
    help="Maximum number of requeues per task.",
)
def slurm(
    config: Path,
    output: Path | None,
    overrides: tuple[str, ...],
    shards: int,
    own: bool,
    **job: Any,
) -> None:
    """Print the script of a Slurm job array that runs a sweep, one shard per task.

    Tasks stop shortly before the time limit and resume after a restart.
    """
    from rattlesweep.store.manifest import examine
    from rattlesweep.work.slurm import job_script

    planned, directory = _planned(config, overrides, output)
    if not own:
        examine(planned, directory)
    if shards > planned.runs:
        runs = counted(planned.runs, "run")
        raise ConfigError(f"--shards {shards}: there are only {runs}")
    script = job_script(
        planned,
        config.resolve(),
        directory.absolute(),
        overrides,
        shards=shards,
        own=own,
        **job,
    )
    click.echo(script, nl=False)


@command(
    "Sweeps",
    "rattlesweep schema > rattlesweep.schema.json",
    "rattlesweep schema --json verdict",
)
@option("--case", is_flag=True, help="That of the documents that `export` writes.")
@option(
    "--json",
    "document",
    type=options.DOCUMENT_CHOICE,
    help="That of what a command prints by --json.",
)
def schema(case: bool, document: str | None) -> None:
    """Print the JSON Schema of the config."""
    from rattlesweep.config.read import config_json_schema

    if case and document is not None:
        raise ConfigError("--case and --json are two schemas; ask for one of them")
    if case:
        from rattlesweep.analysis.engines.case import case_schema

        click.echo(to_json(case_schema()))
    elif document is not None:
        from rattlesweep.analysis.documents import document_schema

        click.echo(to_json(document_schema(document)))
    else:
        click.echo(to_json(config_json_schema()))


@command("Documentation", "rattlesweep docs", "rattlesweep docs tutorial")
@click.argument("page", required=False)
def docs(page: str | None) -> None:
    """Print a page of the documentation, or list the pages.

    Pages come with the package and are Markdown; pictures do not come with it.
    """
    pages = documentation()
    if page is None:
        for name, text in pages.items():
            click.echo(f"{name:<13}{text.partition(chr(10))[0].removeprefix('# ')}")
        return
    check_names("PAGE", [page], pages)
    click.echo_via_pager(pages[page])


def _print_summary(summary: pa.Table | None, directory: Path) -> None:
    from rattlesweep.store.summary import closing_table, doubts_of_means

    if summary is None:
        return
    click.echo(closing_table(summary.slice(0, options.PRINTED_ROWS)))
    more = len(summary) - options.PRINTED_ROWS
    if more > 0:
        say(f"{counted(more, 'more case')} in {directory / 'summary.parquet'}")
    say("`rattlesweep docs columns` explains the columns")
    doubt = doubts_of_means(summary)
    if doubt is not None:
        say(f"note: {doubt}")


def _planned(
    path: Path, overrides: tuple[str, ...], output: Path | None
) -> tuple[Plan, Path]:
    """Return the plan of a config and its output directory; say what is doubtful."""
    from rattlesweep.config.read import load_config
    from rattlesweep.system.files import as_path
    from rattlesweep.work.planning import checked_plan

    config = load_config(path, overrides)
    planned, doubts = checked_plan(config, path.resolve().parent)
    for doubt in doubts:
        warn(doubt)
    return planned, output or as_path(config.directory, "output")


def _forecast(planned: Plan, directory: Path, threads: int | None) -> Forecast:
    """Return the forecast of a sweep, and warn if the disk is too small for it."""
    from rattlesweep.work.forecast import forecast

    expected = forecast(planned, threads, startup=time.process_time())
    parents = (directory.absolute(), *directory.absolute().parents)
    place = next(parent for parent in parents if parent.exists())
    free = shutil.disk_usage(place).free
    if expected.bytes > free:
        warn(f"{place} has only {free / 1e9:.1f} GB free")
    return expected
