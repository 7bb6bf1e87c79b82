"""Batches of runs: build the kernel of a method, start it, listen to it, stop it."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import config, get_num_threads, njit, set_num_threads

from rattlesweep.integrate import lanes
from rattlesweep.integrate.cache import cached, specialise
from rattlesweep.integrate.stages import (
    LANES,
    SUBSTEPS,
    Layout,
    compile_attempt,
    compile_lane_functions,
)
from rattlesweep.integrate.status import Status

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau

    Floats = NDArray[np.float64]

N_WINDOWS = 64
RECORDS = ("energy", "contact", "windows")


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
    rate : ndarray
        Bound of the spin's rate in the first steps, in ``g/a``.
    window : ndarray
        Length of the windows in which amplitudes are compared, in ``sqrt(a/g)``.
    """

    y0: Floats
    constants: Floats
    probe: Floats
    t_end: Floats
    swing: Floats
    rate: Floats
    window: Floats

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.t_end)


@dataclass(frozen=True)
class Outcome:
    """What became of the runs of a :class:`Batch`; arrays over runs, NaN where there is nothing.

    Attributes
    ----------
    t_end, t_r, n_end, energy_drift, amp_growth, n_departure : ndarray
        The columns of the same names in the tables.
    status, n_steps, near_tangencies, n_rejected : ndarray of int64
        ``status`` holds values of :class:`Status`.
    energy_0, energy_drift_max, contact_ratio_max, contact_normal_min : ndarray
        Meaningful only where they were asked for.
    y_end : ndarray, shape (runs, n_state)
        State at ``t_end``.
    windows : ndarray, shape (runs, windows, 3) or (0, ...)
        Amplitude, least and largest spin in each window; NaN where the run had ended.
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
    status: NDArray[np.int64]
    n_steps: NDArray[np.int64]
    near_tangencies: NDArray[np.int64]
    n_rejected: NDArray[np.int64]
    y_end: Floats
    windows: Floats
    stopped: bool


@dataclass
class Control:
    """Link to a running kernel: hears how far it is and tells it to stop.

    Attributes
    ----------
    total : float
        Expected cost of the batch, in the units of :attr:`done`.
    """

    total: float = 0.0
    _shared: NDArray[np.int64] = field(default_factory=lambda: np.zeros(2, dtype=np.int64))
    _progress: Floats = field(default_factory=lambda: np.zeros((1, 8)))

    def stop(self) -> None:
        """Ask the kernel to end; it does so within a few hundred steps."""
        self._shared[1] = 1

    @property
    def stopping(self) -> bool:
        """Whether a stop was asked for."""
        return bool(self._shared[1])

    @property
    def done(self) -> float:
        """Cost of what is done so far."""
        return float(self._progress[:, :2].sum())

    @property
    def runs_done(self) -> int:
        """Runs that have ended."""
        return int(self._progress[:, 2].sum())


@cache
def kernel(tableau_name: str, model_name: str) -> Callable[..., None]:
    """Compiled :func:`lanes.drive` of a method and a model; compiled when first called."""
    from rattlesweep.integrate.model import MODELS
    from rattlesweep.integrate.tableau import METHODS

    tableau, model = METHODS[tableau_name], MODELS[model_name]
    at = Layout.of(model)
    bindings: dict[str, Any] = {
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
    suffix = f"_{tableau.name}_{model.name}"
    # In the order in which they call each other.  No fastmath here: the time is a compensated sum.
    for name in ("close_window", "start", "idle", "finish", "give_up", "decide", "commit",
                 "watch", "work"):  # fmt: skip
        function = specialise(getattr(lanes, name), name + suffix, **bindings)
        bindings[name] = njit(nogil=True, error_model="numpy")(function)
    driver = specialise(lanes.drive, "drive" + suffix, **bindings)
    compiled: Callable[..., None] = cached(driver, parallel=True, nogil=True)
    return compiled


def available_threads() -> int:
    """Threads to use by default: the processors this process may run on, as Numba counts them."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(allowed or 1, most_threads()))


def most_threads() -> int:
    """Threads that Numba can start at most; ``NUMBA_NUM_THREADS`` sets it."""
    return int(config.NUMBA_NUM_THREADS)


def _aligned(threads: int, size: int) -> Floats:
    """Zeros of shape (threads, size), each row on its own cache lines."""
    size = -(-size // 16) * 16
    flat = np.zeros(threads * size + 8)
    shift = (-flat.ctypes.data // 8) % 8
    return flat[shift : shift + threads * size].reshape(threads, size)


def integrate(
    batch: Batch,
    tableau: Tableau,
    model: Model,
    *,
    tol: float = 1e-9,
    dt: float = 0.002,
    max_steps: int = 100_000_000,
    record: frozenset[str] = frozenset(),
    threads: int | None = None,
    control: Control | None = None,
) -> Outcome:
    """Integrate every run to its first reversal or its horizon.

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
        Extra observations: ``energy``, ``contact``, ``windows``.
    threads : int, optional
        Threads; by default :func:`available_threads`.
    control : Control, optional
        To watch and to stop the kernel from another thread.

    Returns
    -------
    Outcome
        Bit for bit the same for any number of threads and any composition of the batch.
    """
    runs = len(batch)
    threads = min(threads or available_threads(), most_threads())
    control = control or Control()
    at = Layout.of(model)
    cost = expected_cost(batch)
    # Longest first, so that no thread begins a long run when the others are done.
    order = np.argsort(-cost, kind="stable")
    control.total = float(cost.sum())
    control._progress = np.zeros((threads, 8))
    # A fixed-step method is looked at every few steps.
    stride = 1 if tableau.adaptive else SUBSTEPS
    first = 0.1 / batch.swing if tableau.adaptive else np.full(runs, stride * dt)
    plan = np.stack([batch.t_end, batch.swing, batch.window, batch.rate, first, cost], axis=1)
    result = np.full((runs, lanes.FIRST_STATE + model.n_state), np.nan)
    counts = np.zeros((runs, lanes.N_COUNTS), dtype=np.int64)
    counts[:, lanes.STATUS] = Status.STOPPED
    windows = np.full((runs if "windows" in record else 0, N_WINDOWS, 3), np.nan)
    # How far tolerance leaves an extremum of the spin undecided, as a share of its swing.
    fuzz = 1e3 * (tol if tableau.adaptive else 1e-12)
    options = np.array([1.0 / tol**2, stride * dt, max_steps / stride, fuzz])
    flags = np.array([name in record for name in RECORDS])

    def run_kernel() -> None:
        before = get_num_threads()
        set_num_threads(threads)
        try:
            kernel(tableau.name, model.name)(
                threads,
                _aligned(threads, (at.stages + tableau.stages * model.n_state) * LANES),
                np.zeros((threads, LANES), dtype=np.int64),
                np.full((threads, LANES), -1, dtype=np.int64),
                control._shared,
                order,
                np.ascontiguousarray(batch.y0),
                np.ascontiguousarray(batch.constants),
                np.ascontiguousarray(batch.probe),
                plan,
                options,
                flags,
                result,
                counts,
                windows,
                control._progress,
            )
        finally:
            set_num_threads(before)

    if runs:
        control._shared[0] = 0
        run_kernel()
    c = lanes
    return Outcome(
        t_end=result[:, c.T_END],
        t_r=result[:, c.T_R],
        n_end=result[:, c.N_END],
        energy_drift=result[:, c.DRIFT],
        amp_growth=result[:, c.GROWTH],
        n_departure=result[:, c.DEPARTURE],
        energy_0=result[:, c.ENERGY_0],
        energy_drift_max=result[:, c.DRIFT_MAX],
        contact_ratio_max=result[:, c.RATIO_MAX],
        contact_normal_min=result[:, c.NORMAL_MIN],
        status=counts[:, c.STATUS],
        n_steps=counts[:, c.STEPS] * stride,
        near_tangencies=counts[:, c.NEAR],
        n_rejected=counts[:, c.REJECTED],
        y_end=result[:, c.FIRST_STATE :],
        windows=windows,
        stopped=bool((counts[:, c.STATUS] == Status.STOPPED).any()),
    )


def expected_cost(batch: Batch) -> Floats:
    """Expected cost of runs in swings of the spin, the unit of the progress reports."""
    return batch.t_end * batch.swing


__all__ = ["Batch", "Control", "Outcome", "available_threads", "expected_cost", "integrate"]
