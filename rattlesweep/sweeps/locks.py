"""One writer for each shard: locks in an output directory that die with their process.

A process that does the whole sweep excludes all others; shards ``I/N`` of the same N may work side
by side.  A process takes its own lock first and then looks for one that excludes it, so that of two
processes that begin at once at most one goes on.
"""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from rattlesweep.errors import OutputError
from rattlesweep.sweeps.files import explained, remove_temporaries
from rattlesweep.sweeps.provenance import SESSIONS, read_sessions, who

FOLDER = ".locks"
WHOLE, MANIFEST = "whole", "manifest"
PATIENCE, MANIFEST_PATIENCE = 0.5, 60.0
"""Seconds; a lock may be held for a moment by a process that only looks whether it is held."""
ABANDONED = 3600.0
"""Seconds after which a temporary file beside working shards counts as left by a dead process."""
NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL)
"""Answers of file systems without locks, on which each process goes on as if it were alone."""


@contextlib.contextmanager
def hold(directory: Path, shard: str | None = None) -> Iterator[None]:
    """Hold a directory, or a shard such as ``shard-0-of-4``, and tidy up after dead processes.

    Raises
    ------
    OutputError
        If another process works there, or no lock file can be made.
    """
    folder, mine = directory / FOLDER, shard or WHOLE
    with explained(f"cannot write in {folder}", folder=True):
        folder.mkdir(exist_ok=True)
    with _held(folder / mine, PATIENCE) as held:
        if not held:
            raise _in_use(directory, shard)
        for path in sorted(folder.iterdir()):
            beside = shard is not None and _count(path.name) == _count(shard)
            if path.name not in (mine, MANIFEST) and not beside and at_work(path):
                raise _in_use(directory, None if path.name == WHOLE else path.name)
        for place in (directory, directory / "runs", directory / SESSIONS):
            remove_temporaries(place, 0.0 if shard is None else ABANDONED)
        yield


@contextlib.contextmanager
def manifest_lock(directory: Path) -> Iterator[None]:
    """Keep other processes from the manifest for a moment."""
    path = directory / FOLDER / MANIFEST
    with _held(path, MANIFEST_PATIENCE) as held:
        if not held:
            raise OutputError(f"{path} has been held for a minute")
        yield


def others_at_work(directory: Path, shard: str | None) -> bool:
    """Return whether another process computes runs in the directory."""
    with contextlib.suppress(OSError):
        paths = (directory / FOLDER).iterdir()
        return any(p.name not in (shard or WHOLE, MANIFEST) and at_work(p) for p in paths)
    return False


def at_work(path: Path) -> bool:
    """Return whether a process holds a lock file, without waiting."""
    try:
        with FileLock(path).acquire(timeout=0):
            return False
    except Timeout:
        return True
    except OSError:
        return False


def _count(name: str) -> str:
    """Return the N of ``shard-I-of-N``."""
    return name.rpartition("-of-")[2]


@contextlib.contextmanager
def _held(path: Path, patience: float) -> Iterator[bool]:
    """Hold a lock file; yield whether that could be done."""
    lock = FileLock(path)
    with explained(f"cannot write {path}"):
        try:
            lock.acquire(timeout=patience, poll_interval=0.02)
        except Timeout:
            yield False
            return
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
    try:
        yield True
    finally:
        lock.release()


def _in_use(directory: Path, shard: str | None) -> OutputError:
    what = f"{directory}" if shard is None else f"{directory}: {shard}"
    records = [
        record
        for record in read_sessions(directory)
        if record.get("how") == "running" and record.get("shard") == shard
    ]
    return OutputError(f"{what} is in use by {who(records[-1]) if records else 'another process'}")
