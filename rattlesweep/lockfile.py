"""A lock that one process holds at a time, and that ends with it, however that ends.

It is the system's lock of a file.  Some file systems of clusters have none.  There, a
note beside the file says who holds the lock, and its holder touches the note every
second.  A holder that has been silent for :data:`SILENCE` seconds is taken for dead,
and the next process takes its place.

A name in the folder may be a link to a file of others, so links are not followed, and
no file is truncated or written to: notes are new files.
"""

import contextlib
import errno
import json
import math
import os
import random
import secrets
import socket
import stat
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

# Seconds between two attempts to take a lock, at first and at most.
_POLL = 0.005
LONGEST_POLL = 0.25
BEAT = 1.0  # seconds between two touches of a note
SILENCE = 15.0  # seconds without a touch after which the holder of a note is dead
SETTLE = 0.5  # seconds in which another process may take over the same note
_MOST_BYTES = 4096  # of a note
# Errors of file systems and networks without locks.
NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL}
IS_HELD = {errno.EAGAIN, errno.EACCES, errno.EWOULDBLOCK, errno.EDEADLK}
# Opening a pipe must not wait.
AS_IT_IS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


class Holder(NamedTuple):
    """Who holds a lock; `token` is of this hold alone."""

    host: str
    pid: int
    since: str
    token: str

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}, since {self.since[:19]} UTC"


class LockFile:
    """A lock between processes, and between objects of one process."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._note = path.with_name(f"{path.name}.note")
        self._handle: int | None = None  # of the locked file
        self._is_note = False  # whether the system has no locks here
        self._token = ""  # of the note of this object
        self._beating: threading.Event | None = None  # set to end the beat

    def acquire(
        self,
        patience: float = math.inf,
        waiting: Callable[[float], object] = lambda seconds: None,
    ) -> bool:
        """Take the lock, or return False if another holds it for `patience` seconds.

        `waiting` is called now and then with the seconds waited so far, and may raise.
        Where the system has no locks, a holder that may be dead is waited for until
        that is known.
        """
        start = time.monotonic()
        delay = _POLL
        first_touch = _touched(self._note)
        while not self._try():
            waited = time.monotonic() - start
            if waited >= patience and not self._may_be_dead(first_touch):
                return False
            waiting(waited)
            # Many may wait, and each at times of its own.
            time.sleep(delay * random.uniform(0.5, 1.0))
            delay = min(1.5 * delay, LONGEST_POLL)
        return True

    def release(self) -> None:
        """Release the lock; nothing happens if it is not held."""
        if self._beating is not None:
            self._beating.set()
            self._beating = None
        if self._token:
            holder = read_note(self._note)
            if holder is not None and holder.token == self._token:
                with contextlib.suppress(OSError):
                    self._note.unlink()
            self._token = ""
        self._close()

    def is_lost(self) -> bool:
        """Return whether another process has taken this one for dead."""
        if self._beating is None:
            return False
        holder = read_note(self._note)
        return holder is None or holder.token != self._token

    def holder(self) -> Holder | None:
        """Return who holds the lock, if that can be told."""
        return read_note(self._note)

    def _close(self) -> None:
        if self._handle is not None:
            os.close(self._handle)  # which unlocks the file
            self._handle = None

    def _try(self) -> bool:
        """Take the lock if it is free."""
        handle = _open_to_lock(self._path)
        self._handle = handle
        try:
            locked = lock(handle)
        except OSError as error:
            self._close()
            if error.errno not in NO_LOCKS:
                raise
            self._is_note = True
            return self._take_note()
        # The file may have been removed meanwhile, so that others lock another one.
        if not locked or not _is_at(handle, self._path):
            self._close()
            return False
        _held.add(self)
        # This note is for information only.
        with contextlib.suppress(OSError):
            self._note.unlink(missing_ok=True)
            self._token = _write_note(self._note)
        return True

    def _may_be_dead(self, first_touch: int) -> bool:
        """Return whether the holder of a note has not been seen to touch it."""
        return self._is_note and _touched(self._note) == first_touch != 0

    def _take_note(self) -> bool:
        """Hold the lock by a note that is touched again and again."""
        try:
            token = _write_note(self._note)
        except FileExistsError:
            if not is_silent(self._note):
                return False
            # Of several that do this at once, the last one succeeds.
            mine = self._note.with_name(
                f".{self._note.name}.{secrets.token_hex(4)}.tmp"
            )
            token = _write_note(mine)
            os.replace(mine, self._note)
            time.sleep(SETTLE)
            holder = read_note(self._note)
            if holder is None or holder.token != token:
                return False
        self._token = token
        self._beating = threading.Event()
        beat = threading.Thread(
            target=_beat, args=(self._note, token, self._beating), daemon=True
        )
        beat.start()
        return True


def is_held(path: Path) -> bool | None:
    """Return whether a process holds a lock, None if that cannot be told.

    Nothing is written, so that readers without permission to write may ask.
    """
    try:
        handle = os.open(path, os.O_RDONLY | AS_IT_IS)
    except FileNotFoundError:
        return False
    except OSError:
        return None
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            return None
        return not lock(handle, shared=True)
    except OSError as error:
        if error.errno not in NO_LOCKS:
            return None
        note = path.with_name(f"{path.name}.note")
        return _touched(note) != 0 and not is_silent(note)
    finally:
        os.close(handle)


if sys.platform == "win32":

    def lock(handle: int, shared: bool = False) -> bool:
        """Lock an open file; return whether it was free."""
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            if error.errno in IS_HELD:
                return False
            raise
        return True

else:

    def lock(handle: int, shared: bool = False) -> bool:
        """Lock an open file; return whether it was free.

        A shared lock excludes only those that are not shared.
        """
        kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
        try:
            fcntl.flock(handle, kind | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in IS_HELD:
                return False
            raise
        return True


def _open_to_lock(path: Path) -> int:
    """Open a file, which is made if it is missing; it must be a regular file."""
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | AS_IT_IS, 0o666)
    except PermissionError:
        # Another user's file; most systems lock it all the same.
        handle = os.open(path, os.O_RDONLY | AS_IT_IS)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return handle


def _is_at(handle: int, path: Path) -> bool:
    """Return whether an open file is the one at a path."""
    try:
        return os.path.samestat(os.fstat(handle), os.lstat(path))
    except FileNotFoundError:
        return False


def _write_note(path: Path) -> str:
    """Write a new note, and return its token; a FileExistsError says that it exists."""
    token = secrets.token_hex(8)
    since = datetime.now(UTC).isoformat(timespec="seconds")
    holder = Holder(socket.gethostname(), os.getpid(), since, token)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | AS_IT_IS, 0o666)
    try:
        os.write(handle, json.dumps(holder._asdict()).encode())
    finally:
        os.close(handle)
    return token


def read_note(path: Path) -> Holder | None:
    """Return who wrote a note, None if it is missing or cannot be read."""
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        handle = os.open(path, os.O_RDONLY | AS_IT_IS)
        try:
            values = json.loads(os.read(handle, _MOST_BYTES))
        finally:
            os.close(handle)
        texts = (str(values[name])[:100] for name in ("host", "since", "token"))
        host, since, token = texts
        return Holder(host, int(values["pid"]), since, token)
    return None


def _touched(note: Path) -> int:
    """Return when a note was touched, in ns; 0 if there is none."""
    # Network file systems remember the times of files, but look again at an open.
    with contextlib.suppress(OSError):
        handle = os.open(note, os.O_RDONLY | AS_IT_IS)
        try:
            return os.fstat(handle).st_mtime_ns
        finally:
            os.close(handle)
    return 0


def is_silent(note: Path) -> bool:
    """Return whether the holder of a note has been silent for too long."""
    now = time.time_ns()
    # The clock of the file system, which also sets the times of notes.
    with contextlib.suppress(OSError), tempfile.TemporaryFile(dir=note.parent) as file:
        now = os.fstat(file.fileno()).st_mtime_ns
    return now - _touched(note) > SILENCE * 1e9


def _beat(note: Path, token: str, ended: threading.Event) -> None:
    """Touch a note until the hold ends or another process has taken over."""
    while not ended.wait(BEAT):
        with contextlib.suppress(OSError):  # a disk may fail for a while
            holder = read_note(note)
            if holder is not None and holder.token != token:
                return
            os.utime(note)


# Locks of the system that this process holds. A process that is forked inherits them,
# and would keep them for as long as it lives.
_held: "weakref.WeakSet[LockFile]" = weakref.WeakSet()


def _after_fork() -> None:
    for held in _held:
        held._token = ""
        held._close()
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
