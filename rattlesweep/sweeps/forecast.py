"""How long a sweep will take on this machine, from a sample of its runs."""

import time
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Flags, Floats, take
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.status import Status
from rattlesweep.sweeps.block import columns_of, load_kernel, run_batch
from rattlesweep.sweeps.columns import build_table
from rattlesweep.sweeps.cost import expected_cost, sample_keys, some_cases
from rattlesweep.sweeps.launches import Launches, make_batch, prepare
from rattlesweep.sweeps.parquet import encode
from rattlesweep.sweeps.plan import Plan
from rattlesweep.text import clock, counted

SEED = 20170427
EXPECTED = 20_000  # runs whose cost is expected from theory
MOST_AIMED = 400  # samples of a case among them, if bodies meet a target by many draws
# Runs of a first pilot, which sets the size of the second one, and the largest number
# of steps of each.
FIRST = 128
FIRST_STEPS = 20_000
LEAST = 256  # bounds for the number of runs of the second pilot
MOST = 8_192
# The same work takes more or less time from one minute to the next, by these factors.
FASTER = 0.8
SLOWER = 1.35
LEAST_SHARE = 0.3  # of the processors, below which a forecast does not go
SIZES = ("B", "kB", "MB", "GB", "TB")


@dataclass(frozen=True)
class Forecast:
    """Expected time and disk space of a sweep on this machine at its present load."""

    runs: int
    threads: int
    seconds: float  # of the whole command, without compiling
    # From how long to how long it may take: with what the pilot leaves open, and what
    # other programs may do.
    low: float
    high: float
    bytes: int  # size of the files
    decides: str | None  # key that makes the sweep skip runs; figures are for all runs

    @property
    def words(self) -> str:
        """The forecast as a line of text."""
        most = "at most " if self.decides else "about "
        power = min(len(SIZES) - 1, int(np.log10(max(self.bytes, 1)) // 3))
        size = f"{self.bytes / 1000**power:.3g} {SIZES[power]}"
        text = (
            f"{self.runs:,} runs: {most}{_time(self.seconds)} with "
            f"{counted(self.threads, 'thread')} ({_time(self.low)} to "
            f"{_time(self.high)}, as other programs allow), up to {size} on disk"
        )
        if self.decides:
            text += (
                f"\n{self.decides} will skip some runs; how many cannot be predicted"
            )
        return text


@dataclass(frozen=True)
class Pilot:
    """Runs that were integrated to measure how long runs take."""

    table: pa.Table  # their rows
    weight: Floats  # share of the sample that each of them stands for
    steps: Floats
    ratio: Floats  # steps over expected cost
    is_cut: Flags  # whether a run was too long for the pilot
    rate: float  # steps a second
    share: float  # of the processors that the pilot got
    row_seconds: float  # for making a row


class Sample:
    """Runs of a plan with their expected costs, from which pilots are drawn."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        cases = some_cases(len(plan.cases), EXPECTED // 4)
        each = max(4, EXPECTED // len(cases))
        if getattr(plan.config.bodies, "target", None):
            each = min(each, MOST_AIMED)
        begin = time.perf_counter()
        self._launches = prepare(*sample_keys(plan, each, cases))
        self.cost = expected_cost(self._launches, plan.config.model)
        count = len(self.cost)
        self.body_seconds = (time.perf_counter() - begin) / count
        self._shares = np.full(count, 1 / count)
        if self.cost.sum() > 0:
            self._shares = self.cost / self.cost.sum()
        self._random = np.random.default_rng(SEED)

    def pilot(self, count: int, max_steps: int) -> Pilot:
        """Integrate `count` runs, up to a number of steps."""
        # They are drawn in proportion to expected cost, so that the mean of steps over
        # cost is that of the sweep.
        drawn, times = np.unique(
            self._random.choice(len(self.cost), count, p=self._shares),
            return_counts=True,
        )
        begin = time.perf_counter()
        processor_begin = time.process_time()
        launches = take(self._launches, drawn)
        steps, is_cut, columns = self._integrate(launches, max_steps)
        seconds = max(time.perf_counter() - begin, 1e-6)
        used = time.process_time() - processor_begin
        begin = time.perf_counter()
        table = build_table(columns, self._plan.schema)
        encode(table)
        return Pilot(
            table=table,
            weight=times / count,
            steps=steps,
            ratio=steps / np.maximum(self.cost[drawn], 1e-300),
            is_cut=is_cut,
            rate=float(steps.sum()) / seconds,
            share=min(1.0, used / (seconds * available_threads())),
            row_seconds=(time.perf_counter() - begin) / len(table),
        )

    def _integrate(
        self, launches: Launches, max_steps: int
    ) -> tuple[Floats, Flags, dict[str, object]]:
        """Return the steps of runs, whether they were cut off, and their columns."""
        config = self._plan.config
        batch = make_batch(launches, config.model)
        if batch is None:
            count = len(launches.horizon)
            columns = columns_of(config, launches, None, None)
            return np.ones(count), np.zeros(count, bool), columns
        settings = config.integrator
        limit = {"max_steps": min(max_steps, settings.max_steps)}
        capped = {"integrator": settings.model_copy(update=limit)}
        outcome = run_batch(
            config.model_copy(update=capped), batch, available_threads()
        )
        columns = columns_of(config, launches, batch, outcome)
        is_cut = outcome.status == Status.STEP_LIMIT
        return np.maximum(outcome.n_steps, 1.0), is_cut, columns


def forecast(
    plan: Plan,
    threads: int | None = None,
    seconds: float = 2.0,
    startup: float = 0.0,
) -> Forecast:
    """Forecast a sweep by integrating a sample of its runs for about `seconds`.

    `startup` is the processor time that a command needs before it begins.
    """
    available = available_threads()
    threads = threads or available
    load_kernel(plan.config)
    sample = Sample(plan)
    first = sample.pilot(FIRST, FIRST_STEPS)
    budget = max(first.rate * seconds, 1e4)
    wanted = budget / max(float(first.steps.mean()), 1.0)
    count = int(np.clip(wanted, LEAST, MOST))
    pilot = sample.pilot(count, max(1_000, int(budget / FIRST)))
    # Runs that were cut off count with the largest ratio of steps to cost.
    upper = np.where(pilot.is_cut, pilot.ratio.max(), pilot.ratio)
    mean = float(pilot.weight @ pilot.ratio)
    variance = float(pilot.weight @ (pilot.ratio - mean) ** 2)
    error = 1.96 * np.sqrt(variance / count)
    kernel = float(sample.cost.mean()) * plan.runs * available / pilot.rate / threads
    largest = float(pilot.weight @ upper)
    # Bodies are drawn and rows are made while the kernel works, at its expense.
    beside = (sample.body_seconds + pilot.row_seconds) * plan.runs
    share = max(pilot.share, LEAST_SHARE)
    begin = startup / share
    low = startup + kernel * max(0.0, mean - error)
    middle = begin + kernel * (mean + largest) / 2 + beside / 2
    high = begin + kernel * (largest + error) + beside
    return Forecast(
        runs=plan.runs,
        threads=threads,
        seconds=middle,
        # Where others use the processors now, they may stop, or as many more come.
        low=min(middle, FASTER * share * low),
        high=SLOWER * (2 - share) * high,
        bytes=_files_size(pilot.table, plan.runs),
        decides=plan.config.deciding_key,
    )


def _files_size(table: pa.Table, runs: int) -> int:
    """Return the size of the files of so many runs, from those of a sample."""
    half = len(table) // 2
    whole_size = len(encode(table))
    row_size = (whole_size - len(encode(table.slice(0, half)))) / (len(table) - half)
    return whole_size + int((runs - len(table)) * row_size)


def _time(seconds: float) -> str:
    if seconds >= 100:
        return clock(seconds)
    if seconds >= 10:
        return f"{seconds:.0f} s"
    return f"{seconds:.2g} s"
