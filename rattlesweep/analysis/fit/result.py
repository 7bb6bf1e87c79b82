"""The result of a fit, and its figure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from html import escape
from itertools import combinations
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from rattlesweep.analysis.fit.doubts import MEANINGLESS
from rattlesweep.analysis.fit.estimate import Estimate
from rattlesweep.analysis.fit.problem import FITTABLE
from rattlesweep.arrays import Floats
from rattlesweep.physics.body import Rattleback
from rattlesweep.system.console import align
from rattlesweep.words.errors import ConfigError, not_one_of
from rattlesweep.words.units import readable_unit

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from rattlesweep.physics.si import Units

# Units for people, beside those of bodies.
SI_SIZES = {"rad": (180 / math.pi, "deg"), "m": (1e3, "mm"), "kg": (1e3, "g")}
LEAST_CORRELATION = 0.1  # that is printed


def unit_for_people(name: str, units: Units | None) -> tuple[float, str]:
    """Return a unit of a parameter for people, and its size in that of fits."""
    unit = FITTABLE[name].unit
    sizes = SI_SIZES
    if units is not None:
        spin = 30 / math.pi / units.time, "rpm"
        sizes = {**sizes, **units.sizes, "sqrt(g/a)": spin}
    return sizes.get(unit, (1.0, unit))


def in_words(name: str, value: float, units: Units | None) -> str:
    """Return a parameter with its value and unit for people."""
    size, unit = unit_for_people(name, units)
    factor, unit = readable_unit(size * value, unit)
    text = f"{name} {factor * size * value:.4g}"
    return text if unit == "1" else f"{text} {unit}"


@dataclass(frozen=True, repr=False)
class Fit:
    """The result of a fit: best parameters in the units of the fitted body.

    Angles are in radians, sizes such as `length` and `mass` in m and kg, and `psi_deg`
    is in degrees; `in_si` has degrees, rpm, mm, g and SI units.  `intervals` are 95 %
    intervals, of quantities in SI units where the size of the body is fitted, too.
    An interval is NaN where any value fits.  `launch` holds launch and dissipation as
    arguments of ``rs.trajectory``; `noise` is the standard deviation of a residual, in
    `noise_unit`; `remarks` name what the data cannot determine or the model not
    describe.  Where they hardly tell the push, `advised` is the fit with the `push`
    that the remark advises, and None elsewhere.

    A fit prints as the table of the command, and is a table in a notebook.

    Stability: stable.
    """

    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    body: Rattleback
    launch: dict[str, Any]
    noise: float
    noise_unit: str
    rows: int
    remarks: list[str]
    advised: Fit | None
    push: str | None
    _estimate: Estimate = field(repr=False)
    _expected: Floats = field(repr=False)

    def __repr__(self) -> str:
        return "\n".join([report_of(self), *lines_below(self)])

    def _repr_html_(self) -> str:
        return html_of(self)

    @property
    def table(self) -> pd.DataFrame:
        """Value, 95 % interval, unit for people and meaning of each parameter."""
        return table_of(self)

    @property
    def means_something(self) -> bool:
        """Whether the run follows the data; if not, the values mean nothing."""
        return not any(MEANINGLESS in remark for remark in self.remarks)

    @property
    def covariance(self) -> pd.DataFrame:
        """Covariance of the parameters, in products of the units of `values`.

        It is that of the measured errors if these are known, and otherwise that of
        noise of the size of the residuals.
        """
        return self._matrix(self._estimate.covariance)

    @property
    def correlations(self) -> pd.DataFrame:
        """Correlations of the parameters, from -1 to 1."""
        return self._matrix(self._estimate.correlations)

    def _matrix(self, entries: Floats) -> pd.DataFrame:
        import pandas as pd

        names = list(self.values)
        return pd.DataFrame(entries, index=names, columns=names)

    @property
    def dof(self) -> int:
        """Degrees of freedom: values of data and priors less fitted parameters.

        The first direction of angles counts as a parameter.
        """
        return self._estimate.problem.freedom

    @property
    def chi_squared(self) -> float | None:
        """Sum of the squares of the residuals over their errors, with the priors'.

        None if the errors of the data are not known.
        """
        if self._estimate.problem.film.error is None:
            return None
        return self._estimate.search.squares

    @property
    def reduced_chi_squared(self) -> float | None:
        """Chi squared per degree of freedom; None if it is not known."""
        if self.chi_squared is None or self.dof == 0:
            return None
        return self.chi_squared / self.dof

    def profile(self, name: str) -> pd.DataFrame:
        """Return chi squared along one parameter, the others fitted at each value.

        Parameters
        ----------
        name : str
            One of the free parameters.

        Returns
        -------
        DataFrame
            Columns `name` and ``delta_chi_squared``, the increase of chi squared (of
            the sum of squares over that of the noise, if the errors are not known), and
            the other parameters, all in the units of `values`; 12 rows or more.
            ``attrs["interval"]`` is the 95 % interval where the increase stays below
            ``attrs["threshold"]``, up to the limit of the parameter if it does so
            there.

        Raises
        ------
        ConfigError
            If no free parameter has this name.
        """
        from rattlesweep.analysis.fit.profile import profile_of

        if name not in self.values:
            raise ConfigError(f"profile: {not_one_of(name, self.values)}")
        return profile_of(self._estimate, name)

    def plot_profile(
        self, profile: str | pd.DataFrame, path: str | Path | None = None
    ) -> Figure:
        """Draw a profile beside the parabola of the covariance, with its interval.

        `profile` is a name or what :meth:`profile` has returned; the figure is also
        written to `path` if given.
        """
        from rattlesweep.analysis.fit.profile import draw_profile

        if isinstance(profile, str):
            profile = self.profile(profile)
        size, unit = self.unit_of(str(profile.columns[0]))
        return draw_profile(self._estimate, profile, size, unit, path)

    def unit_of(self, name: str) -> tuple[float, str]:
        """Return the unit of a parameter for people, and its size in that of `values`.

        It is an SI unit, rpm or deg, if there is one.
        """
        return unit_for_people(name, self.body.units)

    @property
    def in_si(self) -> dict[str, tuple[float, float, float, str]]:
        """Value, interval and unit of each parameter with an SI unit, and of angles."""
        in_si = {}
        for name, value in self.values.items():
            size, unit = self.unit_of(name)
            if unit != FITTABLE[name].unit:
                low, high = self.intervals[name]
                in_si[name] = (size * value, size * low, size * high, unit)
        return in_si

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw data, fit and residuals, and write the figure to `path` if given."""
        from rattlesweep.analysis.fit.pictures import draw_films

        return draw_films([self._estimate.problem.film], [self._expected], path)


def report_of(fit: Fit) -> str:
    """Return parameters with their intervals, and correlations, as text."""
    lines = [["", "value", "low", "high", "unit", "", "low", "high", "unit", ""]]
    for name, value in fit.values.items():
        parameter = FITTABLE[name]
        line = [name]
        line += [_told(number, ".6g") for number in (value, *fit.intervals[name])]
        line.append(parameter.unit)
        if name in fit.in_si:
            *numbers, unit = fit.in_si[name]
            factor, unit = readable_unit(numbers[0], unit)
            line += [_told(factor * number, ".5g") for number in numbers]
            line.append(unit)
        else:
            line += [""] * 4
        lines.append([*line, parameter.description])
    report = align(lines, "<>>><>>><<")
    correlations = fit.correlations.to_numpy()
    pairs = []
    for (i, first), (j, second) in combinations(enumerate(fit.values), 2):
        size = float(correlations[i, j])
        if abs(size) > LEAST_CORRELATION:
            # A line is not broken within a pair.
            pairs.append((abs(size), f"{first}\xa0{second}\xa0{size:.2f}"))
    pairs.sort(reverse=True)
    if pairs:
        listed = "; ".join(text for _, text in pairs)
        lines_of_pairs = fill(f"correlations: {listed}", 100, subsequent_indent="  ")
        report += "\n" + lines_of_pairs.replace("\xa0", " ")
    return report


def _told(number: float, form: str) -> str:
    """Return a number, or a dash where there is none."""
    if math.isnan(number):
        return "-"
    return f"{number:{form}}"


def advice_of(fit: Fit) -> str | None:
    """Return a line with the fit that follows the advice on the push."""
    if fit.advised is None:
        return None
    parts = []
    for name in fit.advised.values:
        size, unit = fit.advised.unit_of(name)
        low, high = fit.advised.intervals[name]
        factor, unit = readable_unit(size * fit.advised.values[name], unit)
        part = f"{name} {factor * size * low:.4g} to {factor * size * high:.4g}"
        if unit != "1":
            part += f" {unit}"
        parts.append(part)
    return f"with omega_xy0: {fit.push}, the intervals are {', '.join(parts)}"


def summary_of(fit: Fit) -> str:
    """Return how many rows there are, and how well they are met."""
    summary = f"{fit.rows} rows, noise {fit.noise:.3g} {fit.noise_unit}"
    if fit.reduced_chi_squared is not None:
        summary += (
            f", chi squared {fit.chi_squared:.4g}, "
            f"{fit.reduced_chi_squared:.3g} per degree of freedom"
        )
    return summary


def table_of(fit: Fit) -> pd.DataFrame:
    """Return parameters and intervals as a table, in units for people if there are."""
    import pandas as pd

    rows = {}
    for name, value in fit.values.items():
        low, high = fit.intervals[name]
        row = value, low, high, FITTABLE[name].unit
        row = fit.in_si.get(name, row)
        rows[name] = *row, FITTABLE[name].description
    columns = ["value", "low", "high", "unit", "meaning"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns)


def html_of(fit: Fit) -> str:
    """Return a fit as a table of a notebook, with its warnings."""
    parts = [table_of(fit).to_html(float_format="{:.5g}".format)]
    parts += [f"<p>{escape(line)}</p>" for line in lines_below(fit)]
    return "\n".join(parts)


def lines_below(fit: Fit) -> list[str]:
    """Return the lines below the table: noise and warnings."""
    lines = [summary_of(fit), *(f"warning: {remark}" for remark in fit.remarks)]
    advice = advice_of(fit)
    if advice is not None:
        lines.append(advice)
    return lines
