"""``sessions/*.json``: who worked in an output directory, when, how long, and how it ended.

For people: nothing depends on these files, and a sweep is the same without them.
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import socket
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rattlesweep.errors import OutputError
from rattlesweep.sweeps.files import replace_file
from rattlesweep.sweeps.provenance import command_line, machine, now, peak_memory, versions

FOLDER = "sessions"
NOTE_EVERY = 5.0
"""Seconds between two notes of how far a session is."""


@dataclass
class Session:
    """The record of this process.

    Parameters
    ----------
    directory : Path
    share : str or None
        Such as ``shard-0-of-4``.
    threads : int
    """

    directory: Path
    share: str | None
    threads: int
    _data: dict[str, Any] = field(default_factory=dict)
    _due: float = 0.0

    def __post_init__(self) -> None:
        started = now("microseconds")
        self._data = {
            "started": started,
            "ended": None,
            "how": "running",
            "share": self.share,
            "command": shlex.join(command_line()),
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "threads": self.threads,
            "versions": versions(),
            "machine": machine(),
        }
        stamp = started.replace(":", "").replace("-", "").replace("+0000", "Z")
        self._path = self.directory / FOLDER / f"{stamp}-{os.getpid()}.json"
        self.note(at_once=True)

    def note(self, at_once: bool = False, **facts: Any) -> None:
        """Write down how far the session is, now and then; a full disk does not matter here."""
        if not at_once and time.monotonic() < self._due:
            return
        self._due = time.monotonic() + NOTE_EVERY
        self._data |= facts
        with contextlib.suppress(OutputError, OSError):
            self._path.parent.mkdir(exist_ok=True)
            replace_file(self._path, json.dumps(self._data, indent=2).encode())

    def end(self, how: str, **facts: Any) -> None:
        """Write down how the session ended: complete, stopped, interrupted or failed."""
        self._data.pop("progress", None)
        self.note(True, ended=now(), how=how, peak_memory=peak_memory(), **facts)


def read_sessions(directory: Path) -> list[dict[str, Any]]:
    """Return the records of a directory, the oldest first; what cannot be read is left out."""
    found = []
    for path in sorted((directory / FOLDER).glob("*.json")):
        with contextlib.suppress(OSError, ValueError):
            data = json.loads(path.read_bytes())
            if isinstance(data, dict):
                found.append(data)
    return found


def who_holds(directory: Path, share: str | None) -> str:
    """Return who is at work in a directory, in words."""
    for data in reversed(read_sessions(directory)):
        if data.get("how") == "running" and data.get("share") == share:
            with contextlib.suppress(KeyError):
                return (
                    f"`{data['command']}` (process {data['pid']} on {data['host']}, since "
                    f"{data['started'][:19]} UTC)"
                )
    return "another process"
