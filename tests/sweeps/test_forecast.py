"""What a sweep is said to take: structure, draws, bytes; times only where they cannot fail."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from refusal import assert_refused
from test_run import CONFIGS, invoke

from rattlesweep.integrate.batch import Control, most_threads
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.blocks.block import prepare_block, run_batch
from rattlesweep.sweeps.cases.costs import Costs, some_runs
from rattlesweep.sweeps.cases.launches import prepare
from rattlesweep.sweeps.cases.plan import Plan, make_plan
from rattlesweep.sweeps.cases.shards import deal
from rattlesweep.sweeps.config.load import load_config
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.forecast import footprint
from rattlesweep.sweeps.forecast import forecast as forecasting
from rattlesweep.sweeps.forecast import pilot as pilots
from rattlesweep.sweeps.forecast.forecast import Forecast, describe, expectation, forecast
from rattlesweep.sweeps.forecast.pilot import Pilot, turns

SMALL = ("bodies.samples=40", "spin.n_i=[-0.1, -0.3]", "horizon={t_rgh: 5, t: 2000}")


def plan_of(name: str, *overrides: str) -> Plan:
    return make_plan(load_config(str(CONFIGS / name), overrides))


def trial(plan: Plan, budget: float = 60.0, threads: int = 2) -> Pilot:
    pilot = Pilot(plan, threads)
    pilot.run(budget)
    return pilot


@pytest.fixture(scope="module")
def small() -> tuple[Plan, Forecast]:
    plan = plan_of("quickstart.yaml", *SMALL)
    return plan, forecast(plan, 2, budget=1.0, shards=2)


def test_it_says_what_the_plan_says(small):
    plan, f = small
    assert (f.runs, f.cases, f.blocks, f.block_rows) == (240, 6, 1, 240)
    assert f.threads == 2
    assert 0 < f.low < f.seconds < f.high
    assert 0 < f.kernel_seconds < f.seconds
    assert 0 < f.units <= f.units_most
    assert f.million < f.billion
    assert 0 < f.pilot_runs <= plan.runs


def test_as_data_is_json_and_comes_back(small):
    _, f = small
    data = json.loads(json.dumps(f.as_data(), allow_nan=False))
    assert data["seconds"] == pytest.approx(f.seconds, rel=1e-3)
    assert data["low"] < data["seconds"] < data["high"]
    assert isinstance(data["bytes"], int)
    assert "compile_seconds" not in replace(f, compile_seconds=None).as_data()


def test_a_table_for_people(small):
    _, f = small
    text = describe(replace(f, seconds=190.0, low=170.0, high=210.0, pilot_cut=3))
    assert "3 min 10 s (2 min 50 s to 3 min 30 s) on 2 threads" in text
    assert "240 in 6 cases" in text
    assert "3 of them cut short" in text
    assert len({line.index("  ") for line in text.splitlines() if line.startswith("blocks")}) == 1
    assert "done at" not in describe(replace(f, seconds=1e15, low=1e14, high=1e16))
    long = describe(replace(f, seconds=9.6e5))
    assert "11 d 2 h" in long


def test_some_runs_of_a_large_sweep_are_the_first_and_the_sweeps_own():
    plan = plan_of("quickstart.yaml", "bodies.samples=3000")
    cheap, case, sample = some_runs(plan, 20)
    assert (case.tolist(), sample.tolist()) == (
        np.repeat(np.arange(len(plan.cases)), 20).tolist(), [*range(20)] * len(plan.cases)
    )  # fmt: skip
    theta = prepare(cheap, case, sample).bodies.theta[-20:]
    assert np.array_equal(theta, plan.source.bodies(2, np.arange(20)).theta)


def test_samples_of_a_grid_come_from_all_over_it():
    plan = plan_of(
        "gh.yaml",
        "bodies={source: grid, base: {preset: GH}, axes: {theta: {linspace: [0.6, 0.9, 400]}, "
        "phi: {linspace: [0.02, 0.036, 400]}}}",
    )
    theta = prepare(*some_runs(plan, 2000)).bodies.theta
    assert theta.min() < 0.605
    assert theta.max() > 0.895
    assert np.array_equal(theta, prepare(*some_runs(plan, 2000)).bodies.theta)


def test_turns_of_queues_worked_out_by_hand():
    ones = np.ones(4)
    assert turns(np.array([3.0, 2.0, 2.0, 1.0]), np.array([4.0, 3.0, 2.0, 1.0]), 2) == 4
    # The dearest by expectation is not the longest, and the long one comes last.
    assert turns(np.array([1.0, 1.0, 1.0, 9.0]), np.array([4.0, 3.0, 2.0, 1.0]), 2) == 10
    assert turns(ones, ones, 64) == 1
    assert turns(ones[:0], ones[:0], 64) == 0


def test_runs_are_drawn_in_proportion_to_their_cost_and_their_steps_are_the_sweeps():
    plan = plan_of("quickstart.yaml", "bodies.samples=40", "horizon={t_rgh: 5, t: 3000}")
    one, two = trial(plan), trial(plan, threads=1)
    drawn = one.drawn[:128]
    assert np.array_equal(drawn, two.drawn[:128])
    share = one.cost[drawn] / one.cost.sum() * 128
    assert np.bincount(drawn).max() <= np.ceil(share.max())
    launches, batch = prepare_block(plan, plan.block(0))
    assert np.array_equal(launches.sample, one.launches.sample)
    outcome = run_batch(plan.config, batch)
    steps = outcome.n_steps + outcome.n_rejected
    known = np.flatnonzero(~np.isnan(one.low))
    assert np.array_equal(one.low[known], steps[known])
    assert np.array_equal(one.high[known], steps[known])
    # The mean over the draws is that of all runs.
    paces = one.low[one.drawn] / one.cost[one.drawn]
    error = paces.std() / np.sqrt(len(paces))
    assert paces.mean() == pytest.approx(steps.sum() / one.cost.sum(), abs=4 * error)


def test_a_sweep_of_few_runs_is_known_exactly():
    assert trial(plan_of("gh.yaml")).all_known
    f = forecast(plan_of("gh.yaml"), 1, budget=60.0)
    # t_r = 112.09 and 809.86, from the comment in the config.
    assert f.units == pytest.approx(112.0939 + 809.857, rel=1e-4)
    assert (f.pilot_runs, f.pilot_cut) == (2, 0)


def test_runs_that_take_too_long_are_cut_and_counted_as_unknown():
    # 2e9 steps in all: the budget is spent on any machine.
    plan = plan_of("gh.yaml", "bodies.overrides.theta=0.9", "horizon={t: 3.0e9}", "spin.n_i=-0.9")
    f = forecast(plan, 1, budget=0.2)
    assert f.pilot_cut == 1
    assert f.low < f.seconds / 2
    assert f.seconds > 60


class UntilSomeHaveEnded(Task):
    """Is stopped by what its kernel has done, and not by a clock."""

    def wait(self, tick=None):
        def stop_early(control: Control) -> None:
            if control.runs_done >= 20:
                control.stop()

        return super().wait(stop_early)


def test_of_what_was_cut_the_steps_lie_between_the_bounds(monkeypatch):
    """Of others that have ended it is known how many steps a unit of their cost takes."""
    plan = plan_of(
        "quickstart.yaml", "bodies.samples=45", "bodies.target=", "horizon={t: 50000}",
        "spin.n_i=[-0.9, 0.9]",
    )  # fmt: skip
    monkeypatch.setattr(pilots, "Task", UntilSomeHaveEnded)
    pilot = trial(plan)
    assert pilot.cut > 0
    cut = np.flatnonzero(pilot.low < pilot.high)
    _, batch = prepare_block(plan, plan.block(0))
    outcome = run_batch(plan.config, batch)
    truth = (outcome.n_steps + outcome.n_rejected)[cut].sum()
    assert pilot.low[cut].sum() / 2 < truth < 2 * pilot.high[cut].sum()


def test_fixed_steps_are_counted_not_taken(monkeypatch):
    plan = plan_of(
        "gh.yaml", "integrator={method: rk4, dt: 0.002}", "horizon={t: 300}", "record=[]"
    )
    asked = []

    def watched(config: Any, *args: Any, **kwargs: Any) -> Any:
        asked.append(config.integrator.dt)
        return run_batch(config, *args, **kwargs)

    monkeypatch.setattr(pilots, "run_batch", watched)
    pilot = trial(plan)
    assert set(asked) == {pilots.PILOT_DT}
    # t_r = 112.09 and the horizon.
    assert pilot.low == pytest.approx([112.09 / 0.002, 300 / 0.002], rel=0.01)


def test_the_closed_form_needs_no_kernel():
    plan = plan_of("quickstart.yaml", "model=gh", "bodies.samples=20")
    f = forecast(plan, 1)
    assert f.kernel_seconds == 0
    assert f.pilot_runs == 0
    assert f.units == 0
    assert 0 < f.low < f.seconds < f.high


@pytest.mark.parametrize(
    "overrides",
    [
        ("quickstart.yaml", "bodies.samples=200", "horizon={t_rgh: 5, t: 1000}"),
        ("gh.yaml", "horizon={t: 500}", f"spin.omega_xy0={np.linspace(0.001, 0.1, 200).tolist()}"),
        ("gh.yaml", "model=gh", "record=[]"),
        ("quickstart.yaml", "bodies={source: sd, samples: 100}", "horizon={t: 500}",
         "record=[windows]", "block_size=300"),
        ("gh.yaml", "horizon={t: 500}", "record=[error]",
         f"spin.omega_xy0={np.linspace(0.001, 0.1, 200).tolist()}"),
    ],
    ids=["shared bodies", "one body", "closed form", "windows", "errors"],
)  # fmt: skip
def test_bytes_are_those_of_the_files(overrides, tmp_path):
    plan = plan_of(*overrides)
    f = forecast(plan, 2, budget=60.0)
    run_sweep(plan, tmp_path / "out", threads=2)
    real = sum(p.stat().st_size for p in (tmp_path / "out").rglob("*") if p.is_file())
    assert f.bytes == pytest.approx(real, rel=0.15)


def test_a_table_of_bodies(tmp_path):
    launches = prepare(*some_runs(plan_of("quickstart.yaml", *SMALL), 40))
    names = ("alpha", "beta", "gamma", "theta", "phi", "xi")
    rows = {name: getattr(launches.bodies, name) for name in names}
    rows |= {"n_i": launches.n_i, "omega_xy0": launches.omega_xy0}
    pd.DataFrame(rows).to_csv(tmp_path / "bodies.csv", index=False)
    (tmp_path / "c.yaml").write_text(
        "bodies: {source: table, path: bodies.csv}\nhorizon: {t_rgh: 5, t: 2000}\n"
    )
    plan = make_plan(load_config(str(tmp_path / "c.yaml"), ()), tmp_path)
    f = forecast(plan, 2, budget=0.2)
    assert (f.runs, f.cases) == (240, 1)
    assert 0 < f.units < f.units_most


def test_the_longest_share_is_that_of_the_deal():
    overrides = ("bodies.samples=64", "block_size=48", "horizon={t: 100}")
    plan = plan_of("quickstart.yaml", *overrides)
    whole = forecast(plan, 1, budget=0.2, shards=1)
    assert whole.shard_seconds == pytest.approx(whole.seconds)
    four = forecast(plan, 1, budget=0.2, shards=4)
    costs = Costs(plan)
    dealt = [sum(map(costs.of, share)) for share in deal(plan, 4, costs)]
    assert max(dealt) / sum(dealt) == pytest.approx(0.25, rel=0.1)
    part = (four.shard_seconds - four.start_seconds) / (four.seconds - four.start_seconds)
    assert part == pytest.approx(max(dealt) / sum(dealt))
    assert forecast(plan, 1, budget=0.2, shards=1000).shard_seconds < four.shard_seconds * 2


def test_memory_grows_with_the_block_and_not_with_the_sweep():
    few = forecast(plan_of("quickstart.yaml", "model=gh", "block_size=1000"), 1).memory
    many = "bodies.samples=100000"
    same = forecast(plan_of("quickstart.yaml", "model=gh", "block_size=1000", many), 1).memory
    large = forecast(plan_of("quickstart.yaml", "model=gh", "block_size=200000", many), 1).memory
    assert same < few + 30e6
    assert same + 100e6 < large < 2e9


def test_only_long_sweeps_get_a_pilot_of_their_own(monkeypatch):
    asked = []
    monkeypatch.setattr(forecasting, "forecast", lambda plan, threads: asked.append(plan))
    for name, *sets in (("quickstart.yaml",), ("gh.yaml",), ("quickstart.yaml", "model=gh")):
        assert expectation(plan_of(name, *sets), 2) is None
    # One that is to stop before it would pay.
    assert expectation(plan_of("quickstart.yaml", "bodies.samples=1000000"), 2, 30.0) is None
    assert not asked
    small = forecast(plan_of("gh.yaml"), 1)
    monkeypatch.setattr(forecasting, "forecast", lambda plan, threads: small)
    for name, *sets in (
        ("quickstart.yaml", "bodies.samples=1000000"),
        ("steady.yaml", "integrator={method: rk4, dt: 0.002}"),
    ):
        assert expectation(plan_of(name, *sets), 2) == small.as_data()


def listing(folder: Path) -> dict[str, int]:
    return {str(p): p.stat().st_mtime_ns for p in sorted(folder.rglob("*"))}


def test_a_machine_that_others_use_widens_the_interval(monkeypatch):
    plan = plan_of("quickstart.yaml", *SMALL)
    wide = []
    for had, waited in ((1.0, 0.0), (1.0, 3.0)):
        ticks = iter(range(1000))
        # Each look finds so many seconds more with a core, and waiting for one.
        monkeypatch.setattr(
            pilots,
            "_core_seconds",
            lambda: next(ticks) * np.array([had, waited]),  # noqa: B023
        )
        f = forecast(plan, 1, budget=0.2)
        wide.append(f.high / f.low)
    # A quarter of the cores: the machine may be four times as fast again.
    assert wide[0] < 4 < wide[1]


def test_the_command_prints_a_table_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = listing(tmp_path)
    overrides = [word for text in SMALL for word in ("--set", text)]
    done = invoke(
        "plan", str(CONFIGS / "quickstart.yaml"), *overrides, "--budget", "0.2s", "--shards", "3",
        "--threads", "1",
    )  # fmt: skip
    assert done.exit_code == 0
    words = [line.split("  ")[0] for line in done.stdout.splitlines()]
    assert words[:4] == ["runs", "blocks", "time", "done at"]
    assert "3 shards" in words
    assert {"disk", "memory", "pilot"} <= set(words)
    assert listing(tmp_path) == before


def test_the_command_prints_json():
    done = invoke("plan", str(CONFIGS / "gh.yaml"), "--json", "--budget", "0.2s")
    assert done.exit_code == 0
    data = json.loads(done.stdout)
    assert data["runs"] == 2
    assert data["low"] < data["seconds"] < data["high"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--budget", "2"], "--budget 2: is no length of time"),
        (["--set", "bodies.samples=x"], "bodies.samples"),
        (["--set", "horizn=3"], "horizn"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(arguments, words):
    assert_refused(invoke("plan", str(CONFIGS / "quickstart.yaml"), *arguments), 2, words)


def test_it_warns_of_what_the_machine_has_not(small, monkeypatch, tmp_path):
    _, f = small
    monkeypatch.setattr(footprint, "free_memory", lambda: 10**9)
    assert footprint.shortages(10**8, f.bytes, tmp_path / "not" / "there") == []
    lines = footprint.shortages(2 * 10**9, 10**18, tmp_path / "not" / "there")
    assert len(lines) == 2
    assert "2.0 GB of memory, and 1.0 GB" in lines[0]
    assert str(tmp_path) in lines[1]


def test_free_memory_is_that_of_a_machine():
    free = footprint.free_memory()
    assert free is not None
    assert 10**6 < free < os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def test_a_forecast_for_more_cores_than_there_are(tmp_path):
    """What a forecast is for: the pilot uses what there is."""
    many = 4 * most_threads()
    plan = plan_of("quickstart.yaml", "bodies={source: sd, samples: 200000}", "horizon={t: 500}")
    found, few = (forecast(plan, threads, budget=0.2) for threads in (many, 1))
    assert (found.threads, few.pilot_threads) == (many, 1)
    assert found.pilot_threads <= most_threads()
    assert found.kernel_seconds < few.kernel_seconds
    assert f"on {many} threads of cores like those here" in describe(found)
    done = invoke("plan", str(CONFIGS / "gh.yaml"), "--threads", str(many))
    assert done.exit_code == 0
