"""Growth of a tangent: the exponents of a sweep's runs, and one long run through its reversals."""

# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.defaults import TOL
from rattlesweep.integrate.lanes.build import problem_of
from rattlesweep.integrate.lanes.controller import error_root, retry_ratio, step_ratio
from rattlesweep.integrate.lanes.intrinsics import addresses_of, call, first_of
from rattlesweep.integrate.lanes.kernel import ATTEMPT
from rattlesweep.integrate.lanes.lane import Layout, lane_of
from rattlesweep.integrate.lanes.runs import derive
from rattlesweep.integrate.lanes.step import OPTIONS, write_attempt
from rattlesweep.integrate.lanes.tangents import advance, tangent_begin, tangent_log
from rattlesweep.integrate.model import FULL, MODELS, WITH_TANGENT
from rattlesweep.integrate.tableau import DOP853, METHODS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from rattlesweep.arrays import Floats
    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau

FIRST_STEP = 0.01
# A step shorter than this share of the interval is given up.
LEAST_STEP = 1e-12


def exponents(growth: Floats) -> tuple[Floats, Floats]:
    """Finite-time Lyapunov exponents of runs, over all of their time and over its second half.

    Parameters
    ----------
    growth : ndarray, shape (runs, windows, 2)
        Of :class:`rattlesweep.integrate.batch.Outcome`.

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
    return _finite(whole), _finite(late)


def _finite(values: Floats) -> Floats:
    return np.where(np.isfinite(values), values, np.nan)


def grow(problem, parts, w, constants, y0, seed, times, scale, growth):  # type: ignore[no-untyped-def]
    """Move one run, in one lane, from each time to the next; return how many it reached.

    A step ends at each of the times, and the next is then as long as it would have been without.
    """
    lane = lane_of(problem, w, 0)
    lane.y = first_of(y0, problem.n_state)
    lane.constants = first_of(constants, problem.n_constants)
    derive(lane)
    lane.v = first_of(seed, problem.n_state)
    tangent_begin(lane)
    t = 0.0
    h = FIRST_STEP
    last = 1.0
    held = False
    for k in range(times.size):
        behind = False
        while not behind:
            left = times[k] - t
            behind = h >= left
            lane.h = left if behind else h
            call(parts[ATTEMPT], (problem, w, scale))
            if not lane.error <= 1.0:
                h = lane.h * retry_ratio(lane.error)
                held = True
                behind = False
                if not h > LEAST_STEP * times[k]:
                    return k
                continue
            root = error_root(lane.error)
            h_next = lane.h * step_ratio(root, last, held)
            last = root
            held = False
            if behind:
                growth[k] = tangent_log(lane)
                t = times[k]
                h = max(h_next, h)
            else:
                t += h
                h = h_next
            advance(problem, w)
    return times.size


def growth_recipe(model_name: str) -> Kernel:
    """Return :func:`grow` of a model with a tangent."""
    model = MODELS[model_name]
    parts, w = np.zeros(1, dtype=np.int64), np.zeros(Layout.of(model).rows(DOP853, model))
    nothing = [np.zeros(n) for n in (model.n_constants, model.n_state, model.n_state, 0)]
    arguments = (problem_of(model, True, 1), parts, w, *nothing, 1.0, np.zeros(0))
    return Kernel(grow, arguments, {"nogil": True, "error_model": "numpy"})


def attempt_alone(tableau_name: str, model_name: str) -> Kernel:
    """Return the step of a method and a model on a single lane."""
    tableau, model = METHODS[tableau_name], MODELS[model_name]
    arguments = problem_of(model, True, 1), np.zeros(Layout.of(model).rows(tableau, model)), 1.0
    return Kernel(write_attempt(tableau, model, 1), arguments, OPTIONS)


def load_growth(tableau_name: str, model_name: str) -> Callable[..., int]:
    """Return :func:`grow` of a method and a model, to be given its workspace and more."""
    wanted = (growth_recipe, model_name), (attempt_alone, tableau_name, model_name)
    growth, step = load_kernels(*wanted)
    return partial(growth, problem_of(MODELS[model_name], True, 1), addresses_of(step))


def growth_along(
    constants: ArrayLike,
    y0: ArrayLike,
    times: ArrayLike,
    *,
    tableau: Tableau = DOP853,
    model: Model = FULL,
    tol: float = TOL,
    seed: ArrayLike | None = None,
) -> Floats:
    """Logarithm of a tangent's growth along one run, past any number of reversals.

    Divided by ``times`` it is the running estimate of the largest Lyapunov exponent.

    Parameters
    ----------
    constants, y0 : array_like
        As the rows of :class:`rattlesweep.integrate.batch.Batch`.
    times : array_like
        Where to measure: positive and ascending, in ``sqrt(a/g)``.
    tableau, model, tol
        A method with error control, ``FULL`` or ``REDUCED``, and the tolerance.
    seed : array_like, optional
        First tangent, of which the transverse part is taken; by default one along no mode.

    Raises
    ------
    ValueError
        If the times do not ascend or the method has no error control.
    ArithmeticError
        If the integration fails.
    """
    if not tableau.adaptive:
        raise ValueError(f"the method {tableau.name} has no error control")
    times = np.array(times, dtype=float)
    if times.ndim != 1 or np.any(~(np.diff(times, prepend=0.0) > 0)):
        raise ValueError("times must be a list of numbers that are positive and ascend")
    model = WITH_TANGENT[model.name]
    assert model.tangent is not None
    y0, constants = np.array(y0, dtype=float), np.array(constants, dtype=float)
    seed = model.tangent.seed(*y0, *constants) if seed is None else seed
    growth, w = np.full(len(times), np.nan), np.zeros(Layout.of(model).rows(tableau, model))
    reached = load_growth(tableau.name, model.name)(
        w, constants, y0, np.array(seed, dtype=float), times, 1.0 / tol**2, growth
    )
    if reached < len(times):
        raise ArithmeticError(
            f"no step, however small, met the tolerance before t = {times[reached]}"
        )
    return growth
