"""Two processes in one directory: they share it by shards, or the second is told who is there."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import signal
import socket
from pathlib import Path
from typing import Any

import duckdb
import pandas as pd
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

from rattlesweep.sweeps.cases.shards import Shard
from rattlesweep.sweeps.inspect.verify import verify
from rattlesweep.sweeps.store.locks import hold, holder


def no_lock(*_: object) -> None:
    """`flock` on a file system without locks."""
    raise OSError(errno.ENOLCK, "No locks available")


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Reference]:
    """A config, its sweep, and that remembered."""
    return finished_sweep(tmp_path_factory.mktemp("sweep"))


def at_work(config: Path, output: Path, *options: str, **how: Any) -> Child:
    """A sweep that holds its directory after a block, until it is let go on."""
    how, before = how or {"hold": 1}, len(blocks_of(output))
    child = nursery().start("run", config, "--output", output, "-q", *options, **how)
    wait_until(lambda: child.ended() or len(blocks_of(output)) > before)
    assert not child.ended(), child.wait()
    return child


def told_who(done: Ended, child: Child, output: Path, *args: Any) -> bool:
    """Whether a command was refused, and said who works there."""
    command = " ".join(map(str, args))
    who = (
        rf"`rattlesweep {re.escape(command)}` \(process {child.pid} on {socket.gethostname()} since"
    )
    where = re.escape(str(output))
    return bool(
        done.code == 1
        and one_sentence(done.err)
        and re.match(rf"error: {where}(: shard-\S+)? is in use by {who} \S+\)\n", done.err)
    )


def test_a_second_run_is_told_who_works_there(sweep, tmp_path):
    config, _, reference = sweep
    output = tmp_path / "out"
    first = at_work(config, output)
    first.kill(signal.SIGSTOP)  # for as long as the others take
    args = ("run", config, "--output", output, "-q")
    for command in (
        args,
        (*args, "--fresh"),
        (*args, "--retry-failed"),
        (*args, "--shard", "0/2"),
        ("classify", output, "--set", OTHER_TYPES),
    ):
        done = nursery().run(*command)
        assert told_who(done, first, output, *args), done
    first.go_on()
    first.kill(signal.SIGCONT)
    assert first.wait().code == 0
    check_finished(output, reference)


def test_who_only_looks_does_not_disturb(sweep, tmp_path):
    config, _, reference = sweep
    output = tmp_path / "out"
    first = at_work(config, output, pace=0.05)
    while not first.ended():
        words = holder(output)
        assert words is None or f"process {first.pid} " in words
        assert all("missing" not in problem for problem in verify(output).problems)
        assert nursery().run("status", output).code == 0
        # Readers see complete blocks of two runs, each once, now as at any time.
        for frame in (
            pd.read_parquet(output / "runs"),
            duckdb.sql(f"select * from '{output}/runs/*.parquet'").df(),
        ):
            assert 0 < len(frame) == 2 * len(frame.groupby(["case", frame["sample"] // 2]))
            assert not frame.duplicated(["case", "sample"]).any()
    assert first.wait().code == 0
    check_finished(output, reference)
    # A run that begins while others look gets its turn.
    for _ in range(10):
        child = nursery().start("run", config, "--output", output, "-q")
        while not child.ended():
            holder(output)
        assert child.wait().code == 0


@pytest.mark.parametrize("second", ["run", "classify"])
def test_two_that_begin_at_once_never_mix(second, sweep, tmp_path):
    config, _, reference = sweep
    other = tmp_path / "other"
    run = ("run", config, "--output", "{}", "-q")
    assert nursery().run("run", config, "--output", other, "-q").code == 0
    assert nursery().run("classify", other, "--set", OTHER_TYPES).code == 0
    references = reference, Reference.of(other)
    ends = []
    for place in range(3):
        output = tmp_path / str(place)
        commands = [run, run if second == "run" else ("classify", "{}", "--set", OTHER_TYPES)]
        if second == "classify":
            # Half done: the one has blocks to do, the other types to change.
            assert nursery().run("run", config, "--output", output, "-q").code == 0
            for index in range(0, 12, 2):
                (output / f"runs/block-{index:06d}.parquet").unlink()
        children = [
            nursery().start(*(output if part == "{}" else part for part in command))
            for command in commands
        ]
        done = [child.wait() for child in children]
        ends.append(tuple(end.code for end in done))
        assert 0 in ends[-1], done
        for end in done:
            assert end.code == 0 or (one_sentence(end.err) and "is in use by" in end.err), end
        check_whole(output, *references)
        check_goes_on(config, output, reference)
    assert set(ends) <= {(0, 0), (0, 1), (1, 0)}


@pytest.mark.parametrize("then", ["nothing", "an empty directory", "another sweep"])
def test_a_directory_that_is_moved_is_left_alone(then, sweep, tmp_path):
    """Whatever takes its place, nothing of the sweep goes there, and no sentence is missing."""
    config, _, reference = sweep
    output, moved = tmp_path / "out", tmp_path / "moved"
    first = at_work(config, output)
    first.kill(signal.SIGSTOP)
    output.rename(moved)
    other: Child | None = None
    if then == "another sweep":
        other = at_work(config, output, "--set", "seed=1")
    elif then == "an empty directory":
        (output / "runs").mkdir(parents=True)
    first.go_on()
    first.kill(signal.SIGCONT)
    done = first.wait()
    assert done.code == 1, done
    assert one_sentence(done.err)
    assert "has been moved, removed or replaced while it was in use" in done.err
    if other is not None:
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
    for text in ("", "{", "[]", json.dumps({"pid": os.getpid(), "host": socket.gethostname(),
                                             "command": "x", "since": "today"})):  # fmt: skip
        for command in (("run", config, "--output", output, "-q"), ("classify", output)):
            (output / ".locks").mkdir(exist_ok=True)
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
    args = ("run", config, "--output", output, "-q")
    first = at_work(config, output, hold=1, calls=no_locks)
    second = nursery().start(*args, calls=no_locks)
    first.go_on()
    assert first.wait().code == 0
    assert second.wait().code == 0
    assert blocks_of(output) == reference.runs
    assert nursery().run(*args).code == 0
    check_finished(output, reference)


@pytest.mark.parametrize(("lock", "alone"), [(fcntl.flock, True), (no_lock, False)])
def test_only_a_lock_says_that_nobody_else_is_there(lock, alone, tmp_path, monkeypatch):
    monkeypatch.setattr(fcntl, "flock", lock)
    with hold(tmp_path) as found:
        assert found is alone
    with hold(tmp_path, "shard-0-of-2") as found:
        assert found is False


# -- shards ------------------------------------------------------------------------------------


def test_two_shards_at_once_share_a_directory(sweep, tmp_path):
    config, _, reference = sweep
    output = tmp_path / "out"
    shards = [at_work(config, output, "--shard", f"{k}/2") for k in range(2)]
    for shard in shards:
        shard.go_on()
    done = [shard.wait() for shard in shards]
    assert [end.code for end in done] == [0, 0], done
    check_finished(output, reference)
    said = manifest(output)
    assert [entry["shard"] for entry in said["sessions"]] == ["0/2", "1/2"]
    assert [entry["state"] for entry in said["sessions"]] == ["complete", "complete"]
    assert sum(entry["blocks"] for entry in said["sessions"]) == 12


@pytest.mark.parametrize("count", [2, 5])
def test_shards_that_begin_at_once(count, sweep, tmp_path):
    config, _, reference = sweep
    for place in range(2):
        output = tmp_path / str(place)
        shards = [
            nursery().start("run", config, "--output", output, "--shard", Shard(k, count), "-q")
            for k in range(count)
        ]
        done = [shard.wait() for shard in shards]
        assert {end.code for end in done} == {0}, done
        check_finished(output, reference)


def test_shards_one_after_the_other(sweep, tmp_path):
    config, _, reference = sweep
    output = tmp_path / "out"
    for k in range(3):
        done = nursery().run("run", config, "--output", output, "--shard", f"{k}/3")
        assert done.code == 0
        assert (output / "summary.parquet").exists() == (k == 2)
        assert ("of other shards are not in" in done.err) == (k < 2)
        assert (manifest(output)["state"] == "complete") == (k == 2)
    check_finished(output, reference)


def test_the_same_share_twice_or_all_of_it_is_refused(sweep, tmp_path):
    config, _, reference = sweep
    output = tmp_path / "out"
    first = at_work(config, output, "--shard", "0/2")
    first.kill(signal.SIGSTOP)
    run = ("run", config, "--output", output, "-q")
    who = (*run, "--shard", "0/2")
    for command in (who, run, (*run, "--fresh"), ("classify", output, "--set", OTHER_TYPES)):
        done = nursery().run(*command)
        assert told_who(done, first, output, *who), done
    first.go_on()
    first.kill(signal.SIGCONT)
    assert first.wait().code == 0
    assert nursery().run(*run).code == 0
    check_finished(output, reference)


def test_a_shard_that_is_killed_leaves_the_others_alone(sweep, tmp_path):
    config, _, reference = sweep
    output = tmp_path / "out"
    shards = [at_work(config, output, "--shard", f"{k}/2") for k in range(2)]
    shards[1].go_on()
    shards[0].kill()
    assert shards[0].wait().code == -signal.SIGKILL
    assert shards[1].wait().code == 0
    check_whole(output, reference)
    assert manifest(output)["state"] != "complete"
    options = ("--shard", "0/2", "-q")
    assert nursery().run("run", config, "--output", output, *options).code == 0
    check_finished(output, reference)
