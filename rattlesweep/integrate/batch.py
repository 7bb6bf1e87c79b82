"""Batches of runs: load a kernel, start its threads, listen to it, stop it."""

from __future__ import annotations

import os
import threading
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from numba import config

from rattlesweep.arrays import put, take
from rattlesweep.integrate import SettingError, processors
from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.lanes import kernel as lanes
from rattlesweep.integrate.lanes import runs as C
from rattlesweep.integrate.lanes.lane import INNER, LANES, Layout, Problem, addresses_of
from rattlesweep.integrate.lanes.step import OPTIONS, SUBSTEPS, write_attempt
from rattlesweep.integrate.model import TANGENT, find_model
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DT, MAX_STEPS, METHODS, TOL
from rattlesweep.integrate.task import Control
from rattlesweep.physics import vectors

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from rattlesweep.arrays import Flags, Floats, Integers
    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau

N_WINDOWS = 64
MAX_DAMPING = 0.1  # largest logarithmic change of the amplitude that a fixed step may cause
# The spin has reversed once it has gone from beyond this share of the launch's spin to beyond it on
# the other side.  Where the spin has plateaus, any share from 0.05 to 0.5 counts the same.
PLATEAU_SHARE = 0.25
# What the kernel of every model can note, and what needs a kernel of its own.
WATCHED = ("energy", "contact", "windows", "reversals", "volume")
RECORDS = (*WATCHED, "lyapunov")


@cache
def problem_of(model: Model | None, adaptive: bool, width: int = LANES) -> Problem:
    """Return what the kernels of a model are compiled for."""
    hooks = "start", "pass_marks", "finish", "advance"
    tangent = "_both" if model and model.rate else ""
    functions = {name: getattr(C, name + tangent) for name in hooks}
    return Problem(model, adaptive, width, **functions)


def workspace(tableau: Tableau, model: Model, threads: int, width: int = LANES) -> Floats:
    """Return the workspace of each thread, a row of zeros on cache lines of its own."""
    size = -(-Layout(model).rows(tableau, model) * width // 16) * 16
    flat = np.zeros(threads * size + 8)
    shift = (-flat.ctypes.data // 8) % 8
    found = flat[shift : shift + threads * size].reshape(threads, size)
    # Whole rows: they are looked at as such where nothing is compiled.
    return found[:, : size // width * width] if config.DISABLE_JIT else found


# Arguments of their types, for recipes: a workspace, addresses of parts, what threads share, empty.
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
    return Kernel(lanes.decide_closely, (problem_of(None, adaptive), FLAT, 0, 1.0, False), INNER)


def drive() -> Kernel:
    """Return what starts the threads of all kernels."""
    options = {"parallel": True, "nogil": True}
    return Kernel(lanes.drive, (0, NO_PARTS, 1, TABLE, SHARED), options)


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
        return partial(start, addresses_of(do)[0], addresses_of(*others))
    do, *others = load_kernels(*wanted)
    problem, addresses = problem_of(find_model(model_name), adaptive), addresses_of(*others)

    def alone(threads: int, w: Floats, shared: tuple[Any, ...]) -> None:
        for thread in range(threads):
            do(problem, thread, addresses, w[thread], *shared)

    return alone


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


def most_threads() -> int:
    """Return the threads that Numba can start at most; ``NUMBA_NUM_THREADS`` sets it."""
    return int(config.NUMBA_NUM_THREADS)


def available_threads() -> int:
    """Return the threads to use by default: one for each processor this process may run on."""
    return min(processors(), most_threads())


@dataclass(frozen=True)
class Batch:
    """Runs to integrate; the first axis of every array is the run, units are ``a`` and ``g``."""

    y0: Floats  # initial states
    constants: Floats
    probe: Floats  # coefficients of the watched amplitude
    t_end: Floats
    # Angular frequencies: the fastest at which the spin swings, and that of the watched
    # oscillation or 0; bound of the spin's rate in the first steps.
    swing: Floats
    relevant: Floats
    rate: Floats
    # Length of the windows in which amplitudes are compared; the first time at which they are, and
    # again after twice, four times as long within the first window.
    window: Floats
    first_mark: Floats
    scale: Floats  # modulus of the launch's spin, or of what stands for it
    tapped: Flags  # launched without spin: zeros count once it has passed PLATEAU_SHARE of scale
    # Oscillation (its square in Model.error) from which on it only decays: where it has come down
    # to this and never grew, a run ends after a window.  0 is never.
    settled: Floats = field(default_factory=lambda: np.zeros(0))
    # Share of the launch's energy, with friction, below which a zero of the spin is no reversal.
    dead: Floats = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.t_end)


@dataclass(frozen=True)
class Outcome:
    """Results of the runs of a :class:`Batch`; arrays over runs, NaN where there is nothing."""

    t_end: Floats
    t_r: Floats
    n_end: Floats
    energy_drift: Floats
    amp_growth: Floats
    n_departure: Floats
    # Meaningful only where they were asked for, as is n_turns.
    energy_0: Floats
    energy_drift_max: Floats
    contact_ratio_max: Floats
    contact_normal_min: Floats
    volume_rate: Floats
    status: Integers  # values of Status
    n_steps: Integers
    near_tangencies: Integers
    n_rejected: Integers
    n_turns: Integers
    y_end: Floats  # the state at t_end
    # Amplitude, least and largest spin in each window, shape (runs, windows, 3) or (0, ...).
    windows: Floats
    # Time and logarithm of the tangent's growth at the end of each window, and of the run; NaN in
    # all windows that one step ended but the first; (runs, windows, 2).
    growth: Floats
    # Time of each of the first reversals, largest modulus of the spin until the next; (runs, 8, 2).
    reversals: Floats
    stopped: bool  # whether a stop request ended the kernel before all runs were done


def has_settled(batch: Batch, outcome: Outcome) -> Flags:
    """Return which runs ended before their horizon, at :attr:`Batch.settled`."""
    ended = (outcome.t_end < batch.t_end) & np.isnan(outcome.t_r)
    # Without this column a run that ended early was dead at a zero of its spin.
    settled: Flags = ended & (outcome.status == Status.OK) & (len(batch.settled) > 0)
    return settled


def needed(model: Model, record: Collection[str]) -> tuple[Model, tuple[str, ...]]:
    """Return the model that records something, and what its steps find beside the state."""
    beside = ("volume",) if "volume" in record else ()
    return TANGENT if "lyapunov" in record else model, beside


def integrate(
    batch: Batch, tableau: Tableau, model: Model, *, tol: float = TOL, dt: float = DT,
    max_steps: int = MAX_STEPS, record: frozenset[str] = frozenset(),
    cost: Integers | None = None, threads: int | None = None, control: Control | None = None,
) -> Outcome:  # fmt: skip
    """Integrate every run to its first reversal, or to its horizon.

    All go to the horizon if reversals are recorded, and none further than where it has settled.  An
    ellipsoid that rolls onto its side, where the slope has no value, is integrated anew as
    :attr:`Model.anywhere`.

    The outcome is bit for bit the same for any number of threads and any composition of the batch.

    Parameters
    ----------
    tol, dt : float
        Largest error of one step, in the energy norm, relative to the oscillation, of adaptive
        methods; step of the others, in ``sqrt(a/g)``.
    record : frozenset of str
        Extra observations, of :data:`RECORDS`.
    cost : ndarray, optional
        What the runs are expected to cost, in any unit; by default their horizons tell.
    control : Control, optional
        To watch and to stop the kernel from another thread.
    """
    control = control or Control()
    count = min(threads or available_threads(), most_threads()) if parallel() else 1
    price = batch.t_end * batch.swing if cost is None else cost.astype(float)
    control.start(count, price)
    moving, beside = needed(model, record)
    result = np.full((len(batch), C.FIRST_STATE + model.n_state), np.nan)
    counts = np.zeros((len(batch), len(C.COUNTS)), dtype=np.int64)
    counts[:, C.STATUS] = Status.STOPPED
    # Columns of the windows, of the reversals, of the tangent.
    seen = 3 if "windows" in record else 0
    turned = seen + (2 if "reversals" in record else 0)
    width = turned + (2 if moving is not model else 0)
    windows = np.full((len(batch) if width else 0, N_WINDOWS, width), np.nan)
    if len(batch):
        # Longest first.
        order = np.argsort(-price, kind="stable")
        flags = np.array([name in record for name in WATCHED])
        call = kernel(tableau.name, moving.name, *beside)
        with holding(count):
            call(count, workspace(tableau, moving, count), (
                control._shared, order, *run_arrays(batch, tableau, tol, dt, max_steps, price),
                flags, result, counts, windows, control._progress,
            ))  # fmt: skip
    if not tableau.adaptive:
        # A coarse step may damp an oscillation without a trace in the energy's drift.
        damping = tableau.damping(dt * batch.relevant) * (result[:, C.T_END] / dt)
        coarse = (counts[:, C.STATUS] == Status.OK) & ~(np.abs(damping) <= MAX_DAMPING)
        counts[coarse, C.STATUS] = Status.COARSE
        result[coarse, C.T_R] = np.nan
    counts[:, C.STEPS] *= stride(tableau)
    # Both compare with the launch's spin.
    result[batch.tapped, C.GROWTH] = result[batch.tapped, C.DEPARTURE] = np.nan
    found: dict[str, Any] = dict(zip(C.RESULT, result.T, strict=False))
    found |= dict(zip(C.COUNTS, counts.T, strict=True))
    outcome = Outcome(
        **found,
        y_end=result[:, C.FIRST_STATE :],
        windows=windows[:, :, :3] if seen else np.zeros((0, N_WINDOWS, 3)),
        growth=windows[:, :, turned:] if width > turned else np.zeros((0, N_WINDOWS, 2)),
        reversals=windows[: len(batch) if turned > seen else 0, : C.MOST_REVERSALS, seen:turned],
        stopped=bool((counts[:, C.STATUS] == Status.STOPPED).any()),
    )
    failed = np.isin(outcome.status, (Status.NONFINITE, Status.STEP_TOO_SMALL, Status.ENERGY))
    if model.anywhere is None or not failed.any():
        return outcome
    # Anew from the launch, so that a run is a function of its own numbers alone.
    rows = np.flatnonzero(failed)
    again = take(batch, rows)
    y0, constants = vectors.from_slopes(again.y0, again.constants)
    control.stay()
    other = integrate(
        replace(again, y0=y0, constants=constants), tableau, model.anywhere, tol=tol, dt=dt,
        max_steps=max_steps, record=record, threads=threads, control=control,
    )  # fmt: skip
    y_end = vectors.to_slopes(other.y_end)[:, : model.n_state]
    put(replace(other, y_end=y_end), outcome, rows)
    return replace(outcome, stopped=outcome.stopped or other.stopped)


def stride(tableau: Tableau) -> int:
    """Return the steps between two looks at a run: several of a method without error control."""
    return 1 if tableau.adaptive else SUBSTEPS


def run_arrays(
    batch: Batch, tableau: Tableau, tol: float, dt: float, max_steps: int,
    cost: Floats | float = 0.0,
) -> tuple[Floats, ...]:  # fmt: skip
    """Return what a kernel reads of runs: states, constants, probes, ``plan`` and ``options``."""
    angle = min(1.0, lanes.FIRST_STEP * tol ** (1 / tableau.order))
    first = angle / batch.swing if tableau.adaptive else SUBSTEPS * dt
    # How far the method leaves an extremum of the spin undecided, as a share of its swing.
    coarse = np.maximum(1e-9, (dt * batch.swing) ** tableau.order)
    fuzz = 1e3 * tol if tableau.adaptive else coarse
    settled, dead = (x if len(x) else 0.0 for x in (batch.settled, batch.dead))
    own = batch.t_end, batch.swing, batch.window, batch.rate, first, cost, fuzz, batch.first_mark
    far = PLATEAU_SHARE * batch.scale
    columns = np.broadcast_arrays(*own, far, batch.tapped, settled, dead)
    plan = np.column_stack(columns).astype(float)
    options = np.array([1.0 / tol**2, stride(tableau) * dt, max_steps / stride(tableau)])
    runs = map(np.ascontiguousarray, (batch.y0, batch.constants, batch.probe))
    return *runs, plan, options


def exponents(growth: Floats) -> tuple[Floats, Floats]:
    """Return finite-time Lyapunov exponents, over all of a run's time and over its second half.

    They come from :attr:`Outcome.growth`, in ``sqrt(g/a)``, NaN where a run left the numbers.  The
    second is also NaN where it ended within its second window.
    """
    row = np.arange(len(growth))
    # A step that ends several windows fills the row of the first; the empty ones go last.
    order = np.argsort(~np.isfinite(growth[:, :, :1]), axis=1, kind="stable")
    growth = np.take_along_axis(growth, order, axis=1)
    t, log = np.concatenate([np.zeros((len(row), 1, 2)), growth], axis=1).transpose(2, 0, 1)
    last = np.isfinite(t).sum(axis=1) - 1
    end, grown = t[row, last], log[row, last]
    half = end / 2
    # NaN compares as false: the last border not behind half time.
    before = (t <= half[:, None]).sum(axis=1) - 1
    after = np.minimum(before + 1, last)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (half - t[row, before]) / (t[row, after] - t[row, before])
        until = log[row, before] + share * (log[row, after] - log[row, before])
        whole, late = grown / end, np.where(before > 0, (grown - until) / half, np.nan)
    whole, late = (np.where(np.isfinite(rate), rate, np.nan) for rate in (whole, late))
    return whole, late


__all__ = ["Batch", "Control", "Outcome", "available_threads", "integrate"]
