"""Locks of an output directory: one writer for each shard, or one for all of it.

A lock ends with its process, however that ends.
"""

import contextlib
import errno
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from rattlesweep.errors import OutputError
from rattlesweep.sweeps.files import explained, kept_in_place, remove_unfinished
from rattlesweep.sweeps.sessions import SESSIONS, WHOLE, read_sessions, unfinished, who

LOCKS = ".locks"
MANIFEST_LOCK = "manifest"
# Seconds to wait for a lock, which :func:`at_work` may hold for a moment.
PATIENCE = 0.5
POLL = 0.02  # seconds between two attempts to take a lock
# Errors of file systems without locks, where each process goes on as if it were alone.
NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL)


@contextlib.contextmanager
def hold(directory: Path, shard: str | None = None) -> Iterator[None]:
    """Hold a directory, or a shard such as ``shard-0-of-4``; raise an OutputError."""
    mine = shard or WHOLE
    # First take the lock, then look for others: of two that begin at once at most one
    # goes on.
    with locked(directory, mine, PATIENCE) as free:
        busy = [] if free else [mine]
        for lock in at_work(directory, mine):
            # Shards of the same number may work at once.
            if _shards(lock) != _shards(mine):
                busy.append(lock)
        if busy:
            what = f"{directory}" if busy[0] == WHOLE else f"{directory}: {busy[0]}"
            user = unfinished(read_sessions(directory)).get(busy[0])
            by = "another process" if user is None else who(user)
            raise OutputError(f"{what} is in use by {by}")
        if shard is None:  # otherwise other shards may be writing
            remove_unfinished(directory)
            if not (directory / SESSIONS).is_symlink():
                remove_unfinished(directory / SESSIONS)
        with kept_in_place(directory):
            yield


def _shards(lock: str) -> str:
    """Return the number of shards in the name of a lock; empty for the whole."""
    return lock.partition("-of-")[2]


@contextlib.contextmanager
def locked(directory: Path, name: str, patience: float = -1.0) -> Iterator[bool]:
    """Hold a lock; yield whether it was free within `patience` seconds."""
    lock = FileLock(directory / LOCKS / name, patience, poll_interval=POLL)
    free = True
    with explained(f"cannot write in {directory}"):
        (directory / LOCKS).mkdir(exist_ok=True)
        try:
            lock.acquire()
        except Timeout:
            free = False
        except NotImplementedError:  # of an older filelock, without locks
            pass
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
    try:
        yield free
    finally:
        lock.release()


def at_work(directory: Path, mine: str | None = None) -> list[str]:
    """Return the locks that other processes hold, except the one of the manifest."""
    held = []
    for path in sorted((directory / LOCKS).glob("*")):
        if path.name in (mine, MANIFEST_LOCK):
            continue
        lock = FileLock(path)
        # Errors mean that the directory is another user's, or that there are no locks.
        with contextlib.suppress(OSError, NotImplementedError):
            try:
                lock.acquire(timeout=0.1, poll_interval=POLL)
                lock.release()
            except Timeout:
                held.append(path.name)
    return held
