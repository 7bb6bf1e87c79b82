"""Comparison of the kernels of two checkouts: steps, errors and time at equal error.

    python benchmarks/paired.py OTHER [--method dop853] [--samples 6] [--repeats 9]

Both integrate the mix of ``peer_work.py``, in turn, each in a process of its own on one
thread. Errors are those of the reversal times against two methods at a tolerance of
1e-13, and only where these two agree to 1e-8.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np
import peer_work
from machine import ROOT, heading

TOLS = {
    "dop853": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12),
    "dopri5": (1e-5, 1e-6, 1e-7, 1e-8),
    "verner98": (1e-6, 1e-8, 1e-9, 1e-10, 1e-12),
}


@dataclass
class Measured:
    """One checkout at one tolerance."""

    accepted: int
    rejected: int
    median: float  # of the errors
    p99: float
    seconds: list[float] = field(default_factory=list)


def reference(samples: int) -> peer_work.Floats:
    """Return reversal times on which two methods agree; NaN where they do not."""
    runs = peer_work.draw(samples)
    order_8 = peer_work.rattlesweep("dop853", tol=1e-13)(runs)
    order_9 = peer_work.rattlesweep("verner98", tol=1e-13)(runs)
    agree = np.abs(order_8 / order_9 - 1) < peer_work.AGREE
    return np.where(agree, order_9, np.nan)


def serve(method: str, samples: int) -> None:
    """Read tolerances and print times and results (runs in a child process)."""
    from rattlesweep.kernel.batch import integrate
    from rattlesweep.kernel.method.tableau import METHODS
    from rattlesweep.motion.model import FULL

    runs = peer_work.draw(samples)
    for line in sys.stdin:
        begin = time.process_time()
        outcome = integrate(runs, METHODS[method], FULL, tol=float(line), threads=1)
        answer = {
            "seconds": time.process_time() - begin,
            "accepted": int(outcome.n_steps.sum()),
            "rejected": int(outcome.n_rejected.sum()),
            "t_r": outcome.t_r.tolist(),
        }
        print(json.dumps(answer), flush=True)


class Child:
    """A process that serves with the package of a checkout."""

    def __init__(self, checkout: Path, *options: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--serve", *options],
            env=os.environ | {"PYTHONPATH": str(checkout)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, tol: float) -> dict[str, Any]:
        """Return one measurement."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{tol}\n")
        self.process.stdin.flush()
        answer: dict[str, Any] = json.loads(self.process.stdout.readline())
        return answer


def measure(child: Child, tol: float, t_ref: peer_work.Floats) -> Measured:
    """Return the steps and errors of a checkout; this call also compiles."""
    answer = child.ask(tol)
    errors = np.abs(np.array(answer["t_r"], dtype=float) / t_ref - 1)
    median, p99 = np.percentile(errors[np.isfinite(errors)], (50, 99))
    return Measured(answer["accepted"], answer["rejected"], median, p99)


@click.command()
@click.argument("other", default=ROOT, type=click.Path(path_type=Path))
@click.option("--method", default="dop853", show_default=True)
@click.option("--samples", default=6, show_default=True, help="Runs of each case.")
@click.option("--repeats", default=9, show_default=True)
@click.option("--serve", "serving", is_flag=True, hidden=True)
def main(other: Path, method: str, samples: int, repeats: int, serving: bool) -> None:
    """Measure this checkout (new) against OTHER (old)."""
    if serving:
        serve(method, samples)
        return
    click.echo(f"{heading()}\n{method}, one thread, medians of {repeats}")
    t_ref = reference(samples)
    options = ("--method", method, "--samples", str(samples))
    children = {"old": Child(other, *options), "new": Child(ROOT, *options)}
    click.echo(f"{np.isfinite(t_ref).sum()} of {len(t_ref)} runs reverse")
    click.echo(
        f"{'tol':>6}      {'seconds':>9}{'M tried/s':>10}{'accepted':>10}"
        f"{'rejected':>9}{'median':>10}{'99 %':>10}"
    )
    curves: dict[str, list[Measured]] = {side: [] for side in children}
    for tol in TOLS[method]:
        for side, child in children.items():
            curves[side].append(measure(child, tol, t_ref))
        for _ in range(repeats):
            for side, child in children.items():
                curves[side][-1].seconds.append(child.ask(tol)["seconds"])
        for side, curve in curves.items():
            point = curve[-1]
            seconds = statistics.median(point.seconds)
            tried = point.accepted + point.rejected
            click.echo(
                f"{tol:6.0e} {side:5}{seconds:9.3f}{tried / seconds / 1e6:10.2f}"
                f"{point.accepted:10d}{point.rejected / tried:9.2%}"
                f"{point.median:10.1e}{point.p99:10.1e}"
            )
        old, new = (curve[-1].seconds for curve in curves.values())
        ratio = statistics.median(a / b for a, b in zip(old, new, strict=True))
        click.echo(f"{'':7}new is {ratio:.3f} times as fast at this tol")
    costs = np.array([statistics.median(point.seconds) for point in curves["new"]])
    for name in ("median", "p99"):
        errors = np.array([getattr(point, name) for point in curves["new"]])
        for tol, point in zip(TOLS[method], curves["old"], strict=True):
            cost, mark = peer_work.cost_at(getattr(point, name), errors, costs)
            ratio = statistics.median(point.seconds) / cost
            click.echo(f"at the {name} error of old tol {tol:.0e}: {mark}{ratio:.3f}")


if __name__ == "__main__":
    main()
