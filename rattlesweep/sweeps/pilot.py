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
from rattlesweep.durations import clock
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.status import Status
from rattlesweep.sweeps.arrow import build_table, encode
from rattlesweep.sweeps.block import columns_of, load_kernel, run_batch
from rattlesweep.sweeps.cost import SEED, expected_cost, sample_keys
from rattlesweep.sweeps.decide import decides
from rattlesweep.sweeps.launches import Launches, make_batch, prepare
from rattlesweep.sweeps.plan import Plan

KNOWN = 20_000
"""Runs whose expected cost is worked out."""
FIRST, FIRST_STEPS = 128, 20_000
"""Runs of a first look, which tells the size of the pilot, and the steps of each at most."""
LEAST, MOST = 256, 8_192
"""Runs of the pilot; a run takes at most the budget over `FIRST`, and longer ones are cut."""
FEW_OF, FEW_LIMIT = 100, 0.5
"""A few runs take most of the time if one in a hundred takes half of it."""
LANES = 8
"""Lanes of a thread at the speed of which a run that is left alone goes on."""
CONFIDENT = 1.96


@dataclass(frozen=True)
class Forecast:
    """What a sweep is expected to take on this machine, as busy as it is now.

    Attributes
    ----------
    runs, threads : int
    seconds : float
        Time of the kernel for all runs; drawing bodies and compiling come on top.
    low, high : float
        Interval of 95 % of that; runs that the pilot could not follow to their end widen it.
    longest : float
        Time that the longest single run takes at most.
    bytes : int
        Size of the files.
    share : float or None
        Seconds of one of so many shares.
    few : float or None
        Share of the expected cost that one run in a hundred takes; None for fewer runs.
    unseen : float
        Share of the pilot's runs that were too long for it.
    decides : str or None
        Key by which the sweep leaves runs out; the figures are then those of all runs.
    """

    runs: int
    threads: int
    seconds: float
    low: float
    high: float
    longest: float
    bytes: int
    share: float | None
    few: float | None
    unseen: float
    decides: str | None

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
        if self.few is not None and self.few >= FEW_LIMIT:
            lines.append(
                f"one run in a hundred takes {100 * self.few:.0f} % of the time, as t_rGH goes to "
                "infinity with the skew to zero; horizon: {t_rgh: 5, t: ...} sets a limit"
            )
        if self.unseen > 0.05:
            lines.append(
                f"{100 * self.unseen:.0f} % of the pilot's runs were too long for it, so the time "
                "may be anywhere in the interval"
            )
        if self.decides:
            lines.append(f"{self.decides} leaves runs out; how many cannot be told before")
        return "\n".join(lines)


def forecast(
    plan: Plan, threads: int | None = None, shards: int | None = None, seconds: float = 2.0
) -> Forecast:
    """Integrate some runs of a plan for about so many seconds, and say what all of them take.

    `shards` is the number of shares of which the time of one is asked for.
    """
    here = available_threads()
    threads = threads or here
    load_kernel(plan.config)
    launches = _known(plan)
    cost = expected_cost(launches, plan.config.model)
    rng = np.random.default_rng(SEED)
    shares = cost / cost.sum() if cost.sum() > 0 else np.full(len(cost), 1 / len(cost))

    def measure(count: int, most: int) -> tuple[Any, ...]:
        """Return the runs drawn, how often each was, their steps, which were cut, and the rate."""
        drawn, times = np.unique(rng.choice(len(cost), count, p=shares), return_counts=True)
        table, steps, cut, rate = _integrate(plan, take(launches, drawn), here, most)
        return table, times / count, steps / np.maximum(cost[drawn], 1e-300), cut, rate, steps

    *_, rate, steps = measure(FIRST, FIRST_STEPS)
    budget = max(rate * seconds, 1e4)
    count = int(np.clip(budget / max(float(steps.mean()), 1.0), LEAST, MOST))
    table, weight, ratio, cut, rate, _ = measure(count, max(1_000, int(budget / FIRST)))
    # A run that was cut takes at most as many steps for its cost as one that has ended.
    upper = np.where(cut, ratio.max(), ratio)
    error = CONFIDENT * np.sqrt(float(weight @ (ratio - weight @ ratio) ** 2) / count)
    each = float(cost.mean()) * plan.runs / (rate * threads / here)
    low, high = each * max(0.0, float(weight @ ratio) - error), each * (weight @ upper + error)
    middle = each * float(weight @ (ratio + upper)) / 2
    few = None
    if min(plan.runs, len(cost)) >= FEW_OF:
        few = float(np.sort(shares)[::-1][: len(cost) // FEW_OF].sum())
    # Of a heavy tail the largest of many draws grows with their number.
    beyond = plan.runs / len(cost) if few is not None and few >= FEW_LIMIT else 1.0
    longest = float(cost.max() * ratio.max()) * beyond / (rate / (LANES * here))
    return Forecast(
        plan.runs, threads, middle, low, float(high), longest, _disk(table, plan.runs),
        None if shards is None else max(middle / shards, longest), few, float(weight @ cut),
        decides(plan.config),
    )  # fmt: skip


def _integrate(plan: Plan, launches: Launches, threads: int, most: int) -> tuple[Any, ...]:
    """Return the rows of runs of so many steps at most, their steps, which were cut, the rate."""
    config = plan.config
    capped = {"max_steps": min(most, config.integrator.max_steps)}
    limited = config.model_copy(update={"integrator": config.integrator.model_copy(update=capped)})
    batch = make_batch(launches, config.model)
    start = time.perf_counter()
    outcome = None if batch is None else run_batch(limited, batch, threads=threads)
    columns = columns_of(config, launches, batch, outcome)
    seconds = max(time.perf_counter() - start, 1e-6)
    steps, cut = np.ones(len(launches.n_i)), np.zeros(len(launches.n_i), bool)
    if outcome is not None:
        steps, cut = np.maximum(outcome.n_steps, 1.0), outcome.status == Status.STEP_LIMIT
    return build_table(columns, plan.schema), steps, cut, float(steps.sum()) / seconds


def _known(plan: Plan) -> Launches:
    """Return launches that stand for all of a plan."""
    cases = np.arange(len(plan.cases))
    if len(cases) > KNOWN // 4:
        cases = np.unique(np.linspace(0, len(cases) - 1, KNOWN // 4).astype(int))
    each = max(4, KNOWN // len(cases))
    if plan.config.bodies.source == "sd" and getattr(plan.config.bodies, "target", None):
        each = min(each, 400)  # each of these is drawn many times until it meets its target
    return prepare(*sample_keys(plan, each, cases))


def _disk(table: pa.Table, runs: int) -> int:
    """Return the size of a file of so many runs, from rows of some of them."""
    half = len(table) // 2
    whole, part = _encoded(table), _encoded(table.slice(0, half))
    return int(whole + (runs - len(table)) * (whole - part) / (len(table) - half))


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
