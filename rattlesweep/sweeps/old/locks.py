"""Who works in an output directory.

Locks are the operating system's (``flock``): they end with the process that holds them, however it
ends, so no lock is ever stale, and their files stay where they are. A whole sweep holds its
directory alone; shards share it, and each holds its own share alone. Where a file system has no
locks, two processes may do the same blocks twice; their files are the same, and each appears in one
step.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shlex
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from rattlesweep.errors import OutputError
from rattlesweep.sweeps.files import explained, read_file
from rattlesweep.sweeps.provenance import command_line, now

fcntl: Any
try:
    fcntl = import_module("fcntl")
except ImportError:  # Windows
    fcntl = None

FOLDER = ".locks"
_WHOLE, _MANIFEST = "directory", "manifest"
# Seconds for which a lock may be in the hands of somebody who only looks.
PATIENCE = 0.3
_MOST_WORDS = 1 << 20
# What flock says where there are no locks, as on some network file systems.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL)


def holder(directory: Path) -> str | None:
    """Who works in a directory, in words; None if nobody does."""
    try:
        names = sorted(os.listdir(directory / FOLDER))
    except OSError:
        return None
    for path in (directory / FOLDER / name for name in names if name != _MANIFEST):
        with contextlib.suppress(OSError), open(path, "rb", opener=_at_once) as handle:
            if _try(handle.fileno(), shared=True) is False:
                return _words(path)
    return None


@contextmanager
def hold(directory: Path, share: str | None = None) -> Iterator[bool]:
    """Hold a directory, which must exist, for a block of code; an OutputError if another does.

    A share, such as ``shard-0-of-7``, leaves other shares to be held meanwhile. Yields whether no
    other process can be at work there: the whole is held, by a lock that exists.
    """
    if fcntl is None:
        yield False
        return
    folder = directory / FOLDER
    with contextlib.ExitStack() as stack:
        with explained(f"cannot write in {folder}", folder=True):
            folder.mkdir(exist_ok=True)
            mine = stack.enter_context(_locked(folder / _WHOLE, shared=share is not None))
            if mine is False:
                raise OutputError(
                    f"{directory} is in use by {holder(directory) or 'another process'}"
                )
            if share and stack.enter_context(_locked(folder / share, shared=False)) is False:
                raise OutputError(f"{directory}: {share} is in use by {_words(folder / share)}")
        yield share is None and mine is True


@contextmanager
def manifest_lock(directory: Path) -> Iterator[None]:
    """Wait until no other shard changes the manifest, and keep others waiting: a moment."""
    path = directory / FOLDER / _MANIFEST
    with contextlib.ExitStack() as stack:
        with explained(f"cannot write {path}"):
            if fcntl is not None and path.parent.is_dir():
                handle = stack.enter_context(open(path, "ab"))
                with contextlib.suppress(OSError):
                    fcntl.flock(handle, fcntl.LOCK_EX)
        yield


@contextmanager
def _locked(path: Path, *, shared: bool) -> Iterator[bool | None]:
    """Hold a lock file, if no other process does; the file says who holds it alone."""
    end = time.monotonic() + PATIENCE
    with open(path, "a+b") as handle:
        while (mine := _try(handle.fileno(), shared=shared)) is False and time.monotonic() < end:
            time.sleep(0.02)
        if mine is not False and not shared:
            handle.truncate(0)
            handle.write(json.dumps(_me()).encode())
            handle.flush()
        yield mine


def _at_once(path: str, flags: int) -> int:
    """Open without waiting, as for somebody at the other end of a FIFO."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _try(handle: int, *, shared: bool) -> bool | None:
    """Lock a file: whether that could be done, None where there are no locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        return None
    return True


def _me() -> dict[str, Any]:
    return {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "command": shlex.join(command_line()),
        "since": now(),
    }


def _words(path: Path) -> str:
    try:
        who = json.loads(read_file(path, _MOST_WORDS))
        return f"`{who['command']}` (process {who['pid']} on {who['host']} since {who['since']})"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
