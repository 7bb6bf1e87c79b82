"""Calls of the system that fail: each call of a sweep, with each reason, once and for good.

After each: exit 1 and one sentence that names a file and the reason, or exit 0 and everything
there; what readers see is whole; the same command again ends with the same bytes.
"""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hardship import (
    OTHER_TYPES,
    Child,
    Ended,
    Reference,
    blocks_of,
    check_finished,
    check_goes_on,
    check_whole,
    everything_in,
    nursery,
    one_sentence,
    wait_until,
)
from scenes import at_every_call, finished_sweep, make_scene
from syscalls import MAY_FAIL

NAMES = {number: errno.errorcode[number] for number in MAY_FAIL}
NOBODY = 65534
only_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")


def refused(done: Ended, output: Path, *reasons: str) -> bool:
    """Whether it ended with 1 and one sentence that names a file and a reason."""
    named = str(output) in done.err and any(reason in done.err for reason in reasons)
    return done.code == 1 and one_sentence(done.err) and named


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Reference]:
    """A config of two blocks, and its sweep to which nothing happens."""
    return finished_sweep(tmp_path_factory.mktemp("whole"), block_size=12)


RUN = [("run", number, when) for number in MAY_FAIL for when in ("once", "for good")]
CLASSIFY = [("classify", number, when) for number in (errno.ENOSPC, errno.EIO)
            for when in ("once", "for good")]  # fmt: skip
FRESH = [("fresh", number, "once") for number in (errno.ENOSPC, errno.EACCES)]
QUICK = [("run", errno.ENOSPC, "once"), ("run", errno.EIO, "for good"), CLASSIFY[-1], FRESH[-1]]


@pytest.mark.parametrize(
    ("name", "number", "when", "stride"),
    [
        *((*case, 20) for case in QUICK),
        *(pytest.param(*case, 1, marks=pytest.mark.slow) for case in (*RUN, *CLASSIFY, *FRESH)),
    ],
    ids=lambda value: NAMES.get(value, str(value)),
)
def test_every_call_fails(name, number, when, stride, tmp_path, record_property):
    scene = make_scene(name, tmp_path)
    codes: Counter[int] = Counter()

    def judge(done: Ended, output: Path) -> bool:
        codes[done.code] += 1
        if done.code == 0:
            return blocks_of(output) == scene.after.runs
        return refused(done, output, os.strerror(number))

    faults = at_every_call(scene, tmp_path, MAY_FAIL[number], judge, stride, number=number,
                           for_good=when == "for good")  # fmt: skip
    assert codes[1] > 1
    record_property("faults", faults)


# -- faults that are real ----------------------------------------------------------------------


@pytest.fixture
def one_megabyte(tmp_path: Path) -> Iterator[Path]:
    """A file system of a megabyte."""
    place = tmp_path / "small"
    place.mkdir()
    mount = shutil.which("mount")
    if os.geteuid() != 0 or mount is None:
        pytest.skip("only root may mount a file system")
    done = subprocess.run([mount, "-t", "tmpfs", "-o", "size=1m", "tmpfs", place], check=False,
                          capture_output=True)  # fmt: skip
    if done.returncode != 0:
        pytest.skip(f"no file system can be mounted here: {done.stderr.decode().strip()}")
    try:
        yield place
    finally:
        subprocess.run(["umount", place], check=True)


def test_a_disk_that_fills_up(one_megabyte, tmp_path):
    # Blocks of 11 kB and more; what fills the rest goes away by the third try.
    bodies = "{source: sd, samples: 600}"
    config, _, reference = finished_sweep(tmp_path, "record: []", bodies=bodies, block_size=40)
    size = sum(map(len, reference.runs.values()))
    assert 300_000 < size < 900_000
    output, ballast = one_megabyte / "out", one_megabyte / "ballast"
    kept = []
    for free in (20_000, size // 3, size // 2):
        ballast.unlink(missing_ok=True)
        used = sum(map(len, blocks_of(output).values()))
        ballast.write_bytes(bytes((1 << 20) - used - free))
        done = nursery().run("run", config, "--output", output, "-q")
        assert refused(done, output, "No space left on device"), done
        kept.append(check_whole(output, reference))
    assert kept == sorted(kept)
    assert 0 < kept[1] < kept[2] < len(reference.runs)
    ballast.unlink()
    check_goes_on(config, output, reference)


@pytest.mark.parametrize("fsize", [400, 8000])
def test_files_that_may_not_grow(fsize, whole, tmp_path):
    """RLIMIT_FSIZE: a real fault, half-way through a write, that needs no rights."""
    config, _, reference = whole
    output = tmp_path / "out"
    assert min(map(len, reference.runs.values())) > 8000
    done = nursery().run("run", config, "--output", output, "-q", fsize=fsize)
    assert refused(done, output, "File too large"), done
    assert check_whole(output, reference) == 0
    check_goes_on(config, output, reference)


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that other users can reach too, which pytest's own is not."""
    shared = os.environ.get("TMPDIR", "/tmp")
    with tempfile.TemporaryDirectory(prefix="rattlesweep-tests-", dir=shared) as name:
        os.chmod(name, 0o777)
        yield Path(name)


def remove(path: Path) -> None:
    """A file, or a folder with all that is in it."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()


def begin(config: Path, output: Path, **how: Any) -> Child:
    """Start a sweep, and wait until two blocks are in place: it waits then, too."""
    child = nursery().start("run", config, "--output", output, "-q", hold=2, **how)
    wait_until(lambda: child.ended() or len(blocks_of(output)) >= 2)
    assert not child.ended(), child.wait()
    return child


@only_root
@pytest.mark.parametrize("what", ["runs", "."])
def test_a_directory_that_becomes_read_only(what, open_folder):
    config, _, reference = finished_sweep(open_folder)
    output = open_folder / "out"
    child = begin(config, output, uid=NOBODY)
    os.chmod(output / what, 0o555)
    child.go_on()
    done = child.wait()
    assert refused(done, output, "Permission denied"), done
    kept = check_whole(output, reference)
    # Where only the directory itself is closed, just the summary and the manifest are missing.
    assert 2 <= kept < 12 if what == "runs" else kept == 12
    again = nursery().run("run", config, "--output", output, "-q", uid=NOBODY)
    assert refused(again, output, "Permission denied"), again
    os.chmod(output / what, 0o755)
    assert nursery().run("run", config, "--output", output, "-q", uid=NOBODY).code == 0
    check_finished(output, reference)


@only_root
def test_a_directory_of_somebody_else(open_folder):
    config, output, reference = finished_sweep(open_folder)
    run = ["run", config, "--output", output]
    for command in (
        run,
        [*run, "--fresh"],
        [*run, "--shard", "0/2"],
        ["classify", output, "--set", OTHER_TYPES],
    ):
        done = nursery().run(*command, uid=NOBODY)
        assert refused(done, output, "Permission denied"), done
    check_finished(output, reference)
    os.chmod(output / "runs" / "block-000003.parquet", 0o000)
    done = nursery().run("verify", output, uid=NOBODY)
    assert done.code == 1
    assert "block-000003.parquet: Permission denied" in done.out + done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize("what", ["runs", ".", "manifest.json"])
def test_something_is_removed_under_the_sweep(what, tmp_path):
    """A directory that is gone is not made again; a manifest is."""
    config, _, reference = finished_sweep(tmp_path)
    output = tmp_path / "out"
    child = begin(config, output)
    remove(output / what)
    child.go_on()
    done = child.wait()
    if what == "manifest.json":
        assert done.code == 0
        check_finished(output, reference)
    else:
        assert refused(done, output, "has been moved, removed or replaced"), done
    check_goes_on(config, output, reference)


@pytest.mark.parametrize("where", [".", "runs", ".locks", "manifest.json", "summary.parquet",
                                   "runs/block-000001.parquet"])  # fmt: skip
def test_something_is_in_the_way(where, whole, tmp_path):
    """A file where a folder is to be, and the other way about."""
    config, _, reference = whole
    output = tmp_path / "out"
    place = output / where
    if place.suffix:
        shutil.copytree(whole[1], output)
        place.unlink()
        (place / "mine").mkdir(parents=True)
    else:
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text("mine")
    before = everything_in(tmp_path)
    done = nursery().run("run", config, "--output", output, "-q")
    assert refused(done, output, "in the way", "Is a directory", "Not a directory"), done
    assert before <= everything_in(tmp_path)
    remove(place)
    check_goes_on(config, output, reference)


def test_standard_output_that_is_full(whole, tmp_path):
    """The table cannot be printed; the sweep is there all the same."""
    config, _, reference = whole
    done = nursery().run("run", config, "--output", tmp_path / "out", full=True)
    check_finished(tmp_path / "out", reference)
    assert done.code == 1
    assert "Traceback" not in done.err, done.err
