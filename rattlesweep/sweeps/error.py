"""Errors of reversal times, from companions: the same runs at a looser tolerance.

With d = abs(t_r'/t_r - 1), where t_r' is the reversal time of the companion, and s the
distance of the two states at their reversals in the norm of the step control,

    t_r_error / t_r = (floor + near r) tol + slope T (d + share s / sqrt(N)) + C + G,
    T = max((r + near r^2)^power, P),   P = min(1, (s / PARTED)^2),
    r = tol / tol',   N = n_steps / 1000,

The estimate is at most 1, and is 1 if the companion does not reverse.  The second term
scales the difference down to the tighter tolerance as long as the two runs stay
together (small s), and takes all of it once they have parted.  Too often d alone is
small by chance; s, which has several components, is not.  C is P^2 in the unsteady
direction, where runs that part are chaotic, and 0 in the other.  G is one swing of the
spin if an extremum of the spin touches zero within the tolerance.

With `accuracy: {t_r: ...}`, runs with a larger estimate are integrated again, a hundred
times tighter, with the previous run as their companion; and then once more.  A
companion that has parted from its own companion may be near the run by chance.  So T is
at least a tenth of (s' / PARTED)^2, where s' is the distance of these two.

If reversals are recorded too, runs that end at their first reversal are also integrated
to the horizon.  The error of a later turn follows from the largest d up to this turn,
with P = min(1, (d / TURN_PARTED)^2) and s = 0.  ``benchmarks/errors.py`` fits the
constants.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers, put, take
from rattlesweep.integrate.batch import Batch, Outcome, has_settled, integrate
from rattlesweep.integrate.lanes.runs import MOST_REVERSALS
from rattlesweep.integrate.model import REDUCED, Model
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DT, MAX_STEPS, METHODS, TOL
from rattlesweep.integrate.task import Control
from rattlesweep.physics import full
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.launches import model_of


class Fit(NamedTuple):
    """Constants of the estimate."""

    floor: float = 0.5
    near: float = 10.0
    slope: float = 12.0
    share: float = 0.0007
    power: float = 1.0
    looser: float = 2e3  # ratio of the companion's tolerance to the run's


FITS = {"dop853": Fit(), "verner98": Fit(floor=0.2), "rk4": Fit(floor=0.0, share=0.003)}
ELLIPSOID = Fit(slope=20.0, share=0.002)  # its large swings are harder to integrate
# Kinks lower the order of all methods, so a companion must be nearly as accurate as the
# run.
ROLLING = Fit(floor=5.0, slope=20.0, share=0.0015, power=0.3, looser=30.0)
LEAST_LOOSER = 10.0  # smallest ratio of the companion's tolerance to the run's
LOOSEST = 1e-5  # largest tolerance of a companion; at larger ones most runs part
TIGHTEST = 1e-14  # tolerance below which rounding dominates the error of a step
PARTED = 0.2  # distance at which two runs have become independent
# loss of spin beyond which a run that has parted from its companion may reverse
NEAR_ZERO = 0.8
# least share of d that counts if the companion had parted from its own companion
REMEMBERED = 0.1
TURN_PARTED = 5e-3  # relative difference of turns at which two runs have parted
TURN_SLOPE = 50.0  # slope of the errors of turns
SURE = 1e-3  # relative error below which a turn is sure, if those before it are
# Tolerances for a given error: the first in units of it, the ratio of the next ones,
# their number.
FIRST_RUNG, RUNG, RUNGS = 0.3, 1e-2, 3
# The loosest of these tolerances, and of their companions, where runs part early and so
# tell best. With companions at 1e-5, runs agree by chance: 6 of 4,886 were off by more
# than 1e-4.
LOOSEST_RUNG, LOOSEST_OF_LADDER = 1e-6, 1e-4
AGAIN = (
    0.4,
    0.1,
)  # cost of each repetition, relative to that of all runs at the first tolerance
DIFFER = (
    10.0  # error of amp_growth and n_departure over their difference from the companion
)


@dataclass(frozen=True)
class Estimated(Outcome):
    """Outcome of runs, with errors from their companions; NaN where there are none."""

    t_r_error: Floats
    amp_growth_error: Floats
    n_departure_error: Floats
    reversal_sure: (
        Flags  # whether it is sure that a run reverses by its horizon, or does not
    )
    tol: Floats  # NaN with a fixed step, like companion_tol
    companion_tol: Floats
    companion_t_r: Floats
    apart: Floats  # distance of the two states at their reversals
    grazes: Integers  # undecided extrema of the spin in both
    turn_errors: Floats  # errors of the times in `reversals`, shape (runs, 8) or (0, 8)
    turns_sure: Integers  # number of turns, from the first on, that are sure


def integrate_estimated(
    config: Config, batch: Batch, threads: int | None, control: Control
) -> Estimated:
    """Integrate companions and runs, then again, at tighter tolerances, runs of large
    error.
    """
    settings, model = config.integrator, model_of(config)
    tableau, goal = METHODS[settings.method], settings.goal or np.inf
    (values, costs), turning = ladder(config), frozenset(config.record) & {"reversals"}
    record, pair = frozenset(config.record) - turning, (values[1], values[0])
    spans = np.cumsum([0.0, *costs, *(costs[:2] if turning else [])])
    spans /= spans[-1]

    def attempt(stage: int, rung: int, part: Batch, **asked: Any) -> Outcome:
        is_last = stage == 1 and len(spans) == 3  # runs that end are then done
        control.stage(*spans[stage : stage + 2], ends=is_last)
        asked["tol" if tableau.adaptive else "dt"] = values[rung]
        # A companion's limit of steps must not change the error of its run.
        most = settings.max_steps if rung else max(settings.max_steps, MAX_STEPS)
        asked |= {"threads": threads, "control": control, "max_steps": most}
        return integrate(part, tableau, model, **asked)

    companions = attempt(0, 0, batch)
    # Companions tell the cost of each run, so the longest begin first and no lane
    # waits.
    runs = attempt(1, 1, batch, record=record, cost=companions.n_steps)
    now = done = with_errors(config, batch, runs, companions, pair)
    rows, part = np.arange(len(batch)), batch
    for k in range(2, len(values)):
        inaccurate = now.t_r_error > goal * now.t_r
        missed = np.isnan(now.t_r) & np.isfinite(now.companion_t_r)
        failed = ~np.isin(now.status, (Status.OK, Status.STEP_LIMIT, Status.STOPPED))
        again = ((inaccurate | missed) & (now.status == Status.OK)) | failed
        if not again.any():
            break
        control.count_ended(int((~again & (now.status != Status.STOPPED)).sum()))
        rows, before = rows[again], now.apart[again]
        part, companions = take(part, again), take(runs, again)
        runs = attempt(k, k, part, record=record, cost=companions.n_steps)
        now = with_errors(
            config, part, runs, companions, (values[k], values[k - 1]), before
        )
        put(now, done, rows)
    if turning:
        none = np.full((len(batch), MOST_REVERSALS, 2), np.nan)
        done = replace(done, reversals=none, turn_errors=none[:, :, 0].copy())
        goes_on = (done.status == Status.OK) & (done.t_end < batch.t_end)
        control.count_ended(int((~goes_on & (done.status != Status.STOPPED)).sum()))
        part, first = take(batch, goes_on), take(done, goes_on)
        companions = attempt(2, 0, part, record=turning)
        runs = attempt(3, 1, part, record=record | turning, cost=companions.n_steps)
        now = with_errors(config, part, runs, companions, pair)
        now = _with_turns(
            now, first, companions.reversals[:, :, 0], _scales(config, pair)
        )
        put(now, done, np.flatnonzero(goes_on))
    return replace(done, stopped=bool((done.status == Status.STOPPED).any()))


def ladder(config: Config) -> tuple[list[float], list[float]]:
    """Return tolerances (or steps) of companions, runs and repeated runs, and their
    costs.
    """
    settings, tableau = config.integrator, METHODS[config.integrator.method]
    if not tableau.adaptive:
        dt = settings.dt or DT
        return [companion_setting(config, dt), dt], [0.5, 1.0]
    if settings.goal is None:
        tol = settings.tol or TOL
        values = [companion_setting(config, tol), tol]
    else:
        first = min(FIRST_RUNG * settings.goal, LOOSEST_RUNG)
        rungs = {max(first * RUNG**k, TIGHTEST) for k in range(RUNGS)}
        loosest = min(fit_of(config).looser * first, LOOSEST_OF_LADDER)
        values = [loosest, *sorted(rungs, reverse=True)]
    # 1.1 for rejected steps; measured costs are 40 to 45 % at 1e-9, and 77 to 84 % at
    # 1e-6.
    companion = 1.1 * float((values[1] / values[0]) ** (1.0 / tableau.order))
    return values, [companion, 1.0, *AGAIN[: len(values) - 2]]


def companion_setting(config: Config, value: float) -> float:
    """Return the tolerance of a companion; for methods of fixed steps, twice the
    step.
    """
    if not METHODS[config.integrator.method].adaptive:
        return 2.0 * value
    return max(LEAST_LOOSER * value, min(fit_of(config).looser * value, LOOSEST))


def with_errors(
    config: Config,
    batch: Batch,
    runs: Outcome,
    companions: Outcome,
    settings: tuple[float, float],
    before: Floats | float = 0.0,
) -> Estimated:
    """Add errors to runs; `before` is the distance of the companions from their own
    companions.
    """
    model = model_of(config)
    fit, common, ratio = _scales(config, settings)
    both = np.isfinite(runs.t_r) & np.isfinite(companions.t_r)
    ok, others_ok = (x.status == Status.OK for x in (runs, companions))
    stay = ok & others_ok & np.isnan(runs.t_r) & np.isnan(companions.t_r)
    d, apart = (
        np.where(both, np.abs(companions.t_r / runs.t_r - 1.0), 1.0),
        np.ones(len(batch)),
    )
    end = both | stay
    apart[end] = distance(
        model, runs.y_end[end], companions.y_end[end], batch.constants[end]
    )
    parted, had_parted = (
        np.minimum(1.0, (s / PARTED) ** 2) for s in (apart, np.asarray(before))
    )
    carried = np.maximum(np.maximum(ratio, parted), REMEMBERED * had_parted)
    root = np.sqrt(np.maximum(runs.n_steps, 1) / 1000.0)
    # In the full dynamics the mixed curvature has the sign of K_p, and omega_z that of
    # -n.
    place, sign = (0, 1) if model.name == REDUCED.name else (4, -1)
    unsteady = sign * batch.constants[:, place] * batch.y0[:, place] >= 0
    grazes = runs.near_tangencies + companions.near_tangencies
    relative = common + fit.slope * carried * (d + fit.share * apart / root)
    relative = relative + np.where(unsteady, parted**2, 0.0)
    relative = relative + np.where(grazes > 0, 2 * np.pi / batch.swing / runs.t_r, 0.0)
    relative = np.minimum(relative, 1.0)
    t_r_error = relative * runs.t_r
    # The final amp_growth of a run that has settled lies between its value so far and
    # 0.
    pair = runs, companions
    high, high_other = (
        np.where(has_settled(batch, x), 0.0, x.amp_growth) for x in pair
    )
    below, above = runs.amp_growth - high_other, companions.amp_growth - high
    departed = DIFFER * np.abs(runs.n_departure - companions.n_departure)
    # Where the two have parted, nothing tells how much nearer to zero the spin may
    # come.
    near = stay & (apart > PARTED) & (runs.n_departure > NEAR_ZERO)
    departed = np.where(near, np.maximum(departed, 1.0 - runs.n_departure), departed)
    # If a stop ended the companion, its run has no error and counts as stopped.
    cut = companions.status == Status.STOPPED
    changed = {"status": np.where(cut, Status.STOPPED, runs.status)}
    adaptive = METHODS[config.integrator.method].adaptive
    tol, looser = (np.full(len(batch), x if adaptive else np.nan) for x in settings)
    return Estimated(
        **vars(runs) | changed,
        t_r_error=t_r_error,
        amp_growth_error=np.where(
            ok, DIFFER * np.maximum(0.0, np.maximum(below, above)), np.nan
        ),
        n_departure_error=np.where(ok & others_ok, departed, np.nan),
        reversal_sure=((relative < 1.0) & (runs.t_r + t_r_error < batch.t_end))
        | (stay & (grazes == 0)),
        tol=tol,
        companion_tol=looser,
        companion_t_r=companions.t_r,
        apart=apart,
        grazes=grazes,
        turn_errors=np.zeros((0, MOST_REVERSALS)),
        turns_sure=np.zeros(len(batch), np.int64),
    )


def distance(model: Model, y: Floats, other: Floats, constants: Floats) -> Floats:
    """Return the distance of states in the norm of the step control, relative to that
    of `y`.
    """
    change, here, q = (y - other).T, y.T, constants.T
    if model.name == REDUCED.name:
        norm: Any = model.error
        moved, size = norm.py_func(*change, *here, *q)
    else:
        # The spin is zero in both states at a reversal.
        ix, iy, _, cxx, cxy, cyy = q[:6]
        square = full.oscillation.py_func
        moved, size = (square(*v[:4], ix, iy, cxx, cxy, cyy) for v in (change, here))
    return np.asarray(np.sqrt(moved / size))


def _with_turns(
    runs: Estimated,
    first: Estimated,
    other_times: Floats,
    scales: tuple[Fit, float, float],
) -> Estimated:
    """Add errors of turns to runs to the horizon; `first` are the runs to the first
    reversal.
    """
    _, common, ratio = scales
    times, t_r = runs.reversals[:, :, 0], first.t_r[:, None]
    difference = np.abs(other_times / times - 1.0)
    there = np.isfinite(difference)
    d = np.maximum.accumulate(np.where(there, difference, 1.0), axis=1)
    relative = (
        common
        + TURN_SLOPE * np.maximum(ratio, np.minimum(1.0, (d / TURN_PARTED) ** 2)) * d
    )
    # If the spin returns after its first zero, it turns at a later zero, which is less
    # certain.
    relative[:, :1] = np.maximum(
        first.t_r_error[:, None] / t_r, times[:, :1] / t_r - 1.0
    )
    relative = np.minimum(relative, 1.0)
    names = ("t_r_error", "reversal_sure", "apart", "companion_t_r", "grazes")
    kept = {name: getattr(first, name) for name in names}
    sure = np.cumprod(there & (relative < SURE), axis=1).sum(axis=1)
    errors = np.where(there, relative * times, np.nan)
    return replace(runs, turn_errors=errors, turns_sure=sure, **kept)


def _scales(config: Config, settings: tuple[float, float]) -> tuple[Fit, float, float]:
    """Return the fit, the first term of the estimate, and (r + near r^2)^power."""
    tableau, fit = METHODS[config.integrator.method], fit_of(config)
    tol, ratio = settings[0], settings[0] / settings[1]
    if not tableau.adaptive:  # the errors of fixed steps are systematic
        tol, ratio = 0.0, ratio**tableau.order
    common = (fit.floor + fit.near * ratio) * max(tol, TIGHTEST)
    return fit, common, (ratio + fit.near * ratio**2) ** fit.power


def fit_of(config: Config) -> Fit:
    """Return the constants for the method and the model of a sweep."""
    if config.dissipation.kind == "rolling":
        return ROLLING
    return (
        ELLIPSOID
        if config.bodies.ellipsoidal
        else FITS.get(config.integrator.method, Fit())
    )
