"""What runs are expected to cost before they are integrated: the one model of it.

Shares of a sweep, progress, the order in which workers get blocks and the forecast all go by it.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.sweeps.launches import Launches, prepare
from rattlesweep.sweeps.plan import Block, Plan, make_plan
from rattlesweep.sweeps.config.bodies import SdSource

# Runs by which the cost of a case is judged: of each of many, and of a single one.
FEW, MANY = 16, 256
# Draws depend on nothing but this and the plan.
SEED = 20170427


def expected_cost(launches: Launches, model: str) -> Floats:
    """Expected cost of runs: radians of oscillation up to the horizon; 0 where there is none.

    Steps go with the oscillations of the full dynamics, with the spin's of the reduced one; the
    closed form takes the same for all.
    """
    if model == "gh":
        return np.ones(len(launches.t_end))
    if model == "reduced":
        cost = launches.t_end * launches.gh.n_0 * np.abs(launches.modes.K_p)
    else:
        cost = launches.t_end * launches.modes.omega_p
    return np.where(np.isfinite(cost), cost, 0.0)


def some_runs(plan: Plan, per_case: int) -> tuple[Plan, Integers, Integers]:
    """Cases and samples of at most so many runs of every case, and a plan that is cheap to ask.

    Random bodies are all alike, so the first will do; those of a grid or a table are drawn from
    all over it.
    """
    bodies = plan.config.bodies
    count = min(plan.samples, per_case)
    cases = len(plan.cases)
    chosen = np.arange(count)
    if isinstance(bodies, SdSource):
        if bodies.target is not None:
            # Bodies come in chunks; a smaller plan has smaller ones, with the same bodies.
            small = bodies.model_copy(update={"samples": count})
            plan = make_plan(plan.config.model_copy(update={"bodies": small}))
    elif count < plan.samples:
        random = np.random.default_rng(SEED)
        chosen = np.sort(random.choice(plan.samples, count, replace=False, shuffle=False))
    return plan, np.repeat(np.arange(cases), count), np.tile(chosen, cases)


class Costs:
    """Expected costs of the blocks of a plan."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan

    def following(self, plan: Plan) -> Costs:
        """Those of a plan with more stages."""
        costs = Costs(plan)
        costs.of_cases = self.of_cases
        return costs

    @cached_property
    def of_cases(self) -> Floats:
        """Expected cost of one run of each case, from a few samples spread over it."""
        cases = len(self._plan.cases)
        if self._plan.config.model == "gh":
            return np.ones(cases)
        runs = prepare(*some_runs(self._plan, FEW if cases > 1 else MANY))
        cost = expected_cost(runs, self._plan.config.model)
        mean: Floats = cost.reshape(cases, -1).mean(axis=1)
        return mean

    def of(self, block: Block) -> float:
        """Expected cost of a block."""
        if self._plan.stages:
            return float(self.of_cases[self._plan.runs_of(block)[0]].sum())
        first, last = block.first // self._plan.samples, (block.stop - 1) // self._plan.samples
        cases = np.arange(first, last + 1)
        edges = np.clip(cases * self._plan.samples, block.first, block.stop)
        counts = np.diff(np.append(edges, block.stop))
        return float(self.of_cases[cases] @ counts)
