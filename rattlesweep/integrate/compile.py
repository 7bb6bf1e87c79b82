"""Compile kernels once a machine, in processes of their own, and load them from the user's cache.

Numba's ``cache=True`` looks at the file of the function that is called, and not at the files of
the functions that it calls.  The cache is therefore a folder named by a hash of all sources that
kernels are made of, and of what they are compiled with and for: after an edit nothing old is found.
A kernel has a subfolder of its own, since Numba's index of a function is not made for two processes
that write to it at once.

Numba holds its own lock, and mostly the interpreter's, while it compiles.  So other processes
compile: two kernels at once, while the calling process draws bodies and hears Ctrl-C.  They are
plain ``python -c`` processes.  Those of ``concurrent.futures`` would import the user's script again
(and run it, where it has no ``if __name__ == "__main__"``), and outlive a command that is stopped.

What is loaded is executed: see :func:`cache_folder` for whom the folder must belong to.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import cache
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

# Packages are imported by the functions that need them: commands that need no kernel take half the
# time.
PACKAGE = Path(__file__).resolve().parents[1]
# Processes that compile at the same time: each takes 200 MB, and no group of kernels gains by more.
AT_ONCE = 2


class Kernel(NamedTuple):
    """A function to compile.

    Attributes
    ----------
    function : callable
    arguments : tuple
        Arguments of the types that it is compiled for.
    options : dict
        Options of ``njit``.
    files : tuple of str
        Source files outside of ``integrate`` and ``physics`` whose functions it calls.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    options: dict[str, Any]
    files: tuple[str, ...] = ()


# A function at the top of a module, which makes a kernel from names (str or bool).
Recipe = Callable[..., Kernel]


# -- the folder ------------------------------------------------------------------------------------


def _hash(files: list[Path], *words: object) -> str:
    digest = hashlib.sha256(repr(words).encode())
    for path in files:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def source_hash() -> str:
    """Return the hash of what kernels are made of, made with and made for.

    Where the package lies is part of it, since Numba's index of a function is for one file.
    """
    import llvmlite
    import numba
    from llvmlite import binding
    from numba import config

    files = [path for room in ("integrate", "physics") for path in (PACKAGE / room).rglob("*.py")]
    processor = (
        config.CPU_NAME or binding.get_host_cpu_name(),
        config.CPU_FEATURES or binding.get_host_cpu_features().flatten(),
    )
    versions = sys.version, numba.__version__, llvmlite.__version__
    return _hash(sorted(files), str(PACKAGE), *versions, *processor)


def _others_may_write(found: os.stat_result) -> bool:
    """Return whether somebody else can write; a group of the user's own is nobody else."""
    if not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return False
    try:
        import grp
        import pwd

        user, group = pwd.getpwuid(found.st_uid), grp.getgrgid(found.st_gid)
    except (ImportError, KeyError):
        return True
    own = user.pw_gid == group.gr_gid and not {*group.gr_mem} - {user.pw_name}
    return bool(found.st_mode & stat.S_IWOTH) or user.pw_name != group.gr_name or not own


def is_private(folder: Path) -> bool:
    """Return whether only this user, and root, can put anything into a folder.

    It must be this user's with mode 0700, and nobody else may be able to replace it: the folders
    above are this user's or root's, and not writable for others unless they are sticky.  A missing
    folder is made, but not below one that belongs to somebody else.
    """
    if not hasattr(os, "geteuid"):  # Windows, where the user's folders are private
        folder.mkdir(parents=True, exist_ok=True)
        return True
    for parent in reversed(folder.parents):
        parent.mkdir(mode=0o700, exist_ok=True)
        found = parent.stat()
        if found.st_uid not in (0, os.geteuid()):
            return False
        if _others_may_write(found) and not found.st_mode & stat.S_ISVTX:
            return False
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.stat()
    private = found.st_uid == os.geteuid() and stat.S_IMODE(found.st_mode) == 0o700
    return private and os.access(folder, os.W_OK)


@cache
def cache_folder() -> Path:
    """Return the folder of this version's kernels.

    It lies in ``$NUMBA_CACHE_DIR`` if that is set, else in the user's cache directory.  Where
    neither :func:`is_private`, it is a temporary folder, which is removed when this process ends;
    where there is none either, as on a full disk, it is one that cannot be: kernels then stay in
    memory.
    """
    from platformdirs import user_cache_dir

    for root in filter(None, (os.environ.get("NUMBA_CACHE_DIR"), user_cache_dir("rattlesweep"))):
        with suppress(OSError, RuntimeError):  # RuntimeError: there is no home
            folder = Path(root).expanduser().resolve() / source_hash()
            if is_private(folder):
                return folder
    try:
        temporary = Path(tempfile.mkdtemp(prefix="rattlesweep-"))
    except OSError:
        return Path(os.devnull, "nowhere")
    atexit.register(_remove, temporary, os.getpid())
    return temporary


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:  # and not one that was forked from it
        shutil.rmtree(folder, ignore_errors=True)


def _place(recipe: Recipe, names: tuple[Any, ...]) -> Path:
    """Return the subfolder of a kernel."""
    kernel = recipe(*names)
    files = [_hash([Path(file) for file in kernel.files])[:8]] if kernel.files else []
    return cache_folder() / "-".join([recipe.__name__, *map(str, names), *files])


def import_written(name: str, source: str) -> ModuleType:
    """Write a module into :func:`cache_folder`, import it and return it."""
    path = cache_folder() / f"{name}.py"
    if name in sys.modules and getattr(sys.modules[name], "__file__", None) == str(path):
        return sys.modules[name]
    try:
        if not path.exists() or path.read_text() != source:
            written = path.with_suffix(f".{os.getpid()}")
            written.write_text(source)
            written.replace(path)
    except OSError:
        # A full disk: the module is the same, but no debugger can show its source.
        sys.modules[name] = module = ModuleType(name)
        exec(compile(source, str(path), "exec"), vars(module))
        return module
    spec = spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    # Numba looks the module of a stored function up by its name.
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


# -- loading ---------------------------------------------------------------------------------------

_loaded: dict[tuple[Any, ...], Any] = {}
_cache_dir = threading.Lock()


def load_kernel(recipe: Recipe, *names: Any) -> Any:
    """Return a compiled kernel: :func:`load_kernels` for one."""
    return load_kernels((recipe, *names))[0]


def load_kernels(*wanted: tuple[Any, ...]) -> list[Any]:
    """Return compiled kernels; those that were never compiled on this machine take seconds.

    Parameters
    ----------
    *wanted : tuple
        A :data:`Recipe` each, and the names that it is given.

    Returns
    -------
    list
        Functions for the types of their recipe's arguments; plain Python functions with
        ``NUMBA_DISABLE_JIT=1``.
    """
    missing = [(recipe, names) for recipe, *names in wanted if (recipe, *names) not in _loaded]
    if missing:
        _compile([(recipe, tuple(names)) for recipe, names in missing])
    for recipe, names in missing:
        _loaded.setdefault((recipe, *names), _load(recipe, tuple(names)))
    return [_loaded[each] for each in wanted]


def _load(recipe: Recipe, names: tuple[Any, ...]) -> Any:
    """Load a kernel, or compile it here if no other process could."""
    import numba
    from numba import config, njit

    function, arguments, options, _ = recipe(*names)
    if config.DISABLE_JIT:
        return function
    signature = tuple(map(numba.typeof, arguments))
    place = _place(recipe, names)
    with suppress(Exception):
        # A damaged file or a full disk: the kernel is then compiled again, and kept in memory.  An
        # error in the kernel comes up again below.
        with _cache_dir:
            before, config.CACHE_DIR = config.CACHE_DIR, str(place)
            try:
                compiled = njit(cache=True, **options)(function)
            finally:
                config.CACHE_DIR = before
        # Numba looks elsewhere when it cannot write here.
        if place in Path(compiled.stats.cache_path).parents:
            compiled.compile(signature)
            return compiled
    shutil.rmtree(place, ignore_errors=True)
    compiled = njit(**options)(function)
    compiled.compile(signature)
    return compiled


def is_stored(recipe: Recipe, *names: Any) -> bool:
    """Return whether a kernel has been compiled before."""
    return any(_place(recipe, names).glob("*/*.nbc"))


# -- compiling -------------------------------------------------------------------------------------

# The child ends with a Ctrl-C without a word, and does not look for garbage: that would take an
# eighth of the time.
CODE = (
    "import gc, signal; gc.disable(); signal.signal(signal.SIGINT, signal.SIG_DFL); "
    f"from {__name__} import compile_in_child; compile_in_child()"
)


def _compile(wanted: list[tuple[Recipe, tuple[Any, ...]]]) -> None:
    """Have other processes compile the kernels that are not stored, and wait for them.

    Each kernel has a lock, which dies with the process that compiles it.  So all processes of this
    user share the work: none compiles what another one is compiling.
    """
    from numba import config

    if config.DISABLE_JIT:
        return
    wanted = [(recipe, names) for recipe, names in wanted if not is_stored(recipe, *names)]
    if not wanted:
        return
    orders = [(recipe.__module__, recipe.__name__, names) for recipe, names in wanted]
    path = os.pathsep.join(filter(None, [str(PACKAGE.parent), os.environ.get("PYTHONPATH")]))
    children: list[subprocess.Popen[bytes]] = []
    with compiling("-".join(map(str, wanted[0][1]))):
        try:
            for _ in range(min(AT_ONCE, len(wanted))):
                # -P: a package of this name in the working directory is another one.
                call = [sys.executable, "-P", "-c", CODE, str(cache_folder()), json.dumps(orders)]
                children.append(
                    subprocess.Popen(
                        call,
                        env=os.environ | {"PYTHONPATH": path, "PYTHONHASHSEED": "0"},
                        stdin=subprocess.PIPE,
                        stdout=subprocess.DEVNULL,
                        stderr=subprocess.DEVNULL,
                    )
                )
            for child in children:
                child.wait()
            for recipe, names in wanted:
                # Another command may be compiling it.
                with _locked(_place(recipe, names), timeout=-1):
                    pass
        finally:
            for child in children:
                child.kill()
                child.communicate()


@contextmanager
def _locked(place: Path, timeout: float) -> Iterator[bool]:
    """Hold the lock of a kernel, where there are locks; False if another process holds it."""
    from filelock import FileLock, Timeout

    lock, free = FileLock(f"{place}.lock", timeout=timeout), True
    try:
        lock.acquire()
    except Timeout:
        free = False
    except (OSError, NotImplementedError):
        pass
    try:
        yield free
    finally:
        lock.release()


def compile_in_child() -> None:
    """Compile and store kernels, in a process that does nothing else."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    folder, orders = Path(sys.argv[1]), json.loads(sys.argv[2])
    globals()["cache_folder"] = lambda: folder
    for module, name, names in orders:
        recipe = getattr(import_module(module), name)
        with _locked(_place(recipe, names), timeout=0) as free:
            if free and not is_stored(recipe, *names):
                _load(recipe, tuple(names))
    # Python would take a while to let go of all that LLVM has made.
    os._exit(0)


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(1)


# -- saying so -------------------------------------------------------------------------------------

# Given a kernel's name; what it makes lasts as long as the compilation.
Listener = Callable[[str], AbstractContextManager[object]]
_listeners: list[Listener] = []


@contextmanager
def listening(listener: Listener | None) -> Iterator[None]:
    """Tell a listener of the compilations inside ``with``, in all threads; None: tell nobody."""
    _listeners.append(listener or nullcontext)
    try:
        yield
    finally:
        _listeners.pop()


def compiling(kernel: str) -> AbstractContextManager[object]:
    """Return the innermost listener's context of a compilation."""
    return _listeners[-1](kernel) if _listeners else nullcontext()
