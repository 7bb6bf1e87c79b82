"""Merging the directories of shards, and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import sweeping
from hardship import check_equal, files_of
from refusal import assert_refused
from sweeping import invoke, tree

from rattlesweep.store.classify import classify_stored
from rattlesweep.work.run import Shard

CONFIG: dict[str, Any] = {
    "name": "shards",
    "seed": 11,
    "bodies": {
        "source": "sd",
        "samples": 30,
        "target": {"K_r": [0.03, 0.1], "rel_tol": 0.1},
    },
    "spin": {"n_i": [-0.1, -0.5, 0.2], "omega_xy0": [0.01, 0.1]},
    "model": "gh",
}
RUNS = 360


def sweep(output: Path, shard: tuple[int, int] | None = None, **changes: Any) -> Any:
    chosen = None if shard is None else Shard(*shard)
    return sweeping.sweep(output, CONFIG | changes, shard=chosen)


def merge(*directories: Path, to: Path) -> Any:
    return invoke("merge", *directories, "--output", to)


def files(directory: Path) -> dict[str, bytes]:
    return {
        name: data for name, data in tree(directory).items() if ".locks" not in name
    }


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Path:
    directory = tmp_path_factory.mktemp("plain") / "out"
    assert sweep(directory).summary is not None
    return directory


@pytest.fixture(scope="module")
def thirds(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("thirds")
    for index in range(3):
        sweep(folder / str(index), (index, 3))
    return [folder / str(index) for index in range(3)]


def test_shards_come_to_the_same_table_and_stay_as_they_are(plain, thirds, tmp_path):
    before = [files(third) for third in thirds]
    result = merge(*thirds, to=tmp_path / "out")
    assert (result.exit_code, len(result.stdout.splitlines())) == (0, 1 + 12)
    assert f"{RUNS} runs in 3 files" in result.stderr
    check_equal(tmp_path / "out", plain)
    assert sweep(tmp_path / "out").done == 0
    # Typing its runs again does not change the shards.
    classify_stored(tmp_path / "out", ["classify.sw_departure=1e-6"])
    assert [files(third) for third in thirds] == before


def test_a_missing_shard_is_said_and_run_or_merge_does_the_rest(
    plain, thirds, tmp_path
):
    result = merge(*thirds[:2], to=tmp_path / "a")
    assert result.exit_code == 75
    assert "120 runs missing; merge the other shards" in result.stderr
    assert not (tmp_path / "a" / "summary.parquet").exists()
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    assert sweep(tmp_path / "a").done == 120
    check_equal(tmp_path / "a", plain)
    # Files that are already there, as after a kill, are not added twice.
    assert merge(*thirds[1:], to=tmp_path / "b").exit_code == 0
    assert merge(*thirds, to=tmp_path / "b").exit_code == 0
    check_equal(tmp_path / "b", plain)


@pytest.mark.parametrize(
    ("changes", "code", "word"),
    [
        ({"seed": 12}, 2, "holds another sweep (seed: 1"),
        ({"classify": {"sw_departure": 0.2}}, 2, "types of different thresholds"),
        (
            {"spin": {"n_i": [0.2, -0.1], "omega_xy0": 0.1}},
            1,
            "numbers its cases differently than",
        ),
        (
            {
                "bodies": CONFIG["bodies"]
                | {"samples": 40, "target": {"K_r": [0.03], "rel_tol": 0.1}}
            },
            1,
            "these are two sweeps",
        ),
    ],
)
def test_only_shards_of_one_config_are_joined(changes, code, word, thirds, tmp_path):
    sweep(tmp_path / "other", (0, 12), **changes)
    result = merge(tmp_path / "other", thirds[1], to=tmp_path / "out")
    assert_refused(result, code, word)
    assert not (tmp_path / "out").exists()


def test_files_are_copied_and_linked_by_wish(plain, tmp_path):
    (path,) = files_of(plain)
    for folder, links in (("copied", 1), ("linked", 2)):
        command = ["merge", plain, "--output", tmp_path / folder]
        if links > 1:
            command.append("--link")
        assert invoke(*command).exit_code == 0
        (merged,) = files_of(tmp_path / folder)
        assert merged.samefile(path) == (links > 1)
        assert merged.stat().st_nlink == links
        check_equal(tmp_path / folder, plain)


@pytest.mark.parametrize("options", [(), ("--link",)])
def test_what_a_link_leads_to_is_merged_and_not_the_link(options, plain, tmp_path):
    linked = Path(shutil.copytree(plain, tmp_path / "linked"))
    store = tmp_path / "store"
    store.mkdir()
    (path,) = files_of(linked)
    path.rename(store / path.name)
    path.symlink_to(Path("../../store") / path.name)
    output = tmp_path / "deep" / "er" / "out"
    assert invoke("merge", linked, "--output", output, *options).exit_code == 0
    shutil.rmtree(store)
    (merged,) = files_of(output)
    assert not merged.is_symlink()
    check_equal(output, plain)


def test_what_is_there_twice_or_damaged_is_not_passed_on(plain, thirds, tmp_path):
    result = merge(plain, thirds[0], to=tmp_path / "a")
    assert_refused(result, 1, "holds runs that are stored twice")
    other = Path(shutil.copytree(thirds[0], tmp_path / "other"))
    (path,) = files_of(other)
    path.write_bytes(path.read_bytes()[:-9])
    result = merge(other, *thirds[1:], to=tmp_path / "b")
    assert_refused(result, 1, f"{path} is damaged; do its runs")
    # Nothing else is affected: the next merge succeeds with an undamaged copy.
    shutil.copy(files_of(thirds[0])[0], path)
    assert merge(other, *thirds[1:], to=tmp_path / "b").exit_code == 0
    check_equal(tmp_path / "b", plain)


def test_output_must_be_new(plain, thirds, tmp_path):
    assert_refused(merge(plain, to=plain), 2, "a directory is given twice")
    sweep(tmp_path / "used", (0, 12), seed=3)
    before = tree(tmp_path / "used")
    assert_refused(merge(plain, to=tmp_path / "used"), 2, "holds another sweep (seed")
    assert tree(tmp_path / "used") == before
    assert_refused(
        merge(tmp_path / "none", to=tmp_path / "out"), 2, "is not an output directory"
    )
