"""How many of the lanes are busy while a sweep is computed block by block.

The steps that each run of quickstart tries, rejected ones included, are replayed: each
lane takes the next run of its block when its own has ended, and waits at the end of the
block. So the numbers do not depend on how busy the machine is.

    python benchmarks/blocks.py
"""

from __future__ import annotations

import argparse
import heapq
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
from machine import all_runs, plan_of

from rattlesweep.arrays import Floats
from rattlesweep.config.read import parse_config
from rattlesweep.design.plan import Plan, make_plan
from rattlesweep.kernel.state.fields import LANES
from rattlesweep.rows.arrow import build_table
from rattlesweep.store.parquet import write_parquet
from rattlesweep.store.rows import Found
from rattlesweep.work.block import columns_of, run_batch
from rattlesweep.work.job import Job, Keys

TRIED_SECONDS = 34e-9  # for a step of one lane, on one thread
THREADS = (1, 2, 4, 16)


def measure(samples: int) -> tuple[Plan, pa.Table, Floats, Floats]:
    """Return quickstart, its rows, and expected price and tried steps of each run."""
    plan = plan_of("quickstart.yaml", f"bodies.samples={samples}")
    launches, batch = all_runs(plan)
    outcome = run_batch(plan.config, batch)
    columns = columns_of(plan.config, launches, batch, outcome)
    rows = build_table(columns, plan.schema)
    tried = outcome.n_steps + outcome.n_rejected
    return plan, rows, batch.t_end * batch.swing, tried.astype(float)


def as_table(rows: pa.Table, folder: Path) -> Plan:
    """Return the plan of a table with the same runs, which is one case."""
    write_parquet(rows, folder / "table.parquet")
    bodies = {"source": "table", "path": str(folder / "table.parquet")}
    return make_plan(parse_config({"bodies": bodies}))


def last_end(price: Floats, tried: Floats, lanes: int) -> float:
    """Return when the last of some lanes ends, if the dearest runs start first."""
    ends = [0.0] * lanes
    for run in np.argsort(-price, kind="stable"):
        heapq.heapreplace(ends, ends[0] + tried[run])
    return max(ends)


def blocks_of(plan: Plan, threads: int, tried: Floats, price: Floats) -> Iterator[Any]:
    """Yield runs and last end of each block, cut as on this machine by `local`."""
    stored: Any = SimpleNamespace(append=lambda *rows: None)
    job = Job(plan, stored, Found(plan.shape), threads)
    blocks = job.blocks(np.ones(plan.shape, bool))
    lanes = LANES * threads
    ahead = next(blocks, None)
    while ahead is not None:
        case, sample = ahead
        # The next block is cut before the time of this one is known.
        ahead = next(blocks, None)
        run = case * plan.samples + sample
        end = last_end(price[run], tried[run], lanes)
        job.write(_rows((case, sample), tried[run]), end * LANES * TRIED_SECONDS)
        yield run, end


def _rows(keys: Keys, tried: Floats) -> pa.Table:
    columns = {"case": keys[0], "sample": keys[1], "n_steps": tried}
    labels = {"type": ["R"] * len(tried), "status": ["ok"] * len(tried)}
    return pa.table(columns | labels)


def main() -> None:
    """Print the share of busy lanes, in all and of one queue with all runs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=400)
    options = parser.parse_args()
    plan, rows, price, tried = measure(options.samples)
    print(f"{plan.runs:,} runs, {tried.sum():.4g} steps tried")
    print(f"{'sweep':12}{'threads':>8}{'blocks':>8}{'busy':>8}{'one queue':>11}")
    with tempfile.TemporaryDirectory() as folder:
        plans = {"quickstart": plan, "table": as_table(rows, Path(folder))}
        for name, cut in plans.items():
            for threads in THREADS:
                lanes = LANES * threads
                ends = [end for _, end in blocks_of(cut, threads, tried, price)]
                least_turns = tried.sum() / lanes
                busy = least_turns / sum(ends)
                most = least_turns / last_end(price, tried, lanes)
                print(f"{name:12}{threads:8}{len(ends):8}{busy:8.3f}{most:11.3f}")


if __name__ == "__main__":
    main()
