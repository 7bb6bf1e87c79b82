"""Files that appear whole or not at all, and errors of the system in words."""

import contextlib
import errno
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from rattlesweep.errors import ConfigError, OutputError, one_line

UNSET = re.compile(r"\$(\w+|\{\w+\})")  # variables that are left in a path
_MOST_BYTES = 1 << 28  # of a file that is read as a whole
UNFINISHED = re.compile(r"\..+\.[0-9a-f]{8}\.tmp")  # names of files being written
# Directories that are held in their places, and what they were.
_held: list[tuple[Path, os.stat_result]] = []
# Errors of file systems that cannot write a file to disk at a wish.
NO_SYNC = {errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}


def as_path(value: object, name: str) -> Path:
    """Return an argument as a path; raise a ConfigError if it is none."""
    if not isinstance(value, str | os.PathLike) or not os.fspath(value):
        raise ConfigError(f"{name}: {one_line(repr(value), 40)} is not a path")
    text = os.fspath(value)
    try:
        return Path(expand(text))
    except ValueError as error:
        raise ConfigError(f"{name}: {one_line(str(text))}: {error}") from None


def expand(path: str) -> str:
    """Return a path with the values of ``~`` and ``$VARIABLES``, as a shell does.

    A ValueError names a variable that is not set, unless there is a file of the name.
    """
    text = os.path.expanduser(os.path.expandvars(path))
    unset = UNSET.search(text)
    if unset is None:
        return text
    if os.path.lexists(path):
        return path
    raise ValueError(f"the variable {unset[0]} is not set")


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


def read_regular(path: Path, limit: int = _MOST_BYTES) -> bytes:
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
                _sync(file.fileno())
            check_place(path)
            move(temporary, path)
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


def move(source: Path, target: Path) -> None:
    """Move a file in one step, also to another file system."""
    try:
        os.replace(source, target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        # The target's folder is a mount, or a link, so the file is completed there.
        with open(source, "rb") as file, streamed_file(target) as copy:
            shutil.copyfileobj(file, copy)
        source.unlink()
    sync_folder(target.parent)


def _sync(handle: int) -> None:
    """Write an open file to disk, if its file system can."""
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in NO_SYNC:
            raise


def sync_folder(path: Path) -> None:
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
