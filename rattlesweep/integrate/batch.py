"""Batches of runs: load a kernel, run it in threads, and return the results."""

import os
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Self

import numba
import numpy as np
from numba import config
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats, Integers, Places, put, spread, take
from rattlesweep.integrate import SettingError, processors
from rattlesweep.integrate.compile import Compiled, Kernel, Order, load_kernels
from rattlesweep.integrate.lanes import kernel, looks, modes, runs, slides
from rattlesweep.integrate.lanes.block import block_of
from rattlesweep.integrate.lanes.lane import INNER, LANES, Problem, addresses_of
from rattlesweep.integrate.lanes.marks import MARKS
from rattlesweep.integrate.lanes.runs import SHAPES, Inputs, Outputs, Recording
from rattlesweep.integrate.lanes.step import OPTIONS, SUBSTEPS, write_attempt
from rattlesweep.integrate.lanes.tangents import tangents_of
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DT, MAX_STEPS, METHODS, TOL, Tableau
from rattlesweep.integrate.task import Control
from rattlesweep.motion.anywhere import from_slopes, to_slopes
from rattlesweep.motion.chart import SLOPES
from rattlesweep.motion.model import FULL, Model, compose, find_model
from rattlesweep.physics import frame
from rattlesweep.physics.surface import PARABOLOID

# Largest change of the amplitude's logarithm that a fixed step may cause.
MAX_DAMPING = 0.1
# Statuses of runs that may have left the chart of their variables.
LEFT_CHART = (
    Status.NONFINITE,
    Status.STEP_TOO_SMALL,
    Status.ENERGY,
    Status.LIFTS_OFF,
    Status.JAMMED,
)
# A reversal takes the spin from beyond this share of `Batch.scale` to beyond it on the
# other side. If the spin has plateaus, any share from 0.05 to 0.5 counts the same
# reversals.
PLATEAU_SHARE = 0.25
# Height of a rim that is never reached; products with a power of two keep their digits.
NO_RIM = 2.0**100
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
SETTINGS = kernel.Options(1.0, 1.0, 1.0)
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
    return Kernel(kernel.work_off, arguments, options)


def attempt_recipe(tableau_name: str, model_name: str, extra: str = "") -> Kernel:
    """Return the step of a method and a model; ``extra`` is ``volume`` or empty."""
    tableau = METHODS[tableau_name]
    model = find_model(model_name)
    written = write_attempt(tableau, model, volume=extra == "volume")
    return Kernel(written, (problem_of(model, tableau.adaptive), FLAT, 1.0), OPTIONS)


def decide_recipe(adaptive: bool) -> Kernel:
    """Return :func:`kernel.decide_closely`, which serves all models."""
    return Kernel(
        kernel.decide_closely,
        (problem_of(None, adaptive), FLAT, 0, 1.0, kernel.ZEROS),
        INNER,
    )


def slide_recipe(model_name: str, rim: str = "") -> Kernel:
    """Return :func:`slides.slide_lanes` for a model.

    ``rim`` is as for :func:`work_recipe`.
    """
    problem = problem_of(find_model(model_name), True, rimmed=bool(rim))
    return Kernel(slides.slide_lanes, (problem, FLAT, 1.0, True, 0), INNER)


def look_recipe(model_name: str) -> Kernel:
    """Return :func:`looks.look_within` for a model, which serves all methods."""
    problem = problem_of(find_model(model_name), True)
    times = NOTHING.marks
    arguments = problem, FLAT, looks.ROLLED, True, True, times
    return Kernel(looks.look_within, arguments, INNER)


def drive_recipe() -> Kernel:
    """Return :func:`kernel.drive`, which starts the threads of all kernels."""
    options = {"parallel": True, "nogil": True}
    return Kernel(kernel.drive, (0, NO_PARTS, 1, TABLE, *SHARED), options)


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
        parts[kernel.LOOK] = look_recipe, model.name
    if model.slide is not None:
        parts[kernel.SLIDE] = (slide_recipe, model.name, *rim)
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


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


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
    with _workqueue if numba.threading_layer() == "workqueue" else nullcontext():
        before = numba.get_num_threads()
        numba.set_num_threads(threads)
        try:
            yield
        finally:
            numba.set_num_threads(before)


def available_threads() -> int:
    """Return the default number of threads, one for each processor allowed."""
    return min(processors(), int(config.NUMBA_NUM_THREADS))


@dataclass(frozen=True)
class Batch:
    """Runs to integrate, in units of ``a`` and ``g``; arrays have one row a run."""

    y0: Floats  # initial states
    constants: Floats  # of the bodies
    probe: Floats  # coefficients of the relevant amplitude
    t_end: Floats  # horizon
    swing: Floats  # fastest angular frequency of the spin
    relevant: Floats  # angular frequency of the relevant oscillation, or 0
    rate: Floats  # bound of the spin's rate in the first steps
    window: Floats  # length of the windows whose amplitudes are compared
    # Time of the first comparison of amplitudes; in the first window, the next ones are
    # at twice, four times, ... this time.
    first_comparison: Floats
    # modulus of the spin at launch, or of the spin that would hold all the energy
    scale: Floats
    # launched without spin: zeros count once |n| has exceeded PLATEAU_SHARE of scale
    tapped: Flags
    # Square of the oscillation (as in Model.error) below which it only decays: a run
    # ends if it is below after two windows without growth.  0 means that no run ends
    # so.
    settled: Floats = field(default_factory=lambda: np.zeros(0))
    # Share of the energy at launch below which a zero of the spin, with friction, is no
    # reversal.
    dead: Floats = field(default_factory=lambda: np.zeros(0))
    # Height of the body's rim over its lowest point, NaN without one.
    rim: Floats = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.t_end)


@dataclass(frozen=True)
class Outcome:
    """Results of a :class:`Batch`: arrays over runs, NaN where a run has no value."""

    t_end: Floats  # time reached
    t_r: Floats  # first reversal
    n_end: Floats  # spin at t_end
    energy_drift: Floats  # at t_end, relative to energy_0
    # Largest growth of the relevant amplitude between comparisons, relative.
    amp_growth: Floats
    n_departure: Floats  # largest loss of spin, relative to the launch
    energy_0: Floats  # energy at launch
    status: Integers  # values of Status
    n_steps: Integers
    near_tangencies: Integers
    n_rejected: Integers
    n_turns: Integers  # 0 if reversals are not recorded
    y_end: Floats  # states at t_end, shape (runs, n_state)
    # The next four have no rows if the model does not slide.
    t_slide: Floats  # begin of the first slide
    n_slides: NDArray[np.int32]
    slide_time: Floats  # time spent sliding
    slide_work: Floats  # energy lost by sliding, relative to energy_0
    # The next four have no rows if the model has no pivoting friction.
    t_held: Floats  # begin of the first rest of the spin
    held_time: Floats  # time for which the spin is held
    pivot_work: Floats  # energy lost by pivoting, relative to energy_0
    # 1 where a step ended at a state in which the plane would have to pull the body.
    pulled: Floats
    # The others have no rows if they were not recorded.
    energy_drift_max: Floats
    contact_ratio_max: Floats
    contact_normal_min: Floats
    volume_rate: Floats
    marks: Floats  # times of `lanes.marks`, shape (runs, marks)
    # Amplitude, least and largest spin in each window, shape (runs, 64, 3).
    windows: Floats
    # Time of each reversal and largest modulus of the spin until the next, shape (runs,
    # 8, 2).
    reversals: Floats
    # Time and logarithm of the tangent's growth at the ends of the windows and of the
    # run, shape (runs, 64, 2).  If a step ends several windows, only the row of the
    # first is filled.  For the spectrum there are N_GROWTHS logarithms, and
    # N_COMPARISONS further rows within the first window.
    growth: Floats
    stopped: bool  # whether the kernel was stopped before all runs had ended

    def mark(self, name: str) -> Floats:
        """Return the times of a mark of `lanes.marks`, NaN where there is none."""
        (place,) = [k for k, mark in enumerate(MARKS) if mark.name == name]
        times: Floats = self.marks[:, place]
        return times


def has_settled(batch: Batch, outcome: Outcome) -> Flags:
    """Return which runs ended before their horizon because they had settled."""
    ended = (outcome.t_end < batch.t_end) & np.isnan(outcome.t_r)
    # Where no run could settle, one that ended early was dead at a zero of its spin.
    settled: Flags = ended & (outcome.status == Status.OK) & (len(batch.settled) > 0)
    return settled


@dataclass(frozen=True)
class Settings:
    """How a batch is integrated; see :func:`integrate`."""

    tol: float = TOL
    dt: float = DT
    max_steps: int = MAX_STEPS
    record: frozenset[str] = frozenset()
    threads: int | None = None


def integrate(
    batch: Batch,
    tableau: Tableau,
    model: Model,
    *,
    tol: float = TOL,
    dt: float = DT,
    max_steps: int = MAX_STEPS,
    longest_step: Floats | None = None,
    record: frozenset[str] = frozenset(),
    cost: Integers | None = None,
    threads: int | None = None,
    control: Control | None = None,
) -> Outcome:
    """Integrate every run to its first reversal, its horizon, or until it has settled.

    If reversals are recorded, runs continue after a reversal.  A run whose contact
    passes the rim of its body ends there.  The slopes of an
    ellipsoid that rolls onto its side diverge; such a run is integrated again with
    :attr:`Model.anywhere`.  The bits of a run depend neither on the number of threads
    nor on the other runs.

    Parameters
    ----------
    tol, dt : float
        Largest error of a step of adaptive methods, in the energy norm, relative to the
        oscillation; step of the other methods, in ``sqrt(a/g)``.
    longest_step : ndarray, shape (runs,), optional
        Largest step of each run with an adaptive method; by default, only the error
        limits steps.
    max_steps : int
        Number of steps after which a run ends with `Status.STEP_LIMIT`.
    record : frozenset of str
        Further observations: names of :data:`RECORDINGS` and of marks, and
        ``spectrum``.
    cost : ndarray, shape (runs,), optional
        Expected cost of the runs in any unit, by default from their horizons.  The most
        expensive runs start first.
    threads : int, optional
        Number of threads, by default :func:`available_threads`.
    control : Control, optional
        Watches and stops the kernel from another thread.

    Raises
    ------
    SettingError
        If Numba cannot load the threading layer that the environment names.
    """
    control = control or Control()
    settings = Settings(tol, dt, max_steps, record, threads)
    if "spectrum" in record and longest_step is None:
        longest_step = longest_frame_steps(batch, tableau, tol)
    longest = np.full(len(batch), np.inf) if longest_step is None else longest_step
    price = batch.t_end * batch.swing if cost is None else cost.astype(float)

    groups = by_own_model(batch, model)
    shares = [len(rows) / max(1, len(batch)) for rows, _ in groups]
    outcomes = []
    for (rows, own), _ in zip(groups, control.divided(shares), strict=True):
        part = with_model(take(batch, rows), model, own)
        outcome = _run(
            part, tableau, own, settings, longest[rows], price[rows], control
        )
        outcome = _repeated(
            part, tableau, own, settings, outcome, longest[rows], control
        )
        outcomes.append(_completed(outcome, own, model))
    if len(groups) == 1:
        return outcomes[0]

    is_first = np.zeros(len(batch), bool)
    is_first[groups[0][0]] = True
    whole = spread(outcomes[0], is_first)
    for (rows, _), outcome in zip(groups[1:], outcomes[1:], strict=True):
        put(outcome, whole, rows)
    return replace(whole, stopped=any(outcome.stopped for outcome in outcomes))


def by_own_model(batch: Batch, model: Model) -> list[tuple[Places, Model]]:
    """Return the runs of each model, which lacks the constants that are zero for them.

    A run has the bits of its own model, whichever others are beside it.
    """
    names = np.array(model.vanishing)
    if not names.size or not len(batch):
        return [(np.arange(len(batch)), model)]
    named = model.named(batch.constants.T)
    is_zero = np.array([named[name] == 0 for name in names])
    kinds, kind_of = np.unique(is_zero, axis=1, return_inverse=True)
    groups = []
    for k, zero in enumerate(kinds.T):
        own = model.without(names[zero]) if zero.any() else model
        groups.append((np.flatnonzero(kind_of.ravel() == k), own))
    return groups


def with_model(batch: Batch, model: Model, own: Model) -> Batch:
    """Return a batch of a model with the numbers that a simpler one needs."""
    if own is model:
        return batch
    named = model.named(batch.constants.T)
    constants = np.stack([named[name] for name in own.of_runs], axis=1)
    components = [model.column(name) for name in own.components]
    return replace(batch, y0=batch.y0[:, components], constants=constants)


def _run(
    batch: Batch,
    tableau: Tableau,
    model: Model,
    settings: Settings,
    longest_step: Floats,
    price: Floats,
    control: Control,
) -> Outcome:
    """Integrate runs by the equations of one model."""
    count = 1
    if parallel():
        count = min(settings.threads or available_threads(), config.NUMBA_NUM_THREADS)
    control.start(count, price)
    outputs = outputs_of(len(batch), model)
    recording = recording_of(len(batch), settings.record)
    if len(batch):
        order = np.argsort(-price, kind="stable")
        inputs = inputs_of(
            batch,
            tableau,
            settings.tol,
            settings.dt,
            cost=price,
            longest_step=longest_step,
        )
        options = options_of(tableau, settings.tol, settings.dt, settings.max_steps)
        rimmed = can_reach_rim(batch, model)
        call = threaded_kernel(tableau.name, model.name, settings.record, rimmed=rimmed)
        with holding(count):
            written = control.progress, outputs, recording
            call(count, (control.shared, order, inputs, options, *written))
    return _outcome(batch, model, tableau, settings.dt, outputs, recording)


def _repeated(
    batch: Batch,
    tableau: Tableau,
    model: Model,
    settings: Settings,
    outcome: Outcome,
    longest_step: Floats,
    control: Control,
) -> Outcome:
    """Repeat the runs of an outcome that have left the chart of their variables.

    The repetition begins at the launch, so that a run depends on its own numbers alone.
    """
    rows = np.flatnonzero(np.isin(outcome.status, LEFT_CHART))
    there = model.anywhere
    if there is None or not rows.size:
        return outcome
    control.repeat()
    part = anywhere(take(batch, rows), model)
    price = part.t_end * part.swing
    again = _run(part, tableau, there, settings, longest_step[rows], price, control)
    again = replace(again, y_end=to_slopes(model, again.y_end))
    put(again, outcome, rows)
    return replace(outcome, stopped=outcome.stopped or again.stopped)


def can_reach_rim(batch: Batch, model: Model) -> bool:
    """Return whether a body has a rim that its contact can pass in a model.

    At an infinite slope the contact is on the equator of the ellipsoid, so a rim there
    or above is only reached with :attr:`Model.anywhere`.
    """
    has_rim = np.isfinite(batch.rim)
    if has_rim.any() and model.anywhere is not None:
        inverse_semi_axis = model.named(batch.constants.T)["k"]
        has_rim &= batch.rim * inverse_semi_axis < 1 - 1e-12
    return bool(has_rim.any())


def _completed(outcome: Outcome, own: Model, model: Model) -> Outcome:
    """Return the outcome of a simpler model with what another one adds to it."""
    if own is model:
        return outcome
    count = len(outcome.y_end)
    y_end = np.zeros((count, model.n_state))
    y_end[:, [model.column(name) for name in own.components]] = outcome.y_end
    outcome = replace(outcome, y_end=y_end)
    if model.pivot is None or own.pivot is not None:
        return outcome
    none = np.zeros(count)
    return replace(
        outcome,
        t_held=np.full(count, np.nan),
        held_time=none,
        pivot_work=none.copy(),
        pulled=none.copy(),
    )


def longest_frame_steps(batch: Batch, tableau: Tableau, tol: float) -> Floats:
    """Return the longest steps that damp no tangent by more than the tolerance.

    Fixed steps have no limit.

    The error controls only the motion, whose steps grow long for the faster mode where
    this has decayed; tangents along that mode would then be damped by the method.
    """
    if not tableau.adaptive:
        return np.full(len(batch), np.inf)
    angles = np.linspace(0.05, 2.0, 40)
    too_long = np.flatnonzero(np.abs(tableau.damping(angles)) > tol)
    angle = angles[-1]
    if too_long.size:
        angle = angles[max(0, too_long[0] - 1)]
    # The spin oscillates at twice the frequency of the mode.
    steps: Floats = angle / (batch.swing / 2)
    return steps


def anywhere(batch: Batch, model: Model) -> Batch:
    """Return a batch of slopes in the variables of :attr:`Model.anywhere`."""
    y0, constants = from_slopes(model, batch.y0, batch.constants)
    return replace(batch, y0=y0, constants=constants)


def outputs_of(count: int, model: Model) -> Outputs:
    """Return arrays for what a kernel writes of a number of runs, without values."""
    results = np.zeros(count, modes.RESULT)
    for name in modes.RESULT.names or ():
        if modes.RESULT[name].kind == "f":
            results[name] = np.nan
    results["status"] = Status.STOPPED
    return Outputs(results, np.full((count, model.n_state), np.nan))


def recording_of(count: int, record: Collection[str]) -> Recording:
    """Return arrays for a number of runs, empty where something is not recorded."""
    arrays = {}
    for name, shape in SHAPES._asdict().items():
        arrays[name] = np.full((count if name in record else 0, *shape), np.nan)
    if not {mark.name for mark in MARKS}.isdisjoint(record):
        arrays["marks"] = np.full((count, *SHAPES.marks), np.nan)
    if "spectrum" in record:
        shape = count, runs.N_WINDOWS + runs.N_COMPARISONS, 1 + runs.N_GROWTHS
        arrays["lyapunov"] = np.full(shape, np.nan)
    return Recording(**arrays)


def _outcome(
    batch: Batch,
    model: Model,
    tableau: Tableau,
    dt: float,
    outputs: Outputs,
    recording: Recording,
) -> Outcome:
    """Return what a kernel has written as an outcome."""
    known = {name for name, _ in runs.RESULTS}
    known.update(problem_of(model, True).modes.results)
    columns: dict[str, Any] = {}
    for name in modes.RESULT.names or ():
        values = outputs.results[name]
        columns[name] = values.copy() if name in known else values[:0]
    if not tableau.adaptive:
        coarse = is_coarse(tableau, dt, batch.relevant, columns["t_end"])
        coarse &= columns["status"] == Status.OK
        columns["status"][coarse] = Status.COARSE
        columns["t_r"][coarse] = np.nan
    columns["n_steps"] *= stride(tableau)
    # Without spin at launch these two have no reference.
    columns["amp_growth"][batch.tapped] = np.nan
    columns["n_departure"][batch.tapped] = np.nan
    return Outcome(
        **columns,
        y_end=outputs.y_end,
        energy_drift_max=recording.energy[:, 0, 0],
        contact_ratio_max=recording.contact[:, 0, 0],
        contact_normal_min=recording.contact[:, 0, 1],
        volume_rate=recording.volume[:, 0, 0],
        marks=recording.marks[:, 0],
        windows=recording.windows,
        reversals=recording.reversals,
        growth=_without_comparisons(recording.lyapunov, columns["t_end"]),
        stopped=bool((columns["status"] == Status.STOPPED).any()),
    )


def is_coarse(
    tableau: Tableau, dt: float, relevant: Floats, t_end: Floats | float
) -> Flags:
    """Return which runs damp or feed their oscillation too much with a fixed step.

    The energy need not drift visibly in such a run.
    """
    damping = tableau.damping(dt * relevant) * (t_end / dt)
    return np.asarray(~(np.abs(damping) <= MAX_DAMPING))


def stride(tableau: Tableau) -> int:
    """Return the number of steps between two decisions on a run."""
    return 1 if tableau.adaptive else SUBSTEPS


def inputs_of(
    batch: Batch,
    tableau: Tableau,
    tol: float,
    dt: float,
    *,
    cost: Floats | float = 0.0,
    longest_step: Floats | float = np.inf,
) -> Inputs:
    """Return what a kernel reads of runs."""
    plan = np.zeros(len(batch), runs.PLAN)
    plan["horizon"] = batch.t_end
    plan["swing"] = batch.swing
    plan["window"] = batch.window
    plan["rate"] = batch.rate
    plan["cost"] = cost
    plan["longest_step"] = longest_step
    plan["first_comparison"] = batch.first_comparison
    plan["far"] = PLATEAU_SHARE * batch.scale
    plan["tapped"] = batch.tapped
    if len(batch.settled):
        plan["settled"] = batch.settled
    if len(batch.dead):
        plan["dead"] = batch.dead
    plan["rim"] = NO_RIM
    if len(batch.rim):
        plan["rim"] = np.nan_to_num(batch.rim, nan=NO_RIM)
    # The depth below which the method cannot tell the sign of an extremum, as a
    # fraction of the swing.
    if tableau.adaptive:
        angle = min(1.0, kernel.FIRST_STEP_ANGLE * tol ** (1 / tableau.order))
        plan["first_step"] = angle / batch.swing
        plan["fuzz"] = 1e3 * tol
    else:
        plan["first_step"] = SUBSTEPS * dt
        plan["fuzz"] = np.maximum(1e-9, (dt * batch.swing) ** tableau.order)
    y0 = np.ascontiguousarray(batch.y0)
    constants = np.ascontiguousarray(batch.constants)
    return Inputs(y0, constants, np.ascontiguousarray(batch.probe), plan)


def options_of(
    tableau: Tableau, tol: float, dt: float, max_steps: int
) -> kernel.Options:
    """Return how a kernel integrates."""
    steps = stride(tableau)
    return kernel.Options(1.0 / tol**2, float(steps * dt), max_steps / steps)


def _without_comparisons(growth: Floats, t_end: Floats) -> Floats:
    """Return growths without those in the first window, but for motions that died out.

    Their last growths are older than the end of the run.
    """
    if growth.shape[1] > runs.N_WINDOWS:
        ends = np.nan_to_num(growth[:, : runs.N_WINDOWS, 0]).max(axis=1)
        growth[ends >= t_end, runs.N_WINDOWS :] = np.nan
    return growth


@dataclass(frozen=True)
class _Grown:
    """Logarithms of the growth of tangents over time, interpolated."""

    t: Floats  # shape (runs, rows), increasing from 0, then NaN
    log: Floats  # shape (runs, rows, tangents)
    last: Integers  # the last row of each run that is known

    @classmethod
    def of(cls, growth: Floats) -> Self:
        """Return the growth in the rows of :attr:`Outcome.growth`."""
        # A step that ends several windows fills the row of the first; the empty rows
        # go to the end.
        order = np.argsort(growth[:, :, :1], axis=1, kind="stable")
        rows = np.take_along_axis(growth, order, axis=1)
        # At the launch, time and growth are zero.
        launch = np.zeros((len(growth), 1, growth.shape[2]))
        rows = np.concatenate([launch, rows], axis=1)
        t = rows[:, :, 0]
        return cls(t, rows[:, :, 1:], np.isfinite(t).sum(axis=1) - 1)

    @property
    def end(self) -> Floats:
        """Time up to which the growth is known."""
        ends: Floats = self.t[np.arange(len(self.t)), self.last]
        return ends

    def whole(self) -> Floats:
        """Return the growth up to the end."""
        grown: Floats = self.log[np.arange(len(self.t)), self.last]
        return grown

    def until(self, time: Floats) -> Floats:
        """Return the growth up to a time, NaN where that is before the second row."""
        run = np.arange(len(self.t))
        before = (self.t <= time[:, None]).sum(axis=1) - 1
        after = np.minimum(before + 1, self.last)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = (time - self.t[run, before]) / (
                self.t[run, after] - self.t[run, before]
            )
            between = self.log[run, after] - self.log[run, before]
            grown = self.log[run, before] + share[:, None] * between
        return np.where((before > 0)[:, None], grown, np.nan)


def exponents(growth: Floats) -> tuple[Floats, Floats]:
    """Return finite-time Lyapunov exponents over each run and over its second half.

    They are slopes of :attr:`Outcome.growth`, shape (runs, tangents), in ``sqrt(g/a)``,
    and NaN where it is not finite. The growth up to half time is interpolated between
    the ends of windows.  The second slopes are also NaN where half time falls within
    the first window.
    """
    grown = _Grown.of(growth)
    half = grown.end / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        whole = grown.whole() / grown.end[:, None]
        late = (grown.whole() - grown.until(half)) / half[:, None]
    whole[~np.isfinite(whole)] = np.nan
    late[~np.isfinite(late)] = np.nan
    return whole, late


def late_growths(growth: Floats) -> tuple[Floats, Floats]:
    """Return the logarithms of growth in the third and in the last quarter of each run.

    They have the shape (runs, tangents), and are NaN where :func:`exponents` of the
    second half are.
    """
    grown = _Grown.of(growth)
    until_half = grown.until(grown.end / 2)
    until_last = grown.until(0.75 * grown.end)
    return until_last - until_half, grown.whole() - until_last
