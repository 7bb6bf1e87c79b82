"""Speed against accuracy, measured: methods, settings and models on the same runs.

The error of a reversal time is taken against two methods at a tight tolerance that agree on it. The
cost is processor time on one thread, medians of measurements that take turns; the runs are cut at a
common horizon for it, since the few longest would leave most lanes of a small batch empty, which a
sweep does not.

Single precision is no setting. The spin changes by 1e-9 and less in one step; 24 bits, good to
6e-8, lose that in rounding whatever the method.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rattlesweep.analysis.tradeoff.runs import FULL, PLAIN, Runs, Scope, Setting, Solution, draw
from rattlesweep.arrays import Flags, Floats, Places
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import Control, available_threads
from rattlesweep.integrate.task import side_by_side
from rattlesweep.physics import theory
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.launches import with_theory

Report = Callable[[str], None]
# The references agree on a time to AGREE, and on the last spin of a run without one to AGREE_N: a
# tumbling body amplifies rounding, and whether it reverses one day is not for double precision.
AGREE, AGREE_N = 1e-8, 1e-6


@dataclass(frozen=True)
class Study:
    """What was measured on the runs of a config."""

    name: str  # of the config
    rows: pd.DataFrame
    """One row a setting, with the columns of :data:`rattlesweep.analysis.tradeoff.table.SCHEMA`;
    NaN where there is nothing, infinity for the error of a run without ``t_r``."""
    facts: dict[str, Any]  # what the rows rest on


@dataclass(frozen=True)
class Reference:
    """What the runs come to by two methods at a tight tolerance."""

    solution: Solution  # of the first method
    both: Flags  # both have a reversal, and agree on its time
    neither: Flags  # neither has one, and both give the same type and last spin
    apart: Floats  # relative difference of the times of each run with a reversal in both


def measure(
    config: Config,
    base: Path | None = None,
    *,
    samples: int | None = None,
    scope: Scope = FULL,
    threads: int = 1,
    report: Report = lambda text: None,
) -> Study:
    """Measure cost and error of every setting on the runs of :func:`draw`.

    Parameters
    ----------
    threads : int
        Threads for the errors; costs are always those of one thread.
    report : callable
        Called with what is about to be done.

    Raises
    ------
    ConfigError
        No run reverses.
    """
    begin = time.perf_counter()
    runs = draw(config, base, samples=samples, least=scope.least)
    kernels = {f"{s.model} {s.method}": s for s in (*scope.references, *scope.settings)
               if s.model != "gh"}  # fmt: skip
    report(f"kernels, compiled where this machine has them not yet: {', '.join(kernels)}")

    def load(setting: Setting, _: Control) -> None:
        runs.load(setting)

    side_by_side([partial(load, setting) for setting in kernels.values()], available_threads())
    report("references")
    reference = make_reference(runs, scope.references, threads)
    if not reference.both.any():
        raise ConfigError(
            "no run of this config reverses by its horizon, so there is no error of t_r to "
            "measure; choose other spins or a longer horizon"
        )
    lived = np.minimum(reference.solution.t_end, scope.horizon)
    mean = float(lived[runs.bounded].mean())

    # Processor time of every setting: medians over rounds in which all take their turn. A first
    # call, which is not timed, counts steps and units of time.
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
    seconds = {s: statistics.median(spent[s]) / units for s, (_, units) in counts.items()}

    rows = []
    for setting, (tries, units) in counts.items():
        report(f"errors of {setting.model}, {setting.method} {setting.name} {setting.value:g}")
        index = _affordable(runs, reference, setting, tries / units, scope)
        found = runs.solve(setting, index, threads=threads)
        rows.append(
            {
                "model": setting.model,
                "method": setting.method,
                "setting": setting.name,
                "value": setting.value,
                "runs": len(index),
                "reversing": int(reference.both[index].sum()),
                "us_per_unit": 1e6 * seconds[setting],
                "us_per_run": 1e6 * seconds[setting] * mean,
                "speedup": seconds.get(PLAIN, np.nan) / seconds[setting],
                **errors(setting, found, reference, index),
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
        "units": float(reference.solution.t_end.sum()),
        "timing_horizon": scope.horizon,
        "seconds": time.perf_counter() - begin,
    }
    return Study(runs.config.name, pd.DataFrame(rows), facts)


def make_reference(runs: Runs, settings: tuple[Setting, ...], threads: int) -> Reference:
    """Integrate the runs with two methods at a tight tolerance."""
    every = np.arange(len(runs))
    one, other = (runs.solve(setting, every, threads=threads) for setting in settings)
    reversal = np.isfinite(one.t_r) & np.isfinite(other.t_r)
    apart = np.abs(one.t_r / other.t_r - 1)
    none = np.isnan(one.t_r) & np.isnan(other.t_r) & one.ok & other.ok
    none &= np.abs(one.n_end - other.n_end) <= AGREE_N * np.abs(runs.launches.n_i)
    return Reference(
        one, reversal & (apart < AGREE), none & (one.types == other.types), apart[reversal]
    )


def _timed_call(
    runs: Runs, setting: Setting, mean: float, scope: Scope
) -> Callable[[], tuple[float, float]]:
    """Return what is timed: it gives the steps tried, and the runs' units of time together."""
    batch = runs.batch(setting, runs.bounded)
    if batch is None:
        la, b = runs.launches, runs.launches.bodies

        def closed_form() -> tuple[float, float]:
            """Evaluate t_rGH of all runs from the parameters of their bodies."""
            modes = theory.modes(b.alpha, b.beta, b.theta, b.phi, b.xi)
            with_theory(la.case, la.sample, b, la.n_i, la.omega_xy0, la.psi, modes,
                        runs.config.horizon)  # fmt: skip
            return 0.0, len(runs) * mean

        return closed_form
    horizon = scope.horizon
    if setting.name == "dt":
        # Steps of one size cost the same anywhere: shorter runs tell as much.
        share = 0.03 if setting.method == "plain" else 0.1
        horizon = min(horizon, share * scope.stages * setting.value / setting.stages / len(batch))
    cut = replace(batch, t_end=np.minimum(batch.t_end, horizon))

    def call() -> tuple[float, float]:
        found = runs.solve(setting, runs.bounded, cut)
        return found.tries, float(found.t_end.sum())

    return call


def _affordable(
    runs: Runs, reference: Reference, setting: Setting, tries: float, scope: Scope
) -> Places:
    """Return runs for the errors: all that one can afford, drawn from those that are not too long.

    They depend on the config and the setting alone, not on the machine's speed. `tries` are steps
    for one unit of time.
    """
    good = runs.bounded
    if setting.model != "full":
        return good
    most = scope.stages / 5 if setting.method == "plain" else scope.stages
    price = np.maximum(reference.solution.t_end[good], 1.0) * tries * setting.stages
    if price.sum() <= most:
        return good
    # A run that is long beside the rest would be integrated alone, in one lane of many.
    order = np.random.default_rng(0).permutation(np.flatnonzero(price <= most / 200))
    kept = order[np.cumsum(price[order]) <= most]
    return np.sort(good[kept])


def errors(
    setting: Setting, found: Solution, reference: Reference, index: Places
) -> dict[str, Any]:
    """Return the columns of a row that say how well the runs `index` came out."""
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
    # Runs that say that they keep an error that was asked for.
    promised = setting.name == "accuracy"
    held = found.t_r_error[both] <= setting.value * found.t_r[both]

    def mean(values: Any) -> float:
        return float(values.mean()) if len(values) else np.nan

    return {
        "error_median": float(median),
        "error_p90": float(p90),
        "error_p99": float(p99),
        "error_max": float(finite.max()) if len(finite) else np.nan,
        "share_above_1e_6": mean(error > 1e-6),
        "missed": int((np.isnan(found.t_r) & both & found.ok).sum()),
        "false": int((np.isfinite(found.t_r) & neither).sum()),
        "kept": mean((error <= setting.value)[held]) if promised else np.nan,
        "marked": mean(~held) if promised else np.nan,
        "type_flips": mean(flips),
        "energy_drift_median": float(np.median(drift)) if len(drift) else np.nan,
        "energy_drift_max": float(drift.max()) if len(drift) else np.nan,
        "failed": int((~found.ok).sum()),
    }
