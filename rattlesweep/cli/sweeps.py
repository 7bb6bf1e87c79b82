"""Commands that plan, run, check and show sweeps, and studies of several sweeps."""

from __future__ import annotations

import secrets
import shutil
import sys
import time
from dataclasses import asdict
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
    probe_files,
    say,
    tell,
    to_json,
)
from rattlesweep.system.console import Bar, counted
from rattlesweep.system.shipped import documentation, example_names
from rattlesweep.words.defaults import FIGURE_DPI
from rattlesweep.words.errors import ConfigError, check_names

if TYPE_CHECKING:
    import pyarrow as pa

    from rattlesweep.design.plan import Plan
    from rattlesweep.work.forecast import Forecast
    from rattlesweep.work.run import Engine, Shard, Swept

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
    "--engine",
    type=click.Choice(["local", "dask"]),
    default="local",
    help="Where to compute.",
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
    engine: str,
    scheduler: str | None,
    dry_run: bool,
    compile_only: bool,
    quiet: bool,
    verbose: bool,
    shard: Shard | None,
    max_time: float | None,
    retry_failed: bool,
) -> int:
    """Run a sweep, or resume one that was stopped.

    Prints one row per case.
    """
    if scheduler is not None and engine != "dask":
        raise ConfigError(
            "--scheduler ADDRESS: works only with --engine dask; give that too"
        )
    from rattlesweep.store.manifest import examine
    from rattlesweep.work.run import run_sweep

    planned, directory = _planned(config, overrides, output, quiet)
    if compile_only:
        _compile(planned)
        return DONE
    if dry_run:
        examine(planned, directory)
        click.echo(_forecast(planned, directory, threads).words)
        return DONE
    workers: Engine | None = None
    if engine == "dask":
        from rattlesweep.work.dask import make_engine

        workers = make_engine(scheduler, threads)
    with Bar.of_command(quiet) as bar:
        result = run_sweep(
            planned,
            directory,
            base=config.resolve().parent,
            engine=workers,
            threads=threads,
            shard=shard,
            max_time=max_time,
            retry_failed=retry_failed,
            report=bar,
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
        now = f"{result.done:,} of them done now in {result.seconds:.1f} s"
        say(f"{counted(result.runs, 'run')} in {directory}, {now}")
    if verbose:
        integration = f"{result.kernel_seconds:.2f} s of integration"
        say(f"{result.seconds:.2f} s in all, {integration}")
    if result.stopped is not None:
        resume = "are kept, and the same command resumes from there"
        say(f"stopped: {result.stopped}; {result.runs:,} runs {resume}")
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
    click.echo(to_json(counts.data) if as_json else counts.words)
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
    click.echo(to_json(asdict(verified)) if as_json else verified.words)
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
    path: Path, overrides: tuple[str, ...], output: Path | None, quiet: bool = False
) -> tuple[Plan, Path]:
    """Return the plan of a config and its output directory; say what is doubtful."""
    from rattlesweep.config.read import load_config
    from rattlesweep.system.files import as_path
    from rattlesweep.work.planning import checked_plan

    config = load_config(path, overrides)
    planned, doubts = checked_plan(config, path.resolve().parent)
    if not quiet:
        for doubt in doubts:
            say(f"warning: {doubt}")
    return planned, output or as_path(config.directory, "output")


def _forecast(planned: Plan, directory: Path, threads: int | None) -> Forecast:
    """Return the forecast of a sweep, and warn if the disk is too small for it."""
    from rattlesweep.work.forecast import forecast

    expected = forecast(planned, threads, startup=time.process_time())
    parents = (directory.absolute(), *directory.absolute().parents)
    place = next(parent for parent in parents if parent.exists())
    free = shutil.disk_usage(place).free
    if expected.bytes > free:
        say(f"warning: {place} has only {free / 1e9:.1f} GB free")
    return expected


@command(
    "Results of a sweep",
    "rattlesweep plot out/steady --kind ratio --select n_i=-0.1,-0.3 "
    "--output ratio.pdf",
    "rattlesweep plot out/steady --kind scatter --x K_r "
    "--where 'type == \"R\" and t_r < 2e3'",
    "rattlesweep plot out/steady --kind fractions --x xi --data xi.csv",
    "rattlesweep plot out/steady --kind times --panels n_i --labels german.yaml",
    "rattlesweep plot out/map-theta-spin --select theta=0.84:0.99 --select n_i=-0.45:0",
)
@options.directory
@option(
    "--kind", type=options.PLOTS, help="Kind of plot; by default what suits the sweep."
)
@option(
    "--x",
    metavar="NAME",
    help="Abscissa: what the config varies; for a scatter or fractions any column.",
)
@option(
    "--quantity",
    metavar="COLUMN",
    help="Numeric column for a map, a distribution or the ordinate of a scatter.",
)
@option("--colour", metavar="COLUMN", help="Numeric column that colours a scatter.")
@option(
    "--panels",
    metavar="COLUMN",
    help="What the config varies, each value in a panel of its own, as in n_i.",
)
@option(
    "--select",
    metavar="NAME=VALUES",
    multiple=True,
    help="Only runs with these values, as "
    "in n_i=-0.3,-0.5 or theta=0.6:0.7; may be repeated.",
)
@options.where
@option(
    "--log/--linear",
    default=None,
    help="Logarithmic or linear axes; by default by range.",
)
@option("--xlim", type=options.LOW_HIGH, help="Limits of the abscissa.")
@option("--ylim", type=options.LOW_HIGH, help="Limits of the ordinate.")
@option("--size", type=options.FIGURE_SIZE, help="Width and height in inches.")
@option(
    "--dpi",
    type=options.DPI_VALUE,
    default=FIGURE_DPI,
    help="Dots per inch of a PNG, 20 to 600.",
)
@option(
    "--style",
    metavar="STYLE",
    help="A style of Matplotlib: a file (.mplstyle), or a name such as ggplot.",
)
@option(
    "--no-caption",
    "caption",
    flag_value=False,
    default=True,
    show_default=False,
    help="Leave out the sentences below the figure.",
)
@option(
    "--labels",
    type=options.FILE,
    help="A YAML file with other texts for the figure, as in 'ylabel: Anteil'.",
)
@option("--title", help="Title of the figure; may hold formulas, as in '$n_i$'.")
@options.file(
    "--output",
    *options.PICTURES,
    multiple=True,
    help="May be repeated; by default DIRECTORY/KIND.svg and .png.",
)
@options.data
def plot(
    directory: Path,
    dpi: float,
    style: str | None,
    output: tuple[Path, ...],
    data: Path | None,
    labels: Path | None,
    **given: Any,
) -> None:
    """Plot a sweep: fractions of types, reversal times, a map of a grid.

    Works at any time, even while the sweep is running. A map shows the mean of a column
    by colours, a distribution its histogram. Prints the paths of the files it writes.
    """
    from rattlesweep.analysis.labels import read_labels
    from rattlesweep.analysis.layout import read_layout
    from rattlesweep.analysis.plots import choose_picture
    from rattlesweep.analysis.style import (
        local_numbers,
        save_figure,
        save_table,
        styled,
    )

    probe_files(*output, data)
    names = ("title", "log", "size", "xlim", "ylim", "caption")
    looks = {name: given.pop(name) for name in names}
    looks["labels"] = read_labels(labels)
    paths = list(output)
    with styled(style):
        picture = choose_picture(read_layout(directory), **given)
        if not paths:
            paths = [directory / f"{picture.name}{end}" for end in (".svg", ".png")]
        with local_numbers():
            save_figure(picture.figure(**looks), paths, dpi)
    if data is not None:
        save_table(picture.table(), data)
        paths.append(data)
    tell(*paths)
    say(f"{picture.name}: {counted(len(picture), 'run')}")


@command(
    "Results of a sweep",
    "rattlesweep table out/steady --output runs.csv",
    "rattlesweep table out/steady --columns n_i,t_r,type --where 'type == \"R\"'",
    "rattlesweep table out/steady --output runs.arrow",
)
@options.directory
@option(
    "--columns",
    type=options.NAME_LIST,
    help="Columns in this order, as in n_i,t_r,type; by default all.",
)
@options.where
@option(
    "--units",
    is_flag=True,
    help="Write units into the head of a CSV, as in 't_r [sqrt(a/g)]'.",
)
@options.file(
    "--output",
    ".csv",
    ".parquet",
    ".arrow",
    help="File to write; without it, CSV goes to standard output.",
)
def table(
    directory: Path,
    columns: tuple[str, ...] | None,
    where: str | None,
    units: bool,
    output: Path | None,
) -> None:
    """Write the runs of a sweep as one table: CSV, Parquet, or Arrow.

    A row is a run, in order of case and sample; docs/columns.md lists the columns. In
    CSV a null is an empty cell. Works at any time, even while the sweep is running, and
    with little memory. Prints the path of the file.
    """
    from rattlesweep.analysis.table import chosen_batches, schema_of, write_rows
    from rattlesweep.store.rows import open_stored

    probe_files(output)
    stored = open_stored(directory)
    schema = schema_of(stored, columns)
    batches = chosen_batches(stored, schema, where)
    rows = write_rows(batches, schema, output, sys.stdout.buffer, units)
    if output is not None:
        tell(output)
    say(counted(rows, "run"))


@command(
    "Results of a sweep", "rattlesweep report out/steady --title 'Steady direction'"
)
@options.directory
@options.file(
    "--output", ".html", ".htm", help="File to write; by default DIRECTORY/report.html."
)
@options.title
def report(directory: Path, output: Path | None, title: str | None) -> None:
    """Write one self-contained HTML page about a sweep.

    It holds the config, cases, figures, failures, cost and provenance. Works at any
    time, even while the sweep is running. Prints the path of the page.
    """
    from rattlesweep.api import load

    probe_files(output)
    page = load(directory).report(output, title=title)
    tell(page.path)
    say(f"{len(page.content) / 1e6:.2f} MB")


@command(
    "Results of a sweep",
    "rattlesweep compare out/here out/there --figure differences.svg",
)
@options.path("a")
@options.path("b")
# t_r_error should cover 99.5 % of the runs.
@option(
    "--allow",
    type=options.SHARE,
    default=0.005,
    help="Share of runs that may be beyond.",
)
@options.figure
@options.data
@options.as_json
def compare(
    a: Path,
    b: Path,
    allow: float,
    figure: Path | None,
    data: Path | None,
    as_json: bool,
) -> int:
    """Compare two output directories of the same runs.

    A and B may differ in tolerance, method, machine or version. Differences of t_r are
    relative to their mean. "beyond" counts runs whose t_r differ by more than their
    errors, "types_sure" those whose types differ although both are sure. Exits with 1
    if there are such types, or if the share of runs beyond is larger than --allow.

    If A and B differ in model or dissipation, the differences are said to be of models:
    ratios of t_r (B over A), and a table of types against types.
    """
    from rattlesweep.analysis import compare as compared
    from rattlesweep.analysis.style import save_table

    probe_files(figure, data)
    result = compared.compare(a, b)
    if data is not None:
        save_table(result.runs, data)
    if figure is not None:
        compared.save_comparison(result, figure)
    if as_json:
        click.echo(to_json(result.data))
    else:
        click.echo(compared.comparison_text(result, options.PRINTED_ROWS))
    if result.disagree(allow):
        say("the directories disagree")
        return options.EXIT_FAILED
    return DONE


@command(
    "Results of a sweep", "rattlesweep sensitivity out/design --figure indices.svg"
)
@options.directory
@options.figure
@options.as_json
def sensitivity(directory: Path, figure: Path | None, as_json: bool) -> None:
    """Estimate which parameters of the bodies t_r and the types depend on.

    Prints first-order and total Sobol' indices for each case, with 95 % bootstrap
    intervals. The sweep's config must have bodies.draw: saltelli. Indices of t_r need a
    case in which nearly all runs reverse.
    """
    from rattlesweep.analysis import sensitivity as estimate

    probe_files(figure)
    indices = estimate.sensitivity(directory)
    if figure is not None:
        estimate.save_sensitivity(indices, figure)
    if as_json:
        click.echo(to_json(indices))
    else:
        click.echo(estimate.sensitivity_text(indices, options.PRINTED_ROWS))


@command(
    "Studies",
    "rattlesweep paper --quick",
    "rattlesweep paper --only fig7,fig8",
    "rattlesweep paper --set bodies.ranges.theta=[0.7,0.8] --output out/narrow",
)
@options.output("Output directory; by default out/paper, or out/paper-quick.")
@option("--quick", is_flag=True, help="Fewer samples: faster, with wide intervals.")
@option(
    "--only", metavar="NAMES", help="Only these parts, such as fig7,fig8 or theory."
)
@options.overrides
@option("--size", type=options.FIGURE_SIZE, help="Size of each figure, in inches.")
@option("--style", metavar="STYLE", help="A style of Matplotlib, as of `plot`.")
@options.threads
@options.quiet
def paper(
    output: Path | None,
    quick: bool,
    only: str | None,
    overrides: tuple[str, ...],
    size: tuple[float, float] | None,
    style: str | None,
    threads: int | None,
    quiet: bool,
) -> int:
    """Reproduce the figures of Kondo and Nakanishi (2017) and check their claims.

    Prints a verdict on each claim. Writes data and pictures of the figures, and
    report.html, a self-contained page. After a stop the same command resumes. Bodies
    of other ranges (--set bodies.ranges.theta=[0.7,0.8]) need an --output of their own.
    """
    from rattlesweep.paper.reproduce import (
        choose_figures,
        reproduce,
        tally,
        verdict_table,
    )
    from rattlesweep.paper.workspace import FULL_SIZES, QUICK_SIZES, Workspace

    start = time.monotonic()
    names = choose_figures(only)
    directory = output or Path("out/paper-quick" if quick else "out/paper")
    sizes = QUICK_SIZES if quick else FULL_SIZES
    progress = False if quiet else None
    workspace = Workspace(
        directory, sizes, overrides, threads=threads, progress=progress
    )
    with Bar.of_command(quiet) as bar:
        claims = reproduce(workspace, names, bar.stage, style=style, size=size)
    if not quiet:
        if claims:
            click.echo(verdict_table(claims))
            say(f"{len(claims)} claims: {tally(claims)}")
        say(f"{directory / 'report.html'}; {time.monotonic() - start:.1f} s")
    if workspace.failed:
        runs = counted(workspace.failed, "run")
        say(f"{runs} of the sweeps failed; see their column status")
        return options.SOME_FAILED
    return DONE


@command(
    "Studies",
    "rattlesweep tradeoff --quick",
    "rattlesweep tradeoff configs/tradeoff.yaml",
)
@options.path("config", required=False)
@options.output()
@option(
    "--samples", type=COUNT, help="Number of bodies; by default enough for 2000 runs."
)
@option("--quick", is_flag=True, help="Fewer runs and methods: faster, but rough.")
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

    Integrates the same runs by several methods, settings and models. The runs are drawn
    from CONFIG, by default shell-dumbbell bodies in both directions. Prints a table
    with the costs on one thread and the cheapest setting for some errors of t_r; writes
    tradeoff.parquet, .svg, .png.
    """
    from rattlesweep.analysis import tradeoff as study
    from rattlesweep.config.read import load_config, parse_config
    from rattlesweep.kernel.threads import available_threads
    from rattlesweep.system.files import as_path, probe_directory

    start = time.monotonic()
    base: Path | None = None
    if config is None:
        loaded = parse_config(study.DEFAULT, overrides)
    else:
        loaded = load_config(config, overrides)
        base = config.resolve().parent
    directory = output or as_path(loaded.directory, "output")
    probe_directory(directory)
    measured = study.measure(
        loaded,
        base,
        settings=study.QUICK_SETTINGS if quick else study.FULL_SETTINGS,
        samples=samples,
        least=300 if quick else 2000,
        threads=threads or available_threads(),
        report=Bar.of_command().stage,
    )
    files = study.save_tradeoff(measured, directory)
    if as_json:
        click.echo(to_json(study.as_data(measured)))
    else:
        click.echo(study.tradeoff_text(measured))
    names = ", ".join(path.name for path in files)
    say(f"{names} in {directory}; {time.monotonic() - start:.1f} s")
