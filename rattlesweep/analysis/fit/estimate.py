"""Searches for the least sum of squares, and what they say of the parameters."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rattlesweep.analysis.fit import doubts
from rattlesweep.analysis.fit.problem import PARAMETERS, Problem, ratio
from rattlesweep.arrays import Floats
from rattlesweep.physics.si import Units

# The size of noise is settled if it changes by less than this.
SETTLED = 1e-3
MOST_SIZES = 20
# Noise below this share of the largest value is taken as this when priors are weighed,
# since slopes are finite differences.
LEAST_NOISE = 1e-6
# Rows that are as many as the parameters they determine leave rounding errors.
LEAST_FREEDOM = 1e-6


@dataclass(frozen=True)
class Search:
    """A finished search: the parameters ``x``, and residuals and Jacobian there."""

    x: Floats
    residuals: Floats
    jacobian: Floats
    settled: bool

    @property
    def squares(self) -> float:
        """The sum of the squares of the residuals."""
        return float((self.residuals**2).sum())


def minimise(
    problem: Problem,
    x: Floats,
    accuracy: float,
    steps: int,
    free: Sequence[int] | None = None,
) -> Search:
    """Minimise the sum of squares from ``x`` on, by all parameters or the `free` ones.

    The Jacobian of the search has columns for the free parameters alone.
    """
    from scipy.optimize import least_squares

    if free is None:
        free = range(len(x))
    places = list(free)

    def whole(x_free: Floats) -> Floats:
        all_x = x.copy()
        all_x[places] = x_free
        return all_x

    def residuals(x_free: Floats) -> Floats:
        return problem.residuals(whole(x_free))

    def slopes(x_free: Floats) -> Floats:
        return problem.slopes(whole(x_free), places)

    low, high = problem.limits()
    limits = low[places], high[places]
    # The method "trf" is slow where two parameters are strongly correlated.
    result = least_squares(
        residuals,
        np.clip(x[places], *limits),
        slopes,
        limits,
        "dogbox",
        x_scale="jac",
        ftol=accuracy,
        max_nfev=steps,
    )
    # SciPy's Jacobian is of the type of `slopes`.
    jacobian = np.asarray(result.jac)
    best = whole(result.x)
    return Search(best, result.fun, jacobian, settled=result.status != 0)


@dataclass(frozen=True)
class Estimate:
    """The best parameters, and how well the data and the priors determine them."""

    problem: Problem
    search: Search
    units: Units | None  # of the fitted body

    @classmethod
    def of(cls, problem: Problem, search: Search) -> Estimate:
        """Return the estimate of a search."""
        units = problem.launched(search.x).body.units
        return cls(problem, search, units)

    @property
    def x(self) -> Floats:
        """The best parameters as the problem takes them."""
        return self.search.x

    @cached_property
    def _directions(self) -> tuple[Floats, Floats, Floats]:
        """The Jacobian with columns of length 1, their lengths, and a root of the
        covariance.
        """
        lengths = np.linalg.norm(self.search.jacobian, axis=0)
        jacobian = self.search.jacobian / np.where(lengths > 0, lengths, 1.0)
        spread, _, _ = doubts.directions_of(jacobian)
        return jacobian, lengths, spread

    @property
    def jacobian(self) -> Floats:
        """The Jacobian with columns of length 1."""
        return self._directions[0]

    @property
    def told_by_priors(self) -> Floats:
        """Share of the variance of each parameter that no noise adds to.

        It is 1 for a parameter of which the film tells nothing.
        """
        jacobian, _, spread = self._directions
        pulls = jacobian[self.problem.rows :] @ spread
        variances = (spread**2).sum(axis=1)
        of_priors = ((spread @ pulls.T) ** 2).sum(axis=1)
        return np.asarray(of_priors / variances)

    @property
    def freedom(self) -> float:
        """Number of rows less the parameters that they determine.

        A parameter that a prior determines costs no row, and a share of one if both do.
        """
        jacobian, _, spread = self._directions
        pulls = jacobian[self.problem.rows :] @ spread
        freedom = self.problem.rows - self.problem.unknowns + float((pulls**2).sum())
        return max(freedom, LEAST_FREEDOM)

    @property
    def noise(self) -> float:
        """Standard deviation of the residuals of the film, in units of the body."""
        rows = self.search.residuals[: self.problem.rows] * self.problem.errors
        return math.sqrt(float((rows**2).sum()) / self.freedom)

    def of_noise(self, noise: float) -> Estimate:
        """Return the estimate with the residuals divided by another noise."""
        residuals = self.search.residuals.copy()
        jacobian = self.search.jacobian.copy()
        residuals[: self.problem.rows] *= self.problem.noise / noise
        jacobian[: self.problem.rows] *= self.problem.noise / noise
        search = replace(self.search, residuals=residuals, jacobian=jacobian)
        return replace(self, problem=replace(self.problem, noise=noise), search=search)

    @property
    def standard_errors(self) -> Floats:
        """Standard errors of ``x``."""
        _, lengths, spread = self._directions
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.linalg.norm(spread, axis=1) / lengths)

    @property
    def quantiles(self) -> Floats:
        """Half the width of each 95 % interval, in standard errors."""
        from scipy.stats import t as student

        freedom = np.full(len(self.x), np.inf)
        if self.problem.film.error is None:
            # Welch and Satterthwaite: only the part of noise has a size that is
            # estimated from the residuals.
            of_noise = 1 - self.told_by_priors
            with np.errstate(divide="ignore"):
                freedom = self.freedom / of_noise**2
        return np.asarray(student.ppf(0.975, freedom))

    @property
    def correlations(self) -> Floats:
        """Correlations of the parameters."""
        _, _, spread = self._directions
        directions = spread / np.linalg.norm(spread, axis=1)[:, None]
        return np.asarray(directions @ directions.T)

    @property
    def covariance(self) -> Floats:
        """Covariance of the parameters in the units of :meth:`values`."""
        _, lengths, spread = self._directions
        best = self.values(self.x)
        linear = self.values(np.ones(len(self.x)))
        sizes = []
        for name in best:
            # d exp(x) / dx is exp(x) itself.
            size = best[name] if name == "omega_xy0" else linear[name]
            sizes.append(size)
        with np.errstate(divide="ignore", invalid="ignore"):
            root = spread * (np.array(sizes) / lengths)[:, None]
        return root @ root.T

    def values(self, x: Floats) -> dict[str, float]:
        """Return the parameters at ``x`` in the units of the fitted body."""
        given = self.problem.launch.body.units
        return {
            name: ratio(PARAMETERS[name].unit, given, self.units) * value
            for name, value in self.problem.values(x).items()
        }


def settle_noise(problem: Problem, search: Search, steps: int) -> Estimate:
    """Return the estimate of a search with the noise that its residuals have.

    Priors weigh the more, the larger the noise is, so the search is repeated with them
    until the noise settles.
    """
    estimate = Estimate.of(problem, search)
    if problem.film.error is not None:
        return estimate
    if not problem.priors:
        return estimate.of_noise(max(estimate.noise, sys.float_info.min))
    for _ in range(MOST_SIZES):
        noise = max(estimate.noise, LEAST_NOISE * problem.film.size)
        change = abs(noise / problem.noise - 1)
        problem = replace(problem, noise=noise)
        if change < SETTLED:
            break
        search = minimise(problem, search.x, 1e-8, steps)
        estimate = Estimate.of(problem, search)
    return estimate.of_noise(noise)
