"""Threads of kernels: whether this process can start them, and how many."""

import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress

import numba
from numba import config

from rattlesweep.system.processors import SettingError, processors

# Whether GNU OpenMP had started threads when this process was forked; it cannot start
# any here.
_forked = False
# Numba's layer "workqueue" ends a process in which two threads start a kernel at once.
_workqueue = threading.Lock()


def _after_fork() -> None:
    global _forked, _workqueue
    # The thread that held the old lock does not exist here.
    _workqueue = threading.Lock()
    with suppress(ValueError):  # no threads were started
        _forked = numba.threading_layer() == "omp" or _forked


def parallel() -> bool:
    """Return whether this process can start threads.

    Raises SettingError if no threading layer can be loaded.
    """
    if _forked or config.DISABLE_JIT:
        return False
    try:
        numba.get_num_threads()
    except ValueError as error:
        raise SettingError(
            f"NUMBA_THREADING_LAYER: {str(error).splitlines()[0]}"
        ) from error
    return True


@contextmanager
def holding(threads: int) -> Iterator[None]:
    """Set the number of threads of the kernels started inside ``with``."""
    if not parallel():
        yield
        return
    own: AbstractContextManager[object] = nullcontext()
    if numba.threading_layer() == "workqueue":
        own = _workqueue
    with own:
        before = numba.get_num_threads()
        numba.set_num_threads(threads)
        try:
            yield
        finally:
            numba.set_num_threads(before)


def available_threads() -> int:
    """Return the default number of threads, one for each processor allowed."""
    return min(processors(), int(config.NUMBA_NUM_THREADS))
