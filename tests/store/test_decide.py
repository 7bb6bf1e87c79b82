"""`bodies.refine` and `stop`: the wanted runs follow from the rows alone."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import sweeping
from cutting import Stop, cut
from hardship import check_equal
from sweeping import changed, plan_of, proved

from rattlesweep.statistics.intervals import wilson
from rattlesweep.store.decide import FIRST_WAVE, nearest_rows, wanted_runs
from rattlesweep.store.progress import status
from rattlesweep.store.rows import nothing_found, open_stored, same_bits
from rattlesweep.store.summary import summarise
from rattlesweep.words.errors import ConfigError
from rattlesweep.work.run import integrate_plan, run_sweep
from rattlesweep.work.verify import verify

GRID: dict[str, Any] = {
    "source": "grid",
    "base": {"preset": "GH"},
    "axes": {"theta": {"linspace": [0.6, 0.99, 61]}},
}
MAP: dict[str, Any] = {
    "bodies": GRID | {"refine": {"levels": 3}},
    "spin": {"n_i": {"linspace": [-0.6, 0.6, 50]}, "omega_xy0": [0.01, 0.1]},
    "model": "gh",
    "horizon": {"t": 2000},
}
POINTS = 6100
TIMES = MAP | {"bodies": GRID | {"refine": {"levels": 3, "by": "t_r"}}}
ENOUGH: dict[str, Any] = {
    "seed": 5,
    "bodies": {"source": "sd", "samples": 4000},
    "stop": {"fraction": 0.03},
    "spin": {"n_i": [-0.1, -0.4, 0.2], "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 2000},
}
CONFIGS = {"refine by type": MAP, "refine by t_r": TIMES, "stop": ENOUGH}


@pytest.fixture(scope="module")
def full() -> pa.Table:
    """The whole grid."""
    return integrate_plan(plan_of(MAP, bodies=GRID))


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> dict[str, Path]:
    """Each of the sweeps, without interruptions."""
    folder = tmp_path_factory.mktemp("done")
    for name, config in CONFIGS.items():
        sweeping.sweep(folder / name, config)
    return {name: folder / name for name in CONFIGS}


@pytest.mark.parametrize("name", CONFIGS)
def test_wanted_is_found_from_any_rows_in_any_order(name, done):
    """From no rows to all, in parts of waves, and with rows that are not wanted."""
    plan = plan_of(CONFIGS[name])
    dice = np.random.default_rng(4)
    bodies = {k: v for k, v in CONFIGS[name]["bodies"].items() if k != "refine"}
    whole = {k: v for k, v in CONFIGS[name].items() if k != "stop"} | {"bodies": bodies}
    every = integrate_plan(plan_of(whole))
    rows = open_stored(done[name]).read()
    is_stored = np.zeros(plan.shape, bool)
    is_stored[rows["case"].to_numpy(), rows["sample"].to_numpy()] = True
    waves = {0}
    for surplus in (0.0, 0.3):
        known = nothing_found(plan)
        if surplus:
            extra = dice.random(plan.runs) < surplus
            known.add(every.filter(pa.array(extra)))
        while True:
            wanted = wanted_runs(plan, known)
            waves.add(int(wanted.sum()))
            todo = wanted & ~known.done
            if not todo.any():
                break
            case, sample = np.nonzero(todo)
            some = dice.permutation(len(case))[: max(1, len(case) // 2)]
            known.add(every.take(pa.array(case[some] * plan.samples + sample[some])))
        assert np.array_equal(wanted, is_stored)
    assert len(waves) > 3


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name == "refine by t_r" else [])
        for name in CONFIGS
    ],
)
def test_stopped_again_and_again_in_any_order_with_harm(name, done, tmp_path):
    dice = random.Random(3)
    stops = 0
    while True:
        try:
            sweeping.sweep(
                tmp_path, CONFIGS[name], executor=cut(160, dice.randint(1, 3), dice)
            )
            break
        except Stop:
            stops += 1
        files = open_stored(tmp_path).files()
        now = status(tmp_path)
        assert now.data["runs"] < now.data["wanted"] or stops % 2 == 0
        assert verify(tmp_path).problems == []
        assert (
            summarise(open_stored(tmp_path))["runs"].to_numpy().sum()
            == now.data["runs"]
        )
        if stops % 4 == 1:
            (tmp_path / "manifest.json").unlink()
        if stops % 5 == 2:
            dice.choice(files).unlink()
    assert stops > 2
    check_equal(tmp_path, done[name])


def test_a_fraction_of_the_runs_gives_the_same_map(full, done):
    output = done["refine by type"]
    proved(output, recompute=20)
    some = open_stored(output).read()
    at = some["case"].to_numpy().astype(int) * 61 + some["sample"].to_numpy()
    assert same_bits(some, full.take(pa.array(at)))
    assert len(some) < POINTS / 4
    # Points of the grid that were left out get the type of the nearest run.
    nearest = np.concatenate([rows for _, rows in nearest_rows(open_stored(output))])
    shown = some["type"].to_numpy()[nearest]
    types = full["type"].to_numpy()
    assert len(set(types)) == 3
    assert np.mean(shown != types) < 0.002


def test_the_summary_is_that_of_the_grid_and_not_of_its_boundaries(full, done):
    summary = pd.read_parquet(done["refine by type"] / "summary.parquet")
    grid = full.to_pandas()
    some = pd.read_parquet(done["refine by type"] / "runs")
    share = (grid.type == "R").groupby(grid.case).mean()
    assert (summary.fraction_R - share).abs().max() < 0.02
    assert abs(summary.fraction_R.mean() - share.mean()) < 0.002
    # The unweighted share of the runs differs.
    assert abs((some.type == "R").mean() - share.mean()) > 0.2
    # The number of runs is not weighted.
    runs = some.groupby("case").size().reindex(summary.case, fill_value=0)
    assert summary.runs.tolist() == runs.tolist()


@pytest.mark.parametrize("name", ["refine by type", "stop"])
def test_progress_is_whole_only_once_no_more_runs_are_wanted(name, tmp_path):
    seen = []
    run_sweep(plan_of(CONFIGS[name]), tmp_path, report=seen.append)
    fractions = [progress.fraction for progress in seen]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    # Of the runs that the config has, some are never wanted.
    assert 0 < fractions[-2] < 0.9


def test_spins_with_units_are_refined_like_plain_ones(tmp_path):
    theta = {"linspace": [0.3, 0.6, 17]}
    bodies = GRID | {
        "base": {"preset": "KL"},
        "axes": {"theta": theta},
        "refine": {"levels": 2},
    }
    spin = {
        "n_i": ["-60 rpm", "20 rpm", "-0.1 sqrt(g/a)", "-30 rpm"],
        "omega_xy0": ["5 rpm", "0.1 sqrt(g/a)"],
    }
    horizon = {"t": f"{MAP['horizon']['t']} sqrt(a/g)"}
    in_units = MAP | {"bodies": bodies, "horizon": horizon}
    sweeping.sweep(tmp_path / "rpm", in_units | {"spin": spin})
    stored = open_stored(tmp_path / "rpm")
    cases = stored.cases
    spin = {
        "n_i": [f"{float(case.n_i)!r} sqrt(g/a)" for case in cases[::2]],
        "omega_xy0": [f"{float(case.omega_xy0)!r} sqrt(g/a)" for case in cases[:2]],
    }
    sweeping.sweep(tmp_path / "plain", in_units | {"spin": spin})
    plain = open_stored(tmp_path / "plain").read()
    assert len(plain) < 8 * 17
    assert same_bits(stored.read(plain.schema.names), plain)


def test_refused_where_nothing_can_be_left_out_or_recorded():
    few = GRID | {"axes": {"theta": [0.6, 0.7, 0.8]}, "refine": {}}
    one_spin = {"n_i": 0.1, "omega_xy0": 0.1}
    plan = plan_of(MAP, bodies=few, spin=one_spin)
    with pytest.raises(ConfigError, match="no axis has 5 values or more"):
        wanted_runs(plan, nothing_found(plan))
    plan = plan_of(MAP, bodies=GRID | {"refine": {"by": "lyapunov"}})
    with pytest.raises(
        ConfigError, match=r"refine\.by: there is no column lyapunov in these runs"
    ):
        wanted_runs(plan, nothing_found(plan))


def test_a_refined_directory_becomes_the_whole_grid(full, done, tmp_path):
    sweeping.sweep(tmp_path, MAP)
    result = sweeping.sweep(tmp_path, MAP | {"bodies": GRID})
    assert result.runs - result.done == open_stored(done["refine by type"]).count()
    assert same_bits(open_stored(tmp_path).read(), full)


def test_every_case_is_known_well_enough_and_no_case_long_before(done):
    whole = done["stop"]
    proved(whole, recompute=30)
    summary = pd.read_parquet(whole / "summary.parquet")
    runs = pd.read_parquet(whole / "runs")
    assert len(set(summary.runs)) > 1
    assert (summary.runs >= FIRST_WAVE).all()
    for case, rows in runs.groupby("case"):
        # The samples of a case are the first ones, whatever the others have.
        assert rows["sample"].sort_values().tolist() == list(range(len(rows)))
        for kind in ("R", "SS", "SW", "unclassified"):
            low, high = wilson((rows.type == kind).sum(), len(rows))
            assert (high - low) / 2 <= 0.03, (case, kind)
        fewer = rows[rows["sample"] < len(rows) / 1.5]
        if len(fewer) >= FIRST_WAVE:
            intervals = [
                wilson((fewer.type == kind).sum(), len(fewer)) for kind in ("R", "SW")
            ]
            assert max(high - low for low, high in intervals) / 2 > 0.03


def test_mean_times_known_well_enough_or_all_samples(tmp_path):
    known = changed(ENOUGH, bodies={"samples": 6000}) | {"stop": {"t_r": 0.05}}
    sweeping.sweep(tmp_path / "known", known)
    for _, rows in pd.read_parquet(tmp_path / "known" / "runs").groupby("case"):
        assert 1.96 * rows.t_r.sem() / rows.t_r.mean() <= 0.05
        assert FIRST_WAVE <= len(rows) < 6000
    never = changed(ENOUGH, bodies={"samples": 1000}, stop={"t_r": 1e-4})
    assert sweeping.sweep(tmp_path / "all", never).runs == 3000
