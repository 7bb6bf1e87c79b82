"""Rattlesweep against heyoka, diffrax, SciPy and plain Numba: cost against error.

    python benchmarks/peers.py [--quick] [--avx2]     (extra ``[bench]``)

The work is a sample of every case of ``configs/steady.yaml``, and the body of Garcia
and Hubbard, to the first zero of the spin or to a common horizon. Every time of
reversal is compared with a reference on which rattlesweep at tol 1e-13 and heyoka at
tol 1e-16 agree. All measurements are of one thread, in processor time, interleaved and
repeated; the table shows medians. A peer's ratio is its cost over that of
rattlesweep's DOP853 at the same median error, read from DOP853's own curve of cost
against error on the same runs in the same round.
"""

from __future__ import annotations

import itertools
import os
import statistics
import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from peer_work import Errors, Solve, Work

# These must be set before NumPy, Numba and XLA are loaded, so functions import them.
ONE_THREAD = {
    "NUMBA_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}
# XLA and Numba's plain loops have to be restricted as well.
AVX2 = {
    "NUMBA_CPU_NAME": "znver3",
    "NUMBA_CPU_FEATURES": "",
    "XLA_FLAGS": f"{ONE_THREAD['XLA_FLAGS']} --xla_cpu_max_isa=AVX2",
}
CURVE = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
# heyoka's steps hardly depend on tol, which sets the order; these make it 7 to 13.
HEYOKA = (1e-5, 1e-6, 2e-7, 2e-8, 3e-9, 3e-10, 4e-11)
BATCH = "heyoka batch"
REVERSING = "heyoka batch, reversing runs"
ORDER_9 = "rattlesweep verner98"


@dataclass
class Entry:
    """One line of the table."""

    method: str
    setting: str
    solve: Solve
    work: str  # name of the runs
    rounds: int = 99  # largest number of rounds in which it is measured
    micros: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)
    mark: str = ""
    errors: Errors | None = None


@dataclass
class Bench:
    """The works by name, the entries, and rattlesweep's curve on each work."""

    works: dict[str, Work]
    entries: list[Entry]
    curves: dict[str, list[Entry]]

    def measure(self, rounds: int) -> None:
        """Compile everything, then measure all in turn, ``rounds`` times."""
        for entry in itertools.chain(self.entries, *self.curves.values()):
            runs = self.works[entry.work].runs
            # Of the shapes to come, but short.
            entry.solve(replace(runs, t_end=runs.t_end * 1e-3))
        for number in range(rounds):
            click.echo(f"round {number + 1} of {rounds}", err=True)
            for name, curve in self.curves.items():
                for entry in curve:
                    # A few runs would leave lanes empty that a sweep fills.
                    self.time(entry, len(self.works["all"].runs))
                for entry in self.entries:
                    if entry.work == name and number < entry.rounds:
                        self.time(entry, 1)
                        self.compare(entry, number)

    def time(self, entry: Entry, least_runs: int) -> None:
        """Measure an entry once, on repeated runs if there are fewer than asked."""
        from peer_work import errors_of, timed

        work = self.works[entry.work]
        runs, copies = work.tiled(least_runs)
        seconds, t_r = timed(entry.solve, runs)
        entry.micros.append(seconds / copies / work.units * 1e6)
        if entry.errors is None:
            entry.errors = errors_of(t_r[: len(work.runs)], work)

    def compare(self, entry: Entry, number: int) -> None:
        """Add the cost of a round over rattlesweep's at the same median error."""
        assert entry.errors is not None
        curve = self.curves[entry.work]
        cost, mark = interpolate(curve, number, entry.errors.median)
        entry.ratios.append(entry.micros[number] / cost)
        # A bound of our cost from above is one of the ratio from below.
        entry.mark = {"<": ">", ">": "<", "": ""}[mark]

    def ratio_at(self, method: str, error: float) -> float:
        """Return the ratio at an error, both costs from curves; median of rounds."""
        points = [entry for entry in self.entries if entry.method == method]
        curve = self.curves[points[0].work]
        ratios = []
        for number in range(len(points[0].micros)):
            peer, peer_mark = interpolate(points, number, error)
            ours, our_mark = interpolate(curve, number, error)
            if peer_mark or our_mark:
                raise click.ClickException(f"{method}: no setting reaches {error}")
            ratios.append(peer / ours)
        return statistics.median(ratios)


def interpolate(curve: list[Entry], number: int, error: float) -> tuple[float, str]:
    """Return the cost in a round at an error, from several tolerances."""
    import numpy as np
    from peer_work import cost_at

    errors = [entry.errors.median for entry in curve if entry.errors is not None]
    costs = [entry.micros[number] for entry in curve]
    return cost_at(error, np.array(errors), np.array(costs))


def reference(samples: int) -> Work:
    """Return runs on which two references agree, with their times of reversal."""
    import numpy as np
    from peer_heyoka import BatchSolver
    from peer_work import AGREE, Work, draw, rattlesweep

    runs = draw(samples)
    ours = rattlesweep("dop853", tol=1e-13)(runs)
    theirs = BatchSolver(1e-16, high_accuracy=True)(runs)
    difference = np.abs(ours - theirs) / theirs
    neither = np.isnan(ours) & np.isnan(theirs)
    work = Work(runs, 0.5 * (ours + theirs)).take(neither | (difference <= AGREE))
    click.echo(
        f"{len(runs)} runs drawn, {len(work.runs)} on which the references agree to "
        f"{AGREE:g}, {np.isfinite(work.t_ref).sum()} of these reverse, "
        f"{work.units:.3g} units of time"
    )
    return work


def build(work: Work) -> Bench:
    """Return all methods and settings."""
    import numpy as np
    from peer_diffrax import Solver
    from peer_heyoka import BatchSolver, ScalarSolver
    from peer_plain import plain_rk4, scipy_dop853
    from peer_work import rattlesweep

    index = np.arange(len(work.runs))
    works = {
        "all": work,
        "reversing": work.take(~np.isnan(work.t_ref)),
        "every 4th": work.take(index % 4 == 0),
        "every 20th": work.take(index % 20 == 0),
        "every 40th": work.take(index % 40 == 0),
    }
    curves = {}
    for name in works:
        solvers = {tol: rattlesweep("dop853", tol=tol) for tol in CURVE}
        curves[name] = [
            Entry("rattlesweep dop853", f"tol {tol:.0e}", solve, name)
            for tol, solve in solvers.items()
        ]
    entries = []
    for tol in (1e-5, 1e-6, 1e-7, 1e-8):
        solve = rattlesweep("verner98", tol=tol)
        entries.append(Entry(ORDER_9, f"tol {tol:.0e}", solve, "all"))
    for tol in HEYOKA:
        batch = BatchSolver(tol)
        entries.append(Entry(BATCH, batch.setting, batch, "all"))
        entries.append(Entry(REVERSING, batch.setting, batch, "reversing"))
    for tol in (2e-7, 2e-8):
        scalar = ScalarSolver(tol)
        entries.append(Entry("heyoka, scalar", scalar.setting, scalar, "every 4th", 3))
    for rtol in (1e-6, 1e-7, 1e-9):
        vmap = Solver(rtol, 1e-2 * rtol)
        entries.append(Entry("diffrax Dopri8, vmap", vmap.setting, vmap, "all", 3))
    plain = plain_rk4(0.002)
    entries.append(Entry("plain Numba RK4", "dt 0.002", plain, "every 20th", 3))
    for rtol in (1e-6, 1e-9):
        solve = scipy_dop853(rtol, 1e-2 * rtol)
        setting = f"rtol {rtol:.0e}, atol {1e-2 * rtol:.0e}"
        entries.append(
            Entry("SciPy DOP853, Numba rhs", setting, solve, "every 40th", 2)
        )
    return Bench(works, entries, curves)


def show(entries: list[Entry]) -> None:
    """Print the table."""
    click.echo(
        f"\n{'method':29}{'setting':25}{'us per unit':>12}{'ratio':>9}{'median':>10}"
        f"{'99 %':>9}{'missed/false/another zero':>27}{'runs':>6}"
    )
    for entry in entries:
        errors = entry.errors
        assert errors is not None
        zeros = f"{errors.missed}/{errors.false}/{errors.another_zero}"
        ratio = ""
        if entry.ratios:
            ratio = f"{entry.mark}{statistics.median(entry.ratios):.1f}x"
        click.echo(
            f"{entry.method:29}{entry.setting:25}{statistics.median(entry.micros):12.4f}"
            f"{ratio:>9}{errors.median:10.1e}{errors.p99:9.0e}{zeros:>27}"
            f"{errors.runs:6}"
        )


@click.command()
@click.option("--quick", is_flag=True, help="Fewer runs and repeats.")
@click.option(
    "--avx2", is_flag=True, help="Code for Zen 3 here, vectors of 256 bits in heyoka."
)
def main(quick: bool, avx2: bool) -> None:
    """Measure rattlesweep and its peers on the same runs."""
    os.environ.update(ONE_THREAD)
    if avx2:
        os.environ.update(AVX2)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    from machine import heading

    click.echo(heading("heyoka", "jax", "diffrax", "scipy"))
    begin = time.perf_counter()
    bench = build(reference(1 if quick else 8))
    bench.measure(1 if quick else 7)
    show([*bench.curves["all"], *bench.entries])
    click.echo("\nrattlesweep's cost at equal median error of t_r, compared with")
    for method in (BATCH, REVERSING):
        ratios = (f"{bench.ratio_at(method, error):.3g}" for error in (1e-6, 1e-9))
        click.echo(f"  {method} at 1e-6, 1e-9: {', '.join(ratios)}")
    click.echo(f"  {ORDER_9} at 1e-9: {bench.ratio_at(ORDER_9, 1e-9):.3g}")
    click.echo(f"done in {time.perf_counter() - begin:.0f} s", err=True)


if __name__ == "__main__":
    main()
