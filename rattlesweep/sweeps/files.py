"""Files that appear whole or not at all, and errors of the system in words."""

import contextlib
import errno
import os
import re
import secrets
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from rattlesweep.errors import ConfigError, OutputError, one_line

MOST_BYTES = 1 << 28  # of a file that is read as a whole
UNFINISHED = re.compile(r"\..+\.[0-9a-f]{8}\.tmp")  # names of files being written
# Directories that are held in their places, and what they were.
_held: list[tuple[Path, os.stat_result]] = []


def as_path(value: object, name: str) -> Path:
    """Return an argument as a path; raise a ConfigError if it is none."""
    if isinstance(value, str | os.PathLike) and os.fspath(value):
        return Path(value)
    raise ConfigError(f"{name}: {one_line(repr(value), 40)} is not a path")


def probe_directory(path: Path) -> None:
    """Create a directory if need be; raise an OutputError if no file can be written
    there.
    """
    with explained(f"cannot write in {path}"):
        path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()


def open_regular(path: Path) -> BinaryIO:
    """Open a file to read; raise an OSError for what is no file.

    A pipe may never end, and a device may never stop.
    """
    mode = os.stat(path).st_mode
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, "it is not a regular file")
    return open(path, "rb")


def read_regular(path: Path, limit: int = MOST_BYTES) -> bytes:
    """Return the bytes of a file, at most `limit`, or raise an OSError that says why.

    Only regular files are read; see :func:`open_regular`.
    """
    with open_regular(path) as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        raise OSError(errno.EFBIG, f"it is larger than {limit / 1e6:g} MB")
    return data


def replace_file(path: Path, data: bytes) -> None:
    """Write `data` to `path` in one step; see :func:`streamed_file`."""
    with streamed_file(path) as file:
        file.write(data)


@contextlib.contextmanager
def streamed_file(path: Path, staging: Path | None = None) -> Iterator[BinaryIO]:
    """Open a file that appears at `path`, whole and on disk, after the body.

    Until then it is a hidden file in the folder `staging`, by default its own.
    """
    folder = path.parent if staging is None else staging
    temporary = folder / f".{path.name}.{secrets.token_hex(4)}.tmp"
    with explained(f"cannot write {path}"):
        check_place(path)
        try:
            with open(temporary, "xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            check_place(path)
            os.replace(temporary, path)
            _sync_folder(path.parent)
        finally:
            with contextlib.suppress(OSError):  # it is gone if the rename succeeded
                temporary.unlink()


def remove_unfinished(folder: Path) -> None:
    """Remove the files that a killed process left half-written in a folder itself."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if UNFINISHED.fullmatch(entry.name) and entry.is_file(
                follow_symlinks=False
            ):
                with contextlib.suppress(OSError):
                    os.unlink(entry.path)


@contextlib.contextmanager
def kept_in_place(directory: Path) -> Iterator[None]:
    """Let :func:`check_place` refuse files of a directory that is moved meanwhile."""
    with contextlib.ExitStack() as stack:
        # While it is open, no other directory can get its number.
        with contextlib.suppress(OSError):
            stack.callback(os.close, os.open(directory, os.O_RDONLY))
        with explained(f"cannot read {directory}"):
            held = directory, os.stat(directory)
        _held.append(held)
        try:
            yield
        finally:
            _held.remove(held)


def check_place(path: Path) -> None:
    """Raise an OutputError if a path leads to another directory than the one held."""
    for directory, before in _held:
        if not path.is_relative_to(directory):
            continue
        try:
            moved = not os.path.samestat(os.stat(directory), before)
        except FileNotFoundError:
            moved = True
        if moved:
            raise OutputError(
                f"{directory} was moved or replaced while this command wrote there; "
                "run it again with the directory's new path as --output"
            )


def _sync_folder(path: Path) -> None:
    """Write the names in a folder to disk, if the system can.

    Windows cannot open a folder, and some network file systems cannot sync one.
    """
    with contextlib.suppress(OSError):
        folder = os.open(path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@contextlib.contextmanager
def explained(failure: str) -> Iterator[None]:
    """Turn an OSError into an OutputError: `failure`, such as "cannot read X", and the
    reason.
    """
    try:
        yield
    except OSError as error:
        raise OutputError(f"{failure}: {reason(error)}") from error


def reason(error: BaseException) -> str:
    """Return in one line what went wrong."""
    text = getattr(error, "strerror", None) or str(error).strip().split("\n")[0]
    return text or type(error).__name__
