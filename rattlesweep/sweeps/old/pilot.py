"""A short timed pilot of a sweep: what its runs cost here and now. Nothing is written.

Runs differ a thousandfold in length and most end before their horizon. So they are drawn in
proportion to their expected cost: the mean of steps over expected cost is then the sweep's (a ratio
estimator). Time is measured in *turns*: in one turn a thread moves all its lanes by one step,
whether they are in use or not. A turn takes the same time in small and large batches (1.13 to
1.15 us on one thread, between 20 and 99.8 % of the lanes in use), and how many there are follows
from the steps of the runs and the order in which lanes take them.
"""

from __future__ import annotations

import heapq
import os
import time
from collections.abc import Mapping
from dataclasses import replace
from glob import glob
from typing import Any

import numpy as np

from rattlesweep.arrays import Floats, Integers, take
from rattlesweep.integrate.batch import Batch, Control, Outcome
from rattlesweep.integrate.batch import expected_cost as kernel_cost
from rattlesweep.integrate.defaults import DT
from rattlesweep.integrate.lanes.lane import LANES
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import columns_of, load_kernel, prepare_runs, run_batch
from rattlesweep.sweeps.error import Estimated, ladder, prices
from rattlesweep.sweeps.cost import SEED, expected_cost, some_runs
from rattlesweep.sweeps.launches import Launches, prepare
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.config.bodies import SdSource

# Runs whose expected cost is worked out (2 us each), and bodies drawn for a target (160 us each).
KNOWN, DRAWN = 20_000, 2_000
# Runs of the first draw, and of a batch that only loads the kernel, cut to this time.
FIRST, LOADING, SHORT = 128, 32, 1.0
# Fixed steps are this long in the pilot: their number scales, and RK4 still sees every reversal.
PILOT_DT = 0.04
# Seconds that a kernel takes from disk, and from which on it was compiled.
LOADED, COMPILED = 0.2, 2.0
# Rows of blocks whose queue is played through to see how long their last runs keep lanes waiting.
PLAYED_ROWS = 20_000


def turns(steps: Floats, cost: Floats, lanes: int) -> float:
    """Turns until all runs are done, taken up by free lanes, dearest first.

    `steps` are those of the runs, and `cost` what they are queued by; `lanes` those of all threads.
    """
    ends = [0.0] * max(1, min(lanes, len(steps)))
    for more in steps[np.argsort(-cost, kind="stable")].tolist():
        heapq.heapreplace(ends, ends[0] + more)
    return max(ends)


class Pilot:
    """Integrates runs of a plan, drawn by their cost, until the time is up.

    `case`, `sample`, `launches` and their `cost` (expected) are some samples of every case, the
    same for all cases: `each` of them; `whole`, if these are all runs of the sweep. `low` and
    `high` are bounds of the steps of each of these runs, apart where it was not waited for, and
    `spent` the time that it integrated; NaN where it was not tried.
    """

    def __init__(self, plan: Plan, threads: int) -> None:
        self.plan, self.threads = plan, threads
        bodies = plan.config.bodies
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
        # To draw all bodies that are drawn for a target.
        self.draw_seconds = max(0.0, first - again) * (plan.samples / self.each) * (targets > 0)
        self.cost = expected_cost(self.launches, plan.config.model)
        self.low, self.high, self.spent = np.full((3, len(self.cost)), np.nan)
        # Rows of the launches, in proportion to their cost; one may come again.
        self.drawn: Integers = np.zeros(0, dtype=np.int64)
        self.columns: Mapping[str, Any] | None = None  # of some runs
        self.cut = 0  # runs that were under way when the time was up
        self.load_seconds = 0.0
        self.compile_seconds: float | None = None
        self._turns = self._seconds = 0.0
        self._listed = False
        self._cores = np.zeros(2)
        self._random = np.random.default_rng(SEED)
        self.config, self._stretch, self._price = plan.config, 1.0, 1.0
        settings = plan.config.integrator
        if "error" in plan.config.record:
            # Time is measured in turns of the runs alone; what their companions cost is known.
            self._price = sum(prices(settings))
            others = [part for part in plan.config.record if part != "error"]
            if settings.goal is not None:
                tol = ladder(settings)[1]
                settings = settings.model_copy(update={"accuracy": None, "tol": tol})
            self.config = plan.config.model_copy(update={"record": others, "integrator": settings})
        if not METHODS[settings.method].adaptive:
            dt = settings.dt or DT
            self._stretch = max(dt, PILOT_DT) / dt
            coarse = settings.model_copy(update={"dt": dt * self._stretch})
            self.config = self.config.model_copy(update={"integrator": coarse})

    @property
    def turn(self) -> float:
        """Seconds of a turn, with its share of the companions; 0 if nothing was integrated."""
        return self._price * self._seconds / self._turns if self._turns else 0.0

    @property
    def share(self) -> float:
        """Part of the time in which the kernel's threads had a core: less than 1 if others do."""
        had, waited = self._cores
        return float(had / (had + waited)) if had > 0 else 1.0

    @property
    def all_known(self) -> bool:
        """Whether every run of the sweep has been integrated to its end."""
        return self.whole and not self.cut and not np.isnan(self.low[self.cost > 0]).any()

    def run(self, budget: float) -> None:
        """Load the kernel, and integrate for about so many seconds."""
        rows = np.flatnonzero(self.cost)
        if self.config.model == "gh" or not len(rows):
            return
        begin = time.perf_counter()
        load_kernel(self.plan.config)
        launches, batch = prepare_runs(self.small, self.case[rows[:LOADING]],
                                       self.sample[rows[:LOADING]])  # fmt: skip
        assert batch is not None
        short = np.minimum(batch.t_end, SHORT) / batch.t_end
        batch = replace(batch, t_end=short * batch.t_end, window=short * batch.window)
        self.columns = columns_of(self.config, launches, batch, self._integrate(batch)[0])
        loaded = time.perf_counter() - begin
        self.load_seconds = loaded if loaded < COMPILED else LOADED
        self.compile_seconds = None if loaded < COMPILED else loaded
        self._cores[:] = 0.0
        end, lanes, count = time.perf_counter() + budget, LANES * self.threads, FIRST
        self._listed = self.whole and len(rows) <= FIRST
        while not self.cut and not self.all_known and count >= FIRST // 2:
            self._draw(rows if self._listed else self._by_cost(count), end)
            # As many more as there is time for, should they be like those before.
            turn = self.turn / self._price
            left = 0.9 * (end - time.perf_counter()) / turn * self._stretch
            known = self.high[self.drawn]
            able = (left - float(known.max())) * lanes / float(known.mean())
            count = int(min(able, 4 * len(self.drawn), KNOWN))
        if self.plan.config.integrator.goal is not None and not self.cut:
            self._price = self._price_of_goal() or self._price

    def _price_of_goal(self) -> float | None:
        """What runs cost until they have the error that is asked for, over their plain cost."""
        rows = np.unique(self.drawn[:FIRST])
        _, batch = prepare_runs(self.small, self.case[rows], self.sample[rows])
        if batch is None:
            return None
        outcome = run_batch(self.plan.config, batch, threads=self.threads)
        assert isinstance(outcome, Estimated)
        plain = self.low[rows] / self.cost[rows]
        return float((outcome.tries / self.cost[rows]).sum() / plain.sum())

    def _by_cost(self, count: int) -> Integers:
        """Rows in steps of equal cost: likely in proportion to it, and spread over the cases."""
        edges = np.cumsum(self.cost)
        places = (np.arange(count) + self._random.random()) / count * edges[-1]
        last = int(np.flatnonzero(self.cost)[-1])
        rows: Integers = np.minimum(np.searchsorted(edges, places, side="right"), last)
        return rows

    def _integrate(self, batch: Batch, end: float = np.inf) -> tuple[Outcome, float, Control]:
        def call(control: Control) -> Outcome:
            before = _core_seconds()
            outcome = run_batch(self.config, batch, threads=self.threads, control=control)
            self._cores += np.maximum(0.0, _core_seconds() - before)
            return outcome

        def until_late(control: Control) -> None:
            if time.perf_counter() > end:
                control.stop()

        task = Task(call)
        return task.wait(until_late), task.seconds, task.control

    def _draw(self, drawn: Integers, end: float) -> None:
        """Integrate the runs of a draw that are not known yet."""
        rows = np.unique(drawn[np.isnan(self.low[drawn])])
        if len(rows):
            launches, batch = prepare_runs(self.small, self.case[rows], self.sample[rows])
            assert batch is not None
            outcome, seconds, control = self._integrate(batch, end)
            ended = outcome.status != Status.STOPPED
            if ended.any():
                parts = take(launches, ended), take(batch, ended), take(outcome, ended)
                self.columns = columns_of(self.config, *parts)
            self._learn(rows, batch, outcome, seconds, control.done)
        self.drawn = np.concatenate([self.drawn, drawn[~np.isnan(self.low[drawn])]])

    def _learn(
        self, rows: Integers, batch: Batch, outcome: Outcome, seconds: float, done: float
    ) -> None:
        """Learn the steps of the runs, or their bounds, and what a turn takes.

        Of the runs under way when the time was up, which are the dearest that are left, all that is
        known is how much of their horizons they have behind them together.
        """
        lanes = LANES * self.threads
        cost, steps = kernel_cost(batch), (outcome.n_steps + outcome.n_rejected).astype(float)
        ended, so_far, spent = outcome.status != Status.STOPPED, steps, outcome.t_end
        if not ended.all():
            gone = float((cost * spent / batch.t_end)[ended].sum())
            # Where no run has ended the value cancels.
            pace = float(steps[ended].sum()) / gone if gone > 0 else 1.0
            at = np.flatnonzero(~ended)[np.argsort(-cost[~ended], kind="stable")][:lanes]
            steps = np.where(ended, steps, np.nan)
            steps[at] = pace * cost[at]
            # Lanes move alike.
            each = pace * max(done - cost[ended].sum(), 1e-6 * cost[at].sum()) / len(at)
            so_far = np.where(ended, steps, np.minimum(each, 0.999 * steps))
            spent = np.where(ended, spent, (so_far / steps + 1) / 2 * batch.t_end)
            self.cut += len(at)
        self.low[rows], self.high[rows] = so_far * self._stretch, steps * self._stretch
        self.spent[rows] = spent
        self._turns += turns(np.nan_to_num(so_far), cost, lanes)
        self._seconds += seconds

    def steps(self, replicates: int) -> tuple[Floats, float]:
        """Steps of the whole sweep, and the time that it integrates.

        Of the steps, the first is the estimate; the others are those of samples of the runs drawn
        (bootstrap), in each of which what was cut goes on to another part of what is left of it.
        """
        if self.all_known:
            return np.full(1 + replicates, np.nansum(self.low)), float(np.nansum(self.spent))
        if not len(self.drawn):
            return np.zeros(1 + replicates), 0.0
        total, random = float(self.cost.sum()) * self.plan.samples / self.each, self._random
        cost = self.cost[self.drawn]
        weights = cost if self._listed else np.ones(len(cost))
        weights = weights / weights.sum()
        low, high, spent = (values[self.drawn] for values in (self.low, self.high, self.spent))
        paces = np.array([low, high]) / cost * weights
        means = [paces.sum() / 2]
        # Samples beyond those whose cost is known have others.
        sums = self.cost.reshape(-1, self.each).sum(axis=0) / self.cost.sum() * self.each
        for _ in range(replicates):
            part = random.random()
            mean = np.array([1 - part, part]) @ paces[:, random.integers(0, len(cost), len(cost))]
            others = 1.0 if self.whole else sums[random.integers(0, self.each, self.each)].mean()
            means.append(mean.sum() * others)
        return np.array(means) * total, float((spent / cost * weights).sum()) * total

    def waiting(self, lanes: int) -> float:
        """Turns of blocks over those without idle lanes, from playing their queues through.

        `lanes` are those of all threads of the sweep.
        """
        if not len(self.drawn):
            return 1.0
        plan, random = self.plan, np.random.default_rng(SEED)
        paces = (self.low + self.high) / 2 / np.where(self.cost > 0, self.cost, np.nan)
        count = max(1, min(plan.n_blocks, PLAYED_ROWS // min(plan.block_size, plan.runs)))
        played = busy = 0.0
        for index in np.linspace(0, plan.n_blocks - 1, count).astype(int).tolist():
            case, sample = plan.runs_of(plan.block(index))
            at = case * self.each + (sample if self.whole else sample % self.each)
            at = at[self.cost[at] > 0]
            guess = paces[random.choice(self.drawn, len(at))]
            steps = self.cost[at] * np.where(np.isnan(paces[at]), guess, paces[at])
            played += turns(steps, self.cost[at], lanes) * lanes
            busy += float(steps.sum())
        return played / busy if busy > 0 else 1.0


def _core_seconds() -> Floats:
    """Seconds for which threads beside the main one had a core, and waited for one (Linux)."""
    sums = np.zeros(2)
    main = f"/proc/self/task/{os.getpid()}/schedstat"
    for path in set(glob("/proc/self/task/*/schedstat")) - {main}:
        try:
            with open(path) as file:
                sums += np.array(file.read().split()[:2], dtype=float) / 1e9
        except (OSError, ValueError):  # the thread has just ended
            continue
    return sums
