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
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from llvmlite import binding
from numba import config, njit

from rattlesweep.integrate import carry, lanes, runs
from rattlesweep.integrate import columns as C
from rattlesweep.integrate.cache import PACKAGE, cached, directory, specialise
from rattlesweep.integrate.cells import INNER
from rattlesweep.integrate.model import MODELS
from rattlesweep.integrate.stages import LANES, Layout, compile_attempt, compile_lane_functions
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.integrate.tangents import compile_tangent_functions

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau

# Templates in the order in which they call each other; carry.py stands between the two.
TEMPLATES = (
    runs.reach_border,
    runs.see_contact,
    runs.compare,
    runs.close_window,
    runs.pass_marks,
    runs.start,
    runs.idle,
    runs.finish,
)
LANE_TEMPLATES = (
    lanes.give_up,
    lanes.decide,
    lanes.commit,
    lanes.watch,
    lanes.work,
)


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
    """Kernel of a method and a model: :func:`lanes.drive`, compiled when it is first called."""
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
            bindings["plain_" + name] = bindings.get(name)
        bind(carry.STAND_INS, "_carry")
    bind(LANE_TEMPLATES)
    driver = specialise(lanes.drive, "drive" + suffix, **bindings)
    compiled: Callable[..., None] = cached(driver, parallel=True, nogil=True)
    return compiled


def aligned(threads: int, size: int) -> NDArray[np.float64]:
    """Zeros of shape (threads, size), each row on its own cache lines."""
    size = -(-size // 16) * 16
    flat = np.zeros(threads * size + 8)
    shift = (-flat.ctypes.data // 8) % 8
    return flat[shift : shift + threads * size].reshape(threads, size)


def workspace(tableau: Tableau, model: Model, threads: int) -> tuple[Any, ...]:
    """Workspace and run numbers of each thread: the arguments after ``threads``."""
    rows = Layout.of(model).rows(tableau, model)
    return (
        aligned(threads, rows * LANES),
        np.full((threads, LANES), -1, dtype=np.int64),
    )


def compile_here(tableau_name: str, model_name: str) -> None:
    """Compile a kernel in this process by calling it with an empty queue."""
    tableau, model = METHODS[tableau_name], MODELS[model_name]

    def nothing(*shape: int) -> NDArray[np.float64]:
        return np.zeros(shape)

    build(tableau, model)(
        1,
        *workspace(tableau, model, 1),
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


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a file lock, where the system has them: one process compiles, the others wait."""
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    with open(path, "w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def compile_in_child(tableau_name: str, model_name: str, module: str = "kernels") -> None:
    """Have the kernel on disk, compiled by ``compile_here`` of a module in a process of its own."""
    place = directory(lanes.__file__)
    name = config.CPU_NAME or binding.get_host_cpu_name()
    cpu = "".join(c for c in name if c.isalnum())
    mark = place / f"{module}-{tableau_name}-{model_name}-{cpu}-{numba.__version__}.compiled"
    if mark.exists():
        return
    with _locked(place / "compile.lock"):
        if mark.exists():
            return
        path = os.pathsep.join(filter(None, [str(PACKAGE.parent), os.environ.get("PYTHONPATH")]))
        environment = os.environ | {
            "NUMBA_CACHE_DIR": str(place.parent),
            "PYTHONHASHSEED": "0",
            "PYTHONPATH": path,
        }
        call = f"import sys; from rattlesweep.integrate.{module} import compile_here; " \
               "compile_here(*sys.argv[1:])"  # fmt: skip
        done = subprocess.run(
            # -P: a package of this name in the working directory is another one.
            [sys.executable, "-P", "-c", call, tableau_name, model_name],
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise RuntimeError(
                f"the kernel {tableau_name}/{model_name} could not be compiled:\n{done.stderr}"
            )
        mark.touch()


@cache
def kernel(tableau_name: str, model_name: str) -> Callable[..., None]:
    """Kernel by names; the first call on a machine takes the time of its compilation."""
    compile_in_child(tableau_name, model_name)
    return build(METHODS[tableau_name], MODELS[model_name])
