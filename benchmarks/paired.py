"""Comparison of the kernels of two checkouts: steps, errors and time at equal error.

    python benchmarks/paired.py OTHER [--method dop853] [--samples 6] [--repeats 9]

Both integrate the mix of ``configs/steady.yaml`` (see ``peer_work.py``), in turn, each
in a process of its own on one thread.  Errors are those of the reversal times against
two methods at a tolerance of 1e-13, and only where these two agree to 1e-8.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import click
import numpy as np
import peer_work

HERE = Path(__file__).resolve()
TOLS = {
    "dop853": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12),
    "dopri5": (1e-5, 1e-6, 1e-7, 1e-8),
    "verner98": (1e-6, 1e-8, 1e-9, 1e-10, 1e-12),
}


def reference(samples):
    """Return reversal times on which two methods agree; NaN where they do not."""
    runs = peer_work.draw(samples)
    one, other = (
        peer_work.rattlesweep(name, tol=1e-13)(runs) for name in ("dop853", "verner98")
    )
    return np.where(np.abs(one / other - 1) < peer_work.AGREE, other, np.nan).tolist()


def serve(method, samples):
    """Read tolerances and print times and results (runs in a child process)."""
    from rattlesweep.integrate.batch import integrate
    from rattlesweep.integrate.model import FULL
    from rattlesweep.integrate.tableau import METHODS

    runs = peer_work.draw(samples)
    out = None
    for line in sys.stdin:
        begin = time.process_time()
        out = integrate(runs, METHODS[method], FULL, tol=float(line), threads=1)
        seconds = time.process_time() - begin
        steps = int(out.n_steps.sum()), int(out.n_rejected.sum())
        print(json.dumps([seconds, *steps, out.t_r.tolist()]), flush=True)


def child(checkout, *arguments):
    """Process that serves with the package of a checkout."""
    return subprocess.Popen(
        [sys.executable, str(HERE), *arguments],
        env=os.environ | {"PYTHONPATH": str(checkout)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def ask(process, tol):
    """One measurement."""
    process.stdin.write(f"{tol}\n")
    process.stdin.flush()
    return json.loads(process.stdout.readline())


@click.command()
@click.argument("other", required=False)
@click.option("--method", default="dop853", show_default=True)
@click.option(
    "--samples", default=6, show_default=True, help="Runs of each of the 120 cases."
)
@click.option("--repeats", default=9, show_default=True)
@click.option("--tols", default="", help="Tolerances, with commas between.")
@click.option("--serve", "serving", is_flag=True, hidden=True)
def main(
    other: str | None, method: str, samples: int, repeats: int, tols: str, serving: bool
) -> None:
    """Measure this checkout (new) against OTHER (old)."""
    if serving:
        serve(method, samples)
        return
    click.echo(f"{peer_work.processor()}; {method}, one thread, medians of {repeats}")
    kept = Path(os.environ.get("RATTLESWEEP_REFERENCE", "")) if samples else None
    if kept and kept.is_file():
        t_ref = np.array(json.loads(kept.read_text()))
    else:
        t_ref = np.array(reference(samples))
        if kept and kept.name:
            kept.write_text(json.dumps(t_ref.tolist()))
    options = ("--serve", "--method", method, "--samples", str(samples))
    sides = {
        "old": child(Path(other or "."), *options),
        "new": child(HERE.parents[1], *options),
    }
    click.echo(
        f"{np.isfinite(t_ref).sum()} of {len(t_ref)} runs reverse\n{'tol':>6}      "
        f"{'seconds':>9}{'M tried/s':>10}{'accepted':>10}{'rejected':>9}{'median':>10}{'99 %':>10}"
    )
    curves = {side: [] for side in sides}
    chosen = [float(t) for t in tols.split(",")] if tols else TOLS[method]
    for tol in chosen:
        seconds = {side: [] for side in sides}
        for repeat in range(repeats + 1):
            for side, process in sides.items():
                answer = ask(process, tol)
                if repeat:
                    seconds[side].append(answer[0])
                    continue
                error = np.abs(np.array(answer[3], dtype=float) / t_ref - 1)
                error = error[np.isfinite(error)]
                curves[side].append([*answer[1:3], *np.percentile(error, (50, 99))])
        for side in sides:
            spent = statistics.median(seconds[side])
            accepted, rejected, median, worst = curves[side][-1]
            curves[side][-1] = spent, median, worst
            tried = accepted + rejected
            click.echo(
                f"{tol:6.0e} {side:5}{spent:9.3f}{tried / spent / 1e6:10.2f}{accepted:10d}"
                f"{rejected / tried:9.2%}{median:10.1e}{worst:10.1e}"
            )
        ratio = statistics.median(
            a / b for a, b in zip(seconds["old"], seconds["new"], strict=True)
        )
        click.echo(f"{'':7}new is {ratio:.3f} times as fast at this tol")
    for which, column in (("median", 1), ("99 %", 2)):
        for tol, point in zip(chosen, curves["old"], strict=True):
            new = np.array(curves["new"])
            cost, mark = peer_work.cost_at(point[column], new[:, column], new[:, 0])
            click.echo(
                f"at the {which} error of old tol {tol:.0e}: {mark}{point[0] / cost:.3f}"
            )


if __name__ == "__main__":
    main()
