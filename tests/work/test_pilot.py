"""Forecasts: what is estimated from a pilot, and how it is printed."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sweeping import plan_of

from rattlesweep.design.prepare import prepare_launches
from rattlesweep.store.parquet import write_parquet
from rattlesweep.work.cost import expected_cost, sample_keys
from rattlesweep.work.forecast import forecast
from rattlesweep.work.run import integrate_plan, run_sweep

CONFIG: dict[str, Any] = {
    "bodies": {"source": "sd", "samples": 1000},
    "spin": {"n_i": [-0.1, -0.3], "omega_xy0": 0.01},
    "horizon": {"t_rgh": 5, "t": 2000},
}
GRID = {
    "source": "grid",
    "base": {"preset": "GH"},
    "axes": {
        "theta": {"linspace": [0.6, 0.9, 400]},
        "phi": {"linspace": [0.02, 0.036, 400]},
    },
}


def test_it_says_what_the_plan_takes(tmp_path):
    plan = plan_of(CONFIG)
    expected = forecast(plan, 2, seconds=0.3)
    assert (expected.runs, expected.threads, expected.decides) == (2000, 2, None)
    assert 0 <= expected.low <= expected.seconds <= expected.high
    # With the time that the command takes before it begins, on whatever machine.
    later = forecast(plan, 2, seconds=0.3, startup=1000.0)
    assert later.low > 100
    assert 1000 <= later.seconds <= later.high
    assert json.loads(json.dumps(vars(expected), allow_nan=False))["runs"] == 2000
    text = replace(
        expected, seconds=190.0, low=170.0, high=210.0, bytes=12_300_000
    ).words
    assert (
        text
        == "2,000 runs: about 3:10 with 2 threads (2:50 to 3:30, as other programs "
        "allow), up to 12.3 MB on disk"
    )
    rows = integrate_plan(plan)
    write_parquet(rows, tmp_path / "a")
    assert expected.bytes == pytest.approx((tmp_path / "a").stat().st_size, rel=0.5)
    # Runs drawn in proportion to expected cost estimate the mean of steps / cost.
    cost = expected_cost(
        prepare_launches(*sample_keys(plan, 10_000, np.arange(2))), "full"
    )
    steps = rows["n_steps"].to_numpy()
    drawn = np.random.default_rng(1).choice(len(cost), 500, p=cost / cost.sum())
    guess = (steps[drawn] / cost[drawn]).mean() * cost.mean() * plan.runs
    assert guess == pytest.approx(steps.sum(), rel=0.1)


def test_files_are_as_large_as_forecast_where_bodies_do_not_recur(tmp_path):
    # A file has few of the cases, so that each of its rows has another body.
    many = {"bodies": {"source": "sd", "samples": 60_000}, "model": "gh"}
    plan = plan_of(CONFIG | many)
    run_sweep(plan, tmp_path / "out", threads=1)
    size = sum(path.stat().st_size for path in (tmp_path / "out" / "runs").iterdir())
    assert forecast(plan, 1, seconds=0.1).bytes == pytest.approx(size, rel=0.15)


@pytest.mark.parametrize(
    "changes",
    [
        {"bodies": {"source": "sd", "samples": 10**8}, "model": "gh"},
        {"bodies": {"source": "sd", "samples": 1}},
        {
            "bodies": {"source": "sd", "samples": 200_000},
            "horizon": {"t_rgh": 5},
        },  # a heavy tail
        {"bodies": GRID | {"refine": {"levels": 4}}},
    ],
)
def test_any_plan_can_be_forecast(changes):
    expected = forecast(plan_of(CONFIG | changes), 1, seconds=0.1)
    assert np.isfinite([expected.seconds, expected.low, expected.high]).all()
    assert expected.bytes > 0
    assert (expected.decides == "bodies.refine") == ("refine" in expected.words)
