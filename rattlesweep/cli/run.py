"""`rattlesweep run`: a sweep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import option

from rattlesweep.cli.common import Meter, command, options, print_summary, say, types
from rattlesweep.cli.common.output import DONE, EARLY, SOME_FAILED
from rattlesweep.errors import ConfigError

if TYPE_CHECKING:

    from rattlesweep.sweeps.run import Result


session = options.Group(
    "session",
    option("--shard", type=types.SHARD, help="Compute share I of N only, with I from 0 to N-1."),
    option("--max-time", type=types.TIME, help="Stop after this much time, such as 3h50m."),
    option("--fresh", is_flag=True, help="Delete the existing runs and start over."),
    option("--retry-failed", is_flag=True, help="Repeat the runs whose status is not ok."),
)


@command(
    "Sweeps",
    "rattlesweep run configs/quickstart.yaml --set bodies.samples=100",
    "rattlesweep run configs/steady.yaml --max-time 3h50m",
    "rattlesweep run configs/steady.yaml --shard 0/4 --output out/steady-0",
    resumes=True,
)
@options.config
@options.output()
@options.overrides
@option("-j", "--threads", type=click.IntRange(1), help="Number of threads of the kernel.")
@option("--engine", type=click.Choice(["local", "dask"]), default="local", help="Where blocks are "
        "computed: in this process, or by the workers of a Dask cluster.")  # fmt: skip
@option("--scheduler", metavar="ADDRESS", help="Address of an existing Dask scheduler.")
@option("--workers", type=click.IntRange(1),
        help="Worker processes of a Dask cluster started here.")  # fmt: skip
@session
@option("--dry-run", is_flag=True, help="Print the forecast, as `plan` does, and stop.")
@options.quiet
@option("-v", "--verbose", is_flag=True, help="Report where the time went.")
def run(
    config: Path,
    output: Path | None,
    overrides: tuple[str, ...],
    threads: int | None,
    engine: str,
    scheduler: str | None,
    workers: int | None,
    session: dict[str, Any],
    dry_run: bool,
    quiet: bool,
    verbose: bool,
) -> int:
    """Run a sweep, or resume one that was stopped.

    Prints one row per case on standard output.
    """
    from rattlesweep.sweeps.run import run_sweep
    from rattlesweep.sweeps.stored import examine

    loaded = options.load_sweep(config, overrides, output)
    shard = session.get("shard")
    if session["fresh"] and shard is not None:
        raise ConfigError("--fresh: would remove the runs of other shards; start over without it")
    base = config.resolve().parent
    work_off = _engine(engine, scheduler, workers, threads)
    if scheduler is None:
        types.check_threads(threads)
    plan = options.planned(loaded, config)
    directory = Path(loaded.directory)
    if dry_run:
        if not session["fresh"]:
            examine(plan, directory)
        return DONE
    with Meter(quiet) as meter:
        result = run_sweep(
            plan, directory, base=base, threads=threads, report=meter, engine=work_off, **session
        )
    return _close(result, quiet, verbose)


def _engine(
    name: str, scheduler: str | None, workers: int | None, threads: int | None
) -> Any:
    """The engine that the options ask for."""
    from rattlesweep.sweeps.local import local

    if name == "local":
        for flag, value in (("--scheduler", scheduler), ("--workers", workers)):
            if value is not None:
                raise ConfigError(f"{flag}: is for --engine dask; add that, or leave this out")
        return local
    from rattlesweep.sweeps.old.dask_driver import make_engine

    return make_engine(scheduler, workers, threads)


def _close(result: Result, quiet: bool, verbose: bool) -> int:
    """Say what became of a sweep; the exit code."""
    for remark in result.remarks:
        say(f"note: {remark}")
    if not quiet:
        if result.summary is not None:
            print_summary(result.summary, result.directory)
        rate = result.done / max(result.seconds - result.load_seconds, 1e-9)
        again = f", {result.retried} done again" if result.retried else ""
        say(
            f"{result.runs} runs in {result.directory}, {result.resumed_runs} of them from before"
            f"{again}; {result.seconds:.1f} s, {rate:.0f} runs a second"
        )
    if verbose:
        say(
            f"kernel loaded or compiled in {result.load_seconds:.2f} s, integration "
            f"{result.kernel_seconds:.2f} s, in all {result.seconds:.2f} s"
        )
    if result.stopped is not None:
        say(f"stopped: {result.stopped}; {result.kept}, and the same command resumes from there")
        return EARLY
    if result.missing and not quiet:
        say(f"{result.missing} runs of other shares are not in {result.directory} (yet)")
    if result.summary is not None and not quiet:
        say(f"see them: rattlesweep plot {result.directory}, rattlesweep report {result.directory}")
    if result.failed:
        words = ", ".join(f"{count} {word}" for word, count in sorted(result.failed.items()))
        say(f"{sum(result.failed.values())} runs are not ok: {words}")
        return SOME_FAILED
    return DONE
