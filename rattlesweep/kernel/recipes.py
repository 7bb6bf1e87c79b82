"""Recipes of the kernels: what is compiled for a method, a model and a record."""

from collections.abc import Callable, Collection, Mapping
from functools import cache
from typing import Any

import numpy as np
from numba import config
from numpy.typing import NDArray

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import INNER, addresses_of
from rattlesweep.compiling.loading import Compiled, Kernel, Order, load_kernels
from rattlesweep.kernel import runs, turn
from rattlesweep.kernel.event import looks
from rattlesweep.kernel.look.marks import MARKS
from rattlesweep.kernel.method.tableau import METHODS, Tableau
from rattlesweep.kernel.mode import modes
from rattlesweep.kernel.runs import Inputs, Outputs, Recording
from rattlesweep.kernel.state.fields import LANES
from rattlesweep.kernel.state.lane import Problem
from rattlesweep.kernel.step import slots
from rattlesweep.kernel.step.explicit import OPTIONS, write_attempt
from rattlesweep.kernel.step.implicit import write_implicit
from rattlesweep.kernel.step.radau import block_of
from rattlesweep.kernel.tangents import tangents_of
from rattlesweep.kernel.threads import parallel
from rattlesweep.motion.chart import SLOPES
from rattlesweep.motion.model import FULL, Model, compose, find_model
from rattlesweep.physics import frame
from rattlesweep.physics.surface import PARABOLOID

RECORDINGS = Recording._fields
# Observations for which steps are looked into (`kernel.looks_within`).
LOOKED_INTO = {"contact", "reversals", "marks"} | {mark.name for mark in MARKS}


@cache
def problem_of(
    model: Model | None, adaptive: bool, width: int = LANES, *, rimmed: bool = False
) -> Problem:
    """Return the problem that the kernels of a model are compiled for."""
    if model is None:
        return Problem(None, adaptive, width)
    ways = modes.modes_of(model, rimmed)
    carried = tangents_of(model)
    block = block_of(model) if model.slide is not None else None
    return Problem(model, adaptive, width, ways, carried, rimmed, block)


def workspace(tableau: Tableau, model: Model, threads: int) -> Floats:
    """Return workspaces (threads, size): rows of zeros that share no cache line.

    Where lanes slide, the rows of a block follow those of the lanes.
    """
    problem = problem_of(model, tableau.adaptive)
    rows = problem.layout.rows(tableau, model)
    if problem.block is not None:
        rows += -(-problem.block.rows * problem.block.width // LANES)
    size = -(-rows * LANES // 16) * 16
    flat = np.zeros(threads * size + 8)
    shift = (-flat.ctypes.data // 8) % 8
    spaces = flat[shift : shift + threads * size].reshape(threads, size)
    if config.DISABLE_JIT:
        # Lanes reshape the workspace, so its size must be a multiple of LANES.
        return spaces[:, : size // LANES * LANES]
    return spaces


# Arguments whose types a kernel is compiled for: a workspace, tables, addresses, what
# it reads and writes, what threads share.
FLAT = np.zeros(0)
TABLE = np.zeros((0, 1))
WHOLE = np.zeros(0, dtype=np.int64)
NO_PARTS = np.zeros(4, dtype=np.int64)
INPUTS = Inputs(TABLE, TABLE, TABLE, np.zeros(0, runs.PLAN))
SETTINGS = turn.Options(1.0, 1.0, 1.0)
NOTHING = Recording(*(np.zeros((0, 1, 1)) for _ in RECORDINGS))
OUTPUTS = Outputs(np.zeros(0, modes.RESULT), TABLE)
SHARED = WHOLE, WHOLE, INPUTS, SETTINGS, TABLE, OUTPUTS, NOTHING


def work_recipe(model_name: str, adaptive: bool, rim: str = "") -> Kernel:
    """Return :func:`kernel.work_off` for a model, which each thread runs.

    ``rim`` is ``rimmed`` or empty.
    """
    problem = problem_of(find_model(model_name), adaptive, rimmed=bool(rim))
    arguments = problem, 0, NO_PARTS, FLAT, *SHARED
    options = INNER | {"no_cpython_wrapper": False}
    return Kernel(turn.work_off, arguments, options)


def attempt_recipe(tableau_name: str, model_name: str, extra: str = "") -> Kernel:
    """Return the step of a method and a model; ``extra`` is ``volume`` or empty."""
    tableau = METHODS[tableau_name]
    model = find_model(model_name)
    if model.stiffness is not None:
        written = write_implicit(model)
    else:
        written = write_attempt(tableau, model, volume=extra == "volume")
    return Kernel(written, (problem_of(model, tableau.adaptive), FLAT, 1.0), OPTIONS)


def decide_recipe(adaptive: bool) -> Kernel:
    """Return :func:`kernel.decide_closely`, which serves all models."""
    return Kernel(
        turn.decide_closely,
        (problem_of(None, adaptive), FLAT, 0, 1.0, turn.ZEROS),
        INNER,
    )


def slide_recipe(model_name: str, rim: str = "") -> Kernel:
    """Return :func:`slides.slide_lanes` for a model.

    ``rim`` is as for :func:`work_recipe`.
    """
    problem = problem_of(find_model(model_name), True, rimmed=bool(rim))
    return Kernel(slots.slide_lanes, (problem, FLAT, 1.0, True, 0), INNER)


def look_recipe(model_name: str) -> Kernel:
    """Return :func:`looks.look_within` for a model, which serves all methods."""
    problem = problem_of(find_model(model_name), True)
    times = NOTHING.marks
    arguments = problem, FLAT, looks.ROLLED, True, True, times
    return Kernel(looks.look_within, arguments, INNER)


def drive_recipe() -> Kernel:
    """Return :func:`kernel.drive`, which starts the threads of all kernels."""
    options = {"parallel": True, "nogil": True}
    return Kernel(turn.drive, (0, NO_PARTS, 1, TABLE, *SHARED), options)


def parts_of(
    tableau: Tableau, model: Model, record: Collection[str], *, rimmed: bool
) -> list[Order | None]:
    """Return the parts of a kernel by their indices, None for one it does not call."""
    # Steps integrate the rate of phase volume as well if it is recorded.
    extra = ("volume",) if "volume" in record else ()
    rim = ("rimmed",) if rimmed else ()
    parts: list[Order | None] = [
        (attempt_recipe, tableau.name, model.name, *extra),
        (decide_recipe, tableau.adaptive),
        None,
        None,
    ]
    if not LOOKED_INTO.isdisjoint(record):
        parts[turn.LOOK] = look_recipe, model.name
    if model.slide is not None:
        parts[turn.SLIDE] = (slide_recipe, model.name, *rim)
    return parts


def addresses(
    called: list[Order | None], loaded: Mapping[Order, Compiled]
) -> NDArray[Any]:
    """Return the addresses of parts, 0 for those that are not called."""
    return addresses_of(*(loaded[order] if order else None for order in called))


def threaded_kernel(
    tableau_name: str,
    model_name: str,
    record: Collection[str] = (),
    *,
    rimmed: bool = False,
) -> Callable[[int, tuple[object, ...]], None]:
    """Return a kernel, which takes the number of threads and the shared arrays.

    If threads cannot be started (:func:`parallel`), the work of all is done in this
    one.
    """
    tableau = METHODS[tableau_name]
    model = find_model(model_name)
    if not {"lyapunov", "spectrum"}.isdisjoint(record) and model is not FULL:
        raise ValueError(
            f"the tangents of {model_name} are not known; only those of full are, "
            "without dissipation on a paraboloid"
        )
    if "lyapunov" in record:
        model = compose(SLOPES, PARABOLOID, tangents=1)
    if "spectrum" in record:
        model = compose(SLOPES, PARABOLOID, tangents=frame.N_TANGENTS)
    rim = ("rimmed",) if rimmed else ()
    work: Order = (work_recipe, model.name, tableau.adaptive, *rim)
    called = parts_of(tableau, model, record, rimmed=rimmed)
    orders = [work, *filter(None, called)]
    threaded = parallel()
    if threaded:
        orders.append((drive_recipe,))
    # All are loaded together, so that they are compiled in parallel.
    loaded = dict(zip(orders, load_kernels(*orders), strict=True))
    working = loaded[work]
    parts = addresses(called, loaded)
    driving = loaded[orders[-1]]

    def call(threads: int, shared: tuple[object, ...]) -> None:
        w = workspace(tableau, model, threads)
        if threaded:
            driving(addresses_of(working)[0], parts, threads, w, *shared)
            return
        problem = problem_of(model, tableau.adaptive, rimmed=rimmed)
        for thread in range(threads):
            working(problem, thread, parts, w[thread], *shared)

    return call
