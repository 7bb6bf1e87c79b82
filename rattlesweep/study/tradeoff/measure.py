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

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.errors import ConfigError
from rattlesweep.study.tradeoff.cost import Cost, measure_costs
from rattlesweep.study.tradeoff.plain import plain_rk4
from rattlesweep.study.tradeoff.reference import Confirmation, Reference, confirm, make_reference
from rattlesweep.study.tradeoff.settings import (
    DEFAULT,
    FULL,
    QUICK,
    Scope,
    Setting,
    settings,
)
from rattlesweep.study.tradeoff.table import Row
from rattlesweep.study.work import Answer, Work, draw, integrate, take, with_horizon
from rattlesweep.sweeps.blocks.block import finish_block

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from rattlesweep.sweeps.config.schema import Config

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Study:
    """What was measured."""

    rows: list[Row]
    work: Work
    reference: Reference
    confirmation: Confirmation
    horizon: float
    seconds: float

    @property
    def facts(self) -> dict[str, Any]:
        """What the rows rest on."""
        r = self.reference
        return {
            "runs": len(self.work),
            "reversing_in_both": r.reverse_in_both,
            "compared": int(r.both.sum()),
            "dropped": r.dropped,
            "references_differ_median": float(np.median(r.apart)) if r.apart.size else None,
            "references_differ_p99": float(np.quantile(r.apart, 0.99)) if r.apart.size else None,
            "confirmed_runs": self.confirmation.runs,
            "confirmed_within": _number(self.confirmation.largest),
            "confirmed_missed": self.confirmation.missed,
            "units": float(r.answer.t_end.sum()),
            "timing_horizon": self.horizon,
            "seconds": self.seconds,
        }


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


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
    work = draw(config, base, samples=samples, least=scope.least)
    reference = make_reference(work, threads)
    if not reference.both.any():
        raise ConfigError(
            "no run of this config reverses by its horizon, so there is no error of t_r to "
            "measure; choose other spins or a longer horizon"
        )
    report("an independent integrator on a few runs")
    confirmation = confirm(work, reference, units=scope.confirm)
    all_ = chosen or settings()
    costs = measure_costs(work, all_, scope, report)
    yardstick = next((c.seconds / c.units for s, c in costs.items() if s.method == "plain"), np.nan)
    lived = np.minimum(reference.answer.t_end, scope.horizon)
    mean = float(lived[with_horizon(work)].mean())
    rows = []
    for setting in all_:
        report(f"errors of {setting.model}, {setting.method} {setting.name} {setting.value:g}")
        per_unit = costs[setting].seconds / costs[setting].units * 1e6
        if setting.model == "gh":
            per_unit = costs[setting].seconds / len(work) / mean * 1e6
        index = _part(work, reference, setting, costs[setting], scope)
        answer = _answer(work, setting, index, threads)
        rows.append(
            _row(setting, answer, reference, index, per_unit, per_unit * mean,
                 yardstick * 1e6 / per_unit)
        )  # fmt: skip
    return Study(rows, work, reference, confirmation, scope.horizon, time.perf_counter() - begin)


def _part(
    work: Work, reference: Reference, setting: Setting, cost: Cost, scope: Scope
) -> NDArray[np.intp]:
    """Runs for the errors: all that one can afford, drawn from those that are not too long.

    It depends on the config and the setting alone, not on the machine's speed.
    """
    good = np.flatnonzero(with_horizon(work))
    if setting.model != "full":
        return good
    most = scope.plain_stages if setting.method == "plain" else scope.stages
    price = np.maximum(reference.answer.t_end[good], 1.0) * cost.tries * setting.stages
    if price.sum() <= most:
        return good
    # A run that is long beside the rest would be integrated alone, in one lane of many.
    order = np.random.default_rng(0).permutation(np.flatnonzero(price <= most / 200))
    kept = order[np.cumsum(price[order]) <= most]
    return np.sort(good[kept])


def _answer(work: Work, setting: Setting, index: NDArray[np.intp], threads: int) -> Answer:
    if setting.model == "gh":
        chosen = work.config.model_copy(update={"model": "gh"})
        columns = finish_block(chosen, work.launches, None)
        return Answer(
            t_r=columns["t_r"][index],
            t_end=columns["t_end"][index],
            types=columns["type"][0][index],
            ok=np.ones(len(index), dtype=bool),
            n_end=columns["n_end"][index],
            drift=np.full(len(index), np.nan),
            tries=0.0,
        )
    batch = take(work.batch(setting.model), index)
    if setting.method == "plain":
        t_r = plain_rk4(batch)
        nothing = np.full(len(index), np.nan)
        # It sees no oscillation, and so knows no types.
        types = np.full(len(index), -2)
        good = np.ones(len(index), dtype=bool)
        return Answer(t_r, batch.t_end, types, good, nothing, nothing, 0.0)
    return integrate(work.config, batch, setting.model, setting.integrator, threads)


def _row(
    setting: Setting,
    answer: Answer,
    reference: Reference,
    index: NDArray[np.intp],
    per_unit: float,
    per_run: float,
    speedup: float,
) -> Row:
    both, neither = reference.both[index], reference.neither[index]
    with np.errstate(invalid="ignore"):
        error = np.abs(answer.t_r / reference.answer.t_r[index] - 1)[both]
    found = error[np.isfinite(error)]
    error = np.where(np.isfinite(error), error, np.inf)
    # No interpolation: half of infinity is no error.
    median, p90, p99 = (
        np.quantile(error, (0.5, 0.9, 0.99), method="inverted_cdf") if len(error) else [np.nan] * 3
    )
    known = (both | neither) & (answer.types > -2)
    drift = answer.drift[answer.ok & np.isfinite(answer.drift)]
    flips = answer.types[known] != reference.answer.types[index][known]
    return Row(
        model=setting.model,
        method=setting.method,
        setting=setting.name,
        value=setting.value,
        runs=len(index),
        reversing=int(both.sum()),
        us_per_unit=per_unit,
        us_per_run=per_run,
        speedup=speedup,
        error_median=float(median),
        error_p90=float(p90),
        error_p99=float(p99),
        error_max=float(found.max()) if len(found) else float("nan"),
        share_above_1e_6=float((error > 1e-6).mean()) if len(error) else float("nan"),
        missed=int((np.isnan(answer.t_r) & both & answer.ok).sum()),
        false=int((np.isfinite(answer.t_r) & neither).sum()),
        type_flips=float(flips.mean()) if len(flips) else float("nan"),
        energy_drift_median=float(np.median(drift)) if len(drift) else float("nan"),
        energy_drift_max=float(drift.max()) if len(drift) else float("nan"),
        failed=int((~answer.ok).sum()),
    )


__all__ = ["DEFAULT", "FULL", "QUICK", "Scope", "Setting", "Study", "measure", "settings"]
