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

from rattlesweep.arrays import Floats, take
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
FIRST, LEAST, MOST = 128, 256, 8_192
"""Runs of the first look, and of the pilot at least and at most."""
CAP_SHARE = 1 / 128
"""Share of the pilot's steps that one run may take: a longer one tells only that it is long."""
FEW_SHARE, FEW_LIMIT = 0.01, 0.5
"""A few runs take most of the time if one in a hundred takes half of it."""
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
        Time that the longest single run takes at most, on one lane of a thread.
    bytes : int
        Size of the files.
    share : float or None
        Seconds of one of so many shares.
    few : float
        Share of the expected cost that one run in a hundred takes.
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
    few: float
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
        if self.few >= FEW_LIMIT:
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

    Parameters
    ----------
    plan : Plan
    threads : int, optional
        Threads of the kernel; by default one for each processor.
    shards : int, optional
        Shares of which the time of one is asked for.
    seconds : float
        Time for the pilot, beside compiling and drawing bodies.
    """
    here = available_threads()
    threads = threads or here
    load_kernel(plan.config)
    launches = _known(plan)
    cost = expected_cost(launches, plan.config.model)
    rng = np.random.default_rng(SEED)
    share = cost / cost.sum() if cost.sum() > 0 else np.full(len(cost), 1 / len(cost))

    def draw(count: int) -> Launches:
        return take(launches, np.sort(rng.choice(len(cost), count, p=share)))

    # A first look, of which the pilot's size follows.
    first = _measure(plan, draw(FIRST), here, 20_000)
    steps = max(first.rate * seconds * 0.6, 1e4)
    reach = np.where(first.cut, first.cost * np.max(first.steps / first.cost), first.steps)
    each = float(np.mean(np.minimum(reach, steps * CAP_SHARE)))
    count = int(np.clip(steps / max(each, 1.0), LEAST, MOST))
    begin = time.perf_counter()
    parts: list[_Pilot] = []
    while not parts or time.perf_counter() - begin < 0.6 * seconds:
        parts.append(_measure(plan, draw(count), here, max(1_000, int(steps * CAP_SHARE))))
    pilot = _together(parts)

    ratio = pilot.steps / np.maximum(pilot.cost, 1e-300)
    # A run that was cut off takes as many steps for its cost as one that reaches its horizon.
    whole = float(ratio[~pilot.cut].max()) if (~pilot.cut).any() else float(ratio.max())
    upper = np.where(pilot.cut, max(whole, float(ratio.max())), ratio)
    error = CONFIDENT * float(ratio.std()) / np.sqrt(len(ratio))
    each = float(cost.mean()) * plan.runs / (pilot.rate * threads / here)
    low, high = each * max(0.0, float(ratio.mean()) - error), each * (float(upper.mean()) + error)
    middle = each * float((ratio + upper).mean()) / 2
    order = np.sort(cost)[::-1]
    few = float(order[: max(1, int(FEW_SHARE * len(order)))].sum() / max(order.sum(), 1e-300))
    # Of a heavy tail the largest of many draws grows with their number.
    beyond = max(1.0, plan.runs / len(cost)) if few >= FEW_LIMIT and plan.runs > len(cost) else 1.0
    lanes = 8 * here
    longest = float(order[0]) * beyond * whole / (pilot.rate / lanes)
    return Forecast(
        plan.runs, threads, middle, low, high, longest, int(pilot.row_bytes * plan.runs),
        None if shards is None else max(middle / shards, longest), few,
        float(pilot.cut.mean()), decides(plan.config),
    )  # fmt: skip


@dataclass(frozen=True)
class _Pilot:
    steps: Floats
    cost: Floats
    cut: Any  # runs that were given up
    rate: float  # steps a second
    row_bytes: float


def _measure(plan: Plan, launches: Launches, threads: int, most: int) -> _Pilot:
    """Integrate runs, each for so many steps at most."""
    config = plan.config
    cost = expected_cost(launches, config.model)
    capped = {"max_steps": min(most, config.integrator.max_steps)}
    limited = config.model_copy(update={"integrator": config.integrator.model_copy(update=capped)})
    batch = make_batch(launches, config.model)
    start = time.perf_counter()
    outcome = None if batch is None else run_batch(limited, batch, threads=threads)
    columns = columns_of(config, launches, batch, outcome)
    seconds = max(time.perf_counter() - start, 1e-6)
    table = build_table(columns, plan.schema)
    steps = np.ones(len(cost)) if outcome is None else outcome.n_steps.astype(float)
    cut = np.zeros(len(cost), bool) if outcome is None else outcome.status == Status.STEP_LIMIT
    # Runs are drawn with replacement, and those that come again compress to nothing.
    _, once = np.unique([launches.case, launches.sample], axis=1, return_index=True)
    rows = table.take(pa.array(np.sort(once)))
    half = len(rows) // 2
    row_bytes = (_encoded(rows) - _encoded(rows.slice(0, half))) / (len(rows) - half)
    return _Pilot(np.maximum(steps, 1.0), cost, cut, float(steps.sum()) / seconds, row_bytes)


def _together(parts: list[_Pilot]) -> _Pilot:
    return _Pilot(
        steps=np.concatenate([part.steps for part in parts]),
        cost=np.concatenate([part.cost for part in parts]),
        cut=np.concatenate([part.cut for part in parts]),
        rate=len(parts) / sum(1 / part.rate for part in parts),
        row_bytes=float(np.mean([part.row_bytes for part in parts])),
    )


def _known(plan: Plan) -> Launches:
    """Return launches that stand for all of a plan."""
    cases = np.arange(len(plan.cases))
    if len(cases) > KNOWN // 4:
        cases = np.unique(np.linspace(0, len(cases) - 1, KNOWN // 4).astype(int))
    each = max(4, KNOWN // len(cases))
    if plan.config.bodies.source == "sd" and getattr(plan.config.bodies, "target", None):
        each = min(each, 400)  # each of these is drawn many times until it meets its target
    return prepare(*sample_keys(plan, each, cases))


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
