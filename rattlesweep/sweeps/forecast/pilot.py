"""A short timed pilot of a sweep: what its runs cost here and now.  Nothing is written.

The cost of a sweep is not in its size: runs differ a thousandfold in length, most end before their
horizon, and the lanes of a kernel all wait for the slowest one.  So the cost is measured in
*turns*: in one turn a thread moves all its lanes by one step, whether they are in use or
not.  A turn takes the same time in small and large batches (1.13 to 1.15 us on one thread, between
20 and 99.8 % of the lanes in use), and the number of turns follows from the steps of the runs
and the order in which lanes take them.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.batch import Batch, Control, Outcome, expected_cost
from rattlesweep.integrate.lanes.build import kernel
from rattlesweep.integrate.lanes.step import LANES
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.blocks.block import finish_block, run_batch, take
from rattlesweep.sweeps.cases.pool import SEED

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.sweeps.cases.launches import Launches
    from rattlesweep.sweeps.cases.pool import Pool
    from rattlesweep.sweeps.config.schema import Config

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

FIRST_STAGE = 128
# Relative half-width of the interval at which the pilot is content.
GOOD = 0.05
# Fixed steps are this long in the pilot: their number scales, and RK4 still sees every reversal.
PILOT_DT = 0.04
# Relative standard deviation of the time of a turn on a machine that others use too.
USUAL = 0.1
# Stand-in for the time of a turn as long as none is known; cancels.
SOME_TURN = 1e-6


def turns(work: Floats, cost: Floats, lanes: int) -> float:
    """Turns until all runs are done.

    Parameters
    ----------
    work, cost : ndarray, shape (runs,)
        Steps of the runs, and the expected costs by which they are queued, dearest first.
    lanes : int
        Of all threads together.
    """
    if not len(work):
        return 0.0
    order = np.argsort(-cost, kind="stable")
    ends = [0.0] * min(lanes, len(work))
    for steps in work[order].tolist():
        heapq.heapreplace(ends, ends[0] + steps)
    return max(ends)


def systematic(cost: Floats, count: int, offset: float) -> Integers:
    """Rows in steps of equal cost: likely in proportion to it, and spread evenly over the cases."""
    edges = np.cumsum(cost)
    places = (np.arange(count) + offset) / count * edges[-1]
    last = int(np.flatnonzero(cost)[-1])
    rows: Integers = np.minimum(np.searchsorted(edges, places, side="right"), last)
    return rows


def _until(end: float) -> Callable[[Control], None]:
    def tick(control: Control) -> None:
        if time.perf_counter() > end:
            control.stop()

    return tick


@dataclass
class Pilot:
    """Integrates runs of a pool until their cost is known well enough, or the time is up.

    Attributes
    ----------
    work, share : ndarray, shape (rows of the pool,)
        Steps of each run, NaN where it was not tried, and how much of its horizon it took.
    low, high : ndarray
        Bounds of the steps: apart where the time was up before the run had ended.
    stages : list of ndarray
        Rows of each stage; one may occur in several, or more than once in one.
    rates : list of (float, float, float)
        Turns and seconds of each batch, and which part of its lanes was in use.
    """

    config: Config
    pool: Pool
    threads: int
    work: Floats = field(init=False)
    share: Floats = field(init=False)
    low: Floats = field(init=False)
    high: Floats = field(init=False)
    stages: list[Integers] = field(default_factory=list)
    rates: list[tuple[float, float, float]] = field(default_factory=list)
    censored: int = 0
    load_seconds: float = 0.0
    compile_seconds: float | None = None

    def __post_init__(self) -> None:
        """Know nothing."""
        rows = self.pool.cost.size
        self.work, self.share, self.low, self.high = (np.full(rows, np.nan) for _ in range(4))
        self._random = np.random.default_rng(SEED)
        integrator = self.config.integrator
        self._stretch = 1.0
        if not METHODS[integrator.method].adaptive:
            dt = integrator.dt or 0.002
            self._stretch = max(dt, PILOT_DT) / dt
            coarse = integrator.model_copy(update={"dt": dt * self._stretch})
            self.config = self.config.model_copy(update={"integrator": coarse})

    @property
    def cost(self) -> Floats:
        """Expected cost of each row of the pool."""
        return self.pool.cost.ravel()

    @property
    def lanes(self) -> int:
        """Lanes of all threads."""
        return LANES * self.threads

    @property
    def turn(self) -> float:
        """Seconds of a turn; from the batches in which lanes were in use, as they are in a sweep.

        Where few are, the time is that of the thread with the longest run, which on a busy machine
        may be the slower one.
        """
        done = sum(turns * used for turns, _, used in self.rates)
        spent = sum(seconds * used for _, seconds, used in self.rates)
        return spent / done if done > 0 else SOME_TURN

    def load(self) -> None:
        """Load the kernel, compile it if need be, and take it out once."""
        if self.pool.batch is None or not self.cost.any():
            return
        start = time.perf_counter()
        kernel(self.config.integrator.method, self.config.model)
        loaded = time.perf_counter() - start
        # From disk it takes a few hundredths of a second, from source ten seconds.
        if loaded > 2.0:
            self.compile_seconds, start = loaded, time.perf_counter()
        one = take(self.pool.batch, np.array([int(np.argmax(self.cost > 0))]))
        self._integrate(replace(one, t_end=np.minimum(one.t_end, 1.0)), float("inf"))
        self.load_seconds = time.perf_counter() - start

    def run(self, budget: float) -> None:
        """Integrate stage after stage, for about so many seconds."""
        if self.pool.batch is None or not self.cost.any():
            return
        end = time.perf_counter() + budget
        rows = np.flatnonzero(self.cost)
        stage = rows
        if len(rows) > FIRST_STAGE:
            stage = systematic(self.cost, FIRST_STAGE, self._random.random())
        while True:
            whole = self._try(stage, end)
            if len(self.stages) == 1 and len(rows) > FIRST_STAGE:
                self.gauge(0.15 * budget)
            if not whole or self.all_known:
                return
            error, left = 1.96 * self.error(), end - time.perf_counter()
            if error < GOOD or left < 0.1 * budget:
                return
            done = np.concatenate(self.stages)
            # The turns of so many more, should they be like those before.
            mean = float(self.work[done].mean()) / self._stretch
            most = float(np.nanmax(self.work)) / self._stretch
            able = (0.8 * left / self.turn - most) * self.lanes / mean
            wanted = len(done) * ((error / GOOD) ** 2 - 1) + FIRST_STAGE
            count = int(min(able, wanted, 2 * len(done)))
            if count < FIRST_STAGE // 2:
                return
            stage = systematic(self.cost, count, self._random.random())

    @property
    def all_known(self) -> bool:
        """Whether every run of the pool has been integrated to its end."""
        return not self.censored and not np.isnan(self.work[self.cost > 0]).any()

    def _try(self, stage: Integers, end: float) -> bool:
        """Integrate the runs of a stage that are not known yet; whether there was time to."""
        rows = np.unique(stage[np.isnan(self.work[stage])])
        if len(rows):
            assert self.pool.batch is not None
            batch = take(self.pool.batch, rows)
            outcome, seconds, control = self._integrate(batch, end)
            self._learn(rows, outcome, seconds, control)
        self.stages.append(stage[~np.isnan(self.work[stage])])
        return not self.censored

    def _integrate(self, batch: Batch, end: float) -> tuple[Outcome, float, Control]:
        task: Task[Outcome] = Task(
            lambda control: run_batch(self.config, batch, threads=self.threads, control=control)
        )
        return task.wait(_until(end)), task.seconds, task.control

    def finish(self, launches: Launches, batch: Batch, budget: float) -> Mapping[str, Any]:
        """Columns of some runs, as a block has them.

        Raises
        ------
        Interrupted
            If it takes more than so many seconds.
        """
        task: Task[Mapping[str, Any]] = Task(
            lambda control: finish_block(
                self.config, launches, batch, threads=self.threads, control=control
            )
        )
        return task.wait(_until(time.perf_counter() + budget))

    def _learn(self, rows: Integers, outcome: Outcome, seconds: float, control: Control) -> None:
        assert self.pool.batch is not None
        ended = outcome.status != Status.STOPPED
        steps = (outcome.n_steps + outcome.n_rejected).astype(float)
        known = rows[ended]
        self.share[known] = outcome.t_end[ended] / self.pool.horizon.ravel()[known]
        self.work[known] = self.low[known] = self.high[known] = steps[ended] * self._stretch
        if ended.all():
            self._rate(steps, expected_cost(take(self.pool.batch, rows)), seconds)
            return
        self._extrapolate(rows, ended, steps, seconds, control.done)

    def _rate(self, steps: Floats, cost: Floats, seconds: float) -> None:
        count = turns(steps, cost, self.lanes)
        if count > 0:
            self.rates.append((count, seconds, float(steps.sum()) / (count * self.lanes)))

    def gauge(self, seconds: float) -> None:
        """Time a turn with all lanes in use: on short pieces of runs of every kind."""
        rows = np.flatnonzero(self.cost)
        known = ~np.isnan(self.work)
        if self.pool.batch is None or not known.any():
            return
        rows = np.unique(rows[np.linspace(0, len(rows) - 1, 4 * self.lanes).astype(np.int64)])
        batch = take(self.pool.batch, rows)
        swings = expected_cost(batch)
        most = seconds / (self.turn * float(self.paces(known).mean()) * len(rows) / self.lanes)
        short = replace(batch, t_end=batch.t_end * np.minimum(1.0, most / swings))
        outcome, spent, _ = self._integrate(short, time.perf_counter() + 4 * seconds)
        if not outcome.stopped:
            steps = (outcome.n_steps + outcome.n_rejected).astype(float)
            self._rate(steps, expected_cost(short), spent)

    def _extrapolate(self, rows: Integers, ended: NDArray[np.bool_], steps: Floats,
                     seconds: float, done: float) -> None:  # fmt: skip
        """Judge the runs that were under way when the time was up.

        All that is known of them is how much of their horizons they have behind them together. They
        go on to the next end as the runs seen so far have ended: at a constant rate.
        """
        assert self.pool.batch is not None
        swings = expected_cost(take(self.pool.batch, rows))
        # Longest first, so those under way are the dearest of what is left.
        waiting = np.flatnonzero(~ended)[np.argsort(-swings[~ended], kind="stable")]
        under_way = waiting[: self.lanes]
        whole = float(swings[under_way].sum())
        past = min(0.999, max((done - swings[ended].sum()) / whole, 1e-6))
        known = ~np.isnan(self.share)
        if known.any():
            pace = float(np.mean(self.paces(known)))
        else:
            pace = len(under_way) * seconds / SOME_TURN / (past * whole)
        now = past * whole * pace
        if not self.rates:
            # Lanes were in use all the time, or at least those of the runs under way.
            lanes = min(self.lanes, len(rows))
            elapsed = max(now / len(under_way), (now + steps[ended].sum()) / lanes)
            used = (now + steps[ended].sum()) / (elapsed * self.lanes)
            self.rates.append((elapsed, seconds, min(1.0, used)))
        exposure = float(self.share[known].sum()) + past * len(under_way)
        hazard = float((self.share[known] < 1).sum()) / exposure
        rest = 1 - past
        more = -np.expm1(-hazard * rest) / hazard if hazard > 0 else rest
        full = pace * swings[under_way] * self._stretch
        at = rows[under_way]
        self.low[at], self.work[at], self.high[at] = past * full, (past + more) * full, full
        self.share[at] = past + more
        self.censored += len(at)

    # -------------------------------------------------------------- what it says

    def paces(self, rows: NDArray[np.bool_]) -> Floats:
        """Steps to a swing of the spin in the pilot, of some runs that are known."""
        assert self.pool.batch is not None
        swings = expected_cost(self.pool.batch)[rows] * self.share[rows]
        paces: Floats = self.work[rows] / self._stretch / swings
        return paces

    def error(self) -> float:
        """Relative standard error of the steps a unit of expected cost.

        From the differences of neighbours, since the runs of a stage are spread evenly over cases.
        """
        if self.pool.whole and self.all_known:
            return 0.0
        parts = [self.work[stage] / self.cost[stage] for stage in self.stages if len(stage) > 1]
        if not parts:
            return 1.0
        count = sum(len(part) for part in parts)
        squares = sum(float((np.diff(part) ** 2).sum()) for part in parts)
        variance = squares / 2 / (count - len(parts)) / count
        mean = float(np.concatenate(parts).mean())
        return float(np.sqrt(variance)) / mean

    def rate_error(self) -> float:
        """Relative standard deviation of the time of a turn from batch to batch.

        Two batches say little of it, so it is drawn towards what is usual.
        """
        used = np.array([part for *_, part in self.rates])
        each = np.array([seconds / count for count, seconds, _ in self.rates])
        if not len(each):
            return 0.0
        squares = float((used * (each / self.turn - 1) ** 2).sum())
        return float(np.sqrt((2 * USUAL**2 + squares) / (1 + used.sum())))


__all__ = ["Pilot", "systematic", "turns"]
