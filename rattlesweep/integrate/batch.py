"""Batches of runs: load a kernel, run it in threads, and return the results."""

import os
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numba
import numpy as np
from numba import config

from rattlesweep.arrays import Flags, Floats, Integers, put, take
from rattlesweep.integrate import SettingError, processors
from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.lanes import kernel as lanes
from rattlesweep.integrate.lanes import runs
from rattlesweep.integrate.lanes.lane import INNER, LANES, Layout, Problem, addresses_of
from rattlesweep.integrate.lanes.step import OPTIONS, SUBSTEPS, write_attempt
from rattlesweep.integrate.model import TANGENT, Model, find_model
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DT, MAX_STEPS, METHODS, TOL, Tableau
from rattlesweep.integrate.task import Control
from rattlesweep.physics import vectors

N_WINDOWS = 64
MAX_DAMPING = (
    0.1  # largest change of the amplitude's logarithm that a fixed step may cause
)
# A reversal takes the spin from beyond this share of `Batch.scale` to beyond it on the
# other side. If the spin has plateaus, any share from 0.05 to 0.5 counts the same
# reversals.
PLATEAU_SHARE = 0.25
# Observations that every kernel can record; and all of them, as only a tangent yields
# the last.
WATCHED = ("energy", "contact", "windows", "reversals", "volume")
RECORDS = (*WATCHED, "lyapunov")


@cache
def problem_of(model: Model | None, adaptive: bool, width: int = LANES) -> Problem:
    """Return the problem that the kernels of a model are compiled for."""
    hooks = "start", "pass_marks", "finish", "advance"
    tangent = "_both" if model and model.rate else ""
    functions = {name: getattr(runs, name + tangent) for name in hooks}
    return Problem(model, adaptive, width, **functions)


def workspace(tableau: Tableau, model: Model, threads: int) -> Floats:
    """Return workspaces, shape (threads, size): rows of zeros that share no cache
    line.
    """
    size = -(-Layout(model).rows(tableau, model) * LANES // 16) * 16
    flat = np.zeros(threads * size + 8)
    shift = (-flat.ctypes.data // 8) % 8
    found = flat[shift : shift + threads * size].reshape(threads, size)
    # Without compilation, lanes reshape the workspace, so its size must be a multiple
    # of LANES.
    return found[:, : size // LANES * LANES] if config.DISABLE_JIT else found


# Arguments whose types a kernel is compiled for: a workspace, a table, addresses,
# shared arrays.
FLAT, TABLE, NO_PARTS = (
    np.zeros(0),
    np.zeros((0, 1)),
    np.zeros(lanes.PARTS, dtype=np.int64),
)
WHOLE = np.zeros(0, dtype=np.int64)
RUNS = TABLE, TABLE, TABLE, TABLE, FLAT, np.zeros(1, dtype=np.bool_)
SHARED = WHOLE, WHOLE, *RUNS, TABLE, TABLE.astype(np.int64), np.zeros((0, 1, 1)), TABLE


def work(model_name: str, adaptive: bool) -> Kernel:
    """Return :func:`lanes.work` for a model, which each thread runs."""
    arguments = problem_of(find_model(model_name), adaptive), 0, NO_PARTS, FLAT, *SHARED
    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    return Kernel(lanes.work, arguments, options)


def attempt(tableau_name: str, model_name: str, extra: str = "") -> Kernel:
    """Return the step of a method and a model; ``extra`` is ``volume`` or empty."""
    tableau, model = METHODS[tableau_name], find_model(model_name)
    written = write_attempt(tableau, model, volume=extra == "volume")
    return Kernel(written, (problem_of(model, tableau.adaptive), FLAT, 1.0), OPTIONS)


def decide_closely(adaptive: bool) -> Kernel:
    """Return :func:`lanes.decide_closely`, which serves all models."""
    return Kernel(
        lanes.decide_closely,
        (problem_of(None, adaptive), FLAT, 0, 1.0, lanes.SPIN),
        INNER,
    )


def drive() -> Kernel:
    """Return :func:`lanes.drive`, which starts the threads of all kernels."""
    options = {"parallel": True, "nogil": True}
    return Kernel(lanes.drive, (0, NO_PARTS, 1, TABLE, SHARED), options)


def kernel(
    tableau_name: str, model_name: str, record: Collection[str] = ()
) -> Callable[[int, tuple[Any, ...]], None]:
    """Return a kernel for a record, which takes the number of threads and the shared
    arrays.

    If threads cannot be started (:func:`parallel`), the work of all is done in this
    one.
    """
    tableau, model = METHODS[tableau_name], find_model(model_name)
    model = TANGENT if "lyapunov" in record else model
    # Steps integrate the rate of phase volume as well if it is recorded.
    extra = ("volume",) if "volume" in record else ()
    wanted: list[tuple[Any, ...]] = [
        (work, model.name, tableau.adaptive),
        (attempt, tableau_name, model.name, *extra),
        (decide_closely, tableau.adaptive),
        *([(drive,)] if parallel() else []),
    ]
    do, one, closely, *drivers = load_kernels(*wanted)
    address, parts = addresses_of(do)[0], addresses_of(one, closely)

    def call(threads: int, shared: tuple[Any, ...]) -> None:
        w = workspace(tableau, model, threads)
        for start in drivers:
            start(address, parts, threads, w, shared)
        for thread in range(0 if drivers else threads):
            do(problem_of(model, tableau.adaptive), thread, parts, w[thread], *shared)

    return call


# Whether GNU OpenMP had started threads when this process was forked; it cannot start
# any here.
_forked = False
# Numba's layer "workqueue" ends a process in which two threads start a kernel at once.
_workqueue = threading.Lock()


def _after_fork() -> None:
    global _forked, _workqueue
    _workqueue = (
        threading.Lock()
    )  # the thread that held the old one does not exist here
    with suppress(ValueError):  # no threads were started
        _forked = numba.threading_layer() == "omp" or _forked


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def parallel() -> bool:
    """Return whether this process can start threads; SettingError if no layer can be
    loaded.
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
    """Return the default number of threads: one for each processor this process may run
    on.
    """
    return min(processors(), int(config.NUMBA_NUM_THREADS))


@dataclass(frozen=True)
class Batch:
    """Runs to integrate, in units of ``a`` and ``g``; the first axis of every array is
    the run.
    """

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
    first_mark: Floats
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
    amp_growth: (
        Floats  # largest growth of the relevant amplitude between comparisons, relative
    )
    n_departure: Floats  # largest loss of spin, relative to the launch
    energy_0: Floats  # energy at launch
    # These and n_turns are meaningful only if they were recorded.
    energy_drift_max: Floats
    contact_ratio_max: Floats
    contact_normal_min: Floats
    volume_rate: Floats
    status: Integers  # values of Status
    n_steps: Integers
    near_tangencies: Integers
    n_rejected: Integers
    n_turns: Integers
    y_end: Floats  # states at t_end, shape (runs, n_state)
    # These three have no rows if they were not recorded.
    windows: (
        Floats  # amplitude, least and largest spin in each window, shape (runs, 64, 3)
    )
    # Time and logarithm of the tangent's growth at the ends of the windows and of the
    # run, shape (runs, 64, 2).  If a step ends several windows, only the row of the
    # first is filled.
    growth: Floats
    # Time of each reversal and largest modulus of the spin until the next, shape (runs,
    # 8, 2).
    reversals: Floats
    stopped: bool  # whether the kernel was stopped before all runs had ended


def has_settled(batch: Batch, outcome: Outcome) -> Flags:
    """Return which runs ended before their horizon because they had settled."""
    ended = (outcome.t_end < batch.t_end) & np.isnan(outcome.t_r)
    # Where no run could settle, one that ended early was dead at a zero of its spin.
    settled: Flags = ended & (outcome.status == Status.OK) & (len(batch.settled) > 0)
    return settled


def integrate(
    batch: Batch,
    tableau: Tableau,
    model: Model,
    *,
    tol: float = TOL,
    dt: float = DT,
    max_steps: int = MAX_STEPS,
    record: frozenset[str] = frozenset(),
    cost: Integers | None = None,
    threads: int | None = None,
    control: Control | None = None,
) -> Outcome:
    """Integrate every run to its first reversal, its horizon, or the time when it has
    settled.

    If reversals are recorded, runs continue after a reversal.  The slopes of an
    ellipsoid that rolls onto its side diverge; such a run is integrated again with
    :attr:`Model.anywhere`.  The bits of a run depend neither on the number of threads
    nor on the other runs.

    Parameters
    ----------
    tol, dt : float
        Largest error of a step of adaptive methods, in the energy norm, relative to the
        oscillation; step of the other methods, in ``sqrt(a/g)``.
    max_steps : int
        Number of steps after which a run ends with `Status.STEP_LIMIT`.
    record : frozenset of str
        Further observations, from :data:`RECORDS`.
    cost : ndarray, shape (runs,), optional
        Expected cost of the runs in any unit, by default from their horizons.  The most expensive
        runs start first.
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
    count = (
        min(threads or available_threads(), config.NUMBA_NUM_THREADS)
        if parallel()
        else 1
    )
    price = batch.t_end * batch.swing if cost is None else cost.astype(float)
    control.start(count, price)
    result = np.full((len(batch), runs.FIRST_STATE + model.n_state), np.nan)
    counts = np.zeros((len(batch), len(runs.COUNTS)), dtype=np.int64)
    counts[:, runs.STATUS] = Status.STOPPED
    # The columns of ``windows`` belong to windows, then to reversals, then to the
    # tangent.
    seen = 3 if "windows" in record else 0
    turned = seen + (2 if "reversals" in record else 0)
    width = turned + (2 if "lyapunov" in record else 0)
    windows = np.full((len(batch) if width else 0, N_WINDOWS, width), np.nan)
    if len(batch):
        order = np.argsort(-price, kind="stable")
        flags = np.array([name in record for name in WATCHED])
        call = kernel(tableau.name, model.name, record)
        with holding(count):
            call(
                count,
                (
                    control.shared,
                    order,
                    *run_arrays(batch, tableau, tol, dt, max_steps, price),
                    flags,
                    result,
                    counts,
                    windows,
                    control.progress,
                ),
            )
    if not tableau.adaptive:
        coarse = is_coarse(tableau, dt, batch.relevant, result[:, runs.T_END])
        coarse &= counts[:, runs.STATUS] == Status.OK
        counts[coarse, runs.STATUS] = Status.COARSE
        result[coarse, runs.T_R] = np.nan
    counts[:, runs.STEPS] *= stride(tableau)
    # Without spin at launch these two have no reference.
    result[batch.tapped, runs.GROWTH] = result[batch.tapped, runs.DEPARTURE] = np.nan
    found: dict[str, Any] = dict(zip(runs.RESULT, result.T, strict=False))
    found |= dict(zip(runs.COUNTS, counts.T, strict=True))
    outcome = Outcome(
        **found,
        y_end=result[:, runs.FIRST_STATE :],
        windows=windows[:, :, :3] if seen else np.zeros((0, N_WINDOWS, 3)),
        growth=windows[:, :, turned:]
        if width > turned
        else np.zeros((0, N_WINDOWS, 2)),
        reversals=windows[
            : len(batch) if turned > seen else 0, : runs.MOST_REVERSALS, seen:turned
        ],
        stopped=bool((counts[:, runs.STATUS] == Status.STOPPED).any()),
    )
    failed = np.isin(
        outcome.status, (Status.NONFINITE, Status.STEP_TOO_SMALL, Status.ENERGY)
    )
    if model.anywhere is None or not failed.any():
        return outcome
    # The repetition begins at the launch, so that a run depends on its own numbers
    # alone.
    rows = np.flatnonzero(failed)
    again = take(batch, rows)
    y0, constants = vectors.from_slopes(again.y0, again.constants)
    control.repeat()
    other = integrate(
        replace(again, y0=y0, constants=constants),
        tableau,
        model.anywhere,
        tol=tol,
        dt=dt,
        max_steps=max_steps,
        record=record,
        threads=threads,
        control=control,
    )
    y_end = vectors.to_slopes(other.y_end)[:, : model.n_state]
    put(replace(other, y_end=y_end), outcome, rows)
    return replace(outcome, stopped=outcome.stopped or other.stopped)


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


def run_arrays(
    batch: Batch,
    tableau: Tableau,
    tol: float,
    dt: float,
    max_steps: int,
    cost: Floats | float = 0.0,
) -> tuple[Floats, ...]:
    """Return the arrays that a kernel reads (see `lanes.runs`), from ``y0`` to
    ``options``.
    """
    angle = min(1.0, lanes.FIRST_ANGLE * tol ** (1 / tableau.order))
    first = angle / batch.swing if tableau.adaptive else SUBSTEPS * dt
    # Depth below which the method cannot tell the sign of an extremum, as a share of
    # the swing.
    coarse = np.maximum(1e-9, (dt * batch.swing) ** tableau.order)
    fuzz = 1e3 * tol if tableau.adaptive else coarse
    settled, dead = (x if len(x) else 0.0 for x in (batch.settled, batch.dead))
    far = PLATEAU_SHARE * batch.scale
    columns = np.broadcast_arrays(
        batch.t_end,
        batch.swing,
        batch.window,
        batch.rate,
        first,
        cost,
        fuzz,
        batch.first_mark,
        far,
        batch.tapped,
        settled,
        dead,
    )
    plan = np.column_stack(columns).astype(float)
    options = np.array(
        [1.0 / tol**2, stride(tableau) * dt, max_steps / stride(tableau)]
    )
    own = map(np.ascontiguousarray, (batch.y0, batch.constants, batch.probe))
    return *own, plan, options


def exponents(growth: Floats) -> tuple[Floats, Floats]:
    """Return finite-time Lyapunov exponents over each run and over its second half,
    (runs,).

    They are slopes of :attr:`Outcome.growth`, in ``sqrt(g/a)``, and NaN where it is not
    finite. The second is also NaN where half time falls within the first window.
    """
    row = np.arange(len(growth))
    # A step that ends several windows fills the row of the first; move the empty rows
    # to the end.
    order = np.argsort(~np.isfinite(growth[:, :, :1]), axis=1, kind="stable")
    growth = np.take_along_axis(growth, order, axis=1)
    t, log = np.concatenate([np.zeros((len(row), 1, 2)), growth], axis=1).transpose(
        2, 0, 1
    )
    last = np.isfinite(t).sum(axis=1) - 1
    end, grown = t[row, last], log[row, last]
    half = end / 2
    # The last end of a window before half time; comparisons with NaN are false.
    before = (t <= half[:, None]).sum(axis=1) - 1
    after = np.minimum(before + 1, last)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (half - t[row, before]) / (t[row, after] - t[row, before])
        until = log[row, before] + share * (log[row, after] - log[row, before])
        whole, late = grown / end, np.where(before > 0, (grown - until) / half, np.nan)
    whole, late = (np.where(np.isfinite(rate), rate, np.nan) for rate in (whole, late))
    return whole, late
