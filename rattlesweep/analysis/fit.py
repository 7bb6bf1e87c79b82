"""Fit parameters of a run to what was measured: angles or spins of a video, or reversal times.

The noise is taken to be equal and independent from row to row, and estimated from the residuals.
Intervals come from the Jacobian at the best fit.  An angle is that of the body's long axis, seen
from above, from an unknown direction.  Spins of a video are central differences of angles, so that
rows at a distance of two share noise with opposite signs; where the residuals show it, they are
summed up to angles again.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.analysis.onerun.course import Course
from rattlesweep.analysis.onerun.rows import Rows
from rattlesweep.arrays import Flags, Floats, Places
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.integrate.status import Status
from rattlesweep.physics.body import PARAMETERS as BODY
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.si import Units
from rattlesweep.physics.theory import modes
from rattlesweep.sweeps.single import Launch
from rattlesweep.units import quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONFIDENCE = 0.95
STEP = 3e-6
"""Step of the differences, as a share of a parameter's scale; the best where runs are sensitive."""
SHARES = (0.15, 0.3, 0.6, 1.0)
"""Parts of the data, from their beginning, that are fitted one after the other."""
MOST_STARTS, MOST_STEPS = 3, 60
ALIKE = 0.1
"""Smallest singular value of the Jacobian, its columns of length 1, of parameters that the data
tell apart: two of them then have errors with a correlation of 0.99."""
CORRELATED = 0.3
"""Autocorrelation of residuals from which on they are not independent."""


@dataclass(frozen=True)
class Parameter:
    """What can be fitted: unit, limits, and the kind of quantity that words with units are."""

    unit: str
    low: float
    high: float
    kind: str
    description: str


PARAMETERS = {
    "n_i": Parameter("sqrt(g/a)", -math.inf, math.inf, "spin", "initial spin"),
    "omega_xy0": Parameter("sqrt(g/a)", 0, math.inf, "spin", "initial oscillation"),
    "psi_deg": Parameter("deg", -360, 360, "", "direction of the initial oscillation"),
    "sigma": Parameter("M a^2 sqrt(g/a)", 0, 10, "torque per spin", "torque -sigma omega"),
    "rolling": Parameter("a", 0, 1, "length", "lever of the rolling resistance"),
    "skew": Parameter("rad", -math.pi / 2, math.pi / 2, "angle", "skew angle, -xi"),
    "xi": Parameter("rad", -math.pi / 2, math.pi / 2, "angle", "skew angle"),
    "theta": Parameter("1", 0, 1, "", "larger curvature"),
    "phi": Parameter("1", 0, 1, "", "smaller curvature"),
    "alpha": Parameter("1", 1, 1e6, "", "I_xx + 1"),
    "beta": Parameter("1", 1, 1e6, "", "I_yy + 1"),
    "gamma": Parameter("1", 0, 1e6, "", "I_zz"),
    "c": Parameter("a", 0, math.inf, "length", "vertical semi-axis of the ellipsoid"),
}
LOGARITHMIC = ("omega_xy0",)


def in_body_units(name: str, value: Any, units: Units | None) -> float:
    """Return a number, or a text with a unit, in the units of a body."""
    known = PARAMETERS[name]
    if not isinstance(value, str):
        return float(value)
    if not known.kind:
        raise ValueError(f"{one_line(value)} is text; give a number")
    found = quantity(value, known.kind)
    if known.kind == "angle":
        return found
    if units is None:
        raise ValueError(
            f"{value} has a unit, but the body has no size; give the body in SI units, or a "
            f"number in {known.unit}"
        )
    return found / units.sizes[known.unit][0]


# -- data ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Data:
    """What was measured.

    Attributes
    ----------
    kind : str
        One of :data:`KINDS`.
    t, value : ndarray
        Times since the first row and values, in the units of the body; NaN where there is none.
        Of reversals the times alone, since the launch.
    units : tuple of (str, float)
        Names of the units of times and values as they were given, and their sizes in the body's.
    """

    kind: str
    t: Floats
    value: Floats
    units: tuple[tuple[str, float], tuple[str, float]]

    @cached_property
    def known(self) -> Flags:
        """Rows that have a value."""
        return np.isfinite(self.value)


KINDS = {"angle": "angle", "spin": "spin", "n": "spin", "reversal": "time"}
"""Angle of the long axis, its rate, the spin ``u . omega``, and times of reversals."""
BARE = {"t": "sqrt(a/g)", "n": "sqrt(g/a)"}
"""Columns in the units of the body, as ``rattlesweep trajectory`` writes them."""
WANTED = ("give a column t_s and one of angle_deg, angle_rad, spin_rpm or spin_rad/s, or one of "
          "reversal_s")  # fmt: skip


def read_data(source: Any, units: Units | None) -> Data:
    """Return measured data from a CSV or Parquet file, a table or a mapping of columns.

    A column is called ``t`` or one of :data:`KINDS`, the first of which counts, and behind a ``_``
    its unit.
    """
    import pandas as pd

    named = isinstance(source, str | os.PathLike)
    place = one_line(os.fspath(source), 200) if named else "data"
    try:
        if not named:
            frame = pd.DataFrame(source)
        elif Path(source).suffix.lower() in (".parquet", ".pq"):
            frame = pd.read_parquet(source)
        else:
            frame = pd.read_csv(source, skipinitialspace=True)
    except FileNotFoundError:
        raise ConfigError(f"{place}: there is no such file; give a table of data") from None
    except Exception as error:  # pandas and pyarrow raise many kinds
        reason = one_line(str(error).strip().partition("\n")[0], 200)
        raise ConfigError(f"{place}: cannot be read as a table ({reason})") from None
    found: dict[str, tuple[Any, str, float]] = {}
    for name in map(str, frame.columns):
        if known := _column(name):
            found.setdefault(known[0], (name, *known[1:]))
    kind = next((name for name in KINDS if name in found), None)
    if kind is None or (kind != "reversal" and "t" not in found):
        names = one_line(", ".join(map(str, frame.columns)), 100)
        raise ConfigError(f"{place}: the columns are {names or 'none'}; {WANTED}")

    def read(name: str) -> tuple[Floats, tuple[str, float]]:
        column, unit, size = found[name]
        try:
            values = pd.to_numeric(frame[column]).to_numpy(float)
        except (ValueError, TypeError) as error:
            raise ConfigError(f"{place}: column {column}: {one_line(str(error), 80)}") from None
        if column not in BARE and name != "angle":
            if units is None:
                raise ConfigError(
                    f"{place}: column {column} has a unit, but the body has no size; give the "
                    "body in SI units, or columns t and n in its own units"
                )
            size = size * units.time if KINDS.get(name) == "spin" else size / units.time
        return values * size, (unit, size)

    value, unit = read(kind)
    if kind == "reversal":
        value = np.sort(value[np.isfinite(value)])
        if not value.size or value[0] <= 0:
            raise ConfigError(f"{place}: reversal times are needed, all after the launch at 0")
        return Data(kind, value, value, (unit, unit))
    t, unit_t = read("t")
    bad = ~np.isfinite(t) | (np.diff(t, prepend=-np.inf) <= 0)
    if bad.any() or len(t) < 2:
        row = int(np.argmax(bad)) + 1 if bad.any() else len(t)
        raise ConfigError(f"{place}: row {row}: times must be finite and increase from row to row")
    t = t - t[0]
    return Data(kind, t, unwrapped(t, value) if kind == "angle" else value, (unit_t, unit))


def _column(name: str) -> tuple[str, str, float] | None:
    """Return what a column is, the name of its unit, and the size of that in SI units."""
    if name in BARE:
        return name, BARE[name], 1.0
    match = re.fullmatch(rf"(t|{'|'.join(KINDS)})_(.+)", name)
    if match is None:
        return None
    unit = match[2].replace("_per_", "/").replace("_", "/")
    try:
        return match[1], unit, quantity(f"1 {unit}", KINDS.get(match[1], "time"))
    except ValueError:
        return None


def unwrapped(t: Floats, angle: Floats) -> Floats:
    """Return an angle without jumps by half a turn or more; a gap is bridged at the spin before.

    The direction of an axis, without a front and a back, jumps by half a turn.
    """
    found = np.array(angle)
    known = np.flatnonzero(np.isfinite(found))
    runs = np.split(known, np.flatnonzero(np.diff(known) > 1) + 1)
    before = np.zeros(0, int)
    for run in runs:
        found[run] = np.unwrap(found[run], period=math.pi)
        if before.size:
            recent = before[-20:]
            slope = np.polyfit(
                t[recent] - t[recent[-1]], found[recent], 1 if recent.size > 1 else 0
            )
            ahead = np.polyval(slope, t[run[0]] - t[recent[-1]]) - found[run[0]]
            found[run] += math.pi * np.round(ahead / math.pi)
        before = np.concatenate([before, run])
    return found


# -- fit -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fit:
    """Parameters that fit data best.

    Attributes
    ----------
    values : dict
        Best value of each free parameter, in the units of the body: spins in ``sqrt(g/a)``, `sigma`
        in ``M a^2 sqrt(g/a)``, `rolling` in ``a``, angles in radians but `psi_deg`.
    intervals : dict
        Lower and upper end of each one's 95 % interval.
    body : Rattleback
        The body with the values that are its own.
    launch : dict
        Launch and dissipation with the others, as arguments of ``rs.trajectory``.
    noise : float
        Standard deviation of a measured value, estimated from the residuals, in `noise_unit`.
    rows : int
        Number of measured values.
    remarks : list of str
        Sentences on what the data cannot tell, or the model cannot describe; usually none.
    """

    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    body: Rattleback
    launch: dict[str, Any]
    noise: float
    noise_unit: str
    rows: int
    remarks: list[str]
    _data: Data = field(repr=False)
    _expected: Floats = field(repr=False)
    _spin: tuple[Floats, Floats] = field(repr=False)  # times, and spins of the fit then

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw data, fit and residuals, and write the figure to a file if `path` is given."""
        from rattlesweep.analysis import style

        data = self._data
        (t_unit, t_size), (unit, size) = data.units
        dots: dict[str, Any] = {"color": style.BLUE, "linestyle": "none", "markersize": 2.5,
                                "marker": "." if len(data.t) > 30 else "o"}  # fmt: skip
        curve: dict[str, Any] = {"color": style.VERMILION, "linewidth": 1.2, "label": "fit"}
        with style.styled():
            figure = style.new_figure(7.2, 4.6)
            top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
            t = data.t / t_size
            if data.kind == "reversal":
                top.plot(self._spin[0] / t_size, self._spin[1], **curve)
                top.plot(t, 0 * t, label="measured", **dots)
                top.set_ylabel(style.label("spin $n$", "sqrt(g/a)"))
            else:
                top.plot(t, data.value / size, label="measured", **dots)
                top.plot(t, self._expected / size, **curve)
                top.set_ylabel(style.label(data.kind, unit))
            bottom.plot(t, (data.value - self._expected) / size, **dots)
            bottom.axhline(0, color=style.VERMILION, linewidth=1.0)
            bottom.set_ylabel(style.label("residual", unit))
            bottom.set_xlabel(style.label("time", t_unit))
            top.legend(loc="best")
            for axes in (top, bottom):
                style.light_grid(axes)
            figure.align_ylabels([top, bottom])
            if path is not None:
                style.save(figure, [Path(path)], 150.0)
        # Figures made without pyplot need `_repr_png_` to show in a notebook.
        setattr(figure, "_repr_png_", lambda: style.encode(figure, "png", 110.0))  # noqa: B010
        return figure


def _follow(launch: Launch, kind: str, times: Floats) -> tuple[Floats, list[float]]:
    """Return what would be measured of a run at some times, and the times of its reversals."""
    moving = kind in ("angle", "spin")
    names = ["yaw", "u_x", "u_y", "u_z"] if moving else ["n"]
    course = Course(launch, channels=names, rows=Rows(times=times))
    columns = course.columns()
    if course.status != Status.OK or not len(columns[names[0]]):
        raise ValueError(f"the run failed: {course.status.meaning}")
    found = columns[names[0]]
    if moving:
        # The long axis against the x axis, of which "yaw" is the direction.
        x, y = -math.sin(launch.body.xi), math.cos(launch.body.xi)
        u_x, u_y, u_z = (columns[name] for name in names[1:])
        found = found + np.unwrap(np.arctan2(y * u_z, x - (x * u_x + y * u_y) * u_x))
    # A body that has come to rest stays where it is.
    found = np.pad(found, (0, len(times) - len(found)), mode="edge")
    return np.gradient(found, times) if kind == "spin" else found, course.reversals


@dataclass(frozen=True)
class Free:
    """A parameter to fit, in the units of the body: where the search begins, and its limits."""

    start: float | None
    low: float
    high: float


@dataclass(frozen=True)
class Problem:
    """Residuals of a run as a function of scaled parameters ``x``.

    Attributes
    ----------
    launch : Launch
        The run, with what is not free.
    data : Data
    free : dict
        Limits of the free parameters.
    scales : dict
        Their scales.
    summed : bool
        Whether the data are central differences of angles that have independent noise.
    """

    launch: Launch
    data: Data
    free: dict[str, Free]
    scales: dict[str, float]
    summed: bool

    @cached_property
    def groups(self) -> list[Places]:
        """Rows with data; if their noise has unknown constants, in groups that share one."""
        known, t = np.flatnonzero(self.data.known), self.data.t
        if not self.summed:
            return [known]
        most = 3 * float(np.median(np.diff(t)))
        chains = known[known % 2 == 0], known[known % 2 == 1]
        split = [np.split(chain, np.flatnonzero(np.diff(t[chain]) > most) + 1) for chain in chains]
        return [part for parts in split for part in parts if part.size]

    @property
    def freedom(self) -> int:
        """Number of data beyond those that the parameters and the unknown constants take up."""
        constants = len(self.groups) if self.summed or self.data.kind == "angle" else 0
        return int(self.data.known.sum()) - len(self.free) - constants

    def until(self, share: float) -> Problem:
        """Return the problem of the first part of the data."""
        data = self.data
        first = data.t <= share * data.t[-1]
        part = replace(data, t=data.t[first], value=data.value[first])
        return replace(self, data=part, launch=replace(self.launch, t_end=float(part.t[-1]) or 1.0))

    def scaled(self, values: Mapping[str, float]) -> Floats:
        """Return parameters as the search has them."""
        return np.array([
            math.log(max(values[name], 1e-12)) if name in LOGARITHMIC else values[name] / scale
            for name, scale in self.scales.items()
        ])  # fmt: skip

    def values(self, x: Floats) -> dict[str, float]:
        """Return parameters from what the search has."""
        return {
            name: math.exp(place) if name in LOGARITHMIC else place * scale
            for (name, scale), place in zip(self.scales.items(), x.tolist(), strict=True)
        }

    def launched(self, x: Floats) -> Launch:
        """Return the run with these parameters; a ValueError says that there is none."""
        changes: dict[str, Any] = self.values(x)
        if "skew" in changes:
            changes["xi"] = -changes.pop("skew")
        if "psi_deg" in changes:
            changes["psi"] = changes.pop("psi_deg")
        own = {name: changes.pop(name) for name in (*BODY, "c") if name in changes}
        return replace(self.launch, body=self.launch.body.replace(**own), **changes)

    def expected(self, x: Floats) -> Floats:
        """Return what would be measured without noise; angles from the best first direction."""
        data, launch = self.data, self.launched(x)
        if data.kind == "reversal":
            _, found = _follow(launch, "n", np.zeros(1))
            missing = [launch.t_end] * max(0, len(data.t) - len(found))
            return np.array([*found[: len(data.t)], *missing], float)
        run, _ = _follow(launch, data.kind, data.t)
        return run + np.nanmean(data.value - run) if data.kind == "angle" else run

    def residuals(self, x: Floats) -> Floats:
        """Return residuals with independent noise, large ones where there is no such run."""
        try:
            difference = self.data.value - self.expected(x)
        except ValueError:
            return np.full(self.data.known.sum(), 10 * np.nanmax(np.abs(self.data.value)))
        if not self.summed:
            return difference[self.data.known]
        turned = difference * 2 * np.gradient(self.data.t)
        sums = [np.cumsum(turned[group]) for group in self.groups]
        return np.concatenate([angle - angle.mean() for angle in sums])

    def slopes(self, x: Floats) -> Floats:
        """Return the Jacobian of the residuals, by differences."""
        base, (_, high) = self.residuals(x), self.limits
        steps = np.where(x + STEP < high, STEP, -STEP)
        moved = [self.residuals(x + step) for step in np.diag(steps)]
        return (np.stack(moved, axis=1) - base[:, None]) / steps

    @property
    def limits(self) -> tuple[Floats, Floats]:
        """Lowest and highest ``x``."""
        low = self.scaled({name: limit.low for name, limit in self.free.items()})
        return low, self.scaled({name: limit.high for name, limit in self.free.items()})

    def search(self, x: Floats) -> Any:
        """Return the least squares nearest ``x``, as SciPy has them."""
        from scipy.optimize import least_squares

        low, high = self.limits
        x = np.clip(x, low + 1e-9, high - 1e-9)
        return least_squares(self.residuals, x, self.slopes, (low, high), max_nfev=MOST_STEPS)


def fit_run(launch: Launch, data: Data, free: dict[str, Free]) -> Fit:
    """Fit free parameters of a run by least squares.

    The beginning of the data is fitted first, and then more and more of them: a run that reverses
    at another time has nothing in common with the later data, and no search would find its way.

    Parameters
    ----------
    launch : Launch
        The run; what is free may be missing in it.
    data : Data
        Of :func:`read_data`.
    free : dict of Free
        By the names of :data:`PARAMETERS`.
    """
    from scipy.stats import t as student

    series = data.kind != "reversal"
    launch = replace(launch, t_end=float(data.t[-1]) * (1.0 if series else 1.5))
    firsts = _first_values(launch, data, free)
    scales = {name: max(map(abs, values)) for name, values in firsts.items()}
    problem = Problem(launch, data, free, scales, summed=data.kind == "spin")
    if problem.freedom < 1:
        raise ConfigError(f"{int(data.known.sum())} measured values cannot tell {len(free)} "
                          "parameters and the noise; give more rows or free fewer")  # fmt: skip
    starts = [problem.scaled(dict(zip(firsts, x, strict=True))) for x in product(*firsts.values())]
    problem.expected(starts[0])  # says what is wrong with the body or the launch
    parts = [problem.until(share) for share in SHARES[:-1]] if series else []
    parts = [part for part in parts if part.freedom > 10 * len(free)]
    begun = (parts or [problem])[0]
    starts.sort(key=lambda x: float((begun.residuals(x) ** 2).sum()))
    best = None
    for x in starts[:MOST_STARTS]:
        for part in parts:
            x = part.search(x).x
        found = problem.search(x)
        best = found if best is None or found.cost < best.cost else best
        if _autocorrelation(best.fun) < CORRELATED:
            break
    assert best is not None
    if problem.summed:
        difference = (data.value - problem.expected(best.x))[data.known]
        if _autocorrelation(difference, 2) > -CORRELATED:
            problem = replace(problem, summed=False)
            best = problem.search(best.x)

    noise = math.sqrt(2 * best.cost / problem.freedom)
    errors, alike = _resolution(best.jac, list(free))
    width = errors * noise * float(student.ppf((1 + CONFIDENCE) / 2, problem.freedom))
    low, high = problem.limits
    ends = [problem.values(np.clip(best.x + side * width, low, high)) for side in (-1, 1)]
    final = problem.launched(best.x)
    remarks = []
    if alike and (width > 0.5 * np.abs(best.x))[[name in alike for name in free]].any():
        told = "apart: a change of one makes up for a change of the other; fix one of them"
        remarks.append(f"the data cannot tell {' and '.join(alike)} {told}")
    if best.status == 0:
        remarks.append(f"the search did not settle within {MOST_STEPS} steps; give better starts")
    shared = _autocorrelation(best.fun)
    if series and shared > CORRELATED:
        told = "the model does not describe the data within their noise, or they were smoothed"
        remarks.append(f"neighbouring residuals have a correlation of {shared:.2f}: {told}, and "
                       "the intervals are too narrow")  # fmt: skip
    if series and shared < -CORRELATED:
        remarks.append(f"neighbouring residuals have a correlation of {shared:.2f}: these seem to "
                       "be differences of angles, and with the angles the intervals would be "
                       "narrower")  # fmt: skip
    unit, size = ("deg", math.pi / 180) if problem.summed else data.units[1]
    names = ("n_i", "omega_xy0", "psi", "omega", "u", "sigma", "rolling")
    dense = np.linspace(0, launch.t_end or 1.0, 2000)
    return Fit(
        values=problem.values(best.x),
        intervals={name: (ends[0][name], ends[1][name]) for name in free},
        body=final.body,
        launch={name: v for name in names if (v := getattr(final, name)) is not None},
        noise=noise / size,
        noise_unit=unit,
        rows=int(data.known.sum()),
        remarks=remarks,
        _data=data,
        _expected=problem.expected(best.x),
        _spin=(dense, _follow(final, "n", dense)[0]),
    )


def _first_values(launch: Launch, data: Data, free: dict[str, Free]) -> dict[str, list[float]]:
    """Return the values of each free parameter from which the search may begin."""
    body, few = launch.body, np.flatnonzero(data.known)[: max(10, data.known.sum() // 50)]
    spin = launch.n_i or 0.1
    if data.kind in ("spin", "n"):
        spin = float(data.value[few].mean())
    elif data.kind == "angle":
        spin = float(np.polyfit(data.t[few], data.value[few], 1)[0])
    decay = body.gamma / float(data.t[-1])
    found = modes(body.alpha, body.beta, body.theta, body.phi, body.xi)
    psi = found.psi_r if launch.psi == "roll" else found.psi_p
    guesses = {
        "n_i": [spin],
        "omega_xy0": [share * abs(spin) for share in (0.01, 0.03, 0.1, 0.3)],
        "psi_deg": [launch.psi if isinstance(launch.psi, float) else math.degrees(psi)],
        "sigma": [0.03 * decay, 0.3 * decay],
        "rolling": [1e-4, 1e-3],
        "skew": [-body.xi],
    }
    values = {}
    for name, limit in free.items():
        given = limit.start or getattr(launch, name, None) or getattr(body, name, None)
        values[name] = [given] if given else guesses[name]
    return values


def _autocorrelation(residual: Floats, distance: int = 1) -> float:
    """Return the correlation of residuals with those some rows later."""
    return float((residual[distance:] * residual[:-distance]).sum() / (residual**2).sum())


def _resolution(jacobian: Floats, names: list[str]) -> tuple[Floats, list[str]]:
    """Return standard errors for noise of size 1, and the names that the data hardly tell apart."""
    sizes = np.linalg.norm(jacobian, axis=0)
    _, singular, directions = np.linalg.svd(
        jacobian / np.where(sizes > 0, sizes, 1.0), full_matrices=False
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        errors = np.linalg.norm(directions.T / np.maximum(singular, 1e-12), axis=1) / sizes
    alike = [name for name, part in zip(names, directions[-1], strict=True) if abs(part) > 0.3]
    return errors, alike if singular[-1] < ALIKE else []
