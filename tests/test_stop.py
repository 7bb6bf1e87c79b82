"""Ways to stop: a time that is up, and Ctrl-C at any moment and twice."""

from __future__ import annotations

import fcntl
import shutil
import signal
import time
from pathlib import Path

import pytest
from hardship import (
    Reference,
    blocks_of,
    check_finished,
    check_whole,
    everything_in,
    manifest,
    nursery,
    tiny,
    trace,
    wait_until,
)
from syscalls import CHANGES


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Reference]:
    """A config of four blocks, and its sweep."""
    folder = tmp_path_factory.mktemp("sweep")
    config = tiny(folder, block_size=6)
    assert nursery().run("run", config, "--output", folder / "out", "-q").code == 0
    return config, Reference.of(folder / "out")


def test_the_time_is_up(sweep, tmp_path):
    config, reference = sweep
    output, kept, ends = tmp_path / "out", [0], []
    while 0 not in ends:
        done = nursery().run("run", config, "--output", output, "--max-time", "0.7s", pace=0.3)
        ends.append(done.code)
        kept.append(check_whole(output, reference))
        if done.code:
            assert done.code == 75
            assert done.out == ""
            last = done.err.splitlines()[-1]
            assert last == "stopped: the time is up; the same command resumes from there"
            assert manifest(output)["state"] == "stopped"
            assert kept[-1] > kept[-2]
            assert not [name for name in everything_in(output) if "/." in f"/{name}"]
    assert len(ends) > 1
    check_finished(output, reference)


def test_a_time_too_short_for_one_block_says_so(sweep, tmp_path):
    config, reference = sweep
    output = tmp_path / "out"
    began = time.monotonic()
    done = nursery().run("run", config, "--output", output, "--max-time", "0.3s", pace=60)
    assert time.monotonic() - began < 30  # it does not wait for the block
    assert done.code == 75
    assert done.err.splitlines()[-1] == (
        "stopped: the time was up before one block was done; give more, or choose a smaller "
        "block_size in a new output; the same command resumes from there"
    )
    assert blocks_of(output) == {}
    done = nursery().run("run", config, "--output", output, "--max-time", "1h")
    assert done.code == 0
    check_finished(output, reference)
    # What is done needs no time.
    done = nursery().run("run", config, "--output", output, "--max-time", "0.001s", "-q")
    assert (done.code, done.err) == (0, "")


@pytest.mark.parametrize("text", ["2", "s", "-1s", "0s", "1 fortnight", "", "nan s"])
def test_what_is_no_time(text, sweep, tmp_path):
    done = nursery().run("run", sweep[0], "--output", tmp_path / "out", f"--max-time={text}")
    assert done.code == 2
    assert done.err.startswith(f"error: --max-time {text}: is ")
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("number", "code", "word", "stride"),
    [
        (signal.SIGINT, 130, "interrupted", 5),
        (signal.SIGTERM, 143, "terminated", 9),
        pytest.param(signal.SIGINT, 130, "interrupted", 1, marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, 143, "terminated", 1, marks=pytest.mark.slow),
    ],
)
def test_stopped_at_every_call(number, code, word, stride, sweep, tmp_path):
    config, reference = sweep
    output = tmp_path / "out"
    args = ("run", config, "--output", output, "-q")
    calls = trace(output, tmp_path / "log", *args, kinds=CHANGES)
    assert len(calls) > 60
    for at in range(0, len(calls), stride):
        shutil.rmtree(output)
        harm = {"root": output, "kinds": CHANGES, "at": at, "sent": number}
        done = nursery().run(*args, calls=harm)
        where = f"call {at}: {calls[at]}: {done}"
        assert done.code == code, where
        expected = f"{word}; completed work is kept, and the same command resumes from there\n"
        assert done.err == expected, where
        check_whole(output, reference)
        assert nursery().run(*args).code == 0
        check_finished(output, reference)


def test_a_second_ctrl_c_is_obeyed_at_once(sweep, tmp_path):
    """The first one waits for the manifest, which another process does not let go of."""
    config, reference = sweep
    output = tmp_path / "out"
    child = nursery().start("run", config, "--output", output, "-q", pace=0.2)
    wait_until(lambda: child.ended() or blocks_of(output))
    with open(output / ".locks/manifest", "ab") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        child.kill(signal.SIGINT)
        time.sleep(1)
        assert not child.ended()
        sent = time.monotonic()
        child.kill(signal.SIGINT)
        done = child.wait()
        assert time.monotonic() - sent < 10
    assert done.code in (130, -signal.SIGINT)
    assert "Traceback" not in done.err
    check_whole(output, reference)
    assert nursery().run("run", config, "--output", output, "-q").code == 0
    check_finished(output, reference)


def test_what_the_tests_leave_lying_is_in_pytests_own_directory(tmp_path_factory):
    assert nursery().folder.is_relative_to(tmp_path_factory.getbasetemp())
    assert nursery().folder.is_dir()
