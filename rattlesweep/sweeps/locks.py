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
from rattlesweep.sweeps.files import explained
from rattlesweep.sweeps.provenance import SESSIONS, read_sessions, who

FOLDER, WHOLE = ".locks", "whole"
PATIENCE = 0.5
"""Seconds; a lock may be held for a moment by a process that only looks whether it is held."""
NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL)
"""Answers of file systems without locks, on which each process goes on as if it were alone."""


@contextlib.contextmanager
def hold(directory: Path, shard: str | None = None) -> Iterator[None]:
    """Hold a directory, or a shard such as ``shard-0-of-4``, and tidy up after dead processes.

    Raise an OutputError if another process works there.
    """
    mine, busy = shard or WHOLE, []
    lock = FileLock(directory / FOLDER / mine)
    with explained(f"cannot write in {directory}"):
        (directory / FOLDER).mkdir(exist_ok=True)
        try:
            lock.acquire(timeout=PATIENCE, poll_interval=0.02)
        except Timeout:
            busy = [mine]
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
    try:
        beside = None if shard is None else shard.partition("-of-")[2]
        busy += [o for o in at_work(directory, mine) if o.partition("-of-")[2] != beside]
        if busy:
            what = f"{directory}" if busy[0] == WHOLE else f"{directory}: {busy[0]}"
            by = [who(s) for s in read_sessions(directory)
                  if s["how"] == "running" and (s["shard"] or WHOLE) == busy[0]]  # fmt: skip
            raise OutputError(f"{what} is in use by {by[-1] if by else 'another process'}")
        if shard is None:  # other shards may be writing
            for folder in (directory, directory / "runs", directory / SESSIONS):
                for path in folder.glob(".*.tmp"):
                    with contextlib.suppress(OSError):
                        path.unlink()
        yield
    finally:
        lock.release()


def at_work(directory: Path, mine: str | None = None) -> list[str]:
    """Return the locks that other processes hold, without waiting."""
    held = []
    for path in sorted((directory / FOLDER).glob("*")):
        if path.name != mine:
            try:
                with FileLock(path).acquire(timeout=0):
                    continue
            except Timeout:
                held.append(path.name)
            except OSError:
                continue  # a directory of somebody else, or no locks at all
    return held
