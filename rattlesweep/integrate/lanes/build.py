"""Kernels of all methods and models: built from the templates, compiled once, kept on disk.

A kernel is always compiled by a child process that does nothing else, and then loaded.  A process
that compiles runs its functions as they were optimised one by one; a process that loads
runs them as they were optimised together, and the last bits may differ.  This way every process
runs the same code, and a sweep that is resumed after years, or spread over processes, has the
rows of one that was never interrupted.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections import defaultdict
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from numba import config, njit

from rattlesweep.integrate import SettingError
from rattlesweep.integrate.cache import PACKAGE, KernelCache, cached, specialise
from rattlesweep.integrate.compiling import compiling
from rattlesweep.integrate.lanes import carry, runs
from rattlesweep.integrate.lanes import columns as C
from rattlesweep.integrate.lanes import kernel as lanes
from rattlesweep.integrate.lanes.atomics import address_of
from rattlesweep.integrate.lanes.cells import INNER
from rattlesweep.integrate.lanes.step import LANES, Layout, compile_attempt, compile_lane_functions
from rattlesweep.integrate.lanes.tangents import compile_tangent_functions
from rattlesweep.integrate.model import MODELS, REDUCED
from rattlesweep.integrate.tableau import METHODS, RK4

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau

    Example = Callable[..., tuple[Any, tuple[Any, ...]]]

# Templates in the order in which they call each other; carry.py stands between the two.
TEMPLATES = (
    runs.reach_border,
    runs.see_contact,
    runs.compare,
    runs.close_window,
    runs.pass_marks,
    runs.start,
    runs.idle,
    runs.stay,
    runs.finish,
)
LANE_TEMPLATES = (lanes.give_up, lanes.settle, lanes.decide, lanes.commit, lanes.watch)


def names(tableau: Tableau, model: Model) -> dict[str, Any]:
    """What templates see as globals: places of rows, functions of a method and a model."""
    at = Layout.of(model)
    return {
        "N_STATE": model.n_state,
        "N_CONSTANTS": model.n_constants,
        "N_PROBE": model.n_probe,
        "Y": at.y,
        "F": at.f,
        "Y1": at.y1,
        "F1": at.f1,
        "Q": at.constants,
        "PROBE": at.probe,
        "H": at.h,
        "ERROR": at.error,
        "N1": at.n1,
        "RATE1": at.rate1,
        "AMPLITUDE": at.amplitude,
        "ADAPTIVE": tableau.adaptive,
        "attempt": compile_attempt(tableau, model),
        **compile_lane_functions(model),
    }


def build(tableau: Tableau, model: Model) -> Callable[..., None]:
    """Kernel of a method and a model: :func:`lanes.work`, compiled when it is first called."""
    bindings = names(tableau, model) | compile_tangent_functions(model)
    suffix = f"_{tableau.name}_{model.name}"

    def bind(templates: tuple[Callable[..., Any], ...], mark: str = "") -> None:
        for template in templates:
            name = template.__name__
            # No fastmath here: the time is a compensated sum.
            bindings[name] = njit(**INNER)(specialise(template, name + mark + suffix, **bindings))

    bind(TEMPLATES)
    if model.tangent:
        for template in carry.STAND_INS:
            name = template.__name__
            # ``see_tangent`` stands in for nothing.
            bindings["plain_" + name] = bindings.get(name)
        bind(carry.STAND_INS, "_carry")
    bind(LANE_TEMPLATES)
    work = specialise(lanes.work, "work" + suffix, **bindings)
    compiled: Callable[..., None] = cached(
        work, nogil=True, error_model="numpy", no_cfunc_wrapper=True
    )
    return compiled


def aligned(threads: int, size: int) -> NDArray[np.float64]:
    """Zeros of shape (threads, size), each row on its own cache lines."""
    size = -(-size // 16) * 16
    flat = np.zeros(threads * size + 8)
    shift = (-flat.ctypes.data // 8) % 8
    return flat[shift : shift + threads * size].reshape(threads, size)


def workspace(tableau: Tableau, model: Model, threads: int) -> NDArray[np.float64]:
    """Workspace of each thread, shape (threads, rows * lanes)."""
    return aligned(threads, Layout.of(model).rows(tableau, model) * LANES)


def _arguments(tableau: Tableau, model: Model) -> tuple[Any, ...]:
    """Arguments of :func:`lanes.work` behind the thread's own, with an empty queue."""

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
        np.zeros(3, dtype=np.bool_),
        nothing(0, C.FIRST_STATE + model.n_state),
        np.zeros((0, C.N_COUNTS), dtype=np.int64),
        nothing(0, 1, 3),
        nothing(1, 8),
    )


def example(tableau_name: str, model_name: str) -> tuple[Any, tuple[Any, ...]]:
    """Kernel of these names, not yet compiled, and arguments to call it with an empty queue."""
    tableau, model = METHODS[tableau_name], MODELS[model_name]
    w = workspace(tableau, model, 1)[0]
    return build(tableau, model), (0, w, *_arguments(tableau, model))


def driver() -> tuple[Any, tuple[Any, ...]]:
    """What starts the threads of all kernels, as :func:`example`."""
    compiled = cached(lanes.drive, parallel=True, nogil=True)
    return compiled, (0, 1, workspace(RK4, REDUCED, 1), *_arguments(RK4, REDUCED))


def _signature(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(numba.typeof(argument) for argument in arguments)


def hand_over(module: str, function: str, *names: str) -> None:
    """In a child: compile the kernel of an example and write it to standard output."""
    # Whatever else prints must not come in between.
    out = os.dup(1)
    os.dup2(2, 1)
    compiled, arguments = getattr(import_module(module), function)(*names)
    # Not what is on disk.
    compiled._cache = KernelCache(compiled.py_func, None)
    compiled.compile(_signature(arguments))
    with open(out, "wb") as pipe:
        pipe.write(compiled._cache.handed_over())


def compile_in_child(example: Example, *names: str) -> bytes:
    """Sealed code of the kernel of an example, compiled in a process of its own."""
    path = os.pathsep.join(filter(None, [str(PACKAGE.parent), os.environ.get("PYTHONPATH")]))
    call = f"import sys; from {__name__} import hand_over; hand_over(*sys.argv[1:])"
    done = subprocess.run(
        # -P: a package of this name in the working directory is another one.
        [sys.executable, "-P", "-c", call, example.__module__, example.__name__, *names],
        env=os.environ | {"PYTHONHASHSEED": "0", "PYTHONPATH": path},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=False,
    )
    if done.returncode:
        said = done.stderr.decode(errors="replace")
        raise RuntimeError(f"the kernel {'/'.join(names)} could not be compiled:\n{said}")
    return done.stdout


@cache
def _loaded(example: Example, *names: str) -> Any:
    compiled, arguments = example(*names)
    signature, context, store = _signature(arguments), compiled.targetctx, compiled._cache
    context.refresh()
    name = store.name(signature, context)
    if store.get(name) is None:
        with store.locked(name):
            if store.get(name) is None:
                with compiling("/".join(names)):
                    store.put(name, compile_in_child(example, *names))
    compiled.compile(signature)
    return compiled


# Each kernel is compiled once although several threads ask for it.
_loading: defaultdict[tuple[Any, ...], threading.Lock] = defaultdict(threading.Lock)


def loaded(example: Example, *names: str) -> Any:
    """Kernel of an example, loaded; its first call on a machine takes the time of its compilation.

    Parameters
    ----------
    example
        Function at the top of a module that takes the names; gives what :func:`cache.cached`
        made and arguments of the types that it will be called with.
    """
    with _loading[example, *names]:
        return _loaded(example, *names)


# Whether this process was forked from one in which GNU OpenMP had started threads: it ends a
# process that starts threads again.
_forked = False


def _after_fork() -> None:
    global _forked
    _loading.clear()
    with suppress(ValueError):  # no threads were started
        _forked = numba.threading_layer() == "omp" or _forked


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def parallel() -> bool:
    """Whether this process can start threads for its kernels.

    Raises
    ------
    SettingError
        The environment asks for threads that cannot be.
    """
    if _forked:
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


def kernel(tableau_name: str, model_name: str) -> Callable[..., None]:
    """Kernel by names: called with the number of threads, their workspaces and what they share.

    Where :func:`parallel` says so, its threads work one after another.
    """
    work = loaded(example, tableau_name, model_name)
    if parallel():
        return partial(loaded(driver), address_of(work))

    def alone(threads: int, w: Any, *shared: Any) -> None:
        for thread in range(threads):
            work(thread, w[thread], *shared)

    return alone
