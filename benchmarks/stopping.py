"""Whether what `stop` promises holds: many sweeps, each stopped by its own runs.

Of each sweep's cases, whether the shares of types and the mean of t_r lie as close to the true
values as was asked for, and within the intervals of 95 % that plots show. The closed form, in
memory; what decides is what decides in a sweep. The truth is a sweep of 2^20 Sobol' samples.

    python benchmarks/stopping.py --sweeps 500
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from rattlesweep.sweeps.block import finish_block, prepare_runs
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.decide import make_stages
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.arrow import build_table
from rattlesweep.sweeps.counts import Z95, Cells, wilson
from rattlesweep.sweeps.columns import runs_schema

CONFIG: dict[str, Any] = {
    "bodies": {"source": "sd", "samples": 50_000},
    "spin": {"n_i": [-0.1, -0.2, -0.4], "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 2000},
}
STOPS = ({"fraction": 0.02}, {"t_r": 0.03})


def run(plan, numbers, decide, cells) -> None:
    """Do some runs, and count them."""
    launches, batch = prepare_runs(plan, *np.divmod(numbers, plan.samples))
    table = build_table(finish_block(plan.config, launches, batch), runs_schema(model="gh"))
    for rows in table.to_batches():
        cells.add(rows, rows.column("case").to_numpy().astype(np.int64))
        if decide is not None:
            decide.add(rows)


def stopped(config: dict[str, Any]) -> Cells:
    """A sweep that stops, by case."""
    plan = make_plan(parse_config(config))
    decide = make_stages(plan.config, len(plan.cases), plan.samples)
    cells = Cells(len(plan.cases))
    numbers = decide.first()
    while len(numbers):
        run(plan, numbers, decide, cells)
        numbers = decide.next()
    return cells


def truth(bits: int = 20) -> Cells:
    """The same of very many samples."""
    bodies = CONFIG["bodies"] | {"samples": 2**bits, "draw": "sobol"}
    plan = make_plan(parse_config(CONFIG | {"bodies": bodies, "seed": 1}))
    cells = Cells(len(plan.cases))
    for numbers in np.split(np.arange(plan.runs), 3 * 2 ** max(0, bits - 17)):
        run(plan, numbers, None, cells)
    return cells


def main() -> None:
    """Print a line for each stop, block size, case and measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sweeps", type=int, default=500)
    parser.add_argument("--sizes", type=int, nargs="+", default=[100, 1000])
    options = parser.parse_args()
    exact = truth()
    print("stop            block  n_i  measure             true   samples  as asked  in 95 %")
    for stop in STOPS:
        for size in options.sizes:
            found = [
                stopped(CONFIG | {"stop": stop, "seed": 100 + seed})
                for seed in range(options.sweeps)
            ]
            samples = np.mean([cells.runs for cells in found], axis=0)
            for name, value, asked, inside in coverage(stop, found, exact):
                for case, n_i in enumerate(CONFIG["spin"]["n_i"]):
                    print(
                        f"{stop!s:15} {size:5d} {n_i:5.2g}  {name:18} {value[case]:6.4g} "
                        f"{samples[case]:8.0f}  {asked[case]:8.3f} {inside[case]:8.3f}",
                        flush=True,
                    )


def coverage(stop, found: list[Cells], exact: Cells):
    """By measure: true values, and how often they are as near as asked, and in the interval."""
    if "t_r" in stop:
        true = exact.t_r.means()
        means = np.array([cells.t_r.means() for cells in found])
        errors = Z95 * np.array([cells.t_r.errors() for cells in found])
        off = np.abs(means - true)
        yield "mean t_r", true, np.mean(off <= stop["t_r"] * means, 0), np.mean(off <= errors, 0)
        return
    for name in ("R", "SW", "unclassified"):
        true = exact.types[name] / exact.ok
        parts = np.array([cells.types[name] for cells in found])
        whole = np.array([cells.ok for cells in found])
        low, high = wilson(parts, whole)
        near = np.abs(parts / whole - true) <= stop["fraction"]
        yield f"share of {name}", true, near.mean(0), np.mean((low <= true) & (true <= high), 0)


if __name__ == "__main__":
    main()
