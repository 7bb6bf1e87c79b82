"""Provenance and locks: program and machine behind the numbers, the record of each
session, and locks that keep to one writer for each shard and end with their process.
"""

import contextlib
import errno
import json
import os
import platform
import shlex
import socket
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from rattlesweep.errors import OutputError
from rattlesweep.integrate import processors
from rattlesweep.sweeps.files import explained, replace_file

PACKAGES = ("numpy", "numba", "llvmlite", "scipy", "pandas", "pyarrow")
SESSIONS, LOCKS, WHOLE, MANIFEST_LOCK = "sessions", ".locks", "whole", "manifest"
PATIENCE = (
    0.5  # seconds to wait for a lock, which :func:`at_work` may hold for a moment
)
# Errors of file systems without locks, where each process goes on as if it were alone.
NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL)


def versions() -> dict[str, str]:
    """Return the versions of the program and of the packages that the numbers depend
    on.
    """
    own = {"rattlesweep": version("rattlesweep"), "python": platform.python_version()}
    return own | {name: version(name) for name in PACKAGES}


def machine() -> dict[str, Any]:
    """Return system, processor and the number of processors that this process may
    use.
    """
    from llvmlite import binding

    cpu, kind = binding.get_host_cpu_name(), platform.machine()
    return {
        "system": platform.system(),
        "machine": kind,
        "cpu": cpu,
        "processors": processors(),
    }


def now() -> str:
    """Return the time, in UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def command_line() -> list[str]:
    """Return the program and arguments of this process."""
    words = [Path(sys.argv[0]).name, *sys.argv[1:]]
    # Arguments need not be UTF-8, but JSON must be.
    return [word.encode(errors="backslashreplace").decode() for word in words]


@contextlib.contextmanager
def hold(directory: Path, shard: str | None = None) -> Iterator[None]:
    """Hold a directory or a shard, such as ``shard-0-of-4``, or raise an
    OutputError.
    """
    mine = shard or WHOLE
    # First take the lock, then look for others: of two that begin at once at most one
    # goes on.
    with locked(directory, mine, PATIENCE) as free:
        busy = [] if free else [mine]
        count = mine.partition("-of-")[2]  # shards of the same number may work at once
        busy += [
            lock
            for lock in at_work(directory, mine)
            if lock.partition("-of-")[2] != count
        ]
        if busy:
            what = f"{directory}" if busy[0] == WHOLE else f"{directory}: {busy[0]}"
            user = unfinished(read_sessions(directory)).get(busy[0])
            raise OutputError(
                f"{what} is in use by {who(user) if user else 'another process'}"
            )
        if shard is None:  # otherwise other shards may be writing
            for path in [*directory.glob(".*.tmp"), *directory.glob("*/.*.tmp")]:
                with contextlib.suppress(OSError):
                    path.unlink()
        yield


@contextlib.contextmanager
def locked(directory: Path, name: str, patience: float = -1.0) -> Iterator[bool]:
    """Hold a lock of a directory; yield whether it was free within `patience`
    seconds.
    """
    lock, free = FileLock(directory / LOCKS / name, patience, poll_interval=0.02), True
    with explained(f"cannot write in {directory}"):
        (directory / LOCKS).mkdir(exist_ok=True)
        try:
            lock.acquire()
        except Timeout:
            free = False
        except (
            OSError,
            NotImplementedError,
        ) as error:  # older filelock raises the latter
            if isinstance(error, OSError) and error.errno not in NO_LOCKS:
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
        # Errors mean that the directory is another user's, or that there are no locks.
        with contextlib.suppress(OSError, NotImplementedError):
            try:
                FileLock(path).acquire(timeout=0.1, poll_interval=0.02).lock.release()
            except Timeout:
                held.append(path.name)
    return held


@contextlib.contextmanager
def session(
    directory: Path, shard: str | None, threads: int
) -> Iterator[dict[str, Any]]:
    """Keep the record of this process; the body sets ``how`` to say how it ended."""
    begin, pid = datetime.now(UTC), os.getpid()
    path = directory / SESSIONS / f"{begin:%Y%m%dT%H%M%S.%fZ}-{pid}.json"
    record: dict[str, Any] = {
        "started": begin.isoformat(),
        "ended": None,
        "how": "running",
        "shard": shard,
        "command": shlex.join(command_line()),
        "host": socket.gethostname(),
        "pid": pid,
        "threads": threads,
        "machine": machine(),
    }

    def write() -> None:
        with contextlib.suppress(
            OutputError, OSError
        ):  # the sweep does not depend on it
            path.parent.mkdir(exist_ok=True)
            replace_file(path, json.dumps(record, indent=2).encode())

    write()
    try:
        yield record
    except BaseException as error:
        record["how"] = "failed" if isinstance(error, Exception) else "interrupted"
        raise
    finally:
        record["ended"] = now()
        write()


def read_sessions(directory: Path) -> list[dict[str, Any]]:
    """Return the records of a directory, the oldest first, without any that cannot be
    read.
    """
    found = []
    for path in sorted((directory / SESSIONS).glob("*.json")):
        with contextlib.suppress(OSError, ValueError, TypeError):
            found.append({"how": None, "shard": None} | json.loads(path.read_bytes()))
    return found


def unfinished(sessions: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return, by their locks, the last sessions that run or were killed."""
    return {
        each["shard"] or WHOLE: each for each in sessions if each["how"] == "running"
    }


def who(session: dict[str, Any]) -> str:
    """Return the command and process of a session, in words."""
    command, pid, host, since = map(session.get, ("command", "pid", "host", "started"))
    return f"`{command}` (process {pid} on {host}, since {str(since)[:19]} UTC)"
