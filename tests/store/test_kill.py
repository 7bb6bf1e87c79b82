"""SIGKILL at every call with which a sweep touches its directory, and at random instants.

After each: what readers see is whole, the same command again ends with the same bytes, and nothing
is left of the process that died.
"""

from __future__ import annotations

import random
import re
import shutil
import subprocess
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from hardship import (
    OTHER_TYPES,
    PROGRAM,
    Ended,
    Reference,
    check_finished,
    check_whole,
    everything_in,
    manifest,
    nursery,
    tiny,
    trace,
)
from syscalls import CHANGES, Calls

from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.store.manifest import Manifest, count_failed
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.tables.columns import runs_schema

CONFIGS = Path(__file__).parents[2] / "configs"
FEW = {"block_size": 12}  # 2 blocks: more pass through the same calls
# A run is killed at every call; what else there is, at every fourth unless there is time.
EVERY = pytest.mark.parametrize("stride", [4, pytest.param(1, marks=pytest.mark.slow)])


def copy_of(directory: Path, target: Path) -> Path:
    shutil.rmtree(target, ignore_errors=True)
    return Path(shutil.copytree(directory, target))


def killed_at_every_call(
    prepared: Path | None,
    folder: Path,
    command: list[Any],
    after: Reference,
    *others: Reference,
    stride: int = 1,
) -> int:
    """Kill a command before each of its calls, look, and give it again; returns how many calls.

    ``{out}`` in the command stands for the directory, a copy of `prepared` each time.
    """
    output = folder / "out"

    def begin() -> list[str]:
        shutil.rmtree(output, ignore_errors=True)
        if prepared is not None:
            shutil.copytree(prepared, output)
        return [str(part).replace("{out}", str(output)) for part in command]

    calls = trace(output, folder / "log", *begin(), kinds=CHANGES)
    check_finished(output, after)
    for at in range(0, len(calls), stride):
        args = begin()
        done = nursery().run(*args, calls={"root": output, "kinds": CHANGES, "at": at})
        where = f"call {at}: {calls[at]}"
        assert done.code == -9, (where, done)
        if output.exists():
            check_whole(output, after, *others)
        again = nursery().run(*args)
        assert again.code == 0, (where, again.err)
        check_finished(output, after)
    assert (
        nursery().run(*begin(), calls={"root": output, "kinds": CHANGES, "at": len(calls)}).code
        == 0
    )
    return len(calls)


def kills_of_a_run(folder: Path, **changes: Any) -> int:
    config = tiny(folder, **changes)
    command = ["run", config, "--output", "{out}", "-q"]
    assert nursery().run("run", config, "--output", folder / "whole", "-q").code == 0
    return killed_at_every_call(None, folder, command, Reference.of(folder / "whole"))


def test_killed_at_every_call_of_a_run(tmp_path, record_property):
    kills = kills_of_a_run(tmp_path, **FEW)
    assert kills > 50
    record_property("kills", kills)


@pytest.mark.slow
def test_killed_at_every_call_of_a_run_of_twelve_blocks(tmp_path, record_property):
    kills = kills_of_a_run(tmp_path)
    assert kills > 120
    record_property("kills", kills)


@EVERY
def test_killed_at_every_call_of_classify(stride, tmp_path, record_property):
    config = tiny(tmp_path, **FEW)
    before, after = tmp_path / "before", tmp_path / "after"
    assert nursery().run("run", config, "--output", before, "-q").code == 0
    copy_of(before, after)
    done = nursery().run("classify", after, "--set", OTHER_TYPES)
    assert done.code == 0
    assert int(done.err.split()[0]) > 0
    command = ["classify", "{out}", "--set", OTHER_TYPES]
    references = Reference.of(after), Reference.of(before)
    assert references[0].hash != references[1].hash
    kills = killed_at_every_call(before, tmp_path, command, *references, stride=stride)
    assert kills > 30
    record_property("kills", -(-kills // stride))


def with_failures(directory: Path, config_hash: str) -> None:
    """Make of a finished sweep one in which every third run came to its limit of steps."""
    store, said = Store(directory), manifest(directory)
    receipts = {}
    for index in store.block_indices():
        file = store.read_block(index)
        note, table = file.note, file.table()
        assert note is not None
        assert note.sweep == config_hash
        ends = [sample % 3 == 1 for sample in table.column("sample").to_pylist()]
        columns = {name: table.column(name).to_pylist() for name in table.schema.names}
        for row in (row for row, limited in enumerate(ends) if limited):
            columns["status"][row] = "step_limit"
            for name in ("type", "t_r"):
                columns[name][row] = None
        rows = pa.table(columns, schema=runs_schema(model="gh"))
        receipt = store.write_block(index, rows, replace(note, max_steps=10))
        receipts[index] = receipt
    limited = said["config"]["integrator"] | {"max_steps": 10}
    said["config"]["integrator"] = limited
    changed = Manifest.parse(said)
    changed.receipts, changed.failed = receipts, count_failed(receipts.values())
    store.write_manifest(changed)


@EVERY
def test_killed_at_every_call_of_retry_failed(stride, tmp_path, record_property):
    config = tiny(tmp_path, **FEW)
    whole, failed = tmp_path / "whole", tmp_path / "failed"
    assert nursery().run("run", config, "--output", whole, "-q").code == 0
    copy_of(whole, failed)
    with_failures(failed, manifest(whole)["config_hash"])
    again = copy_of(failed, tmp_path / "again")
    assert nursery().run("run", config, "--output", again, "-q").code == 2
    command = ["run", config, "--output", "{out}", "--retry-failed", "-q"]
    done = nursery().run(*(str(part).replace("{out}", str(again)) for part in command))
    assert done.code == 0
    assert content_hash(again) == content_hash(whole)
    references = Reference.of(again), Reference.of(failed)
    kills = killed_at_every_call(failed, tmp_path, command, *references, stride=stride)
    assert kills > 50
    record_property("kills", -(-kills // stride))


@EVERY
def test_killed_at_every_call_of_a_fresh_start_over_another_config(
    stride, tmp_path, record_property
):
    config = tiny(tmp_path, **FEW)
    other, whole = tmp_path / "other", tmp_path / "whole"
    assert nursery().run("run", config, "--output", other, "--set", "seed=1", "-q").code == 0
    assert nursery().run("run", config, "--output", whole, "-q").code == 0
    references = Reference.of(whole), Reference.of(other)
    assert not set(references[0].runs.values()) & set(references[1].runs.values())
    command = ["run", config, "--output", "{out}", "--fresh", "-q"]
    kills = killed_at_every_call(other, tmp_path, command, *references, stride=stride)
    assert kills > 50
    record_property("kills", -(-kills // stride))


@EVERY
def test_killed_at_every_call_of_a_merge(stride, tmp_path, record_property):
    config = tiny(tmp_path, **FEW)
    shards = [tmp_path / "0", tmp_path / "1"]
    for place, shard in enumerate(shards):
        options = ("--shard", f"{place}/2", "-q")
        assert nursery().run("run", config, "--output", shard, *options).code == 0
    assert nursery().run("merge", *shards, "--output", tmp_path / "whole").code == 0
    command = ["merge", *shards, "--output", "{out}"]
    kills = killed_at_every_call(None, tmp_path, command, Reference.of(tmp_path / "whole"),
                                  stride=stride)  # fmt: skip
    assert kills > 30
    record_property("kills", -(-kills // stride))


# -- what a kill of the process does not show ---------------------------------------------------


def test_files_are_on_the_disk_before_they_are_in_their_place(tmp_path):
    """After a power cut only what was forced to the disk is there: so the order matters."""
    config = tiny(tmp_path)
    lines = trace(tmp_path / "out", tmp_path / "log", "run", config, "--output", tmp_path / "out",
                  kinds=(*CHANGES, "read"))  # fmt: skip
    renamed: Counter[str] = Counter()
    for place, line in enumerate(lines):
        kind, path = line.split()
        if kind != "rename":
            continue
        renamed[path.lstrip("./").split("-")[0].split(".")[0]] += 1
        table = ".parquet." in path
        expected = ["create", "write", "write", "fsync", *(["read"] if table else []), "rename"]
        own = [line.split()[0] for line in lines[: place + 1] if line.split()[1] == path]
        assert own == expected
        folder = str(Path(path).parent)
        after = next(line for line in lines[place + 1 :] if line.split()[0] != "read")
        assert after == f"fsync {folder}"
    assert renamed.keys() == {"runs/", "summary", "manifest"}
    assert (renamed["runs/"], renamed["summary"]) == (12, 1)
    assert renamed["manifest"] >= 2  # before and after
    # The manifest says that all is there only after all is.
    last = max(k for k, line in enumerate(lines) if line.startswith("rename .manifest"))
    assert last > max(k for k, line in enumerate(lines) if re.match(r"fsync runs$", line))


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
@pytest.mark.slow
def test_no_call_of_the_system_goes_uncounted(tmp_path):
    """What strace sees of the real program is what the kills and faults are counted by."""
    config = tiny(tmp_path)
    counted = trace(tmp_path / "out", tmp_path / "log1", "run", config, "--output",
                    tmp_path / "out", "-q", kinds=CHANGES)  # fmt: skip
    output, log = tmp_path / "again", tmp_path / "log2"
    names = ("openat", "open", "creat", "write", "pwrite64", "writev", "fsync", "fdatasync",
             "rename", "renameat", "renameat2", "unlink", "unlinkat", "mkdir", "mkdirat", "rmdir",
             "ftruncate", "truncate", "flock", "link", "symlink", "chmod", "fallocate")  # fmt: skip
    command = ["strace", "-f", "-y", "-o", log, "-e", f"trace={','.join(names)}", PROGRAM, "run",
               config, "--output", output, "-q"]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "ptrace" in done.stderr:
        pytest.skip("strace may not trace here")
    assert done.returncode == 0, done.stderr
    seen = []
    for line in log.read_text().splitlines():
        call = re.sub(r"^\d+ +", "", line)
        # A path that is given, or that of a descriptor.
        found = re.search(re.escape(str(output)) + r"([^\">]*)", call)
        if found is None or "resumed" in call:
            continue
        kind = call.split("(")[0]
        if kind == "openat" and "O_CREAT" not in call:
            continue
        kind = {"openat": "create", "flock": "lock", "ftruncate": "truncate"}.get(kind, kind)
        path = re.sub(r"\.[0-9a-f]{8}\.", ".*.", found[1].strip("/") or ".")
        seen.append(f"{kind} {path}")
    expected = [re.sub(r"\.[0-9a-f]{8}\.", ".*.", line) for line in counted]

    def once(lines: list[str]) -> list[str]:
        # The raw layer of the tests cuts writes in two.
        return [
            line
            for place, line in enumerate(lines)
            if not (line.startswith("write ") and place and lines[place - 1] == line)
        ]

    assert once(seen) == once(expected)


# -- the real program, at any instant -----------------------------------------------------------

SETS = (
    "bodies.samples=100",
    "bodies.target={K_r: [0.02, 0.1], rel_tol: 0.1}",
    "spin.n_i=[-0.3, -0.5]",
    "block_size=40",
)


def real(output: Path, *options: str) -> list[str]:
    sets = [part for text in SETS for part in ("--set", text)]
    return [str(PROGRAM), "run", str(CONFIGS / "quickstart.yaml"), "--output", str(output), "-q",
            *sets, *options]  # fmt: skip


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Reference, float]:
    """The sweep of ten blocks to which nothing happens, and how long it takes."""
    output = tmp_path_factory.mktemp("undisturbed") / "out"
    subprocess.run(real(output), check=True, capture_output=True)
    began = time.monotonic()
    subprocess.run(real(output, "--fresh"), check=True, capture_output=True)
    return output, Reference.of(output), time.monotonic() - began


def kill_now_and_then(
    folder: Path, undisturbed: tuple[Path, Reference, float], kills: int, seed: int
) -> dict[str, int]:
    """Kill the program at random instants until it is through; start over; and so on."""
    _, reference, seconds = undisturbed
    rng, done, counts = random.Random(seed), 0, {"killed": 0, "half": 0, "through": 0}
    output = folder / "out"
    while counts["killed"] < kills:
        process = subprocess.Popen(real(output), stderr=subprocess.PIPE, text=True)
        try:
            # Nearly all of the time goes into loading: most instants are to fall after that.
            _, err = process.communicate(timeout=seconds * rng.uniform(0.3, 1.1))
        except subprocess.TimeoutExpired:
            process.kill()
            _, err = process.communicate()
        if process.returncode == -9:
            counts["killed"] += 1
            if output.exists():
                done = check_whole(output, reference)
                counts["half"] += 0 < done < len(reference.runs)
        else:
            assert process.returncode == 0, Ended(process.returncode, "", err)
            check_finished(output, reference)
            counts["through"] += 1
            shutil.rmtree(output)
    subprocess.run(real(output), check=True, capture_output=True)
    check_finished(output, reference)
    assert "manifest.json" in everything_in(output)
    return counts


def test_killed_at_a_few_random_instants(tmp_path, undisturbed):
    counts = kill_now_and_then(tmp_path, undisturbed, 4, seed=2017)
    assert counts["killed"] == 4


@pytest.mark.slow
def test_killed_at_a_hundred_random_instants(tmp_path, undisturbed, capsys):
    counts = kill_now_and_then(tmp_path, undisturbed, 100, seed=1)
    with capsys.disabled():
        print(f"\n{counts}")
    assert counts["half"] >= 10  # or the instants were badly chosen


@pytest.mark.slow
def test_real_runs_that_are_done_again_survive_kills(tmp_path, undisturbed, capsys):
    """`--retry-failed` under the full model: most runs had come to their limit of steps."""
    failed, output = tmp_path / "failed", tmp_path / "out"
    limited = real(failed, "--set", "integrator.max_steps=3000")
    assert subprocess.run(limited, capture_output=True, check=False).returncode == 3
    retry = real(output, "--retry-failed")
    copy_of(failed, output)
    began = time.monotonic()
    subprocess.run(retry, check=True, capture_output=True)
    seconds = time.monotonic() - began
    references = Reference.of(output), Reference.of(failed)
    assert references[0].hash == undisturbed[1].hash
    rng, counts = random.Random(7), {"killed": 0, "through": 0}
    copy_of(failed, output)
    for _ in range(20):
        process = subprocess.Popen(retry, stderr=subprocess.DEVNULL)
        try:
            process.wait(seconds * rng.uniform(0.5, 1.1))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            counts["killed"] += 1
            check_whole(output, *references)
            continue
        assert process.returncode == 0
        counts["through"] += 1
        check_finished(output, references[0])
        copy_of(failed, output)
    subprocess.run(retry, check=True, capture_output=True)
    check_finished(output, references[0])
    assert counts["killed"] > 3
    with capsys.disabled():
        print(f"\n{counts}")


def test_the_counter_kills_and_lets_live(tmp_path):
    """The tests above would pass if nothing were ever killed or failed: so prove the tool."""
    config = tiny(tmp_path, **FEW)
    args = ("run", config, "--output", tmp_path / "a", "-q")
    lines = trace(tmp_path / "a", tmp_path / "log", *args, kinds=CHANGES)
    at = next(k for k, line in enumerate(lines) if line.startswith("write runs/.block"))
    shutil.rmtree(tmp_path / "a")
    harm = {"root": tmp_path / "a", "kinds": CHANGES, "at": at + 1}
    done = nursery().run(*args, calls=harm)
    assert done.code == -9
    left = [n for n in everything_in(tmp_path / "a") if n.endswith(".tmp")]
    assert len(left) == 1
    assert 1000 < (tmp_path / "a" / left[0]).stat().st_size < 10_000  # half-written
    calls = Calls(tmp_path, ("write",), at=1, number=5)
    calls.come("write", "x")
    with pytest.raises(OSError, match="Input/output error"):
        calls.come("write", "x")
    calls.come("write", "x")
