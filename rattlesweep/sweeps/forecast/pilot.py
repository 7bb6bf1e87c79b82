"""A short timed pilot of a sweep: what its runs cost here and now. Nothing is written.

Runs differ a thousandfold in length and most end before their horizon. So they are drawn in
proportion to their expected cost: the mean of steps over expected cost is then the sweep's. Time is
measured in *turns*: in one turn a thread moves all its lanes by one step, whether they are in use
or not. A turn takes the same time in small and large batches (1.13 to 1.15 us on one thread,
between 20 and 99.8 % of the lanes in use), and how many there are follows from the steps of the
runs and the order in which lanes take them.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.batch import Batch, Control, Outcome
from rattlesweep.integrate.batch import expected_cost as kernel_cost
from rattlesweep.integrate.defaults import DT
from rattlesweep.integrate.lanes.step import LANES
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.blocks.block import columns_of, load_kernel, prepare_runs, run_batch, take
from rattlesweep.sweeps.cases.costs import SEED, expected_cost, some_runs
from rattlesweep.sweeps.cases.launches import Launches, prepare
from rattlesweep.sweeps.config.bodies import SdSource

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.sweeps.cases.plan import Plan

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

# Runs whose expected cost is worked out (2 us each), and bodies drawn for a target (160 us each).
KNOWN, DRAWN = 20_000, 2_000
# Runs of the first draw, and those integrated a little way to see what they leave in a file.
FIRST, PIECES = 128, 256
# Share of the time that those may take.
SHARE = 0.03
# Nanoseconds of a step of one run on one thread, a stage of the method; steps a unit of cost.
STAGE, STEPS = 3e-9, 1.0
# Fixed steps are this long in the pilot: their number scales, and RK4 still sees every reversal.
PILOT_DT = 0.04
# Seconds that a kernel takes from disk, and from which on it was compiled.
LOADED, COMPILED = 0.2, 2.0


def turns(steps: Floats, cost: Floats, lanes: int) -> float:
    """Turns until all runs are done, taken up by free lanes, dearest first.

    Parameters
    ----------
    steps, cost : ndarray, shape (runs,)
        Steps of the runs, and the expected costs by which they are queued.
    lanes : int
        Of all threads together.
    """
    ends = [0.0] * max(1, min(lanes, len(steps)))
    for more in steps[np.argsort(-cost, kind="stable")].tolist():
        heapq.heapreplace(ends, ends[0] + more)
    return max(ends)


def nominal_seconds(plan: Plan, cost: float) -> float:
    """Seconds of one thread for runs of so much expected cost, by nominal rates."""
    settings = plan.config.integrator
    method = METHODS[settings.method]
    steps = cost * STEPS if method.adaptive else cost / (settings.dt or DT)
    return 0.0 if plan.config.model == "gh" else steps * method.stages * STAGE


@dataclass
class Pilot:
    """Integrates runs of a plan, drawn by their cost, until the time is up.

    Attributes
    ----------
    launches : Launches
        Some samples of every case, the same for all cases: `each` of them.
    cost : ndarray, shape (rows of launches,)
        Expected.
    whole : bool
        Whether these are all runs of the sweep.
    steps, low, high, spent : ndarray, shape (rows of launches,)
        Steps of a run and their bounds, which are apart where it was not waited for, and the time
        it integrated; NaN where it was not tried.
    drawn : ndarray of int64
        Rows, in proportion to their cost; one may come again.
    rates : list of (float, float, float)
        Turns and seconds of each batch, and which part of its lanes was in use.
    columns : mapping or None
        Of some runs of every kind.
    draw_seconds : float
        To draw all bodies that are drawn for a target.
    """

    plan: Plan
    threads: int
    drawn: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    rates: list[tuple[float, float, float]] = field(default_factory=list)
    columns: Mapping[str, Any] | None = None
    batch: Batch | None = None
    cut: int = 0
    load_seconds: float = 0.0
    compile_seconds: float | None = None

    def __post_init__(self) -> None:
        """Prepare runs, and time it."""
        plan, bodies = self.plan, self.plan.config.bodies
        most = max(4, KNOWN // len(plan.cases))
        targets = 0
        if isinstance(bodies, SdSource) and bodies.target is not None:
            targets = len(bodies.target.values)
            most = min(most, max(64, DRAWN // targets))
        self.small, self.case, self.sample = some_runs(plan, most)
        self.each = len(self.case) // len(plan.cases)
        self.whole = self.each == plan.samples
        times = [time.perf_counter()]
        for _ in range(2):
            self.launches: Launches = prepare(self.small, self.case, self.sample)
            times.append(time.perf_counter())
        first, again = np.diff(times)
        self.draw_seconds = max(0.0, first - again) * (plan.samples / self.each) * (targets > 0)
        self.cost = expected_cost(self.launches, plan.config.model)
        self.steps, self.low, self.high, self.spent = np.full((4, len(self.cost)), np.nan)
        self._random = np.random.default_rng(SEED)
        config, self._stretch = plan.config, 1.0
        if not METHODS[config.integrator.method].adaptive:
            dt = config.integrator.dt or DT
            self._stretch = max(dt, PILOT_DT) / dt
            coarse = config.integrator.model_copy(update={"dt": dt * self._stretch})
            config = config.model_copy(update={"integrator": coarse})
        self.config = config

    @property
    def lanes(self) -> int:
        """Lanes of all threads."""
        return LANES * self.threads

    @property
    def turn(self) -> float:
        """Seconds of a turn; batches count by the part of the lanes that was in use.

        Where few are, the time is that of the thread with the longest run, which on a busy machine
        may be the slower one.
        """
        count, seconds, used = np.transpose(self.rates)
        return float((seconds * used).sum() / (count * used).sum())

    @property
    def all_known(self) -> bool:
        """Whether every run of the sweep has been integrated to its end."""
        return self.whole and not self.cut and not np.isnan(self.steps[self.cost > 0]).any()

    def run(self, budget: float) -> None:
        """Load the kernel, and integrate for about so many seconds."""
        if self.config.model == "gh" or not self.cost.any():
            return
        begin = time.perf_counter()
        load_kernel(self.config)
        rows = np.flatnonzero(self.cost)
        _, one = prepare_runs(self.small, self.case[rows[:1]], self.sample[rows[:1]])
        assert one is not None
        self._integrate(replace(one, t_end=np.minimum(one.t_end, 1.0)), np.inf)
        loaded = time.perf_counter() - begin
        self.load_seconds = loaded if loaded < COMPILED else LOADED
        self.compile_seconds = None if loaded < COMPILED else loaded
        end = time.perf_counter() + budget
        self._try_pieces(rows[np.unique(np.linspace(0, len(rows) - 1, PIECES).astype(int))], budget)
        count = FIRST
        while not self.cut and not self.all_known and count >= FIRST // 2:
            self._draw(rows if self.whole and len(rows) <= FIRST else self._by_cost(count), end)
            # As many more as there is time for, should they be like those before.
            left = (0.9 * (end - time.perf_counter())) / self.turn * self._stretch
            known = self.steps[self.drawn]
            able = (left - float(known.max())) * self.lanes / float(known.mean())
            count = int(min(able, 4 * len(self.drawn)))

    def _by_cost(self, count: int) -> Integers:
        """Rows in steps of equal cost: likely in proportion to it, and spread over the cases."""
        edges = np.cumsum(self.cost)
        places = (np.arange(count) + self._random.random()) / count * edges[-1]
        last = int(np.flatnonzero(self.cost)[-1])
        rows: Integers = np.minimum(np.searchsorted(edges, places, side="right"), last)
        return rows

    def _integrate(self, batch: Batch, end: float) -> tuple[Outcome, float, Control]:
        def until_late(control: Control) -> None:
            if time.perf_counter() > end:
                control.stop()

        task: Task[Outcome] = Task(
            lambda control: run_batch(self.config, batch, threads=self.threads, control=control)
        )
        return task.wait(until_late), task.seconds, task.control

    def _rate(self, batch: Batch, outcome: Outcome, seconds: float, done: float) -> float:
        """Learn what a turn takes; steps to a unit of the kernel's cost, as far as runs have ended.

        Where the time was up all lanes were in use.
        """
        ended = outcome.status != Status.STOPPED
        steps = np.where(ended, outcome.n_steps + outcome.n_rejected, 0).astype(float)
        cost = kernel_cost(batch)
        gone = np.where(ended, cost * outcome.t_end / batch.t_end, 0.0).sum()
        if not ended.any():
            return 0.0
        pace = float(steps.sum() / gone)
        tried = float(steps.sum())
        if ended.all():
            count = turns(steps, cost, self.lanes)
        else:
            tried += pace * max(0.0, done - cost[ended].sum())
            count = tried / min(self.lanes, len(cost))
        if count > 0:
            self.rates.append((count, seconds, tried / (count * self.lanes)))
        return pace

    def _try_pieces(self, rows: Integers, budget: float) -> None:
        """Integrate runs of every kind, cut to what takes little of the time."""
        launches, batch = prepare_runs(self.small, self.case[rows], self.sample[rows])
        assert batch is not None
        self.batch = batch
        turn = nominal_seconds(self.plan, 1.0) * LANES / self._stretch
        most = SHARE * budget / (turn * (1 + len(rows) / self.lanes))
        part = np.minimum(1.0, most / self.cost[rows])
        short = replace(batch, t_end=part * batch.t_end, window=part * batch.window)
        outcome, seconds, control = self._integrate(short, time.perf_counter() + 0.4 * budget)
        ended = outcome.status != Status.STOPPED
        if ended.any():
            parts = take(launches, ended), take(short, ended), take(outcome, ended)
            self.columns = columns_of(self.config, *parts)
        self._rate(short, outcome, seconds, control.done)

    def _draw(self, drawn: Integers, end: float) -> None:
        """Integrate the runs of a draw that are not known yet."""
        rows = np.unique(drawn[np.isnan(self.steps[drawn])])
        if len(rows):
            _, batch = prepare_runs(self.small, self.case[rows], self.sample[rows])
            assert batch is not None
            outcome, seconds, control = self._integrate(batch, end)
            ended, steps = outcome.status != Status.STOPPED, outcome.n_steps + outcome.n_rejected
            known = rows[ended]
            self.spent[known] = outcome.t_end[ended]
            self.steps[known] = self.low[known] = self.high[known] = steps[ended] * self._stretch
            pace = self._rate(batch, outcome, seconds, control.done)
            if not ended.all():
                self._judge(rows, ended, batch, pace, seconds, control.done)
        self.drawn = np.concatenate([self.drawn, drawn[~np.isnan(self.steps[drawn])]])

    def _judge(
        self,
        rows: Integers,
        ended: NDArray[np.bool_],
        batch: Batch,
        pace: float,
        seconds: float,
        done: float,
    ) -> None:
        """Bound the steps of the runs under way when the time was up, the dearest of what is left.

        All that is known is how much of their horizons they have behind them together.
        """
        cost = kernel_cost(batch)
        waiting = np.flatnonzero(~ended)[np.argsort(-cost[~ended], kind="stable")]
        at = waiting[: self.lanes]
        past = min(0.999, max((done - cost[ended].sum()) / cost[at].sum(), 1e-6))
        if not pace:
            if not self.rates:  # its value cancels
                self.rates.append((seconds / 1e-6, seconds, 1.0))
            pace = seconds / self.turn * len(at) / (past * float(cost[at].sum()))
        high, rows = pace * cost[at] * self._stretch, rows[at]
        self.low[rows], self.steps[rows], self.high[rows] = past * high, (1 + past) / 2 * high, high
        self.spent[rows] = (1 + past) / 2 * batch.t_end[at]
        self.cut += len(at)
