"""Forecast what a sweep takes from about two seconds of it; nothing is written.

Runs differ a thousandfold in length, and most end before their horizon.  Runs are therefore drawn
in proportion to their expected cost: the mean of steps over expected cost is then the sweep's.
"""

from __future__ import annotations

import io
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import take
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.status import Status
from rattlesweep.sweeps.arrow import build_table, encode
from rattlesweep.sweeps.block import columns_of, load_kernel, run_batch
from rattlesweep.sweeps.cost import SEED, expected_cost, sample_keys
from rattlesweep.sweeps.decide import decides
from rattlesweep.sweeps.launches import make_batch, prepare
from rattlesweep.sweeps.plan import Plan
from rattlesweep.text import clock

KNOWN = 20_000  # runs whose expected cost is worked out
# Runs of a first look, which tells the size of the pilot, and the steps of each at most; a run of
# the pilot takes at most its budget over FIRST, and longer ones are cut.
FIRST, FIRST_STEPS = 128, 20_000
LEAST, MOST = 256, 8_192  # runs of the pilot
LANES = 8  # lanes of a thread at the speed of which a run that is left alone goes on


@dataclass(frozen=True)
class Forecast:
    """What a sweep is expected to take on this machine, as busy as it is now."""

    runs: int
    threads: int
    seconds: float  # of the kernel for all runs; drawing bodies and compiling come on top
    low: float  # and high: interval of 95 %; runs that were too long for the pilot widen it
    high: float
    longest: float  # seconds that the longest single run takes at most
    bytes: int  # of the files
    share: float | None  # seconds of one of so many shards
    unseen: float  # share of the pilot's runs that were too long for it
    decides: str | None  # key by which the sweep leaves runs out; the figures are those of all

    def as_data(self) -> dict[str, Any]:
        """Return the figures as JSON data."""
        return asdict(self)

    @property
    def words(self) -> str:
        """The same for the terminal."""
        most, plural = "at most " if self.decides else "", "s" if self.threads > 1 else ""
        lines = [
            f"{self.runs:,} runs: {most}{_time(self.seconds)} with {self.threads} thread{plural} "
            f"(95 %: {_time(self.low)} to {_time(self.high)}), up to {_size(self.bytes)} on disk",
            f"the longest run takes up to {_time(self.longest)}",
        ]
        if self.share is not None:
            lines.append(f"a shard takes about {_time(self.share)}")
        if self.decides:
            lines.append(f"{self.decides} leaves runs out; how many cannot be told before")
        return "\n".join(lines)


def forecast(
    plan: Plan, threads: int | None = None, shards: int | None = None, seconds: float = 2.0
) -> Forecast:
    """Integrate some runs of a plan for about so many seconds, and say what all of them take.

    `shards` is the number of shards of which the time of one is asked for.
    """
    here, config = available_threads(), plan.config
    threads = threads or here
    load_kernel(config)
    # Launches that stand for all.
    cases, most_cases = np.arange(len(plan.cases)), KNOWN // 4
    if len(cases) > most_cases:
        cases = np.unique(np.linspace(0, len(cases) - 1, most_cases).astype(int))
    each = max(4, KNOWN // len(cases))
    if getattr(config.bodies, "target", None):
        each = min(each, 400)  # each of these is drawn many times until it meets its target
    launches = prepare(*sample_keys(plan, each, cases))
    cost = expected_cost(launches, config.model)
    shares = cost / cost.sum() if cost.sum() > 0 else np.full(len(cost), 1 / len(cost))
    rng = np.random.default_rng(SEED)

    def measure(count: int, most: int) -> tuple[Any, ...]:
        """Integrate runs, each drawn so often, of so many steps at most."""
        drawn, times = np.unique(rng.choice(len(cost), count, p=shares), return_counts=True)
        part, settings = take(launches, drawn), config.integrator
        batch, outcome, start = make_batch(part, config.model), None, time.perf_counter()
        steps, cut = np.ones(len(drawn)), np.zeros(len(drawn), bool)
        if batch is not None:
            capped = settings.model_copy(update={"max_steps": min(most, settings.max_steps)})
            outcome = run_batch(config.model_copy(update={"integrator": capped}), batch, here)
            steps, cut = np.maximum(outcome.n_steps, 1.0), outcome.status == Status.STEP_LIMIT
        columns = columns_of(config, part, batch, outcome)
        rate = float(steps.sum()) / max(time.perf_counter() - start, 1e-6)
        table = build_table(columns, plan.schema)
        return table, times / count, steps, steps / np.maximum(cost[drawn], 1e-300), cut, rate

    _, _, steps, *_, rate = measure(FIRST, FIRST_STEPS)
    budget = max(rate * seconds, 1e4)
    count = int(np.clip(budget / max(float(steps.mean()), 1.0), LEAST, MOST))
    table, weight, _, ratio, cut, rate = measure(count, max(1_000, int(budget / FIRST)))
    # A run that was cut takes at most as many steps for its cost as one that has ended.
    upper, mean = np.where(cut, ratio.max(), ratio), float(weight @ ratio)
    error = 1.96 * np.sqrt(float(weight @ (ratio - mean) ** 2) / count)
    all_runs = float(cost.mean()) * plan.runs / (rate * threads / here)
    low, high = all_runs * max(0.0, mean - error), float(all_runs * (weight @ upper + error))
    middle = all_runs * float(weight @ (ratio + upper)) / 2
    # Of a heavy tail, in which one run in a hundred takes half, the largest of many draws grows.
    heavy = np.sort(shares)[::-1][: len(cost) // 100].sum() > 0.5
    beyond = plan.runs / len(cost) if heavy else 1.0
    longest = float(cost.max() * ratio.max()) * beyond / (rate / (LANES * here))
    if plan.runs <= LEAST and not cut.any():
        longest = min(longest, high)  # few runs leave lanes idle
    half = len(table) // 2
    size, first = _encoded(table), _encoded(table.slice(0, half))
    size += int((plan.runs - len(table)) * (size - first) / (len(table) - half))
    share = None if shards is None else max(middle / shards, longest)
    unseen, leaves = float(weight @ cut), decides(config)
    return Forecast(plan.runs, threads, middle, low, high, longest, size, share, unseen, leaves)


def _encoded(table: pa.Table) -> int:
    sink = io.BytesIO()
    encode(table, sink)
    return sink.tell()


def _time(seconds: float) -> str:
    if seconds >= 100:
        return clock(seconds)
    return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"


def _size(size: float) -> str:
    power = min(4, int(np.log10(max(size, 1)) // 3))
    return f"{size / 1000**power:.3g} {('B', 'kB', 'MB', 'GB', 'TB')[power]}"
