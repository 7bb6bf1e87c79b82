"""The cost of runs that is expected from theory, for blocks, progress and forecasts."""

from dataclasses import replace

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.config.body_sources import SdSource
from rattlesweep.design.plan import Plan, make_plan
from rattlesweep.design.prepare import prepare_launches
from rattlesweep.rows.prepared import PreparedRuns

RUNS_PER_CASE = 16  # sampled for the expected cost of a case
RUNS_ALONE = 256  # the same for the only case
_MOST_CASES = 2_000  # cases whose cost is computed; it is interpolated between them
_SEED = 20170427


def expected_cost(launches: PreparedRuns, model: str) -> Floats:
    """Return the radians of phase of runs up to the horizon, 0 without one."""
    if model == "gh":
        return np.ones(len(launches.horizon))
    rate = launches.modes.omega_p
    if model == "reduced":  # its steps follow the spin, not the oscillations
        rate = launches.gh.n_0 * np.abs(launches.modes.K_p)
    return np.nan_to_num(launches.horizon * rate, posinf=0.0, neginf=0.0)


def sample_keys(
    plan: Plan, per_case: int, cases: Integers
) -> tuple[Plan, Integers, Integers]:
    """Return the keys of some runs of cases, and a plan that is quick to prepare them.

    For bodies with a target, that is a smaller plan: bodies are drawn by chunks, and it
    has smaller chunks of the same bodies.
    """
    bodies = plan.config.bodies
    count = min(plan.samples, per_case)
    chosen = np.arange(count)  # the first of random bodies are as good as any
    if not isinstance(bodies, SdSource):
        random = np.random.default_rng(_SEED)
        some = random.choice(plan.samples, count, replace=False, shuffle=False)
        chosen = np.sort(some)
    elif bodies.target is not None:
        fewer = bodies.model_copy(update={"samples": count})
        smaller = make_plan(plan.config.model_copy(update={"bodies": fewer}))
        plan = replace(smaller, cases=plan.cases)
    return plan, np.repeat(cases, count), np.tile(chosen, len(cases))


def some_cases(count: int, most: int) -> Integers:
    """Return the numbers of all cases, or of at most `most` evenly spaced ones."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def case_costs(plan: Plan) -> Floats:
    """Return the expected cost of one run of each case, above 0."""
    count = len(plan.cases)
    if plan.config.model == "gh":
        return np.ones(count)
    cases = some_cases(count, _MOST_CASES)
    per_case = RUNS_PER_CASE if count > 1 else RUNS_ALONE
    launches = prepare_launches(*sample_keys(plan, per_case, cases))
    cost = expected_cost(launches, plan.config.model).reshape(len(cases), -1)
    # Cases with neighbouring numbers have similar launches.
    costs: Floats = np.interp(np.arange(count), cases, cost.mean(axis=1))
    costs[costs <= 0] = 1e-3 * costs.max() or 1.0
    return costs
