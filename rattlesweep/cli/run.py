"""`rattlesweep run`: a sweep."""

from __future__ import annotations

from pathlib import Path

import click

from rattlesweep.cli.common import DONE, OVERRIDES, SOME_FAILED, Meter, guarded, most_threads, say


@click.command(
    epilog="\b\nExample:\n  rattlesweep run configs/quickstart.yaml --set bodies.samples=100"
)
@click.argument("config", type=click.Path())
@click.option("--output", metavar="DIR", help="Output directory; overrides the config's.")
@OVERRIDES
@click.option("--threads", type=click.IntRange(1), help="Threads of the kernel.")
@click.option("--dry-run", is_flag=True, help="Say what would be run, and stop.")
@click.option("-q", "--quiet", is_flag=True, help="No progress and no closing table.")
@click.option("-v", "--verbose", is_flag=True, help="Say where the time went.")
@guarded
def run(
    config: str,
    output: str | None,
    overrides: tuple[str, ...],
    threads: int | None,
    dry_run: bool,
    quiet: bool,
    verbose: bool,
) -> int:
    """Run a sweep, or go on with one that was stopped.

    Prints one row per case on standard output.
    """
    from rattlesweep.sweep.config import load_config
    from rattlesweep.sweep.engine import open_store, run_sweep
    from rattlesweep.sweep.errors import ConfigError
    from rattlesweep.sweep.plan import make_plan
    from rattlesweep.sweep.summary import closing_table

    loaded = load_config(config, overrides)
    if output is not None:
        if not output:
            raise ConfigError("--output: the directory has no name; give one")
        loaded = loaded.model_copy(update={"output": output})
    base = Path(config).resolve().parent
    if threads is not None and threads > (most := most_threads()):
        raise click.BadParameter(f"{threads} is more than the {most} processors there are")
    plan = make_plan(loaded, base)
    directory = Path(loaded.directory)
    if dry_run:
        open_store(plan, directory, base, threads or 1)
        click.echo(
            f"{plan.runs} runs: {len(plan.cases)} cases of {plan.samples} samples, in "
            f"{plan.n_blocks} blocks, to {directory}"
        )
        return DONE
    with Meter(quiet) as meter:
        report = run_sweep(plan, directory, base=base, threads=threads, report=meter)
    if not quiet and report.summary is not None:
        click.echo(closing_table(report.summary))
        rate = (report.runs - report.resumed_runs) / max(report.seconds, 1e-9)
        say(
            f"{report.runs} runs in {directory}, {report.resumed_runs} of them from before; "
            f"{report.seconds:.1f} s, {rate:.0f} runs a second"
        )
    if verbose:
        say(
            f"kernel loaded or compiled in {report.load_seconds:.2f} s, integration "
            f"{report.kernel_seconds:.2f} s, in all {report.seconds:.2f} s"
        )
    if report.failed:
        words = ", ".join(f"{count} {word}" for word, count in sorted(report.failed.items()))
        say(f"{sum(report.failed.values())} runs are not ok: {words}")
        return SOME_FAILED
    return DONE
