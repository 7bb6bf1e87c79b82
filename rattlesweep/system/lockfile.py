"""A lock that one process holds at a time, and that ends with it, however that ends.

It has two parts.  One is the system's lock of a file.  Some file systems of clusters
have none, and some have locks that only processes of one machine see.  So a note beside
the file says who holds the lock, and its holder touches the note every second.  Who
wants the lock needs both.  A note is of a dead process if nobody touches it while the
next one watches it for :data:`SILENCE` seconds of its own clock, since clocks of
machines differ.

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

from rattlesweep.system.processors import start_thread
from rattlesweep.words.errors import OutputError

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

# Seconds between two attempts to take a lock, at first and at most.
_POLL = 0.005
LONGEST_POLL = 0.25
BEAT = 1.0  # seconds between two touches of a note
SILENCE = 15.0  # seconds without a touch after which the holder of a note is dead
# Seconds in which another process that saw the same silence may take over the note.
SETTLE = 0.5
_MOST_BYTES = 4096  # of a note
# Errors of file systems and networks without locks.
NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL}
IS_HELD = {errno.EAGAIN, errno.EACCES, errno.EWOULDBLOCK, errno.EDEADLK}
# How files are opened: no link is followed, and opening a pipe does not wait.
AS_IT_IS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


class Holder(NamedTuple):
    """Who holds a lock; `token` is of this hold alone."""

    host: str
    pid: int
    since: str
    token: str
    system: str = ""  # in which the process has its number

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}, since {self.since[:19]} UTC"


class Sight(NamedTuple):
    """What a look at a note shows: its text and when it was touched, in ns."""

    text: bytes
    touched: int


class LockFile:
    """A lock between processes, and between objects of one process."""

    def __init__(self, path: Path, settles: bool = True) -> None:
        """`settles` is False for a hold of a moment, which several may have at once."""
        self._path = path
        self._settles = settles
        self._note = path.with_name(f"{path.name}.note")
        self._handle: int | None = None  # of the locked file
        self._token = ""  # of the note of this object
        self._beating: threading.Event | None = None  # set to end the beat
        self._may_be_dead = False  # whether only a note stands in the way

    def acquire(
        self,
        patience: float = math.inf,
        waiting: Callable[[float], object] = lambda seconds: None,
    ) -> bool:
        """Take the lock, or return False if another holds it for `patience` seconds.

        `waiting` is called now and then with the seconds waited so far, and may raise.
        A holder of a note that may be dead is waited for until that is known.
        """
        start = time.monotonic()
        delay = _POLL
        first = look_at(self._note)
        while not self._try():
            waited = time.monotonic() - start
            # While the note is as at first, its holder may be alive or dead.  The next
            # touch tells, or its silence.
            is_unknown = False
            if self._may_be_dead:
                sight = look_at(self._note)
                is_unknown = sight is not None and sight == first
            if waited >= patience and not is_unknown:
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
        """Return whether another process has taken this one for dead.

        An OSError says that the note cannot be read.
        """
        if not self._token:
            return False
        sight = look_at(self._note)
        holder = None if sight is None else _holder(sight)
        return holder is None or holder.token != self._token

    def holder(self) -> Holder | None:
        """Return who holds the lock, if that can be told."""
        return read_note(self._note)

    def _close(self) -> None:
        if self._handle is not None:
            os.close(self._handle)  # which unlocks the file
            self._handle = None

    def _try(self) -> bool:
        """Take the lock if it is free; return whether it was."""
        self._may_be_dead = False
        handle = _open_to_lock(self._path)
        self._handle = handle
        is_locked = True
        try:
            is_free = lock(handle)
        except OSError as error:
            self._close()
            if error.errno not in NO_LOCKS:
                raise
            is_locked = False  # so the note alone decides
        else:
            # The file may have been removed meanwhile, so that others lock another one.
            if not is_free or not _is_at(handle, self._path):
                self._close()
                return False
        try:
            is_taken = self._take_note()
        except OSError:
            # A full disk has no room for a note; then the system's lock must do.
            if not is_locked:
                raise
            is_taken = True
        if not is_taken:
            self._close()
            return False
        _held.add(self)
        return True

    def _take_note(self) -> bool:
        """Write the note, if no living process has one; return whether it is written.

        From then on a thread touches it again and again.
        """
        try:
            token = _write_note(self._note)
        except FileExistsError:
            is_silent = silence(self._note) >= SILENCE
            if not is_silent and not has_ended(read_note(self._note)):
                self._may_be_dead = True
                return False
            # Of several that do this at once, the last one succeeds.
            mine = self._note.with_name(
                f".{self._note.name}.{secrets.token_hex(4)}.tmp"
            )
            token = _write_note(mine)
            os.replace(mine, self._note)
            if is_silent and self._settles:
                # Others may have seen the same silence, and replace this note.
                time.sleep(SETTLE)
            holder = read_note(self._note)
            if holder is None or holder.token != token:
                return False
        self._token = token
        self._beating = threading.Event()
        beat = threading.Thread(
            target=_beat, args=(self._note, token, self._beating), daemon=True
        )
        try:
            start_thread(beat)
        except OutputError:
            self.release()
            raise
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
        if not lock(handle, shared=True):
            return True
    except OSError as error:
        if error.errno not in NO_LOCKS:
            return None
    finally:
        os.close(handle)
    # Others may have locks that this machine does not see.
    note = path.with_name(f"{path.name}.note")
    try:
        sight = look_at(note)
    except OSError:
        return None
    if sight is None or has_ended(_holder(sight)):
        return False
    age = _age(note, sight)
    if age < -BEAT:
        return None  # a clock was set, or is that of another machine
    return age <= SILENCE


if sys.platform == "win32":

    def lock(handle: int, shared: bool = False) -> bool:
        """Lock an open file; return whether it was free.

        There are no shared locks, so `shared` changes nothing.
        """
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


def _system() -> str:
    """Return the boot and the process namespace of this process; "" if unknown.

    Processes in which these are equal know each other by their numbers.  Names of hosts
    will not do: machines share them, and so do containers.
    """
    with contextlib.suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    return ""


def has_ended(holder: Holder | None) -> bool:
    """Return whether the process that wrote a note is known to have ended.

    It is never known where :func:`_system` is "", as on Windows, where a signal of 0
    would not be without effect.
    """
    if holder is None or holder.pid <= 0 or not holder.system:
        return False
    if holder.system != _system():
        return False
    try:
        os.kill(holder.pid, 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):  # of another user, or a number that none has
        return False
    return False


def _write_note(path: Path) -> str:
    """Write a new note, and return its token; a FileExistsError says that it exists."""
    token = secrets.token_hex(8)
    since = datetime.now(UTC).isoformat(timespec="seconds")
    holder = Holder(socket.gethostname(), os.getpid(), since, token, _system())
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | AS_IT_IS, 0o666)
    try:
        os.write(handle, json.dumps(holder._asdict()).encode())
    except OSError:
        with contextlib.suppress(OSError):
            path.unlink()
        raise
    finally:
        os.close(handle)
    return token


def look_at(note: Path) -> Sight | None:
    """Return what a note shows, None if there is none.

    A link or a folder in its place shows nothing, and is never touched.
    """
    # Network file systems remember the times of files, but look again at an open.
    try:
        handle = os.open(note, os.O_RDONLY | AS_IT_IS)
    except FileNotFoundError:
        return None
    except OSError as error:
        if error.errno == errno.ESTALE:  # it has just been removed
            return None
        if error.errno == errno.ELOOP:
            return Sight(b"", 0)
        raise
    try:
        about = os.fstat(handle)
        if not stat.S_ISREG(about.st_mode):
            return Sight(b"", 0)
        return Sight(os.read(handle, _MOST_BYTES), about.st_mtime_ns)
    finally:
        os.close(handle)


def _holder(sight: Sight) -> Holder | None:
    """Return who wrote a note, None if that cannot be read."""
    with contextlib.suppress(ValueError, TypeError, KeyError):
        values = json.loads(sight.text)
        texts = (str(values[name])[:100] for name in ("host", "since", "token"))
        host, since, token = texts
        system = str(values.get("system", ""))
        return Holder(host, int(values["pid"]), since, token, system)
    return None


def read_note(path: Path) -> Holder | None:
    """Return who wrote a note, None if it is missing or cannot be read."""
    with contextlib.suppress(OSError):
        sight = look_at(path)
        if sight is not None:
            return _holder(sight)
    return None


# Notes that this process watches: what they showed, and since when.
_watched: dict[Path, tuple[Sight, float]] = {}


def silence(note: Path) -> float:
    """Return for how many seconds of its clock this process has seen no touch."""
    sight = look_at(note)
    now = time.monotonic()
    if sight is None:
        _watched.pop(note, None)
        return 0.0
    before, since = _watched.get(note, (None, now))
    if sight != before:
        _watched[note] = sight, now
        return 0.0
    return now - since


def _age(note: Path, sight: Sight) -> float:
    """Return the seconds since a note was touched, below 0 if that is to come."""
    now = time.time_ns()
    # The clock of the file system, which also sets the times of notes.
    with contextlib.suppress(OSError), tempfile.TemporaryFile(dir=note.parent) as file:
        now = os.fstat(file.fileno()).st_mtime_ns
    return (now - sight.touched) / 1e9


def _beat(note: Path, token: str, ended: threading.Event) -> None:
    """Touch a note until the hold ends or another process has taken over."""
    while not ended.wait(BEAT):
        with contextlib.suppress(OSError):  # a disk may fail for a while
            holder = read_note(note)
            if holder is not None and holder.token != token:
                return
            os.utime(note)


# Locks that this process holds. A process that is forked inherits them, and would keep
# them for as long as it lives.
_held: "weakref.WeakSet[LockFile]" = weakref.WeakSet()


def _after_fork() -> None:
    for held in _held:
        held._token = ""
        held._beating = None
        held._close()
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
