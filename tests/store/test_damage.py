"""Files that change behind the program's back: `verify` finds it, `run` does the runs again."""

from __future__ import annotations

import json
import os
import random
import shutil
import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hardship import (
    OTHER_TYPES,
    Reference,
    blocks_of,
    check_finished,
    everything_in,
    manifest,
    nursery,
    one_sentence,
    tiny,
)

import rattlesweep as rs
from rattlesweep.errors import ConfigError, OutputError, printable
from rattlesweep.sweeps.inspect.status import describe, status_of
from rattlesweep.sweeps.inspect.verify import _choose, verify
from rattlesweep.sweeps.store import sealed as sealedjson
from rattlesweep.sweeps.store.store import Store

FIRST, LAST = "runs/block-000000.parquet", "runs/block-000003.parquet"
FILES = [FIRST, LAST, "manifest.json", "summary.parquet"]


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Reference]:
    """A config of four blocks, its sweep, and that remembered."""
    folder = tmp_path_factory.mktemp("sweep")
    config = tiny(folder, block_size=6)
    assert nursery().run("run", config, "--output", folder / "out", "-q").code == 0
    return config, folder / "out", Reference.of(folder / "out")


@pytest.fixture
def output(sweep: tuple[Path, Path, Reference], tmp_path: Path) -> Path:
    """A copy of the sweep, to be damaged."""
    return Path(shutil.copytree(sweep[1], tmp_path / "out"))


def found(directory: Path) -> list[str]:
    """What `verify` complains of; the command line says the same."""
    problems = verify(directory).problems
    done = nursery().run("verify", directory)
    assert done.code == (1 if problems else 0), done
    assert done.out.splitlines() == problems
    return problems


def check_mended(sweep: tuple[Path, Path, Reference], directory: Path) -> None:
    done = nursery().run("run", sweep[0], "--output", directory, "-q")
    assert done.code == 0, done
    check_finished(directory, sweep[2])
    assert found(directory) == []


def check_every(
    sweep: tuple[Path, Path, Reference],
    directory: Path,
    name: str,
    versions: Iterable[bytes],
    mend_every: int,
    verify_every: int = 1,
) -> int:
    """Put damaged versions in a file's place: each is found; some by `verify` too, some mended."""
    path, original, count = directory / name, (directory / name).read_bytes(), 0
    store = Store(directory)
    read: Callable[[], object] = {
        "manifest.json": store.read_manifest,
        "summary.parquet": store.read_summary,
    }.get(name, lambda: store.read_block(int(path.stem.split("-")[1])))
    for damaged in versions:
        assert damaged != original
        path.write_bytes(damaged)
        with pytest.raises(OutputError):
            read()
        if count % verify_every == 0:
            problems = verify(directory).problems
            assert any(str(path) in problem for problem in problems), (count, problems)
        if count % mend_every == 0:
            check_mended(sweep, directory)
            if name.startswith("runs/"):
                assert path.read_bytes() == original
        count += 1
    path.write_bytes(original)
    return count


def flipped(data: bytes, places: Iterable[int], rng: random.Random) -> Iterable[bytes]:
    for place in places:
        changed = bytearray(data)
        changed[place] ^= 1 << rng.randrange(8)
        yield bytes(changed)


@pytest.mark.parametrize("name", FILES)
def test_flipped_bits_are_found_and_mended(name, sweep, output, record_property):
    data, rng = (output / name).read_bytes(), random.Random(2017)
    places = {*range(8), *range(len(data) - 8, len(data))}
    places |= {rng.randrange(len(data)) for _ in range(20)}
    if name.endswith(".parquet"):
        footer = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
        places |= {*range(footer, len(data), (len(data) - footer) // 24)}
    count = check_every(sweep, output, name, flipped(data, sorted(places), rng), mend_every=12)
    assert count > 30
    record_property("offsets", count)


@pytest.mark.parametrize("name", FILES)
def test_lost_ends_are_found_and_mended(name, sweep, output, record_property):
    data = (output / name).read_bytes()
    lengths = sorted({0, 1, 4, 7, 8, *range(9, len(data), len(data) // 8), len(data) - 1})
    versions = [*(data[:length] for length in lengths), data + b"\0", data + data, bytes(len(data))]
    count = check_every(sweep, output, name, versions, mend_every=8)
    record_property("lengths", count)


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES[1:])
def test_every_flipped_byte_is_found(name, sweep, output, record_property):
    data, rng = (output / name).read_bytes(), random.Random(1)
    count = check_every(
        sweep, output, name, flipped(data, range(len(data)), rng), mend_every=97, verify_every=11
    )
    assert count == len(data)
    record_property("offsets", count)


@pytest.mark.slow
@pytest.mark.parametrize("name", [LAST, "manifest.json"])
def test_every_lost_end_is_found(name, sweep, output, record_property):
    data = (output / name).read_bytes()
    versions = (data[:length] for length in range(len(data)))
    count = check_every(sweep, output, name, versions, mend_every=97, verify_every=11)
    record_property("lengths", count)


def swap(directory: Path, other: Path) -> None:
    one, two = directory / FIRST, directory / LAST
    a, b = one.read_bytes(), two.read_bytes()
    one.write_bytes(b)
    two.write_bytes(a)


def of_another_seed(directory: Path, other: Path) -> None:
    shutil.copy(other / LAST, directory / LAST)


def twice(directory: Path, other: Path) -> None:
    shutil.copy(directory / FIRST, directory / "runs/block-000004.parquet")


def twice_far_off(directory: Path, other: Path) -> None:
    shutil.copy(directory / FIRST, directory / "runs/block-123456.parquet")


def twice_by_hand(directory: Path, other: Path) -> None:
    shutil.copy(directory / FIRST, directory / "runs/block-000000 (copy).parquet")


def deleted(directory: Path, other: Path) -> None:
    (directory / FIRST).unlink()


def all_deleted(directory: Path, other: Path) -> None:
    shutil.rmtree(directory / "runs")


def empty(directory: Path, other: Path) -> None:
    (directory / LAST).write_bytes(b"")


def no_summary(directory: Path, other: Path) -> None:
    (directory / "summary.parquet").unlink()


def summary_of_another(directory: Path, other: Path) -> None:
    shutil.copy(other / "summary.parquet", directory / "summary.parquet")


def receipts_of_another(directory: Path, other: Path) -> None:
    """Not damage but malice: the seal is whole."""
    said = manifest(directory) | {"receipts": manifest(other)["receipts"]}
    (directory / "manifest.json").write_bytes(sealedjson.dump(said))


def without_receipts(directory: Path, other: Path) -> None:
    said = manifest(directory) | {"receipts": {}}
    (directory / "manifest.json").write_bytes(sealedjson.dump(said))


def left_behind(directory: Path, other: Path) -> None:
    (directory / "runs/.block-000001.parquet.0123abcd.tmp").write_bytes(b"half")
    (directory / ".manifest.json.0123abcd.tmp").write_bytes(b"half")


def everything_at_once(directory: Path, other: Path) -> None:
    swap(directory, other)
    for name in ("runs/block-000001.parquet", "manifest.json", "summary.parquet"):
        (directory / name).write_bytes((directory / name).read_bytes()[:-20])
    left_behind(directory, other)


@pytest.mark.parametrize(
    "harm",
    [
        swap, of_another_seed, twice, twice_far_off, twice_by_hand, deleted, all_deleted, empty,
        no_summary, summary_of_another, receipts_of_another, without_receipts, left_behind,
        everything_at_once,
    ],
    ids=lambda harm: harm.__name__,
)  # fmt: skip
def test_files_in_the_wrong_place_are_found_and_mended(
    harm: Callable[[Path, Path], None], sweep, output, other_seed
):
    harm(output, other_seed)
    assert found(output)
    check_mended(sweep, output)


@pytest.fixture(scope="module")
def other_seed(
    sweep: tuple[Path, Path, Reference], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A sweep of the same shape with other bodies."""
    output = tmp_path_factory.mktemp("other") / "out"
    done = nursery().run("run", sweep[0], "--output", output, "--set", "seed=1", "-q")
    assert done.code == 0
    assert not set(blocks_of(output).values()) & set(sweep[2].runs.values())
    return output


def test_the_manifest_of_another_sweep_is_refused(sweep, output, other_seed):
    shutil.copy(other_seed / "manifest.json", output / "manifest.json")
    before = everything_in(output), blocks_of(output)
    assert len(found(output)) >= 4
    done = nursery().run("run", sweep[0], "--output", output, "-q")
    assert done.code == 2
    assert one_sentence(done.err)
    assert "it holds the runs of another config (seed: 1 against 0)" in done.err
    assert (everything_in(output), blocks_of(output)) == before
    # Without it, the blocks say of which sweep they are.
    (output / "manifest.json").unlink()
    check_mended(sweep, output)


@pytest.mark.parametrize("size", [4, 10, 100])
def test_the_manifest_of_the_same_sweep_in_other_blocks(size, sweep, output, tmp_path):
    other = tmp_path / "other"
    options = ("--set", f"block_size={size}", "-q")
    assert nursery().run("run", sweep[0], "--output", other, *options).code == 0
    shutil.copy(other / "manifest.json", output / "manifest.json")
    assert found(output)
    done = nursery().run("run", sweep[0], "--output", output, "-q")
    assert done.code == 0
    check_finished(output, Reference.of(other))
    assert Reference.of(output).hash == sweep[2].hash


def test_the_manifest_of_an_earlier_day(sweep, output, tmp_path):
    """From a backup: all blocks are there, and the manifest knows of none."""
    said = manifest(output)
    earlier = {key: value for key, value in said.items() if key != "finished"}
    earlier |= {"state": "running", "receipts": {}}
    earlier["sessions"] = [s | {"state": "running"} for s in said["sessions"]]
    (output / "manifest.json").write_bytes(sealedjson.dump(earlier))
    check_mended(sweep, output)


def test_a_file_that_is_nobodys_is_left_alone(sweep, output, other_seed):
    """A block of another sweep, by a name that ours do not have, may be all there is of it."""
    stranger = output / "runs/block-000007.parquet"
    shutil.copy(other_seed / FIRST, stranger)
    assert len(found(output)) == 1
    done = nursery().run("run", sweep[0], "--output", output, "-q")
    assert done.code == 1
    assert done.err == f"error: {stranger} is no block of this sweep; move it elsewhere\n"
    stranger = stranger.rename(output / "runs/mine.parquet")
    done = nursery().run("run", sweep[0], "--output", output, "-q")
    assert done.code == 0
    remark = f"{stranger} is no block of this sweep, but readers take it for one"
    assert done.err == f"note: {remark}\n"
    assert stranger.read_bytes() == (other_seed / FIRST).read_bytes()
    stranger.unlink()
    check_mended(sweep, output)


def test_a_damaged_sweep_is_not_typed_merged_or_loaded_as_if_whole(sweep, output, tmp_path):
    data = bytearray((output / LAST).read_bytes())
    data[len(data) // 2] ^= 4
    (output / LAST).write_bytes(data)
    for command in (["classify", output, "--set", OTHER_TYPES],
                    ["merge", output, "--output", tmp_path / "merged"]):  # fmt: skip
        done = nursery().run(*command)
        assert done.code == 1
        assert one_sentence(done.err)
        assert str(output / LAST) in done.err
    assert json.loads((output / "manifest.json").read_text())["state"] == "complete"
    check_mended(sweep, output)


# -- what is no file, or no file of ours -----------------------------------------------------------


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("kind", ["fifo", "device", "huge"])
def test_what_is_no_block_is_not_waited_for(kind, name, sweep, output):
    """In the place of a file: a FIFO nobody writes to, zeros without end, a terabyte of a hole."""
    path = output / name
    path.unlink()
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.touch()
        os.truncate(path, 1 << 40)
    assert any(str(path) in problem for problem in found(output))
    for command in (["status", output], ["classify", output]):
        assert nursery().run(*command).code in (0, 1, 2)
    check_mended(sweep, output)


def test_a_block_under_another_name_is_put_in_its_place(sweep, output):
    """It is the only copy: nothing is done again."""
    (output / LAST).rename(output / "runs/block-000777.parquet")
    (output / FIRST).write_bytes(b"damaged")
    shutil.copy(output / "runs/block-000001.parquet", output / "runs/copy of 1.parquet")
    done = nursery().run("run", sweep[0], "--output", output, "-q")
    assert done.code == 0
    assert "block-000777.parquet to block-000003.parquet, whose runs it holds" in done.err
    assert "copy of 1.parquet: a copy of block-000001.parquet" in done.err
    assert manifest(output)["sessions"][-1]["blocks"] == 1
    check_finished(output, sweep[2])


def test_status_counts_blocks_of_its_sweep_only(sweep, output):
    shutil.copy(output / FIRST, output / "runs/block-123456.parquet")
    for receipts in ("with", "without"):
        if receipts == "without":
            without_receipts(output, output)
        done = nursery().run("status", output)
        assert "runs     24 of 24 done (100.0 %)" in done.out
        assert "blocks   4 of 4" in done.out
        assert "strays   block-123456.parquet: no block of this sweep" in done.out
    (output / "runs/block-123456.parquet").unlink()
    swap(output, output)
    assert "damaged  blocks 0, 3" in nursery().run("status", output).out


# -- a manifest whose seal is whole, and which says what cannot be ---------------------------------

ABSURD: list[Any] = [None, -1, 10**15, 1e308, "\x1b[2J", [], {}, True]


def places_in(data: Any, key: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every key of every mapping and list, outermost first."""
    items = data.items() if isinstance(data, dict) else enumerate(data[:1])
    for name, value in items:
        yield (*key, name)
        if isinstance(value, dict | list):
            yield from places_in(value, (*key, name))


def tampered(said: dict[str, Any], key: tuple[Any, ...], value: Any) -> bytes:
    changed = json.loads(json.dumps(said))
    inner = changed
    for part in key[:-1]:
        inner = inner[part]
    inner[key[-1]] = value
    return sealedjson.dump(changed)


def test_a_tampered_manifest_is_one_sentence_everywhere(sweep, output, tmp_path, record_property):
    """No field of it, whatever it says, is good for a traceback or for an endless loop."""
    said = manifest(output)
    said["expected"] = {"seconds": 1.0, "low": 0.5, "high": 2.0}
    said["sessions"][0] |= {"progress": {"at": said["started"], "left": 3.0}}
    count = refusals = 0
    for key in [*places_in(said)]:
        for value in ABSURD:
            (output / "manifest.json").write_bytes(tampered(said, key, value))
            for look in (
                lambda: describe(status_of(output)),
                lambda: "\n".join(verify(output).problems),
                lambda: str(rs.load(output).manifest["runs"]),
            ):
                try:
                    words = look()
                except (ConfigError, OutputError) as error:
                    words = str(error)
                    refusals += 1
                assert printable(words) == words, (key, value)
            count += 1
    assert count > 300
    assert refusals > count
    record_property("manifests", count)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        (("blocks",), 10**15, "its blocks are not those of its runs"),
        (("samples",), 10**12, "its samples are not those of its config"),
        (("runs",), 25, "its runs are not cases times samples"),
        (("sessions", 0, "started"), "yesterday", "sessions.0.started: Invalid isoformat"),
        (("receipts", "0", "rows"), -1, "receipts.0.rows: "),
        (("config", "block_size"), 10**9, "config: block_size: "),
        (("cases",), [], "cases: "),
        (("machine",), None, "machine: "),
    ],
)
def test_a_tampered_manifest_is_named_and_mended(key, value, words, sweep, output, tmp_path):
    (output / "manifest.json").write_bytes(tampered(manifest(output), key, value))
    problems = found(output)
    assert len(problems) == 1
    assert f"manifest.json is damaged: {words}" in problems[0]
    for command in (
        ["status", output],
        ["classify", output],
        ["merge", output, "--output", tmp_path / "merged"],
        ["plot", output],
        ["report", output],
        ["replay", output, "--case", "0", "--sample", "0"],
    ):
        done = nursery().run(*command)
        assert done.code in (1, 2), done
        assert "Traceback" not in done.err, done
    check_mended(sweep, output)


def test_escapes_in_a_manifest_reach_no_terminal(sweep, output):
    said = manifest(output)
    said["name"] = "\x1b]0;owned\x07"
    said["versions"]["numpy"] = "\x1b[2J1.0"
    (output / "manifest.json").write_bytes(sealedjson.dump(said))
    done = nursery().run("status", output)
    assert "\\x1b]0;owned\\x07" in done.out
    again = nursery().run("run", sweep[0], "--output", output, "-q")
    assert "begun with other versions" in again.err
    assert "\x1b" not in done.out + again.err


def test_another_number_of_processors_changes_no_bit(sweep, output):
    """Results do not depend on it, so nothing is said."""
    said = manifest(output)
    said["machine"]["processors"] += 62
    (output / "manifest.json").write_bytes(sealedjson.dump(said))
    assert nursery().run("run", sweep[0], "--output", output, "-q").err == ""
    said["machine"]["cpu"] = "another"
    (output / "manifest.json").write_bytes(sealedjson.dump(said))
    err = nursery().run("run", sweep[0], "--output", output, "-q").err
    assert "was begun with other machine (cpu:" in err
    assert "processors" not in err


# -- what is somebody else's -----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["manifest.json", "summary.parquet", "notes.txt"])
def test_a_foreign_directory_is_refused(name, sweep, output, tmp_path):
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    if name == "summary.parquet":
        pd.DataFrame({"mine": [1.0]}).to_parquet(theirs / name)
    else:
        (theirs / name).write_text('{"name": "app", "icons": []}')
    before = (theirs / name).read_bytes()
    run = ["run", sweep[0], "--output", theirs, "-q"]
    for command in (run, [*run, "--fresh"], [*run, "--dry-run"], [*run, "--shard", "0/2"],
                    ["merge", output, "--output", theirs]):  # fmt: skip
        done = nursery().run(*command)
        assert done.code == 2, done
        assert one_sentence(done.err)
        assert f"{theirs}: it is not empty, and what it holds ({name}) is no sweep" in done.err
        assert everything_in(theirs) == {name}
        assert (theirs / name).read_bytes() == before
    # What is hidden is not in the way, and an empty directory is as good as none.
    (theirs / name).rename(theirs / ".hidden")
    assert nursery().run(*run).code == 0


@pytest.mark.parametrize("where", ["runs", "runs/block-000002.parquet", "."])
def test_fresh_does_not_remove_its_own_input(where, sweep, output, tmp_path):
    """A table source may be the output of a sweep: the one that is about to be removed too."""
    config = tiny(tmp_path, bodies=f"{{source: table, path: {output / where}}}")
    before = blocks_of(output)
    done = nursery().run("run", config, "--output", output, "--fresh", "-q")
    assert done.code == 2, done
    assert one_sentence(done.err)
    if where != ".":  # the summary is no table of bodies
        assert "which this sweep takes its bodies from" in done.err
    assert blocks_of(output) == before
    assert verify(output).problems == []


# -- what a look costs -----------------------------------------------------------------------------


def test_runs_are_chosen_without_a_list_of_all():
    spans = [(first, first + 10_000) for first in range(0, 10**8, 20_000)]
    tracemalloc.start()
    chosen = _choose(spans, 100, 1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e6
    assert len(set(chosen)) == 100
    assert np.all(chosen % 20_000 < 10_000)
    assert chosen.max() > 5 * 10**7
    few = [(5, 8), (11, 12)]
    assert _choose(few, 9, 1).tolist() == [5, 6, 7, 11]
    assert {n for k in range(100) for n in _choose(few, 1, k)} == {5, 6, 7, 11}
    assert len(_choose([], 3, 1)) == 0


def test_verify_takes_as_many_threads_as_there_are(output):
    done = nursery().run("verify", output, "--recompute", "1", "--threads", "999999")
    assert done.code == 2
    assert "999999 is more than" in done.err
