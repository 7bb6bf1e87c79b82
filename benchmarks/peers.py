"""Rattlesweep against heyoka, diffrax, SciPy and plain Numba: the same runs, cost
against error.

    python benchmarks/peers.py [--quick] [--avx2] [--json FILE]     (extra ``[bench]``)

The work is a sample of every case of ``configs/steady.yaml``, and the body of Garcia
and Hubbard, to the first zero of the spin or to a common horizon.  Every time of
reversal is compared with a reference on which rattlesweep at tol 1e-13 and heyoka at
tol 1e-16 agree.  All measurements are of one thread, in processor time, interleaved and
repeated; the table shows medians.  A peer's ratio is its cost over that of
rattlesweep's DOP853 at the same median error, read from DOP853's own curve of cost
against error on the same runs in the same round.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import statistics
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Callable

    from peer_work import Errors, Solve, Work

# These must be set before NumPy, Numba and XLA are loaded, so ``main`` imports them.
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
VERSIONS = ("rattlesweep", "numpy", "numba", "heyoka", "jax", "diffrax", "scipy")
OWN, ORDER_9 = "rattlesweep dop853", "rattlesweep verner98"
BATCH, REVERSING = "heyoka batch", "heyoka batch, reversing runs"
VMAP, PLAIN = "diffrax Dopri8, vmap", "plain Numba RK4, scalar"
CURVE = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
# heyoka's steps hardly depend on tol, which sets the order; these make it 7 to 13.
HEYOKA = (1e-5, 1e-6, 2e-7, 2e-8, 3e-9, 3e-10, 4e-11)


@dataclass
class Entry:
    """One line of the table."""

    method: str
    setting: str
    solve: Solve
    work: str
    rounds: int = 99
    compile_seconds: float = 0.0
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

    def measure(self, rounds: int, report: Callable[[str], None]) -> None:
        """Warm everything up, then measure all in turn, ``rounds`` times."""
        for entry in [
            *self.entries,
            *(e for curve in self.curves.values() for e in curve),
        ]:
            begin = time.perf_counter()
            entry.solve(self._small(entry.work))
            entry.compile_seconds += time.perf_counter() - begin
        for r in range(rounds):
            report(f"round {r + 1} of {rounds}")
            for name, curve in self.curves.items():
                for entry in curve:
                    self._time(entry)
                    entry.ratios.append(1.0)
                for entry in self.entries:
                    if entry.work == name and r < entry.rounds:
                        self._time(entry)
                        ratio, entry.mark = self.ratio(entry, r)
                        entry.ratios.append(ratio)

    def _small(self, work: str) -> Any:
        """Runs for the first call, of the shapes to come, but short."""
        from dataclasses import replace

        runs = self.works[work].runs
        return replace(runs, t_end=runs.t_end * 1e-3)

    def _time(self, entry: Entry) -> None:
        from peer_work import errors, timed

        work = self.works[entry.work]
        own = entry in self.curves[entry.work]
        # A few runs would leave lanes empty that a sweep fills, so rattlesweep repeats
        # them.
        runs, copies = work.tiled(len(self.works["all"].runs) if own else 1)
        seconds, t_r = timed(entry.solve, runs)
        entry.micros.append(seconds / copies / work.units * 1e6)
        entry.errors = entry.errors or errors(t_r[: len(work.runs)], work)

    def ratio(self, entry: Entry, r: int) -> tuple[float, str]:
        """Cost of a round over that of rattlesweep at the same median error."""
        assert entry.errors is not None
        cost, mark = interpolate(self.curves[entry.work], r, entry.errors.median)
        return entry.micros[r] / cost, {"<": ">", ">": "<"}.get(mark, "")

    def at(self, method: str, error: float) -> float:
        """Ratio at an error, both costs read from curves; median of the rounds."""
        points = [entry for entry in self.entries if entry.method == method]
        curve = self.curves[points[0].work]
        ratios = []
        for r in range(len(points[0].micros)):
            (cost, mark), (own, own_mark) = (
                interpolate(p, r, error) for p in (points, curve)
            )
            if mark or own_mark:
                raise click.ClickException(
                    f"{method}: the settings do not reach error {error}"
                )
            ratios.append(cost / own)
        return statistics.median(ratios)


def interpolate(curve: list[Entry], r: int, error: float) -> tuple[float, str]:
    """Cost in round ``r`` at an error, from entries with several tolerances."""
    import numpy as np
    from peer_work import cost_at

    errors = np.array(
        [entry.errors.median for entry in curve if entry.errors is not None]
    )
    return cost_at(error, errors, np.array([entry.micros[r] for entry in curve]))


def reference(
    samples: int, report: Callable[[str], None]
) -> tuple[Work, dict[str, float]]:
    """Runs on which two references agree, with their times of reversal."""
    import numpy as np
    from peer_heyoka import BatchSolver
    from peer_work import AGREE, Work, draw, first_calls, rattlesweep

    report("rattlesweep's first call")
    cold, warm = first_calls()
    report("runs and references")
    runs = draw(samples)
    own = rattlesweep("dop853", tol=1e-13)(runs)
    other = BatchSolver("5 variables", 1e-16, high_accuracy=True)(runs)
    apart = np.abs(own - other) / other
    agree = np.where(np.isnan(own) & np.isnan(other), True, apart <= AGREE)
    work = Work(runs, 0.5 * (own + other)).take(agree)
    facts = {
        "drawn": len(runs),
        "dropped": int((~agree).sum()),
        "reversing": int((~np.isnan(work.t_ref)).sum()),
        "units": work.units,
        "cold_first_call_seconds": cold,
        "warm_first_call_seconds": warm,
        "median_disagreement": float(np.nanmedian(apart)),
        "p99_disagreement": float(np.nanpercentile(apart[agree], 99)),
    }
    return work, facts


def faster_system(work: Work) -> tuple[str, dict[str, float]]:
    """Return which form of the equations is faster for heyoka, and both costs."""
    from peer_heyoka import SYSTEMS, BatchSolver
    from peer_work import timed

    solvers = {name: BatchSolver(name, 2e-8) for name in SYSTEMS}
    costs: dict[str, list[float]] = {name: [] for name in SYSTEMS}
    for _ in range(4):
        for name, solver in solvers.items():
            costs[name].append(timed(solver, work.runs)[0] / work.units * 1e6)
    medians = {name: statistics.median(values[1:]) for name, values in costs.items()}
    return min(medians, key=lambda name: medians[name]), medians


def build(work: Work, system: str) -> Bench:
    """All methods and settings."""
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
    curves = {
        name: [
            Entry(OWN, f"tol {t:.0e}", rattlesweep("dop853", tol=t), name)
            for t in CURVE
        ]
        for name in works
    }
    entries = [
        Entry("rattlesweep dopri5", f"tol {t:.0e}", rattlesweep("dopri5", tol=t), "all")
        for t in (1e-6, 1e-9)
    ]
    entries += [
        Entry(ORDER_9, f"tol {t:.0e}", rattlesweep("verner98", tol=t), "all")
        for t in (1e-5, 1e-6, 1e-7, 1e-8)
    ]
    entries += [
        Entry(
            "rattlesweep rk4, lanes",
            f"dt {dt}",
            rattlesweep("rk4", dt=dt),
            "every 4th",
            2,
        )
        for dt in (0.02, 0.002)
    ]
    batches = [BatchSolver(system, tol) for tol in HEYOKA]
    for method, name in ((BATCH, "all"), (REVERSING, "reversing")):
        entries += [
            Entry(
                method,
                batch.setting,
                batch,
                name,
                compile_seconds=batch.compile_seconds,
            )
            for batch in batches
        ]
    groups = BatchSolver(system, 2e-8, refill=False)
    entries.append(
        Entry(
            "heyoka batch, no refilling",
            groups.setting,
            groups,
            "all",
            3,
            groups.compile_seconds,
        )
    )
    for tol in (2e-7, 2e-8):
        one = ScalarSolver(system, tol)
        entries.append(
            Entry(
                "heyoka, scalar", one.setting, one, "every 4th", 3, one.compile_seconds
            )
        )
    for rtol, atol in ((1e-6, 1e-8), (1e-7, 1e-9), (1e-9, 1e-11)):
        vmap = Solver(rtol, atol)
        entries.append(Entry(VMAP, vmap.setting, vmap, "all", 3))
    entries.append(Entry(PLAIN, "dt 0.002", plain_rk4(0.002), "every 20th", 3))
    for rtol in (1e-6, 1e-9):
        solve = scipy_dop853(rtol, 1e-2 * rtol)
        setting = f"rtol {rtol:.0e}, atol {1e-2 * rtol:.0e}"
        entries.append(
            Entry("SciPy DOP853, Numba rhs", setting, solve, "every 40th", 2)
        )
    return Bench(works, entries, curves)


def row(entry: Entry) -> dict[str, Any]:
    """One line of the table, as data."""
    assert entry.errors is not None
    return {
        "method": entry.method,
        "setting": entry.setting,
        "work": entry.work,
        "us_per_unit_and_run": statistics.median(entry.micros),
        "spread": (max(entry.micros) - min(entry.micros))
        / statistics.median(entry.micros),
        "ratio_at_equal_median_error": statistics.median(entry.ratios),
        "ratio_bound": entry.mark,
        "first_call_seconds": entry.compile_seconds,
        "rounds": entry.micros,
        **asdict(entry.errors),
    }


def show(rows: list[dict[str, Any]]) -> None:
    """Print the table."""
    click.echo(
        f"\n{'':29}{'':25}{'us per unit':>12}{'cost':>9}{'t_r: median':>12}{'99th':>9}"
        f"{'missed/false/':>15}{'':>6}{'first':>8}\n"
        f"{'method':29}{'setting':25}{'and run':>12}{'ratio':>9}{'error':>12}{'perc.':>9}"
        f"{'other zero':>15}{'runs':>6}{'call, s':>8}"
    )
    for line in rows:
        flips = f"{line['missed']}/{line['false']}/{line['other_zero']}"
        ratio = f"{line['ratio_bound']}{line['ratio_at_equal_median_error']:.1f}x"
        click.echo(
            f"{line['method']:29}{line['setting']:25}{line['us_per_unit_and_run']:12.4f}{ratio:>9}"
            f"{line['median']:12.1e}{line['p99']:9.0e}{flips:>15}{line['runs']:6}"
            f"{line['first_call_seconds']:8.2f}"
        )


def quoted(bench: Bench, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the quoted ratios, each at an error or at the peer's best setting."""

    def least(method: str) -> float:
        return min(
            r["ratio_at_equal_median_error"] for r in rows if r["method"] == method
        )

    found = [
        {"over": f"{method}, at error {error:.0e}", "ratio": bench.at(method, error)}
        for method in (BATCH, REVERSING)
        for error in (1e-6, 1e-9)
    ]
    return [
        *found,
        {"over": f"{ORDER_9}, at error 1e-09", "ratio": bench.at(ORDER_9, 1e-9)},
        {"over": f"{VMAP}, the least of its settings", "ratio": least(VMAP)},
        {"over": f"{PLAIN}, dt 0.002", "ratio": least(PLAIN)},
    ]


def heading() -> dict[str, Any]:
    """Machine and versions."""
    from peer_work import processor, source

    return {
        "processor": processor(),
        "load": f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown",
        "source": source(),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in VERSIONS},
    }


@click.command()
@click.option("--quick", is_flag=True, help="Fewer runs and repeats.")
@click.option(
    "--avx2", is_flag=True, help="Code for Zen 3 here, vectors of 256 bits in heyoka."
)
@click.option(
    "--json",
    "file",
    type=click.Path(path_type=Path),
    help="Write all numbers here too.",
)
def main(quick: bool, avx2: bool, file: Path | None) -> None:
    """Measure rattlesweep and its peers on the same runs."""
    os.environ.update(ONE_THREAD | (AVX2 if avx2 else {}))
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    begin = time.perf_counter()

    def report(text: str) -> None:
        click.echo(f"[{time.perf_counter() - begin:5.0f} s] {text}", err=True)

    machine = heading()
    click.echo(", ".join(f"{name} {value}" for name, value in machine.items()))
    work, facts = reference(3 if quick else 8, report)
    click.echo(
        f"{facts['drawn']} runs drawn; {facts['dropped']} dropped, where the references differ by "
        f"more than 1e-8; {facts['reversing']} of the others reverse; {facts['units']:.3g} units "
        f"of time\nthe references differ by {facts['median_disagreement']:.1e} (median), "
        f"{facts['p99_disagreement']:.0e} (99th percentile)\n"
        f"rattlesweep's first call: {facts['cold_first_call_seconds']:.1f} s when it compiles, "
        f"{facts['warm_first_call_seconds']:.2f} s from its cache"
    )
    report("heyoka: 5 or 6 variables")
    system, costs = faster_system(work)
    both = ", ".join(f"{name} {cost:.3f} us" for name, cost in costs.items())
    click.echo(f"heyoka at tol 2e-08: {both}; taken: {system}")
    report("first calls")
    bench = build(work, system)
    bench.measure(2 if quick else 7, report)
    rows = [row(entry) for entry in [*bench.curves["all"], *bench.entries]]
    show(rows)
    click.echo("\nrattlesweep's cost at equal median error of t_r, compared with")
    outcome = quoted(bench, rows)
    for line in outcome:
        text = f"{line['over']}:"
        click.echo(f"  {text:55}{line['ratio']:8.3g}x")
    report("done")
    if file is not None:
        curves = {name: [row(e) for e in curve] for name, curve in bench.curves.items()}
        record = {
            "machine": machine,
            "work": facts,
            "heyoka_systems": costs,
            "rows": rows,
            "curves": curves,
            "quoted": outcome,
        }
        file.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
