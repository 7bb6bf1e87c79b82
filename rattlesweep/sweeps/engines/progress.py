"""How far a sweep is, weighted by what its runs are expected to cost."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.task import POLL
from rattlesweep.sweeps.cases.launches import prepare
from rattlesweep.sweeps.cases.pool import few_samples

if TYPE_CHECKING:
    from rattlesweep.integrate.batch import Control
    from rattlesweep.sweeps.cases.plan import Block, Plan

# Runs by which the cost of a case is judged before it is run.
PILOT = 16


@dataclass(frozen=True)
class Progress:
    """How far a sweep is.

    Attributes
    ----------
    fraction : float
        Of the expected cost, blocks found on disk included.
    runs, total : int
        Runs done, and all runs.
    elapsed : float
        Seconds since the start.
    left : float or None
        Estimated seconds left; None as long as there is nothing to judge by.
    """

    fraction: float
    runs: int
    total: int
    elapsed: float
    left: float | None


class Costs:
    """Expected costs of the blocks of a plan, in any unit."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan

    @cached_property
    def of_cases(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Expected cost of one run of each case, from a few samples spread over it."""
        plan = self._plan
        if plan.config.model == "gh":
            return np.ones(len(plan.cases))
        # The bodies of few samples are drawn at once; those of all took 35 s for 160,000.
        few, samples = few_samples(plan, PILOT if len(plan.cases) > 1 else 16 * PILOT)
        case = np.repeat(np.arange(len(plan.cases)), len(samples))
        launches = prepare(few, case, np.tile(samples, len(plan.cases)))
        # Steps go with the oscillations of the full dynamics, with the spin's of the reduced one.
        if plan.config.model == "full":
            cost = launches.t_end * launches.modes.omega_p
        else:
            cost = launches.t_end * launches.gh.n_0 * np.abs(launches.modes.K_p)
        cost = np.where(np.isfinite(cost), cost, 0.0).reshape(len(plan.cases), -1)
        mean: np.ndarray[Any, np.dtype[np.float64]] = cost.mean(axis=1)
        return mean

    def of(self, block: Block) -> float:
        """Expected cost of a block."""
        first, last = block.first // self._plan.samples, (block.stop - 1) // self._plan.samples
        cases = np.arange(first, last + 1)
        edges = np.clip(cases * self._plan.samples, block.first, block.stop)
        counts = np.diff(np.append(edges, block.stop))
        return float(self.of_cases[cases] @ counts)


class Meter:
    """Counts what is done, and says how long the rest will take.

    Parameters
    ----------
    costs : Costs
    blocks : sequence of Block
        All that are to be done, those on disk included.
    report : callable
        Called with a :class:`Progress` at each tick.
    """

    def __init__(
        self, costs: Costs, blocks: list[Block], report: Callable[[Progress], None]
    ) -> None:
        self._report = report
        self._costs = {block.index: costs.of(block) for block in blocks}
        self._rows = {block.index: block.rows for block in blocks}
        self._total = sum(self._costs.values())
        self._runs_total = sum(block.rows for block in blocks)
        self._start = time.perf_counter()
        self._done = 0.0
        self._skipped = 0.0
        self._runs = 0
        self._begun: float | None = None

    def begin(self) -> None:
        """Say that work begins now; otherwise the first sign of life says so."""
        self._begun = time.perf_counter() - self._start

    def skip(self, block: Block, rows: int | None = None) -> None:
        """Count a block found on disk, or so many of its rows."""
        rows = block.rows if rows is None else rows
        cost = self._costs[block.index] * rows / block.rows
        self._costs[block.index] -= cost
        self._rows[block.index] -= rows
        self._skipped += cost
        self._runs += rows

    def finish(self, block: Block) -> None:
        """Count a block that is done."""
        self._done += self._costs[block.index]
        self._runs += self._rows[block.index]

    def tick(self, block: Block | None = None, control: Control | None = None) -> Progress:
        """Report, with what the kernel says of the block under way."""
        done, runs = self._done, self._runs
        if block is not None and control is not None and control.total > 0:
            done += self._costs[block.index] * min(1.0, control.done / control.total)
            runs += control.runs_done
        elapsed = time.perf_counter() - self._start
        left = None
        if done > 0:
            # From the first sign of life on: compilation says nothing of what is left.
            if self._begun is None:
                self._begun = max(0.0, elapsed - POLL)
            left = (self._total - self._skipped - done) * (elapsed - self._begun) / done
        fraction = min(1.0, (done + self._skipped) / self._total) if self._total > 0 else 1.0
        progress = Progress(fraction, runs, self._runs_total, elapsed, left)
        self._report(progress)
        return progress
