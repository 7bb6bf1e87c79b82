"""How long a sweep will take on this machine, from a sample of its runs."""

import time
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Flags, Floats, take
from rattlesweep.design.batches import make_batch
from rattlesweep.design.plan import Plan
from rattlesweep.design.prepare import prepare_launches
from rattlesweep.kernel.threads import available_threads
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.rows.arrow import floats
from rattlesweep.rows.prepared import PreparedRuns
from rattlesweep.store.parquet import encode
from rattlesweep.system.console import clock, counted
from rattlesweep.work.block import compute, load_kernel
from rattlesweep.work.cost import expected_cost, sample_keys, some_cases
from rattlesweep.work.job import MAX_BLOCK_RUNS

_SEED = 20170427
EXPECTED = 20_000  # runs whose cost is expected from theory
MOST_AIMED = 400  # samples of a case among them, if bodies meet a target by many draws
# Runs of a first pilot, which sets the size of the second one, and the largest number
# of steps of each.
_FIRST = 128
_FIRST_STEPS = 20_000
_LEAST = 256  # bounds for the number of runs of the second pilot
_MOST = 8_192
# The same work takes more or less time from one minute to the next, by these factors.
FASTER = 0.8
SLOWER = 1.35
LEAST_SHARE = 0.3  # of the processors, below which a forecast does not go
# How much slower a sweep may become if a pilot gets next to nothing of the processors,
# as many more programs may come where there are others.
MOST_CROWDED = 3
_FEW = 32  # rows that are too few to tell their size in a file
_SIZES = ("B", "kB", "MB", "GB", "TB")


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
        power = min(len(_SIZES) - 1, int(np.log10(max(self.bytes, 1)) // 3))
        text = (
            f"{self.runs:,} runs: {most}{_time(self.seconds)} with "
            f"{counted(self.threads, 'thread')} ({_time(self.low)} to "
            f"{_time(self.high)}, as other programs allow), up to "
            f"{self.bytes / 1000**power:.3g} {_SIZES[power]} on disk"
        )
        if self.decides:
            text += (
                f"\n{self.decides} will skip some runs; how many cannot be predicted"
            )
        return text


@dataclass(frozen=True)
class Pilot:
    """Runs that were integrated to measure how long runs take."""

    rows: pa.Table
    weight: Floats  # share of all runs that each of them stands for
    steps: Floats
    ratio: Floats  # steps over expected cost
    is_cut: Flags  # whether a run was too long for the pilot
    rate: float  # steps a second
    share: float  # of the processors that the pilot got


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
    cases = some_cases(len(plan.cases), EXPECTED // 4)
    each = max(4, EXPECTED // len(cases))
    if getattr(plan.config.bodies, "target", None):
        each = min(each, MOST_AIMED)
    begin = time.perf_counter()
    launches = prepare_launches(*sample_keys(plan, each, cases))
    cost = expected_cost(launches, plan.config.model)
    body_seconds = (time.perf_counter() - begin) / len(cost)
    random = np.random.default_rng(_SEED)
    first = _pilot(plan, launches, cost, random, _FIRST, _FIRST_STEPS)
    budget = max(first.rate * seconds, 1e4)
    count = int(np.clip(budget / first.steps.mean(), _LEAST, _MOST))
    max_steps = max(1_000, int(budget / _FIRST))
    pilot = _pilot(plan, launches, cost, random, count, max_steps)
    # Runs that were cut off count with the largest ratio of steps to cost.
    upper = np.where(pilot.is_cut, pilot.ratio.max(), pilot.ratio)
    mean = float(pilot.weight @ pilot.ratio)
    variance = float(pilot.weight @ (pilot.ratio - mean) ** 2)
    error = 1.96 * np.sqrt(variance / count)
    kernel = float(cost.mean()) * plan.runs * available / pilot.rate / threads
    largest = float(pilot.weight @ upper)
    # Bodies are drawn while the kernel works, at its expense.
    beside = body_seconds * plan.runs
    share = min(1.0, max(pilot.share, LEAST_SHARE))
    # Where others use the processors now, they may stop, or many more may come.
    crowding = share + MOST_CROWDED * (1 - share)
    low = startup + kernel * max(0.0, mean - error)
    middle = startup / share + kernel * (mean + largest) / 2 + beside / 2
    high = startup / share + kernel * (largest + error) + beside
    return Forecast(
        runs=plan.runs,
        threads=threads,
        seconds=middle,
        low=min(middle, FASTER * share * low),
        high=SLOWER * crowding * high,
        bytes=_files_size(_as_in_files(pilot.rows, plan), plan.runs),
        decides=plan.config.deciding_key,
    )


def _pilot(
    plan: Plan,
    launches: PreparedRuns,
    cost: Floats,
    random: np.random.Generator,
    count: int,
    max_steps: int,
) -> Pilot:
    """Integrate some of the launches, up to a number of steps."""
    # They are drawn in proportion to expected cost, so that the mean of steps over cost
    # is that of the sweep.
    shares = np.full(len(cost), 1 / len(cost))
    if cost.sum() > 0:
        shares = cost / cost.sum()
    choice = random.choice(len(cost), count, p=shares)
    drawn, times = np.unique(choice, return_counts=True)
    settings = plan.config.integrator
    limit = {"max_steps": min(max_steps, settings.max_steps)}
    capped = {"integrator": settings.model_copy(update=limit)}
    config = plan.config.model_copy(update=capped)
    chosen = take(launches, drawn)
    threads = available_threads()
    begin = time.perf_counter()
    processor_begin = time.process_time()
    prepared = chosen, make_batch(chosen, config.model)
    rows = compute(config, plan.schema, prepared, threads)
    seconds = max(time.perf_counter() - begin, 1e-6)
    steps = np.maximum(floats(rows["n_steps"]), 1.0)
    return Pilot(
        rows=rows,
        weight=times / count,
        steps=steps,
        ratio=steps / np.maximum(cost[drawn], 1e-300),
        is_cut=rows["status"].to_numpy() == "step_limit",
        rate=float(steps.sum()) / seconds,
        share=(time.process_time() - processor_begin) / (seconds * threads),
    )


def _as_in_files(rows: pa.Table, plan: Plan) -> pa.Table:
    """Return rows of a sample in which bodies recur as often as in files of the sweep.

    A value that recurs takes less space.  The sample has each body once a case, while a
    file of a sweep of many samples has few cases, with other bodies in each row.
    """
    bodies = np.stack([floats(rows[name]) for name in PARAMETERS])
    _, body = np.unique(bodies, axis=1, return_inverse=True)
    order = np.argsort(body, kind="stable")
    first = np.searchsorted(body[order], body[order])
    recurrence = np.arange(len(body)) - first  # how often the body was there before
    most = max(1, MAX_BLOCK_RUNS // max(1, plan.samples))
    kept = np.sort(order[recurrence < most])
    if len(kept) < _FEW:
        return rows
    return rows.take(kept)


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
