"""Speed against accuracy, measured: methods, settings and models on the same runs.

The error of a time of reversal is taken against two methods at a tight tolerance that agree on it
(:mod:`rattlesweep.analysis.tradeoff.reference`).  The cost is processor time on one thread, medians of
measurements that take turns; the runs are cut at a common horizon for it, since the few longest
would leave most lanes of a small batch empty, which a sweep does not.

Single precision is no setting.  The spin changes by 1e-9 and less in one step; 24 bits, good to
6e-8, lose that in rounding whatever the method.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from rattlesweep.arrays import Floats, Places
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import Control, available_threads
from rattlesweep.integrate.task import side_by_side
from rattlesweep.physics import theory
from rattlesweep.analysis.tradeoff.reference import Reference, confirm, make_reference
from rattlesweep.analysis.tradeoff.runs import Runs, Solution, draw
from rattlesweep.analysis.tradeoff.settings import FULL, PLAIN, Scope, Setting
from rattlesweep.sweeps.launches import with_theory
from rattlesweep.sweeps.config.schema import Config

Report = Callable[[str], None]


@dataclass(frozen=True)
class Study:
    """What was measured on the runs of a config."""

    name: str  # of the config
    rows: pd.DataFrame
    """One row a setting, with the columns of :data:`rattlesweep.analysis.tradeoff.table.SCHEMA`; NaN
    where there is nothing, infinity for the error of a run without ``t_r``."""
    facts: dict[str, Any]  # what the rows rest on


def measure(
    config: Config,
    base: Path | None = None,
    *,
    samples: int | None = None,
    scope: Scope = FULL,
    threads: int = 1,
    report: Report = lambda text: None,
) -> Study:
    """Measure cost and error of every setting on the runs of :func:`draw`; one must reverse.

    ``threads`` are for the errors; costs are always those of one thread.  ``report`` is called with
    what is about to be done.
    """
    begin = time.perf_counter()
    runs = draw(config, base, samples=samples, least=scope.least)
    _load_kernels(runs, [*scope.references, *scope.settings], report)
    report("references")
    reference = make_reference(runs, scope.references, threads)
    if not reference.both.any():
        raise ConfigError(
            "no run of this config reverses by its horizon, so there is no error of t_r to "
            "measure; choose other spins or a longer horizon"
        )
    report("an independent integrator on a few runs")
    confirmed = confirm(runs, reference, units=scope.confirm)
    lived = np.minimum(reference.solution.t_end, scope.horizon)
    mean = float(lived[runs.bounded].mean())
    costs = _measure_costs(runs, mean, scope, report)
    yardstick = costs[PLAIN].seconds if PLAIN in costs else np.nan
    rows = []
    for setting, cost in costs.items():
        report(f"errors of {setting.model}, {setting.method} {setting.name} {setting.value:g}")
        index = _affordable(runs, reference, setting, cost.tries, scope)
        found = runs.solve(setting, index, threads=threads)
        rows.append(
            {
                "model": setting.model,
                "method": setting.method,
                "setting": setting.name,
                "value": setting.value,
                "runs": len(index),
                "reversing": int(reference.both[index].sum()),
                "us_per_unit": 1e6 * cost.seconds,
                "us_per_run": 1e6 * cost.seconds * mean,
                "speedup": yardstick / cost.seconds,
                **_errors(found, reference, index),
                **promise_kept(setting, found, reference, index),
            }
        )
    apart = reference.apart
    facts = {
        "runs": len(runs),
        "reversing_in_both": len(apart),
        "compared": int(reference.both.sum()),
        "dropped": int((~reference.both & ~reference.neither).sum()),
        "references_differ_median": float(np.median(apart)),
        "references_differ_p99": float(np.quantile(apart, 0.99)),
        **confirmed,
        "units": float(reference.solution.t_end.sum()),
        "timing_horizon": scope.horizon,
        "seconds": time.perf_counter() - begin,
    }
    return Study(runs.config.name, pd.DataFrame(rows), facts)


def _load_kernels(runs: Runs, settings: Iterable[Setting], report: Report) -> None:
    """Load the kernels, and compile side by side those that this machine has not yet."""
    kernels = {f"{s.model} {s.method}": s for s in settings if s.model != "gh"}
    report(f"kernels, compiled where this machine has them not yet: {', '.join(kernels)}")

    def load(setting: Setting, _: Control) -> None:
        runs.load(setting)

    side_by_side([partial(load, setting) for setting in kernels.values()], available_threads())


class _Cost(NamedTuple):
    """Of one run over one unit of time: steps tried, and seconds of one thread."""

    tries: float
    seconds: float


def _measure_costs(runs: Runs, mean: float, scope: Scope, report: Report) -> dict[Setting, _Cost]:
    """Processor time of every setting: medians over rounds in which all take their turn.

    A first call, which is not timed, counts steps and units of time.
    """
    report("steps of every setting")
    calls = {setting: _timed_call(runs, setting, mean, scope) for setting in scope.settings}
    counts = {setting: call() for setting, call in calls.items()}
    spent: dict[Setting, list[float]] = {setting: [] for setting in calls}
    for r in range(scope.rounds):
        report(f"costs, round {r + 1} of {scope.rounds}")
        for setting, call in calls.items():
            before = time.process_time()
            call()
            spent[setting].append(time.process_time() - before)
    return {
        setting: _Cost(tries / units, statistics.median(spent[setting]) / units)
        for setting, (tries, units) in counts.items()
    }


def _timed_call(
    runs: Runs, setting: Setting, mean: float, scope: Scope
) -> Callable[[], tuple[float, float]]:
    """What is timed: it gives the steps tried, and the runs' units of time together."""
    batch = runs.batch(setting, runs.bounded)
    if batch is None:
        return lambda: _closed_form(runs, mean)
    horizon = scope.horizon
    if setting.name == "dt":
        # Steps of one size cost the same anywhere: shorter runs tell as much.
        share = 0.3 if setting.method == "plain" else 1.0
        most = share * scope.cost_stages * setting.value / setting.stages
        horizon = min(horizon, _horizon_for(batch.t_end, most))
    cut = replace(batch, t_end=np.minimum(batch.t_end, horizon))

    def call() -> tuple[float, float]:
        found = runs.solve(setting, runs.bounded, cut)
        return found.tries, float(found.t_end.sum())

    return call


def _closed_form(runs: Runs, mean: float) -> tuple[float, float]:
    """Evaluate t_rGH of all runs from the parameters of their bodies."""
    la, b = runs.launches, runs.launches.bodies
    modes = theory.modes(b.alpha, b.beta, b.theta, b.phi, b.xi)
    with_theory(la.case, la.sample, b, la.n_i, la.omega_xy0, la.psi, modes, runs.config.horizon)
    return 0.0, len(runs) * mean


def _horizon_for(t_end: Floats, units: float) -> float:
    """Horizon at which these runs come to so many units of time together."""
    ends = np.sort(t_end)
    longer = np.arange(len(ends))[::-1]
    return float(np.interp(units, [0, *(np.cumsum(ends) + longer * ends)], [0, *ends]))


def _affordable(
    runs: Runs, reference: Reference, setting: Setting, tries: float, scope: Scope
) -> Places:
    """Runs for the errors: all that one can afford, drawn from those that are not too long.

    It depends on the config and the setting alone, not on the machine's speed.
    """
    good = runs.bounded
    if setting.model != "full":
        return good
    most = scope.scalar_stages if setting.method == "plain" else scope.stages
    price = np.maximum(reference.solution.t_end[good], 1.0) * tries * setting.stages
    if price.sum() <= most:
        return good
    # A run that is long beside the rest would be integrated alone, in one lane of many.
    order = np.random.default_rng(0).permutation(np.flatnonzero(price <= most / 200))
    kept = order[np.cumsum(price[order]) <= most]
    return np.sort(good[kept])


def promise_kept(
    setting: Setting, found: Solution, reference: Reference, index: Places
) -> dict[str, float]:
    """How far an error that was asked for is kept."""
    if setting.name != "accuracy":
        return {"kept": np.nan, "marked": np.nan}
    both = reference.both[index]
    t_r, told = found.t_r[both], found.t_r_error[both]
    error = np.abs(t_r / reference.solution.t_r[index][both] - 1)
    held = told <= setting.value * t_r
    return {
        "kept": float((error <= setting.value)[held].mean()) if held.any() else np.nan,
        "marked": float((~held).mean()) if len(held) else np.nan,
    }


def _errors(found: Solution, reference: Reference, index: Places) -> dict[str, Any]:
    """The columns of a row that say how well the runs ``index`` came out."""
    both, neither = reference.both[index], reference.neither[index]
    error = np.abs(found.t_r / reference.solution.t_r[index] - 1)[both]
    finite = error[np.isfinite(error)]
    error = np.where(np.isfinite(error), error, np.inf)
    # No interpolation: half of infinity is no error.
    median, p90, p99 = (
        np.quantile(error, (0.5, 0.9, 0.99), method="inverted_cdf") if len(error) else [np.nan] * 3
    )
    known = (both | neither) & (found.types > -2)
    flips = found.types[known] != reference.solution.types[index][known]
    drift = found.drift[found.ok & np.isfinite(found.drift)]
    return {
        "error_median": float(median),
        "error_p90": float(p90),
        "error_p99": float(p99),
        "error_max": float(finite.max()) if len(finite) else np.nan,
        "share_above_1e_6": float((error > 1e-6).mean()) if len(error) else np.nan,
        "missed": int((np.isnan(found.t_r) & both & found.ok).sum()),
        "false": int((np.isfinite(found.t_r) & neither).sum()),
        "type_flips": float(flips.mean()) if len(flips) else np.nan,
        "energy_drift_median": float(np.median(drift)) if len(drift) else np.nan,
        "energy_drift_max": float(drift.max()) if len(drift) else np.nan,
        "failed": int((~found.ok).sum()),
    }
