"""The error of every reversal time, from a companion: the same run, integrated more loosely.

With d = abs(t_r'/t_r - 1), where t_r' is the companion's, and s the distance of the two states at
their reversals in the norm of the step control,

    t_r_error / t_r = (floor + near r) tol + slope T (d + share s / sqrt(N)) + G,
    T = max(r, min(1, (s / PARTED)^2)),   r = tol / tol',   N = n_steps / 1000,

at most 1, which it is where the companion does not reverse.  The first term is the common size of
the error, and more where the companion is hardly looser and so tells less.  The second carries the
difference over to the tighter tolerance: in proportion as long as the two have stayed together (s
small), and in full once they have parted.  d alone is small by chance too often; s, which has
several components, is not.  G is one swing of the spin if an extremum of it touches zero within the
tolerance (`near_tangencies`).

How far that holds is measured by ``benchmarks/errors.py``, which also finds the constants again
after a change of the integrator; docs/sensitive.md says what the runs are that part.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rattlesweep.integrate.batch import Batch, Control, Outcome, integrate
from rattlesweep.integrate.defaults import DT, MAX_STEPS, TOL
from rattlesweep.integrate.model import REDUCED
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.physics import full
from rattlesweep.sweeps.cases.launches import model_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.integrate.model import Model
    from rattlesweep.sweeps.config.schema import Config, Integrator

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]


class Fit(NamedTuple):
    """Constants of the estimate.

    Fitted to cover 99.5 % of the runs of each of four mixes at tolerances of 1e-6, 1e-9 and 1e-12,
    with the least overestimate (``benchmarks/errors.py --fit``): of 44,852 runs 99.54 to 100 % are
    covered, at 13 to 29 times the true error in the median.
    """

    floor: float = 0.5
    near: float = 10.0
    slope: float = 8.0
    share: float = 0.0007


FITS = {"dop853": Fit(), "verner98": Fit(floor=0.2), "rk4": Fit(floor=0.0, share=0.003)}
"""By method: how far the error of a step stays below what the control allows differs."""
LOOSER, LOOSEST = 2e3, 1e-5
"""Tolerance of a companion in units of the run's, and the loosest: beyond, most runs part."""
LEAST_LOOSER = 10.0
"""The least ratio of the two, for tolerances near the loosest."""
TIGHTEST = 1e-14
"""Tolerance below which the error of a step is rounding."""
PARTED = 0.2
"""Distance at which two runs have nothing to do with each other any more."""
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
        Whether a run that reverses does so before its horizon for any error of this size.
    """

    t_r_error: Floats
    amp_growth_error: Floats
    n_departure_error: Floats
    reversal_sure: Flags


def companion_setting(method: str, value: float) -> float:
    """Setting of the companion of runs: a tolerance, or twice the step of a fixed-step method."""
    if not METHODS[method].adaptive:
        return 2.0 * value
    return max(LEAST_LOOSER * value, min(LOOSER * value, LOOSEST))


def scales(method: str, value: float) -> tuple[float, float]:
    """Expected ratio of the errors of a run and its companion, and the tolerance of the run.

    0 stands for the tolerance of a fixed step, whose errors do not add up at random.
    """
    tableau = METHODS[method]
    if not tableau.adaptive:
        return 2.0**-tableau.order, 0.0
    return value / companion_setting(method, value), value


def companion_price(settings: Integrator) -> float:
    """Expected cost of the companions, in units of that of the runs."""
    tableau = METHODS[settings.method]
    if not tableau.adaptive:
        return 0.5
    ratio, _ = scales(settings.method, settings.tol or TOL)
    # The other tenth is lost in rejected steps: 40 to 45 % at 1e-9, 77 to 84 % at 1e-6.
    return 1.1 * float(ratio ** (1.0 / tableau.order))


def integrate_companions(
    config: Config, batch: Batch, threads: int | None, control: Control
) -> Outcome:
    """Integrate the companions of runs.

    To be done before the runs themselves: whenever these are stopped, those that have ended have
    their errors.  `control` stops it, but counts the runs alone.
    """
    settings = config.integrator
    return integrate(
        batch,
        METHODS[settings.method],
        model_of(config),
        tol=companion_setting(settings.method, settings.tol or TOL),
        dt=companion_setting(settings.method, settings.dt or DT),
        # A run that is done again under another limit must get the same error.
        max_steps=max(settings.max_steps, MAX_STEPS),
        threads=threads,
        control=control.of_companion(),
    )


def with_errors(config: Config, batch: Batch, runs: Outcome, companions: Outcome) -> Estimated:
    """Add to the outcome of runs the errors that their companions tell."""
    settings = config.integrator
    ratio, tol = scales(settings.method, settings.tol or settings.dt or TOL)
    fit = FITS.get(settings.method, Fit())
    relative = relative_error(batch, model_of(config), runs, companions, ratio, tol, fit)
    t_r_error = relative * runs.t_r
    ok = runs.status == Status.OK
    growth, departure = (
        np.where(ok, DIFFER * np.abs(one - other), np.nan)
        for one, other in (
            (runs.amp_growth, companions.amp_growth),
            (runs.n_departure, companions.n_departure),
        )
    )
    # A companion that failed has numbers, but says nothing; one that reversed says R.
    departure[companions.status != Status.OK] = np.nan
    # Where a stop has kept a companion from its end, the run has not been either.
    cut = companions.status == Status.STOPPED
    runs = replace(
        runs,
        status=np.where(cut, Status.STOPPED, runs.status),
        stopped=runs.stopped or companions.stopped,
    )
    return Estimated(
        **{part.name: getattr(runs, part.name) for part in fields(Outcome)},
        t_r_error=t_r_error,
        amp_growth_error=growth,
        n_departure_error=departure,
        reversal_sure=(relative < 1.0) & (runs.t_r + t_r_error < batch.t_end),
    )


def relative_error(
    batch: Batch,
    model: Model,
    runs: Outcome,
    companions: Outcome,
    ratio: float,
    tol: float,
    fit: Fit,
) -> Floats:
    """Estimate of ``abs(t_r / true - 1)``, NaN where there is no ``t_r``.

    `ratio` and `tol` are the two `scales`.
    """
    known = np.isfinite(runs.t_r)
    both = known & np.isfinite(companions.t_r)
    d, s = np.ones((2, len(known)))
    d[both] = np.abs(companions.t_r[both] / runs.t_r[both] - 1.0)
    s[both] = distance(model, runs.y_end[both], companions.y_end[both], batch.constants[both])
    carried = np.maximum(ratio, np.minimum(1.0, (s / PARTED) ** 2))
    thousands = np.maximum(runs.n_steps, 1) / 1000.0
    grazing = runs.near_tangencies + companions.near_tangencies > 0
    estimate = (
        (fit.floor + fit.near * ratio) * max(tol, TIGHTEST)
        + fit.slope * carried * (d + fit.share * s / np.sqrt(thousands))
        + np.where(grazing, 2 * np.pi / batch.swing / runs.t_r, 0.0)
    )
    return np.where(known, np.minimum(estimate, 1.0), np.nan)


def distance(model: Model, y: Floats, other: Floats, constants: Floats) -> Floats:
    """Distance of states relative to the oscillation in ``y``, in the norm of the step control.

    Arrays have the shapes (runs, n_state), twice, and (runs, n_constants).
    """
    change, here, q = (y - other).T, y.T, constants.T
    if model.name == REDUCED.name:
        norm: Any = model.error
        moved, size = norm.py_func(*change, *here, *q)
    else:
        # At a reversal the spin itself is zero in both.
        ix, iy, _, cxx, cxy, cyy = q
        square = full.oscillation.py_func
        moved, size = (square(*v[:4], ix, iy, cxx, cxy, cyy) for v in (change, here))
    return np.asarray(np.sqrt(moved / size))
