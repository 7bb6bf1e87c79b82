"""Kernels of all methods and models."""

from __future__ import annotations

import os
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from numba import config

from rattlesweep.integrate import SettingError
from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.lanes import columns as C
from rattlesweep.integrate.lanes import kernel as lanes
from rattlesweep.integrate.lanes import runs, tangents
from rattlesweep.integrate.lanes.intrinsics import INNER, address_of, addresses_of
from rattlesweep.integrate.lanes.lane import LANES, Layout, Problem
from rattlesweep.integrate.lanes.step import OPTIONS, write_attempt
from rattlesweep.integrate.model import REDUCED, find_model
from rattlesweep.integrate.tableau import METHODS, RK4

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau


def problem_of(model: Model, adaptive: bool, width: int = LANES) -> Problem:
    """Return what the kernels of a model are compiled for."""
    kind = tangents if model.tangent else runs
    hooks = {"start": kind.start, "pass_marks": kind.pass_marks, "finish": kind.finish}
    advance = tangents.advance if model.tangent else lanes.advance
    return Problem(model, adaptive, width, advance=advance, **hooks)


def aligned(threads: int, size: int) -> NDArray[np.float64]:
    """Return zeros of shape (threads, size), each row on its own cache lines."""
    size = -(-size // 16) * 16
    flat = np.zeros(threads * size + 8)
    shift = (-flat.ctypes.data // 8) % 8
    return flat[shift : shift + threads * size].reshape(threads, size)


def workspace(tableau: Tableau, model: Model, threads: int) -> NDArray[np.float64]:
    """Return the workspace of each thread, shape (threads, rows * lanes)."""
    size = Layout.of(model).rows(tableau, model) * LANES
    # Whole rows: they are looked at as such where nothing is compiled.
    return aligned(threads, size)[:, :size] if config.DISABLE_JIT else aligned(threads, size)


# -- recipes, see compile.Recipe -------------------------------------------------------------------

NO_PARTS = np.zeros(lanes.PARTS, dtype=np.int64)


def _arguments(model: Model) -> tuple[Any, ...]:
    """Return arguments of :func:`lanes.work` behind the thread's own, with an empty queue."""

    def nothing(*shape: int) -> NDArray[np.float64]:
        return np.zeros(shape)

    return (
        np.zeros(2, dtype=np.int64),
        np.zeros(0, dtype=np.int64),
        nothing(0, model.n_state),
        nothing(0, model.n_constants),
        nothing(0, model.n_probe),
        nothing(0, C.N_PLAN),
        nothing(C.N_OPTIONS),
        np.zeros(C.N_RECORD, dtype=np.bool_),
        nothing(0, C.FIRST_STATE + model.n_state),
        np.zeros((0, C.N_COUNTS), dtype=np.int64),
        nothing(0, 1, 3),
        nothing(1, 8),
    )


def work(model_name: str, adaptive: bool) -> Kernel:
    """Return :func:`lanes.work` for a model: what each thread does."""
    model = find_model(model_name)
    arguments = 0, NO_PARTS, workspace(RK4, model, 1)[0], *_arguments(model)
    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    return Kernel(lanes.work, (problem_of(model, adaptive), *arguments), options)


def attempt(tableau_name: str, model_name: str, beside: str = "") -> Kernel:
    """Return the step of a method and a model; ``beside`` is ``volume`` or nothing."""
    tableau, model = METHODS[tableau_name], find_model(model_name)
    arguments = problem_of(model, tableau.adaptive), workspace(tableau, model, 1)[0], 1.0
    written = write_attempt(tableau, model, volume=beside == "volume")
    return Kernel(written, arguments, OPTIONS)


def decide_closely(adaptive: bool) -> Kernel:
    """Return :func:`lanes.decide_closely`, which is that of all models."""
    arguments = Problem(None, adaptive), np.zeros(0), 0, 1.0, False
    return Kernel(lanes.decide_closely, arguments, INNER)


def drive() -> Kernel:
    """Return what starts the threads of all kernels."""
    arguments = (0, NO_PARTS, 1, workspace(RK4, REDUCED, 1), *_arguments(REDUCED))
    return Kernel(lanes.drive, arguments, {"parallel": True, "nogil": True})


# -- threads ---------------------------------------------------------------------------------------

# Whether this process was forked from one in which GNU OpenMP had started threads: it ends a
# process that starts threads again.
_forked = False


def _after_fork() -> None:
    global _forked
    with suppress(ValueError):  # no threads were started
        _forked = numba.threading_layer() == "omp" or _forked


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def parallel() -> bool:
    """Return whether this process can start threads for its kernels.

    Raises
    ------
    SettingError
        The environment asks for threads that cannot be.
    """
    if _forked or config.DISABLE_JIT:
        return False
    try:
        numba.get_num_threads()
    except ValueError as error:
        # The first line says what is wrong, hints follow.
        said = str(error).splitlines()[0].rstrip(".")
        raise SettingError(
            f"NUMBA_THREADING_LAYER={ascii(config.THREADING_LAYER)[1:-1]}: {said}; "
            "leave it unset, or set it to omp or workqueue"
        ) from error
    return True


# -- kernels ---------------------------------------------------------------------------------------


def kernel(tableau_name: str, model_name: str, *beside: str) -> Callable[..., None]:
    """Return a kernel: called with the number of threads, their workspaces and what they share.

    With ``"volume"`` beside, its steps find the rate of phase volume.
    Where not :func:`parallel`, its threads work one after another.
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

    def alone(threads: int, w: Any, *shared: Any) -> None:
        for thread in range(threads):
            do(problem, thread, addresses, w[thread], *shared)

    return alone
