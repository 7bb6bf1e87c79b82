"""One fit to several films of a stone: each has its launch, and the rest is shared.

Each film is fitted alone first, which finds its valley and its noise.  From there one
search fits all films, whose residuals are divided by the noise of their film.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.analysis.fit import doubts
from rattlesweep.analysis.fit.measured import of_body
from rattlesweep.analysis.fit.problem import FITTABLE, FitProblem
from rattlesweep.analysis.fit.profile import ends_by_profile, ranges_along
from rattlesweep.analysis.fit.result import Fit, unit_for_people
from rattlesweep.arrays import Floats
from rattlesweep.words.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd
    from matplotlib.figure import Figure

    from rattlesweep.physics.si import Units

OF_LAUNCH = ("n_i", "omega_xy0", "psi_deg", "base_phase")
_MOST_STEPS = 60
# Shared values of two films differ by so many standard errors with a probability of
# less than a percent, also if there are several.
APART = 4.0


@dataclass(frozen=True, repr=False)
class JointFit:
    """The result of a fit to several films, in the units of the body that was given.

    Names of a launch have the number of their film, such as ``n_i_2``.  `intervals` are
    95 % intervals, and `alone` are the fits of each film alone.

    Stability: may change.
    """

    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    covariance: pd.DataFrame
    alone: list[Fit]
    rows: int
    dof: float
    remarks: list[str]
    _units: Units | None
    _expected: list[Floats]

    @property
    def table(self) -> pd.DataFrame:
        """Value, 95 % interval, unit for people and meaning of each parameter."""
        import pandas as pd

        rows = {}
        for name, value in self.values.items():
            plain = _plain(name)
            size, unit = unit_for_people(plain, self._units)
            low, high = self.intervals[name]
            meaning = FITTABLE[plain].description
            if plain != name:
                meaning += f", film {name.rpartition('_')[2]}"
            rows[name] = size * value, size * low, size * high, unit, meaning
        columns = ["value", "low", "high", "unit", "meaning"]
        return pd.DataFrame.from_dict(rows, orient="index", columns=columns)

    @property
    def means_something(self) -> bool:
        """Whether the runs follow the data; if not, the values mean nothing."""
        return all(fit.means_something for fit in self.alone)

    @property
    def table_as_text(self) -> str:
        """The table as the command prints it."""
        return self.table.to_string(float_format="{:.5g}".format, na_rep="-")

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw data, fit and residuals of all films, and write them to a `path`."""
        from rattlesweep.analysis.fit.pictures import draw_films

        films = [fit._estimate.problem.film for fit in self.alone]
        return draw_films(films, self._expected, path)

    def __repr__(self) -> str:
        return "\n".join([self.table_as_text, *self.lines_below])

    def _repr_html_(self) -> str:
        from html import escape

        parts = [self.table.to_html(float_format="{:.5g}".format)]
        parts += [f"<p>{escape(line)}</p>" for line in self.lines_below]
        return "\n".join(parts)

    @property
    def lines_below(self) -> list[str]:
        """The lines below the table: rows, noise of each film, and warnings."""
        noises = ", ".join(f"{fit.noise:.3g} {fit.noise_unit}" for fit in self.alone)
        lines = [f"{len(self.alone)} films, {self.rows} rows, noise {noises}"]
        return lines + [f"warning: {remark}" for remark in self.remarks]


def _plain(name: str) -> str:
    """Return the name of a parameter without the number of its film."""
    stem, _, number = name.rpartition("_")
    return stem if number.isdigit() and stem in OF_LAUNCH else name


@dataclass(frozen=True)
class Together:
    """Where the parameters of each film are among all: the launches, then the rest."""

    problems: list[FitProblem]
    shared: list[str]
    own: list[str]

    @property
    def names(self) -> list[str]:
        """The names of all parameters."""
        count = len(self.problems)
        numbered = [f"{name}_{film + 1}" for film in range(count) for name in self.own]
        return [*numbered, *self.shared]

    def places(self, film: int) -> list[int]:
        """Return the places of a film's parameters, in the order of its problem."""
        names = self.names
        return [
            names.index(name if name in self.shared else f"{name}_{film + 1}")
            for name in self.problems[film].scales
        ]

    def is_given(self, name: str) -> bool:
        """Return whether a parameter was measured otherwise, with an error."""
        return any(_plain(name) in problem.priors for problem in self.problems)

    def spin_of(self, x: Floats, name: str) -> float:
        """Return the size of the spin of the film that a parameter is of."""
        film = int(name.rpartition("_")[2]) - 1
        problem = self.problems[film]
        values = problem.values(x[self.places(film)])
        return abs(values.get("n_i", problem.launch.n_i or math.inf))

    def residuals(self, x: Floats) -> Floats:
        """Return the residuals of all films over their noise."""
        parts = [
            problem.residuals(x[self.places(film)])
            for film, problem in enumerate(self.problems)
        ]
        return np.concatenate(parts)

    def slopes(self, x: Floats) -> Floats:
        """Return the Jacobian of the residuals."""
        blocks = []
        for film, problem in enumerate(self.problems):
            places = self.places(film)
            slopes = problem.slopes(x[places])
            block = np.zeros((len(slopes), len(x)))
            block[:, places] = slopes
            blocks.append(block)
        return np.concatenate(blocks)

    def rough_slopes(self, x: Floats, here: Floats, wanted: Sequence[int]) -> Floats:
        """Return the columns `wanted` of the Jacobian by differences on one side.

        The residuals at ``x`` are known, `here`.
        """
        columns = np.zeros((len(here), len(wanted)))
        first = 0
        for film, problem in enumerate(self.problems):
            places = self.places(film)
            last = first + problem.rows + len(problem.priors)
            # A film says nothing of the launches of the others.
            own = [k for k, place in enumerate(wanted) if place in places]
            if own:
                of_film = [places.index(wanted[k]) for k in own]
                slopes = problem.rough_slopes(x[places], here[first:last], of_film)
                columns[first:last, own] = slopes
            first = last
        return columns

    def limits(self) -> tuple[Floats, Floats]:
        """Return the lowest and the highest ``x``."""
        low = np.zeros(len(self.names))
        high = np.zeros(len(self.names))
        for film, problem in enumerate(self.problems):
            low[self.places(film)], high[self.places(film)] = problem.limits()
        return low, high


@dataclass(frozen=True)
class Best:
    """The best parameters of all films, and how well they are known."""

    problem: Together
    x: Floats
    squares: float
    standard_errors: Floats
    quantiles: Floats

    def intervals(self) -> dict[str, tuple[float, float]]:
        """Return the 95 % interval of each parameter.

        Where a limit cuts the parabola of chi squared off, or where it ends anywhere,
        as that of the logarithm of a push that is hardly known, the profile has it.
        """
        limits = self.problem.limits()
        half_width = self.quantiles * self.standard_errors
        low = self.x - half_width
        high = self.x + half_width
        by_profile = (low < limits[0]) | (high > limits[1])
        names = self.problem.names
        is_push = np.array([_plain(name) == "omega_xy0" for name in names])
        by_profile |= is_push & (half_width > doubts.VAGUE)
        by_profile &= [not self.problem.is_given(name) for name in names]
        lows = _values(self.problem, np.clip(low, *limits))
        highs = _values(self.problem, np.clip(high, *limits))
        for place in np.flatnonzero(by_profile).tolist():
            name = names[place]
            ends = ends_by_profile(self, place)
            lows[name], highs[name] = (_values(self.problem, end)[name] for end in ends)
        for place in np.flatnonzero(by_profile & is_push).tolist():
            # Other values go with other pushes, and the parabola at one does not know.
            lowest, highest = (
                _values(self.problem, np.clip(end, *limits))
                for end in ranges_along(self, place)
            )
            for name in names:
                lows[name] = min(lows[name], lowest[name])
                highs[name] = max(highs[name], highest[name])
            push = names[place]
            if highs[push] > self.problem.spin_of(self.x, push):
                # Any push fits, which is no interval.
                lows[push] = highs[push] = math.nan
        return {name: (lows[name], highs[name]) for name in names}


def fit_together(fits: Sequence[Fit]) -> JointFit:
    """Return one fit of all films, from the fits of each film alone.

    The noise of each film is that of its own fit.  Raises a ConfigError if a film is of
    another body or has other free parameters.
    """
    import pandas as pd
    from scipy.optimize import least_squares
    from scipy.special import stdtrit

    estimates = [fit._estimate for fit in fits]
    first = estimates[0].problem
    names = list(first.scales)
    shared = [name for name in names if name not in OF_LAUNCH]
    own = [name for name in names if name in OF_LAUNCH]
    if not shared:
        raise ConfigError(
            "free: several films share nothing; free a parameter that is not of the "
            "launch, such as sigma"
        )
    problems = []
    for film, estimate in enumerate(estimates):
        problem = estimate.problem
        scales = dict(problem.scales)
        priors = problem.priors
        for name in shared:
            scales[name] = first.scales[name]
        if film > 0:
            # What was measured of the stone was measured once.
            priors = {name: priors[name] for name in priors if name in own}
        problems.append(replace(problem, scales=scales, priors=priors))
    together = Together(problems, shared, own)
    starts = [
        problem.scaled(estimate.problem.values(estimate.x))
        for problem, estimate in zip(problems, estimates, strict=True)
    ]
    remarks = [
        f"film {film + 1}: {remark}"
        for film, fit in enumerate(fits)
        for remark in fit.remarks
    ]
    x = np.zeros(len(together.names))
    weights = np.zeros(len(x))
    for film, (start, estimate) in enumerate(zip(starts, estimates, strict=True)):
        places = together.places(film)
        ratios = np.array(
            [
                estimate.problem.scales[name] / problems[film].scales[name]
                for name in names
            ]
        )
        errors = estimate.standard_errors * np.where(
            np.array(names) == "omega_xy0", 1.0, ratios
        )
        x[places] += start / errors**2
        weights[places] += errors**-2.0
    x /= weights
    result = least_squares(
        together.residuals,
        np.clip(x, *together.limits()),
        together.slopes,
        together.limits(),
        "dogbox",
        x_scale="jac",
        ftol=1e-10,
        max_nfev=_MOST_STEPS,
    )
    jacobian = np.asarray(result.jac)
    lengths = np.linalg.norm(jacobian, axis=0)
    spread, _, _ = doubts.directions_of(jacobian / np.maximum(lengths, 1e-100))
    root = spread / np.maximum(lengths, 1e-100)[:, None]
    errors = np.linalg.norm(root, axis=1)
    directions = sum(problem.film.kind == "angle" for problem in problems)
    freedom = float(len(result.fun) - len(x) - directions)
    is_known = all(problem.film.error is not None for problem in problems)
    quantile = float(stdtrit(math.inf if is_known else freedom, 0.975))
    value = _values(together, result.x)
    squares = float((result.fun**2).sum())
    best = Best(together, result.x, squares, errors, np.full(len(x), quantile))
    slope = {
        name: value[name] if _plain(name) == "omega_xy0" else one
        for name, one in _values(together, np.ones(len(x))).items()
    }
    scaled = root * np.array([slope[name] for name in together.names])[:, None]
    remarks += _doubts_of_films(fits, estimates, shared)
    if result.status == 0:
        remarks.append(f"the search did not settle within {_MOST_STEPS} steps")
    return JointFit(
        values=value,
        intervals=best.intervals(),
        covariance=pd.DataFrame(
            scaled @ scaled.T, index=together.names, columns=together.names
        ),
        alone=list(fits),
        rows=sum(problem.rows for problem in problems),
        dof=freedom,
        remarks=remarks,
        _units=first.launch.body.units,
        _expected=[
            problem.expected(result.x[together.places(film)])
            for film, problem in enumerate(problems)
        ],
    )


def _values(together: Together, x: Floats) -> dict[str, float]:
    """Return all parameters at ``x``, in the units of the body that is given."""
    values: dict[str, float] = {}
    for film, problem in enumerate(together.problems):
        places = together.places(film)
        of_film = problem.values(x[places])
        for place, value in zip(places, of_film.values(), strict=True):
            full = together.names[place]
            values[full] = of_body(_plain(full), value)
    return {name: values[name] for name in together.names}


def _doubts_of_films(
    fits: Sequence[Fit], estimates: Sequence[Any], shared: Sequence[str]
) -> list[str]:
    """Return remarks on shared values that films tell differently."""
    remarks = []
    for name in shared:
        values = np.array([fit.values[name] for fit in fits])
        variances = np.array(
            [fit.covariance.loc[name, name] for fit in fits], dtype=float
        )
        mean = float((values / variances).sum() / (1 / variances).sum())
        off = np.abs(values - mean) / np.sqrt(variances)
        worst = int(off.argmax())
        if off[worst] > APART:
            remarks.append(
                f"film {worst + 1} alone tells another {name}, by {off[worst]:.2g} "
                "standard errors: it is not the same stone on the same table, or the "
                "model does not describe one of the films"
            )
    return remarks
