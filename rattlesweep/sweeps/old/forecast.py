"""What a sweep will take: time, disk, memory; from a short timed pilot that writes nothing."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.defaults import DT
from rattlesweep.integrate.lanes.lane import LANES
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.cost import SEED, Costs
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.shards import deal, refuse_stages
from rattlesweep.sweeps.old.footprint import Footprint, measure
from rattlesweep.sweeps.old.pilot import Pilot
from rattlesweep.text import align

# Opening and closing a directory, and putting a block to rest on the disk: a pilot that writes
# nothing cannot measure them. Both were 0.05 s and 0.01 s on a local disk.
OPEN_SECONDS, REST_SECONDS = 0.05, 0.01
# Relative standard deviation of a machine's speed from one time to another.
SPEED = 0.15
# Nanoseconds of a step of one run on one thread, a stage of the method; and the seconds from which
# on a sweep is worth a pilot.
STAGE, WORTH = 3e-9, 120.0
# Seconds up to which the end of a sweep is told as a date: calendars end with the year 9999.
CALENDAR = 1e11
REPLICATES = 500


@dataclass(frozen=True)
class Forecast:
    """What a sweep is expected to take: times in seconds, of which `low` to `high` hold 95 %."""

    runs: int
    cases: int
    blocks: int
    block_rows: int
    threads: int
    units: float  # time integrated, in sqrt(a/g), summed over the runs
    units_most: float  # the same, if every run went to its horizon
    seconds: float
    low: float
    high: float
    kernel_seconds: float  # integration
    start_seconds: float  # paid once by a process
    compile_seconds: float | None  # the kernel, just now; None if it was compiled before
    bytes: int  # on disk
    memory: int  # bytes at most
    million: float  # seconds for so many runs like these
    billion: float
    shards: int | None  # each on a machine like this one
    shard_seconds: float | None  # of the longest
    pilot_runs: int
    pilot_cut: int  # of these, how many the pilot could not wait for
    pilot_threads: int
    pilot_seconds: float

    def as_data(self) -> dict[str, Any]:
        """As plain data for JSON, without what is not known."""
        data = {key: value for key, value in asdict(self).items() if value is not None}
        return {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in data.items()}


def forecast(
    plan: Plan, threads: int | None = None, *, budget: float = 2.0, shards: int | None = None
) -> Forecast:
    """Try out a sweep for about `budget` seconds, a kernel that must be compiled aside.

    `threads` are those of the kernel in the sweep; more than there are here are of cores like
    these, of which the pilot uses what there are. Of so many `shards` the longest is forecast too.
    """
    begin = time.perf_counter()
    if shards is not None:
        refuse_stages(plan)
    plan, threads = plan.whole, threads or available_threads()
    pilot = Pilot(plan, min(threads, available_threads()))
    pilot.run(max(0.25 * budget, 0.9 * budget - (time.perf_counter() - begin)))
    paper = measure(plan, pilot)
    spent = time.perf_counter() - begin - (pilot.compile_seconds or 0.0)
    horizon = np.where(pilot.cost > 0, pilot.launches.t_end, 0.0) * (plan.config.model != "gh")
    once = pilot.load_seconds + paper.start_seconds + OPEN_SECONDS
    steps, units = pilot.steps(REPLICATES)
    waiting = pilot.waiting(LANES * threads)
    kernel = waiting * steps * pilot.turn / (LANES * threads)
    times = once + _overlapped(plan, paper, threads, kernel) + pilot.draw_seconds
    # The machine may be as fast again as the others who use it now let it be, or slower.
    speed = np.hypot(SPEED, np.log(pilot.share) / 2)
    random = np.random.default_rng(SEED)
    busier = np.exp(speed * random.standard_normal(REPLICATES))
    low, high = np.quantile(times[1:] * busier, [0.025, 0.975]).tolist()
    seconds = float(times[0])
    # In a large sweep no lane waits for the last runs.
    each = (seconds - once - float(kernel[0]) * (1 - 1 / waiting)) / plan.runs
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
        units_most=float(horizon.sum()) * plan.samples / pilot.each,
        seconds=seconds,
        low=min(low, seconds),
        high=max(high, seconds),
        kernel_seconds=float(kernel[0]),
        start_seconds=once,
        compile_seconds=pilot.compile_seconds,
        bytes=paper.bytes,
        memory=paper.memory,
        million=once + 1e6 * each,
        billion=once + 1e9 * each,
        shards=shards,
        shard_seconds=longest,
        pilot_runs=int((~np.isnan(pilot.low)).sum()),
        pilot_cut=pilot.cut,
        pilot_threads=pilot.threads,
        pilot_seconds=spent,
    )


def _overlapped(plan: Plan, paper: Footprint, threads: int, kernel: Floats) -> Floats:
    """Seconds of all blocks, as the engine does them: the kernel beside preparing and writing."""
    beside = paper.prepare_seconds + paper.write_seconds + plan.n_blocks * REST_SECONDS
    # The first block is prepared, and the last one written, by itself; and the summary reads a
    # part of what was written.
    ends = beside * min(plan.block_size, plan.runs) / plan.runs
    typed, meanwhile = kernel + paper.type_seconds, beside - ends
    cores = max(available_threads(), threads)
    all_cores = (threads * kernel + paper.type_seconds + meanwhile) / cores
    seconds: Floats = np.maximum(np.maximum(typed, meanwhile), all_cores)
    return seconds + ends + paper.write_seconds / 4


def expectation(plan: Plan, threads: int, max_time: float | None = None) -> dict[str, Any] | None:
    """What a run keeps beside what it then takes: a forecast, if it is long enough for a pilot.

    What a shorter one would take by nominal rates says nothing of this machine and is not kept.
    """
    settings = plan.config.integrator
    method = METHODS[settings.method]
    if plan.config.model == "gh":
        return None
    # A run ends halfway to its horizon or so; an adaptive step is about a radian long.
    steps = float(Costs(plan).of_cases.sum()) * plan.samples / 2
    if not method.adaptive:
        steps /= settings.dt or DT
    seconds = steps * method.stages * STAGE / threads
    return forecast(plan, threads).as_data() if min(seconds, max_time or np.inf) > WORTH else None


def describe(forecast: Forecast) -> str:
    """A short table for people."""
    f = forecast
    form = "%H:%M:%S" if f.seconds < 600 else "%H:%M" if f.seconds < 43200 else "%a %d %b %H:%M"
    threads = f"{f.threads} thread{'s' if f.threads > 1 else ''}"
    if f.threads > f.pilot_threads:
        threads += " of cores like those here"
    rows = [
        ("runs", f"{f.runs:,} in {f.cases:,} cases"),
        ("blocks", f"{f.blocks:,} of {f.block_rows:,} runs"),
        ("time", f"{_length(f.seconds)} ({_length(f.low)} to {_length(f.high)}) on {threads}"),
    ]
    if f.seconds < CALENDAR:
        finish = datetime.now() + timedelta(seconds=f.seconds)
        rows.append(("done at", f"{finish.strftime(form)} if begun now"))
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
