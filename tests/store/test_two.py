"""Two processes in one directory: they share it by shards, or the second is told who is there."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import shutil
import signal
import socket
from collections.abc import Callable
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
    manifest,
    nursery,
    one_sentence,
    wait_until,
)
from scenes import finished_sweep

from rattlesweep.sweeps.old.verify import verify
from rattlesweep.sweeps.old.locks import hold, holder


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Reference]:
    """A config, its sweep, and that remembered."""
    return finished_sweep(tmp_path_factory.mktemp("sweep"))


def run(config: Path, output: Path, *options: str) -> tuple[Any, ...]:
    return ("run", config, "--output", output, "-q", *options)


def classify(output: Path) -> tuple[Any, ...]:
    return ("classify", output, "--set", OTHER_TYPES)


def at_work(config: Path, output: Path, *options: str, **how: Any) -> Child:
    """A sweep that holds its directory after a block, until it is let go on."""
    before = len(blocks_of(output))
    child = nursery().start(*run(config, output, *options), **(how or {"hold": 1}))
    wait_until(lambda: child.ended() or len(blocks_of(output)) > before)
    assert not child.ended(), child.wait()
    return child


def wake(child: Child) -> Ended:
    """Let a child that was halted go on to its end."""
    child.go_on()
    child.kill(signal.SIGCONT)
    return child.wait()


@pytest.mark.parametrize("share", [(), ("--shard", "0/2")])
def test_who_comes_second_is_told_who_works_there(share, sweep, tmp_path):
    """Whoever works on all of it, or on the same share, and whatever the second wants to do."""
    config, _, reference = sweep
    output = tmp_path / "out"
    first = at_work(config, output, *share)
    first.kill(signal.SIGSTOP)  # for as long as the others take
    seconds = [(), ("--fresh",), ("--retry-failed",), ("--shard", "0/2")]
    words = " ".join(map(str, run(config, output, *share)))
    who = rf"`rattlesweep {re.escape(words)}` \(process {first.pid} on {socket.gethostname()} since"
    told = rf"error: {re.escape(str(output))}(: shard-\S+)? is in use by {who} \S+\)\n"
    for command in (*(run(config, output, *more) for more in seconds), classify(output)):
        done = nursery().run(*command)
        assert done.code == 1, done
        assert one_sentence(done.err)
        assert re.match(told, done.err), done
    assert wake(first).code == 0
    check_goes_on(config, output, reference)


def test_who_only_looks_does_not_disturb(sweep, tmp_path):
    """That readers see whole blocks meanwhile is shown in test_readers.py."""
    config, _, reference = sweep
    output = tmp_path / "out"
    first = at_work(config, output, pace=0.02)
    while not first.ended():
        words = holder(output)
        assert words is None or f"process {first.pid} " in words
        assert all("missing" not in problem for problem in verify(output).problems)
        assert nursery().run("status", output).code == 0
    assert first.wait().code == 0
    check_finished(output, reference)
    # A run that begins while others look gets its turn.
    for _ in range(5):
        child = nursery().start(*run(config, output))
        while not child.ended():
            holder(output)
        assert child.wait().code == 0


Commands = Callable[[Path, Path], list[tuple[Any, ...]]]
AT_ONCE: dict[str, Commands] = {
    "run": lambda config, output: [run(config, output)] * 2,
    "classify": lambda config, output: [run(config, output), classify(output)],
    "shards": lambda config, output: [run(config, output, "--shard", f"{k}/5") for k in range(5)],
}


@pytest.mark.parametrize("name", AT_ONCE)
def test_those_that_begin_at_once_never_mix(name, sweep, tmp_path):
    config, whole, reference = sweep
    references = [reference]
    if name == "classify":
        other = Path(shutil.copytree(whole, tmp_path / "other"))
        assert nursery().run(*classify(other)).code == 0
        references.append(Reference.of(other))
    for place in range(2):
        output = tmp_path / str(place)
        if name == "classify":
            # Half done: the one has blocks to do, the other types to change.
            shutil.copytree(whole, output)
            for index in range(0, 12, 2):
                (output / f"runs/block-{index:06d}.parquet").unlink()
        children = [nursery().start(*command) for command in AT_ONCE[name](config, output)]
        done = [child.wait() for child in children]
        assert 0 in {end.code for end in done}, done
        for end in done:
            refused = end.code == 1 and one_sentence(end.err) and "is in use by" in end.err
            assert end.code == 0 or (refused and name != "shards"), end
        check_whole(output, *references)
        if name == "shards":
            check_finished(output, reference)
        check_goes_on(config, output, reference)


@pytest.mark.parametrize("then", ["nothing", "an empty directory", "another sweep"])
def test_a_directory_that_is_moved_is_left_alone(then, sweep, tmp_path):
    """Whatever takes its place, nothing of the sweep goes there, and no sentence is missing."""
    config, _, reference = sweep
    output, moved = tmp_path / "out", tmp_path / "moved"
    first = at_work(config, output)
    first.kill(signal.SIGSTOP)
    output.rename(moved)
    if then == "another sweep":
        other = at_work(config, output, "--set", "seed=1")
    elif then == "an empty directory":
        (output / "runs").mkdir(parents=True)
    done = wake(first)
    assert (done.code, one_sentence(done.err)) == (1, True), done
    assert "has been moved, removed or replaced while it was in use" in done.err
    if then == "another sweep":
        assert holder(output) is not None
        other.go_on()
        assert other.wait().code == 0
        assert not set(blocks_of(output).values()) & set(reference.runs.values())
        assert verify(output).problems == []
    else:
        assert blocks_of(output) == {}
        assert everything_in(output) <= {"runs"}
    # What was done is where the directory is now, and goes on from there.
    assert check_whole(moved, reference) >= 1
    check_goes_on(config, moved, reference)


def test_the_lock_of_a_process_that_is_gone_is_no_obstacle(sweep, tmp_path):
    config, _, reference = sweep
    # Killed: the system lets go.
    output = tmp_path / "killed"
    first = at_work(config, output)
    first.kill()
    assert first.wait().code == -signal.SIGKILL
    assert (output / ".locks/directory").exists()
    assert holder(output) is None
    check_goes_on(config, output, reference)
    # A file alone, even one that names a process that lives, locks nothing.
    me = {"pid": os.getpid(), "host": socket.gethostname(), "command": "x", "since": "today"}
    for text in ("", "{", json.dumps(me)):
        for command in (run(config, output), ("classify", output)):
            for name in ("directory", "manifest", "shard-0-of-2"):
                (output / ".locks" / name).write_text(text)
            done = nursery().run(*command)
            assert done.code == 0, done
    check_finished(output, reference)


def test_without_locks_two_do_the_same_blocks_twice(sweep, tmp_path):
    config, _, reference = sweep
    output = tmp_path / "out"
    no_locks = {"root": output, "kinds": ("lock",), "at": 0, "number": errno.ENOLCK,
                "for_good": True}  # fmt: skip
    first = at_work(config, output, hold=1, calls=no_locks)
    second = nursery().start(*run(config, output), calls=no_locks)
    first.go_on()
    assert (first.wait().code, second.wait().code) == (0, 0)
    assert blocks_of(output) == reference.runs
    check_goes_on(config, output, reference)


def test_only_a_lock_says_that_nobody_else_is_there(tmp_path, monkeypatch):
    def no_lock(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    for alone in (True, False):
        with hold(tmp_path) as found:
            assert found is alone
        with hold(tmp_path, "shard-0-of-2") as found:
            assert found is False
        monkeypatch.setattr(fcntl, "flock", no_lock)


def test_a_shard_that_is_killed_leaves_the_others_alone(sweep, tmp_path):
    """That shares come to the same rows, in any order, is shown in test_invariance.py."""
    config, _, reference = sweep
    output = tmp_path / "out"
    shards = [at_work(config, output, "--shard", f"{k}/2") for k in range(2)]
    shards[1].go_on()
    shards[0].kill()
    assert shards[0].wait().code == -signal.SIGKILL
    assert shards[1].wait().code == 0
    check_whole(output, reference)
    assert manifest(output)["state"] != "complete"
    assert not (output / "summary.parquet").exists()
    assert nursery().run(*run(config, output, "--shard", "0/2")).code == 0
    check_finished(output, reference)
    sessions = manifest(output)["sessions"]
    assert [entry["shard"] for entry in sessions] == ["0/2", "1/2", "0/2"]
    assert [entry["state"] for entry in sessions[1:]] == ["complete", "complete"]
