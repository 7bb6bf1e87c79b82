"""Shares of a sweep in directories of their own, or in one, and what `merge` makes of them."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from refusal import assert_refused
from test_run import invoke

from rattlesweep.sweeps.cases.costs import Costs
from rattlesweep.sweeps.cases.plan import Plan, make_plan
from rattlesweep.sweeps.cases.shards import Shard, deal
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.inspect import merge as merging
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.inspect.verify import verify

CONFIG = {
    "name": "shares",
    "seed": 11,
    "bodies": {"source": "sd", "samples": 30, "target": {"K_r": [0.03, 0.1], "rel_tol": 0.1}},
    "spin": {"n_i": [-0.1, -0.5, 0.2], "omega_xy0": [0.01, 0.1]},
    "block_size": 32,
}


def plan_of(**changes: Any) -> Plan:
    return make_plan(parse_config(CONFIG | changes))


def merge(*args: Any) -> Any:
    return invoke("merge", *args)


def shares(place: Path, plan: Plan, count: int, **options: Any) -> list[Path]:
    """Each share in a directory of its own."""
    directories = [place / f"share-{i}" for i in range(count)]
    for i, directory in enumerate(directories):
        run_sweep(plan, directory, shard=Shard(i, count), **options)
    return directories


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sweep done at once, by one thread."""
    directory = tmp_path_factory.mktemp("plain") / "out"
    assert run_sweep(plan_of(), directory, threads=1).summary is not None
    return directory


# -- the same table --------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "threads"), [(1, 2), (2, 1), (7, 2)])
@pytest.mark.parametrize("own", [False, True], ids=["shared", "own"])
def test_shares_come_to_the_same_table(own, count, threads, plain, tmp_path):
    plan = plan_of()
    assert plan.n_blocks == 12
    if own:
        directories = shares(tmp_path, plan, count, threads=threads)
    else:
        directories = [tmp_path / "out"]
        for i in range(count):
            run_sweep(plan, directories[0], shard=Shard(i, count), threads=threads)
        assert verify(directories[0]).problems == []
        assert content_hash(directories[0]) == content_hash(plain)
    result = merge(*directories, "--output", tmp_path / "merged")
    assert result.exit_code == 0
    assert verify(tmp_path / "merged").problems == []
    assert content_hash(tmp_path / "merged") == content_hash(plain)
    assert pq.read_table(tmp_path / "merged" / "summary.parquet").equals(
        pq.read_table(plain / "summary.parquet")
    )
    # 360 rows are one file.
    assert len(list((tmp_path / "merged" / "runs").iterdir())) == 1


@pytest.mark.parametrize("count", [1, 2, 5, 12, 40])
def test_every_block_is_dealt_once_and_shares_cost_about_the_same(count):
    plan = plan_of()
    costs = Costs(plan)
    dealt = deal(plan, count, costs)
    numbers = sorted(block.index for part in dealt for block in part)
    assert numbers == list(range(plan.n_blocks))
    sums = [sum(costs.of(block) for block in part) for part in dealt]
    dearest = max(costs.of(plan.block(i)) for i in range(plan.n_blocks))
    # No share is above the mean by more than one block.
    assert max(sums) <= np.mean(sums) + dearest
    if count > plan.n_blocks:
        assert sums.count(0.0) == count - plan.n_blocks


# -- files of sensible size ------------------------------------------------------------------------


def test_files_hold_so_many_runs_and_the_last_one_the_rest(plain, tmp_path, monkeypatch):
    monkeypatch.setattr(merging, "MERGED_SIZE", 100)
    done = merge(plain, "--output", tmp_path / "out", "-q")
    assert (done.exit_code, done.stdout) == (0, "")
    files = sorted((tmp_path / "out" / "runs").iterdir())
    assert [pq.read_metadata(f).num_rows for f in files] == [100, 100, 100, 60]
    assert verify(tmp_path / "out").problems == []
    assert content_hash(tmp_path / "out") == content_hash(plain)
    said = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert (said["state"], said["blocks"], said["config"]["block_size"]) == ("complete", 4, 100)
    # An output directory like any other: nothing is left to run there.
    report = run_sweep(plan_of(), tmp_path / "out")
    assert (report.resumed_runs, report.blocks) == (360, 0)


def test_directories_in_blocks_of_different_sizes_are_joined(plain, tmp_path):
    directories = shares(tmp_path, plan_of(), 2)
    other = tmp_path / "other"
    run_sweep(plan_of(block_size=50), other, shard=Shard(0, 2))
    result = merge(other, *directories, "--output", tmp_path / "merged")
    assert result.exit_code == 0
    assert content_hash(tmp_path / "merged") == content_hash(plain)


# -- what is missing -------------------------------------------------------------------------------


def test_missing_share_is_named_and_run_does_the_rest(plain, tmp_path):
    plan = plan_of()
    directories = shares(tmp_path, plan, 3)
    result = merge(*directories[:2], "--output", tmp_path / "merged")
    assert result.exit_code == 75
    absent = {block.index for block in deal(plan, 3, Costs(plan))[2]}
    spans = "\n".join(line for line in result.stderr.splitlines() if "missing" in line)
    first = min(absent)
    assert f"missing: runs {32 * first} to " in spans
    assert "merge the other shards too" in spans
    assert not (tmp_path / "merged" / "summary.parquet").exists()
    there = pd.read_parquet(tmp_path / "merged" / "runs")
    assert len(there) == sum(plan.block(i).rows for i in range(12) if i not in absent)
    assert verify(tmp_path / "merged").problems == []
    assert run_sweep(plan, tmp_path / "merged").missing == 0
    assert content_hash(tmp_path / "merged") == content_hash(plain)


@pytest.mark.parametrize("again", ["all", "the rest"])
def test_another_merge_completes_what_is_there(again, plain, tmp_path):
    plan = plan_of()
    directories = shares(tmp_path, plan, 3)
    output = tmp_path / "merged"
    result = merge(*directories[:2], "--output", output)
    assert result.exit_code == 75
    assert "merge the other shards too, with the same --output" in result.stderr
    rest = directories if again == "all" else directories[2:]
    result = merge(*rest, "--output", output)
    assert result.exit_code == 0, result.stderr
    assert "missing" not in result.stderr
    assert "360 runs in 12 files" in result.stderr
    assert verify(output).problems == []
    assert content_hash(output) == content_hash(plain)
    # Of all that was done, each session once.
    said, parts = (
        json.loads((output / "manifest.json").read_text()),
        [json.loads((d / "manifest.json").read_text()) for d in directories],
    )
    assert said["state"] == "complete"
    assert [s["shard"] for s in said["sessions"]] == ["0/3", "1/3", "2/3"]
    for key in ("seconds", "kernel_seconds"):
        assert said[key] == pytest.approx(sum(part[key] for part in parts), abs=1e-2)
    assert said["peak_memory"] == max(part["peak_memory"] for part in parts)
    assert said["bytes"] == sum(f.stat().st_size for f in (output / "runs").iterdir())
    assert all(part["command"] in said["commands"] for part in parts)
    assert all("command" in session for session in said["sessions"])


def test_merge_judges_the_directory_and_not_what_was_given(plain, tmp_path):
    """What is there may be more, and in other blocks, than the shares that are given."""
    directories = shares(tmp_path, plan_of(), 2)
    output = tmp_path / "merged"
    assert merge(plain, "--output", output).exit_code == 0
    assert merge(directories[0], "--output", output).exit_code == 0
    assert content_hash(output) == content_hash(plain)
    # Blocks of 32 that cover no block of 50 as a whole are not in the output.
    other = tmp_path / "other"
    run_sweep(plan_of(block_size=50), other, shard=Shard(0, 2))
    output = tmp_path / "mixed"
    result = merge(other, directories[0], "--output", output)
    there = {path.name for path in (output / "runs").iterdir()}
    runs = sum(pq.read_metadata(output / "runs" / name).num_rows for name in there)
    assert result.exit_code == 75
    assert f"{runs} runs in {len(there)} files" in result.stderr
    spans = re.findall(r"(\d+) to (\d+)", result.stderr.split("missing: runs ")[1])
    assert sum(int(b) - int(a) + 1 for a, b in spans) == 360 - runs


def test_merge_that_was_interrupted_goes_on(plain, tmp_path, monkeypatch):
    monkeypatch.setattr(merging, "MERGED_SIZE", 100)
    done: list[int] = []
    honest = merging.Store.write_block

    def rewrite(self: Any, index: int, *args: Any) -> Any:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(index)
        return honest(self, index, *args)

    monkeypatch.setattr(merging.Store, "write_block", rewrite)
    assert merge(plain, "--output", tmp_path / "out").exit_code == 130
    done.clear()
    assert merge(plain, "--output", tmp_path / "out").exit_code == 0
    assert done == [2, 3]
    assert content_hash(tmp_path / "out") == content_hash(plain)


# -- what does not go together -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"seed": 12}, "seed"),
        ({"bodies": CONFIG["bodies"] | {"samples": 31}}, "samples"),
        ({"classify": {"sw_departure": 0.2}}, "sw_departure"),
        ({"integrator": {"tol": 1e-8}}, "tol"),
    ],
)
def test_only_shares_of_one_config_are_joined(changes, word, plain, tmp_path):
    run_sweep(plan_of(model="full", **changes), tmp_path / "other", shard=Shard(0, 12))
    result = merge(plain, tmp_path / "other", "--output", tmp_path / "out")
    assert_refused(result, 2, "its config is not that of", word)
    assert not (tmp_path / "out").exists()


def test_directories_that_contradict_each_other_are_not_joined(plain, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(plain, other)
    store = merging.Store(other)
    found = store.read_block(3)
    table = found.table()
    wrong = table.set_column(
        table.schema.get_field_index("n_end"),
        table.schema.field("n_end"),
        [np.nextafter(table.column("n_end").to_numpy(), 1.0)],
    )
    store.write_block(3, wrong, found.note)
    result = merge(plain, other, "--output", tmp_path / "out")
    assert_refused(
        result, 1, "contradicts another directory's runs 96 to 127", "verify --recompute"
    )


def test_damage_is_not_passed_on(plain, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(plain, other)
    path = other / "runs" / "block-000005.parquet"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    assert_refused(merge(other, "--output", tmp_path / "out"), 1, f"{path} is damaged")
    # The work of others is not at risk: the next merge with a good copy ends well.
    shutil.copy(plain / "runs" / path.name, path)
    assert merge(other, "--output", tmp_path / "out").exit_code == 0
    assert content_hash(tmp_path / "out") == content_hash(plain)


def test_output_must_be_new(plain, tmp_path):
    assert_refused(merge(plain, "--output", plain), 2, "is one of the directories to be merged")
    used = tmp_path / "used"
    run_sweep(plan_of(seed=3), used, shard=Shard(0, 12))
    before = content_hash(used)
    assert_refused(merge(plain, "--output", used), 2, "it holds another sweep")
    assert content_hash(used) == before
    result = merge(tmp_path / "nothing", "--output", tmp_path / "out")
    assert_refused(result, 2, "is not an output directory")
