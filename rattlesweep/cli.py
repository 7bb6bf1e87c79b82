"""Command line: load, call, save.  Heavy imports happen inside the commands."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rattlesweep.sweep.engine import Progress

DONE, FAILED, WRONG, SOME_FAILED, INTERRUPTED, TERMINATED = 0, 1, 2, 3, 130, 143
# Seconds between lines of progress where there is no terminal.
LINE_EVERY = 60.0


class Terminated(BaseException):
    """SIGTERM arrived."""


def _say(text: str) -> None:
    click.echo(text, err=True)


def _leave(code: int) -> None:
    """End the process; at once where a kernel still compiles and would hold up the exit."""
    sys.stdout.flush()
    sys.stderr.flush()
    # Ours by name: an embedding program, such as a test runner, may have daemons of its own.
    if any(t.name.startswith("rattlesweep-") for t in threading.enumerate()):
        os._exit(code)
    raise SystemExit(code)


def _guarded(command: Callable[..., Any]) -> Callable[..., Any]:
    """Turn what can go wrong into one sentence and an exit code."""

    @wraps(command)
    def guarded(*args: Any, **kwargs: Any) -> None:
        def terminate(number: int, frame: Any) -> None:
            raise Terminated

        signal.signal(signal.SIGTERM, terminate)
        try:
            code = command(*args, **kwargs)
        except (KeyboardInterrupt, Terminated) as error:
            # A second Ctrl-C is obeyed at once.
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            term = isinstance(error, Terminated)
            what = "terminated" if term else "interrupted"
            _say(f"{what}; what is whole is kept, and the same command goes on from there")
            _leave(TERMINATED if term else INTERRUPTED)
        except BrokenPipeError:
            # The reader of standard output has gone; there is nobody to tell.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise SystemExit(FAILED) from None
        except Exception as error:
            from rattlesweep.sweep.errors import ConfigError, OutputError

            if isinstance(error, ConfigError):
                for line in error.messages:
                    _say(f"error: {line}")
                _leave(WRONG)
            if isinstance(error, OutputError):
                _say(f"error: {error}")
                _leave(FAILED)
            raise
        if code:
            _leave(code)

    return guarded


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="rattlesweep", prog_name="rattlesweep")
def main() -> None:
    """Sweeps of rattlebacks: sample bodies, integrate them, type the runs, write Parquet.

    Exit codes: 0 done, 1 failed, 2 the command or the config is wrong, 3 done but some runs have
    a status other than ok, 130 interrupted, 143 terminated.
    """


OVERRIDES = click.option(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    multiple=True,
    help="Replace a key of the config, such as bodies.samples=10; may be repeated.",
)


@main.command(
    epilog="\b\nExample:\n  rattlesweep run configs/quickstart.yaml --set bodies.samples=100"
)
@click.argument("config", type=click.Path())
@click.option("--output", metavar="DIR", help="Output directory; overrides the config's.")
@OVERRIDES
@click.option("--threads", type=click.IntRange(1), help="Threads of the kernel.")
@click.option("--dry-run", is_flag=True, help="Say what would be run, and stop.")
@click.option("-q", "--quiet", is_flag=True, help="No progress and no closing table.")
@click.option("-v", "--verbose", is_flag=True, help="Say where the time went.")
@_guarded
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
    if threads is not None and threads > (most := _most_threads()):
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
    with _Meter(quiet) as meter:
        report = run_sweep(plan, directory, base=base, threads=threads, report=meter)
    if not quiet and report.summary is not None:
        click.echo(closing_table(report.summary))
        rate = (report.runs - report.resumed_runs) / max(report.seconds, 1e-9)
        _say(
            f"{report.runs} runs in {directory}, {report.resumed_runs} of them from before; "
            f"{report.seconds:.1f} s, {rate:.0f} runs a second"
        )
    if verbose:
        _say(
            f"kernel loaded or compiled in {report.load_seconds:.2f} s, integration "
            f"{report.kernel_seconds:.2f} s, in all {report.seconds:.2f} s"
        )
    if report.failed:
        words = ", ".join(f"{count} {word}" for word, count in sorted(report.failed.items()))
        _say(f"{sum(report.failed.values())} runs are not ok: {words}")
        return SOME_FAILED
    return DONE


def _most_threads() -> int:
    from rattlesweep.integrate.batch import most_threads

    return most_threads()


class _Meter:
    """Progress: a bar on a terminal, one line a minute elsewhere, nothing if quiet."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._bar: Any = None
        self._last = time.monotonic()

    def __enter__(self) -> _Meter:
        if not self._quiet and sys.stderr.isatty():
            from tqdm import tqdm

            # Of expected cost; tqdm's own estimate would count compilation as work.
            self._bar = tqdm(
                total=100.0, bar_format="{percentage:3.0f}%|{bar}| {desc}", file=sys.stderr
            )
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, progress: Progress) -> None:
        left = "" if progress.left is None else f", {_clock(progress.left)} left"
        text = f"{progress.runs}/{progress.total} runs, {_clock(progress.elapsed)}{left}"
        if self._bar is not None:
            self._bar.n = 100.0 * progress.fraction
            self._bar.set_description_str(text)
        elif not self._quiet and time.monotonic() - self._last >= LINE_EVERY:
            self._last = time.monotonic()
            _say(f"{100 * progress.fraction:.1f} %, {text}")


def _clock(seconds: float) -> str:
    whole = round(seconds)
    hours, rest = divmod(whole, 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}" if hours else f"{rest // 60}:{rest % 60:02d}"


@main.command(
    epilog="\b\nExample:\n  rattlesweep classify out/quickstart --set classify.sw_departure=0.1"
)
@click.argument("directory", type=click.Path())
@OVERRIDES
@_guarded
def classify(directory: str, overrides: tuple[str, ...]) -> int:
    """Type the stored runs of a directory again, without integrating.

    Prints one row per case on standard output.
    """
    from rattlesweep.sweep.retype import retype
    from rattlesweep.sweep.summary import closing_table

    changed, summary = retype(Path(directory), overrides)
    click.echo(closing_table(summary))
    _say(f"{changed} runs have changed their type")
    return DONE


@main.command(
    epilog="\b\nExamples:\n  rattlesweep body --preset GH\n  rattlesweep body --gamma 10 --f-sd "
    "0.1 --theta 0.8 --phi 0.05 --xi-deg -3 --json"
)
@click.option("--preset", metavar="NAME", help="A named body: GH (Garcia and Hubbard 1988).")
@click.option("--alpha", type=float, help="I_xx + 1, in M a^2.")
@click.option("--beta", type=float, help="I_yy + 1, in M a^2.")
@click.option("--gamma", type=float, help="I_zz, in M a^2.")
@click.option(
    "--f-sd", type=float, help="I_yy/I_zz of a shell-dumbbell body; replaces alpha, beta."
)
@click.option("--theta", type=float, help="Larger principal curvature, in 1/a.")
@click.option("--phi", type=float, help="Smaller principal curvature, in 1/a.")
@click.option("--xi", type=float, help="Skew angle in radians.")
@click.option("--xi-deg", type=float, help="Skew angle in degrees.")
@click.option("--n-i", type=float, default=0.1, show_default=True, help="Initial spin.")
@click.option("--omega-xy0", type=float, default=0.01, show_default=True, help="Oscillation.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@_guarded
def body(as_json: bool, n_i: float, omega_xy0: float, **given: Any) -> int:
    """Derived quantities of one body: modes, torque coefficients, thresholds, reversal times.

    Spin and oscillation, in sqrt(g/a), are needed for the reversal times only.
    """
    from rattlesweep.sweep.derived import derived, make_body

    values = derived(make_body(given), n_i, omega_xy0)
    if as_json:
        click.echo(json.dumps({q.name: q.value for q in values}, indent=2, allow_nan=False))
        return DONE
    width = max(len(q.name) for q in values)
    for q in values:
        shown = "none" if q.value is None else f"{q.value:.10g}"
        click.echo(f"{q.name:<{width}}  {shown:>15}  {q.unit:<9}  {q.description}".rstrip())
    return DONE


@main.command(
    epilog="\b\nExamples:\n  rattlesweep tradeoff --quick\n  rattlesweep tradeoff "
    "configs/tradeoff.yaml --output out/tradeoff"
)
@click.argument("config", type=click.Path(), required=False)
@click.option("--output", metavar="DIR", help="Output directory; overrides the config's.")
@click.option("--samples", type=click.IntRange(1), help="Bodies; by default, 2000 runs or more.")
@click.option("--quick", is_flag=True, help="Fewer runs and measurements: seconds, but rough.")
@OVERRIDES
@click.option("--threads", type=click.IntRange(1), help="Threads for the errors; costs are of one.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
@_guarded
def tradeoff(
    config: str | None,
    output: str | None,
    samples: int | None,
    quick: bool,
    overrides: tuple[str, ...],
    threads: int | None,
    as_json: bool,
) -> int:
    """Measure speed against accuracy: methods, settings and models on the same runs.

    Draws runs from CONFIG, by default shell-dumbbell bodies in both directions; its model,
    integrator and record play no part. Prints a table and the cheapest settings for some errors of
    t_r, and writes tradeoff.parquet, tradeoff.svg and tradeoff.png.
    """
    from rattlesweep.integrate.batch import available_threads
    from rattlesweep.study import tradeoff_output
    from rattlesweep.study.tradeoff import DEFAULT, FULL, QUICK, measure
    from rattlesweep.sweep.config import load_config, override_config
    from rattlesweep.sweep.errors import ConfigError
    from rattlesweep.sweep.files import probe_directory

    loaded = (
        override_config(DEFAULT, overrides) if config is None else load_config(config, overrides)
    )
    if output is not None and not output:
        raise ConfigError("--output: the directory has no name; give one")
    directory = Path(output if output is not None else loaded.directory)
    if threads is not None and threads > (most := _most_threads()):
        raise click.BadParameter(f"{threads} is more than the {most} processors there are")
    probe_directory(directory)
    start = time.monotonic()
    study = measure(
        loaded,
        None if config is None else Path(config).resolve().parent,
        samples=samples,
        scope=QUICK if quick else FULL,
        threads=threads or available_threads(),
        report=_stages(start),
    )
    files = tradeoff_output.save(study, directory)
    if as_json:
        data = tradeoff_output.as_data(study)
        click.echo(json.dumps(data, indent=2, allow_nan=False))
    else:
        click.echo(tradeoff_output.as_text(study))
    _say(f"{', '.join(p.name for p in files)} in {directory}; {time.monotonic() - start:.1f} s")
    return DONE


def _stages(start: float) -> Callable[[str], None]:
    """Say what is being done: each on a terminal, elsewhere no more than a line a minute."""
    last = start

    def say(text: str) -> None:
        nonlocal last
        if sys.stderr.isatty() or time.monotonic() - last >= LINE_EVERY:
            last = time.monotonic()
            _say(f"{last - start:4.0f} s  {text}")

    return say


@main.command(epilog="\b\nExample:\n  rattlesweep schema > rattlesweep.schema.json")
@_guarded
def schema() -> int:
    """Print the JSON Schema of the config."""
    from rattlesweep.sweep.config import config_json_schema

    click.echo(json.dumps(config_json_schema(), indent=2))
    return DONE
