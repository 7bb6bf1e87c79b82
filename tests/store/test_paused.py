"""Holders that were paused, clocks that differ, and locks of one machine alone."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pytest
import sweeping

from rattlesweep.store import locks
from rattlesweep.store.locks import LOCKS, MANIFEST_LOCK, hold, locked
from rattlesweep.store.merging import Writer
from rattlesweep.store.progress import status
from rattlesweep.store.rows import Stored, open_stored, same_bits, typed_by
from rattlesweep.store.sessions import session
from rattlesweep.system import lockfile
from rattlesweep.system.files import check_place
from rattlesweep.system.lockfile import is_held
from rattlesweep.words.errors import OutputError

CONFIG: dict[str, Any] = {
    "model": "gh",
    "bodies": {"source": "sd", "samples": 3},
    "spin": {"n_i": [-0.1, -0.3], "omega_xy0": 0.01},
}
SHARD = "shard-0-of-1"
NOTE = {"host": "node7", "pid": 4242, "since": "2020-01-01T00:00:00", "token": "x"}


@pytest.fixture(params=["no locks", "locks of one machine"])
def apart(request, monkeypatch):
    """A file system on which processes do not see each other's locks.

    Holders never touch their notes again, as if they were paused.
    """

    def flock(handle: int, kind: int) -> None:
        if request.param == "no locks":
            raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", flock)
    monkeypatch.setattr(lockfile, "BEAT", 1000.0)
    monkeypatch.setattr(lockfile, "SILENCE", 0.3)
    monkeypatch.setattr(lockfile, "SETTLE", 0.01)


@pytest.fixture
def emptied(tmp_path) -> tuple[Stored, pa.Table, str]:
    """Return a directory without rows, its rows, and how they were typed."""
    output = tmp_path / "out"
    sweeping.sweep(output, CONFIG)
    stored = open_stored(output)
    table = stored.read()
    typed = typed_by(stored.files()[0])
    for path in stored.files():
        path.unlink()
    return stored, table, typed


def leave_note(directory: Path, name: str, ahead: float = 0.0, **keys: Any) -> Path:
    (directory / LOCKS).mkdir(exist_ok=True)
    (directory / LOCKS / name).touch()
    note = directory / LOCKS / f"{name}.note"
    note.write_text(json.dumps(NOTE | keys))
    os.utime(note, (time.time() + ahead,) * 2)
    return note


def in_another_thread(work: Any) -> None:
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()


@pytest.mark.parametrize("call", ["link", "replace"])
def test_a_writer_paused_at_its_last_step_changes_nothing(
    call, apart, emptied, monkeypatch
):
    stored, table, typed = emptied
    honest = getattr(os, call)

    def take_over() -> None:
        with hold(stored.directory, SHARD):
            rest = table.filter(pa.array(~stored.find().done.ravel()))
            Writer(stored, typed).write(rest)

    def pause(*args: Any) -> None:
        monkeypatch.setattr(os, call, honest)
        in_another_thread(take_over)
        honest(*args)

    with hold(stored.directory, SHARD):
        writer = Writer(stored, typed)
        if call == "replace":  # the file of these rows grows
            writer.write(table.slice(0, 2))
        monkeypatch.setattr(os, call, pause)
        with pytest.raises(OutputError, match="cannot write"):
            writer.write(table.slice(2, 2))
        # It also says why, once it is asked to write again.
        with pytest.raises(OutputError, match="as if it had died, and its lock was"):
            writer.write(table.slice(2, 2))
    assert same_bits(stored.read(), table)
    assert not list(stored.directory.glob(".*.tmp"))


def test_who_waits_for_the_manifest_leaves_no_file_of_who_was_paused(apart, emptied):
    stored, _, _ = emptied

    def take_over() -> None:
        with locked(stored.directory, MANIFEST_LOCK):
            pass

    with locked(stored.directory, MANIFEST_LOCK), hold(stored.directory, SHARD):
        in_another_thread(take_over)
        # The lock of the shard is still its own.
        with pytest.raises(OutputError, match="silent for too long"):
            stored.write_manifest()


def test_a_shard_that_was_silent_is_told_that_others_have_begun(apart, emptied):
    stored, table, typed = emptied

    def take_over() -> None:
        with hold(stored.directory):
            pass

    with hold(stored.directory, "shard-0-of-2"):
        note = stored.directory / LOCKS / "shard-0-of-2.note"
        os.utime(note, (0, 0))  # long silent by any clock
        in_another_thread(take_over)
        with pytest.raises(OutputError, match="silent for too long"):
            stored.append(table, typed)
    assert stored.count() == 0


def test_holders_that_are_alive_are_told_by_their_notes(apart, tmp_path, monkeypatch):
    monkeypatch.setattr(lockfile, "BEAT", 0.02)
    monkeypatch.setattr(lockfile, "SILENCE", 10.0)
    with hold(tmp_path), pytest.raises(OutputError, match="in use by process"):
        hold(tmp_path).__enter__()
    with hold(tmp_path):  # a lock that was released is free at once
        pass


@pytest.mark.parametrize("ahead", [3600.0, -3600.0])
def test_silence_is_counted_by_the_clock_of_who_waits(
    ahead, apart, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(locks, "WORD_AFTER", 0.1)
    note = leave_note(tmp_path, "whole", ahead)
    start = time.monotonic()
    with hold(tmp_path):
        assert time.monotonic() - start >= lockfile.SILENCE
        assert lockfile.read_note(note) != NOTE
    said = capsys.readouterr().err
    assert said.count("held by process 4242 on node7") == 1
    assert "taken for dead after 0.3 s" in said


def test_many_dead_holders_are_waited_for_at_once(apart, tmp_path):
    for index in range(20):
        leave_note(tmp_path, f"shard-{index}-of-20")
    start = time.monotonic()
    with hold(tmp_path):
        pass
    assert time.monotonic() - start < 10 * lockfile.SILENCE  # one after the other: 20


def test_a_dead_process_of_this_system_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(lockfile, "SILENCE", 1000.0)
    holding = (
        "import os, sys; from pathlib import Path\n"
        "from rattlesweep.system.lockfile import LockFile\n"
        "assert LockFile(Path(sys.argv[1])).acquire(); os.kill(os.getpid(), 9)"
    )
    (tmp_path / LOCKS).mkdir()
    path = tmp_path / LOCKS / "whole"
    subprocess.run([sys.executable, "-c", holding, str(path)], check=False)
    assert path.with_name("whole.note").exists()
    assert is_held(path) is False
    with hold(tmp_path):
        pass


def test_a_time_to_come_tells_nothing_of_who_is_at_work(tmp_path):
    output = tmp_path / "out"
    sweeping.sweep(output, CONFIG)
    with session(output, None, 1):
        for ahead, told in (
            (3600.0, "at work or killed"),
            (0.0, "at work: the whole sweep"),
            (-3600.0, "was killed"),
        ):
            leave_note(output, "whole", ahead)
            assert told in status(output).words


def test_status_says_that_kernels_are_compiled(tmp_path):
    output = tmp_path / "out"
    sweeping.sweep(output, CONFIG)
    with hold(output), session(output, None, 1) as (_, began):
        assert "compiling or loading kernels" in status(output).words
        began()
        assert "at work: the whole sweep" in status(output).words
        assert "compiling" not in status(output).words


def test_equal_rows_twice_are_dropped_by_run_and_others_refused(tmp_path):
    output = tmp_path / "out"
    sweeping.sweep(output, CONFIG)
    stored = open_stored(output)
    table = stored.read()
    typed = typed_by(stored.files()[0])
    for first, count in ((0, 4), (3, 3)):
        stored.append(table.slice(first, count), typed)
    with pytest.raises(OutputError, match="or let `rattlesweep run` without --shard"):
        status(output)
    sweeping.sweep(output, CONFIG)
    assert same_bits(stored.read(), table)
    assert stored.find().rows == len(table)

    place = table.schema.get_field_index("t_r")
    changed = table.set_column(
        place, table.schema.field(place), pc.add(table.column("t_r"), 1.0)
    )
    stored.append(changed.slice(2, 1), typed)
    before = sweeping.tree(stored.folder)
    with pytest.raises(OutputError, match="hold other values of the same runs"):
        sweeping.sweep(output, CONFIG)
    assert sweeping.tree(stored.folder) == before


def test_the_lost_lock_names_no_process_of_before(apart, tmp_path):
    with hold(tmp_path), session(tmp_path, None, 1):
        (tmp_path / LOCKS / "whole.note").unlink()
        with pytest.raises(OutputError, match="its lock was taken or removed") as told:
            check_place(tmp_path / "a")
    assert str(os.getpid()) not in str(told.value)
