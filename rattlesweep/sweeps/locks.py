"""Who works in an output directory: one process a share, by locks that die with their process.

A process that does the whole sweep excludes all others; shares ``I/N`` of the same N may work side
by side.  What a share does first is to hold its own lock, and then it looks whether somebody holds
one that excludes it, so that of two processes that begin at once at most one goes on.
"""

from __future__ import annotations

import contextlib
import errno
import re
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from rattlesweep.errors import OutputError
from rattlesweep.sweeps.files import ABANDONED, explained, remove_temporaries
from rattlesweep.sweeps.sessions import who_holds

FOLDER = ".locks"
WHOLE, MANIFEST = "whole", "manifest"
PATIENCE = 0.5
"""Seconds for which a lock may be in the hands of somebody who only looks at it."""
MANIFEST_PATIENCE = 60.0
NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL)
"""Answers of file systems without locks."""


@contextlib.contextmanager
def hold(directory: Path, share: str | None = None) -> Iterator[None]:
    """Hold a directory, or a share of it such as ``shard-0-of-4``, for a block of code.

    What processes that died there were writing is removed.

    Raises
    ------
    OutputError
        If another process works there, or no lock file can be made.
    """
    folder = directory / FOLDER
    with explained(f"cannot write in {folder}", folder=True):
        folder.mkdir(exist_ok=True)
    with contextlib.ExitStack() as stack:
        mine = share or WHOLE
        if not stack.enter_context(_held(folder / mine, PATIENCE)):
            raise _in_use(directory, share)
        for path in sorted(folder.iterdir()):
            if path.name != mine and _excludes(path.name, share) and at_work(path):
                raise _in_use(directory, None if path.name == WHOLE else path.name)
        for place in (directory, directory / "runs", directory / "sessions"):
            remove_temporaries(place, 0.0 if share is None else ABANDONED)
        yield


@contextlib.contextmanager
def manifest_lock(directory: Path) -> Iterator[None]:
    """Keep other processes from the manifest for a moment."""
    with _held(directory / FOLDER / MANIFEST, MANIFEST_PATIENCE) as held:
        if not held:
            raise OutputError(f"{directory / FOLDER / MANIFEST} has been held for a minute")
        yield


def others_at_work(directory: Path, share: str | None) -> bool:
    """Return whether another process computes runs in the directory."""
    with contextlib.suppress(OSError):
        names = [path for path in (directory / FOLDER).iterdir() if path.name != (share or WHOLE)]
        return any(path.name != MANIFEST and at_work(path) for path in names)
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


def _excludes(name: str, share: str | None) -> bool:
    """Return whether who holds this lock leaves no room for a share, or for the whole."""
    if name == MANIFEST:
        return False
    if share is None or name == WHOLE:
        return True
    counts = [re.fullmatch(r"shard-\d+-of-(\d+)", text) for text in (name, share)]
    return counts[0] is not None and counts[1] is not None and counts[0][1] != counts[1][1]


@contextlib.contextmanager
def _held(path: Path, patience: float) -> Iterator[bool]:
    """Hold a lock file; yield whether that could be done.

    On a file system without locks the answer is yes: two processes may then do the same runs twice,
    which the next one notices.
    """
    lock = FileLock(path)
    with explained(f"cannot write {path}"):
        try:
            lock.acquire(timeout=patience, poll_interval=0.02)
        except Timeout:
            held = False
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
            held = True
        else:
            held = True
    if not held:
        yield False
        return
    try:
        yield True
    finally:
        lock.release()


def _in_use(directory: Path, share: str | None) -> OutputError:
    what = f"{directory}" if share is None else f"{directory}: {share}"
    return OutputError(f"{what} is in use by {who_holds(directory, share)}")
