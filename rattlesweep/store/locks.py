"""Locks of an output directory: one writer for each shard, or one for all of it.

A lock ends with its process, however that ends.
"""

import contextlib
import math
import os
import re
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from rattlesweep.errors import OutputError, printable
from rattlesweep.files import explained, kept_in_place, remove_unfinished
from rattlesweep.lockfile import LockFile, is_held
from rattlesweep.store.sessions import (
    SESSIONS,
    WHOLE_SWEEP,
    read_sessions,
    unfinished,
    who,
)

LOCKS = ".locks"
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

    The body gets a function to call before it writes. It raises an OutputError if
    another process has taken this one for dead.
    """
    mine = shard or WHOLE_SWEEP
    # First take the lock, then look for others: of two that begin at once at most one
    # goes on.
    with _taken(directory, mine, _PATIENCE) as lock:
        busy = [mine]
        if lock is not None:
            busy = []
            # Shards of the same number may work at once.
            for name in at_work(directory, lambda name: _shards(name) != _shards(mine)):
                # Where a note is the lock, this waits until a dead process is known.
                other = LockFile(directory / LOCKS / name)
                if not other.acquire(0.0):
                    busy = [name]
                    break
                other.release()
        if busy:
            what = (
                f"{directory}" if busy[0] == WHOLE_SWEEP else f"{directory}: {busy[0]}"
            )
            raise OutputError(f"{what} is in use by {_user(directory, busy[0])}")
        assert lock is not None
        if shard is None:  # otherwise other shards may be writing
            remove_unfinished(directory)
            if not (directory / SESSIONS).is_symlink():
                remove_unfinished(directory / SESSIONS)

        def check() -> None:
            if lock.is_lost():
                user = _user(directory, mine)
                lost = "this process was silent for too long, as if it had died"
                raise OutputError(f"{directory}: {lost}, and it is now held by {user}")

        with kept_in_place(directory):
            yield check


def _shards(lock: str) -> str:
    """Return the number of shards in the name of a lock; empty for the whole."""
    return lock.partition("-of-")[2]


def _user(directory: Path, name: str) -> str:
    """Return in words who holds a lock."""
    holder = LockFile(directory / LOCKS / name).holder()
    session = unfinished(read_sessions(directory)).get(name)
    if session is not None and (holder is None or session["pid"] == holder.pid):
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
            advice = "it may be stopped or hang; end it, and run this again"
            raise OutputError(f"{held}; {advice}")
        if seconds - since > WORD_AFTER and not said:
            said = True
            print(f"waiting: {held}", file=sys.stderr, flush=True)

    with _taken(directory, name, waiting=waiting):
        yield


@contextlib.contextmanager
def _taken(
    directory: Path,
    name: str,
    patience: float = math.inf,
    waiting: Callable[[float], object] = lambda seconds: None,
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


def at_work(
    directory: Path, others: Callable[[str], bool] = lambda name: True
) -> list[str]:
    """Return the locks that other processes hold, except the one of the manifest.

    Only names for which `others` is true are looked at.
    """
    return [name for name, held in probe_locks(directory, others).items() if held]


def probe_locks(
    directory: Path, others: Callable[[str], bool] = lambda name: True
) -> dict[str, bool | None]:
    """Return by the names of locks whether they are held, None where none can tell.

    A folder of locks that cannot be read, or is a link, has no names.
    """
    folder = directory / LOCKS
    names: list[str] = []
    with contextlib.suppress(OSError):
        if _is_folder(folder):
            names = sorted(filter(NAMES.fullmatch, os.listdir(folder)))
    return {name: is_held(folder / name) for name in names if others(name)}


def is_readable(directory: Path) -> bool:
    """Return whether it can be told which locks are held; no folder: none."""
    folder = directory / LOCKS
    try:
        return _is_folder(folder) and os.access(folder, os.R_OK | os.X_OK)
    except FileNotFoundError:
        return True
    except OSError:
        return False
