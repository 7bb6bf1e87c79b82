"""Compute a block: from the keys of its runs to their rows."""

from __future__ import annotations

from functools import partial
from typing import TypeAlias

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Integers, spread, take
from rattlesweep.config.schema import Config
from rattlesweep.design.batches import ending_early, make_batch
from rattlesweep.design.models import model_of
from rattlesweep.design.plan import Plan
from rattlesweep.design.prepare import prepare_launches
from rattlesweep.kernel import batch as integration
from rattlesweep.kernel import recipes
from rattlesweep.kernel.method.tableau import DT, METHODS, TOL
from rattlesweep.kernel.outcome import Batch, Outcome
from rattlesweep.kernel.state.status import Status
from rattlesweep.kernel.task import Control, Task
from rattlesweep.rows.arrow import Values, build_table
from rattlesweep.rows.columns import GROUPS, SIZE_GROUP, STATE_GROUP
from rattlesweep.rows.prepared import PreparedRuns
from rattlesweep.rows.results import Results, closed_form
from rattlesweep.store.decide import Refining
from rattlesweep.work.error import integrate_estimated
from rattlesweep.work.error_fit import fit_of

Prepared: TypeAlias = tuple[PreparedRuns, Batch | None]  # no batch for the closed form


def check_computable(plan: Plan) -> None:
    """Raise a ConfigError now, before a file is written, for runs that none can do."""
    config = plan.config
    if config.refine is not None:
        Refining(plan)
    if config.model != "gh":
        model_of(config)
    if "error" in config.record:
        fit_of(config)


def load_kernel(config: Config) -> None:
    """Load the kernels that the runs of a config need."""
    if config.model == "gh":
        return
    method = config.integrator.method
    model = model_of(config).name
    recipes.threaded_kernel(method, model, config.record)
    if "error" in config.record:
        # Companions record nothing.
        recipes.threaded_kernel(method, model)


def prepare_runs(plan: Plan, case: Integers, sample: Integers) -> Prepared:
    """Return the bodies, theory and initial states of runs; this needs no kernel."""
    launches = prepare_launches(plan, case, sample)
    batch = make_batch(launches, plan.config.model)
    if batch is not None and plan.config.classify.early:
        batch = ending_early(batch, launches)
    return launches, batch


def compute(
    config: Config,
    schema: pa.Schema,
    prepared: Prepared,
    threads: int | None = None,
    control: Control | None = None,
) -> pa.Table:
    """Integrate and type prepared runs; return the rows of those that ended."""
    launches, batch = prepared
    outcome = None
    if batch is not None:
        outcome = run_batch(config, batch, threads, control)
        if outcome.stopped:
            ended = outcome.status != Status.STOPPED
            if not ended.any():
                return schema.remove_metadata().empty_table()
            launches = take(launches, ended)
            batch = take(batch, ended)
            outcome = take(outcome, ended)
    return build_table(columns_of(config, launches, batch, outcome), schema)


def start_block(plan: Plan, prepared: Prepared, threads: int | None) -> Task[pa.Table]:
    """Start to compute prepared runs in a thread of their own."""
    return Task(partial(compute, plan.config, plan.schema, prepared, threads))


def run_batch(
    config: Config,
    batch: Batch,
    threads: int | None = None,
    control: Control | None = None,
) -> Outcome:
    """Integrate the runs that have a horizon; others have the status ``no_horizon``."""
    has_horizon = np.isfinite(batch.t_end) & (batch.t_end > 0)
    if has_horizon.all():
        return _integrate(config, batch, threads, control)
    outcome = _integrate(config, take(batch, has_horizon), threads, control)
    outcome = spread(outcome, has_horizon)
    outcome.status[~has_horizon] = Status.NO_HORIZON
    outcome.t_end[~has_horizon] = 0.0
    return outcome


def _integrate(
    config: Config, batch: Batch, threads: int | None, control: Control | None
) -> Outcome:
    control = control or Control()
    if "error" in config.record:
        return integrate_estimated(config, batch, threads, control)
    settings = config.integrator
    return integration.integrate(
        batch,
        METHODS[settings.method],
        model_of(config),
        tol=settings.tol or TOL,
        dt=settings.dt or DT,
        max_steps=settings.max_steps,
        record=frozenset(config.record),
        threads=threads,
        control=control,
    )


def columns_of(
    config: Config, launches: PreparedRuns, batch: Batch | None, outcome: Outcome | None
) -> dict[str, Values]:
    """Return the columns of runs; without an outcome, by the closed form.

    Each column of :mod:`rattlesweep.rows.columns` has the function that returns it.
    """
    results = Results(config, launches, batch, outcome or closed_form(launches))
    groups = [
        group for group in GROUPS if not group.optional or group.name in config.parts
    ]
    if launches.bodies.omega is not None:
        groups.append(STATE_GROUP)
    if launches.bodies.units is not None:
        groups.append(SIZE_GROUP)
    columns: dict[str, Values] = {}
    for group in groups:
        for column in group.columns:
            columns[column.name] = column.source(results)
    return columns | launches.bodies.carried
