"""Compile kernels in other processes, and load them from the user's cache.

Numba's ``cache=True`` notices changes in the file of the cached function, but not in
the files of the functions that it calls.  The cache is therefore a folder named by a
hash of all sources of kernels, of the versions that compile them and of the processor.
Each kernel has its own subfolder, since two processes must not write to one index of
Numba at once.  Loading a kernel executes stored code, so the folder must be private
(:func:`is_private`).

Numba holds its own lock, and most of the time the interpreter's, while it compiles.  So
other processes compile, two kernels at once, while the calling process draws bodies and
receives Ctrl-C. The processes of ``concurrent.futures`` would import the user's script
again, and outlive a command that is stopped.
"""

import atexit
import gc
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
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

# Functions import Numba where they need it, so that commands without a kernel start
# faster.
PACKAGE = Path(__file__).resolve().parents[1]
PROCESSES = 2  # processes that compile at once


class Kernel(NamedTuple):
    """A function to compile for the types of ``arguments``, with ``options`` of
    ``njit``.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    options: dict[str, Any]
    files: tuple[
        str, ...
    ] = ()  # sources outside of integrate and physics that it depends on


# A module-level function that returns a kernel for some names, each a string or a bool.
Recipe = Callable[..., Kernel]


def _hash(files: list[Path], *words: object) -> str:
    digest = hashlib.sha256(repr(words).encode())
    for path in files:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def source_hash() -> str:
    """Return a hash of the kernels' sources, their folder, all versions and the
    processor.
    """
    import llvmlite
    import numba
    from llvmlite import binding
    from numba import config

    files = [
        path
        for room in ("integrate", "physics")
        for path in (PACKAGE / room).rglob("*.py")
    ]
    name = config.CPU_NAME or binding.get_host_cpu_name()
    features = config.CPU_FEATURES or binding.get_host_cpu_features().flatten()
    versions = sys.version, numba.__version__, llvmlite.__version__
    return _hash(sorted(files), str(PACKAGE), *versions, name, features)


def is_private(folder: Path) -> bool:
    """Create a folder if it is missing, and return whether only this user can change
    its files.

    The folder must be this user's with mode 0700.  Its parents must belong to this user
    or to root, and must not be writable by all unless they are sticky.
    """
    if not hasattr(os, "geteuid"):  # Windows, where the user's folders are private
        folder.mkdir(parents=True, exist_ok=True)
        return True
    for parent in reversed(folder.parents):
        parent.mkdir(mode=0o700, exist_ok=True)
        found = parent.stat()
        shared = found.st_mode & stat.S_IWOTH and not found.st_mode & stat.S_ISVTX
        if shared or found.st_uid not in (0, os.geteuid()):
            return False
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.stat()
    private = found.st_uid == os.geteuid() and stat.S_IMODE(found.st_mode) == 0o700
    return private and os.access(folder, os.W_OK)


@cache
def cache_folder() -> Path:
    """Return the folder of the kernels of these sources.

    It lies in ``$NUMBA_CACHE_DIR``, or else in the user's cache directory.  If neither
    is private, it is a temporary folder that is removed when this process ends.
    """
    from platformdirs import user_cache_dir

    for root in filter(
        None, (os.environ.get("NUMBA_CACHE_DIR"), user_cache_dir("rattlesweep"))
    ):
        with suppress(
            OSError, RuntimeError
        ):  # RuntimeError: the user has no home directory
            folder = Path(root).expanduser().resolve() / source_hash()
            if is_private(folder):
                return folder
    temporary = Path(tempfile.mkdtemp(prefix="rattlesweep-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    folder = temporary / source_hash()
    folder.mkdir(mode=0o700)
    return folder


def _place(recipe: Recipe, *names: Any) -> Path:
    files = [_hash([Path(file)])[:8] for file in recipe(*names).files]
    return cache_folder() / "-".join([recipe.__name__, *map(str, names), *files])


def import_written(name: str, source: str) -> ModuleType:
    """Write a module into :func:`cache_folder`, import it and return it."""
    path = cache_folder() / f"{name}.py"
    if name in sys.modules and getattr(sys.modules[name], "__file__", None) == str(
        path
    ):
        return sys.modules[name]
    if not path.exists() or path.read_text() != source:
        written = path.with_suffix(f".{os.getpid()}")
        written.write_text(source)
        written.replace(path)
    spec = spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None  # noqa: PT018
    # Numba finds the module of a stored function by name.
    sys.modules[name] = module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


_loaded: dict[tuple[Any, ...], Any] = {}
_cache_dir = threading.Lock()  # held while Numba's setting CACHE_DIR is changed


def load_kernels(*wanted: tuple[Any, ...]) -> list[Any]:
    """Return kernels, each given by a :data:`Recipe` and its names; compile those not
    stored.
    """
    missing = [each for each in wanted if each not in _loaded]
    _compile([each for each in missing if not is_stored(*each)])
    for each in missing:
        _loaded.setdefault(each, _load(*each))
    return [_loaded[each] for each in wanted]


def _load(recipe: Recipe, *names: Any) -> Any:
    """Load a kernel, or compile it in this process if no other could."""
    from numba import config, njit, typeof

    function, arguments, options, _ = recipe(*names)
    if config.DISABLE_JIT:
        return function
    signature, place = tuple(map(typeof, arguments)), _place(recipe, *names)
    # After an error, such as a damaged file or a full disk, the kernel is compiled
    # below in memory.
    with suppress(Exception):
        with _cache_dir:
            before, config.CACHE_DIR = config.CACHE_DIR, str(place)
            try:
                compiled = njit(cache=True, **options)(function)
            finally:
                config.CACHE_DIR = before
        # Numba uses another folder if it cannot write to this one.
        if place in Path(compiled.stats.cache_path).parents:
            compiled.compile(signature)
            return compiled
    shutil.rmtree(place, ignore_errors=True)
    compiled = njit(**options)(function)
    compiled.compile(signature)
    return compiled


def is_stored(recipe: Recipe, *names: Any) -> bool:
    """Return whether a kernel has been compiled before."""
    from numba import config

    return config.DISABLE_JIT or any(_place(recipe, *names).glob("*/*.nbc"))


CODE = f"from {__name__} import compile_in_child; compile_in_child()"


def _compile(wanted: list[tuple[Any, ...]]) -> None:
    """Let other processes compile kernels, and wait for them.

    Each kernel has a lock, which is released when its process dies, so that no kernel
    is compiled by two processes at once.
    """
    from filelock import FileLock

    if not wanted:
        return
    orders = [(recipe.__module__, recipe.__name__, names) for recipe, *names in wanted]
    path = os.pathsep.join(
        filter(None, [str(PACKAGE.parent), os.environ.get("PYTHONPATH")])
    )
    own = {
        "PYTHONPATH": path,
        "PYTHONHASHSEED": "0",
        "NUMBA_CACHE_DIR": str(cache_folder().parent),
    }
    nowhere = subprocess.DEVNULL
    # -P: do not import a package of the same name from the working directory.
    call = [sys.executable, "-P", "-c", CODE, json.dumps(orders)]
    children: list[subprocess.Popen[bytes]] = []
    if _listeners:
        _listeners[-1]()
    try:
        for _ in range(min(PROCESSES, len(wanted))):
            child = subprocess.Popen(
                call,
                env=os.environ | own,
                stdin=subprocess.PIPE,
                stdout=nowhere,
                stderr=nowhere,
            )
            children.append(child)
        for child in children:
            child.wait()
        for each in wanted:
            # Wait in case another command is compiling this kernel.
            with suppress(OSError), FileLock(f"{_place(*each)}.lock"):
                pass
    finally:
        for child in children:
            child.kill()
            child.communicate()


def compile_in_child() -> None:
    """Compile and store kernels in a process that does nothing else and ends with its
    parent.
    """
    from filelock import FileLock, Timeout

    gc.disable()  # the process soon ends, so collecting garbage is lost time
    # Standard input ends when the parent does.
    threading.Thread(
        target=lambda: os._exit(len(sys.stdin.read())), daemon=True
    ).start()
    for module, name, names in json.loads(sys.argv[1]):
        recipe = getattr(import_module(module), name)
        with suppress(Timeout), FileLock(f"{_place(recipe, *names)}.lock", timeout=0):
            if not is_stored(recipe, *names):
                _load(recipe, *names)
    os._exit(0)  # skips freeing the memory of LLVM, which takes a while


_listeners: list[Callable[[], object]] = []


@contextmanager
def listening(listener: Callable[[], object]) -> Iterator[None]:
    """Call a listener before each compilation inside ``with``, in all threads."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.pop()
