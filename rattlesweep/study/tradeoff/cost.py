"""What a setting costs: processor time on one thread for a run over a unit of time."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.physics import theory
from rattlesweep.study.tradeoff.plain import plain_rk4
from rattlesweep.study.work import Work, cut, integrate, take, with_horizon
from rattlesweep.sweeps.cases.launches import with_theory

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.study.tradeoff.settings import Scope, Setting

    Floats = NDArray[np.float64]


@dataclass
class Cost:
    """Cost of a setting.

    ``tries`` is of steps for a unit of time, told by a first call that is not timed.
    """

    call: Callable[[], tuple[float, float]]
    tries: float = 0.0
    units: float = 0.0
    seconds: float = 0.0


def measure_costs(
    work: Work, chosen: list[Setting], scope: Scope, report: Callable[[str], None]
) -> dict[Setting, Cost]:
    """Processor time of every setting: medians over rounds in which all take their turn."""
    costs = {}
    for setting in chosen:
        report(f"kernel of {setting.model}, {setting.method}")
        costs[setting] = _prepare(work, setting, scope)
    spent: dict[Setting, list[float]] = {setting: [] for setting in chosen}
    for r in range(scope.rounds):
        report(f"costs, round {r + 1} of {scope.rounds}")
        for setting, cost in costs.items():
            before = time.process_time()
            cost.call()
            spent[setting].append(time.process_time() - before)
    for setting, cost in costs.items():
        cost.seconds = statistics.median(spent[setting]) if spent[setting] else float("nan")
    return costs


def _prepare(work: Work, setting: Setting, scope: Scope) -> Cost:
    """Choose the runs by which a setting's cost is told, and call it once."""
    if setting.model == "gh":
        return Cost(lambda: _closed_form_cost(work), 0.0, 1.0)
    batch = take(work.batch(setting.model), np.flatnonzero(with_horizon(work)))
    horizon = scope.horizon
    if setting.name == "dt":
        # Steps of one size cost the same anywhere: shorter runs tell as much.
        share = 0.3 if setting.method == "plain" else 1.0
        most = share * scope.cost_stages * setting.value / setting.stages
        horizon = min(horizon, _horizon_for(batch.t_end, most))
    batch = cut(batch, horizon)

    def call() -> tuple[float, float]:
        if setting.method == "plain":
            t_r = plain_rk4(batch)
            units = float(np.where(np.isnan(t_r), batch.t_end, t_r).sum())
            return units / setting.value, units
        answer = integrate(work.config, batch, setting.model, setting.integrator, 1)
        return answer.tries, float(answer.t_end.sum())

    tries, units = call()
    return Cost(call, tries / units, units)


def _horizon_for(t_end: Floats, units: float) -> float:
    """Horizon at which these runs come to so many units of time together."""
    low, high = 0.0, float(t_end.max())
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if np.minimum(t_end, middle).sum() < units else (low, middle)
    return high


def _closed_form_cost(work: Work) -> tuple[float, float]:
    """Evaluate t_rGH of all runs from the parameters of their bodies."""
    la = work.launches
    b = la.bodies
    modes = theory.modes(b.alpha, b.beta, b.theta, b.phi, b.xi)
    with_theory(la.case, la.sample, b, la.n_i, la.omega_xy0, la.psi, modes, work.config.horizon)
    return 0.0, 1.0
