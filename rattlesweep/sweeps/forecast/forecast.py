"""What a sweep will take: time, disk, memory; from a short timed pilot that writes nothing."""

from __future__ import annotations

import heapq
import time
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.lanes.step import LANES
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.cases.pool import SEED, Pool, make_pool
from rattlesweep.sweeps.forecast.footprint import Footprint, weigh
from rattlesweep.sweeps.forecast.pilot import Pilot, turns
from rattlesweep.text import align

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.sweeps.cases.plan import Plan

    Floats = NDArray[np.float64]

# Opening and closing a directory, and putting a block to rest on the disk: a pilot that writes
# nothing cannot measure them. Both were 0.05 s and 0.01 s on a local disk.
OPEN_SECONDS, REST_SECONDS = 0.05, 0.01
# Relative standard deviations of what the model leaves out, of the kernel and of the rest.
MODEL, REST = 0.06, 0.25
# Blocks whose queue is played through to see how long their last runs keep the lanes waiting.
PLAYED, PLAYED_ROWS = 8, 40_000
# Seconds from which on a sweep is worth a pilot, by nominal rates.
WORTH = 120.0
# Nanoseconds of a step of one run on one thread, a stage; and steps to a swing of the spin.
NOMINAL_STAGE, NOMINAL_STEPS = 3e-9, 0.5
# Seconds of a run that is all but integrated.
NOMINAL_ROW = 5e-6
BOUND = 1.96


@dataclass(frozen=True)
class Forecast:
    """What a sweep is expected to take.

    Attributes
    ----------
    runs, cases, blocks, block_rows, threads : int
    units, units_most : float
        Time integrated, in ``sqrt(a/g)``, summed over the runs; and what it would be if every run
        went to its horizon.
    seconds, low, high : float
        Expected time, and its interval of 95 %.
    kernel_seconds, start_seconds : float
        Of these: integration, and what a process pays once.
    compile_seconds : float or None
        Time the kernel took to compile just now, which the sweep need not any more; None if it
        was compiled before.
    bytes, memory : int
        On disk, and of memory at most.
    million, billion : float
        Seconds for so many runs like these.
    shards : int or None
        Shares it is split into, each on a machine like this one.
    shard_seconds : float or None
        Time of the longest share.
    pilot_runs, pilot_cut : int
        Runs that the pilot integrated, and those of them that it could not wait for.
    pilot_threads : int
    pilot_seconds : float
    """

    runs: int
    cases: int
    blocks: int
    block_rows: int
    threads: int
    units: float
    units_most: float
    seconds: float
    low: float
    high: float
    kernel_seconds: float
    start_seconds: float
    compile_seconds: float | None
    bytes: int
    memory: int
    million: float
    billion: float
    shards: int | None
    shard_seconds: float | None
    pilot_runs: int
    pilot_cut: int
    pilot_threads: int
    pilot_seconds: float

    def as_data(self) -> dict[str, Any]:
        """As plain data for JSON, without what is not known."""
        data = {key: value for key, value in asdict(self).items() if value is not None}
        return {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in data.items()}


def forecast(
    plan: Plan, threads: int | None = None, *, budget: float = 2.0, shards: int | None = None
) -> Forecast:
    """Try out a sweep for about `budget` seconds.

    Parameters
    ----------
    plan : Plan
    threads : int, optional
        Threads of the kernel in the sweep; more than there are here are of cores like these, of
        which the pilot uses what there are.
    budget : float
        Seconds that the pilot may take, a kernel that must be compiled aside.
    shards : int, optional
        Shares of which the longest is to be forecast.

    Raises
    ------
    ConfigError
        If a body cannot be drawn.
    KeyboardInterrupt
        On Ctrl-C; the kernel is stopped first.
    """
    begin = time.perf_counter()
    threads = threads or available_threads()
    pool = make_pool(plan)
    pilot = Pilot(plan.config, pool, min(threads, available_threads()))
    pilot.load()
    compiled = pilot.compile_seconds or 0.0
    pilot.run(max(0.25 * budget, 0.85 * budget - (time.perf_counter() - begin - compiled)))
    weight = weigh(plan, pool, pilot)
    known = ~np.isnan(pilot.work)
    spent = time.perf_counter() - begin - compiled
    times = _times(plan, pool, pilot, weight, threads)
    share = _means(pilot, pool, pilot.share)
    horizon = pool.horizon.sum() * plan.samples / pool.per_case
    used = float((pool.horizon * share[:, None]).sum() / max(pool.horizon.sum(), 1e-300))
    # In a large sweep no lane waits for the last runs.
    waiting = times.kernel * (1 - 1 / times.waiting)
    each = (times.expected - times.once - waiting) / plan.runs
    longest = None
    if shards is not None:
        part = _largest_share(plan, pool, _means(pilot, pool, pilot.work / _positive(pilot.cost)),
                              shards)  # fmt: skip
        longest = times.once + part * (times.expected - times.once)
    return Forecast(
        runs=plan.runs,
        cases=len(plan.cases),
        blocks=plan.n_blocks,
        block_rows=min(plan.block_size, plan.runs),
        threads=threads,
        pilot_threads=pilot.threads,
        units=float(horizon * used),
        units_most=float(horizon),
        seconds=times.expected,
        low=times.low,
        high=times.high,
        kernel_seconds=times.kernel,
        start_seconds=times.once,
        compile_seconds=pilot.compile_seconds,
        bytes=weight.bytes_of(plan),
        memory=weight.memory_of(plan),
        million=times.once + 1e6 * each,
        billion=times.once + 1e9 * each,
        shards=shards,
        shard_seconds=longest,
        pilot_runs=int(known.sum()),
        pilot_cut=pilot.censored,
        pilot_seconds=spent,
    )


def expectation(plan: Plan, threads: int, max_time: float | None = None) -> dict[str, Any] | None:
    """What a run keeps beside what it then takes: a forecast, if it is long enough for a pilot.

    What a shorter one would take by nominal rates says nothing of this machine and is not kept.
    """
    if min(nominal_seconds(plan, threads), max_time or np.inf) <= WORTH:
        return None
    return forecast(plan, threads).as_data()


def nominal_seconds(plan: Plan, threads: int) -> float:
    """Seconds that a sweep takes by nominal rates."""
    if plan.config.model == "gh":
        return plan.runs * NOMINAL_ROW
    pool = make_pool(plan, most=16 * len(plan.cases))
    settings = plan.config.integrator
    method = METHODS[settings.method]
    cost = float(pool.cost.mean()) * plan.runs
    steps = cost * NOMINAL_STEPS if method.adaptive else cost / (settings.dt or 0.002)
    # A run ends halfway to its horizon or so.
    return steps * method.stages * NOMINAL_STAGE / 2 / threads + plan.runs * NOMINAL_ROW


@dataclass(frozen=True)
class _Times:
    expected: float
    low: float
    high: float
    kernel: float
    once: float
    waiting: float


def _times(plan: Plan, pool: Pool, pilot: Pilot, weight: Footprint, threads: int) -> _Times:
    """Put the parts together as the engine does: the kernel beside the preparing and writing."""
    cores, lanes = max(available_threads(), threads), LANES * threads
    once = pilot.load_seconds + weight.start_seconds + OPEN_SECONDS
    rows = min(plan.block_size, plan.runs)
    prepare = plan.n_blocks * pool.fixed_seconds + plan.runs * pool.row_seconds
    write = plan.n_blocks * (weight.block_seconds + REST_SECONDS) + plan.runs * weight.row_seconds
    first, last = prepare * rows / plan.runs, write * rows / plan.runs
    beside = prepare + write - first - last
    # Bodies are drawn on all cores, so the kernel stands still meanwhile; and the summary reads a
    # part of what was written.
    alone = pool.draw_seconds + first + last + plan.runs * weight.row_seconds / 4
    typing = plan.runs * weight.type_seconds

    def whole(kernel: float) -> float:
        busy = max(kernel + typing, beside, (threads * kernel + typing + beside) / cores)
        return once + alone + busy

    waiting = _waiting(plan, pool, pilot, lanes)
    kernel, low, high = (waiting * part for part in _kernel_seconds(plan, pool, pilot, lanes))
    expected = whole(kernel)
    rest = BOUND * REST * (expected - kernel)
    down, up = expected - whole(low), whole(high) - expected
    return _Times(expected, max(0.0, expected - float(np.hypot(down, rest))),
                  expected + float(np.hypot(up, rest)), kernel, once, waiting)  # fmt: skip


def _kernel_seconds(plan: Plan, pool: Pool, pilot: Pilot, lanes: int) -> tuple[float, float, float]:
    """Expected seconds of integration with all lanes in use, and the interval of 95 %."""
    if not pilot.stages or not pool.cost.any():
        return 0.0, 0.0, 0.0
    rows = np.concatenate(pilot.stages)
    steps = pilot.work[rows] / pilot.cost[rows]
    total = plan.samples * float(pool.cost.mean(axis=1).sum()) * float(steps.mean())
    if pool.whole and pilot.all_known:
        total = float(np.nansum(pilot.work))
    kernel = pilot.turn * total / lanes
    # Of which samples the pool has: they are the same in all cases of a target.
    pooled = 0.0
    if not pool.whole and pool.per_case > 1:
        groups = np.array([case.group for case in plan.cases])
        sums = [pool.cost[groups == group].sum(axis=0) for group in np.unique(groups)]
        spread = sum(float(s.var(ddof=1)) for s in sums) / pool.per_case
        left = 1 - pool.per_case / plan.samples
        pooled = spread * left / float(pool.cost.mean(axis=1).sum()) ** 2
    error = np.sqrt(pilot.error() ** 2 + pilot.rate_error() ** 2 + pooled + MODEL**2)
    cut_low = float((pilot.low[rows] / pilot.cost[rows]).mean() / steps.mean())
    cut_high = float((pilot.high[rows] / pilot.cost[rows]).mean() / steps.mean())
    return (kernel, kernel * cut_low * float(np.exp(-BOUND * error)),
            kernel * cut_high * float(np.exp(BOUND * error)))  # fmt: skip


def _waiting(plan: Plan, pool: Pool, pilot: Pilot, lanes: int) -> float:
    """Turns of a block over those of one without idle lanes, from playing some blocks through."""
    if not pilot.stages or not pool.cost.any():
        return 1.0
    random = np.random.default_rng(SEED)
    known = np.concatenate(pilot.stages)
    ratio = pilot.work[known] / pilot.cost[known]
    case_of = known // pool.per_case
    order = np.argsort(case_of, kind="stable")
    known, ratio, case_of = known[order], ratio[order], case_of[order]
    rows = min(plan.block_size, plan.runs)
    count = max(1, min(PLAYED, plan.n_blocks, PLAYED_ROWS // rows))
    played = busy = 0.0
    for index in np.unique(np.linspace(0, plan.n_blocks - 1, count).astype(int)).tolist():
        case, sample = plan.runs_of(plan.block(index))
        place = sample if pool.whole else random.integers(0, pool.per_case, len(case))
        at = case * pool.per_case + place
        first, stop = np.searchsorted(case_of, case), np.searchsorted(case_of, case, side="right")
        few = stop - first < 4
        first, stop = np.where(few, 0, first), np.where(few, len(known), stop)
        guess = ratio[random.integers(first, stop)]
        work = pilot.cost[at] * guess
        if pool.whole:
            work = np.where(np.isnan(pilot.work[at]), work, pilot.work[at])
        work = work[pilot.cost[at] > 0]
        played += turns(work, pilot.cost[at][pilot.cost[at] > 0], lanes) * lanes
        busy += float(work.sum())
    return played / busy if busy > 0 else 1.0


def _positive(values: Floats) -> Floats:
    return np.where(values > 0, values, np.nan)


def _means(pilot: Pilot, pool: Pool, values: Floats) -> Floats:
    """Mean of each case over the pilot's runs; drawn towards that of all where there are few."""
    cases = len(pool.cost)
    if not pilot.stages:
        return np.ones(cases)
    rows = np.concatenate(pilot.stages)
    case = rows // pool.per_case
    sums = np.bincount(case, values[rows], cases) + 8 * float(values[rows].mean())
    means: Floats = sums / (np.bincount(case, minlength=cases) + 8)
    return means


def _largest_share(plan: Plan, pool: Pool, steps: Floats, shards: int) -> float:
    """Part of the sweep that falls to the longest share.

    Blocks are dealt by what theory expects, as :func:`rattlesweep.sweeps.cases.shards.deal`
    does, and the shares weighed by what the pilot has seen.
    """
    edges = np.minimum(np.arange(plan.n_blocks + 1) * plan.block_size, plan.runs)
    at = np.arange(len(plan.cases) + 1) * plan.samples
    expected = pool.cost.mean(axis=1)
    if not expected.any():
        expected = np.ones(len(plan.cases))

    def of_blocks(each: Floats) -> Floats:
        below = np.append(0.0, np.cumsum(each * plan.samples))
        costs: Floats = np.diff(np.interp(edges, at, below))
        return costs

    dealt, seen = of_blocks(expected), of_blocks(expected * steps)
    shares = [(0.0, place) for place in range(min(shards, plan.n_blocks))]
    totals = np.zeros(len(shares))
    for index in np.argsort(-dealt, kind="stable").tolist():
        total, place = heapq.heappop(shares)
        heapq.heappush(shares, (total + dealt[index], place))
        totals[place] += seen[index]
    return float(totals.max() / seen.sum())


def describe(forecast: Forecast) -> str:
    """A short table for people."""
    f = forecast
    finish = datetime.now() + timedelta(seconds=f.seconds)
    form = "%H:%M:%S" if f.seconds < 600 else "%H:%M" if f.seconds < 43200 else "%a %d %b %H:%M"
    threads = f"{f.threads} thread{'s' if f.threads > 1 else ''}"
    if f.threads > f.pilot_threads:
        threads += " of cores like those here"
    rows = [
        ("runs", f"{f.runs:,} in {f.cases:,} cases"),
        ("blocks", f"{f.blocks:,} of {f.block_rows:,} runs"),
        ("time", f"{_length(f.seconds)} ({_length(f.low)} to {_length(f.high)}) on {threads}"),
        ("done at", f"{finish.strftime(form)} if begun now"),
    ]
    if f.shards is not None and f.shard_seconds is not None:
        rows.append((f"{f.shards} shards", f"{_length(f.shard_seconds)} for the longest, on "
                                           "machines like this one"))  # fmt: skip
    if f.units_most > 0:
        used = f.units / f.units_most
        rows.append(("integrated", f"{f.units:.3g} units of time, {100 * used:.0f} % of the "
                                   "horizons"))  # fmt: skip
    rows += [
        ("disk", _size(f.bytes)),
        ("memory", f"{_size(f.memory)} at most"),
        ("1e6 runs", f"{_length(f.million)}; 1e9 runs {_length(f.billion)}"),
    ]
    cut = f", {f.pilot_cut} of them cut short" if f.pilot_cut else ""
    rows.append(("pilot", f"{f.pilot_runs:,} runs{cut} in {f.pilot_seconds:.1f} s"))
    if f.compile_seconds is not None:
        rows.append(("kernel", f"compiled in {f.compile_seconds:.0f} s, and kept"))
    return align(rows, "<")


def _length(seconds: float) -> str:
    """A length of time in the two units that matter."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    for unit, name, part, small in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"),
                                    (60, "min", 1, "s")):  # fmt: skip
        if whole >= unit:
            big, rest = divmod(whole, unit)
            few = rest // part
            return f"{big:,} {name} {few} {small}" if few and big < 100 else f"{big:,} {name}"
    return f"{whole} s"


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if count < 999.5 or unit == "TB":
            break
        count /= 1000
    return f"{count:.3g} {unit}"


__all__ = ["Forecast", "describe", "expectation", "forecast", "nominal_seconds"]
