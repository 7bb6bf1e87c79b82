"""The cost of runs: expected from theory for blocks and progress, measured for
forecasts.
"""

import io
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Floats, Integers, take
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.status import Status
from rattlesweep.sweeps.block import columns_of, load_kernel, run_batch
from rattlesweep.sweeps.columns import build_table, encode
from rattlesweep.sweeps.config.schema import SdSource
from rattlesweep.sweeps.launches import Launches, make_batch, prepare
from rattlesweep.sweeps.plan import Plan, make_plan
from rattlesweep.text import clock, counted

RUNS_PER_CASE, RUNS_ALONE = (
    16,
    256,
)  # sampled for the expected cost of a case, or of the only one
MOST_CASES = 2_000  # cases whose cost is computed; it is interpolated between them
SEED = 20170427
EXPECTED = 20_000  # runs of a forecast whose cost is expected from theory
# Runs of a first pilot, which sets the size of the second one, and the largest number
# of steps.
FIRST, FIRST_STEPS = 128, 20_000
LEAST, MOST = 256, 8_192  # bounds for the number of runs of the second pilot


def expected_cost(launches: Launches, model: str) -> Floats:
    """Return the expected cost of runs: radians of phase up to the horizon, 0 without
    one.
    """
    if model == "gh":
        return np.ones(len(launches.horizon))
    rate = launches.modes.omega_p
    if model == "reduced":  # its steps follow the spin, not the oscillations
        rate = launches.gh.n_0 * np.abs(launches.modes.K_p)
    return np.nan_to_num(launches.horizon * rate, posinf=0.0, neginf=0.0)


def sample_keys(
    plan: Plan, per_case: int, cases: Integers
) -> tuple[Plan, Integers, Integers]:
    """Return a plan that is quick to prepare some runs of some cases, and the keys of
    these.
    """
    bodies, count = plan.config.bodies, min(plan.samples, per_case)
    chosen = np.arange(count)  # the first of random bodies are as good as any
    if not isinstance(bodies, SdSource):
        random = np.random.default_rng(SEED)
        chosen = np.sort(
            random.choice(plan.samples, count, replace=False, shuffle=False)
        )
    elif bodies.target is not None:
        # Bodies are drawn by chunks; a smaller plan has smaller chunks of the same
        # bodies.
        fewer = bodies.model_copy(update={"samples": count})
        smaller = make_plan(plan.config.model_copy(update={"bodies": fewer}))
        plan = replace(smaller, cases=plan.cases)
    return plan, np.repeat(cases, count), np.tile(chosen, len(cases))


def some_cases(count: int, most: int) -> Integers:
    """Return the numbers of all cases, or of at most `most` evenly spaced ones."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def case_costs(plan: Plan) -> Floats:
    """Return the expected cost of one run of each case, above 0."""
    count = len(plan.cases)
    if plan.config.model == "gh":
        return np.ones(count)
    cases = some_cases(count, MOST_CASES)
    keys = sample_keys(plan, RUNS_PER_CASE if count > 1 else RUNS_ALONE, cases)
    cost = expected_cost(prepare(*keys), plan.config.model).reshape(len(cases), -1)
    # Cases with neighbouring numbers have similar launches.
    costs: Floats = np.interp(np.arange(count), cases, cost.mean(axis=1))
    costs[costs <= 0] = 1e-3 * costs.max() or 1.0
    return costs


@dataclass(frozen=True)
class Forecast:
    """Expected time and disk space of a sweep on this machine at its present load."""

    runs: int
    threads: int
    seconds: (
        float  # time of the kernel for all runs, without drawing bodies and compiling
    )
    # low and high: 95 % interval, wider if some runs were too long for the pilot
    low: float
    high: float
    bytes: int  # size of the files
    decides: (
        str | None
    )  # key that makes the sweep skip runs; the figures are for all runs

    @property
    def words(self) -> str:
        """The forecast as a line of text."""
        most, threads = (
            "at most " if self.decides else "",
            counted(self.threads, "thread"),
        )
        power = min(4, int(np.log10(max(self.bytes, 1)) // 3))
        size = f"{self.bytes / 1000**power:.3g} {('B', 'kB', 'MB', 'GB', 'TB')[power]}"
        left = f"\n{self.decides} leaves runs out; how many is not known before"
        return (
            f"{self.runs:,} runs: {most}{_time(self.seconds)} with {threads} (95 %: "
            f"{_time(self.low)} to {_time(self.high)}), up to {size} on disk"
        ) + (left if self.decides else "")


def forecast(plan: Plan, threads: int | None = None, seconds: float = 2.0) -> Forecast:
    """Forecast a sweep by integrating a sample of its runs for about `seconds`."""
    available, config = available_threads(), plan.config
    threads = threads or available
    load_kernel(config)
    cases = some_cases(len(plan.cases), EXPECTED // 4)
    each = max(4, EXPECTED // len(cases))
    if getattr(config.bodies, "target", None):
        each = min(each, 400)  # bodies with a target take many draws
    launches = prepare(*sample_keys(plan, each, cases))
    cost = expected_cost(launches, config.model)
    shares = cost / cost.sum() if cost.sum() > 0 else np.full(len(cost), 1 / len(cost))
    rng = np.random.default_rng(SEED)

    def measure(count: int, most: int) -> tuple[Any, ...]:
        # Drawn in proportion to expected cost, so that the mean of steps / cost is the
        # sweep's.
        drawn, times = np.unique(
            rng.choice(len(cost), count, p=shares), return_counts=True
        )
        part, settings = take(launches, drawn), config.integrator
        batch, outcome, start = (
            make_batch(part, config.model),
            None,
            time.perf_counter(),
        )
        steps, cut = np.ones(len(drawn)), np.zeros(len(drawn), bool)
        if batch is not None:
            capped = settings.model_copy(
                update={"max_steps": min(most, settings.max_steps)}
            )
            outcome = run_batch(
                config.model_copy(update={"integrator": capped}), batch, available
            )
            steps, cut = (
                np.maximum(outcome.n_steps, 1.0),
                outcome.status == Status.STEP_LIMIT,
            )
        columns = columns_of(config, part, batch, outcome)
        rate = float(steps.sum()) / max(time.perf_counter() - start, 1e-6)
        table = build_table(columns, plan.schema)
        return (
            table,
            times / count,
            steps,
            steps / np.maximum(cost[drawn], 1e-300),
            cut,
            rate,
        )

    _, _, steps, *_, rate = measure(FIRST, FIRST_STEPS)
    budget = max(rate * seconds, 1e4)
    count = int(np.clip(budget / max(float(steps.mean()), 1.0), LEAST, MOST))
    table, weight, _, ratio, cut, rate = measure(count, max(1_000, int(budget / FIRST)))
    # Runs that were cut off count with the largest ratio of steps to cost.
    upper, mean = np.where(cut, ratio.max(), ratio), float(weight @ ratio)
    error = 1.96 * np.sqrt(float(weight @ (ratio - mean) ** 2) / count)
    all_runs = float(cost.mean()) * plan.runs / (rate * threads / available)
    low, high = (
        all_runs * max(0.0, mean - error),
        float(all_runs * (weight @ upper + error)),
    )
    middle = all_runs * float(weight @ (ratio + upper)) / 2
    half = len(table) // 2
    whole_size, half_size = _file_size(table), _file_size(table.slice(0, half))
    row_size = (whole_size - half_size) / (len(table) - half)
    size = whole_size + int((plan.runs - len(table)) * row_size)
    return Forecast(plan.runs, threads, middle, low, high, size, config.deciding_key)


def _file_size(table: pa.Table) -> int:
    encode(table, sink := io.BytesIO())
    return sink.tell()


def _time(seconds: float) -> str:
    if seconds >= 100:
        return clock(seconds)
    return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
