"""Kernels of all methods and models, and the threads that they may use."""

from __future__ import annotations

import os
import threading
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from numba import config

from rattlesweep.integrate import SettingError
from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.lanes import kernel as lanes
from rattlesweep.integrate.lanes import runs, tangents
from rattlesweep.integrate.lanes.intrinsics import INNER, address_of, addresses_of
from rattlesweep.integrate.lanes.lane import LANES, Layout, Problem
from rattlesweep.integrate.lanes.step import OPTIONS, write_attempt
from rattlesweep.integrate.model import find_model
from rattlesweep.integrate.tableau import METHODS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rattlesweep.arrays import Floats
    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau


def problem_of(model: Model, adaptive: bool, width: int = LANES) -> Problem:
    """Return what the kernels of a model are compiled for."""
    kind = tangents if model.rate else runs
    hooks = {"start": kind.start, "pass_marks": kind.pass_marks, "finish": kind.finish}
    advance = tangents.advance if model.rate else lanes.advance
    return Problem(model, adaptive, width, advance=advance, **hooks)


def workspace(tableau: Tableau, model: Model, threads: int, width: int = LANES) -> Floats:
    """Return the workspace of each thread, a row of zeros on cache lines of its own."""
    size = -(-Layout(model).rows(tableau, model) * width // 16) * 16
    flat = np.zeros(threads * size + 8)
    shift = (-flat.ctypes.data // 8) % 8
    found = flat[shift : shift + threads * size].reshape(threads, size)
    # Whole rows: they are looked at as such where nothing is compiled.
    return found[:, : size // width * width] if config.DISABLE_JIT else found


# -- recipes, see compile.Recipe -------------------------------------------------------------------

# Arguments of their types: a workspace, addresses of parts, and what threads share, empty.
FLAT, TABLE, NO_PARTS = np.zeros(0), np.zeros((0, 1)), np.zeros(lanes.PARTS, dtype=np.int64)
WHOLE = np.zeros(0, dtype=np.int64)
RUNS = TABLE, TABLE, TABLE, TABLE, FLAT, np.zeros(1, dtype=np.bool_)
SHARED = WHOLE, WHOLE, *RUNS, TABLE, TABLE.astype(np.int64), np.zeros((0, 1, 1)), TABLE


def work(model_name: str, adaptive: bool) -> Kernel:
    """Return :func:`lanes.work` for a model: what each thread does."""
    arguments = problem_of(find_model(model_name), adaptive), 0, NO_PARTS, FLAT, *SHARED
    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    return Kernel(lanes.work, arguments, options)


def attempt(tableau_name: str, model_name: str, beside: str = "") -> Kernel:
    """Return the step of a method and a model; ``beside`` is ``volume`` or nothing."""
    tableau, model = METHODS[tableau_name], find_model(model_name)
    written = write_attempt(tableau, model, volume=beside == "volume")
    return Kernel(written, (problem_of(model, tableau.adaptive), FLAT, 1.0), OPTIONS)


def decide_closely(adaptive: bool) -> Kernel:
    """Return :func:`lanes.decide_closely`, which is that of all models."""
    return Kernel(lanes.decide_closely, (Problem(None, adaptive), FLAT, 0, 1.0, False), INNER)


def drive() -> Kernel:
    """Return what starts the threads of all kernels."""
    options = {"parallel": True, "nogil": True}
    return Kernel(lanes.drive, (0, NO_PARTS, 1, TABLE, SHARED), options)


# -- threads ---------------------------------------------------------------------------------------

# Whether this process was forked from one in which GNU OpenMP had started threads: it ends a
# process that starts threads again.
_forked = False
# Numba's own threading layer ends a process in which two threads start a kernel.
_workqueue = threading.Lock()


def _after_fork() -> None:
    global _forked, _workqueue
    _workqueue = threading.Lock()  # whoever held it is not in this process
    with suppress(ValueError):  # no threads were started
        _forked = numba.threading_layer() == "omp" or _forked


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def parallel() -> bool:
    """Return whether this process can start threads for its kernels, or raise SettingError."""
    if _forked or config.DISABLE_JIT:
        return False
    try:
        numba.get_num_threads()
    except ValueError as error:
        raise SettingError(f"NUMBA_THREADING_LAYER: {str(error).splitlines()[0]}") from error
    return True


@contextmanager
def holding(threads: int) -> Iterator[None]:
    """Have threads for a kernel."""
    if not parallel():
        yield
        return
    with _workqueue if numba.threading_layer() == "workqueue" else nullcontext():
        before = numba.get_num_threads()
        numba.set_num_threads(threads)
        try:
            yield
        finally:
            numba.set_num_threads(before)


# -- kernels ---------------------------------------------------------------------------------------


def kernel(tableau_name: str, model_name: str, *beside: str) -> Callable[..., None]:
    """Return a kernel: called with the number of threads, their workspaces and what they share.

    With ``"volume"`` beside, its steps find the rate of phase volume.  Where not :func:`parallel`,
    its threads work one after another.
    """
    adaptive = METHODS[tableau_name].adaptive
    wanted: list[tuple[Any, ...]] = [
        (work, model_name, adaptive),
        (attempt, tableau_name, model_name, *beside),
        (decide_closely, adaptive),
    ]
    if parallel():
        do, *others, start = load_kernels(*wanted, (drive,))
        return partial(start, address_of(do), addresses_of(*others))
    do, *others = load_kernels(*wanted)
    problem, addresses = problem_of(find_model(model_name), adaptive), addresses_of(*others)

    def alone(threads: int, w: Floats, shared: tuple[Any, ...]) -> None:
        for thread in range(threads):
            do(problem, thread, addresses, w[thread], *shared)

    return alone
