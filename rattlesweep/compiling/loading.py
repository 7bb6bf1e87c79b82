"""Compile kernels in other processes, and load them from the user's cache.

Numba's ``cache=True`` notices changes in the file of the cached function, but not in
the files of the functions that it calls.  The cache is therefore a folder named by a
hash of all sources of kernels, of the versions that compile them and of the processor.
Each kernel has its own subfolder, since two processes must not write to one index of
Numba at once.  Loading a kernel executes stored code, so the folder must be private
(:func:`is_private`), and what was checked is held open while kernels are loaded.

Numba holds its own lock, and most of the time the interpreter's, while it compiles.  So
other processes compile, two kernels at once, while the calling process draws bodies and
receives Ctrl-C. The processes of ``concurrent.futures`` would import the user's script
again, and outlive a command that is stopped.  On Linux the second process is a fork of
the first one, which has imported Numba and prepared it.
"""

import atexit
import gc
import hashlib
import json
import os
import re
import shutil
import stat
import subprocess
import sys
import tempfile
import threading
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

from rattlesweep.system.lockfile import LockFile

if TYPE_CHECKING:
    from numba.core.dispatcher import Dispatcher

# Functions import Numba where they need it: commands without a kernel start faster.
PACKAGE = Path(__file__).resolve().parents[1]
PROCESSES = 2  # processes that compile at once
FORKS = sys.platform == "linux"  # whether the second one is a fork of the first
TOLD_EVERY = 60.0  # seconds after which a listener is told again that they compile
# Settings of Numba, as in NUMBA_OPT, that change the code of a kernel.
NUMBA_SETTINGS = (
    "OPT",
    "LOOP_VECTORIZE",
    "SLP_VECTORIZE",
    "ENABLE_AVX",
    "DISABLE_INTEL_SVML",
    "BOUNDSCHECK",
    "DEBUGINFO_DEFAULT",
    "ENABLE_PROFILING",
    "EXTEND_VARIABLE_LIFETIMES",
    "LLVM_REFPRUNE_PASS",
    "LLVM_REFPRUNE_FLAGS",
    "DEBUG_ARRAY_OPT_RUNTIME",
    "DEBUG_NRT",
    "PARFOR_MAX_TUPLE_SIZE",
)
# Set in the processes that compile, which start no others.
IS_CHILD = "RATTLESWEEP_IS_COMPILING"
# Names of interpreters; another program that has Python inside is not one.
INTERPRETER = re.compile(r"(python|pypy|graalpy)[\d.]*[a-z]?(_d)?(\.exe)?", re.ASCII)


class Kernel(NamedTuple):
    """A function to compile for the types of its arguments."""

    function: Callable[..., object]
    arguments: tuple[object, ...]
    options: Mapping[str, object]  # of ``njit``
    # Sources outside of these rooms that it depends on.
    files: tuple[str, ...] = ()
    # Compiled within a second, so that another process would take longer to start.
    small: bool = False


# A module-level function that returns a kernel for some names, each a string or a bool.
Recipe = Callable[..., Kernel]
Order = tuple[Recipe, *tuple[str | bool, ...]]
# What Numba makes of the function of a kernel.
Compiled = Callable[..., object]


def _hash(files: Mapping[str, bytes], *versions: object) -> str:
    digest = hashlib.sha256(repr(versions).encode())
    for name in sorted(files):
        digest.update(name.encode() + b"\0" + files[name] + b"\0")
    return digest.hexdigest()[:16]


def _sources(place: Path) -> dict[str, bytes]:
    """Return a source file, or those of a folder, by path; they may lie in a zip."""
    for parent in place.parents:
        if parent.is_file():
            inside = place.relative_to(parent).as_posix()
            with zipfile.ZipFile(parent) as archive:
                names = [name for name in archive.namelist() if name.endswith(".py")]
                return {
                    name: archive.read(name)
                    for name in names
                    if name == inside or name.startswith(f"{inside}/")
                }
    if place.is_file():
        return {place.name: place.read_bytes()}
    return {
        path.relative_to(place.parent).as_posix(): path.read_bytes()
        for path in place.rglob("*.py")
    }


@cache
def program_hash() -> str:
    """Return a hash of all sources, wherever they lie."""
    return _hash(_sources(PACKAGE))


def processor() -> str:
    """Return the type of processor for which kernels are compiled."""
    from llvmlite import binding
    from numba import config

    return str(config.CPU_NAME or binding.get_host_cpu_name())


@cache
def source_hash() -> str:
    """Return a hash of the kernels' sources, their folder, versions and processor."""
    import llvmlite
    import numba
    from llvmlite import binding
    from numba import config

    files: dict[str, bytes] = {}
    for room in ("compiling", "kernel", "motion", "physics"):
        files |= _sources(PACKAGE / room)
    features = config.CPU_FEATURES or binding.get_host_cpu_features().flatten()
    versions = sys.version, numba.__version__, llvmlite.__version__
    settings = [(key, repr(getattr(config, key, None))) for key in NUMBA_SETTINGS]
    return _hash(files, str(PACKAGE), *versions, processor(), features, settings)


def is_private(folder: Path) -> bool:
    """Create a folder if it is missing, and return whether only this user can write.

    The folder must be this user's, and closed to all others.  Its parents must belong
    to this user or to root, and must not be writable by others, such as a group, unless
    they are sticky.  No link is followed, since its owner could lead it elsewhere.
    """
    if not hasattr(os, "geteuid"):  # Windows, where the user's folders are private
        folder.mkdir(parents=True, exist_ok=True)
        return True
    for parent in reversed(folder.parents):
        parent.mkdir(mode=0o700, exist_ok=True)
        about = parent.lstat()
        writers = about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        shared = writers and not about.st_mode & stat.S_ISVTX
        if shared or about.st_uid not in (0, os.geteuid()):
            return False
        if not stat.S_ISDIR(about.st_mode):
            return False
    folder.mkdir(mode=0o700, exist_ok=True)
    return _is_own(folder.lstat()) and os.access(folder, os.W_OK)


def _is_own(about: os.stat_result) -> bool:
    """Return whether this is a folder of this user, closed to all others."""
    # The bits above these, such as the one by which a folder passes its group on, open
    # it to nobody.
    closed = about.st_mode & 0o777 == 0o700
    return stat.S_ISDIR(about.st_mode) and closed and about.st_uid == os.geteuid()


def _held_path(folder: Path) -> Path:
    """Return a path that leads to a folder even if another one takes its place.

    OSError is raised if the folder is not private.
    """
    if not hasattr(os, "geteuid"):
        return folder
    # It stays open, since Numba may look there again.
    file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    if not is_private(folder) or not _is_own(os.fstat(file)):
        os.close(file)
        raise OSError(f"{folder} is not private any more")
    path = Path(f"/proc/self/fd/{file}")
    return path if path.is_dir() else folder


def _private_folder(root: Callable[[], str]) -> Path | None:
    """Return the folder of these sources below a root, or None if it is not private."""
    try:
        folder = Path(root()).expanduser().resolve() / source_hash()
        private = is_private(folder)
    except (OSError, RuntimeError):  # RuntimeError: the user has no home directory
        return None
    return folder if private else None


@cache
def _stored_folder() -> Path | None:
    """Return the folder in which later runs find kernels, or None if there is none."""
    from platformdirs import user_cache_dir

    if named := os.environ.get("NUMBA_CACHE_DIR"):
        folder = _private_folder(lambda: named)
        if folder is not None:
            return folder
    return _private_folder(lambda: user_cache_dir("rattlesweep"))


@cache
def cache_folder() -> Path:
    """Return the folder of the kernels of these sources.

    It lies in ``$NUMBA_CACHE_DIR``, or else in the user's cache directory.  If neither
    is private, it is a temporary folder that is removed when this process ends.
    """
    stored = _stored_folder()
    if stored is not None:
        return stored
    temporary = Path(tempfile.mkdtemp(prefix="rattlesweep-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    folder = temporary / source_hash()
    folder.mkdir(mode=0o700)
    return folder


def _place(recipe: Recipe, *names: str | bool) -> Path:
    """Return the folder of a kernel."""
    files = [_hash(_sources(Path(file)))[:8] for file in recipe(*names).files]
    return cache_folder() / "-".join([recipe.__name__, *map(str, names), *files])


# One thread at a time imports, so that none finds half a module.
_importing = threading.RLock()


def import_written(name: str, source: str) -> ModuleType:
    """Write a module into :func:`cache_folder`, import it and return it."""
    path = cache_folder() / f"{name}.py"
    with _importing:
        imported = sys.modules.get(name)
        if imported is not None and getattr(imported, "__file__", None) == str(path):
            return imported
        if not path.exists() or path.read_text("utf-8") != source:
            unfinished = path.with_suffix(f".{os.getpid()}")
            unfinished.write_text(source, "utf-8")
            unfinished.replace(path)
        module = ModuleType(name)
        module.__file__ = str(path)
        # Numba finds the module of a stored function by name, and looks at its file.
        # What is executed is the text, whatever the file holds by then.
        sys.modules[name] = module
        exec(compile(source, path, "exec"), module.__dict__)
        return module


_loaded: dict[Order, Compiled] = {}
_cache_dir = threading.Lock()


def load_kernels(*wanted: Order) -> list[Compiled]:
    """Return kernels, given by recipes and names; compile those not stored."""
    missing = [order for order in wanted if order not in _loaded]
    _compile([order for order in missing if not is_stored(*order)])
    for order in missing:
        _loaded.setdefault(order, _load(*order))
    return [_loaded[order] for order in wanted]


def _load(recipe: Recipe, *names: str | bool) -> Compiled:
    """Load a kernel, or compile it in this process if no other could."""
    from numba import config, njit

    kernel = recipe(*names)
    if config.DISABLE_JIT:
        return kernel.function
    place = _place(recipe, *names)
    try:
        return _load_from(place, kernel)
    except OSError:  # such as a full disk
        pass
    except Exception:
        # A damaged file can raise anything.  Once it is gone, an error that is not one
        # of the disk is an error of Numba, which must be seen: without it, every start
        # would be as slow as the first.
        shutil.rmtree(place, ignore_errors=True)
        with suppress(OSError):
            return _load_from(place, kernel)
    # The kernel stays in memory.
    shutil.rmtree(place, ignore_errors=True)
    return _typed(njit(**kernel.options)(kernel.function), kernel)


def _load_from(place: Path, kernel: Kernel) -> Compiled:
    """Load a kernel from its folder, or compile it and store it there.

    OSError is raised if nothing can be stored there.
    """
    from numba import config, njit

    place = _held_path(place.parent) / place.name
    # Numba takes the folder of its files from a setting alone, at the time of `njit`.
    with _cache_dir:
        before = config.CACHE_DIR
        config.CACHE_DIR = str(place)
        try:
            compiled = njit(cache=True, **kernel.options)(kernel.function)
        finally:
            config.CACHE_DIR = before
    # Numba uses another folder, which may not be private, if it cannot write to this.
    if place not in Path(compiled.stats.cache_path).parents:
        raise OSError(f"{place} cannot be written")
    return _typed(compiled, kernel)


def _typed(function: "Dispatcher", kernel: Kernel) -> Compiled:
    """Compile a function for the types of its kernel's arguments, or load it so."""
    from numba import typeof

    from rattlesweep.compiling.linking import linking_alone

    with linking_alone():
        function.compile(tuple(map(typeof, kernel.arguments)))
    compiled: Compiled = function
    return compiled


def is_stored(recipe: Recipe, *names: str | bool) -> bool:
    """Return whether a kernel has been compiled before."""
    from numba import config

    return config.DISABLE_JIT or any(_place(recipe, *names).glob("*/*.nbc"))


CODE = f"from {__name__} import compile_in_child; compile_in_child()"


def _compile(wanted: list[Order]) -> None:
    """Let other processes compile kernels, and wait for them.

    Each kernel has a lock, which is released when its process dies, so that no kernel
    is compiled by two processes at once.  What the processes leave out is compiled in
    this one by :func:`_load`.
    """
    if not wanted:
        return
    if _listeners:
        _listeners[-1](_stored_folder() is not None)
    large = [order for order in wanted if not order[0](*order[1:]).small]
    children: list[subprocess.Popen[bytes]] = []
    try:
        count = 0
        if large and _can_start():
            count = 1 if FORKS else min(PROCESSES, len(large))
        for _ in range(count):
            with suppress(OSError):
                children.append(_start_child(large))
        for order in wanted:
            if order not in large:
                with suppress(OSError):
                    _compile_alone(*order)
        for child in children:
            _wait(child)
        for order in wanted:
            # Wait in case another command is compiling this kernel.
            with suppress(OSError):
                lock = LockFile(Path(f"{_place(*order)}.lock"))
                lock.acquire()
                lock.release()
    finally:
        for child in children:
            child.kill()
            child.communicate()


def _wait(child: subprocess.Popen[bytes]) -> None:
    """Wait for a process, and tell the listener now and then that it goes on."""
    while True:
        try:
            child.wait(TOLD_EVERY)
            return
        except subprocess.TimeoutExpired:
            if _listeners:
                _listeners[-1](_stored_folder() is not None)


def _can_start() -> bool:
    """Return whether this process can start Python.

    A program that has Python inside would start itself, and wait for its own end.
    """
    name = os.path.basename(sys.executable or "")
    is_python = INTERPRETER.fullmatch(name) is not None
    return is_python and not hasattr(sys, "frozen") and IS_CHILD not in os.environ


def _start_child(wanted: list[Order]) -> subprocess.Popen[bytes]:
    """Start a process that compiles kernels."""
    orders = [(recipe.__module__, recipe.__name__, names) for recipe, *names in wanted]
    path = [str(PACKAGE.parent)]
    if inherited := os.environ.get("PYTHONPATH"):
        path.append(inherited)
    settings = {
        "PYTHONPATH": os.pathsep.join(path),
        "PYTHONHASHSEED": "0",
        "NUMBA_CACHE_DIR": str(cache_folder().parent),
        # They would not survive a fork.
        "OPENBLAS_NUM_THREADS": "1",
        IS_CHILD: "1",
    }
    # -P: do not import a package of the same name from the working directory.
    return subprocess.Popen(
        [sys.executable, "-P", "-c", CODE, json.dumps(orders)],
        env=os.environ | settings,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def _end_with_parent() -> None:
    """End this process when standard input ends, as it does when the parent dies."""
    sys.stdin.read()
    os._exit(1)  # sys.exit would end this thread alone


def compile_in_child() -> None:
    """Compile and store kernels in a process that does nothing else, and in its fork.

    Each of the two takes the next kernel that the other has not begun.  They begin at
    different ends, as neighbours share functions, which a process compiles once.
    """
    gc.disable()  # the process soon ends, so collecting garbage is lost time
    orders = json.loads(sys.argv[1])
    fork = 0
    if FORKS and len(orders) > 1:
        _prepare(orders)
        with suppress(OSError):
            fork = os.fork()
        if fork:
            orders.reverse()
    # The fork would lack a thread that was started before.
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        compile_orders(orders)
    finally:
        if fork:
            os.waitpid(fork, 0)
        os._exit(0)  # skips freeing the memory of LLVM, which takes a while


def _prepare(orders: list[tuple[str, str, list[str | bool]]]) -> None:
    """Import and prepare what both processes need."""
    from numba import float64, njit

    for module, _, _ in orders:
        import_module(module)
    # The first function that a process compiles takes 0.3 s longer.
    njit([float64(float64)])(_same)


def _same(x: float) -> float:
    return x


def compile_orders(orders: list[tuple[str, str, list[str | bool]]]) -> None:
    """Compile and store kernels: modules and names of recipes, and their arguments."""
    for module, name, names in orders:
        _compile_alone(getattr(import_module(module), name), *names)


def _compile_alone(recipe: Recipe, *names: str | bool) -> None:
    """Compile and store a kernel, if no other process does."""
    lock = LockFile(Path(f"{_place(recipe, *names)}.lock"))
    if lock.acquire(0.0):
        try:
            if not is_stored(recipe, *names):
                _load(recipe, *names)
        finally:
            lock.release()


# A listener is told whether later runs will find the kernels.
Listener = Callable[[bool], object]
_listeners: list[Listener] = []


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Call a listener before each compilation inside ``with``, in all threads.

    While processes compile, it is called again after each `TOLD_EVERY`.
    """
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.pop()
