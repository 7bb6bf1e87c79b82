"""Batches of runs: start a kernel, listen to it, stop it."""

from __future__ import annotations

import os
import threading
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import config, get_num_threads, set_num_threads, threading_layer

from rattlesweep.arrays import put, take
from rattlesweep.integrate.defaults import DT, MAX_STEPS, TOL
from rattlesweep.integrate.lanes import columns as C
from rattlesweep.integrate.lanes.build import kernel, parallel, workspace
from rattlesweep.integrate.lanes.controller import FIRST_STEP
from rattlesweep.integrate.lanes.step import SUBSTEPS
from rattlesweep.integrate.model import WITH_TANGENT
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.task import Control
from rattlesweep.physics import vectors

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from numpy.typing import NDArray

    from rattlesweep.arrays import Floats
    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau

N_WINDOWS = 64
# Largest change of the oscillation's amplitude, as a logarithm, that a fixed step may cause.
MAX_DAMPING = 0.1
# The spin has reversed once it has gone from beyond this share of the launch's spin to beyond it on
# the other side.  Where the spin has plateaus, any share from 0.05 to 0.5 counts the same (GH at
# n_i = 0.1 and -0.1, with theta = 0.64, 0.75 and 0.9); a spin that wanders has no sure count.
PLATEAU_SHARE = 0.25
# What the kernel of every model can note, and what needs a kernel of its own.
WATCHED = ("energy", "contact", "windows", "reversals", "volume")
RECORDS = (*WATCHED, "lyapunov")


@dataclass(frozen=True)
class Batch:
    """Runs to integrate; the first axis of every array is the run.

    Attributes
    ----------
    y0, constants, probe : ndarray, shapes (runs, n_state), (runs, n_constants), (runs, n_probe)
        Initial states, constants of the bodies, coefficients of the watched amplitude.
    t_end : ndarray
        Horizons, in ``sqrt(a/g)``.
    swing : ndarray
        Fastest angular frequency at which the spin swings, in ``sqrt(g/a)``.
    relevant : ndarray
        Angular frequency of the watched oscillation, in ``sqrt(g/a)``; 0 where there is none.
    rate : ndarray
        Bound of the spin's rate in the first steps, in ``g/a``.
    window : ndarray
        Length of the windows in which amplitudes are compared, in ``sqrt(a/g)``.
    first_mark : ndarray
        First time at which they are compared, and again after twice, four times as long, until the
        first window ends; not earlier than the oscillation shows its size.
    scale : ndarray
        Modulus of the launch's spin, or of what stands for it where there is none.
    tapped : ndarray of bool
        Launched without spin: zeros of it count once it has passed :data:`PLATEAU_SHARE` of scale.
    settled : ndarray, optional
        Oscillation (its square in :attr:`Model.error`) from which on it only decays: where it has
        come down to this, and its amplitude never grew, a run ends after a window.  0 is never;
        empty, too, for all runs.
    dead : ndarray, optional
        Share of the launch's energy, of runs with friction, below which a zero of the spin is no
        reversal.  0 or empty: all zeros are.
    """

    y0: Floats
    constants: Floats
    probe: Floats
    t_end: Floats
    swing: Floats
    relevant: Floats
    rate: Floats
    window: Floats
    first_mark: Floats
    scale: Floats
    tapped: NDArray[np.bool_]
    settled: Floats = field(default_factory=lambda: np.zeros(0))
    dead: Floats = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.t_end)


@dataclass(frozen=True)
class Outcome:
    """Results of the runs of a :class:`Batch`; arrays over runs, NaN where there is nothing.

    Attributes
    ----------
    t_end, t_r, n_end, energy_drift, amp_growth, n_departure : ndarray
        The columns of the same names in the tables.
    status, n_steps, near_tangencies, n_rejected : ndarray of int64
        ``status`` holds values of :class:`Status`.
    energy_0, energy_drift_max, contact_ratio_max, contact_normal_min, volume_rate : ndarray
        Meaningful only where they were asked for; the last where the status is OK.
    y_end : ndarray, shape (runs, n_state)
        State at ``t_end``.
    windows : ndarray, shape (runs, windows, 3) or (0, ...)
        Amplitude, least and largest spin in each window; NaN where the run had ended.
    growth : ndarray, shape (runs, windows, 2) or (0, ...)
        Time and logarithm of the tangent's growth at the end of each window, and of the run in the
        row behind its last window; NaN behind that, and in all windows that one step ended but the
        first.
    n_turns : ndarray of int64
        Meaningful only where reversals were asked for.
    reversals : ndarray, shape (runs, 8, 2) or (0, ...)
        Time of each of the first reversals, and the largest modulus of the spin between it and the
        next one; NaN behind the last.
    stopped : bool
        Whether a stop request ended the kernel before all runs were done.
    """

    t_end: Floats
    t_r: Floats
    n_end: Floats
    energy_drift: Floats
    amp_growth: Floats
    n_departure: Floats
    energy_0: Floats
    energy_drift_max: Floats
    contact_ratio_max: Floats
    contact_normal_min: Floats
    volume_rate: Floats
    status: NDArray[np.int64]
    n_steps: NDArray[np.int64]
    near_tangencies: NDArray[np.int64]
    n_rejected: NDArray[np.int64]
    y_end: Floats
    windows: Floats
    growth: Floats
    n_turns: NDArray[np.int64]
    reversals: Floats
    stopped: bool


def available_threads() -> int:
    """Threads to use by default: the processors this process may run on, as Numba counts them."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(allowed or 1, most_threads()))


def most_threads() -> int:
    """Threads that Numba can start at most; ``NUMBA_NUM_THREADS`` sets it."""
    return int(config.NUMBA_NUM_THREADS)


# Numba's own threading layer ends a process in which two threads start a kernel.
_workqueue = threading.Lock()


def _after_fork() -> None:
    # Whoever held it is not in this process.
    global _workqueue
    _workqueue = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


@contextmanager
def _threads(threads: int, control: Control) -> Iterator[bool]:
    """Have threads for a kernel; False if a stop was asked for before they were free."""
    if not parallel():
        yield True
        return
    lock = _workqueue if threading_layer() == "workqueue" else threading.Lock()
    while not lock.acquire(timeout=0.1):
        if control.stopping:
            yield False
            return
    before = get_num_threads()
    set_num_threads(threads)
    try:
        yield True
    finally:
        set_num_threads(before)
        lock.release()


def has_settled(batch: Batch, outcome: Outcome) -> NDArray[np.bool_]:
    """Which runs ended before their horizon, at :attr:`Batch.settled`."""
    ended = (outcome.t_end < batch.t_end) & np.isnan(outcome.t_r)
    # Without this column a run that ended early was dead at a zero of its spin.
    settled: NDArray[np.bool_] = ended & (outcome.status == Status.OK) & (len(batch.settled) > 0)
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
    cost: NDArray[Any] | None = None,
    threads: int | None = None,
    control: Control | None = None,
) -> Outcome:
    """Integrate every run to its first reversal, or to its horizon.

    It is to the horizon if it does not reverse, and for all if reversals are recorded; less far
    once it has settled.  An ellipsoid that rolls onto its side, where the slope has no value, is
    integrated anew as :attr:`Model.anywhere`.

    Parameters
    ----------
    batch : Batch
        The runs.
    tableau, model
        Method and equations.
    tol : float
        Largest error of one step, in the energy norm, relative to the oscillation (adaptive
        methods).
    dt : float
        Step of methods without an error estimate, in ``sqrt(a/g)``.
    max_steps : int
        Steps after which a run is given up with status STEP_LIMIT.
    record : frozenset of str
        Extra observations, of :data:`RECORDS`.
    cost : ndarray, optional
        What the runs are expected to cost, in any unit; by default their horizons tell.
    threads : int, optional
        Threads; by default :func:`available_threads`.
    control : Control, optional
        To watch and to stop the kernel from another thread.

    Returns
    -------
    Outcome
        Bit for bit the same for any number of threads and any composition of the batch.
    """
    settings: dict[str, Any] = {"tol": tol, "dt": dt, "max_steps": max_steps, "record": record}
    settings |= {"threads": threads, "control": control or Control()}
    outcome = _integrate(batch, tableau, model, cost, **settings)
    failed = np.isin(outcome.status, (Status.NONFINITE, Status.STEP_TOO_SMALL, Status.ENERGY))
    if model.anywhere is None or not failed.any():
        return outcome
    # Anew from the launch, so that a run is a function of its own numbers alone.
    rows = np.flatnonzero(failed)
    again = take(batch, rows)
    y0, constants = vectors.from_slopes(again.y0, again.constants)
    again = replace(again, y0=y0, constants=constants)
    settings["control"].stay()
    found = _integrate(again, tableau, model.anywhere, None, **settings)
    y_end = vectors.to_slopes(found.y_end)[:, : model.n_state]
    put(replace(found, y_end=y_end), outcome, rows)
    return replace(outcome, stopped=outcome.stopped or found.stopped)


def _integrate(
    batch: Batch,
    tableau: Tableau,
    model: Model,
    cost: NDArray[Any] | None,
    *,
    tol: float,
    dt: float,
    max_steps: int,
    record: frozenset[str],
    threads: int | None,
    control: Control,
) -> Outcome:
    """Do :func:`integrate` in the variables of one model."""
    runs = len(batch)
    threads = min(threads or available_threads(), most_threads()) if parallel() else 1
    cost = expected_cost(batch) if cost is None else cost.astype(float)
    # Longest first, so that no thread begins a long run when the others are done.
    order = np.argsort(-cost, kind="stable")
    control.total = control._cost = float(cost.sum())
    control._runs = runs
    control._progress = np.zeros((threads, 8))
    carried, beside = needed(model, record)
    result = np.full((runs, C.FIRST_STATE + model.n_state), np.nan)
    counts = np.zeros((runs, C.N_COUNTS), dtype=np.int64)
    counts[:, C.STATUS] = Status.STOPPED
    # Columns of the windows, of the reversals, of the tangent.
    seen = 3 if "windows" in record else 0
    turned = seen + (2 if "reversals" in record else 0)
    width = turned + (2 if carried is not model else 0)
    windows = np.full((runs if width else 0, N_WINDOWS, width), np.nan)
    flags = np.array([name in record for name in WATCHED])

    arguments = (
        threads,
        workspace(tableau, carried, threads),
        control._shared,
        order,
        np.ascontiguousarray(batch.y0),
        np.ascontiguousarray(batch.constants),
        np.ascontiguousarray(batch.probe),
        run_plans(batch, tableau, tol, dt, cost),
        kernel_options(tableau, tol, dt, max_steps),
        flags,
        result,
        counts,
        windows,
        control._progress,
    )
    if runs:
        control._shared[0] = 0
        with _threads(threads, control) as free:
            if free:
                kernel(tableau.name, carried.name, *beside)(*arguments)
    if not tableau.adaptive:
        _mark_coarse(batch, tableau, dt, result, counts)
    counts[:, C.STEPS] *= stride(tableau)
    # Both compare with the launch's spin.
    for column in (C.GROWTH, C.DEPARTURE):
        result[batch.tapped, column] = np.nan
    found: dict[str, Any] = {name: result[:, place] for place, name in enumerate(C.RESULT)}
    found |= {name: counts[:, place] for place, name in enumerate(C.COUNTS)}
    return Outcome(
        **found,
        y_end=result[:, C.FIRST_STATE :],
        windows=windows[:, :, :3] if seen else np.zeros((0, N_WINDOWS, 3)),
        growth=windows[:, :, turned:] if width > turned else np.zeros((0, N_WINDOWS, 2)),
        reversals=windows[: runs if turned > seen else 0, : C.MOST_REVERSALS, seen:turned],
        stopped=bool((counts[:, C.STATUS] == Status.STOPPED).any()),
    )


def needed(model: Model, record: Collection[str]) -> tuple[Model, tuple[str, ...]]:
    """Return the model that records something, and what its steps find beside the state."""
    carried = WITH_TANGENT[model.name] if "lyapunov" in record else model
    return carried, ("volume",) if "volume" in record else ()


def stride(tableau: Tableau) -> int:
    """Steps between two looks at a run: several of a method without error control."""
    return 1 if tableau.adaptive else SUBSTEPS


def run_plans(
    batch: Batch, tableau: Tableau, tol: float, dt: float, cost: Floats | float = 0.0
) -> Floats:
    """Return what a kernel must know of each run, see ``columns.N_PLAN``."""
    plan = np.empty((len(batch), C.N_PLAN))
    plan[:, C.HORIZON] = batch.t_end
    plan[:, C.SWING] = batch.swing
    plan[:, C.WINDOW] = batch.window
    plan[:, C.RATE] = batch.rate
    angle = min(1.0, FIRST_STEP * tol ** (1 / tableau.order))
    plan[:, C.FIRST_STEP] = angle / batch.swing if tableau.adaptive else SUBSTEPS * dt
    plan[:, C.COST] = cost
    # How far the method leaves an extremum of the spin undecided, as a share of its swing.
    plan[:, C.FUZZ] = (
        1e3 * tol if tableau.adaptive else np.maximum(1e-9, (dt * batch.swing) ** tableau.order)
    )
    plan[:, C.FIRST_MARK] = batch.first_mark
    plan[:, C.FAR] = PLATEAU_SHARE * batch.scale
    plan[:, C.TAPPED] = batch.tapped
    plan[:, C.SETTLED] = batch.settled if len(batch.settled) else 0.0
    plan[:, C.DEAD] = batch.dead if len(batch.dead) else 0.0
    return plan


def kernel_options(tableau: Tableau, tol: float, dt: float, max_steps: int) -> Floats:
    """Settings that all runs of a kernel share, see ``columns.N_OPTIONS``."""
    return np.array([1.0 / tol**2, stride(tableau) * dt, max_steps / stride(tableau)])


def _mark_coarse(
    batch: Batch, tableau: Tableau, dt: float, result: Floats, counts: NDArray[np.int64]
) -> None:
    """Give a status to runs whose step was too long to tell growth from its own damping.

    A coarse step damps an oscillation that is a small part of the energy without a trace in
    the energy's drift, and the run would look like a steady spin.
    """
    damping = tableau.damping(dt * batch.relevant) * (result[:, C.T_END] / dt)
    coarse = (counts[:, C.STATUS] == Status.OK) & ~(np.abs(damping) <= MAX_DAMPING)
    counts[coarse, C.STATUS] = Status.COARSE
    result[coarse, C.T_R] = np.nan


def exponents(growth: Floats) -> tuple[Floats, Floats]:
    """Finite-time Lyapunov exponents of runs, over all of their time and over its second half.

    Parameters
    ----------
    growth : ndarray, shape (runs, windows, 2)
        Of an :class:`Outcome`.

    Returns
    -------
    whole, late : ndarray, shape (runs,)
        In ``sqrt(g/a)``; NaN where a run left the numbers.  ``late`` is also NaN where it ended
        within its second window; the growth until half time is interpolated between the ends of
        windows.
    """
    runs = len(growth)
    # A step that ends several windows fills the row of the first; the empty ones go last.
    order = np.argsort(~np.isfinite(growth[:, :, :1]), axis=1, kind="stable")
    growth = np.take_along_axis(growth, order, axis=1)
    t = np.concatenate([np.zeros((runs, 1)), growth[:, :, 0]], axis=1)
    log = np.concatenate([np.zeros((runs, 1)), growth[:, :, 1]], axis=1)
    row = np.arange(runs)
    last = np.isfinite(t).sum(axis=1) - 1
    end, grown = t[row, last], log[row, last]
    half = end / 2
    # NaN compares as false: the last border not behind half time.
    before = (t <= half[:, None]).sum(axis=1) - 1
    after = np.minimum(before + 1, last)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (half - t[row, before]) / (t[row, after] - t[row, before])
        until = log[row, before] + share * (log[row, after] - log[row, before])
        whole = grown / end
        late = np.where(before > 0, (grown - until) / half, np.nan)
    whole, late = (np.where(np.isfinite(rate), rate, np.nan) for rate in (whole, late))
    return whole, late


def expected_cost(batch: Batch) -> Floats:
    """Expected cost of runs in swings of the spin, the unit of the progress reports."""
    return batch.t_end * batch.swing


__all__ = ["Batch", "Control", "Outcome", "available_threads", "expected_cost", "integrate"]
