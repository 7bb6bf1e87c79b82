"""Speed against accuracy, measured: methods, settings and models on the same runs.

The error of a time of reversal is taken against two methods at a tight tolerance that agree on it
(:mod:`rattlesweep.study.tradeoff.reference`).  The cost is processor time on one thread, medians of
measurements that take turns; the runs are cut at a common horizon for it, since the few longest
would leave most lanes of a small batch empty, which a sweep does not.

Single precision is no setting.  The spin changes by the slow growth of an oscillation a thousand
times smaller, by 1e-9 and less in one step: numbers of 24 bits, good to 6e-8, lose it in
rounding whatever the method.  Sums in double precision around stages in single would keep
it, yet need a second set of kernels, for a gain of two at most and at errors that looser
tolerances reach more cheaply.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from rattlesweep.errors import ConfigError
from rattlesweep.physics import theory
from rattlesweep.study.tradeoff.reference import Confirmation, Reference, confirm, make_reference
from rattlesweep.study.tradeoff.runs import Runs, Solution, draw
from rattlesweep.study.tradeoff.scalar_rk4 import scalar_rk4
from rattlesweep.study.tradeoff.settings import FULL, Scope, Setting, settings
from rattlesweep.sweeps.blocks.block import finish_block, take
from rattlesweep.sweeps.cases.launches import with_theory

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from rattlesweep.integrate.batch import Batch
    from rattlesweep.sweeps.config.schema import Config

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Study:
    """What was measured.

    Attributes
    ----------
    rows : DataFrame
        One row a setting, with the columns of :data:`rattlesweep.study.tradeoff.table.SCHEMA`;
        NaN where there is nothing, infinity for the error of a run without ``t_r``.
    runs : Runs
    reference : Reference
    confirmation : Confirmation
    horizon : float
        Where runs are cut for the cost, in ``sqrt(a/g)``.
    seconds : float
        That it took.
    """

    rows: pd.DataFrame
    runs: Runs
    reference: Reference
    confirmation: Confirmation
    horizon: float
    seconds: float

    @property
    def facts(self) -> dict[str, Any]:
        """What the rows rest on."""
        r, within = self.reference, self.confirmation.largest
        return {
            "runs": len(self.runs),
            "reversing_in_both": r.reverse_in_both,
            "compared": int(r.both.sum()),
            "dropped": r.dropped,
            "references_differ_median": float(np.median(r.apart)) if r.apart.size else None,
            "references_differ_p99": float(np.quantile(r.apart, 0.99)) if r.apart.size else None,
            "confirmed_runs": self.confirmation.runs,
            "confirmed_within": within if np.isfinite(within) else None,
            "confirmed_missed": self.confirmation.missed,
            "units": float(r.solution.t_end.sum()),
            "timing_horizon": self.horizon,
            "seconds": self.seconds,
        }


def measure(
    config: Config,
    base: Path | None = None,
    *,
    samples: int | None = None,
    scope: Scope = FULL,
    threads: int = 1,
    report: Callable[[str], None] = lambda text: None,
    chosen: list[Setting] | None = None,
) -> Study:
    """Measure cost and error of every setting on the runs of a config.

    Parameters
    ----------
    config : Config
        Its model, integrator and records play no part.
    base : Path, optional
        Where a table's relative path is looked up besides the working directory.
    samples : int, optional
        Runs of each case.
    scope : Scope
    threads : int
        Threads for the errors; costs are always those of one thread.
    report : callable
        Called with what is about to be done.
    chosen : list of Setting, optional
        Instead of :func:`settings`.

    Raises
    ------
    ConfigError
        If no run reverses.
    """
    begin = time.perf_counter()
    report("runs and references")
    runs = draw(config, base, samples=samples, least=scope.least)
    reference = make_reference(runs, threads)
    if not reference.both.any():
        raise ConfigError(
            "no run of this config reverses by its horizon, so there is no error of t_r to "
            "measure; choose other spins or a longer horizon"
        )
    report("an independent integrator on a few runs")
    confirmation = confirm(runs, reference, units=scope.confirm)
    lived = np.minimum(reference.solution.t_end, scope.horizon)
    mean = float(lived[runs.bounded].mean())
    costs = _measure_costs(runs, chosen or settings(), mean, scope, report)
    yardstick = next((c.seconds for s, c in costs.items() if s.method == "plain"), np.nan)
    rows = []
    for setting, cost in costs.items():
        report(f"errors of {setting.model}, {setting.method} {setting.name} {setting.value:g}")
        index = _affordable(runs, reference, setting, cost.tries, scope)
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
                **_errors(_solve(runs, setting, index, threads), reference, index),
            }
        )
    seconds = time.perf_counter() - begin
    return Study(pd.DataFrame(rows), runs, reference, confirmation, scope.horizon, seconds)


@dataclass(frozen=True)
class _Cost:
    """Of one run over one unit of time: steps tried, and seconds of one thread."""

    tries: float
    seconds: float


def _measure_costs(
    runs: Runs, chosen: list[Setting], mean: float, scope: Scope, report: Callable[[str], None]
) -> dict[Setting, _Cost]:
    """Processor time of every setting: medians over rounds in which all take their turn.

    A first call, which is not timed, compiles the kernel and counts steps and units of time.
    """
    calls, counts = {}, {}
    for setting in chosen:
        report(f"kernel of {setting.model}, {setting.method}")
        calls[setting] = _timed_call(runs, setting, mean, scope)
        counts[setting] = calls[setting]()
    spent: dict[Setting, list[float]] = {setting: [] for setting in chosen}
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
    if setting.model == "gh":
        return lambda: _closed_form(runs, mean)
    batch = take(runs.batches[setting.model], np.flatnonzero(runs.bounded))
    horizon = scope.horizon
    if setting.name == "dt":
        # Steps of one size cost the same anywhere: shorter runs tell as much.
        share = 0.3 if setting.method == "plain" else 1.0
        most = share * scope.cost_stages * setting.value / setting.stages
        horizon = min(horizon, _horizon_for(batch.t_end, most))
    batch = replace(batch, t_end=np.minimum(batch.t_end, horizon))

    def call() -> tuple[float, float]:
        found = _integrate(runs, setting, batch, 1)
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
    low, high = 0.0, float(t_end.max())
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if np.minimum(t_end, middle).sum() < units else (low, middle)
    return high


def _affordable(
    runs: Runs, reference: Reference, setting: Setting, tries: float, scope: Scope
) -> NDArray[np.intp]:
    """Runs for the errors: all that one can afford, drawn from those that are not too long.

    It depends on the config and the setting alone, not on the machine's speed.
    """
    good = np.flatnonzero(runs.bounded)
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


def _solve(runs: Runs, setting: Setting, index: NDArray[np.intp], threads: int) -> Solution:
    """Some of the runs by a setting."""
    if setting.model != "gh":
        return _integrate(runs, setting, take(runs.batches[setting.model], index), threads)
    chosen = runs.config.model_copy(update={"model": "gh"})
    columns = finish_block(chosen, take(runs.launches, index), None)
    return Solution(
        t_r=columns["t_r"],
        t_end=columns["t_end"],
        types=columns["type"][0],
        ok=np.ones(len(index), dtype=bool),
        n_end=columns["n_end"],
        drift=np.full(len(index), np.nan),
        tries=0.0,
    )


def _integrate(runs: Runs, setting: Setting, batch: Batch, threads: int) -> Solution:
    if setting.method != "plain":
        return runs.integrate(batch, setting.model, setting.integrator, threads)
    t_r, nothing = scalar_rk4(batch), np.full(len(batch), np.nan)
    t_end = np.where(np.isnan(t_r), batch.t_end, t_r)
    # It sees no oscillation, and so knows no types.
    types, ok = np.full(len(batch), -2), np.ones(len(batch), dtype=bool)
    return Solution(t_r, t_end, types, ok, nothing, nothing, float(t_end.sum()) / setting.value)


def _errors(found: Solution, reference: Reference, index: NDArray[np.intp]) -> dict[str, Any]:
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
