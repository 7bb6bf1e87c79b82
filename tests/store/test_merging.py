"""Files of rows grow and are merged; no reader sees a row twice or misses one."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import sweeping
from hardship import check_equal, files_of
from sweeping import invoke, plan_of

from rattlesweep.design.plan import Case
from rattlesweep.store import merging
from rattlesweep.store import rows as stores
from rattlesweep.store.manifest import examine
from rattlesweep.store.parquet import read_parquet, write_parquet
from rattlesweep.store.progress import status
from rattlesweep.store.rows import KEY, metadata, open_stored
from rattlesweep.words.errors import OutputError
from rattlesweep.work import job as jobs
from rattlesweep.work import verify as verifying
from rattlesweep.work.run import Shard
from rattlesweep.work.verify import verify

RUNS = 400
CONFIG: dict[str, Any] = {
    "name": "merges",
    "bodies": {"source": "sd", "samples": RUNS // 4},
    "spin": {"n_i": [-0.2, -0.1, 0.1, 0.2], "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 1000},
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("whole") / "out"
    sweeping.sweep(output, CONFIG)
    return output


@pytest.fixture(scope="module")
def scattered(tmp_path_factory) -> Path:
    """The same rows in files of 10, as many short sessions leave them."""
    output = tmp_path_factory.mktemp("scattered") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs, "MAX_BLOCK_RUNS", 10)
        patch.setattr(merging, "FILE_BYTES", 1)
        sweeping.sweep(output, CONFIG)
    assert len(files_of(output)) == RUNS // 10
    return output


@pytest.fixture
def output(scattered, tmp_path) -> Path:
    return Path(shutil.copytree(scattered, tmp_path / "out"))


def in_order_of(path: Path) -> list[tuple[int, int]]:
    rows = read_parquet(path, KEY)
    return [(row["case"], row["sample"]) for row in rows.to_pylist()]


def keys_in(path: Path) -> set[tuple[int, int]]:
    return set(in_order_of(path))


def test_a_file_grows_until_it_is_large_and_keeps_its_rows(
    whole, tmp_path, monkeypatch
):
    """What another program reads between any two blocks, file by file."""
    monkeypatch.setattr(jobs, "MAX_BLOCK_RUNS", 10)
    monkeypatch.setattr(merging, "FILE_BYTES", 20_000)
    seen: dict[str, set[tuple[int, int]]] = {}

    def look(progress: Any) -> None:
        now = {path.name: keys_in(path) for path in files_of(tmp_path)}
        for name, keys in seen.items():
            assert keys <= now[name]
        assert sum(map(len, now.values())) == len(set().union(*now.values()))
        seen.update(now)

    sweeping.sweep(tmp_path, CONFIG, report=look)
    sizes = sorted(read_parquet(path).nbytes for path in files_of(tmp_path))
    assert 3 <= len(sizes) <= 12
    assert sizes[1] >= 20_000
    check_equal(tmp_path, whole)


def test_small_files_are_merged_when_a_session_begins(output, whole, monkeypatch):
    before = {path.name for path in files_of(output)}
    monkeypatch.setattr(merging, "FILE_BYTES", 80_000)
    result = invoke("classify", output)
    assert result.exit_code == 0
    merged = files_of(output)
    assert len(merged) < 10
    # A slow reader that has listed the old files finds none of them with other rows.
    assert not before & {path.name for path in merged}
    check_equal(output, whole)


def test_few_small_files_stay_as_they_are(output, whole, monkeypatch):
    monkeypatch.setattr(merging, "MANY_FILES", len(files_of(output)) + 1)
    before = sweeping.tree(output / "runs")
    sweeping.sweep(output, CONFIG)
    assert sweeping.tree(output / "runs") == before


def test_a_shard_merges_its_own_files_alone(tmp_path, whole, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(jobs, "MAX_BLOCK_RUNS", 10)
        patch.setattr(merging, "FILE_BYTES", 1)
        for index in range(2):
            sweeping.sweep(tmp_path, CONFIG, shard=Shard(index, 2))
    of_second = {path: path.read_bytes() for path in files_of(tmp_path)}
    for path in list(of_second):
        if sum(next(iter(keys_in(path)))) % 2 == 0:
            del of_second[path]
    sweeping.sweep(tmp_path, CONFIG, shard=Shard(0, 2))
    assert {path: path.read_bytes() for path in of_second} == of_second
    assert len(files_of(tmp_path)) == len(of_second) + 1
    check_equal(tmp_path, whole)


@pytest.fixture
def interrupted(output, monkeypatch) -> Path:
    """A directory whose merge was killed when half of its sources were removed."""
    honest = merging._take_place

    def killed(stored: Any, merged: Path, sources: list[Path]) -> None:
        for path in sources[::2]:
            path.unlink()
        raise KeyboardInterrupt

    monkeypatch.setattr(merging, "_take_place", killed)
    with pytest.raises(KeyboardInterrupt):
        sweeping.sweep(output, CONFIG)
    monkeypatch.setattr(merging, "_take_place", honest)
    assert len(files_of(output)) == RUNS // 20
    return output


def test_a_killed_merge_loses_nothing_and_is_finished_by_the_next(interrupted, whole):
    stored = open_stored(interrupted)
    assert (stored.count(), stored.find().rows) == (RUNS, RUNS)
    assert status(interrupted).data["runs"] == RUNS
    assert stored.read().equals(open_stored(whole).read())
    assert verify(interrupted).problems == []
    sweeping.sweep(interrupted, CONFIG)
    (path,) = files_of(interrupted)
    assert path.parent.name == "runs"
    check_equal(interrupted, whole)


def test_a_new_file_with_the_name_of_a_source_is_kept(interrupted):
    """Sources are known by their contents, not by names alone."""
    stored = open_stored(interrupted)
    (merged,) = (interrupted / "merging").iterdir()
    left = files_of(interrupted)[0]
    rows = read_parquet(left)
    others = pa.array([key not in keys_in(left) for key in in_order_of(merged)])
    labels = metadata(read_parquet(merged))
    whole = read_parquet(merged).replace_schema_metadata(None)
    write_parquet(whole.filter(others), merged, labels)
    # The same rows, written by another version, say.
    write_parquet(rows.replace_schema_metadata(None), left, metadata(rows) | {"a": "b"})
    assert stored.count() == RUNS
    assert stored.find().rows == RUNS


def test_a_damaged_merged_file_stands_for_nothing(interrupted, whole):
    (merged,) = (interrupted / "merging").iterdir()
    merged.write_bytes(merged.read_bytes()[:-1] + b"?")
    result = invoke("status", interrupted)
    assert (result.exit_code, "is damaged" in result.stderr) == (1, True)
    job = sweeping.sweep(interrupted, CONFIG)
    assert job.done == RUNS // 2
    shutil.rmtree(interrupted / "damaged")
    check_equal(interrupted, whole)


@pytest.mark.parametrize("after", range(0, RUNS, 45))
def test_files_are_merged_while_they_are_read(after, output, whole, monkeypatch):
    monkeypatch.setattr(stores, "BATCH_ROWS", 1)
    batches = open_stored(output).batches()
    rows = []
    for batch in batches:
        rows.append(batch)
        if sum(map(len, rows)) > after:
            break
    sweeping.sweep(output, CONFIG)
    assert len(files_of(output)) == 1
    table = pa.Table.from_batches([*rows, *batches])
    assert table.equals(open_stored(whole).read().replace_schema_metadata(None))


def test_a_look_begins_again_if_a_file_is_gone(output, monkeypatch):
    honest = stores.read_parquet
    merges: Iterator[None] = iter([None])

    def late(path: Path, *args: Any, **kwargs: Any) -> pa.Table:
        for _ in merges:  # once, after the files were listed
            with monkeypatch.context() as patch:
                patch.setattr(stores, "read_parquet", honest)
                sweeping.sweep(output, CONFIG)
        return honest(path, *args, **kwargs)

    monkeypatch.setattr(stores, "read_parquet", late)
    assert open_stored(output).find().rows == RUNS


def test_verify_looks_again_if_files_are_merged_meanwhile(output, monkeypatch):
    honest = verifying.with_types
    merges: Iterator[None] = iter([None])

    def late(*args: Any) -> pa.Table:
        for _ in merges:  # once, after the first file of many was read
            sweeping.sweep(output, CONFIG)
        return honest(*args)

    monkeypatch.setattr(verifying, "with_types", late)
    result = verify(output, recompute=3, complete=True)
    assert (result.problems, result.runs, result.files) == ([], RUNS, 1)


def test_thresholds_are_found_while_files_are_merged(output, monkeypatch):
    honest = stores.typed_by
    merges: Iterator[None] = iter([None])

    def late(path: Path) -> str:
        for _ in merges:
            sweeping.sweep(output, CONFIG)
        return honest(path)

    monkeypatch.setattr(stores, "typed_by", late)
    stored = open_stored(output)
    assert stored.thresholds == stored.config.classify


def test_a_merge_that_another_shard_finishes_meanwhile_is_no_error(
    interrupted, monkeypatch
):
    stored = open_stored(interrupted)
    honest = stores.Stored.rows_of

    def late(self: stores.Stored, *args: Any) -> pa.Table:
        monkeypatch.setattr(stores.Stored, "rows_of", honest)
        merging.find_merged(stored, merging.all_runs)
        return honest(self, *args)

    monkeypatch.setattr(stores.Stored, "rows_of", late)
    assert merging.find_merged(stored, Shard(0, 2).has).rows == RUNS
    assert verify(interrupted).problems == []


def test_a_damaged_file_that_another_shard_sets_aside_meanwhile_is_no_error(output):
    path = files_of(output)[0]
    path.write_bytes(path.read_bytes()[:-1] + b"?")
    stored = open_stored(output)
    (moved,) = stored.set_aside([path])
    assert moved.parent.name == "damaged"
    # This shard had found it, too.
    assert stored.set_aside([path]) == []


@pytest.mark.parametrize("link", [False, True])
def test_a_source_that_has_merged_its_files_is_merged_again(
    link, output, whole, tmp_path
):
    """Rows that are there are left out; the new ones among them are added."""
    options = ["--link"] * link
    merged = tmp_path / "merged"
    later = files_of(output)[1::2]
    for path in later:
        path.rename(tmp_path / path.name)
    assert invoke("merge", output, "--output", merged, *options).exit_code == 75
    for path in later:
        (tmp_path / path.name).rename(path)
    sweeping.sweep(output, CONFIG)
    assert len(files_of(output)) == 1
    for _ in range(2):
        result = invoke("merge", output, "--output", merged, *options)
        assert (result.exit_code, f"{RUNS} runs in" in result.stderr) == (0, True)
        check_equal(merged, whole)
    assert len(files_of(merged)) == RUNS // 20 + 1


def test_other_values_of_the_same_runs_are_not_merged(output, tmp_path):
    merged = tmp_path / "merged"
    assert invoke("merge", output, "--output", merged).exit_code == 0
    sweeping.sweep(output, CONFIG)
    (path,) = files_of(output)
    rows = read_parquet(path)
    place = rows.schema.get_field_index("alpha")
    values = rows["alpha"].to_numpy().copy()
    values[-1] = np.nextafter(values[-1], 0)
    labels = metadata(rows)
    changed = rows.set_column(place, rows.schema.field(place), pa.array(values))
    write_parquet(changed.replace_schema_metadata(None), path, labels)
    before = sweeping.tree(merged / "runs")
    result = invoke("merge", output, "--output", merged)
    what = "hold other values of the same runs"
    assert (result.exit_code, what in result.stderr) == (1, True)
    assert sweeping.tree(merged / "runs") == before


def huge(path: Path, rows: int) -> None:
    """Write a small file of very many rows, all alike."""
    first = pq.read_table(path).slice(0, 1)
    piece = first.take(pa.array(np.zeros(1 << 18, int)))
    with pq.ParquetWriter(path, piece.schema, compression="zstd") as writer:
        for _ in range(rows >> 18):
            writer.write_table(piece)


def test_a_file_of_too_many_rows_is_refused_unread(output, monkeypatch):
    path = files_of(output)[3]
    huge(path, 1 << 20)
    monkeypatch.setattr(
        stores.pq.ParquetFile, "read", lambda *_: pytest.fail("the rows are read")
    )
    with pytest.raises(OutputError, match=f"{path} holds 1,048,576 runs, more than"):
        open_stored(output).find([path])


def test_cases_are_looked_at_in_proportion_to_their_number(tmp_path, monkeypatch):
    hashed = []
    honest = Case.__hash__

    def counting(case: Case) -> int:
        hashed.append(case)
        return honest(case)

    plan = plan_of(
        CONFIG, spin={"n_i": np.linspace(0.1, 0.4, 200).tolist()} | {"omega_xy0": 0.01}
    )
    examined = examine(plan, tmp_path)[1]
    (tmp_path / "runs").mkdir()
    examined.write_manifest()
    monkeypatch.setattr(Case, "__hash__", counting)
    examine(plan, tmp_path)
    assert len(hashed) <= 10 * 200
