"""Speed of the kernel of this checkout relative to that of others, such as older ones.

    git worktree add ../older COMMIT
    python benchmarks/older.py ../older [OTHER ...] [--processes 6] [--repeats 3]

The runs are made here and read by all; a checkout needs ``integrate`` with the fields
of its own ``Batch`` alone. Processes of one and the same code differ by up to 6 % in
speed for as long as they live, by where the system places them. So each checkout has
several processes, which take turns on one thread, and the error of the mean is shown.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import IO, Any

import click
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
# Bodies of the paper's ranges: spin, targets, samples, horizon in units of t_RGH.
SWEEPS: dict[str, tuple[float, dict[str, Any], int, int]] = {
    "steady": (-0.3, {"K_r": [0.01, 0.03, 0.1], "rel_tol": 1e-3}, 100, 5),
    "unsteady": (0.3, {"K_p": [0.05, 0.15, 0.45, 1.35], "rel_tol": 1e-3}, 1000, 50),
}


def write_runs(folder: Path) -> None:
    """Write the runs of each sweep into an archive."""
    from machine import all_runs

    from rattlesweep.config.read import parse_config
    from rattlesweep.design.plan import make_plan
    from rattlesweep.kernel.outcome import Batch

    for name, (n_i, target, samples, horizon) in SWEEPS.items():
        config = {
            "seed": 2017,
            "bodies": {"source": "sd", "samples": samples, "target": target},
            "spin": {"n_i": n_i, "omega_xy0": 0.01},
            "horizon": {"t_rgh": horizon},
        }
        _, batch = all_runs(make_plan(parse_config(config)))
        columns = {field.name: getattr(batch, field.name) for field in fields(Batch)}
        np.savez(folder / f"{name}.npz", **columns)


def serve(folder: Path) -> None:
    """Integrate the sweeps named in the standard input (in a child process)."""
    from rattlesweep.kernel.batch import integrate
    from rattlesweep.kernel.method.tableau import METHODS
    from rattlesweep.kernel.outcome import Batch
    from rattlesweep.motion.model import FULL

    known = {field.name for field in fields(Batch)}
    for line in sys.stdin:
        archive = np.load(folder / f"{line.strip()}.npz")
        columns = {name: archive[name] for name in archive.files}
        columns["first_mark"] = columns["first_comparison"]  # as it was called before
        batch = Batch(**{name: columns[name] for name in known & columns.keys()})
        begin = time.process_time()
        outcome = integrate(batch, METHODS["dop853"], FULL, tol=1e-9, threads=1)
        seconds = time.process_time() - begin
        steps = int(outcome.n_steps.sum() + outcome.n_rejected.sum())
        print(json.dumps([seconds, steps]), flush=True)


def start(checkout: Path, folder: Path) -> subprocess.Popen[str]:
    """Start a process that serves with the package of a checkout."""
    return subprocess.Popen(
        [sys.executable, __file__, "--serve", str(folder)],
        env=os.environ | {"PYTHONPATH": str(checkout), "NUMBA_NUM_THREADS": "1"},
        cwd=checkout,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def ask(process: subprocess.Popen[str], sweep: str) -> tuple[float, int]:
    """Return the seconds of a sweep and its tried steps."""
    to_child: IO[str] | None = process.stdin
    from_child: IO[str] | None = process.stdout
    assert to_child is not None
    assert from_child is not None
    to_child.write(f"{sweep}\n")
    to_child.flush()
    seconds, steps = json.loads(from_child.readline())
    return seconds, steps


@click.command()
@click.argument("others", nargs=-1, type=click.Path(path_type=Path, resolve_path=True))
@click.option("--processes", default=6, show_default=True, help="Of each checkout.")
@click.option("--repeats", default=3, show_default=True, help="In each process.")
@click.option("--serve", "served", hidden=True, type=click.Path(path_type=Path))
def main(
    others: tuple[Path, ...], processes: int, repeats: int, served: Path | None
) -> None:
    """Measure this checkout against OTHERS."""
    if served is not None:
        serve(served)
        return
    checkouts = (ROOT, *others)
    seconds: dict[tuple[Path, str], list[float]] = {
        (checkout, sweep): [] for checkout in checkouts for sweep in SWEEPS
    }
    steps: dict[tuple[Path, str], int] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_runs(folder)
        for _ in range(processes):
            with ExitStack() as stack:
                children = {
                    checkout: stack.enter_context(start(checkout, folder))
                    for checkout in checkouts
                }
                for sweep in SWEEPS:
                    for checkout, child in children.items():
                        # The first call loads and compiles.
                        _, steps[checkout, sweep] = ask(child, sweep)
                    spent = [
                        [ask(child, sweep)[0] for child in children.values()]
                        for _ in range(repeats)
                    ]
                    for checkout, least in zip(
                        checkouts, np.min(spent, axis=0), strict=True
                    ):
                        seconds[checkout, sweep].append(float(least))
    click.echo(f"{'':9}{'steps':>9}{'seconds':>9}{'error':>7}{'this is faster by':>19}")
    for (checkout, sweep), measured in seconds.items():
        mean = statistics.mean(measured)
        error = statistics.stdev(measured) / len(measured) ** 0.5 / mean
        ratio = mean / statistics.mean(seconds[ROOT, sweep])
        click.echo(
            f"{sweep:9}{steps[checkout, sweep]:9d}{mean:9.4f}{error:7.2%}{ratio:19.3f}"
            f"  {checkout.name}"
        )


if __name__ == "__main__":
    main()
