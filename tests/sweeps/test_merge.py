"""Shares of a sweep, dealt fairly, and what `merge` makes of their directories."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import sweeping
from refusal import assert_refused
from sweeping import content_hash, invoke, manifest, plan_of, proved, rows

from rattlesweep.sweeps.cost import Costs
from rattlesweep.sweeps.shards import Shard, deal
from rattlesweep.sweeps.old import merge as merging

CONFIG: dict[str, Any] = {
    "name": "shares",
    "seed": 11,
    "bodies": {"source": "sd", "samples": 30, "target": {"K_r": [0.03, 0.1], "rel_tol": 0.1}},
    "spin": {"n_i": [-0.1, -0.5, 0.2], "omega_xy0": [0.01, 0.1]},
    "model": "gh",
    "block_size": 32,
}


def sweep(output: Path, share: tuple[int, int] | None = None, **changes: Any) -> Any:
    shard = None if share is None else Shard(*share)
    return sweeping.sweep(output, CONFIG | changes, shard=shard)


def merge(*directories: Path, to: Path, options: tuple[str, ...] = ()) -> Any:
    return invoke("merge", *directories, "--output", to, *options)


def shares(place: Path, count: int) -> list[Path]:
    """Each share in a directory of its own."""
    for index in range(count):
        sweep(place / f"share-{index}", (index, count))
    return [place / f"share-{index}" for index in range(count)]


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Path:
    """The sweep done at once."""
    directory = tmp_path_factory.mktemp("plain") / "out"
    assert sweep(directory).summary is not None
    return directory


@pytest.fixture(scope="module")
def thirds(tmp_path_factory) -> list[Path]:
    return shares(tmp_path_factory.mktemp("thirds"), 3)


@pytest.mark.parametrize("count", [1, 2, 5, 12, 40])
def test_every_block_is_dealt_once_and_shares_cost_about_the_same(count):
    plan = plan_of(CONFIG, model="full")
    costs = Costs(plan)
    dealt = deal(plan, count, costs)
    assert sorted(block.index for part in dealt for block in part) == list(range(12))
    sums = [sum(costs.of(block) for block in part) for part in dealt]
    # No share is above the mean by more than one block.
    assert max(sums) <= np.mean(sums) + max(costs.of(plan.block(i)) for i in range(12))
    assert sums.count(0.0) == max(0, count - 12)


# -- the same table ----------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 7])
def test_shares_come_to_the_same_table(count, plain, tmp_path):
    merged = tmp_path / "merged"
    assert merge(*shares(tmp_path, count), to=merged).exit_code == 0
    assert proved(merged) == content_hash(plain)
    assert (merged / "summary.parquet").read_bytes() == (plain / "summary.parquet").read_bytes()
    assert len(list((merged / "runs").iterdir())) == 1  # 360 rows are one file


def test_files_hold_so_many_runs_and_an_interrupted_merge_goes_on(plain, tmp_path, monkeypatch):
    monkeypatch.setattr(merging, "MERGED_SIZE", 100)
    output, done, honest = tmp_path / "out", [], merging.Store.write_block

    def write(self: Any, index: int, *args: Any) -> Any:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(index)
        return honest(self, index, *args)

    monkeypatch.setattr(merging.Store, "write_block", write)
    assert merge(plain, to=output).exit_code == 130
    done.clear()
    result = merge(plain, to=output, options=("-q",))
    assert (result.exit_code, result.stdout) == (0, "")
    assert done == [2, 3]
    files = sorted((output / "runs").iterdir())
    assert [pq.read_metadata(f).num_rows for f in files] == [100, 100, 100, 60]
    assert proved(output) == content_hash(plain)
    said = manifest(output)
    assert (said["state"], said["blocks"], said["config"]["block_size"]) == ("complete", 4, 100)
    # An output directory like any other: nothing is left to run there.
    report = sweep(output)
    assert (report.resumed_runs, report.blocks) == (360, 0)


def test_a_missing_share_is_named_and_run_does_the_rest(plain, thirds, tmp_path):
    result = merge(*thirds[:2], to=tmp_path)
    assert result.exit_code == 75
    plan = plan_of(CONFIG)
    absent = {block.index for block in deal(plan, 3, Costs(plan))[2]}
    assert f"missing: runs {32 * min(absent)} to " in result.stderr
    assert "merge the other shards too, with the same --output" in result.stderr
    assert not (tmp_path / "summary.parquet").exists()
    assert len(rows(tmp_path)) == sum(plan.block(i).rows for i in range(12) if i not in absent)
    proved(tmp_path)
    assert sweep(tmp_path).missing == 0
    assert proved(tmp_path) == content_hash(plain)


@pytest.mark.parametrize("again", [0, 2], ids=["all", "the rest"])
def test_another_merge_completes_what_is_there(again, plain, thirds, tmp_path):
    assert merge(*thirds[:2], to=tmp_path).exit_code == 75
    result = merge(*thirds[again:], to=tmp_path)
    assert result.exit_code == 0, result.stderr
    assert "missing" not in result.stderr
    assert "360 runs in 12 files" in result.stderr
    assert proved(tmp_path) == content_hash(plain)
    # Of all that was done, each session once.
    said, parts = manifest(tmp_path), [manifest(third) for third in thirds]
    assert said["state"] == "complete"
    assert [s["shard"] for s in said["sessions"]] == ["0/3", "1/3", "2/3"]
    for key in ("seconds", "kernel_seconds"):
        assert said[key] == pytest.approx(sum(part[key] for part in parts), abs=1e-2)
    assert said["peak_memory"] == max(part["peak_memory"] for part in parts)
    assert said["bytes"] == sum(f.stat().st_size for f in (tmp_path / "runs").iterdir())
    assert all(part["command"] in said["commands"] for part in parts)
    assert all("command" in session for session in said["sessions"])


def test_blocks_of_other_sizes_and_more_than_was_given(plain, tmp_path):
    """The directory is judged, and not what was given to this merge."""
    halves, other = shares(tmp_path, 2), tmp_path / "other"
    sweep(other, (0, 2), block_size=50)
    assert merge(other, *halves, to=tmp_path / "all").exit_code == 0
    assert merge(halves[0], to=tmp_path / "all").exit_code == 0
    assert content_hash(tmp_path / "all") == content_hash(plain)
    # Blocks of 32 that cover no block of 50 as a whole are not in the output.
    result = merge(other, halves[0], to=tmp_path / "mixed")
    files = list((tmp_path / "mixed" / "runs").iterdir())
    runs = sum(pq.read_metadata(file).num_rows for file in files)
    assert result.exit_code == 75
    assert f"{runs} runs in {len(files)} files" in result.stderr
    spans = re.findall(r"(\d+) to (\d+)", result.stderr.split("missing: runs ")[1])
    assert sum(int(b) - int(a) + 1 for a, b in spans) == 360 - runs


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
    sweep(tmp_path / "other", (0, 12), **changes)
    result = merge(plain, tmp_path / "other", to=tmp_path / "out")
    assert_refused(result, 2, "its config is not that of", word)
    assert not (tmp_path / "out").exists()


def test_what_contradicts_or_is_damaged_is_not_passed_on(plain, tmp_path):
    other, output = Path(shutil.copytree(plain, tmp_path / "other")), tmp_path / "out"
    store = merging.Store(other)
    found = store.read_block(3)
    place, values = found.schema.get_field_index("n_end"), found.table()["n_end"].to_numpy()
    wrong = found.table().set_column(place, found.schema.field(place), [np.nextafter(values, 1.0)])
    store.write_block(3, wrong, found.note)
    words = ("contradicts another directory's runs 96 to 127", "verify --recompute")
    assert_refused(merge(plain, other, to=output), 1, *words)
    path = other / "runs" / "block-000003.parquet"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    output = tmp_path / "next"
    assert_refused(merge(other, to=output), 1, f"{path} is damaged")
    # The work of others is not at risk: the next merge with a good copy ends well.
    shutil.copy(plain / "runs" / path.name, path)
    assert merge(other, to=output).exit_code == 0
    assert content_hash(output) == content_hash(plain)


def test_output_must_be_new(plain, tmp_path):
    assert_refused(merge(plain, to=plain), 2, "is one of the directories to be merged")
    used = tmp_path / "used"
    sweep(used, (0, 12), seed=3)
    before = content_hash(used)
    assert_refused(merge(plain, to=used), 2, "it holds another sweep")
    assert content_hash(used) == before
    result = merge(tmp_path / "nothing", to=tmp_path / "out")
    assert_refused(result, 2, "is not an output directory")
