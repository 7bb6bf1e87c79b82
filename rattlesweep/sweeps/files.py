"""Files that appear in one step, complete, or not at all; and what the system refuses, in words."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import stat
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from rattlesweep.errors import OutputError

# A leading dot and another ending: no `*.parquet` or `*.json` pattern matches, and readers that
# take a whole directory skip hidden files.
_TEMPORARY = re.compile(
    r"\.(probe|manifest\.json|(summary|block-\d+|bodies-[0-9a-f]+)\.parquet)\.[0-9a-f]{8}\.tmp"
)


def reason(error: BaseException) -> str:
    """Say in one line what went wrong."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error).strip().split("\n")[0] or type(error).__name__


@contextlib.contextmanager
def explained(failure: str, *, folder: bool = False) -> Iterator[None]:
    """Turn an error of the system into a sentence: `failure`, such as "cannot read X", and why.

    With `folder`, it is a folder that is to be made or used, and a file may be in its place.
    """
    try:
        yield
    except OSError as error:
        in_the_way = folder and isinstance(error, FileExistsError | NotADirectoryError)
        why = "a file is in the way" if in_the_way else reason(error)
        raise OutputError(f"{failure}: {why}") from error


def replace_file(path: Path, data: bytes, check: Callable[[Path], None] | None = None) -> None:
    """Put `data` at `path` in one step; see `streamed_file`."""
    with streamed_file(path, check) as file:
        file.write(data)


@contextlib.contextmanager
def streamed_file(path: Path, check: Callable[[Path], None] | None = None) -> Iterator[BinaryIO]:
    """A file to write to that takes its place at `path` in one step, when the body has ended.

    Whatever is there stays there, whole, until the new file is on the disk. If the body raises,
    nothing is left of it. `check` is called with the finished temporary file; whatever it raises
    keeps that from its place.
    """
    temporary = _temporary(path)
    with explained(f"cannot write {path}"):
        try:
            with _created(temporary) as file:
                yield file
            if check is not None:
                check(temporary)
            rename_file(temporary, path)
        finally:
            # After the rename there is nothing left; after anything else, Ctrl-C too, there may be.
            _discard(temporary)


def rename_file(path: Path, target: Path) -> None:
    """Give a file another name in its directory, for good once this returns."""
    os.replace(path, target)
    _sync_directory(target.parent)


class NotAFile(OSError):
    """Something else in the place of a file of ours: a FIFO, a device, far too many bytes."""


def read_file(path: Path, most: int) -> bytes:
    """All of a regular file of `most` bytes at most; what is none is not waited for."""
    # Without O_NONBLOCK, to open a FIFO is to wait for somebody who writes into it.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise NotAFile("it is no regular file")
        if status.st_size > most:
            raise NotAFile(f"it is larger than the {most} bytes it can have")
        with open(handle, "rb", closefd=False) as file:
            return file.read(most)
    finally:
        os.close(handle)


def probe_directory(path: Path) -> None:
    """Create `path` where need be, and try out that files can be written in it."""
    probe = _temporary(path / "probe")
    with explained(f"cannot write in {path}", folder=True):
        path.mkdir(parents=True, exist_ok=True)
        try:
            with _created(probe) as file:
                file.write(b"probe")
        finally:
            _discard(probe)


def temporaries(folder: Path) -> list[Path]:
    """Files that a process of ours was still writing, or has left half-written."""
    with explained(f"cannot read {folder}"):
        return [folder / name for name in os.listdir(folder) if _TEMPORARY.fullmatch(name)]


def remove_temporaries(folder: Path, older_than: float) -> int:
    """Remove temporary files at least `older_than` seconds old; returns how many."""
    now, removed = time.time(), 0
    for path in temporaries(folder):
        with contextlib.suppress(OSError):  # its owner, or another process, was quicker
            if now - path.stat().st_mtime >= older_than:
                path.unlink()
                removed += 1
    return removed


def _temporary(path: Path) -> Path:
    # The random part keeps two processes that write the same block out of each other's file.
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")


@contextlib.contextmanager
def _created(path: Path) -> Iterator[BinaryIO]:
    """A new file to write to, on the disk once the body has ended."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    with os.fdopen(handle, "wb") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())


def _discard(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


def _sync_directory(path: Path) -> None:
    """Force the rename itself to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        # Some network file systems cannot; the file is in place all the same.
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(handle)
