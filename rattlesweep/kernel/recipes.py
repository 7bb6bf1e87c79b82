"""Recipes of the kernels: what is compiled for a method, a model and a record."""

from collections.abc import Callable, Collection, Mapping
from functools import cache, partial
from typing import Any

import numpy as np
from numba import config
from numpy.typing import NDArray

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import INNER, addresses_of
from rattlesweep.compiling.loading import Compiled, Kernel, Order, load_kernels
from rattlesweep.kernel import answer, runs, tangents, turn
from rattlesweep.kernel.collected import Recording, layout_of
from rattlesweep.kernel.event import looks
from rattlesweep.kernel.event.zeros import HOLD
from rattlesweep.kernel.look import notes
from rattlesweep.kernel.look.extremes import STEPPED
from rattlesweep.kernel.look.marks import MARKS
from rattlesweep.kernel.method.tableau import METHODS, Tableau
from rattlesweep.kernel.mode import modes
from rattlesweep.kernel.runs import Inputs, Outputs
from rattlesweep.kernel.state.fields import LANES
from rattlesweep.kernel.state.lane import Problem
from rattlesweep.kernel.state.statuses import OK
from rattlesweep.kernel.state.traits import Traits, traits_of
from rattlesweep.kernel.step import slots
from rattlesweep.kernel.step.explicit import OPTIONS, write_attempt
from rattlesweep.kernel.step.implicit import write_implicit
from rattlesweep.kernel.tangents import tangents_of
from rattlesweep.kernel.threads import parallel
from rattlesweep.motion.chart import SLOPES
from rattlesweep.motion.model import FULL, Model, compose, find_model
from rattlesweep.physics import frame
from rattlesweep.physics.surface import PARABOLOID

RECORDINGS = Recording._fields
OF_MARKS = {"marks", *(mark.name for mark in MARKS)}  # observations that need marks
NOTED = {"late", "casimir"}  # observations that need notes (`look.notes`)


@cache
def problem_of(
    model: Model | None, width: int = LANES, *, rimmed: bool = False
) -> Problem:
    """Return the problem that the parts of a model are compiled for.

    The loop that calls them has a problem without a model.
    """
    if model is None:
        return Problem(None, layout_of(None), width)
    ways = modes.modes_of(model, rimmed)
    carried = tangents_of(model)
    rack = modes.rack_for(model)
    return Problem(model, layout_of(model), width, ways, carried, rimmed, rack)


def traits_for(tableau: Tableau, model: Model, *, rimmed: bool = False) -> Traits:
    """Return what the loop needs to know of a method and a model."""
    problem = problem_of(model, rimmed=rimmed)
    return traits_of(problem, model, adaptive=tableau.adaptive)


def workspace(tableau: Tableau, model: Model, threads: int) -> Floats:
    """Return workspaces (threads, size): rows of zeros that share no cache line.

    Where lanes slide, the rows of a rack follow those of the lanes.
    """
    problem = problem_of(model)
    rows = problem.layout.rows(tableau, model)
    if problem.rack is not None:
        rows += -(-problem.rack.rows * problem.rack.width // LANES)
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
NO_PARTS = np.zeros(1, dtype=np.int64)
INPUTS = Inputs(TABLE, TABLE, TABLE, TABLE)
SETTINGS = turn.Options(1.0, 1.0, 1.0)
NOTHING: Any = Recording(*(np.zeros((0, 1, 1)) for _ in RECORDINGS))
OUTPUTS = Outputs(np.zeros(0, runs.RESULT), TABLE)
SHARED = WHOLE, WHOLE, INPUTS, SETTINGS, TABLE, OUTPUTS, NOTHING
TRAITS = traits_of(problem_of(FULL), FULL, adaptive=True)
CALLED: dict[str, object] = INNER | {"no_cpython_wrapper": False}


# What is compiled once for all models.


def work_recipe() -> Kernel:
    """Return :func:`turn.work_off`, which each thread runs."""
    return Kernel(
        turn.work_off, (problem_of(None), TRAITS, 0, NO_PARTS, FLAT, *SHARED), INNER
    )


def closer_recipe() -> Kernel:
    """Return :func:`turn.look_closer`."""
    lane = problem_of(None), TRAITS, NO_PARTS, FLAT, 0, 1.0
    recorded = False, NOTHING.reversals, NOTHING.marks
    return Kernel(turn.look_closer, (*lane, *recorded), INNER)


def drive_recipe(way: str) -> Kernel:
    """Return :func:`turn.drive`.

    In the way ``threads`` it starts threads, in the way ``alone`` it starts none.
    """
    options = {"parallel": True, "nogil": True} if way == "threads" else CALLED
    return Kernel(turn.drive, (0, TRAITS, NO_PARTS, 1, TABLE, *SHARED), options)


# What is compiled for each model; ``rim`` is ``rimmed`` or empty.


def attempt_recipe(tableau_name: str, model_name: str, extra: str = "") -> Kernel:
    """Return the step of a method and a model; ``extra`` is ``volume`` or empty."""
    tableau = METHODS[tableau_name]
    model = find_model(model_name)
    problem = problem_of(model)
    if model.stiffness is not None:
        written = write_implicit(problem)
    else:
        written = write_attempt(tableau, problem, volume=extra == "volume")
    return Kernel(written, (problem, FLAT, 1.0, LANES), OPTIONS)


def answer_recipe(model_name: str, rim: str = "") -> Kernel:
    """Return :func:`answer.answer` for a model."""
    model = find_model(model_name)
    problem = problem_of(model, rimmed=bool(rim))
    asked = problem, answer.BEGIN, FLAT, 0, OK, HOLD, False, False
    # Attitude and path are integrated over the steps of a run without them.
    only_rates = model.n_extra > 0
    return Kernel(answer.answer_rates if only_rates else answer.answer, asked, INNER)


def answer_for_all_recipe(model_name: str, rim: str = "") -> Kernel:
    """Return :func:`answer.answer_for_all` for a model."""
    problem = problem_of(find_model(model_name), rimmed=bool(rim))
    return Kernel(answer.answer_for_all, (problem, answer.SCHEDULE, FLAT, 0), INNER)


def slide_recipe(model_name: str, rim: str = "") -> Kernel:
    """Return :func:`slots.slide_lanes` for a model."""
    problem = problem_of(find_model(model_name), rimmed=bool(rim))
    return Kernel(slots.slide_lanes, (problem, FLAT, 1.0, True, 0), INNER)


def look_recipe(model_name: str, word: str) -> Kernel:
    """Return what looks at a word of `record` in the steps of a model."""
    lanes = problem_of(find_model(model_name)), FLAT
    return Kernel(looks.LOOKS_AT[word], (*lanes, STEPPED, False, NOTHING.marks), INNER)


def note_recipe(model_name: str) -> Kernel:
    """Return :func:`notes.note_step` for a model."""
    lane = problem_of(find_model(model_name)), FLAT, 0
    return Kernel(notes.note_step, (*lane, True, True, True, NOTHING.casimir), INNER)


def growth_recipe(model_name: str) -> Kernel:
    """Return :func:`tangents.note_growth` for a model."""
    lane = problem_of(find_model(model_name)), FLAT, 0
    return Kernel(tangents.note_growth, (*lane, 1.0, 0, NOTHING.lyapunov), INNER)


def parts_of(
    tableau: Tableau, model: Model, record: Collection[str], *, rimmed: bool
) -> list[Order | None]:
    """Return the parts of a model by their indices, None for one that is not called."""
    # Steps integrate the rate of phase volume as well if it is recorded.
    extra: tuple[()] | tuple[str] = ()
    if "volume" in record:
        extra = ("volume",)
    rim: tuple[()] | tuple[str] = ()
    if rimmed:
        rim = ("rimmed",)
    traits = traits_for(tableau, model, rimmed=rimmed)
    parts: list[Order | None] = [None] * turn.N_PARTS
    parts[turn.ATTEMPT] = attempt_recipe, tableau.name, model.name, *extra
    parts[turn.CLOSER] = (closer_recipe,)
    parts[turn.ANSWER] = answer_recipe, model.name, *rim
    if traits.limited or traits.has_tangents:
        parts[turn.ANSWER_FOR_ALL] = answer_for_all_recipe, model.name, *rim
    for place, word in enumerate(looks.LOOKS_AT):
        words = OF_MARKS if word == "marks" else {word}
        if not words.isdisjoint(record):
            parts[turn.FIRST_LOOK + place] = look_recipe, model.name, word
    if traits.schedules:
        parts[turn.SLIDE] = slide_recipe, model.name, *rim
    if not NOTED.isdisjoint(record):
        parts[turn.NOTE] = note_recipe, model.name
    if traits.has_tangents:
        parts[turn.GROWTH] = growth_recipe, model.name
    return parts


def addresses(
    called: list[Order | None], loaded: Mapping[Order, Compiled]
) -> NDArray[Any]:
    """Return the addresses of parts, 0 for those that are not called.

    In machine code a problem is no argument.  Where nothing is compiled, each part is
    bound to its own.
    """
    if not config.DISABLE_JIT:
        return addresses_of(*(loaded[order] if order else None for order in called))
    bound: list[object] = []
    for order in called:
        if order is None:
            bound.append(0)
            continue
        recipe, *names = order
        problem = recipe(*names).arguments[0]
        bound.append(partial(loaded[order], problem))
    return np.array(bound, object)


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
    called = parts_of(tableau, model, record, rimmed=rimmed)
    work: Order = (work_recipe,)
    drive: Order = drive_recipe, "threads" if parallel() else "alone"
    # All are loaded together, so that they are compiled in parallel.
    orders = [drive, work, *filter(None, called)]
    loaded = dict(zip(orders, load_kernels(*orders), strict=True))
    parts = addresses(called, loaded)
    (working,) = addresses([work], loaded)
    traits = traits_for(tableau, model, rimmed=rimmed)

    def call(threads: int, shared: tuple[object, ...]) -> None:
        w = workspace(tableau, model, threads)
        loaded[drive](working, traits, parts, threads, w, *shared)

    return call
