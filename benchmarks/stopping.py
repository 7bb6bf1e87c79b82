"""Check the accuracy that `stop` promises, with many sweeps, each stopped by its own
runs.

For each case, counts how often the shares of types and the mean of t_r are within the
requested error of the true values, and how often the 95 % intervals of plots contain
these. The runs are of the closed form, in memory, and stop by the rule of a sweep. The
truth is a sweep of 2^20 Sobol' samples.

    python benchmarks/stopping.py --sweeps 500
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Integers
from rattlesweep.sweeps.block import compute, prepare_runs
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.decide import wanted_runs
from rattlesweep.sweeps.plan import Plan, make_plan
from rattlesweep.sweeps.summary import Counts
from rattlesweep.sweeps.types import Z95, wilson

CONFIG: dict[str, Any] = {
    "bodies": {"source": "sd", "samples": 50_000},
    "spin": {"n_i": [-0.1, -0.2, -0.4], "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 2000},
}
STOPS = ({"fraction": 0.02}, {"t_r": 0.03})


def run(plan: Plan, case: Integers, sample: Integers, counts: Counts) -> pa.Table:
    """Do some runs and count their types."""
    table = compute(plan.config, plan.schema, prepare_runs(plan, case, sample))
    for rows in table.to_batches():
        counts.add(rows, rows.column("case").to_numpy().astype(np.int64))
    return table


def stopped(config: dict[str, Any]) -> Counts:
    """Return the result of a sweep that stops, by case."""
    plan = make_plan(parse_config(config))
    found, counts = plan.nothing_found(), Counts(len(plan.cases))
    while (todo := wanted_runs(plan, found) & ~found.done).any():
        found.add(run(plan, *np.nonzero(todo), counts))
    return counts


def truth(bits: int = 20) -> Counts:
    """Return the same of very many samples."""
    bodies = CONFIG["bodies"] | {"samples": 2**bits, "draw": "sobol"}
    plan = make_plan(parse_config(CONFIG | {"bodies": bodies, "seed": 1}))
    counts = Counts(len(plan.cases))
    for numbers in np.split(np.arange(plan.runs), 3 * 2 ** max(0, bits - 17)):
        run(plan, *np.divmod(numbers, plan.samples), counts)
    return counts


def main() -> None:
    """Print a line for each stop, case and measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sweeps", type=int, default=500)
    options = parser.parse_args()
    exact = truth()
    print(
        "stop                 n_i  measure                 true   samples  as asked  in 95 %"
    )
    for stop in STOPS:
        found = [
            stopped(CONFIG | {"stop": stop, "seed": 100 + seed})
            for seed in range(options.sweeps)
        ]
        samples = np.mean([counts["runs"] for counts in found], axis=0)
        for name, value, asked, inside in coverage(stop, found, exact):
            for case, n_i in enumerate(CONFIG["spin"]["n_i"]):
                print(
                    f"{stop!s:18} {n_i:5.2g}  {name:22} {value[case]:6.4g} "
                    f"{samples[case]:8.0f}  {asked[case]:8.3f} {inside[case]:8.3f}",
                    flush=True,
                )


def coverage(
    stop: dict[str, float], found: list[Counts], exact: Counts
) -> Iterator[Any]:
    """Yield by measure the true values, and how often they are as near as asked and in
    the interval.
    """
    if "t_r" in stop:
        true = exact.t_r.means()
        means = np.array([counts.t_r.means() for counts in found])
        errors = Z95 * np.array([counts.t_r.errors() for counts in found])
        off = np.abs(means - true)
        yield (
            "mean t_r",
            true,
            np.mean(off <= stop["t_r"] * means, 0),
            np.mean(off <= errors, 0),
        )
        return
    for name in ("R", "SW", "unclassified"):
        true = exact.types[name] / exact["ok"]
        parts = np.array([counts.types[name] for counts in found])
        whole = np.array([counts["ok"] for counts in found])
        low, high = wilson(parts, whole)
        near = np.abs(parts / whole - true) <= stop["fraction"]
        yield (
            f"share of {name}",
            true,
            near.mean(0),
            np.mean((low <= true) & (true <= high), 0),
        )


if __name__ == "__main__":
    main()
