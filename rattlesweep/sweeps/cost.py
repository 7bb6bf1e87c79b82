"""What runs are expected to cost: blocks, progress and the forecast all go by it."""

from __future__ import annotations

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.sweeps.config.schema import SdSource
from rattlesweep.sweeps.launches import Launches, prepare
from rattlesweep.sweeps.plan import Plan, make_plan

FEW, MANY = 16, 256
"""Runs by which the cost of a case is judged: of each of many cases, and of a single one."""
MOST_JUDGED = 2_000  # cases that are judged one by one; of more, every so many-th
SEED = 20170427


def expected_cost(launches: Launches, model: str) -> Floats:
    """Return the expected cost of runs: radians up to the horizon, 0 where there is none.

    The steps of the full dynamics go with the oscillations, those of the reduced dynamics with the
    spin's; the closed form costs the same for all.
    """
    if model == "gh":
        return np.ones(len(launches.t_end))
    slow = model == "reduced"
    rate = launches.gh.n_0 * np.abs(launches.modes.K_p) if slow else launches.modes.omega_p
    cost = launches.t_end * rate
    return np.where(np.isfinite(cost), cost, 0.0)


def sample_keys(plan: Plan, per_case: int, cases: Integers) -> tuple[Plan, Integers, Integers]:
    """Return keys of at most so many runs of each of some cases, and a plan that is cheap to ask
    for them.

    Random bodies are all alike, so the first will do; those of a grid or a table are taken from all
    over it.
    """
    bodies, count = plan.config.bodies, min(plan.samples, per_case)
    chosen = np.arange(count)
    if not isinstance(bodies, SdSource):
        random = np.random.default_rng(SEED)
        chosen = np.sort(random.choice(plan.samples, count, replace=False, shuffle=False))
    elif bodies.target is not None:
        # Bodies come in chunks; a smaller plan has smaller ones, with the same bodies.
        fewer = bodies.model_copy(update={"samples": count})
        plan = make_plan(plan.config.model_copy(update={"bodies": fewer})).with_cases(plan.cases)
    return plan, np.repeat(cases, count), np.tile(chosen, len(cases))


def case_costs(plan: Plan) -> Floats:
    """Return the expected cost of one run of each case, above 0, from a few samples of it."""
    count = len(plan.cases)
    if plan.config.model == "gh":
        return np.ones(count)
    judged = np.unique(np.linspace(0, count - 1, min(count, MOST_JUDGED)).astype(int))
    keys = sample_keys(plan, FEW if count > 1 else MANY, judged)
    cost = expected_cost(prepare(*keys), plan.config.model)
    mean = cost.reshape(len(judged), -1).mean(axis=1)
    # Cases between judged ones are neighbours in the order of the config.
    costs: Floats = np.interp(np.arange(count), judged, mean)
    costs[costs <= 0] = 1e-3 * costs.max() or 1.0
    return costs
