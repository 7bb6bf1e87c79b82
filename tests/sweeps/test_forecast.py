"""Forecasts: what a pilot learns, what is made of it, and that the command says it."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from refusal import assert_refused
from sweeping import CONFIGS, invoke, plan_of, tree

from rattlesweep.integrate.batch import Control, most_threads
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import prepare_block, run_batch
from rattlesweep.sweeps.cost import Costs, some_runs
from rattlesweep.sweeps.launches import prepare
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.shards import deal
from rattlesweep.sweeps.old.run import run_sweep
from rattlesweep.sweeps.old import footprint
from rattlesweep.sweeps.old import forecast as forecasting
from rattlesweep.sweeps.old import pilot as pilots
from rattlesweep.sweeps.old.forecast import Forecast, describe, expectation, forecast
from rattlesweep.sweeps.old.pilot import Pilot, turns

SMALL = ("bodies.samples=40", "spin.n_i=[-0.1, -0.3]", "horizon={t_rgh: 5, t: 2000}")
quick = partial(plan_of, "quickstart.yaml")


def trial(plan: Plan, threads: int = 2) -> Pilot:
    pilot = Pilot(plan, threads)
    pilot.run(60.0)
    return pilot


@pytest.fixture(scope="module")
def small() -> Forecast:
    return forecast(quick(*SMALL), 2, budget=1.0, shards=2)


def test_it_says_what_the_plan_says_as_data_and_in_a_table(small):
    f = small
    assert (f.runs, f.cases, f.blocks, f.block_rows, f.threads) == (240, 6, 1, 240, 2)
    assert 0 < f.low < f.seconds < f.high
    assert 0 < f.kernel_seconds < f.seconds
    assert 0 < f.units <= f.units_most
    assert f.million < f.billion
    assert 0 < f.pilot_runs <= 240
    data = json.loads(json.dumps(f.as_data(), allow_nan=False))
    assert data["seconds"] == pytest.approx(f.seconds, rel=1e-3)
    assert data["low"] < data["seconds"] < data["high"]
    assert isinstance(data["bytes"], int)
    assert "compile_seconds" not in replace(f, compile_seconds=None).as_data()
    text = describe(replace(f, seconds=190.0, low=170.0, high=210.0, pilot_cut=3))
    assert "3 min 10 s (2 min 50 s to 3 min 30 s) on 2 threads" in text
    assert "240 in 6 cases" in text
    assert "3 of them cut short" in text
    assert "done at" not in describe(replace(f, seconds=1e15, low=1e14, high=1e16))
    assert "11 d 2 h" in describe(replace(f, seconds=9.6e5))


# -- the pilot ---------------------------------------------------------------------------------


def test_some_runs_are_the_sweeps_own_and_from_all_over_a_grid():
    plan = quick("bodies.samples=3000")
    cheap, case, sample = some_runs(plan, 20)
    assert case.tolist() == np.repeat(np.arange(len(plan.cases)), 20).tolist()
    assert sample.tolist() == [*range(20)] * len(plan.cases)
    theta = prepare(cheap, case, sample).bodies.theta[-20:]
    assert np.array_equal(theta, plan.source.bodies(plan.cases[-1].target, np.arange(20)).theta)
    axes = "{theta: {linspace: [0.6, 0.9, 400]}, phi: {linspace: [0.02, 0.036, 400]}}"
    plan = plan_of("gh.yaml", f"bodies={{source: grid, base: {{preset: GH}}, axes: {axes}}}")
    theta, again = (prepare(*some_runs(plan, 2000)).bodies.theta for _ in range(2))
    assert theta.min() < 0.605
    assert theta.max() > 0.895
    assert np.array_equal(theta, again)


def test_turns_of_queues_worked_out_by_hand():
    ones = np.ones(4)
    assert turns(np.array([3.0, 2.0, 2.0, 1.0]), np.array([4.0, 3.0, 2.0, 1.0]), 2) == 4
    # The dearest by expectation is not the longest, and the long one comes last.
    assert turns(np.array([1.0, 1.0, 1.0, 9.0]), np.array([4.0, 3.0, 2.0, 1.0]), 2) == 10
    assert turns(ones, ones, 64) == 1
    assert turns(ones[:0], ones[:0], 64) == 0


def test_runs_are_drawn_in_proportion_to_their_cost_and_their_steps_are_the_sweeps():
    plan = quick("bodies.samples=40", "horizon={t_rgh: 5, t: 3000}")
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


def test_a_sweep_of_few_runs_is_known_exactly_and_the_closed_form_needs_no_kernel():
    f = forecast(plan_of("gh.yaml"), 1, budget=60.0)
    # t_r = 112.09 and 809.86, from the comment in the config.
    assert f.units == pytest.approx(112.0939 + 809.857, rel=1e-4)
    assert (f.pilot_runs, f.pilot_cut) == (2, 0)
    f = forecast(quick("model=gh", "bodies.samples=20"), 1)
    assert f.kernel_seconds == f.pilot_runs == f.units == 0
    assert 0 < f.low < f.seconds < f.high


def test_runs_that_take_too_long_are_cut_and_counted_as_unknown():
    # 2e9 steps in all: the budget is spent on any machine.
    never = ("bodies.overrides.theta=0.9", "horizon={t: 3.0e9}", "spin.n_i=-0.9")
    f = forecast(plan_of("gh.yaml", *never), 1, budget=0.2)
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
    plan = quick(
        "bodies.samples=30", "bodies.target=", "horizon={t: 50000}", "spin.n_i=[-0.9, 0.9]"
    )
    monkeypatch.setattr(pilots, "Task", UntilSomeHaveEnded)
    pilot = trial(plan)
    assert pilot.cut > 0
    cut = np.flatnonzero(pilot.low < pilot.high)
    _, batch = prepare_block(plan, plan.block(0))
    outcome = run_batch(plan.config, batch)
    truth = (outcome.n_steps + outcome.n_rejected)[cut].sum()
    assert pilot.low[cut].sum() / 2 < truth < 2 * pilot.high[cut].sum()


def test_fixed_steps_are_counted_not_taken(monkeypatch):
    asked = []

    def watched(config: Any, *args: Any, **kwargs: Any) -> Any:
        asked.append(config.integrator.dt)
        return run_batch(config, *args, **kwargs)

    monkeypatch.setattr(pilots, "run_batch", watched)
    fixed = ("integrator={method: rk4, dt: 0.002}", "horizon={t: 300}", "record=[]")
    pilot = trial(plan_of("gh.yaml", *fixed))
    assert set(asked) == {pilots.PILOT_DT}
    # t_r = 112.09 and the horizon.
    assert pilot.low == pytest.approx([112.09 / 0.002, 300 / 0.002], rel=0.01)


# -- what is made of it ------------------------------------------------------------------------

OMEGAS = f"spin.omega_xy0={np.linspace(0.001, 0.1, 200).tolist()}"
FILES = {
    "shared bodies": ("quickstart.yaml", "bodies.samples=200", "horizon={t_rgh: 5, t: 1000}"),
    "one body": ("gh.yaml", "horizon={t: 500}", OMEGAS),
    "closed form": ("gh.yaml", "model=gh", "record=[]"),
    "windows": ("quickstart.yaml", "bodies={source: sd, samples: 100}", "horizon={t: 500}",
                "record=[windows]", "block_size=300"),
    "errors": ("gh.yaml", "horizon={t: 500}", "record=[error]", OMEGAS),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_bytes_are_those_of_the_files(name, tmp_path):
    plan = plan_of(*FILES[name])
    f = forecast(plan, 2, budget=60.0)
    run_sweep(plan, tmp_path, threads=2)
    real = sum(p.stat().st_size for p in tmp_path.rglob("*") if p.is_file())
    assert f.bytes == pytest.approx(real, rel=0.15)


def test_the_longest_share_is_that_of_the_deal():
    plan = quick("bodies.samples=64", "block_size=48", "horizon={t: 100}")
    whole, four, many = (forecast(plan, 1, budget=0.2, shards=k) for k in (1, 4, 1000))
    assert whole.shard_seconds == pytest.approx(whole.seconds)
    costs = Costs(plan)
    dealt = [sum(map(costs.of, share)) for share in deal(plan, 4, costs)]
    assert max(dealt) / sum(dealt) == pytest.approx(0.25, rel=0.1)
    part = (four.shard_seconds - four.start_seconds) / (four.seconds - four.start_seconds)
    assert part == pytest.approx(max(dealt) / sum(dealt))
    assert many.shard_seconds < four.shard_seconds * 2


def test_memory_grows_with_the_block_and_not_with_the_sweep():
    few, same, large = (
        forecast(quick("model=gh", f"block_size={size}", f"bodies.samples={samples}"), 1).memory
        for size, samples in ((1000, 1000), (1000, 100_000), (200_000, 100_000))
    )
    assert same < few + 30e6
    assert same + 100e6 < large < 2e9


def test_only_long_sweeps_get_a_pilot_of_their_own(monkeypatch, small):
    asked = []
    monkeypatch.setattr(forecasting, "forecast", lambda plan, threads: asked.append(plan) or small)
    for plan in (quick(), plan_of("gh.yaml"), quick("model=gh")):
        assert expectation(plan, 2) is None
    million = quick("bodies.samples=1000000")
    # One that is to stop before it would pay.
    assert expectation(million, 2, 30.0) is None
    assert not asked
    for plan in (million, plan_of("steady.yaml", "integrator={method: rk4, dt: 0.002}")):
        assert expectation(plan, 2) == small.as_data()


def test_a_machine_that_others_use_widens_the_interval(monkeypatch):
    wide = []
    for had, waited in ((1.0, 0.0), (1.0, 3.0)):
        ticks, each = iter(range(1000)), np.array([had, waited])
        # Each look finds so many seconds more with a core, and waiting for one.
        looks = partial(lambda ticks, each: next(ticks) * each, ticks, each)
        monkeypatch.setattr(pilots, "_core_seconds", looks)
        f = forecast(quick(*SMALL), 1, budget=0.2)
        wide.append(f.high / f.low)
    # A quarter of the cores: the machine may be four times as fast again.
    assert wide[0] < 4 < wide[1]


def test_a_forecast_for_more_cores_than_there_are():
    """What a forecast is for: the pilot uses what there is."""
    many = 4 * most_threads()
    plan = quick("bodies={source: sd, samples: 20000}", "horizon={t: 500}")
    found, few = (forecast(plan, threads, budget=0.2) for threads in (many, 1))
    assert (found.threads, few.pilot_threads) == (many, 1)
    assert found.pilot_threads <= most_threads()
    assert found.kernel_seconds < few.kernel_seconds
    assert f"on {many} threads of cores like those here" in describe(found)


def test_it_warns_of_what_the_machine_has_not(small, monkeypatch, tmp_path):
    free = footprint.free_memory()
    assert free is not None
    assert 10**6 < free < os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    monkeypatch.setattr(footprint, "free_memory", lambda: 10**9)
    assert footprint.shortages(10**8, small.bytes, tmp_path / "not" / "there") == []
    lines = footprint.shortages(2 * 10**9, 10**18, tmp_path / "not" / "there")
    assert len(lines) == 2
    assert "2.0 GB of memory, and 1.0 GB" in lines[0]
    assert str(tmp_path) in lines[1]


# -- the command -------------------------------------------------------------------------------


def test_the_command_prints_a_table_or_json_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    overrides = [word for text in SMALL for word in ("--set", text)]
    options = ("--budget", "0.2s", "--threads", str(4 * most_threads()))
    done = invoke("plan", CONFIGS / "quickstart.yaml", *overrides, *options, "--shards", 3)
    assert done.exit_code == 0
    words = [line.split("  ")[0] for line in done.stdout.splitlines()]
    assert words[:4] == ["runs", "blocks", "time", "done at"]
    assert {"3 shards", "disk", "memory", "pilot"} <= set(words)
    data = json.loads(invoke("plan", CONFIGS / "gh.yaml", *options, "--json").stdout)
    assert data["runs"] == 2
    assert data["low"] < data["seconds"] < data["high"]
    assert tree(tmp_path) == {}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--budget", "2"], "--budget 2: is no length of time"),
        (["--set", "bodies.samples=x"], "bodies.samples"),
        (["--set", "horizn=3"], "horizn"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(arguments, words):
    assert_refused(invoke("plan", CONFIGS / "quickstart.yaml", *arguments), 2, words)
