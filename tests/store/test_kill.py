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
from pathlib import Path

import pytest
from hardship import (
    PROGRAM,
    Reference,
    check_finished,
    check_whole,
    everything_in,
    nursery,
    tiny,
    trace,
)
from scenes import SCENES, at_every_call, make_scene
from syscalls import CHANGES, Calls

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.mark.parametrize("stride", [20, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", SCENES)
def test_killed_at_every_call(name, stride, tmp_path, record_property):
    scene = make_scene(name, tmp_path)
    kills = at_every_call(scene, tmp_path, CHANGES, lambda done, _: done.code == -9, stride)
    assert kills * stride > 30
    record_property("kills", kills)


def test_files_are_on_the_disk_before_they_are_in_their_place(tmp_path):
    """After a power cut only what was forced to the disk is there: so the order matters."""
    config, output = tiny(tmp_path), tmp_path / "out"
    lines = trace(output, tmp_path / "log", "run", config, "--output", output,
                  kinds=(*CHANGES, "read"))  # fmt: skip
    renamed: Counter[str] = Counter()
    for place, (kind, path) in enumerate(map(str.split, lines)):
        if kind != "rename":
            continue
        renamed[path.lstrip("./").split("-")[0].split(".")[0]] += 1
        read = ["read"] if ".parquet." in path else []
        own = [line.split()[0] for line in lines[: place + 1] if line.split()[1] == path]
        assert own == ["create", "write", "write", "fsync", *read, "rename"]
        after = next(line for line in lines[place + 1 :] if line.split()[0] != "read")
        assert after == f"fsync {Path(path).parent}"
    assert renamed.keys() == {"runs/", "summary", "manifest"}
    assert (renamed["runs/"], renamed["summary"]) == (12, 1)
    assert renamed["manifest"] >= 2  # before and after
    # The manifest says that all is there only after all is.
    last = max(k for k, line in enumerate(lines) if line.startswith("rename .manifest"))
    assert last > max(k for k, line in enumerate(lines) if line == "fsync runs")


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
@pytest.mark.slow
def test_no_call_of_the_system_goes_uncounted(tmp_path):
    """What strace sees of the real program is what the kills and faults are counted by."""
    args = ("run", tiny(tmp_path), "-q", "--output")
    output, log = tmp_path / "again", tmp_path / "strace"
    counted = trace(tmp_path / "out", tmp_path / "log", *args, tmp_path / "out", kinds=CHANGES)
    names = ("openat", "open", "creat", "write", "pwrite64", "writev", "fsync", "fdatasync",
             "rename", "renameat", "renameat2", "unlink", "unlinkat", "mkdir", "mkdirat", "rmdir",
             "ftruncate", "truncate", "flock", "link", "symlink", "chmod", "fallocate")  # fmt: skip
    watch = ["strace", "-f", "-y", "-o", log, "-e", f"trace={','.join(names)}"]
    done = subprocess.run([*watch, PROGRAM, *args, output], capture_output=True, text=True,
                          check=False)  # fmt: skip
    if "ptrace" in done.stderr:
        pytest.skip("strace may not trace here")
    assert done.returncode == 0, done.stderr
    seen = []
    for line in log.read_text().splitlines():
        call = re.sub(r"^\d+ +", "", line)
        kind = call.split("(")[0]
        # A path that is given, or that of a descriptor.
        found = re.search(re.escape(str(output)) + r"([^\">]*)", call)
        if found and "resumed" not in call and (kind != "openat" or "O_CREAT" in call):
            kind = {"openat": "create", "flock": "lock", "ftruncate": "truncate"}.get(kind, kind)
            seen.append(f"{kind} {found[1].strip('/') or '.'}")

    def once(lines: list[str]) -> list[str]:
        # The raw layer of the tests cuts writes in two.
        lines = [re.sub(r"\.[0-9a-f]{8}\.", ".*.", line) for line in lines]
        twice = (line.startswith("write ") and line == last
                 for last, line in zip(["", *lines], lines, strict=False))  # fmt: skip
        return [line for line, again in zip(lines, twice, strict=True) if not again]

    assert once(seen) == once(counted)


# -- the real program, at any instant -----------------------------------------------------------

SETS = ("bodies.samples=100", "bodies.target={K_r: [0.02, 0.1], rel_tol: 0.1}",
        "spin.n_i=[-0.3, -0.5]", "block_size=40")  # fmt: skip


def real(output: Path, *options: str) -> list[str]:
    """The command for a sweep of ten blocks under the full model."""
    sets = [part for text in SETS for part in ("--set", text)]
    return [str(PROGRAM), "run", str(CONFIGS / "quickstart.yaml"), "--output", str(output), "-q",
            *sets, *options]  # fmt: skip


def do(command: list[str], code: int = 0) -> None:
    assert subprocess.run(command, capture_output=True, check=False).returncode == code


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "kills"), [("run", 100), ("retry", 8)])
def test_killed_at_random_instants(kind, kills, tmp_path, record_property):
    """And begun anew each time that it is through; a retry finds most runs at their step limit."""
    output, whole, failed = tmp_path / "out", tmp_path / "whole", tmp_path / "failed"
    command, references = real(output), []
    if kind == "retry":
        command = real(output, "--retry-failed")
        do(real(failed, "--set", "integrator.max_steps=3000"), code=3)
        references = [Reference.of(failed)]
    do(real(whole))

    def begin() -> None:
        shutil.rmtree(output, ignore_errors=True)
        if failed.exists():
            shutil.copytree(failed, output)

    begin()
    began = time.monotonic()
    do(command)
    seconds = time.monotonic() - began
    references.insert(0, Reference.of(output))
    assert references[0].hash == Reference.of(whole).hash
    begin()
    rng, counts = random.Random(2017), Counter[str]()
    while counts["killed"] < kills:
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:
            # Nearly all of the time goes into loading: most instants are to fall after that.
            _, err = process.communicate(timeout=seconds * rng.uniform(0.4, 1.1))
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            counts["killed"] += 1
            if output.exists():
                done = check_whole(output, *references)
                counts["half"] += 0 < done < len(references[0].runs)
        else:
            assert process.returncode == 0, err
            check_finished(output, references[0])
            counts["through"] += 1
            begin()
    do(command)
    check_finished(output, references[0])
    record_property("counts", dict(counts))
    assert kind == "retry" or counts["half"] >= 10  # or the instants were badly chosen


def test_the_counter_kills_and_lets_live(tmp_path):
    """The tests above would pass if nothing were ever killed or failed: so prove the tool."""
    args = ("run", tiny(tmp_path, block_size=12), "--output", tmp_path / "a", "-q")
    lines = trace(tmp_path / "a", tmp_path / "log", *args, kinds=CHANGES)
    at = next(k for k, line in enumerate(lines) if line.startswith("write runs/.block"))
    shutil.rmtree(tmp_path / "a")
    harm = {"root": tmp_path / "a", "kinds": CHANGES, "at": at + 1}
    assert nursery().run(*args, calls=harm).code == -9
    (left,) = (name for name in everything_in(tmp_path / "a") if name.endswith(".tmp"))
    assert 1000 < (tmp_path / "a" / left).stat().st_size < 10_000  # half-written
    calls = Calls(tmp_path, ("write",), at=1, number=5)
    calls.come("write", "x")
    with pytest.raises(OSError, match="Input/output error"):
        calls.come("write", "x")
    calls.come("write", "x")
