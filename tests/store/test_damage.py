"""Files that change behind the program's back: `verify` finds it, `run` does the runs again."""

from __future__ import annotations

import itertools
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
import pyarrow as pa
import pytest
from hardship import (
    Reference,
    blocks_of,
    check_finished,
    check_goes_on,
    everything_in,
    manifest,
    nursery,
    one_sentence,
    tiny,
)
from scenes import finished_sweep

import rattlesweep as rs
from rattlesweep.errors import ConfigError, OutputError, printable
from rattlesweep.sweeps.old.status import describe, status_of
from rattlesweep.sweeps.old.verify import _choose, verify
from rattlesweep.sweeps.old import sealed as sealedjson
from rattlesweep.sweeps.old.manifest import Receipt
from rattlesweep.sweeps.old.store import Store

FIRST, LAST = "runs/block-000000.parquet", "runs/block-000003.parquet"
FILES = [LAST, "manifest.json", "summary.parquet"]


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Reference]:
    """A config of four blocks, its sweep, and that remembered."""
    return finished_sweep(tmp_path_factory.mktemp("sweep"), block_size=6)


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
    check_goes_on(sweep[0], directory, sweep[2])


def check_every(
    sweep: tuple[Path, Path, Reference],
    directory: Path,
    name: str,
    versions: Iterable[bytes],
    verify_every: int,
    mend_every: int,
) -> int:
    """Put damaged versions in a file's place: each is found; some by `verify` too, some mended."""
    path, original, count = directory / name, (directory / name).read_bytes(), 0
    store = Store(directory)
    read: Callable[[], object] = {
        "manifest.json": store.read_manifest,
        "summary.parquet": store.read_summary,
    }.get(name, lambda: store.read_block(int(path.stem.split("-")[1])))
    for count, damaged in enumerate(versions):
        assert damaged != original
        path.write_bytes(damaged)
        with pytest.raises(OutputError):
            read()
        if count % verify_every == 0:
            problems = verify(directory).problems
            assert any(str(path) in problem for problem in problems), (count, problems)
        if count % mend_every == 0:
            check_mended(sweep, directory)
            assert path.read_bytes() == original or name == "manifest.json"
    return count + 1


def flipped(data: bytes, places: Iterable[int], seed: int) -> Iterator[bytes]:
    rng = random.Random(seed)
    for place in places:
        changed = bytearray(data)
        changed[place] ^= 1 << rng.randrange(8)
        yield bytes(changed)


@pytest.mark.parametrize("name", FILES)
def test_damage_is_found_and_mended(name, sweep, output):
    """Flipped bits, where they matter most and anywhere; lost ends, and ends too many."""
    data, rng = (output / name).read_bytes(), random.Random(2017)
    places = {*range(8), *range(len(data) - 8, len(data))}
    places |= {rng.randrange(len(data)) for _ in range(12)}
    if name.endswith(".parquet"):
        footer = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
        places |= {*range(footer, len(data), (len(data) - footer) // 16)}
    lengths = {0, 1, 4, 7, 8, *range(9, len(data), len(data) // 6), len(data) - 1}
    versions = [
        *flipped(data, sorted(places), 2017),
        *(data[:length] for length in sorted(lengths)),
        *(data + b"\0", data + data, bytes(len(data))),
    ]
    check_every(sweep, output, name, versions, verify_every=8, mend_every=31)


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_every_flipped_byte_and_every_lost_end_is_found(name, sweep, output, record_property):
    data = (output / name).read_bytes()
    versions = [*flipped(data, range(len(data)), 1), *(data[:k] for k in range(len(data)))]
    count = check_every(sweep, output, name, versions, verify_every=11, mend_every=97)
    record_property("versions", count)


# -- files in the wrong place ----------------------------------------------------------------------


def swap(directory: Path) -> None:
    one, two = directory / FIRST, directory / LAST
    a, b = one.read_bytes(), two.read_bytes()
    one.write_bytes(b)
    two.write_bytes(a)


def sealed(directory: Path, **changes: Any) -> None:
    """Not damage but malice: a manifest that says something else, its seal whole."""
    said = manifest(directory) | changes
    (directory / "manifest.json").write_bytes(sealedjson.dump(said))


def left_behind(directory: Path) -> None:
    (directory / "runs/.block-000001.parquet.0123abcd.tmp").write_bytes(b"half")
    (directory / ".manifest.json.0123abcd.tmp").write_bytes(b"half")


def everything_at_once(directory: Path, other: Path) -> None:
    swap(directory)
    for name in ("runs/block-000001.parquet", "manifest.json", "summary.parquet"):
        (directory / name).write_bytes((directory / name).read_bytes()[:-20])
    left_behind(directory)


# What is done to a directory, with another of another seed at hand.
HARM: dict[str, Callable[[Path, Path], object]] = {
    "swapped": lambda out, other: swap(out),
    "of another seed": lambda out, other: shutil.copy(other / LAST, out / LAST),
    "twice": lambda out, other: shutil.copy(out / FIRST, out / "runs/block-000004.parquet"),
    "twice far off": lambda out, other: shutil.copy(out / FIRST, out / "runs/block-123456.parquet"),
    "twice by hand": lambda out, other: shutil.copy(out / FIRST, out / "runs/0 (copy).parquet"),
    "deleted": lambda out, other: (out / FIRST).unlink(),
    "all deleted": lambda out, other: shutil.rmtree(out / "runs"),
    "empty": lambda out, other: (out / LAST).write_bytes(b""),
    "no summary": lambda out, other: (out / "summary.parquet").unlink(),
    "summary of another": lambda out, other: shutil.copy(other / "summary.parquet", out),
    "receipts of another": lambda out, other: sealed(out, receipts=manifest(other)["receipts"]),
    "without receipts": lambda out, other: sealed(out, receipts={}),
    "left behind": lambda out, other: left_behind(out),
    "everything at once": everything_at_once,
}


@pytest.mark.parametrize("harm", HARM)
def test_files_in_the_wrong_place_are_found_and_mended(harm, sweep, output, other_seed):
    HARM[harm](output, other_seed)
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
    assert (done.code, one_sentence(done.err)) == (2, True)
    assert "it holds the runs of another config (seed: 1 against 0)" in done.err
    assert (everything_in(output), blocks_of(output)) == before
    # Without it, the blocks say of which sweep they are.
    (output / "manifest.json").unlink()
    check_mended(sweep, output)


@pytest.mark.parametrize("size", [4, 100])
def test_the_manifest_of_the_same_sweep_in_other_blocks(size, sweep, output, tmp_path):
    other = tmp_path / "other"
    options = ("--set", f"block_size={size}", "-q")
    assert nursery().run("run", sweep[0], "--output", other, *options).code == 0
    shutil.copy(other / "manifest.json", output / "manifest.json")
    assert found(output)
    check_goes_on(sweep[0], output, Reference.of(other))
    assert Reference.of(output).hash == sweep[2].hash


def test_the_manifest_of_an_earlier_day(sweep, output):
    """From a backup: all blocks are there, and the manifest knows of none."""
    sessions = [session | {"state": "running"} for session in manifest(output)["sessions"]]
    sealed(output, state="running", receipts={}, sessions=sessions)
    check_mended(sweep, output)


def test_a_file_that_is_nobodys_is_left_alone(sweep, output, other_seed):
    """A block of another sweep, by a name that ours do not have, may be all there is of it."""
    stranger = output / "runs/block-000007.parquet"
    shutil.copy(other_seed / FIRST, stranger)
    assert len(found(output)) == 1
    run = ("run", sweep[0], "--output", output, "-q")
    done = nursery().run(*run)
    assert done.code == 1
    assert done.err == f"error: {stranger} is no block of this sweep; move it elsewhere\n"
    stranger = stranger.rename(output / "runs/mine.parquet")
    done = nursery().run(*run)
    assert done.code == 0
    remark = f"{stranger} is no block of this sweep, but readers take it for one"
    assert done.err == f"note: {remark}\n"
    assert stranger.read_bytes() == (other_seed / FIRST).read_bytes()


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


def test_status_counts_blocks_of_its_sweep_only(output):
    shutil.copy(output / FIRST, output / "runs/block-123456.parquet")
    for changes in ({}, {"receipts": {}}):
        sealed(output, **changes)
        done = nursery().run("status", output)
        assert "runs     24 of 24 done (100.0 %)" in done.out
        assert "blocks   4 of 4" in done.out
        assert "strays   block-123456.parquet: no block of this sweep" in done.out
    (output / "runs/block-123456.parquet").unlink()
    swap(output)
    assert "damaged  blocks 0, 3" in nursery().run("status", output).out


def write_row(directory: Path, place: int, change: dict[str, Any]) -> Receipt:
    """Change a row of the first block, which is sealed again; returns its new receipt."""
    store = Store(directory)
    file = store.read_block(0)
    rows = file.table().to_pylist()
    rows[place] |= change
    return store.write_block(0, pa.Table.from_pylist(rows, file.table().schema), file.note)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"status": "fine"}, "words in status that mean nothing"),
        ({"type": "Q"}, "words in type that mean nothing"),
        ({"type": None}, "types that are null though the status is ok"),
        ({"status": "step_limit", "t_r": None}, "types that are null though the status is ok"),
        ({"type": "SS", "t_r": 1.0}, "reversal times that do not go with their types"),
        ({"type": "R", "t_r": None}, "reversal times that do not go with their types"),
        ({"n_end": None}, "runs that are ok but have no n_end or energy_drift"),
        ({"energy_drift": np.inf}, "NaN or infinity in energy_drift"),
        ({"type": "SS", "t_r": None}, "types that do not follow from its numbers"),
        ({"sample": 99}, "runs missing, double or out of order"),
    ],
)
def test_values_that_cannot_be_are_found(change, words, output):
    """Not damage: the file is whole, and says what no run comes to."""
    write_row(output, 0, change)
    problems = verify(output).problems
    assert any(problem.startswith(f"{output / FIRST} has {words}") for problem in problems)


def test_a_value_that_might_be_is_found_by_integrating_again(output):
    rows = Store(output).read_block(0).table().to_pylist()
    place, row = next((k, row) for k, row in enumerate(rows) if row["type"] == "R")
    receipt = write_row(output, place, {"t_r": float(np.nextafter(row["t_r"], 0))})
    Store(output).update_manifest(lambda manifest: manifest.receipts.update({0: receipt}))
    which = f"case {row['case']}, sample {row['sample']}"
    problem = f"{which} comes out otherwise when integrated again, in t_r"
    assert problem not in verify(output).problems
    assert problem in verify(output, recompute=24).problems


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
    assert nursery().run("status", output).code in (0, 1)
    check_mended(sweep, output)


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


@pytest.mark.parametrize("stride", [9, pytest.param(1, marks=pytest.mark.slow)])
def test_a_tampered_manifest_is_one_sentence_everywhere(stride, output):
    """No field of it, whatever it says, is good for a traceback or for an endless loop."""
    said = manifest(output)
    said["expected"] = {"seconds": 1.0, "low": 0.5, "high": 2.0}
    said["sessions"][0] |= {"progress": {"at": said["started"], "left": 3.0}}
    cases = [*itertools.product(places_in(said), ABSURD)][::stride]
    refusals = 0
    for key, value in cases:
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
    assert len(cases) * stride > 300
    assert refusals > len(cases)


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
def test_a_tampered_manifest_is_named_and_mended(key, value, words, sweep, output):
    (output / "manifest.json").write_bytes(tampered(manifest(output), key, value))
    problems = verify(output).problems
    assert len(problems) == 1
    assert f"manifest.json is damaged: {words}" in problems[0]
    check_mended(sweep, output)


def test_every_command_refuses_a_tampered_manifest(output, tmp_path):
    sealed(output, blocks=10**15)
    for command in (
        ["status", output],
        ["classify", output],
        ["merge", output, "--output", tmp_path / "merged"],
        ["plot", output],
        ["report", output],
        ["replay", output, "--case", "0", "--sample", "0"],
    ):
        done = nursery().run(*command)
        assert (done.code, one_sentence(done.err)) == (1, True), done


def test_what_another_machine_or_version_says_reaches_the_terminal_as_words(sweep, output):
    run = ("run", sweep[0], "--output", output, "-q")
    said = manifest(output)
    sealed(output, name="\x1b]0;owned\x07", versions=said["versions"] | {"numpy": "\x1b[2J1.0"})
    done, again = nursery().run("status", output), nursery().run(*run)
    assert "\\x1b]0;owned\\x07" in done.out
    assert "begun with other versions" in again.err
    assert "\x1b" not in done.out + again.err
    # Results do not depend on the number of processors, so nothing is said of it.
    machine = said["machine"] | {"processors": said["machine"]["processors"] + 62}
    for other, words in ((machine, ""), (machine | {"cpu": "another"}, "other machine (cpu:")):
        sealed(output, machine=other, versions=said["versions"])
        err = nursery().run(*run).err
        assert words in err
        assert "processors" not in err
        assert bool(err) == bool(words)


# -- what is somebody else's -----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["manifest.json", "summary.parquet", "notes.txt"])
def test_a_foreign_directory_is_refused(name, sweep, output, tmp_path):
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (theirs / name).write_text('{"name": "app", "icons": []}')
    if name == "summary.parquet":
        pd.DataFrame({"mine": [1.0]}).to_parquet(theirs / name)
    before = (theirs / name).read_bytes()
    run = ["run", sweep[0], "--output", theirs, "-q"]
    merge = ["merge", output, "--output", theirs]
    for command in (run, [*run, "--fresh"], [*run, "--dry-run"], [*run, "--shard", "0/2"], merge):
        done = nursery().run(*command)
        assert (done.code, one_sentence(done.err)) == (2, True), done
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
