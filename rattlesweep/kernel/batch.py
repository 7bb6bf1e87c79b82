"""Batches of runs: load a kernel, run it in threads, and return the results."""

import os
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import config

from rattlesweep.arrays import Flags, Floats, Integers, Places, put, spread, take
from rattlesweep.kernel import runs, tangents, turn
from rattlesweep.kernel.collected import MODE_RESULTS, SHAPES, Recording, layout_of
from rattlesweep.kernel.growths import leave_out_comparisons
from rattlesweep.kernel.look.marks import MARKS
from rattlesweep.kernel.method.tableau import DT, MAX_STEPS, TOL, Tableau
from rattlesweep.kernel.mode.modes import WITHOUT_MODE
from rattlesweep.kernel.outcome import Batch, Outcome
from rattlesweep.kernel.recipes import problem_of, threaded_kernel
from rattlesweep.kernel.runs import Inputs, Outputs
from rattlesweep.kernel.state.status import Status
from rattlesweep.kernel.step.explicit import SUBSTEPS
from rattlesweep.kernel.task import Control
from rattlesweep.kernel.threads import _after_fork, available_threads, holding, parallel
from rattlesweep.motion.anywhere import from_slopes, to_slopes
from rattlesweep.motion.model import Model

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


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


@dataclass(frozen=True)
class BatchSettings:
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
        Further observations: names of `recipes.RECORDINGS` and of marks, and
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
    settings = BatchSettings(tol, dt, max_steps, record, threads)
    if "spectrum" in record and longest_step is None:
        longest_step = longest_frame_steps(batch, tableau, tol)
    longest = longest_step
    if longest is None:
        longest = np.full(len(batch), np.inf)
    price = batch.t_end * batch.swing
    if cost is not None:
        price = cost.astype(float)

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
        own = model
        if zero.any():
            own = model.without(names[zero])
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
    settings: BatchSettings,
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
    settings: BatchSettings,
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
    lacking = layout_of(model).fields.keys() - layout_of(own).fields.keys()
    none: dict[str, Any] = {
        name: np.full(count, WITHOUT_MODE[name])
        for name in lacking & WITHOUT_MODE.keys()
    }
    return replace(outcome, **none)


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
    results = np.zeros(count, runs.RESULT)
    for name in runs.RESULT.names or ():
        if runs.RESULT[name].kind == "f":
            results[name] = np.nan
    results["status"] = Status.STOPPED
    at = problem_of(model).layout
    n_results = at.stages - at.results
    return Outputs(results, np.full((count, model.n_state + n_results), np.nan))


def recording_of(count: int, record: Collection[str]) -> Recording:
    """Return arrays for a number of runs, empty where something is not recorded."""
    arrays = {}
    for name, shape in SHAPES.items():
        arrays[name] = np.full((count if name in record else 0, *shape), np.nan)
    if not {mark.name for mark in MARKS}.isdisjoint(record):
        arrays["marks"] = np.full((count, *SHAPES["marks"]), np.nan)
    if "spectrum" in record:
        arrays["lyapunov"] = np.full((count, *tangents.OF_FRAME), np.nan)
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
    columns: dict[str, Any] = {}
    for name in runs.RESULT.names or ():
        columns[name] = outputs.results[name].copy()
    at = problem_of(model).layout
    for name, kind in MODE_RESULTS.items():
        # What a model has no mode for has no rows.
        values = np.zeros(0)
        if name in at.fields:
            place = model.n_state + at.fields[name][0] - at.results
            values = outputs.ends[:, place]
        if kind is not float:
            # A run that has not ended has no number.
            values = np.nan_to_num(values)
        columns[name] = values.astype(kind)
    if not tableau.adaptive:
        coarse = is_coarse(tableau, dt, batch.relevant, columns["t_end"])
        coarse &= columns["status"] == Status.OK
        columns["status"][coarse] = Status.COARSE
        columns["t_r"][coarse] = np.nan
    columns["n_steps"] *= stride(tableau)
    # Without spin at launch these two have no reference.
    columns["amp_growth"][batch.tapped] = np.nan
    columns["n_departure"][batch.tapped] = np.nan
    columns |= recording._asdict()
    leave_out_comparisons(columns["lyapunov"], columns["t_end"])
    return Outcome(
        **columns,
        y_end=outputs.ends[:, : model.n_state],
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
    starts = np.zeros(len(batch), runs.START)
    starts["horizon"] = batch.t_end
    starts["swing"] = batch.swing
    starts["window"] = batch.window
    starts["rate"] = batch.rate
    starts["cost"] = cost
    starts["longest_step"] = longest_step
    starts["comparison"] = batch.first_comparison
    starts["far"] = PLATEAU_SHARE * batch.scale
    starts["arm"] = batch.tapped
    if len(batch.settled):
        starts["settled"] = batch.settled
    if len(batch.dead):
        starts["dead"] = batch.dead
    starts["rim"] = NO_RIM
    if len(batch.rim):
        starts["rim"] = np.nan_to_num(batch.rim, nan=NO_RIM)
    # The depth below which the method cannot tell the sign of an extremum, as a
    # fraction of the swing.
    if tableau.adaptive:
        angle = min(1.0, turn.FIRST_STEP_ANGLE * tol ** (1 / tableau.order))
        starts["first_step"] = angle / batch.swing
        starts["fuzz"] = 1e3 * tol
    else:
        starts["first_step"] = SUBSTEPS * dt
        starts["fuzz"] = np.maximum(1e-9, (dt * batch.swing) ** tableau.order)
    y0 = np.ascontiguousarray(batch.y0)
    constants = np.ascontiguousarray(batch.constants)
    table = starts.view(float).reshape(len(batch), starts.itemsize // 8)
    return Inputs(y0, constants, np.ascontiguousarray(batch.probe), table)


def options_of(tableau: Tableau, tol: float, dt: float, max_steps: int) -> turn.Options:
    """Return how a kernel integrates."""
    steps = stride(tableau)
    return turn.Options(1.0 / tol**2, float(steps * dt), max_steps / steps)
