"""Compute a block: from the keys of its runs to their rows."""

from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Integers, take
from rattlesweep.integrate import batch as integration
from rattlesweep.integrate.batch import Batch, Outcome
from rattlesweep.integrate.lanes.runs import MOST_REVERSALS
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DT, METHODS, TOL
from rattlesweep.integrate.task import Control, Task
from rattlesweep.physics import steady
from rattlesweep.physics.theory import damping_rates, unsteady
from rattlesweep.sweeps.columns import build_table, ragged
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.error import Estimated, integrate_estimated
from rattlesweep.sweeps.launches import (
    Launches,
    ending_early,
    make_batch,
    model_of,
    prepare,
)
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.types import TYPES, classify, is_chaotic, sure_types

Prepared = tuple[Launches, Batch | None]  # no batch for the closed form


def load_kernel(config: Config) -> None:
    """Load the kernels that the runs of a config need."""
    if config.model == "gh":
        return
    method, model = config.integrator.method, model_of(config).name
    integration.kernel(method, model, config.record)
    if "error" in config.record:  # companions record nothing
        integration.kernel(method, model)


def prepare_runs(plan: Plan, case: Integers, sample: Integers) -> Prepared:
    """Return the bodies, theory and initial states of runs; this needs no kernel."""
    launches = prepare(plan, case, sample)
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
    """Integrate and type prepared runs; return the rows of those that ended before a
    stop.
    """
    (launches, batch), outcome = prepared, None
    if batch is not None:
        outcome = run_batch(config, batch, threads, control)
        if outcome.stopped:
            ended = outcome.status != Status.STOPPED
            if not ended.any():
                return schema.remove_metadata().empty_table()
            launches, batch = take(launches, ended), take(batch, ended)
            outcome = take(outcome, ended)
    return build_table(columns_of(config, launches, batch, outcome), schema)


def start_block(
    plan: Plan, prepared: Prepared, threads: int | None = None
) -> Task[pa.Table]:
    """Start to compute prepared runs in a thread of their own."""
    return Task(partial(compute, plan.config, plan.schema, prepared, threads))


def run_batch(
    config: Config,
    batch: Batch,
    threads: int | None = None,
    control: Control | None = None,
) -> Outcome:
    """Integrate the runs that have a horizon; the others get the status
    ``no_horizon``.
    """
    has_horizon = np.isfinite(batch.t_end) & (batch.t_end > 0)
    part = batch if has_horizon.all() else take(batch, has_horizon)
    control, settings = control or Control(), config.integrator
    if "error" in config.record:
        outcome: Outcome = integrate_estimated(config, part, threads, control)
    else:
        outcome = integration.integrate(
            part,
            METHODS[settings.method],
            model_of(config),
            tol=settings.tol or TOL,
            dt=settings.dt or DT,
            max_steps=settings.max_steps,
            record=frozenset(config.record),
            threads=threads,
            control=control,
        )
    if has_horizon.all():
        return outcome
    wide = dict(vars(outcome))
    for name, values in vars(outcome).items():
        if name != "stopped" and len(values) == len(
            part
        ):  # what is not recorded is empty
            fill = np.nan if values.dtype.kind == "f" else 0
            wide[name] = np.full(
                (len(batch), *values.shape[1:]), fill, dtype=values.dtype
            )
            wide[name][has_horizon] = values
    wide["status"][~has_horizon], wide["t_end"][~has_horizon] = Status.NO_HORIZON, 0.0
    return type(outcome)(**wide)


def columns_of(
    config: Config, launches: Launches, batch: Batch | None, outcome: Outcome | None
) -> dict[str, Any]:
    """Return the columns of runs with their types; without an outcome, by the closed
    form.
    """
    b = launches.bodies
    columns = (
        vars(b) | vars(launches.modes) | vars(launches) | {"t_rgh": launches.gh.t_rgh}
    )
    for vector, values in (("omega", b.omega), ("u", b.u)):
        if values is not None:
            columns |= {f"{vector}_{x}": values[:, k] for k, x in enumerate("xyz")}
    if batch is None or outcome is None:
        columns |= _closed_form(launches)
    else:
        columns |= _measured(config, launches, batch, outcome)
    if b.units is not None:
        columns["n_i_rpm"] = launches.n_i / b.units.time * 30 / np.pi
        columns["t_r_s"] = columns["t_r"] * b.units.time
    ok, observed = (
        columns["status"] == Status.OK,
        (columns["amp_growth"], columns["n_departure"]),
    )
    left = columns.get("energy_left")
    codes = classify(ok, columns["t_r"], *observed, config.classify, left)
    columns |= {
        "type": (codes, TYPES),
        "status": (columns["status"], [s.label for s in Status]),
    }
    if isinstance(outcome, Estimated):
        errors = outcome.amp_growth_error, outcome.n_departure_error
        sure = sure_types(
            codes, outcome.reversal_sure, observed, errors, config.classify
        )
        columns["type_sure"] = pa.array(sure, mask=codes < 0)
    return columns | b.carried


def _closed_form(launches: Launches) -> dict[str, Any]:
    finite, t_rgh = np.isfinite(launches.t_end), launches.gh.t_rgh
    reverses = finite & (t_rgh <= launches.t_end)
    t_end = np.where(reverses, t_rgh, np.where(finite, launches.t_end, 0.0))
    n_end = np.where(reverses, 0.0, launches.gh.spin(t_end))
    none = np.zeros(len(t_end), dtype=np.int32)
    # An unknown growth rules out SS: in the closed form the relevant oscillation only
    # grows.
    return {
        "t_end": t_end,
        "n_steps": none,
        "near_tangencies": none,
        "status": np.where(finite, Status.OK, Status.NO_HORIZON),
        "t_r": np.where(reverses, t_rgh, np.nan),
        "n_end": np.where(finite, n_end, np.nan),
        "energy_drift": np.where(finite, 0.0, np.nan),
        "amp_growth": np.full(len(t_end), np.nan),
        "n_departure": np.where(finite, 1 - n_end / launches.n_i, np.nan),
    }


def _measured(
    config: Config, launches: Launches, batch: Batch, outcome: Outcome
) -> dict[str, Any]:
    ok, columns = outcome.status == Status.OK, dict(vars(outcome))
    if config.classify.early:
        # A run that settles turns all of its energy into spin.
        spin = np.copysign(
            np.sqrt(2 * outcome.energy_0 / launches.bodies.gamma), launches.n_i
        )
        columns["n_end"] = np.where(
            integration.has_settled(batch, outcome), spin, columns["n_end"]
        )
    if launches.sigma is not None and launches.rolling is not None:
        b, m, sigma = launches.bodies, launches.modes, launches.sigma
        pitch, kinks = unsteady(m.K_p, launches.n_i), launches.rolling > 0
        growth = steady.growth(batch.constants[:, :6].T, launches.n_i, sigma)
        loss = np.where(pitch, *damping_rates(b.alpha, b.beta, m, sigma))
        n_growth = np.sign(launches.n_i) * 2 * loss / np.abs(launches.gh.K)
        columns["growth"] = np.where(kinks, np.nan, np.where(pitch, *growth))
        columns["n_growth"] = np.where(kinks, np.nan, n_growth)
        # The last component of the state is the work of the dissipation.
        columns["energy_left"] = 1 + outcome.y_end[:, -1] / outcome.energy_0
    if "lyapunov" in config.record:
        columns["lyapunov"], late = integration.exponents(outcome.growth)
        chaotic = pa.array(is_chaotic(late, outcome.t_end), mask=~np.isfinite(late))
        columns |= {"lyapunov_late": late, "chaotic": chaotic}
    if "reversals" in config.record:
        turns = np.where(ok, outcome.n_turns, -1)
        kept = np.minimum(turns, MOST_REVERSALS)
        columns["n_turns"] = pa.array(turns.astype(np.int32), mask=~ok)
        for k, name in enumerate(("turn_times", "spin_after_turn")):
            columns[name] = ragged(outcome.reversals[:, :, k], kept)
        if isinstance(outcome, Estimated):
            columns["reversals_sure"] = pa.array(
                outcome.turns_sure.astype(np.int32), mask=~ok
            )
            columns["reversal_times_error"] = ragged(outcome.turn_errors, kept)
    if "windows" in config.record:
        filled = np.isfinite(outcome.windows[:, :, 0]).sum(axis=1)
        columns["window_t"] = batch.window
        for k, name in enumerate(("window_amplitude", "window_n_min", "window_n_max")):
            columns[name] = ragged(outcome.windows[:, :, k], filled)
    return columns
