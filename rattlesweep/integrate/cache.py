"""Compiled kernels on disk, and one kernel source for every method and model.

Numba's cache looks at the file of the function that is called and not at the files of the functions
that this one calls.  Compiled functions are therefore stored in a directory named after a hash of
all they can reach, which is this room, the one to its right and their own file: after any
edit there nothing old is found.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import threading
import types
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numba import config, njit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

# The setting is the process's: one thread at a time may borrow it.
_setting = threading.Lock()

PACKAGE = Path(__file__).resolve().parent.parent


@cache
def source_hash(file: str, also: tuple[str, ...] = ()) -> str:
    """Hash of a source file, some others, and those of ``integrate`` and ``physics``."""
    digest = hashlib.sha256()
    for name in (file, *also):
        digest.update(Path(name).read_bytes())
    for room in ("integrate", "physics"):
        for path in sorted((PACKAGE / room).rglob("*.py")):
            digest.update(path.relative_to(PACKAGE).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def directory(file: str, also: tuple[str, ...] = ()) -> Path:
    """Directory of the compiled functions of a source file, which may reach those in ``also``.

    Under ``$NUMBA_CACHE_DIR`` if it is set, else in the user's cache directory, else in a
    temporary one.
    """
    user = os.environ.get("XDG_CACHE_HOME") or os.path.join("~", ".cache")
    roots = [os.environ.get("NUMBA_CACHE_DIR", ""), os.path.join(user, "rattlesweep")]
    for root in filter(None, roots):
        path = Path(root).expanduser() / source_hash(file, also)
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(path, os.W_OK | os.X_OK):
            return path
    return Path(tempfile.mkdtemp(prefix="rattlesweep-"))


@contextmanager
def _numba_directory(file: str, also: tuple[str, ...]) -> Iterator[None]:
    # Numba reads the setting when a function is decorated; others' functions keep theirs.
    with _setting:
        before = config.CACHE_DIR
        config.CACHE_DIR = str(directory(file, also))
        try:
            yield
        finally:
            config.CACHE_DIR = before


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
    """``njit(cache=True)`` with the cache in :func:`directory` of the function's file.

    Parameters
    ----------
    also : tuple of str
        Other files, outside this room and the one to its right, whose functions it calls.
    """
    with _numba_directory(function.__code__.co_filename, also):
        return njit(cache=True, **options)(function)
