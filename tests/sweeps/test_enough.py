"""`stop`: samples case by case until each is known; what is decided depends on nothing else."""

from __future__ import annotations

import random
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import sweeping
from stopping import again_and_again
from sweeping import changed, content_hash, plan_of, proved

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.block import finish_block, prepare_runs
from rattlesweep.sweeps.shards import Shard
from rattlesweep.sweeps.decide import FIRST, make_stages
from rattlesweep.sweeps.old.retype import retype
from rattlesweep.sweeps.old.verify import verify
from rattlesweep.sweeps.old import sealed
from rattlesweep.sweeps.arrow import build_table
from rattlesweep.sweeps.counts import Cells, wilson
from rattlesweep.sweeps.columns import runs_schema

CONFIG: dict[str, Any] = {
    "seed": 5,
    "bodies": {"source": "sd", "samples": 4000},
    "stop": {"fraction": 0.03},
    "spin": {"n_i": [-0.1, -0.4, 0.2], "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 2000},
    "block_size": 150,
}


def sweep(output: Path, config: dict[str, Any] = CONFIG, **options: Any) -> Any:
    return sweeping.sweep(output, config, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("enough") / "out"
    sweep(output)
    return output


def test_every_case_is_known_well_enough_and_no_case_long_before(whole):
    proved(whole, recompute=30)
    summary, runs = pd.read_parquet(whole / "summary.parquet"), pd.read_parquet(whole / "runs")
    assert len(set(summary.runs)) > 1
    assert (summary.runs >= FIRST).all()
    assert (summary.runs % CONFIG["block_size"] == 0).all()
    for case, own in runs.groupby("case"):
        # The samples of a case are the first ones, whatever the others have.
        assert own["sample"].sort_values().tolist() == list(range(len(own)))
        for kind in ("R", "SS", "SW", "unclassified"):
            low, high = wilson((own.type == kind).sum(), len(own))
            assert (high - low) / 2 <= 0.03, (case, kind)
        fewer = own[own["sample"] < len(own) / 1.5]
        if len(fewer) >= FIRST:
            parts = [wilson((fewer.type == kind).sum(), len(fewer)) for kind in ("R", "SW")]
            assert max(high - low for low, high in parts) / 2 > 0.03


def test_mean_times_known_well_enough_or_all_samples(tmp_path):
    sweep(tmp_path / "known", changed(CONFIG, bodies={"samples": 6000}) | {"stop": {"t_r": 0.05}})
    for _, own in pd.read_parquet(tmp_path / "known" / "runs").groupby("case"):
        assert 1.96 * own.t_r.sem() / own.t_r.mean() <= 0.05
        assert FIRST <= len(own) < 6000
    never = changed(CONFIG, bodies={"samples": 1000}, stop={"t_r": 1e-4})
    assert sweep(tmp_path / "all", never).runs == 3000
    proved(tmp_path / "all")


def test_the_rows_are_those_of_the_sweep_without_it(whole):
    some = pd.read_parquet(whole / "runs").sort_values(["case", "sample"], ignore_index=True)
    plan = plan_of(CONFIG, stop=None)
    columns = finish_block(plan.config, *prepare_runs(plan, *some[["case", "sample"]].to_numpy().T))
    every = build_table(columns, runs_schema(model="gh")).to_pandas()
    pd.testing.assert_frame_equal(some, every, check_exact=True)


def test_stopped_again_and_again_in_any_order_with_harm(whole, tmp_path):
    dice = random.Random(3)

    def harm(trial: int) -> None:
        blocks = sorted((tmp_path / "runs").iterdir())
        if trial % 4 == 1:
            (tmp_path / "manifest.json").unlink()
        if trial % 5 == 2:
            blocks[0].write_bytes(blocks[0].read_bytes()[:-5])
        if trial % 7 == 3:
            dice.choice(blocks).unlink()

    assert again_and_again(partial(sweep, tmp_path), 6, dice, harm) > 5
    assert proved(tmp_path) == content_hash(whole)
    assert (tmp_path / "summary.parquet").read_bytes() == (whole / "summary.parquet").read_bytes()


def test_what_was_decided_is_verified(whole, tmp_path):
    """A directory that stopped too early is not taken for complete."""
    output = Path(shutil.copytree(whole, tmp_path / "out"))
    path = output / "manifest.json"
    said = sealed.load(path.read_bytes())
    last = said["stages"].pop()
    gone = -(-last // CONFIG["block_size"])
    said["runs"], said["blocks"] = said["runs"] - last, said["blocks"] - gone
    for index in range(said["blocks"], said["blocks"] + gone):
        (output / "runs" / f"block-{index:06d}.parquet").unlink()
        del said["receipts"][str(index)]
    path.write_bytes(sealed.dump(said))
    assert said["state"] == "complete"
    assert any("other stages" in problem for problem in verify(output).problems)
    sweep(output)
    assert content_hash(output) == content_hash(whole)


def test_what_would_change_decisions_is_refused(whole):
    before = proved(whole)
    for change, options, words in (
        ({}, {"shard": Shard(0, 2)}, "there are no shares"),
        ({}, {"retry_failed": True}, "has chosen the runs"),
        ({"block_size": 100}, {}, "block_size: 150 against 100"),
        ({"classify": {"sw_departure": 0.1}}, {}, "classify.sw_departure"),
        ({"bodies": {"source": "sd", "samples": 5000}}, {}, "does not grow"),
    ):
        with pytest.raises(ConfigError, match=words):
            sweep(whole, CONFIG | change, **options)
    with pytest.raises(ConfigError, match="its types cannot change"):
        retype(whole, ["classify.sw_departure=0.1"])
    assert proved(whole) == before


def stopped(seed: int) -> Cells:
    """Runs of a sweep in memory, by case."""
    plan = plan_of(CONFIG, block_size=50, seed=seed)
    decide, cells = make_stages(plan.config, 3, plan.samples), Cells(3)
    assert decide is not None
    numbers = decide.first()
    while len(numbers):
        launches, batch = prepare_runs(plan, *np.divmod(numbers, plan.samples))
        columns = finish_block(plan.config, launches, batch)
        for rows in build_table(columns, runs_schema(model="gh")).to_batches():
            decide.add(rows)
            cells.add(rows, rows.column("case").to_numpy().astype(np.int64))
        numbers = decide.next()
    return cells


@pytest.mark.slow
def test_what_is_promised_holds_in_95_of_100_sweeps():
    """Stopping by what came out may not make it look better known than it is."""
    bodies = {"source": "sd", "samples": 2**18, "draw": "sobol"}
    plan = plan_of(CONFIG, bodies=bodies, stop=None)
    launches, batch = prepare_runs(plan, *np.divmod(np.arange(plan.runs), plan.samples))
    t_r = finish_block(plan.config, launches, batch)["t_r"].reshape(3, -1)
    true = np.isfinite(t_r).mean(axis=1)
    found = [stopped(1000 + seed) for seed in range(500)]
    shares = np.array([cells.types["R"] / cells.ok for cells in found])
    assert (np.mean(np.abs(shares - true) <= 0.03, axis=0) >= 0.94).all()
