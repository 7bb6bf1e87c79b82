"""Records of the processes that worked on a sweep: who, when, how long, how it ended.

They are for information only: the sweep does not depend on whether they can be written,
and one that cannot be read is left out.
"""

import contextlib
import json
import os
import shlex
import socket
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from rattlesweep.store.checked import Checked, load_checked
from rattlesweep.store.provenance import command_line, machine, now
from rattlesweep.system.files import read_regular, replace_file
from rattlesweep.words.errors import OutputError

SESSIONS = "sessions"
WHOLE_SWEEP = "whole"  # name of the lock of a process that works on all shards
_MOST_BYTES = 1 << 20  # of a record
Session = dict[str, Any]
_Count = Annotated[int, Field(ge=0, lt=1 << 53)]


class Record(Checked):
    """Keys of a record; null where another version did not write them."""

    started: str | None = None
    ended: str | None = None
    how: str | None = None  # running, complete, stopped, interrupted or failed
    shard: str | None = None  # such as shard-0-of-4
    command: str | None = None
    host: str | None = None
    pid: _Count | None = None
    threads: _Count | None = None
    machine: dict[str, str | _Count] | None = None
    doing: str | None = None  # "compiling" until its kernels are loaded
    runs: _Count | None = None  # that it has done
    seconds: float | None = None
    kernel_seconds: float | None = None


@contextlib.contextmanager
def session(
    directory: Path, shard: str | None, threads: int
) -> Iterator[tuple[Session, Callable[[], None]]]:
    """Keep the record of this process, and a function that says its kernels are loaded.

    The body sets ``how`` to say how it ended.
    """
    begin = datetime.now(UTC)
    pid = os.getpid()
    path = directory / SESSIONS / f"{begin:%Y%m%dT%H%M%S.%fZ}-{pid}.json"
    record: Session = {
        "started": begin.isoformat(),
        "ended": None,
        "how": "running",
        "doing": "compiling",
        "shard": shard,
        "command": shlex.join(command_line()),
        "host": socket.gethostname(),
        "pid": pid,
        "threads": threads,
        "machine": machine(),
    }
    _write(path, record)

    def loaded() -> None:
        record["doing"] = None
        _write(path, record)

    try:
        yield record, loaded
    except BaseException as error:
        record["how"] = "failed" if isinstance(error, Exception) else "interrupted"
        raise
    finally:
        record["doing"] = None
        record["ended"] = now()
        _write(path, record)


def _write(path: Path, record: Session) -> None:
    with contextlib.suppress(OutputError, OSError):
        path.parent.mkdir(exist_ok=True)
        replace_file(path, json.dumps(record, indent=2).encode())


def read_sessions(directory: Path) -> list[Session]:
    """Return the records that can be read, the oldest first."""
    sessions = []
    for path in sorted((directory / SESSIONS).glob("*.json")):
        with contextlib.suppress(OSError, ValueError):
            sessions.append(load_checked(Record, read_regular(path, _MOST_BYTES)))
    return sessions


def unfinished(sessions: list[Session]) -> dict[str, Session]:
    """Return, by their locks, the last sessions that run or were killed."""
    running = [session for session in sessions if session["how"] == "running"]
    # Of several with one lock, the last one stays.
    return {session["shard"] or WHOLE_SWEEP: session for session in running}


def who(session: Session) -> str:
    """Return the command and process of a session, in words."""
    since = str(session["started"])[:19]
    process = f"process {session['pid']} on {session['host']}, since {since} UTC"
    doing = ""
    if session["how"] == "running" and session["doing"] == "compiling":
        doing = ", compiling or loading kernels"
    return f"`{session['command']}` ({process}){doing}"
