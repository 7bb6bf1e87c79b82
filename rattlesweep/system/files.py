"""Files that appear whole or not at all, and errors of the system in words."""

import contextlib
import errno
import os
import re
import secrets
import shutil
import stat
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from rattlesweep.words.errors import ConfigError, OutputError, one_line

UNSET = re.compile(r"\$(\w+|\{\w+\})")  # variables that are left in a path
_MOST_BYTES = 1 << 28  # of a file that is read as a whole
# Names of files being written, with the locks of who writes them.
UNFINISHED = re.compile(r"\.[^@]+?((?:@[\w-]+)*)\.[0-9a-f]{8}\.tmp")
# Errors of file systems that cannot write a file to disk at a wish.
NO_SYNC = {errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}
# Errors of file systems that have no second names of files, or not here.
NO_LINKS = NO_SYNC | {errno.EPERM, errno.EACCES, errno.EMLINK, errno.EXDEV}


class _Hold(NamedTuple):
    """A directory in which this process may write while it holds a lock."""

    directory: Path
    was: os.stat_result
    lock: str  # its name
    check: Callable[[], None]  # raises an OutputError if the lock is lost
    thread: int


_holds: list[_Hold] = []


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
def streamed_file(
    path: Path, staging: Path | None = None, new: bool = False
) -> Iterator[BinaryIO]:
    """Open a file that appears at `path`, whole and on disk, after the body.

    Until then it is a hidden file in the folder `staging`, by default its own. A file
    that is `new` takes no other's place.

    Where the directory is held by a lock, the hidden file has the lock in its name. Who
    takes the lock from a process that seems dead removes such files. If that process
    was only paused, however late, its file is gone and cannot appear.
    """
    with explained(f"cannot write {path}"):
        temporary = staged_name(path, staging)
        check_place(path)
        try:
            with open(temporary, "xb") as file:
                yield file
                file.flush()
                _sync(file.fileno())
            move(temporary, path, new)
        finally:
            with contextlib.suppress(OSError):  # it is gone if the rename succeeded
                temporary.unlink()


def staged_name(path: Path, staging: Path | None) -> Path:
    """Return a path for a file that is to appear at `path`, for :func:`move`."""
    folder = path.parent if staging is None else staging
    locks = "".join(f"@{hold.lock}" for hold in _holds_of(path) if hold.lock)
    return folder / f".{path.name}{locks}.{secrets.token_hex(4)}.tmp"


def remove_unfinished(folder: Path, locks: Collection[str] | None = None) -> None:
    """Remove the files that a killed process left half-written in a folder itself.

    With `locks`, only files of processes that held one of these are removed.
    """
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            match = UNFINISHED.fullmatch(entry.name)
            if match is None or not entry.is_file(follow_symlinks=False):
                continue
            held_by = match[1].split("@")[1:]
            if locks is None or not set(held_by).isdisjoint(locks):
                with contextlib.suppress(OSError):
                    os.unlink(entry.path)


@contextlib.contextmanager
def kept_in_place(
    directory: Path, lock: str, check: Callable[[], None]
) -> Iterator[None]:
    """Let :func:`check_place` refuse files of a directory that is moved meanwhile.

    It also refuses them when the lock, of this name, is found lost by `check`.
    """
    with contextlib.ExitStack() as stack:
        # While it is open, no other directory can get its number.
        with contextlib.suppress(OSError):
            stack.callback(os.close, os.open(directory, os.O_RDONLY))
        with explained(f"cannot read {directory}"):
            was = os.stat(directory)
        hold = _Hold(directory, was, lock, check, threading.get_ident())
        _holds.append(hold)
        try:
            yield
        finally:
            _holds.remove(hold)


def _holds_of(path: Path) -> list[_Hold]:
    """Return the holds of the directory of a path, those of this thread if any."""
    holds = [hold for hold in _holds if path.is_relative_to(hold.directory)]
    thread = threading.get_ident()
    return [hold for hold in holds if hold.thread == thread] or holds


def check_place(path: Path) -> None:
    """Raise an OutputError if this process must not change a path.

    It may lead to another directory than the one held, or the lock may be lost.
    """
    for hold in _holds_of(path):
        try:
            moved = not os.path.samestat(os.stat(hold.directory), hold.was)
        except FileNotFoundError:
            moved = True
        if moved:
            raise OutputError(
                f"{hold.directory} was moved or replaced while this command wrote "
                "there; run it again with the directory's new path as --output"
            )
        hold.check()


def move(source: Path, target: Path, new: bool = False) -> None:
    """Move a file in one step, also to another file system; see `streamed_file`."""
    try:
        check_place(target)
        if not (new and _link(source, target)):
            os.replace(source, target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        # The target's folder is a mount, or a link, so the file is completed there.
        with open(source, "rb") as file, streamed_file(target, new=new) as copy:
            shutil.copyfileobj(file, copy)
        source.unlink()
    sync_folder(target.parent)


def _link(source: Path, target: Path) -> bool:
    """Move a file to a free name; return False if the system cannot.

    Unlike a rename, this replaces no file.
    """
    try:
        os.link(source, target)
    except FileExistsError:
        # A server that answers twice says so of its own first answer.
        if not os.path.samefile(source, target):
            raise
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        if os.path.lexists(target):
            raise FileExistsError(errno.EEXIST, "it exists", str(target)) from None
        return False
    source.unlink(missing_ok=True)
    return True


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
