"""Files that are there whole or not at all, and errors of the system in words."""

import contextlib
import os
import secrets
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from rattlesweep.errors import OutputError


def reason(error: BaseException) -> str:
    """Return in one line what went wrong."""
    words = getattr(error, "strerror", None) or str(error).strip().split("\n")[0]
    return words or type(error).__name__


@contextlib.contextmanager
def explained(failure: str) -> Iterator[None]:
    """Turn an OSError into an OutputError: `failure`, such as "cannot read X", and why."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{failure}: {reason(error)}") from error


def replace_file(path: Path, data: bytes) -> None:
    """Put `data` at `path` in one step; see :func:`streamed_file`."""
    with streamed_file(path) as file:
        file.write(data)


@contextlib.contextmanager
def streamed_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that takes its place at `path`, whole and on the disk, unless the body fails."""
    # Readers of a whole directory skip hidden files.
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    with explained(f"cannot write {path}"):
        try:
            with open(temporary, "xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
            folder = os.open(path.parent, os.O_RDONLY)
            with contextlib.suppress(OSError):  # some network file systems cannot sync a folder
                os.fsync(folder)
            os.close(folder)
        finally:
            with contextlib.suppress(OSError):  # after the rename there is nothing left
                temporary.unlink()


def probe_directory(path: Path) -> None:
    """Create `path` where need be, and raise an OutputError if files cannot be written in it."""
    with explained(f"cannot write in {path}"):
        path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()
