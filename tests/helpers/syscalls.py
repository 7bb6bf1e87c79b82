"""System calls on the directory of a sweep: all are counted, and one of them does harm.

The first write to each file takes only half of the data, as the system is allowed to
do, so that kills and faults also find half-written files.
"""

from __future__ import annotations

import builtins
import errno
import fcntl
import io
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

CHANGES = (
    "create",
    "write",
    "truncate",
    "fsync",
    "rename",
    "unlink",
    "mkdir",
    "rmdir",
    "lock",
    "link",
)
READS = ("read", "close", "list", "stat")
# Calls that may fail with each error. A full disk still deletes files.
MAY_FAIL = {
    errno.ENOSPC: ("create", "write", "fsync", "rename", "mkdir", "link"),
    errno.EIO: (*CHANGES, *READS),
}


@dataclass
class Calls:
    root: str
    kinds: tuple[str, ...]  # kinds of calls that are counted
    at: int | None = None  # index of the call that does harm
    number: int | None = None  # errno of the failure; None sends a signal instead
    sent: int = signal.SIGKILL  # the signal
    for_good: bool = False  # whether all later calls fail, too
    log: str | None = None  # file for one line ``kind path`` per call
    _paths: dict[int, str] = field(default_factory=dict)
    _count: int = 0

    def come(self, kind: str, path: str | None) -> None:
        if path is None:
            return
        if self.log is not None:
            with _OPEN(self.log, "a") as log:
                log.write(f"{kind} {os.path.relpath(path, self.root)}\n")
        if kind not in self.kinds:
            return
        now = self._count
        self._count += 1
        if self.at is None or now < self.at or (now > self.at and not self.for_good):
            return
        if self.number is None:
            os.kill(os.getpid(), self.sent)
        else:
            raise OSError(self.number, os.strerror(self.number), path)

    def mine(self, path: Any) -> str | None:
        """Return a path as text if it is inside the directory."""
        if isinstance(path, int):
            return self._paths.get(path)
        text = os.path.abspath(os.fspath(path))
        if text == self.root or text.startswith(self.root + os.sep):
            return text
        return None

    def install(self) -> None:
        for name, kind in (
            ("replace", "rename"),
            ("rename", "rename"),
            ("unlink", "unlink"),
            ("remove", "unlink"),
            ("mkdir", "mkdir"),
            ("rmdir", "rmdir"),
            ("listdir", "list"),
            ("scandir", "list"),
            ("fsync", "fsync"),
            ("stat", "stat"),
        ):
            setattr(os, name, self._before(kind, getattr(os, name)))
        link = os.link

        def counted_link(path: Any, to: Any) -> None:
            self.come("link", self.mine(to))
            link(path, to)

        os.link = counted_link
        self._open_of_os = os.open
        self._close_of_os = os.close
        os.open = self._open
        os.close = self._close
        builtins.open = io.open = self._open_file  # type: ignore[assignment]
        fcntl.flock = self._flock  # type: ignore[assignment]

    def _before(self, kind: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def counted(path: Any = ".", *args: Any, **kwargs: Any) -> Any:
            self.come(kind, self.mine(path))
            return call(path, *args, **kwargs)

        return counted

    def _open(self, path: Any, flags: int, *args: Any, **kwargs: Any) -> int:
        mine = self.mine(path)
        self.come("create" if flags & os.O_CREAT else "read", mine)
        handle = self._open_of_os(path, flags, *args, **kwargs)
        if mine is not None:
            self._paths[handle] = mine
        return handle

    def _close(self, handle: int) -> None:
        self._paths.pop(handle, None)
        self._close_of_os(handle)

    def _open_file(self, path: Any, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
        mine = None if isinstance(path, int) else self.mine(path)
        if mine is not None and mode == "xb":
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
            return io.BufferedWriter(_Raw(self, self._open(path, flags, 0o666)))
        assert mine is None or mode == "rb", f"files opened as {mode} are not counted"
        self.come("read", mine)
        if mine is not None:
            return io.BufferedReader(_RawReader(self, mine))
        return _OPEN(path, mode, *args, **kwargs)

    def _flock(self, handle: Any, operation: int) -> None:
        number = handle if isinstance(handle, int) else handle.fileno()
        self.come("lock", self._paths.get(number))
        _FLOCK(handle, operation)


_OPEN = builtins.open
_FLOCK = fcntl.flock


class _RawReader(io.FileIO):
    def __init__(self, calls: Calls, path: str) -> None:
        super().__init__(path)
        self._calls = calls
        self._path = path

    def readinto(self, buffer: Any) -> Any:
        self._calls.come("read", self._path)
        return super().readinto(buffer)

    def close(self) -> None:
        if not self.closed:
            super().close()  # as in the system, which closes the file all the same
            self._calls.come("close", self._path)


class _Raw(io.RawIOBase):
    def __init__(self, calls: Calls, handle: int) -> None:
        self._calls = calls
        self._handle = handle
        self._begun = False

    def fileno(self) -> int:
        return self._handle

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self._calls.come("write", self._calls.mine(self._handle))
        if not self._begun and len(data) > 1:
            data = memoryview(data)[: len(data) // 2]
        self._begun = True
        return os.write(self._handle, data)

    def close(self) -> None:
        if not self.closed:
            super().close()
            os.close(self._handle)
