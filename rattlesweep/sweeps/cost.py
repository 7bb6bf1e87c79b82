"""What runs cost: expected from theory, for blocks and progress, and measured, for forecasts."""

import io
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rattlesweep.arrays import Floats, Integers, take
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.status import Status
from rattlesweep.sweeps.block import columns_of, load_kernel, run_batch
from rattlesweep.sweeps.columns import build_table, encode
from rattlesweep.sweeps.config.schema import SdSource
from rattlesweep.sweeps.decide import deciding_key
from rattlesweep.sweeps.launches import Launches, make_batch, prepare
from rattlesweep.sweeps.plan import Plan, make_plan
from rattlesweep.text import clock, counted

FEW, MANY = 16, 256  # runs by which the cost of each of many cases, or of a single one, is judged
MOST_JUDGED = 2_000  # cases that are judged one by one; of more, every so many-th
SEED = 20170427
KNOWN = 20_000  # runs whose expected cost a forecast works out
# Runs of a first look, which tells the size of the pilot, and the steps of each at most.
FIRST, FIRST_STEPS = 128, 20_000
LEAST, MOST = 256, 8_192  # runs of the pilot


def expected_cost(launches: Launches, model: str) -> Floats:
    """Return the expected cost of runs: radians up to the horizon, 0 where there is none."""
    if model == "gh":
        return np.ones(len(launches.t_end))
    rate = launches.modes.omega_p
    if model == "reduced":  # its steps go with the spin, and not with the oscillations
        rate = launches.gh.n_0 * np.abs(launches.modes.K_p)
    return np.nan_to_num(launches.t_end * rate, posinf=0.0, neginf=0.0)


def sample_keys(plan: Plan, per_case: int, cases: Integers) -> tuple[Plan, Integers, Integers]:
    """Return keys of so many runs of some cases, and a plan that is cheap to ask for them."""
    bodies, count = plan.config.bodies, min(plan.samples, per_case)
    chosen = np.arange(count)  # random bodies are all alike
    if not isinstance(bodies, SdSource):
        random = np.random.default_rng(SEED)
        chosen = np.sort(random.choice(plan.samples, count, replace=False, shuffle=False))
    elif bodies.target is not None:
        # Bodies come in chunks; a smaller plan has smaller ones, with the same bodies.
        fewer = bodies.model_copy(update={"samples": count})
        smaller = make_plan(plan.config.model_copy(update={"bodies": fewer}))
        plan = replace(smaller, cases=plan.cases)
    return plan, np.repeat(cases, count), np.tile(chosen, len(cases))


def some_cases(count: int, most: int) -> Integers:
    """Return the numbers of cases, or of so many from all over them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def case_costs(plan: Plan) -> Floats:
    """Return the expected cost of one run of each case, above 0."""
    count = len(plan.cases)
    if plan.config.model == "gh":
        return np.ones(count)
    judged = some_cases(count, MOST_JUDGED)
    keys = sample_keys(plan, FEW if count > 1 else MANY, judged)
    cost = expected_cost(prepare(*keys), plan.config.model).reshape(len(judged), -1)
    # Cases between judged ones are neighbours in the order of the config.
    costs: Floats = np.interp(np.arange(count), judged, cost.mean(axis=1))
    costs[costs <= 0] = 1e-3 * costs.max() or 1.0
    return costs


@dataclass(frozen=True)
class Forecast:
    """What a sweep is expected to take on this machine, as busy as it is now."""

    runs: int
    threads: int
    seconds: float  # of the kernel for all runs; drawing bodies and compiling come on top
    low: float  # and high: interval of 95 %; runs that were too long for the pilot widen it
    high: float
    bytes: int  # of the files
    decides: str | None  # key by which the sweep leaves runs out; the figures are those of all

    @property
    def words(self) -> str:
        """The same for the terminal."""
        most, threads = "at most " if self.decides else "", counted(self.threads, "thread")
        power = min(4, int(np.log10(max(self.bytes, 1)) // 3))
        size = f"{self.bytes / 1000**power:.3g} {('B', 'kB', 'MB', 'GB', 'TB')[power]}"
        left = f"\n{self.decides} leaves runs out; how many cannot be told before"
        return (
            f"{self.runs:,} runs: {most}{_time(self.seconds)} with {threads} (95 %: "
            f"{_time(self.low)} to {_time(self.high)}), up to {size} on disk"
        ) + (left if self.decides else "")


def forecast(plan: Plan, threads: int | None = None, seconds: float = 2.0) -> Forecast:
    """Integrate some runs of a plan for about so many seconds, and say what all of them take."""
    here, config = available_threads(), plan.config
    threads = threads or here
    load_kernel(config)
    cases = some_cases(len(plan.cases), KNOWN // 4)
    each = max(4, KNOWN // len(cases))
    if getattr(config.bodies, "target", None):
        each = min(each, 400)  # each of these is drawn many times until it meets its target
    launches = prepare(*sample_keys(plan, each, cases))
    cost = expected_cost(launches, config.model)
    shares = cost / cost.sum() if cost.sum() > 0 else np.full(len(cost), 1 / len(cost))
    rng = np.random.default_rng(SEED)

    def measure(count: int, most: int) -> tuple[Any, ...]:
        # In proportion to expected cost: the mean of steps over expected cost is then the sweep's.
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
    half = len(table) // 2
    for part in (sinks := {len(table): io.BytesIO(), half: io.BytesIO()}):
        encode(table.slice(0, part), sinks[part])
    size, first = (sink.tell() for sink in sinks.values())
    size += int((plan.runs - len(table)) * (size - first) / (len(table) - half))
    return Forecast(plan.runs, threads, middle, low, high, size, deciding_key(config))


def _time(seconds: float) -> str:
    if seconds >= 100:
        return clock(seconds)
    return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
