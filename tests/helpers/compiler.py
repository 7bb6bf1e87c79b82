"""One process that compiles the kernels of a whole test run.

A command starts processes of its own, each of which imports Numba and compiles what
all kernels have in common.  For the sixty kernels of the tests this would take longer
than the rest of the compilation.  `tests/kernel/test_kernel_cache.py` tests the
processes of commands; the machine code is the same.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from typing import Any

from rattlesweep.compiling import loading

start_child = loading._start_child


class Compiler:
    """A process that compiles one order after the other, and starts with the first."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._busy = threading.Lock()
        self._settings = _cache_settings()

    def start(self, wanted: list[Any]) -> Any:
        """Replace `compile._start_child`: compile kernels, and return what to wait
        for.
        """
        if _cache_settings() != self._settings:  # a test has a cache of its own
            return start_child(wanted)
        self._busy.acquire()
        try:
            self._order(wanted)
        except BaseException:
            self._busy.release()
            raise
        return self

    def _order(self, wanted: list[Any]) -> None:
        """Send orders to the process, which is started if there is none."""
        if self._process is None:
            self._process = _start()
        orders = [
            (order[0].__module__, order[0].__name__, order[1:]) for order in wanted
        ]
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(orders) + "\n")
            self._process.stdin.flush()

    def wait(self, timeout: float | None = None) -> None:
        """Wait until the orders are done, or the process has died, however long."""
        assert self._process is not None
        assert self._process.stdout is not None
        self._process.stdout.readline()

    def kill(self) -> None:
        """Let the process live: there is more to compile."""

    def communicate(self) -> None:
        """Take the next order."""
        self._busy.release()

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            with self._process:
                pass


def _cache_settings() -> list[str | None]:
    return [os.environ.get(name) for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")]


def _start() -> subprocess.Popen[str]:
    settings = {
        "NUMBA_CACHE_DIR": str(loading.cache_folder().parent),
        "PYTHONHASHSEED": "0",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    return subprocess.Popen(
        [sys.executable, "-c", "import compiler; compiler.serve()"],
        env=os.environ | settings,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )


def serve() -> None:
    """Compile what each line of standard input orders, until it ends."""
    for line in sys.stdin:
        for order in json.loads(line):
            # What cannot be compiled here is compiled by the tests' own process.
            with contextlib.suppress(Exception):
                loading.compile_orders([order])
        print(flush=True)
    os._exit(0)  # skips freeing the memory of LLVM, which takes a while
