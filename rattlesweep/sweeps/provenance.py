"""Where numbers come from: program and machine; sessions in a directory, and locks that keep to
one writer for each shard and die with their process.
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
from rattlesweep.sweeps.files import explained, replace_file

PACKAGES = ("numpy", "numba", "llvmlite", "scipy", "pandas", "pyarrow")
SESSIONS, LOCKS, WHOLE, MANIFEST_LOCK = "sessions", ".locks", "whole", "manifest"
PATIENCE = 0.5  # seconds; who only looks whether a lock is held has it for a moment
# Answers of file systems without locks, on which each process goes on as if it were alone.
NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL)


def package_version() -> str:
    """Return the version of rattlesweep."""
    return version("rattlesweep")


def versions() -> dict[str, str]:
    """Return the versions of what the numbers depend on."""
    own = {"rattlesweep": package_version(), "python": platform.python_version()}
    return own | {name: version(name) for name in PACKAGES}


def machine() -> dict[str, Any]:
    """Return system, processor and the number of processors that this process may use."""
    from llvmlite import binding

    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    cpu, kind = binding.get_host_cpu_name(), platform.machine()
    return {"system": platform.system(), "machine": kind, "cpu": cpu, "processors": allowed}


def now() -> str:
    """Return the time, in UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def command_line() -> list[str]:
    """Return the words of the command that this process is."""
    words = [Path(sys.argv[0]).name, *sys.argv[1:]]  # which need not be UTF-8, and JSON must
    return [word.encode(errors="backslashreplace").decode() for word in words]


@contextlib.contextmanager
def session(directory: Path, shard: str | None, threads: int) -> Iterator[dict[str, Any]]:
    """Keep the record of this process; a body that returns says in ``how`` how it ended."""
    begin, pid, command = datetime.now(UTC), os.getpid(), shlex.join(command_line())
    path = directory / SESSIONS / f"{begin:%Y%m%dT%H%M%S.%fZ}-{pid}.json"
    record: dict[str, Any] = {"started": begin.isoformat(), "ended": None, "how": "running"}
    record |= {"shard": shard, "command": command, "host": socket.gethostname(), "pid": pid}
    record |= {"threads": threads, "machine": machine()}

    def write() -> None:
        with contextlib.suppress(OutputError, OSError):  # a full disk does not matter here
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
    """Return the records of a directory, the oldest first; what cannot be read is left out."""
    found = []
    for path in sorted((directory / SESSIONS).glob("*.json")):
        with contextlib.suppress(OSError, ValueError, TypeError):
            found.append({"how": None, "shard": None} | json.loads(path.read_bytes()))
    return found


def who(session: dict[str, Any]) -> str:
    """Return the command and process of a session, in words."""
    command, pid, host, since = map(session.get, ("command", "pid", "host", "started"))
    return f"`{command}` (process {pid} on {host}, since {str(since)[:19]} UTC)"


@contextlib.contextmanager
def locked(directory: Path, name: str, patience: float = -1.0) -> Iterator[bool]:
    """Hold a lock of a directory; yield whether it was free within `patience` seconds."""
    lock, free = FileLock(directory / LOCKS / name, patience, poll_interval=0.02), True
    with explained(f"cannot write in {directory}"):
        (directory / LOCKS).mkdir(exist_ok=True)
        try:
            lock.acquire()
        except Timeout:
            free = False
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
    try:
        yield free
    finally:
        lock.release()


@contextlib.contextmanager
def hold(directory: Path, shard: str | None = None) -> Iterator[None]:
    """Hold a directory, or a shard such as ``shard-0-of-4``; others of as many may be held."""
    # Its own lock first, and then a look for others: of two that begin at once at most one goes on.
    mine = shard or WHOLE
    with locked(directory, mine, PATIENCE) as free:
        busy = [] if free else [mine]
        count = mine.partition("-of-")[2]
        busy += [o for o in at_work(directory, mine) if o.partition("-of-")[2] != count]
        if busy:
            what = f"{directory}" if busy[0] == WHOLE else f"{directory}: {busy[0]}"
            by = [who(s) for s in read_sessions(directory)
                  if s["how"] == "running" and (s["shard"] or WHOLE) == busy[0]]  # fmt: skip
            raise OutputError(f"{what} is in use by {by[-1] if by else 'another process'}")
        left = [*directory.glob(".*.tmp"), *directory.glob("*/.*.tmp")]
        for path in left if shard is None else []:  # other shards may be writing
            with contextlib.suppress(OSError):
                path.unlink()
        yield


def at_work(directory: Path, mine: str | None = None) -> list[str]:
    """Return the locks that other processes hold, but that on the manifest."""
    held = []
    for path in sorted((directory / LOCKS).glob("*")):
        # Who only looks has it for a moment; errors come of somebody else's directory, or no locks.
        if path.name not in (mine, MANIFEST_LOCK):
            with contextlib.suppress(OSError):
                try:
                    FileLock(path).acquire(timeout=0.1, poll_interval=0.02).lock.release()
                except Timeout:
                    held.append(path.name)
    return held
