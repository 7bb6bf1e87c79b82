"""Kernels of all methods and models, built from the templates."""

from __future__ import annotations

import os
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from numba import config, njit

from rattlesweep.integrate import SettingError
from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.lanes import carry, runs
from rattlesweep.integrate.lanes import columns as C
from rattlesweep.integrate.lanes import kernel as lanes
from rattlesweep.integrate.lanes.atomics import address_of
from rattlesweep.integrate.lanes.cells import INNER
from rattlesweep.integrate.lanes.lane import LANES, Layout, lane_of
from rattlesweep.integrate.lanes.step import OPTIONS, write_attempt
from rattlesweep.integrate.model import MODELS, REDUCED
from rattlesweep.integrate.specialise import specialise
from rattlesweep.integrate.tableau import METHODS, RK4
from rattlesweep.physics.full import FASTMATH

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau

# Templates in the order in which they call each other; between them and those of all lanes stands
# carry.py.
FORMULAS = (runs.energy_at, runs.contact_at, runs.oscillation_at, runs.derive)
TEMPLATES = (
    runs.reach_border,
    runs.see_contact,
    runs.see_zero,
    runs.see_side,
    runs.compare,
    runs.close_window,
    runs.pass_marks,
    runs.settled,
    runs.start,
    runs.idle,
    runs.stay,
    runs.finish,
    lanes.advance,
)
LANE_TEMPLATES = (lanes.decide, lanes.commit, lanes.watch)
OF_MODEL = ("rhs", "spin", "spin_rate", "energy", "contact", "error")


def names(adaptive: bool, model: Model, width: int = LANES) -> dict[str, Any]:
    """What templates see as globals: of :mod:`rattlesweep.integrate.lanes.bound`, and each other.

    Each is compiled when it is first called.
    """
    bindings: dict[str, Any] = {
        "N_STATE": model.n_state,
        "N_CONSTANTS": model.n_constants,
        "N_PROBE": model.n_probe,
        "L": width,
        "ADAPTIVE": adaptive,
        "IDLE": ((1.0,) * model.n_state, (1.0,) * model.n_constants, (0.0,) * model.n_probe),
        "lane_of": lane_of(Layout.of(model), width),
        **{name: getattr(model, name) for name in OF_MODEL},
    }
    suffix = f"_{model.name}_{width}{mark(adaptive)}"
    bind(FORMULAS, bindings, suffix, fastmath=FASTMATH)
    bind(TEMPLATES, bindings, suffix)
    if model.tangent:
        bindings |= vars(model.tangent)
        bind(carry.TANGENTS, bindings, suffix, fastmath=FASTMATH)
        for template in carry.STAND_INS:
            name = template.__name__
            # ``see_tangent`` stands in for nothing.
            bindings["plain_" + name] = bindings.get(name)
        bind(carry.STAND_INS, bindings, "_carry" + suffix)
    bind(LANE_TEMPLATES, bindings, suffix)
    return bindings


def mark(adaptive: bool) -> str:
    """Ends the names of what methods without error control have for themselves."""
    return "" if adaptive else "_fixed"


def bind(
    templates: tuple[Callable[..., Any], ...],
    bindings: dict[str, Any],
    suffix: str,
    fastmath: Any = False,
) -> None:
    """Make compiled functions of templates, and add them to what the next ones see.

    Without ``fastmath`` all but formulas: the time is a compensated sum.
    """
    for template in templates:
        name = template.__name__
        own = specialise(template, name + suffix, **bindings)
        bindings[name] = njit(fastmath=fastmath, **INNER)(own)


def build(adaptive: bool, model: Model) -> Callable[..., None]:
    """:func:`lanes.work` for a model, not yet compiled."""
    name = f"work_{model.name}{mark(adaptive)}"
    work: Callable[..., None] = specialise(lanes.work, name, **names(adaptive, model))
    return work


def aligned(threads: int, size: int) -> NDArray[np.float64]:
    """Zeros of shape (threads, size), each row on its own cache lines."""
    size = -(-size // 16) * 16
    flat = np.zeros(threads * size + 8)
    shift = (-flat.ctypes.data // 8) % 8
    return flat[shift : shift + threads * size].reshape(threads, size)


def workspace(tableau: Tableau, model: Model, threads: int) -> NDArray[np.float64]:
    """Workspace of each thread, shape (threads, rows * lanes)."""
    return aligned(threads, Layout.of(model).rows(tableau, model) * LANES)


def _arguments(model: Model) -> tuple[Any, ...]:
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
        np.zeros(C.N_RECORD, dtype=np.bool_),
        nothing(0, C.FIRST_STATE + model.n_state),
        np.zeros((0, C.N_COUNTS), dtype=np.int64),
        nothing(0, 1, 3),
        nothing(1, 8),
    )


def example(model_name: str, adaptive: bool) -> Kernel:
    """What a thread does for a model, not yet compiled, and arguments to call it with."""
    model = MODELS[model_name]
    parts, w = np.zeros(lanes.PARTS, dtype=np.int64), workspace(RK4, model, 1)[0]
    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    return Kernel(build(adaptive, model), (0, parts, w, *_arguments(model)), options)


def attempt(tableau_name: str, model_name: str) -> Kernel:
    """The step of a method and a model, as :func:`example`."""
    tableau, model = METHODS[tableau_name], MODELS[model_name]
    return Kernel(write_attempt(tableau, model), (workspace(tableau, model, 1)[0], 1.0), OPTIONS)


def settle(adaptive: bool) -> Kernel:
    """:func:`lanes.settle`, as :func:`example`; of all models."""
    bindings, suffix = {"ADAPTIVE": adaptive}, mark(adaptive)
    bind((lanes.give_up,), bindings, suffix)
    function = specialise(lanes.settle, "settle" + suffix, **bindings)
    return Kernel(function, (np.zeros(0), 0, 1.0, False), INNER)


def driver() -> Kernel:
    """What starts the threads of all kernels, as :func:`example`."""
    parts = np.zeros(lanes.PARTS, dtype=np.int64)
    arguments = (0, parts, 1, workspace(RK4, REDUCED, 1), *_arguments(REDUCED))
    return Kernel(lanes.drive, arguments, {"parallel": True, "nogil": True})


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


def parts(*compiled: Any) -> NDArray[np.int64]:
    """Addresses of what is compiled for itself, in the order of :mod:`lanes.kernel`."""
    found = np.zeros(lanes.PARTS, dtype=np.int64)
    found[: len(compiled)] = [address_of(each) for each in compiled]
    return found


def kernel(tableau_name: str, model_name: str) -> Callable[..., None]:
    """Kernel by names: called with the number of threads, their workspaces and what they share.

    Where :func:`parallel` says so, its threads work one after another.
    """
    adaptive = METHODS[tableau_name].adaptive
    wanted: list[tuple[Any, ...]] = [
        (example, model_name, adaptive), (attempt, tableau_name, model_name), (settle, adaptive)
    ]  # fmt: skip
    if parallel():
        work, *others, drive = load_kernels(*wanted, (driver,))
        return partial(drive, address_of(work), parts(*others))
    work, *others = load_kernels(*wanted)
    addresses = parts(*others)

    def alone(threads: int, w: Any, *shared: Any) -> None:
        for thread in range(threads):
            work(thread, addresses, w[thread], *shared)

    return alone
