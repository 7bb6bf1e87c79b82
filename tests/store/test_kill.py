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


@pytest.mark.parametrize("stride", [10, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", SCENES)
def test_killed_at_every_call(name, stride, tmp_path, record_property):
    scene = make_scene(name, tmp_path)
    kills = at_every_call(scene, tmp_path, CHANGES, lambda done, _: done.code == -9, stride)
    assert kills * stride > 30
    record_property("kills", kills)


@pytest.mark.slow
def test_killed_at_every_call_of_a_run_of_twelve_blocks(tmp_path, record_property):
    scene = make_scene("run", tmp_path, block_size=2)
    kills = at_every_call(scene, tmp_path, CHANGES, lambda done, _: done.code == -9)
    assert kills > 120
    record_property("kills", kills)


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


def killed_now_and_then(
    command: list[str], output: Path, before: Path | None, kills: int, *references: Reference
) -> Counter[str]:
    """Kill the program at random instants until it is through, and begin anew; how often it was."""

    def begin() -> None:
        shutil.rmtree(output, ignore_errors=True)
        if before is not None:
            shutil.copytree(before, output)

    begin()
    began = time.monotonic()
    subprocess.run(command, check=True, capture_output=True)
    seconds = time.monotonic() - began
    check_finished(output, references[0])
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
    subprocess.run(command, check=True, capture_output=True)
    check_finished(output, references[0])
    return counts


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Reference:
    """The sweep of ten blocks to which nothing happens."""
    output = tmp_path_factory.mktemp("undisturbed") / "out"
    subprocess.run(real(output), check=True, capture_output=True)
    return Reference.of(output)


@pytest.mark.slow
def test_killed_at_a_hundred_random_instants(tmp_path, undisturbed, record_property):
    output = tmp_path / "out"
    counts = killed_now_and_then(real(output), output, None, 100, undisturbed)
    record_property("counts", dict(counts))
    assert counts["half"] >= 10  # or the instants were badly chosen


@pytest.mark.slow
def test_real_runs_that_are_done_again_survive_kills(tmp_path, undisturbed, record_property):
    """`--retry-failed` under the full model: most runs had come to their limit of steps."""
    failed, output, again = tmp_path / "failed", tmp_path / "out", tmp_path / "again"
    limited = real(failed, "--set", "integrator.max_steps=3000")
    assert subprocess.run(limited, capture_output=True, check=False).returncode == 3
    shutil.copytree(failed, again)
    subprocess.run(real(again, "--retry-failed"), check=True, capture_output=True)
    references = Reference.of(again), Reference.of(failed)
    assert references[0].hash == undisturbed.hash
    retry = real(output, "--retry-failed")
    counts = killed_now_and_then(retry, output, failed, 8, *references)
    record_property("counts", dict(counts))


def test_the_counter_kills_and_lets_live(tmp_path):
    """The tests above would pass if nothing were ever killed or failed: so prove the tool."""
    args = ("run", tiny(tmp_path, block_size=12), "--output", tmp_path / "a", "-q")
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
