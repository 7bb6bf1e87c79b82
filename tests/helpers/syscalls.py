"""The calls with which a sweep touches its directory: each counted, and one of them the last.

For a process of its own, which is never mended again. Files are written through a raw layer that
takes half of what it is given first, as the system may: so half-written files are among the states
that a kill or a fault finds.
"""

from __future__ import annotations

import builtins
import errno
import fcntl
import io
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

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
READS = ("read", "list", "stat")
# Which calls may fail with what. A full disk lets go of files; who may not write may look.
MAY_FAIL = {
    errno.ENOSPC: ("create", "write", "fsync", "rename", "mkdir", "link"),
    errno.EDQUOT: ("create", "write", "fsync", "rename", "mkdir", "link"),
    errno.EIO: (*CHANGES, *READS),
    errno.EACCES: ("create", "rename", "unlink", "mkdir", "rmdir", *READS),
}


class Calls:
    """Counts calls below a directory.

    Parameters
    ----------
    root : Path
        Calls on other files are not counted.
    kinds : tuple of str
        Calls that are counted.
    at : int or None
        The call at which harm is done, counted from 0.
    number : int or None
        What the call fails with; None for a signal before it.
    sent : int
        That signal.
    for_good : bool
        Whether all calls that are counted fail from there on.
    log : Path or None
        Gets a line ``kind path`` for each call.
    """

    def __init__(
        self,
        root: Path,
        kinds: tuple[str, ...],
        at: int | None = None,
        number: int | None = None,
        sent: int = signal.SIGKILL,
        for_good: bool = False,
        log: Path | None = None,
    ) -> None:
        self._root = os.path.abspath(root)
        self._kinds = kinds
        self._at = at
        self._number = number
        self._sent = sent
        self._for_good = for_good
        self._log = None if log is None else os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self._paths: dict[int, str] = {}
        self._count = 0

    def come(self, kind: str, path: str | None) -> None:
        """A call is about to be made."""
        if path is None:
            return
        if self._log is not None:
            os.write(self._log, f"{kind} {os.path.relpath(path, self._root)}\n".encode())
        if kind not in self._kinds:
            return
        now = self._count
        self._count += 1
        if self._at is None or now < self._at or (now > self._at and not self._for_good):
            return
        if self._number is None:
            os.kill(os.getpid(), self._sent)
        else:
            raise OSError(self._number, os.strerror(self._number), path)

    def mine(self, path: Any) -> str | None:
        """A path as text, if it is below the directory."""
        if isinstance(path, int):
            return self._paths.get(path)
        text = os.path.abspath(os.fspath(path))
        return text if text == self._root or text.startswith(self._root + os.sep) else None

    def install(self) -> None:
        """Take the place of the system's calls."""
        for name, kind in (
            ("replace", "rename"), ("rename", "rename"), ("unlink", "unlink"),
            ("remove", "unlink"), ("mkdir", "mkdir"), ("rmdir", "rmdir"),
            ("listdir", "list"), ("scandir", "list"), ("fsync", "fsync"), ("stat", "stat"),
        ):  # fmt: skip
            setattr(os, name, self._before(kind, getattr(os, name)))
        link = os.link
        os.link = lambda path, to: (self.come("link", self.mine(to)), link(path, to))[1]
        self._open_of_os, self._close_of_os = os.open, os.close
        os.open, os.close = self._open, self._close
        os.fdopen = self._fdopen
        builtins.open = io.open = self._open_file  # type: ignore[assignment]
        fcntl.flock = self._flock  # type: ignore[assignment]
        real, calls = pq.ParquetFile, self

        class ParquetFile(real):  # type: ignore[misc,valid-type]
            def __init__(self, source: Any, **options: Any) -> None:
                if isinstance(source, str | os.PathLike):
                    calls.come("read", calls.mine(source))
                super().__init__(source, **options)

        pq.ParquetFile = ParquetFile

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

    def _fdopen(self, handle: int, *args: Any, **kwargs: Any) -> Any:
        if handle in self._paths:
            return io.BufferedWriter(_Raw(self, handle))
        return _OPEN(handle, *args, **kwargs)

    def _open_file(self, path: Any, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
        mine = None if isinstance(path, int) else self.mine(path)
        if mine is not None and "a" in mode:
            return io.BufferedWriter(
                _Raw(self, self._open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666))
            )
        assert mine is None or mode == "rb", f"no test knows of files opened as {mode}"
        self.come("read", mine)
        return _OPEN(path, mode, *args, **kwargs)

    def _flock(self, handle: Any, operation: int) -> None:
        number = handle if isinstance(handle, int) else handle.fileno()
        self.come("lock", self._paths.get(number))
        _FLOCK(handle, operation)


_OPEN, _FLOCK = builtins.open, fcntl.flock


class _Raw(io.RawIOBase):
    """A file that takes half of what it is given first."""

    def __init__(self, calls: Calls, handle: int) -> None:
        self._calls, self._handle, self._begun = calls, handle, False

    def fileno(self) -> int:
        return self._handle

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self._calls.come("write", self._calls.mine(self._handle))
        part = data if self._begun or len(data) < 2 else memoryview(data)[: len(data) // 2]
        self._begun = True
        return os.write(self._handle, part)

    def truncate(self, size: int | None = None) -> int:
        self._calls.come("truncate", self._calls.mine(self._handle))
        os.ftruncate(self._handle, size or 0)
        return size or 0

    def close(self) -> None:
        if not self.closed:
            super().close()
            os.close(self._handle)
