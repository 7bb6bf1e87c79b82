"""What a sweep will take: time, disk, memory; from a short timed pilot that writes nothing."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.lanes.step import LANES
from rattlesweep.sweeps.cases.costs import SEED, Costs
from rattlesweep.sweeps.cases.shards import deal
from rattlesweep.sweeps.forecast.footprint import Footprint, measure
from rattlesweep.sweeps.forecast.pilot import Pilot, nominal_seconds, turns
from rattlesweep.text import align

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.sweeps.cases.plan import Plan

    Floats = NDArray[np.float64]

# Opening and closing a directory, and putting a block to rest on the disk: a pilot that writes
# nothing cannot measure them. Both were 0.05 s and 0.01 s on a local disk.
OPEN_SECONDS, REST_SECONDS = 0.05, 0.01
# Usual relative standard deviations of the time of a turn, on a machine that others use too, and
# of what is beside the kernel.
USUAL, REST = 0.15, 0.25
# Rows of blocks whose queue is played through to see how long their last runs keep lanes waiting.
PLAYED_ROWS = 20_000
# Seconds from which on a sweep is worth a pilot, by nominal rates.
WORTH = 120.0
REPLICATES = 1000


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
    pilot = Pilot(plan, min(threads, available_threads()))
    pilot.run(max(0.25 * budget, 0.9 * budget - (time.perf_counter() - begin)))
    paper = measure(plan, pilot)
    spent = time.perf_counter() - begin - (pilot.compile_seconds or 0.0)
    kernel, units, most = _kernel(plan, pilot, LANES * threads)
    once = pilot.load_seconds + paper.start_seconds + OPEN_SECONDS
    beside, waiting = _beside(plan, pilot, paper), _waiting(plan, pilot, LANES * threads)
    times = _whole(plan, paper, threads, once, waiting * kernel, beside)
    low, high = np.quantile(times[1:], [0.025, 0.975]).tolist()
    seconds = float(times[0])
    # In a large sweep no lane waits for the last runs.
    each = (seconds - once - float(kernel[0]) * (waiting - 1)) / plan.runs
    longest = None
    if shards is not None:
        costs = Costs(plan)
        shares = [sum(map(costs.of, share)) for share in deal(plan, shards, costs)]
        longest = once + (seconds - once) * max(shares) / sum(shares)
    return Forecast(
        runs=plan.runs,
        cases=len(plan.cases),
        blocks=plan.n_blocks,
        block_rows=min(plan.block_size, plan.runs),
        threads=threads,
        units=units,
        units_most=most,
        seconds=seconds,
        low=min(low, seconds),
        high=max(high, seconds),
        kernel_seconds=waiting * float(kernel[0]),
        start_seconds=once,
        compile_seconds=pilot.compile_seconds,
        bytes=paper.bytes_of(plan),
        memory=paper.memory_of(plan),
        million=once + 1e6 * each,
        billion=once + 1e9 * each,
        shards=shards,
        shard_seconds=longest,
        pilot_runs=int((~np.isnan(pilot.steps)).sum()),
        pilot_cut=pilot.cut,
        pilot_threads=pilot.threads,
        pilot_seconds=spent,
    )


def expectation(plan: Plan, threads: int, max_time: float | None = None) -> dict[str, Any] | None:
    """What a run keeps beside what it then takes: a forecast, if it is long enough for a pilot.

    What a shorter one would take by nominal rates says nothing of this machine and is not kept.
    """
    cost = float(Costs(plan).of_cases.sum()) * plan.samples
    # A run ends halfway to its horizon or so.
    seconds = nominal_seconds(plan, cost) / 2 / threads
    return forecast(plan, threads).as_data() if min(seconds, max_time or np.inf) > WORTH else None


def _kernel(plan: Plan, pilot: Pilot, lanes: int) -> tuple[Floats, float, float]:
    """Seconds of integration with all lanes in use; the time integrated, expected and at most.

    Of the seconds, the first is the estimate; the others are those of samples of the pilot's runs
    (bootstrap), with what is not known of it: of which bodies it has drawn, how long what it could
    not wait for would have gone on, and how busy the machine will be.
    """
    random = np.random.default_rng(SEED)
    scale = plan.samples / pilot.each
    horizon = np.where(pilot.cost > 0, pilot.launches.t_end, 0.0)
    most = float(horizon.sum()) * scale
    if not len(pilot.drawn):
        return np.zeros(1 + REPLICATES), 0.0, 0.0 if plan.config.model == "gh" else most
    total = float(pilot.cost.sum()) * scale
    rows, picks = pilot.drawn, np.arange(len(pilot.drawn))[None]
    weights = np.ones(len(rows))
    if pilot.all_known:
        rows = np.flatnonzero(pilot.cost)
        picks, weights = np.arange(len(rows))[None], pilot.cost[rows]
    else:
        picks = np.concatenate([picks, random.integers(0, len(rows), (REPLICATES, len(rows)))])
    part = random.random((len(picks), 1))
    part[0] = 0.5
    low, high = pilot.low[rows][picks], pilot.high[rows][picks]
    steps = (low + part * (high - low)) / pilot.cost[rows][picks]
    means = np.average(steps, axis=1, weights=weights) * total
    units = float(np.average(pilot.spent[rows] / pilot.cost[rows], weights=weights)) * total
    sums = pilot.cost.reshape(-1, pilot.each).sum(axis=0)
    drawn = 0.0 if pilot.whole else float(sums.std() / sums.mean() / np.sqrt(len(sums)))
    error = np.hypot(_busyness(pilot), drawn)
    noise = np.exp(np.append(0.0, error * random.standard_normal(REPLICATES)))
    seconds: Floats = pilot.turn * means / lanes * noise
    return seconds, units, most


def _busyness(pilot: Pilot) -> float:
    """Relative standard deviation of the time of a turn from one time to another.

    A few batches say little of it, so it is drawn towards what is usual.
    """
    used = np.array([part for *_, part in pilot.rates])
    each = np.array([seconds / count for count, seconds, _ in pilot.rates])
    squares = float((used * np.log(each / pilot.turn) ** 2).sum())
    return float(np.sqrt((2 * USUAL**2 + squares) / (1 + used.sum())))


def _waiting(plan: Plan, pilot: Pilot, lanes: int) -> float:
    """Turns of a block over those of one without idle lanes, from playing some blocks through."""
    if not len(pilot.drawn):
        return 1.0
    random = np.random.default_rng(SEED)
    pace = pilot.steps / np.where(pilot.cost > 0, pilot.cost, np.nan)
    rows = min(plan.block_size, plan.runs)
    count = max(1, min(plan.n_blocks, PLAYED_ROWS // rows))
    played = busy = 0.0
    for index in np.unique(np.linspace(0, plan.n_blocks - 1, count).astype(int)).tolist():
        case, sample = plan.runs_of(plan.block(index))
        place = sample if pilot.whole else random.integers(0, pilot.each, len(case))
        at = case * pilot.each + place
        at = at[pilot.cost[at] > 0]
        guess = pace[random.choice(pilot.drawn, len(at))]
        known = pilot.whole & ~np.isnan(pace[at])
        steps = pilot.cost[at] * np.where(known, pace[at], guess)
        played += turns(steps, pilot.cost[at], lanes) * lanes
        busy += float(steps.sum())
    return played / busy if busy > 0 else 1.0


def _beside(plan: Plan, pilot: Pilot, paper: Footprint) -> tuple[float, float]:
    """Seconds beside the kernel: while it runs, and while it stands still."""
    rows = min(plan.block_size, plan.runs)
    prepare = plan.runs * paper.prepare_seconds
    write = plan.n_blocks * (paper.block_seconds + REST_SECONDS) + plan.runs * paper.row_seconds
    ends = (prepare + write) * rows / plan.runs
    # Bodies are drawn on all cores; and the summary reads a part of what was written.
    alone = pilot.draw_seconds + ends + plan.runs * paper.row_seconds / 4
    return prepare + write - ends, alone


def _whole(plan: Plan, paper: Footprint, threads: int, once: float, kernel: Floats,
           beside: tuple[float, float]) -> Floats:  # fmt: skip
    """Put the parts together as the engine does: the kernel beside the preparing and writing."""
    cores = max(available_threads(), threads)
    random = np.random.default_rng(SEED)
    noise = np.exp(np.append(0.0, REST * random.standard_normal(REPLICATES)))
    meanwhile, alone = beside
    typing = plan.runs * paper.type_seconds
    busy = [kernel + typing, np.full_like(kernel, meanwhile),
            (threads * kernel + typing + meanwhile) / cores]  # fmt: skip
    longest = np.max(busy, axis=0)
    seconds: Floats = kernel + (once + alone + longest - kernel) * noise
    return seconds


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


__all__ = ["Forecast", "describe", "expectation", "forecast"]
