"""The error of every reversal time, from a companion: the same run, integrated more loosely.

With d = abs(t_r'/t_r - 1), where t_r' is the companion's, and s the distance of the two states at
their reversals in the norm of the step control,

    t_r_error / t_r = (floor + near r) tol + slope T (d + share s / sqrt(N)) + C + G,
    T = max(r^power, P),   P = min(1, (s / PARTED)^2),   r = tol / tol',   N = n_steps / 1000,

at most 1, which it is where the companion does not reverse.  The first term is the common size of
the error, and more where the companion is hardly looser and so tells less.  The second carries the
difference over to the tighter tolerance: in proportion as long as the two have stayed together (s
small), and in full once they have parted.  d alone is small by chance too often; s, which has
several components, is not.  C is P^2 in the unsteady direction, where runs that part are chaotic,
and their reversals anywhere.  G is one swing of the spin if an extremum of it touches zero within
the tolerance (`near_tangencies`).

`integrator: {accuracy: {t_r: ...}}` asks for an error instead.  Runs are then integrated at the
loosest tolerance that gives it to most, with a companion still looser; those whose estimate is
larger again, a hundred times tighter, with the run before as their companion; and once more.  What
is left at the end keeps its large estimate.  A companion that had parted from its own may be near
the run by chance, so T is then a tenth of (s' / PARTED)^2 at least, with s' the distance of those
two.

Where reversals are recorded too, runs that have ended before their horizon are integrated to it,
and so are their companions.  The error of a later turn follows from the largest d of it and the
turns before, as no states are known there: with P = min(1, (d / TURN_PARTED)^2) and s = 0.

How far that holds is measured by ``benchmarks/errors.py``, which also finds the constants again
after a change of the integrator; docs/accuracy.md says what the runs are that part.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers, put, take
from rattlesweep.integrate.batch import Batch, Control, Outcome, has_settled, integrate
from rattlesweep.integrate.defaults import DT, MAX_STEPS, TOL
from rattlesweep.integrate.lanes.columns import MOST_REVERSALS
from rattlesweep.integrate.model import REDUCED, Model
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import METHODS, Tableau
from rattlesweep.physics import full
from rattlesweep.sweeps.config.schema import Config, Integrator
from rattlesweep.sweeps.launches import model_of


class Fit(NamedTuple):
    """Constants of the estimate.

    Fitted to cover 99.5 % of the runs of each of four mixes at tolerances of 1e-6, 1e-9 and 1e-12,
    with the least overestimate (``benchmarks/errors.py --fit``).
    """

    floor: float = 0.5
    near: float = 10.0
    slope: float = 8.0
    share: float = 0.0007
    power: float = 1.0


FITS = {"dop853": Fit(), "verner98": Fit(floor=0.2), "rk4": Fit(floor=0.0, share=0.003)}
"""By method: how far the error of a step stays below what the control allows differs."""
ROLLING = Fit(floor=5.0, power=0.5)
"""Of bodies with rolling resistance, whose kinks lower the order of all methods."""
LOOSER, LOOSEST = 2e3, 1e-5
"""Tolerance of a companion in units of the run's, and the loosest: beyond, most runs part."""
LEAST_LOOSER = 10.0
"""The least ratio of the two, for tolerances near the loosest."""
TIGHTEST = 1e-14
"""Tolerance below which the error of a step is rounding."""
PARTED = 0.2
"""Distance at which two runs have nothing to do with each other any more."""
REMEMBERED = 0.1
"""Least share of the difference that is carried over if the companion had parted from its own."""
TURN_PARTED, TURN_SLOPE = 5e-3, 50.0
"""Relative difference of turns at which two runs have parted, and the slope instead of a fit's."""
SURE = 1e-3
"""Relative error below which a turn is sure, if those before it are."""
FIRST_RUNG, RUNG, RUNGS = 0.3, 1e-2, 3
"""Tolerances for an error that is asked for: the first in its units, the ratio, how many."""
LOOSEST_RUNG, LOOSEST_OF_LADDER = 1e-6, 1e-4
"""The loosest of these, and of their companions, where runs part early and so tell best.  At 1e-5
a run and its companion agree by chance too often: 6 of 4,886 were off by more than 1e-4."""
AGAIN = (0.4, 0.1)
"""Expected cost of doing runs again, in units of doing all once at the first tolerance."""
DIFFER = 10.0
"""Errors of what a type depends on, in units of the difference from the companion."""


@dataclass(frozen=True)
class Estimated(Outcome):
    """What became of runs, with errors from their companions; NaN where there are none.

    Attributes
    ----------
    t_r_error, amp_growth_error, n_departure_error : ndarray
        The columns of the same names.
    reversal_sure : ndarray of bool
        Whether a run that reverses does so before its horizon for any error of this size; whether
        the companion of a run that does not reverse does not either, and no extremum of the spin
        grazes zero.
    tol, companion_tol : ndarray
        Tolerances of the run and its companion; NaN with a fixed step.
    apart, companion_t_r : ndarray
        Distance of the two states at their reversals, and the companion's reversal.
    grazes : ndarray of int64
        Undecided extrema (`near_tangencies`) of the two.
    tries : ndarray of int64
        Steps tried for each run in all, its companion's and those of looser attempts included.
    turn_errors : ndarray, shape (runs, 8) or (0, 8)
        Errors of the times in `reversals`.
    turns_sure : ndarray of int64
        How many of these turns, from the first on, are sure.
    """

    t_r_error: Floats
    amp_growth_error: Floats
    n_departure_error: Floats
    reversal_sure: Flags
    tol: Floats
    companion_tol: Floats
    apart: Floats
    companion_t_r: Floats
    grazes: Integers
    tries: Integers
    turn_errors: Floats
    turns_sure: Integers


def companion_setting(method: str, value: float) -> float:
    """Return the tolerance of a companion, or twice the step of a fixed-step method."""
    if not METHODS[method].adaptive:
        return 2.0 * value
    return max(LEAST_LOOSER * value, min(LOOSER * value, LOOSEST))


def ladder(settings: Integrator) -> list[float]:
    """Return the settings of runs in turn: of companions, the runs, and those that fail.

    Without an error that is asked for there are only the first two.
    """
    if settings.goal is None:
        adaptive = METHODS[settings.method].adaptive
        value = (settings.tol or TOL) if adaptive else (settings.dt or DT)
        return [companion_setting(settings.method, value), value]
    first = min(FIRST_RUNG * settings.goal, LOOSEST_RUNG)
    rungs = {max(first * RUNG**k, TIGHTEST) for k in range(RUNGS)}
    return [min(LOOSER * first, LOOSEST_OF_LADDER), *sorted(rungs, reverse=True)]


def prices(settings: Integrator) -> list[float]:
    """Return the expected cost of each step of the ladder, in units of plain runs on the second."""
    tableau, values = METHODS[settings.method], ladder(settings)
    if not tableau.adaptive:
        return [0.5, 1.0]
    # The other tenth is lost in rejected steps: 40 to 45 % at 1e-9, 77 to 84 % at 1e-6.
    companion = 1.1 * float((values[1] / values[0]) ** (1.0 / tableau.order))
    return [companion, 1.0, *AGAIN[: len(values) - 2]]


def integrate_estimated(
    config: Config, batch: Batch, threads: int | None, control: Control
) -> Estimated:
    """Integrate runs with their companions, and those whose error is too large again, tighter.

    The companions come first: whenever the runs are stopped, those that have ended have their
    errors.  A run that is done again keeps nothing of what it was but a companion, so what becomes
    of it depends on its own numbers alone.
    """
    settings, model = config.integrator, model_of(config)
    tableau, values, goal = METHODS[settings.method], ladder(settings), settings.goal or np.inf
    turning, record = "reversals" in config.record, frozenset(config.record) - {"reversals"}
    costs = prices(settings)
    spans = np.cumsum([0.0, *costs, *(costs[:2] if turning else [])])
    spans /= spans[-1]

    def attempt(
        stage: int, rung: int, part: Batch, cost: Integers | None = None, turns: bool = False
    ) -> Outcome:
        # A run that ends is done if nothing follows.
        ends = stage == 1 and len(spans) == 3
        control.stage(*spans[stage : stage + 2], begins=stage == 1, ends=ends)
        asked = record if rung else frozenset[str]()
        return integrate(
            part,
            tableau,
            model,
            **{"tol" if tableau.adaptive else "dt": values[rung]},
            # A run that is done again under another limit must get the same error.
            max_steps=settings.max_steps if rung else max(settings.max_steps, MAX_STEPS),
            record=asked | {"reversals"} if turns else asked,
            cost=cost,
            threads=threads,
            control=control,
        )

    companions = attempt(0, 0, batch)
    # Where a run ends is known by now, so none is begun late and keeps lanes waiting.
    runs = attempt(1, 1, batch, companions.n_steps)
    now = done = with_errors(config, batch, runs, companions, (values[1], values[0]))
    rows, part, tries = np.arange(len(batch)), batch, now.tries.copy()
    for k in range(2, len(values)):
        again = _to_be_done_again(now, goal)
        if not again.any():
            break
        control.settle(int((~again & (now.status != Status.STOPPED)).sum()))
        rows, part, companions = rows[again], take(part, again), take(runs, again)
        before, runs = now.apart[again], attempt(k, k, part, companions.n_steps)
        now = with_errors(config, part, runs, companions, (values[k], values[k - 1]), before)
        put(now, done, rows)
        tries[rows] += _tries(runs)
    if turning:
        none = np.full((len(batch), MOST_REVERSALS, 2), np.nan)
        done = replace(done, reversals=none, turn_errors=none[:, :, 0].copy())
        open_ = (done.status == Status.OK) & (done.t_end < batch.t_end)
        control.settle(int((~open_ & (done.status != Status.STOPPED)).sum()))
        rows, part, first = np.flatnonzero(open_), take(batch, open_), take(done, open_)
        companions = attempt(2, 0, part, turns=True)
        runs = attempt(3, 1, part, companions.n_steps, turns=True)
        later = with_errors(config, part, runs, companions, (values[1], values[0]))
        errors, sure = _turns(tableau, model, first, runs, companions, (values[1], values[0]))
        names = ("t_r_error", "reversal_sure", "apart", "companion_t_r", "grazes")
        of_t_r = {name: getattr(first, name) for name in names}
        put(replace(later, turn_errors=errors, turns_sure=sure, **of_t_r), done, rows)
        tries[rows] += later.tries
    return replace(done, tries=tries, stopped=bool((done.status == Status.STOPPED).any()))


def _tries(runs: Outcome) -> Integers:
    return runs.n_steps + runs.n_rejected


def _to_be_done_again(runs: Estimated, goal: float) -> Flags:
    """Return which runs may come out otherwise, or at all, at a tighter tolerance."""
    large = runs.t_r_error > goal * runs.t_r
    missed = np.isnan(runs.t_r) & np.isfinite(runs.companion_t_r)
    lost = ~np.isin(runs.status, (Status.OK, Status.STEP_LIMIT, Status.STOPPED))
    again: Flags = ((large | missed) & (runs.status == Status.OK)) | lost
    return again


def with_errors(
    config: Config,
    batch: Batch,
    runs: Outcome,
    companions: Outcome,
    settings: tuple[float, float],
    before: Floats | float = 0.0,
) -> Estimated:
    """Add to the outcome of runs the errors that their companions tell.

    `settings` are the tolerance or step of the runs and that of the companions, `before` how far
    the companions had parted from their own (`Estimated.apart`), if they had any.
    """
    tableau, (value, looser) = METHODS[config.integrator.method], settings
    model = model_of(config)
    apart = how_far_apart(batch, model, runs, companions)
    relative = relative_error(batch, model, runs, companions, apart, tableau, settings, before)
    t_r_error = relative * runs.t_r
    ok = runs.status == Status.OK
    # Of a run that has settled, amp_growth lies between what it was and 0.
    (low, high), (low_other, high_other) = (
        (out.amp_growth, np.where(has_settled(batch, out), 0.0, out.amp_growth))
        for out in (runs, companions)
    )
    between = np.maximum(0.0, np.maximum(low - high_other, low_other - high))
    growth = np.where(ok, DIFFER * between, np.nan)
    departure = np.where(ok, DIFFER * np.abs(runs.n_departure - companions.n_departure), np.nan)
    # A companion that failed has numbers, but says nothing; one that reversed says R.
    departure[companions.status != Status.OK] = np.nan
    neither = np.isnan(runs.t_r) & np.isnan(companions.t_r) & (companions.status == Status.OK)
    grazes = runs.near_tangencies + companions.near_tangencies
    # Where a stop has kept a companion from its end, the run has not been either.
    cut = companions.status == Status.STOPPED
    runs = replace(
        runs,
        status=np.where(cut, Status.STOPPED, runs.status),
        stopped=runs.stopped or companions.stopped,
    )
    return Estimated(
        **vars(runs),
        t_r_error=t_r_error,
        amp_growth_error=growth,
        n_departure_error=departure,
        reversal_sure=((relative < 1.0) & (runs.t_r + t_r_error < batch.t_end))
        | (neither & (grazes == 0)),
        tol=np.full(len(batch), value if tableau.adaptive else np.nan),
        apart=apart,
        companion_tol=np.full(len(batch), looser if tableau.adaptive else np.nan),
        companion_t_r=companions.t_r,
        grazes=grazes,
        tries=_tries(runs) + _tries(companions),
        turn_errors=np.zeros((0, MOST_REVERSALS)),
        turns_sure=np.zeros(len(batch), np.int64),
    )


def how_far_apart(batch: Batch, model: Model, runs: Outcome, companions: Outcome) -> Floats:
    """Return the distance of each run from its companion at their reversals; 1 without one."""
    both = np.isfinite(runs.t_r) & np.isfinite(companions.t_r)
    apart = np.ones(len(both))
    apart[both] = distance(model, runs.y_end[both], companions.y_end[both], batch.constants[both])
    return apart


def relative_error(
    batch: Batch,
    model: Model,
    runs: Outcome,
    companions: Outcome,
    apart: Floats,
    tableau: Tableau,
    settings: tuple[float, float],
    before: Floats | float = 0.0,
    fit: Fit | None = None,
) -> Floats:
    """Return the estimate of ``abs(t_r / true - 1)``, NaN where there is no ``t_r``.

    `apart` is :func:`how_far_apart`, the others are as in :func:`with_errors`.
    """
    fit, common, ratio = _scales(tableau, model, settings, fit)
    difference = np.abs(companions.t_r / runs.t_r - 1.0)
    d = np.where(np.isfinite(difference), difference, 1.0)
    parted, had_parted = (np.minimum(1.0, (s / PARTED) ** 2) for s in (apart, np.asarray(before)))
    carried = np.maximum(np.maximum(ratio, parted), REMEMBERED * had_parted)
    thousands = np.maximum(runs.n_steps, 1) / 1000.0
    grazing = runs.near_tangencies + companions.near_tangencies > 0
    estimate = (
        common
        + fit.slope * carried * (d + fit.share * apart / np.sqrt(thousands))
        + np.where(_is_unsteady(batch, model), parted**2, 0.0)
        + np.where(grazing, 2 * np.pi / batch.swing / runs.t_r, 0.0)
    )
    return np.where(np.isfinite(runs.t_r), np.minimum(estimate, 1.0), np.nan)


def _scales(
    tableau: Tableau, model: Model, settings: tuple[float, float], fit: Fit | None = None
) -> tuple[Fit, float, float]:
    """Return the constants, the common size of the error, and what it is to the difference."""
    fit = fit or (ROLLING if "rolling" in model.name else FITS.get(tableau.name, Fit()))
    ratio = settings[0] / settings[1]
    # Errors of fixed steps do not add up at random.
    tol, ratio = (settings[0], ratio) if tableau.adaptive else (0.0, ratio**tableau.order)
    return fit, (fit.floor + fit.near * ratio) * max(tol, TIGHTEST), ratio**fit.power


def _is_unsteady(batch: Batch, model: Model) -> Flags:
    """Return which runs are not launched in the steady direction."""
    if model.name == REDUCED.name:
        K_p, n_i = batch.constants[:, 0], batch.y0[:, 0]
    else:
        # Of the constants it is the mixed curvature that has the sign of the skew.
        K_p, n_i = -batch.constants[:, 4], batch.y0[:, 4]
    return np.asarray(K_p * n_i >= 0)


def _turns(
    tableau: Tableau,
    model: Model,
    first: Estimated,
    runs: Outcome,
    companions: Outcome,
    settings: tuple[float, float],
) -> tuple[Floats, Integers]:
    """Return the errors of the times of turns, and how many turns are sure, from the first on.

    `first` has the error of ``t_r``, which is the first turn's too where that is its time.
    """
    _, common, ratio = _scales(tableau, model, settings)
    times, others = runs.reversals[:, :, 0], companions.reversals[:, :, 0]
    difference = np.abs(others / times - 1.0)
    there = np.isfinite(difference)
    d = np.maximum.accumulate(np.where(there, difference, 1.0), axis=1)
    carried = np.maximum(ratio, np.minimum(1.0, (d / TURN_PARTED) ** 2))
    relative = common + TURN_SLOPE * carried * d
    # A spin that comes back after its first zero turns at a later one: which, is less sure.
    t_r = first.t_r[:, None]
    relative[:, :1] = np.maximum(first.t_r_error[:, None] / t_r, times[:, :1] / t_r - 1.0)
    relative = np.minimum(relative, 1.0)
    sure = np.cumprod(there & (relative < SURE), axis=1).sum(axis=1)
    return np.where(there, relative * times, np.nan), sure


def distance(model: Model, y: Floats, other: Floats, constants: Floats) -> Floats:
    """Return the distance of states in the norm of the step control, relative to that of ``y``.

    Arrays have the shapes (runs, n_state), twice, and (runs, n_constants).
    """
    change, here, q = (y - other).T, y.T, constants.T
    if model.name == REDUCED.name:
        norm: Any = model.error
        moved, size = norm.py_func(*change, *here, *q)
    else:
        # At a reversal the spin itself is zero in both.
        ix, iy, _, cxx, cxy, cyy = q[:6]
        square = full.oscillation.py_func
        moved, size = (square(*v[:4], ix, iy, cxx, cxy, cyy) for v in (change, here))
    return np.asarray(np.sqrt(moved / size))
