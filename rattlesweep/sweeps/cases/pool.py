"""Runs by which a sweep is judged: some samples of every case, prepared but not integrated."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.integrate.batch import Batch, expected_cost
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.blocks.block import prepare_runs
from rattlesweep.sweeps.cases.launches import Launches, prepare
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.cases.sources import CHUNK
from rattlesweep.sweeps.config.bodies import SdSource

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.sweeps.cases.plan import Plan

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

# Runs whose expected cost is worked out (4 us each), and bodies drawn for a target (160 us each).
POOL, DRAWS = 20_000, 2_000
# Chunks of bodies that the source keeps; where a target has more, each of its cases draws anew.
KEPT = 64
# Draws depend on nothing but this and the plan.
SEED = 20170427


@dataclass(frozen=True)
class Pool:
    """Runs of a sweep before integration: some samples of each case, the same for all cases.

    Attributes
    ----------
    plan : Plan
        From which bodies are drawn cheaply.
    per_case : int
        Samples of each case; row ``case * per_case + j`` is sample ``j`` of those chosen.
    whole : bool
        Whether these are all runs of the sweep.
    cost : ndarray, shape (cases, per_case)
        Expected cost to the horizon, in swings of the spin or in steps of a fixed length.
    horizon : ndarray, shape (cases, per_case)
        In ``sqrt(a/g)``; 0 where it cannot be told.
    draw_seconds, fixed_seconds, row_seconds : float
        Time to draw all bodies of the sweep that are drawn for a target; to prepare a batch,
        whatever its size, and each of its rows.
    """

    plan: Plan
    launches: Launches
    batch: Batch | None
    per_case: int
    whole: bool
    cost: Floats
    horizon: Floats
    draw_seconds: float
    fixed_seconds: float
    row_seconds: float


def few_samples(plan: Plan, most: int) -> tuple[Plan, Integers]:
    """A plan whose bodies are cheap to draw, and at most so many of its samples, for any case.

    Random bodies are all alike, so the first will do; those of a grid or a table are drawn from
    all over it.
    """
    bodies = plan.config.bodies
    count = min(plan.samples, most)
    if isinstance(bodies, SdSource):
        if bodies.target is not None:
            # Bodies come in chunks; a smaller plan has smaller ones, with the same bodies.
            small = bodies.model_copy(update={"samples": count})
            plan = make_plan(plan.config.model_copy(update={"bodies": small}))
        return plan, np.arange(count)
    if count == plan.samples:
        return plan, np.arange(count)
    chosen = np.random.default_rng(SEED).choice(plan.samples, count, replace=False, shuffle=False)
    return plan, np.sort(chosen)


def make_pool(plan: Plan, most: int = POOL) -> Pool:
    """Prepare some runs of every case, and time it."""
    bodies = plan.config.bodies
    targets = 0
    per_case = max(4, most // len(plan.cases))
    if isinstance(bodies, SdSource) and bodies.target is not None:
        targets = len(bodies.target.values)
        per_case = min(per_case, max(64, DRAWS // targets))
    small, chosen = few_samples(plan, per_case)
    count = len(chosen)
    case = np.repeat(np.arange(len(plan.cases)), count)
    sample = np.tile(chosen, len(plan.cases))
    start = time.perf_counter()
    prepare(small, case, sample)
    drawn = time.perf_counter()
    launches, batch = prepare_runs(small, case, sample)
    whole = time.perf_counter()
    prepare_runs(small, case[:1], sample[:1])
    fixed = time.perf_counter() - whole
    cost = np.zeros(len(case))
    if batch is not None:
        method = METHODS[plan.config.integrator.method]
        # A fixed step is as long for slow bodies as for fast ones.
        cost = expected_cost(batch) if method.adaptive else launches.t_end.copy()
    bad = ~(np.isfinite(launches.t_end) & (launches.t_end > 0) & np.isfinite(cost))
    cost[bad] = 0.0
    again = whole - drawn
    draw = max(0.0, (drawn - start) - again) / (targets * count) if targets else 0.0
    if targets and plan.samples > KEPT * CHUNK:
        draw *= len(plan.cases) / targets
    shape = (len(plan.cases), count)
    return Pool(
        plan=small,
        launches=launches,
        batch=batch,
        per_case=count,
        whole=count == plan.samples,
        cost=cost.reshape(shape),
        horizon=np.where(bad | (cost == 0), 0.0, launches.t_end).reshape(shape),
        draw_seconds=draw * targets * plan.samples,
        fixed_seconds=fixed,
        row_seconds=max(0.0, again - fixed) / len(case),
    )
