"""Files that are there whole or not at all, and errors of the system in words."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from rattlesweep.errors import OutputError

# No pattern such as `*.parquet` matches, and readers of a whole directory skip hidden files.
TEMPORARY = ".*.tmp"


def reason(error: BaseException) -> str:
    """Return in one line what went wrong."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error).strip().split("\n")[0] or type(error).__name__


@contextlib.contextmanager
def explained(failure: str, *, folder: bool = False) -> Iterator[None]:
    """Turn an OSError into an OutputError: `failure`, such as "cannot read X", and why.

    With `folder`, a folder is made or used, and a file may be in its place.
    """
    try:
        yield
    except OSError as error:
        in_the_way = folder and isinstance(error, FileExistsError | NotADirectoryError)
        why = "a file is in the way" if in_the_way else reason(error)
        raise OutputError(f"{failure}: {why}") from error


def replace_file(path: Path, data: bytes) -> None:
    """Put `data` at `path` in one step; see :func:`streamed_file`."""
    with streamed_file(path) as file:
        file.write(data)


@contextlib.contextmanager
def streamed_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that takes its place at `path`, whole and on the disk, when the body has ended.

    What is there stays there until then.  If the body raises, nothing is left of the new file.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    # The random part keeps apart two processes that write the same file.
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    with explained(f"cannot write {path}"):
        try:
            handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
            with os.fdopen(handle, "wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
            _sync_directory(path.parent)
        finally:
            # After the rename there is nothing left; after anything else, Ctrl-C too, there may be.
            with contextlib.suppress(OSError):
                temporary.unlink()


def _sync_directory(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        # Some network file systems cannot; the file is in place all the same.
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(handle)


def probe_directory(path: Path) -> None:
    """Create `path` where need be, and raise an OutputError if files cannot be written in it."""
    with explained(f"cannot write in {path}", folder=True):
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass


def remove_temporaries(folder: Path, older_than: float = 0.0) -> None:
    """Remove what dead processes were writing, if it is at least so many seconds old."""
    for path in folder.glob(TEMPORARY):
        with contextlib.suppress(OSError):  # another process was quicker
            if time.time() - path.stat().st_mtime >= older_than:
                path.unlink()
