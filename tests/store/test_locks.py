"""Locks of directories: with and without those of the system, for many at once."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import sweeping
from hardship import wait_until

from rattlesweep.store import locks
from rattlesweep.store.locks import (
    LOCKS,
    MANIFEST_LOCK,
    hold,
    locked,
    probe_locks,
)
from rattlesweep.store.progress import status
from rattlesweep.system import lockfile
from rattlesweep.system.lockfile import LockFile, is_held
from rattlesweep.words.errors import OutputError

CONFIG: dict[str, Any] = {
    "model": "gh",
    "bodies": {"source": "sd", "samples": 3},
    "spin": {"n_i": [-0.1, -0.3], "omega_xy0": 0.01},
}


@pytest.fixture
def no_flock(monkeypatch):
    """A file system without locks, whose processes are soon taken for dead."""

    def fail(handle: int, kind: int) -> None:
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", fail)
    monkeypatch.setattr(lockfile, "BEAT", 0.05)
    monkeypatch.setattr(lockfile, "SILENCE", 0.6)
    monkeypatch.setattr(lockfile, "SETTLE", 0.05)


def at_work(directory: Path) -> list[str]:
    """Return the locks that are held."""
    return [name for name, held in probe_locks(directory).items() if held]


def left_by_a_dead_process(directory: Path, name: str) -> None:
    note = {"host": "node7", "pid": 12345, "since": "2020-01-01T00:00:00", "token": "x"}
    (directory / LOCKS).mkdir(exist_ok=True)
    (directory / LOCKS / f"{name}.note").write_text(json.dumps(note))
    (directory / LOCKS / name).touch()


def test_a_lock_file_is_taken_over_when_its_heartbeat_has_stopped(no_flock, tmp_path):
    left_by_a_dead_process(tmp_path, "whole")
    assert at_work(tmp_path) == ["whole"]
    with hold(tmp_path) as check:
        check()
        assert at_work(tmp_path) == ["whole"]
        # The holder lives on, however long it takes.
        time.sleep(2 * lockfile.SILENCE)
        with pytest.raises(OutputError, match=f"in use by process {os.getpid()} on"):
            hold(tmp_path).__enter__()
        check()
    assert at_work(tmp_path) == []


def test_a_process_that_was_taken_for_dead_writes_no_more(no_flock, tmp_path):
    with hold(tmp_path) as check:
        note = tmp_path / LOCKS / "whole.note"
        note.unlink()
        left_by_a_dead_process(tmp_path, "whole")
        with pytest.raises(OutputError, match="now held by process 12345 on node7"):
            check()
    assert note.exists()  # it belongs to another


def test_dead_shards_without_flock_are_waited_for(no_flock, tmp_path):
    left_by_a_dead_process(tmp_path, "shard-0-of-2")
    with hold(tmp_path):
        pass
    assert at_work(tmp_path) == []


def test_status_changes_nothing_where_the_locks_are_links(tmp_path):
    output = tmp_path / "out"
    sweeping.sweep(output, CONFIG)
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    for name in ("thesis.tex", "whole", "shard-0-of-2"):
        (foreign / name).write_text("precious")
    before = sweeping.tree(foreign)
    for path in (output / LOCKS).iterdir():
        path.unlink()
    os.link(foreign / "thesis.tex", output / LOCKS / "shard-1-of-2")
    (output / LOCKS / "whole").symlink_to(foreign / "whole")
    assert status(output).data["at_work"] == []
    with contextlib.suppress(OutputError), hold(output, "shard-1-of-2"):
        pass
    (output / LOCKS).rename(output / ".old")
    (output / LOCKS).symlink_to(foreign)
    assert status(output).data["at_work"] == []
    with pytest.raises(OutputError, match="is a link"):
        hold(output).__enter__()
    assert sweeping.tree(foreign) == before


def test_a_reader_sees_who_is_at_work_and_writes_nothing(tmp_path, monkeypatch):
    output = tmp_path / "out"
    sweeping.sweep(output, CONFIG)
    (record,) = (output / "sessions").iterdir()
    data = json.loads(record.read_text()) | {"how": "running", "ended": None}
    record.write_text(json.dumps(data))
    honest = os.open

    def read_only(path: Any, flags: int, *args: Any, **kwargs: Any) -> int:
        if flags & (os.O_RDWR | os.O_WRONLY | os.O_CREAT):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return honest(path, flags, *args, **kwargs)

    with hold(output):
        monkeypatch.setattr(os, "open", read_only)
        assert len(status(output).data["at_work"]) == 1
    assert "was killed" in status(output).words
    monkeypatch.setattr("rattlesweep.store.progress.is_readable", lambda place: False)
    told = status(output)
    assert "at work or killed (its lock does not tell)" in told.words
    assert "was killed" not in told.words


def test_many_shards_begin_and_are_listed_quickly(tmp_path):
    start = time.process_time()
    with contextlib.ExitStack() as held:
        for index in range(300):
            with locked(tmp_path, MANIFEST_LOCK):
                held.enter_context(hold(tmp_path, f"shard-{index}-of-300"))
        assert len(at_work(tmp_path)) == 300
        with pytest.raises(OutputError, match="is in use by process"):
            hold(tmp_path).__enter__()
    # A tenth of a second was waited for each lock that was held.
    assert time.process_time() - start < 5


def test_who_holds_the_manifest_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(locks, "WORD_AFTER", 0.1)
    monkeypatch.setattr(locks, "GIVE_UP_AFTER", 0.5)
    me = f"process {os.getpid()} on "
    with locked(tmp_path, MANIFEST_LOCK):
        with pytest.raises(OutputError, match=f"is held by {me}.*it may be stopped"):
            locked(tmp_path, MANIFEST_LOCK).__enter__()
        assert capsys.readouterr().err.count(me) == 1


HOLDING = """if True:
    import sys, time
    from pathlib import Path
    from rattlesweep.system.lockfile import LockFile

    assert LockFile(Path(sys.argv[1])).acquire()
    Path(sys.argv[1] + ".ready").touch()
    time.sleep(60)
"""


def test_a_lock_ends_with_its_process(tmp_path):
    path = tmp_path / "a"
    child = subprocess.Popen([sys.executable, "-c", HOLDING, str(path)])
    wait_until((tmp_path / "a.ready").exists)
    assert is_held(path)
    assert not LockFile(path).acquire(0.0)
    child.kill()
    child.wait()
    assert is_held(path) is False
    assert LockFile(path).acquire(0.0)
