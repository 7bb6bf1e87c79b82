"""Searches for the least sum of squares, and what they say of the parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from rattlesweep.analysis.fit import doubts
from rattlesweep.analysis.fit.problem import FITTABLE, FitProblem, ratio
from rattlesweep.arrays import Floats
from rattlesweep.physics.si import Units

# The size of noise is settled if it changes by less than this.
_SETTLED = 1e-3
_MOST_SIZES = 20
# Noise below this share of the largest value is taken as this when priors are weighed,
# since slopes are finite differences.
LEAST_NOISE = 1e-6
# Rows that are as many as the parameters they determine leave rounding errors.
LEAST_FREEDOM = 1e-6
_TINY = 1e-100
# A search has not ended if a step promises a decrease of chi squared above this.
PROMISED = 1e-9
MOST_POLISH = 10
# Share of the change of residuals that a Jacobian may miss in a step and serve again.
FORESEEN = 0.2
RIVAL = 0.99  # confidence with which another valley is excluded
ELSEWHERE = 3.0  # rise of the parabola over that of a valley that is not excluded


@dataclass(frozen=True)
class Searched:
    """A finished search: the parameters ``x``, and residuals and Jacobian there."""

    x: Floats
    residuals: Floats
    jacobian: Floats
    settled: bool

    @property
    def squares(self) -> float:
        """The sum of the squares of the residuals."""
        return float((self.residuals**2).sum())


class Searchable(Protocol):
    """Residuals that a search makes small: those of one film, or of several."""

    def residuals(self, x: Floats) -> Floats:
        """Return the residuals over their standard errors."""

    def limits(self) -> tuple[Floats, Floats]:
        """Return the lowest and the highest ``x``."""

    def rough_slopes(self, x: Floats, here: Floats, places: Sequence[int]) -> Floats:
        """Return columns of the Jacobian where the residuals are `here`."""


def minimise(
    problem: Searchable,
    x: Floats,
    accuracy: float,
    steps: int,
    free: Sequence[int] | None = None,
    softened: float | None = None,
    again: int = 0,
) -> Searched:
    """Minimise the sum of squares from ``x`` on, by all parameters or the `free` ones.

    A search that has not settled after a number of `steps` begins `again` so many times
    where it has come to: along a narrow valley its corrected Jacobian becomes rough.

    The Jacobian of the search has columns for the free parameters alone.  Residuals
    that are larger than `softened` count by their size and not by its square (SciPy's
    loss "soft_l1").
    """
    from scipy.optimize import least_squares

    if free is None:
        free = range(len(x))
    slopes = _Slopes(problem, x, list(free))
    low, high = problem.limits()
    limits = low[slopes.places], high[slopes.places]
    # The method "trf" is slow where two parameters are strongly correlated.
    result = least_squares(
        slopes.residuals,
        np.clip(x[slopes.places], *limits),
        slopes,
        limits,
        "dogbox",
        x_scale="jac",
        ftol=accuracy,
        max_nfev=steps,
        loss="linear" if softened is None else "soft_l1",
        f_scale=softened or 1.0,
    )
    # SciPy's Jacobian is of the type of `slopes`.
    jacobian = np.asarray(result.jac)
    best = slopes.whole(result.x)
    settled = result.status != 0
    if again and not settled:
        return minimise(problem, best, accuracy, steps, free, softened, again - 1)
    return Searched(best, result.fun, jacobian, settled)


class _Slopes:
    """The Jacobian along a search, by differences only where it has changed much.

    Where it has nearly told the change of the residuals in a step, it is corrected so
    that it would have told it (Broyden 1965), which takes no trial.
    """

    def __init__(self, problem: Searchable, x: Floats, places: list[int]) -> None:
        self.problem = problem
        self.places = places
        self._x = x
        self._seen: dict[bytes, Floats] = {}
        # Where the last Jacobian was asked for, the residuals there, and itself.
        self._last: tuple[Floats, Floats, Floats] | None = None

    def whole(self, x_free: Floats) -> Floats:
        """Return all parameters."""
        all_x = self._x.copy()
        all_x[self.places] = x_free
        return all_x

    def residuals(self, x_free: Floats) -> Floats:
        """Return the residuals, which are kept for the Jacobian at the same place."""
        residuals = self.problem.residuals(self.whole(x_free))
        self._seen[x_free.tobytes()] = residuals
        return residuals

    def __call__(self, x_free: Floats) -> Floats:
        """Return the Jacobian at the last place of the search."""
        here = self._seen.get(x_free.tobytes())
        self._seen.clear()
        if here is None:
            # The search has moved a parameter onto its limit, by a rounding error.
            here = self.problem.residuals(self.whole(x_free))
        jacobian = self._corrected(x_free, here)
        if jacobian is None:
            whole = self.whole(x_free)
            jacobian = self.problem.rough_slopes(whole, here, self.places)
        self._last = x_free.copy(), here.copy(), jacobian
        # A softened search changes what it is given.
        return jacobian.copy()

    def _corrected(self, x_free: Floats, here: Floats) -> Floats | None:
        """Return the corrected Jacobian, None where it told too little."""
        if self._last is None:
            return None
        x, residuals, jacobian = self._last
        step = x_free - x
        change = here - residuals
        missed = change - jacobian @ step
        if not np.linalg.norm(missed) < FORESEEN * np.linalg.norm(change):
            return None
        return jacobian + np.outer(missed, step) / (step @ step)


def promised(search: Searched) -> tuple[Floats, float]:
    """Return the step to the minimum if the residuals were straight lines.

    Also return the decrease of the sum of squares that it promises.
    """
    lengths = np.maximum(np.linalg.norm(search.jacobian, axis=0), _TINY)
    jacobian = search.jacobian / lengths
    spread, _, _ = doubts.directions_of(jacobian)
    pulls = jacobian @ spread
    along = pulls.T @ search.residuals
    return -(spread @ along) / lengths, float((along**2).sum())


def polish(problem: FitProblem, search: Searched) -> Searched:
    """Return a search that goes on until no step promises a lower sum of squares.

    SciPy's stops early where two parameters go together, and its Jacobian is rough;
    that of the result is by central differences.
    """
    search = replace(search, jacobian=problem.slopes(search.x))
    for _ in range(MOST_POLISH):
        step, decrease = promised(search)
        if decrease < PROMISED * search.squares / max(problem.freedom, 1):
            return search
        limits = problem.limits()
        trials = [
            np.clip(search.x + factor * step, *limits) for factor in (1.0, 0.3, 0.1)
        ]
        residuals = problem.residuals_at(trials)
        squares = [float((each**2).sum()) for each in residuals]
        best = int(np.argmin(squares))
        if not squares[best] < search.squares:
            return search
        x = trials[best]
        search = Searched(x, residuals[best], problem.slopes(x), search.settled)
    return search


@dataclass(frozen=True)
class Estimate:
    """The best parameters, and how well the data and the priors determine them."""

    problem: FitProblem
    search: Searched
    units: Units | None  # of the fitted body
    jacobian: Floats  # with columns of length 1
    root: Floats  # R of the covariance R R^T of ``x``
    # Rows less the parameters that they determine: one that a prior determines costs no
    # row, and one that both determine a share of a row.
    freedom: float
    # Share of the variance of each parameter that comes from noise, not from priors.
    noise_shares: Floats

    @classmethod
    def of(cls, problem: FitProblem, search: Searched) -> Estimate:
        """Return the estimate of a finished search."""
        # A parameter that changes no residual has a huge variance, not an infinite one.
        lengths = np.maximum(np.linalg.norm(search.jacobian, axis=0), _TINY)
        jacobian = search.jacobian / lengths
        spread, _, _ = doubts.directions_of(jacobian)
        pulls = jacobian[problem.rows :] @ spread
        freedom = problem.rows - problem.unknowns + float((pulls**2).sum())
        of_priors = ((spread @ pulls.T) ** 2).sum(axis=1)
        return cls(
            problem,
            search,
            problem.launched(search.x).body.units,
            jacobian,
            spread / lengths[:, None],
            max(freedom, LEAST_FREEDOM),
            1 - of_priors / (spread**2).sum(axis=1),
        )

    @property
    def x(self) -> Floats:
        """The best parameters as the problem takes them."""
        return self.search.x

    @property
    def noise(self) -> float:
        """Standard deviation of the residuals of the film, in units of the body."""
        rows = self.search.residuals[: self.problem.rows] * self.problem.errors
        return math.sqrt(float((rows**2).sum()) / self.freedom)

    def of_noise(self, noise: float) -> Estimate:
        """Return the estimate with the residuals divided by another noise."""
        factors = np.ones(len(self.search.residuals))
        factors[: self.problem.rows] = self.problem.noise / noise
        search = replace(
            self.search,
            residuals=self.search.residuals * factors,
            jacobian=self.search.jacobian * factors[:, None],
        )
        return Estimate.of(replace(self.problem, noise=noise), search)

    @property
    def squares(self) -> float:
        """The least sum of squares."""
        return self.search.squares

    @property
    def standard_errors(self) -> Floats:
        """Standard errors of ``x``."""
        return np.asarray(np.linalg.norm(self.root, axis=1))

    @property
    def quantiles(self) -> Floats:
        """Half the width of each 95 % interval, in standard errors."""
        # As in `scipy.stats`, which takes longer to import.
        from scipy.special import stdtrit

        freedom = np.full(len(self.x), np.inf)
        if self.problem.film.error is None:
            # Welch and Satterthwaite: only noise has a size that is estimated.
            with np.errstate(divide="ignore"):
                freedom = self.freedom / self.noise_shares**2
        return np.asarray(stdtrit(freedom, 0.975))

    @property
    def half_widths(self) -> Floats:
        """Half the widths of the 95 % intervals of ``x``."""
        return self.standard_errors * self.quantiles

    @property
    def ends(self) -> list[Floats]:
        """The best ``x`` at both ends of each interval, if residuals were straight."""
        along = self.root @ self.root.T / self.standard_errors
        steps = (along * self.quantiles).T
        return [self.x + sign * step for step in steps for sign in (-1.0, 1.0)]

    @property
    def correlations(self) -> Floats:
        """Correlations of the parameters."""
        directions = self.root / self.standard_errors[:, None]
        return np.asarray(directions @ directions.T)

    @property
    def covariance(self) -> Floats:
        """Covariance of the parameters in the units of :meth:`values`."""
        slopes = self.values(np.ones(len(self.x)))
        if "omega_xy0" in slopes:
            # The slope of an exponential function is its value.
            slopes["omega_xy0"] = self.values(self.x)["omega_xy0"]
        root = self.root * np.array([*slopes.values()])[:, None]
        return np.asarray(root @ root.T)

    def values(self, x: Floats) -> dict[str, float]:
        """Return the parameters at ``x`` in the units of the fitted body."""
        given = self.problem.launch.body.units
        return {
            name: ratio(FITTABLE[name].unit, given, self.units) * value
            for name, value in self.problem.values(x).items()
        }


def rises_of(estimate: Estimate) -> tuple[Floats, list[Floats]]:
    """Return how chi squared rises to the ends of the intervals, and these.

    A rise of 1 is that of a parabola.  Where an end is beyond the limit of a parameter,
    it is 1 as well.
    """
    problem = estimate.problem
    low, high = problem.limits()
    ends = estimate.ends
    residuals = problem.residuals_at([np.clip(x, low, high) for x in ends])
    rises = np.ones(len(ends))
    expected = np.repeat(estimate.quantiles**2, 2)
    for place, x in enumerate(ends):
        if (low <= x).all() and (x <= high).all():
            squares = float((residuals[place] ** 2).sum())
            rises[place] = (squares - estimate.search.squares) / expected[place]
    return rises, ends


def rivals_of(estimate: Estimate, searches: Sequence[Searched]) -> list[Searched]:
    """Return searches in other valleys that the data cannot exclude, best first.

    Chi squared is low there, although the parabola of the estimate is high.
    """
    from scipy.special import chdtri, fdtri

    unknowns = len(estimate.x)
    lowest = min(search.squares for search in searches)
    if estimate.problem.film.error is not None:
        rise = float(chdtri(unknowns, 1 - RIVAL))
        highest = lowest + rise
    else:
        freedom = max(estimate.freedom, 1.0)
        rise = unknowns * float(fdtri(unknowns, freedom, RIVAL))
        # The searches do not know the noise.
        highest = lowest * (1 + rise / freedom)
    rivals = []
    for search in searches:
        changes = estimate.search.jacobian @ (search.x - estimate.x)
        is_elsewhere = float((changes**2).sum()) > ELSEWHERE * rise
        if is_elsewhere and search.squares < highest:
            rivals.append(search)
    return sorted(rivals, key=lambda search: search.squares)


def settle_noise(problem: FitProblem, search: Searched, steps: int) -> Estimate:
    """Return the estimate of a search with the noise that its residuals have.

    Priors weigh the more, the larger the noise is, so the search is repeated with them
    until the noise settles.
    """
    estimate = Estimate.of(problem, search)
    if problem.film.error is not None:
        return estimate
    if not problem.priors:
        return estimate.of_noise(max(estimate.noise, _TINY))
    for _ in range(_MOST_SIZES):
        noise = max(estimate.noise, LEAST_NOISE * problem.film.size)
        change = abs(noise / problem.noise - 1)
        problem = replace(problem, noise=noise)
        if change < _SETTLED:
            break
        search = polish(problem, minimise(problem, search.x, 1e-8, steps))
        estimate = Estimate.of(problem, search)
    return estimate.of_noise(noise)
