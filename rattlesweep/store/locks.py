"""Locks of an output directory: one writer for each shard, or one for all of it.

A lock ends with its process, however that ends.
"""

import contextlib
import math
import os
import re
import stat
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from rattlesweep.store.sessions import (
    SESSIONS,
    WHOLE_SWEEP,
    read_sessions,
    unfinished,
    who,
)
from rattlesweep.system import lockfile
from rattlesweep.system.files import explained, kept_in_place, remove_unfinished
from rattlesweep.system.lockfile import LockFile, is_held, silence
from rattlesweep.words.errors import OutputError, printable

LOCKS = ".locks"
FOLDER = "runs"  # holds rows and nothing else: readers take all files there for data
MANIFEST_LOCK = "manifest"
NAMES = re.compile(
    rf"{WHOLE_SWEEP}|shard-\d+-of-\d+"
)  # of locks, without the manifest's
_PATIENCE = 0.5  # seconds to wait for a lock, which a reader may hold for a moment
# Seconds for which one process may hold the manifest until others say so, and give up.
WORD_AFTER = 5.0
GIVE_UP_AFTER = 120.0


@contextlib.contextmanager
def hold(directory: Path, shard: str | None = None) -> Iterator[Callable[[], None]]:
    """Hold a directory, or a shard such as ``shard-0-of-4``; raise an OutputError.

    Meanwhile no file of the directory is written or removed if another process has
    taken this one for dead; see :func:`rattlesweep.system.files.check_place`. The body
    gets a function that asks for this alone, and raises an OutputError then.
    """
    mine = shard or WHOLE_SWEEP
    # First take the lock, then look for others: of two that begin at once at most one
    # goes on.
    waiting = _Word(directory, mine)
    with _taken(directory, mine, _PATIENCE, waiting) as lock:
        busy = mine if lock is None else None
        # Shards of the same number may work at once.
        others = [
            name
            for name in names_of_locks(directory)
            if name != mine and (shard is None or _shards(name) != _shards(mine))
        ]
        if busy is None:
            busy = free_locks(directory, others)
        if busy is not None:
            what = f"{directory}" if busy == WHOLE_SWEEP else f"{directory}: {busy}"
            raise OutputError(f"{what} is in use by {_user(directory, busy)}")
        assert lock is not None
        # What paused holders were writing must not appear later.
        gone = [mine, *others]
        remove_unfinished(directory, None if shard is None else gone)
        remove_unfinished(directory / FOLDER, gone)
        if shard is None and not (directory / SESSIONS).is_symlink():
            remove_unfinished(directory / SESSIONS)

        def check() -> None:
            with explained(f"cannot read {directory / LOCKS}"):
                is_lost = lock.is_lost()
            if is_lost:
                raise OutputError(_lost(directory, lock))

        with kept_in_place(directory, mine, check):
            yield check


def _lost(directory: Path, lock: LockFile) -> str:
    """Return in words that another process has taken a lock from this one."""
    what = f"{directory}: this process was silent for too long, as if it had died"
    holder = lock.holder()
    if holder is None:
        return f"{what}, and its lock was taken or removed; run it again"
    return f"{what}, and it is now held by {printable(str(holder))}"


def free_locks(directory: Path, names: Iterable[str]) -> str | None:
    """Free the locks of dead processes; return the name of one that is alive.

    Where a note is the lock, this waits until it is known. A holder that was only
    paused finds that it has lost the lock.
    """
    noted = [name for name in names if _is_in_use(directory, name)]
    with explained(f"cannot take over locks in {directory / LOCKS}"):
        for name in noted:
            silence(directory / LOCKS / f"{name}.note")  # watch all from now on
        for name in noted:
            other = LockFile(directory / LOCKS / name, settles=False)
            if not other.acquire(_PATIENCE, _Word(directory, name)):
                return name
            other.release()
    return None


def _is_in_use(directory: Path, name: str) -> bool:
    """Return whether a lock is held, or has the note of a process that did not end."""
    path = directory / LOCKS / name
    return bool(is_held(path)) or os.path.lexists(path.with_name(f"{name}.note"))


class _Word:
    """Says, once, for whom a command waits."""

    def __init__(self, directory: Path, name: str) -> None:
        self._directory = directory
        self._name = name
        self._said = False

    def __call__(self, seconds: float) -> None:
        if seconds < WORD_AFTER or self._said:
            return
        self._said = True
        user = _user(self._directory, self._name)
        print(
            f"waiting: {self._directory} is held by {user}, which is silent; it is "
            f"taken for dead after {lockfile.SILENCE:g} s without a sign",
            file=sys.stderr,
            flush=True,
        )


def _shards(lock: str) -> str:
    """Return the number of shards in the name of a lock; empty for the whole."""
    return lock.partition("-of-")[2]


def _user(directory: Path, name: str) -> str:
    """Return in words who holds a lock."""
    holder = LockFile(directory / LOCKS / name).holder()
    session = unfinished(read_sessions(directory)).get(name)
    if session is not None:
        is_same = holder is None or (
            session["pid"] == holder.pid and session["host"] == holder.host
        )
        if is_same:
            return who(session)
    return "another process" if holder is None else printable(str(holder))


@contextlib.contextmanager
def locked(directory: Path, name: str) -> Iterator[None]:
    """Hold a lock that others hold for moments only, as that of the manifest.

    Who holds it for long is named, and waited for until it seems to be stopped.
    """
    lock = LockFile(directory / LOCKS / name)
    seen = lock.holder()
    since = 0.0
    said = False

    def waiting(seconds: float) -> None:
        nonlocal seen, since, said
        now = lock.holder()
        if now != seen:
            seen = now
            since = seconds
        user = "another process" if now is None else printable(str(now))
        held = f"{directory / LOCKS / name} is held by {user}"
        if seconds - since > GIVE_UP_AFTER:
            raise OutputError(
                f"{held}; it may be stopped or hang; end it, and run this again"
            )
        if seconds - since > WORD_AFTER and not said:
            said = True
            print(f"waiting: {held}", file=sys.stderr, flush=True)

    def check() -> None:
        if lock.is_lost():
            raise OutputError(_lost(directory, lock))

    with _taken(directory, name, math.inf, waiting) as taken:
        assert taken is not None
        lock = taken
        remove_unfinished(directory, [name])
        with kept_in_place(directory, name, check):
            yield


@contextlib.contextmanager
def _taken(
    directory: Path,
    name: str,
    patience: float,
    waiting: Callable[[float], object],
) -> Iterator[LockFile | None]:
    """Hold a lock; yield None if it was not free within `patience` seconds."""
    folder = directory / LOCKS
    lock = LockFile(folder / name)
    with explained(f"cannot write in {directory}"):
        folder.mkdir(exist_ok=True)
        if not _is_folder(folder):
            raise OutputError(f"{folder} is a link; remove it, and run this again")
        free = lock.acquire(patience, waiting)
    try:
        yield lock if free else None
    finally:
        lock.release()


def _is_folder(path: Path) -> bool:
    """Return whether there is a folder at a path, and no link to one."""
    return stat.S_ISDIR(os.lstat(path).st_mode)


def probe_locks(directory: Path) -> dict[str, bool | None]:
    """Return by the names of locks whether they are held, None where none can tell.

    A folder of locks that cannot be read, or is a link, has no names.
    """
    folder = directory / LOCKS
    return {name: is_held(folder / name) for name in names_of_locks(directory)}


def names_of_locks(directory: Path) -> list[str]:
    """Return the names of all locks but the manifest's."""
    folder = directory / LOCKS
    with contextlib.suppress(OSError):
        if _is_folder(folder):
            return sorted(filter(NAMES.fullmatch, os.listdir(folder)))
    return []


def is_readable(directory: Path) -> bool:
    """Return whether it can be told which locks are held; no folder: none."""
    folder = directory / LOCKS
    try:
        return _is_folder(folder) and os.access(folder, os.R_OK | os.X_OK)
    except FileNotFoundError:
        return True
    except OSError:
        return False
