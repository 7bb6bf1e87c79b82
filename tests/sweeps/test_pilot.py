"""Forecasts: what a pilot learns, and what is said of it."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sweeping import plan_of

from rattlesweep.sweeps.columns import write_parquet
from rattlesweep.sweeps.cost import case_costs, expected_cost, forecast, sample_keys
from rattlesweep.sweeps.launches import prepare
from rattlesweep.sweeps.run import integrate_plan

CONFIG: dict[str, Any] = {
    "bodies": {"source": "sd", "samples": 1000},
    "spin": {"n_i": [-0.1, -0.3], "omega_xy0": 0.01},
    "horizon": {"t_rgh": 5, "t": 2000},
}
GRID = {
    "source": "grid", "base": {"preset": "GH"},
    "axes": {"theta": {"linspace": [0.6, 0.9, 400]}, "phi": {"linspace": [0.02, 0.036, 400]}},
}  # fmt: skip


def test_it_says_what_the_plan_takes(tmp_path):
    found = forecast(plan_of(CONFIG), 2, shards=2, seconds=0.3)
    assert (found.runs, found.threads, found.decides) == (2000, 2, None)
    assert 0 <= found.low <= found.seconds <= found.high
    assert found.share == max(found.seconds / 2, found.longest) > 0
    assert json.loads(json.dumps(vars(found), allow_nan=False))["runs"] == 2000
    text = replace(found, seconds=190.0, low=170.0, high=210.0, bytes=12_300_000).words
    assert "2,000 runs: 3:10 with 2 threads (95 %: 2:50 to 3:30), up to 12.3 MB on disk" in text
    assert "a shard takes about" in text
    assert "runs: at most " in replace(found, decides="stop").words
    write_parquet(integrate_plan(plan_of(CONFIG)), tmp_path / "a")
    assert found.bytes == pytest.approx((tmp_path / "a").stat().st_size, rel=0.5)


def test_steps_are_as_many_as_runs_drawn_by_their_cost_say():
    """Without a clock: as the pilot draws them, they tell the mean of steps over cost."""
    plan = plan_of(CONFIG)
    cost = expected_cost(prepare(*sample_keys(plan, 10_000, np.arange(2))), "full")
    steps = integrate_plan(plan)["n_steps"].to_numpy()
    drawn = np.random.default_rng(1).choice(len(cost), 500, p=cost / cost.sum())
    guess = (steps[drawn] / cost[drawn]).mean() * cost.mean() * plan.runs
    assert guess == pytest.approx(steps.sum(), rel=0.1)


@pytest.mark.parametrize(
    "changes",
    [
        {"model": "gh"},
        {"bodies": {"source": "sd", "samples": 10**8}, "model": "gh"},
        {"bodies": {"source": "sd", "samples": 1}},
        {"bodies": {"source": "sd", "samples": 200_000}, "horizon": {"t_rgh": 5}},  # a heavy tail
        {"horizon": {"t": 1e-3}},
        {"bodies": GRID | {"refine": {"levels": 4}}},
    ],
)
def test_any_plan_can_be_forecast(changes):
    found = forecast(plan_of(CONFIG | changes), 1, seconds=0.1)
    assert np.isfinite([found.seconds, found.low, found.high, found.longest]).all()
    assert found.bytes > 0
    assert (found.decides == "bodies.refine") == ("refine" in found.words)


def test_some_runs_are_the_sweeps_own_and_from_all_over_a_grid():
    target = {"K_r": [0.02, 0.1], "rel_tol": 0.1}
    plan = plan_of(CONFIG, bodies={"source": "sd", "samples": 3000, "target": target})
    cheap, case, sample = sample_keys(plan, 20, np.arange(4))
    assert case.tolist() == np.repeat(np.arange(4), 20).tolist()
    theirs = plan.source.bodies(plan.targets[3], np.arange(20)).theta
    assert np.array_equal(prepare(cheap, case, sample).bodies.theta[-20:], theirs)
    theta = prepare(*sample_keys(plan_of(CONFIG, bodies=GRID), 2000, np.arange(1))).bodies.theta
    assert theta.min() < 0.605
    assert theta.max() > 0.895


def test_costs_of_many_cases_are_judged_by_some():
    few = case_costs(plan_of(CONFIG, spin={"n_i": [-0.1, -0.5], "omega_xy0": 0.01}))
    spins = np.linspace(-0.1, -0.5, 5000).tolist()
    many = case_costs(plan_of(CONFIG, spin={"n_i": spins, "omega_xy0": 0.01}))
    assert many[[0, -1]] == pytest.approx(few, rel=1e-12)
    assert np.isfinite(many).all()
