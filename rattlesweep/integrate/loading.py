"""Kernels compiled by other processes, side by side, and loaded.

Numba holds a lock, and the interpreter's, for as long as it compiles.  A kernel is therefore
compiled by a process that does nothing else: two come to be at the same time, bodies are drawn
meanwhile, and Ctrl-C is heard.  It is also what makes every process run the same machine
code: one that compiles runs the functions of a kernel as they were optimised one by one, one that
loads runs them as they were optimised together.  ``benchmarks/bits.py`` has not found a kernel
whose results would differ by that, but nothing promises that there is none.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import traceback
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from typing import Any

import numba
from numba.core.compiler_lock import global_compiler_lock

from rattlesweep import child
from rattlesweep.integrate.cache import KernelCache
from rattlesweep.integrate.compiling import compiling
from rattlesweep.integrate.task import side_by_side

# Function at the top of a module: given names, what `cache.cached` made, and arguments of
# the types that it will be called with.
Example = Callable[..., tuple[Any, tuple[Any, ...]]]

# Processes that compile at the same time: each takes 200 MB, and no group of kernels gains by more.
AT_ONCE = 2


def signature_of(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """Numba's types of some arguments."""
    return tuple(numba.typeof(argument) for argument in arguments)


def compile_here(module: str, function: str, names: list[Any]) -> bytes:
    """Sealed code of the kernel of an example."""
    compiled, arguments = getattr(import_module(module), function)(*names)
    # Not what is on disk.
    compiled._cache = KernelCache(compiled.py_func, None)
    compiled.compile(signature_of(arguments))
    code: bytes = compiled._cache.handed_over()
    return code


def serve() -> None:
    """In a child: compile what standard input names, one line each, until it ends."""
    # Whatever else prints must not come in between, nor fill a pipe that nobody reads.
    out = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    for line in sys.stdin:
        try:
            code, said = compile_here(*json.loads(line)), ""
        except Exception:
            code, said = b"", traceback.format_exc()
        with suppress(BrokenPipeError):  # who asked is no more
            out.write(json.dumps([len(code), said]).encode() + b"\n" + code)
            out.flush()
            continue
        break
    # Python would take a while to let go of all that LLVM has made.
    os._exit(0)


class Compiler:
    """A process that compiles one kernel after another: most of a second goes into its start."""

    def __init__(self) -> None:
        self._process = child.start(__name__, "SIG_DFL", PYTHONHASHSEED="0")

    def __call__(self, example: Example, names: tuple[Any, ...]) -> bytes:
        """Sealed code of the kernel of an example."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(BrokenPipeError):
            request = json.dumps([example.__module__, example.__name__, names])
            self._process.stdin.write(request.encode() + b"\n")
            self._process.stdin.flush()
        size, said = json.loads(self._process.stdout.readline() or "[0, null]")
        code = self._process.stdout.read(size)
        if size and len(code) == size:
            return code
        if said is None:
            said = self._process.communicate()[1].decode(errors="replace")
            said = f"its process ended with {self._process.returncode}\n{said}"
        raise RuntimeError(f"the kernel {_title(example, names)} could not be compiled:\n{said}")

    def close(self, at_once: bool = False) -> None:
        """End the process, which has nothing to do unless it is to be ended at once."""
        if at_once:
            self._process.kill()
        with suppress(BrokenPipeError):
            self._process.communicate()


def _title(example: Example, names: tuple[Any, ...]) -> str:
    return "/".join(map(str, names or [example.__name__]))


class Pool:
    """The processes that compile for this one; none is left when there is nothing to compile."""

    def __init__(self) -> None:
        self._seats = threading.BoundedSemaphore(AT_ONCE)
        self._lock = threading.Lock()
        self._idle: list[Compiler] = []
        self._wanted = 0

    @contextmanager
    def compiler(self) -> Iterator[Compiler]:
        """A process of one's own for a while."""
        with self._lock:
            self._wanted += 1
        try:
            with self._seats:
                with self._lock:
                    found = self._idle.pop() if self._idle else None
                found = found or Compiler()
                try:
                    yield found
                except BaseException:
                    found.close(at_once=True)
                    raise
                with self._lock:
                    self._idle.append(found)
        finally:
            with self._lock:
                self._wanted -= 1
                done, self._idle = (self._idle, []) if self._wanted == 0 else ([], self._idle)
            for process in done:
                process.close()


_pool = Pool()
_there: dict[tuple[Any, ...], Any] = {}
# Each kernel is compiled once although several threads ask for it.
_loading: defaultdict[tuple[Any, ...], threading.Lock] = defaultdict(threading.Lock)


def _after_fork() -> None:
    # Whoever held a lock or a process is not in this one.
    global _pool
    _pool = Pool()
    _loading.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def loaded(example: Example, *names: Any) -> Any:
    """Kernel of an example, loaded; its first call on a machine takes the time of its compilation.

    Parameters
    ----------
    example : Example
    *names : str or bool
        What it is given.
    """
    wanted = (example, *names)
    with _loading[wanted]:
        if wanted not in _there:
            _there[wanted] = _load(example, names)
        return _there[wanted]


def _load(example: Example, names: tuple[Any, ...]) -> Any:
    compiled, arguments = example(*names)
    signature, context, store = signature_of(arguments), compiled.targetctx, compiled._cache
    # Numba's own registries are read by one thread at a time.
    with global_compiler_lock:
        context.refresh()
    name = store.name(signature, context)
    if store.get(name) is None:
        with store.locked(name):
            if store.get(name) is None:
                with compiling(_title(example, names)), _pool.compiler() as compiler:
                    store.put(name, compiler(example, names))
    compiled.compile(signature)
    return compiled


def together(*wanted: tuple[Any, ...]) -> list[Any]:
    """Kernels of several examples, each with its names: :func:`loaded`, side by side."""
    if all(each in _there for each in wanted):
        return [_there[each] for each in wanted]
    # No more threads than processes: none would begin one when it hears of a Ctrl-C.
    return side_by_side([partial(_one, each) for each in wanted], AT_ONCE)


def _one(wanted: tuple[Any, ...], control: object) -> Any:
    return loaded(*wanted)
