"""Chi squared along one parameter, with all others fitted at each of its values."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import pandas as pd

from rattlesweep.analysis.fit.doubts import directions_of
from rattlesweep.analysis.fit.estimate import Estimate, Searchable, minimise
from rattlesweep.arrays import Floats
from rattlesweep.words.errors import ConfigWarning

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Step of the square root of the increase of chi squared, which is nearly linear in the
# parameter.
_STEP = 0.4
# A profile ends where this root is larger than at the end of the interval by a factor.
_BEYOND = 1.3
MOST_PROFILE_POINTS = 40  # on each side
# Most and least step as a share of the range of a parameter: where chi squared is flat,
# a longer one would pass over the end of the interval.
_WIDEST = 0.05
_NARROWEST = 0.005
_MOST_STEPS = 30  # of a search
_TINY = 1e-100
_CLOSE = 1e-3  # of the ends of the interval, in standard errors
# A decrease of chi squared by which another fit is better, and not the same again.
BETTER = 0.05


class ProfilePoint(NamedTuple):
    """The best parameters at one value of one of them."""

    x: Floats
    # Of the increase of chi squared; infinite where no run succeeds.
    root: float
    # Standard errors of the others at this value, zero of the parameter itself.
    errors: Floats


class Fitted(Protocol):
    """The best parameters of one film or of several, and how well they are known."""

    @property
    def problem(self) -> Searchable:
        """The residuals."""

    @property
    def x(self) -> Floats:
        """The best parameters."""

    @property
    def squares(self) -> float:
        """The least sum of squares."""

    @property
    def standard_errors(self) -> Floats:
        """Standard errors of ``x``."""

    @property
    def quantiles(self) -> Floats:
        """Half the width of each 95 % interval, in standard errors."""


@dataclass(frozen=True)
class Profile:
    """Searches along the parameter at one place of ``x``."""

    estimate: Fitted
    place: int

    @property
    def quantile(self) -> float:
        """Root of the increase of chi squared at the ends of the 95 % interval."""
        return float(self.estimate.quantiles[self.place])

    def at(self, value: float, start: Floats) -> ProfilePoint:
        """Return the best parameters at a value; the search begins at ``start``."""
        problem = self.estimate.problem
        x = start.copy()
        x[self.place] = value
        others = [place for place in range(len(x)) if place != self.place]
        errors = np.zeros(len(x))
        residuals = problem.residuals(x)
        if not np.isfinite(residuals).all():
            return ProfilePoint(x, math.inf, errors)
        if others:
            search = minimise(problem, x, 1e-8, _MOST_STEPS, others)
            x = search.x
            residuals = search.residuals
            lengths = np.maximum(np.linalg.norm(search.jacobian, axis=0), _TINY)
            spread, _, _ = directions_of(search.jacobian / lengths)
            errors[others] = np.linalg.norm(spread, axis=1) / lengths
        increase = float((residuals**2).sum()) - self.estimate.squares
        # A decrease, where the fit was not the best, is a negative root.
        return ProfilePoint(
            x, math.copysign(math.sqrt(abs(increase)), increase), errors
        )

    def side(self, sign: int) -> list[ProfilePoint]:
        """Return points from the best fit on, in steps of the root of chi squared."""
        place = self.place
        limits = self.estimate.problem.limits()
        best = self.estimate.x
        limit = limits[int(sign > 0)][place]
        # Where the data tell nothing, a step is a share of the range.
        error = self.estimate.standard_errors[place]
        width = float(limits[1][place] - limits[0][place])
        step = min(_STEP * error, _WIDEST * width)
        points = [self.at(best[place], best)]
        slope = np.zeros(len(best))
        while len(points) <= MOST_PROFILE_POINTS and points[-1].x[place] != limit:
            last = points[-1]
            value = last.x[place] + sign * step
            if sign * value > sign * limit:
                value = limit
            # The other parameters change along a nearly straight line.
            distance = abs(value - last.x[place])
            point = self.at(value, np.clip(last.x + slope * distance, *limits))
            if not math.isfinite(point.root):
                step /= 2
                if step < _NARROWEST * width:
                    break
                continue
            points.append(point)
            if point.root > _BEYOND * self.quantile:
                break
            slope = (point.x - last.x) / distance
            rise = max(point.root - last.root, _STEP / 2)
            step = min(step * _STEP / rise, _WIDEST * width)
        return points

    def end(self, points: list[ProfilePoint]) -> ProfilePoint:
        """Return the end of the 95 % interval between points of one side, or the last.

        The last point is that at the limit of the parameter if the interval reaches it.
        """
        from scipy.optimize import brentq

        place = self.place
        for inner, outer in pairwise(points):
            if inner.root < self.quantile <= outer.root:
                break
        else:
            return points[-1]
        distance = outer.x[place] - inner.x[place]

        def between(value: float) -> ProfilePoint:
            share = (value - inner.x[place]) / distance
            return self.at(value, inner.x + share * (outer.x - inner.x))

        value = brentq(
            lambda value: between(value).root - self.quantile,
            inner.x[place],
            outer.x[place],
            xtol=_CLOSE * abs(distance),
        )
        return between(value)


def ends_by_profile(estimate: Fitted, place: int) -> tuple[Floats, Floats]:
    """Return ``x`` at both ends of the 95 % interval of a parameter by its profile."""
    profile = Profile(estimate, place)
    low, high = (profile.end(profile.side(sign)) for sign in (-1, 1))
    return low.x, high.x


def ranges_along(estimate: Fitted, place: int) -> tuple[Floats, Floats]:
    """Return the ends of the 95 % intervals of all ``x`` along one of them.

    At each of its values, the others have an interval of their own, which is the
    narrower, the higher chi squared is there.  The ends are those of all together.
    """
    profile = Profile(estimate, place)
    points = [point for sign in (-1, 1) for point in profile.side(sign)]
    low = np.full(len(estimate.x), math.inf)
    high = -low
    for point in points:
        left = estimate.quantiles**2 - point.root * abs(point.root)
        reach = point.errors * np.sqrt(np.maximum(left, 0.0))
        is_within = left >= 0
        low = np.where(is_within, np.minimum(low, point.x - reach), low)
        high = np.where(is_within, np.maximum(high, point.x + reach), high)
    return low, high


def profile_of(estimate: Estimate, name: str) -> pd.DataFrame:
    """Return the table of :meth:`Fit.profile`."""
    profile = Profile(estimate, list(estimate.problem.scales).index(name))
    sides = [profile.side(sign) for sign in (-1, 1)]
    ends = [profile.end(points) for points in sides]
    points = {point.x[profile.place]: point for point in (*sides[0], *sides[1], *ends)}
    ordered = [points[value] for value in sorted(points)]
    table = pd.DataFrame([estimate.values(point.x) for point in ordered])
    # A decrease is a negative root.
    increase = [point.root * abs(point.root) for point in ordered]
    table.insert(0, name, table.pop(name))
    table.insert(1, "delta_chi_squared", increase)
    table.attrs["threshold"] = profile.quantile**2
    low, high = (estimate.values(end.x)[name] for end in ends)
    table.attrs["interval"] = (low, high)
    lowest = int(np.argmin(increase))
    if increase[lowest] < -BETTER:
        warnings.warn(
            f"profile: chi squared is lower by {-increase[lowest]:.3g} than at the fit "
            f"where {name} is {table[name][lowest]:.6g}; fit again from there",
            ConfigWarning,
            stacklevel=3,
        )
    return table


def draw_profile(
    estimate: Estimate,
    table: pd.DataFrame,
    size: float,
    unit: str,
    path: str | Path | None = None,
) -> Figure:
    """Return the figure of a profile, in units of a `size`."""
    from rattlesweep.analysis import room, style
    from rattlesweep.analysis.onerun.figure import shown

    name = str(table.columns[0])
    place = list(estimate.problem.scales).index(name)
    best = size * estimate.values(estimate.x)[name]
    low, high = (size * end for end in table.attrs["interval"])
    threshold = table.attrs["threshold"]
    values = size * table[name].to_numpy()
    increase = table.delta_chi_squared.to_numpy()

    # Between the points, the root of chi squared is nearly straight.
    line = np.linspace(values[0], values[-1], 400)
    roots = np.sign(values - best) * np.sqrt(np.maximum(increase, 0))
    curve = np.interp(line, values, roots) ** 2
    # The parabola is one in ``x``, as the interval of the covariance.
    parabola_roots = np.linspace(roots[0], roots[-1], 400)
    parabola = []
    for root in parabola_roots:
        x = estimate.x.copy()
        x[place] += root * estimate.standard_errors[place]
        parabola.append(size * estimate.values(x)[name])
    dots: dict[str, Any] = {"marker": ".", "markersize": 4, "linestyle": "none"}
    ends: dict[str, Any] = {"color": style.VERMILION, "linewidth": 1.0}
    with style.styled():
        figure = room.usual_figure(4.6, 3.2)
        axes = figure.subplots()
        axes.plot(line, curve, color=style.BLUE, label="profile", linewidth=1.2)
        axes.plot(values, increase, color=style.BLUE, **dots)
        axes.plot(parabola, parabola_roots**2, label="covariance", **style.THEORY)
        axes.hlines(threshold, low, high, label="95 %", **ends)
        axes.vlines([low, high], 0, threshold, **ends)
        axes.set(xlim=(values[0], values[-1]), ylim=(0, 1.03 * increase.max()))
        axes.set_xlabel(style.label(name, unit))
        axes.set_ylabel(r"increase of $\chi^2$")
        interval = f"95 %: {low:.4g} to {high:.4g} {unit}"
        style.add_legend(figure, axes.get_legend_handles_labels()[0], [interval])
        style.light_grid(axes)
        return shown(figure, path)
