"""Compiled kernels on disk, and one kernel source for every method and model.

Numba's cache looks at the file of the function that is called and not at the files of the functions
that this one calls.  Compiled functions are therefore stored in a directory named after a hash of
all they can reach, which is this room, the one to its right and their own file: after any
edit there nothing old is found.

What is loaded is executed.  So it is read only from a directory and a file that nobody but this
user and root can change, and only if its checksum holds; anything else is compiled again.  Where
no such directory can be had, or its disk is full, compiled functions stay in memory.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import re
import shutil
import stat
import sys
import tempfile
import types
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import llvmlite
import numba
from numba import njit
from numba.core.caching import FunctionCache
from numba.core.compiler import CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.serialize import dumps

from rattlesweep.child import PACKAGE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

DIGEST = 32
# Who owns, in a user namespace, what is not from there, such as the root directory.
UNMAPPED = 65534


@cache
def rooms_hash() -> str:
    """Hash of the sources of ``integrate`` and ``physics``."""
    digest = hashlib.sha256()
    for room in ("integrate", "physics"):
        for path in sorted((PACKAGE / room).rglob("*.py")):
            digest.update(path.relative_to(PACKAGE).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def source_hash(file: str, also: tuple[str, ...] = ()) -> str:
    """Hash of ``integrate`` and ``physics``, and behind it one of a source file and some others."""
    digest = hashlib.sha256()
    for name in (file, *also):
        digest.update(Path(name).read_bytes())
    return f"{rooms_hash()}-{digest.hexdigest()[:8]}"


def _others_may_write(found: os.stat_result) -> bool:
    """Whether somebody else can write; a group of the user's own is nobody else."""
    if not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return False
    if found.st_mode & stat.S_IWOTH:
        return True
    import grp
    import pwd

    try:
        user, group = pwd.getpwuid(os.geteuid()), grp.getgrgid(found.st_gid)
    except KeyError:
        return True
    private = (user.pw_gid, user.pw_name) == (group.gr_gid, group.gr_name)
    return not private or bool({*group.gr_mem} - {user.pw_name})


def _owners_above() -> set[int]:
    """Users who may own the directories above ours."""
    owners = {0, os.geteuid()}
    with suppress(OSError):
        # Outside of a user namespace every number is a user of its own.
        if Path("/proc/self/uid_map").read_text().split() != ["0", "0", str(2**32 - 1)]:
            owners.add(UNMAPPED)
    return owners


def _secure(path: Path, *, leaf: bool = True) -> bool:
    """Whether only this user and root can put anything there; made, for this user only, if missing.

    Nothing is made where a directory above belongs to another user.
    """
    if path.parent != path and not _secure(path.parent, leaf=False):
        return False
    if not path.exists():
        with suppress(FileExistsError):
            path.mkdir(mode=0o700)
    found = path.stat()
    if not hasattr(os, "geteuid"):  # Windows
        return stat.S_ISDIR(found.st_mode)
    owners = {0, os.geteuid()} if leaf else _owners_above()
    # In a sticky directory nobody can move what is another's.
    sticky = not leaf and bool(found.st_mode & stat.S_ISVTX)
    return (
        stat.S_ISDIR(found.st_mode)
        and found.st_uid in owners
        and (sticky or not _others_may_write(found))
    )


def _user_directory() -> str:
    """The user's cache directory; empty if there is none."""
    place = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(place):  # else to be ignored, by its specification
        return place
    home = os.path.expanduser("~")
    if not os.path.isabs(os.environ.get("HOME", home)):
        import pwd

        try:
            home = pwd.getpwuid(os.geteuid()).pw_dir
        except KeyError:
            return ""
    return os.path.join(home, ".cache")


@cache
def directory(file: str, also: tuple[str, ...] = ()) -> Path | None:
    """Directory of the compiled functions of a source file, which may reach those in ``also``.

    Under ``$NUMBA_CACHE_DIR`` if it is set, else in the user's cache directory; None where neither
    can be written by this user and by nobody else.
    """
    user = _user_directory()
    roots = [os.environ.get("NUMBA_CACHE_DIR", ""), user and os.path.join(user, "rattlesweep")]
    for root in filter(None, roots):
        try:
            path = Path(root).expanduser().resolve() / source_hash(file, also)
            if _secure(path) and os.access(path, os.W_OK | os.X_OK):
                return path
        except (OSError, RuntimeError):
            continue
    return None


def remove_old(place: Path) -> int:
    """Remove the directories beside one of ours that other versions of this program have left.

    Returns
    -------
    int
        How many there were.
    """
    # Without a second hash: as they were named once.
    old = [
        path
        for path in place.parent.iterdir()
        if re.fullmatch(r"[0-9a-f]{16}(-[0-9a-f]{8})?", path.name)
        and not path.name.startswith(rooms_hash())
        and not path.is_symlink()
        and all(kept.name.endswith((".kernel", ".lock")) for kept in path.iterdir())
    ]
    for path in old:
        shutil.rmtree(path, ignore_errors=True)
    return len(old)


def _sealed(name: str, payload: bytes) -> bytes:
    """Payload behind the checksum of itself and of the name it goes by."""
    return hashlib.sha256(name.encode() + b"\0" + payload).digest() + payload


def _opened(name: str, blob: bytes) -> bytes | None:
    """Payload of what :func:`_sealed` gave for this name; None if it is anything else."""
    payload = blob[DIGEST:]
    return payload if payload and _sealed(name, payload) == blob else None


def _read(path: Path) -> bytes:
    """Contents of a file that nobody but this user and root can have written; else nothing."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        with open(os.open(path, flags | getattr(os, "O_BINARY", 0)), "rb") as handle:
            found = os.fstat(handle.fileno())
            safe = stat.S_ISREG(found.st_mode) and (
                not hasattr(os, "geteuid")
                or (found.st_uid in (0, os.geteuid()) and not _others_may_write(found))
            )
            return handle.read() if safe else b""
    except OSError:
        return b""


def _write(path: Path, blob: bytes) -> None:
    """Put a file in place at once; where that fails, as on a full disk, there is none."""
    with suppress(OSError):
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".")
        try:
            with open(handle, "wb") as file:
                file.write(blob)
            os.replace(name, path)
        except OSError:
            os.unlink(name)
            raise


class KernelCache(FunctionCache):  # type: ignore[misc]
    """What Numba asks for compiled code: one sealed file for each signature of a function.

    Numba's own cache unpickles an index and a data file as it finds them.
    """

    # What this process has had compiled.
    compilations = 0

    def __init__(self, function: Callable[..., Any], place: Path | None) -> None:
        # Not Numba's own: it would look for a directory.
        self._py_func = function
        self._place = place
        self._kept: dict[str, bytes] = {}
        self.enable()

    @property
    def cache_path(self) -> str | None:
        """The directory, for Numba's statistics."""
        return None if self._place is None else str(self._place)

    def name(self, sig: Any, context: Any) -> str:
        """File of a signature: of this code, processor, Python and Numba."""
        versions = (sys.version, numba.__version__, llvmlite.__version__)
        key = repr((versions, self._index_key(sig, context.codegen())))
        digest = hashlib.sha256(key.encode()).hexdigest()[:24]
        return f"{self._py_func.__module__}.{self._py_func.__qualname__}-{digest}.kernel"

    def get(self, name: str) -> bytes | None:
        """Verified code, from memory or the disk."""
        blob = self._kept.get(name, b"")
        if not blob and self._place is not None:
            blob = _read(self._place / name)
        return _opened(name, blob)

    def put(self, name: str, blob: bytes) -> None:
        """Keep sealed code in memory and, if possible, on the disk."""
        KernelCache.compilations += 1
        self._kept[name] = blob
        if self._place is not None:
            _write(self._place / name, blob)

    @contextmanager
    def locked(self, name: str) -> Iterator[None]:
        """Hold a file lock, where there are such: one process compiles, the others wait."""
        with ExitStack() as stack:
            # Windows; a full disk or a file system without locks.
            with suppress(ImportError, OSError):
                import fcntl

                if self._place is not None:
                    handle = stack.enter_context(open(self._place / f"{name}.lock", "w"))
                    fcntl.flock(handle, fcntl.LOCK_EX)
            yield

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Compiled code of a signature, or None."""
        target_context.refresh()
        payload = self.get(self.name(sig, target_context))
        self._kept.clear()
        return payload and CompileResult._rebuild(target_context, *pickle.loads(payload))

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what has just been compiled."""
        name = self.name(sig, data.target_context)
        self.put(name, _sealed(name, dumps(data._reduce())))

    def handed_over(self) -> bytes:
        """The one sealed code that was compiled."""
        (blob,) = self._kept.values()
        return blob


def specialise(template: Callable[..., Any], name: str, **bindings: Any) -> Any:
    """Copy of a function that sees other globals, under a name of its own.

    Numba recompiles at every start what closes over a compiled function, because its cache key
    then holds an identity that changes.  Globals are frozen into the code and are not part of the
    key; the name is, and so each specialisation has its own file and symbols.
    """
    code = types.FunctionType(template.__code__, {**template.__globals__, **bindings}, name)
    code.__qualname__ = name
    code.__module__ = template.__module__
    return code


def cached(function: Callable[..., Any], *, also: tuple[str, ...] = (), **options: Any) -> Any:
    """``njit`` with a :class:`KernelCache` in :func:`directory` of the function's file.

    Parameters
    ----------
    also : tuple of str
        Other files, outside this room and the one to its right, whose functions it calls.
    """
    return keep(njit(**options)(function), also)


def keep(compiled: Any, also: tuple[str, ...] = ()) -> Any:
    """Have something compiled kept on disk, as by :func:`cached`."""
    function = compiled.py_func
    compiled._cache = KernelCache(function, directory(function.__code__.co_filename, also))
    return compiled


# A process that is forked while another thread compiles would wait for it for ever.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )
