"""Fit parameters of one run to a measured angle or spin, or to the times of
reversals.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.arrays import Flags, Floats
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.integrate.status import Status
from rattlesweep.physics.body import PARAMETERS as BODY
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.si import Units
from rattlesweep.physics.theory import modes
from rattlesweep.sweeps.config import not_one_of
from rattlesweep.sweeps.launches import Launch
from rattlesweep.text import counted
from rattlesweep.units import quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEP = 3e-6  # of the central differences, relative to the scale of a parameter
# Fractions of the data, from their beginning, that are fitted before the whole; the
# fine ones are tried if the coarse ones end in a wrong minimum.
SHARES, FINE = (0.15, 0.3, 0.6, 0.8), tuple(np.arange(0.1, 1.0, 0.05))
STEPS = 60  # of the search, at most
CORRELATED = (
    0.12  # correlation of neighbouring residuals above which they are not noise
)
ALIKE = 0.99  # correlation of two estimates above which the data cannot separate them
SINGULAR = 1e-6  # smallest singular value that is not an error of the differences
# The parameters that can be fitted: unit, limits, description.
PARAMETERS: dict[str, tuple[str, float, float, str]] = {
    "n_i": ("sqrt(g/a)", -10, 10, "initial spin"),
    "omega_xy0": ("sqrt(g/a)", 1e-9, 10, "initial oscillation"),
    "psi_deg": ("deg", -360, 360, "direction of the initial oscillation"),
    "sigma": ("M a^2 sqrt(g/a)", 0, 10, "torque -sigma omega"),
    "rolling": ("a", 0, 1, "lever of the rolling resistance"),
    "skew": ("rad", -math.pi / 2, math.pi / 2, "skew angle, -xi"),
    "xi": ("rad", -math.pi / 2, math.pi / 2, "skew angle"),
    "theta": ("1", 0, 1, "larger curvature"),
    "phi": ("1", 0, 1, "smaller curvature"),
    "alpha": ("1", 1, 1e6, "I_xx + 1"),
    "beta": ("1", 1, 1e6, "I_yy + 1"),
    "gamma": ("1", 0, 1e6, "I_zz"),
    "c": ("a", 0, 1e6, "vertical semi-axis of the ellipsoid"),
}

# Measured columns: angle of the long axis, its rate, the spin ``u . omega``, reversal
# times.
KINDS = {"angle": "angle", "spin": "spin", "n": "spin", "reversal": "time"}
# Columns without a unit in their names, as ``rattlesweep trajectory`` writes them.
BARE = {"t": "sqrt(a/g)", "n": "sqrt(g/a)"}
WANTED = "t_s and one of angle_deg, spin_rpm, n_rpm, or reversal_s alone"


@dataclass(frozen=True)
class Data:
    """Measured data in the units of the body, NaN where a value is missing."""

    kind: str
    t: Floats  # since the first row; reversals: since the launch
    value: Floats
    units: tuple[
        tuple[str, float], tuple[str, float]
    ]  # of t and value, as given, and their sizes

    @property
    def known(self) -> Flags:
        """The rows that have a value."""
        return np.isfinite(self.value)


def read_data(source: Any, units: Units | None) -> Data:
    """Return measured data from a CSV or Parquet file, a table or a mapping of
    columns.
    """
    import pandas as pd

    place = "data"
    try:
        if isinstance(source, str | os.PathLike):
            place = one_line(os.fspath(source), 200)
            table = Path(source).suffix.lower() in (".parquet", ".pq")
            frame = (
                pd.read_parquet(source)
                if table
                else pd.read_csv(source, skipinitialspace=True)
            )
        else:
            frame = pd.DataFrame(source)
    except Exception as error:  # pandas and pyarrow raise many kinds
        reason = one_line(getattr(error, "strerror", None) or str(error), 200)
        raise ConfigError(f"{place}: cannot be read as a table ({reason})") from None
    found: dict[str, tuple[Any, str, float]] = {}
    for name in frame:
        if known := _column(str(name), units):
            found.setdefault(known[0], (name, *known[1:]))
    kind = next((name for name in KINDS if name in found), None)
    if kind is None or (kind != "reversal" and "t" not in found):
        names = one_line(", ".join(map(str, frame)), 100)
        more = (
            ""
            if units
            else "; the body has no size, so only t and n, or give it in SI units"
        )
        raise ConfigError(
            f"{place}: {WANTED} are needed, and the columns are {names}{more}"
        )
    values: dict[str, Floats] = {}
    for name, (column, _, size) in found.items():
        given = frame.iloc[:, list(frame).index(column)]
        numbers = pd.to_numeric(given, errors="coerce")
        for row in np.flatnonzero(numbers.isna() & given.notna())[:1]:
            shown = one_line(str(given.iloc[row]), 40)
            raise ConfigError(
                f"{place}: row {row + 1}: {column} is {shown}, not a number"
            )
        values[name] = numbers.replace([np.inf, -np.inf], np.nan).to_numpy(float) * size
    value, unit = values[kind], found[kind][1:]
    if not np.isfinite(value).any():
        raise ConfigError(f"{place}: no row has a value of {found[kind][0]}")
    if kind == "reversal":
        value = np.sort(value[np.isfinite(value)])
        if value[0] <= 0:
            first = f"{value[0] / found[kind][2]:g}"
            raise ConfigError(
                f"{place}: {found[kind][0]} is {first}; the launch is at 0"
            )
        return Data(kind, value, value, (unit, unit))
    t = values["t"]
    for row in np.flatnonzero(~np.isfinite(t) | (np.diff(t, prepend=-np.inf) <= 0))[:1]:
        column, _, size = found["t"]
        shown = f"is {t[row] / size:g} after {t[row - 1] / size:g}; times must increase"
        missing = "" if np.isfinite(t[row]) else "has no finite value"
        raise ConfigError(f"{place}: row {row + 1}: {column} {missing or shown}")
    t = t - t[0]
    return Data(
        kind,
        t,
        unwrapped(t, value) if kind == "angle" else value,
        (found["t"][1:], unit),
    )


def _column(name: str, units: Units | None) -> tuple[str, str, float] | None:
    """Return the quantity of a column, its unit, and the unit's size in those of the
    body.
    """
    if name in BARE:
        return name, BARE[name], 1.0
    match = re.fullmatch(rf"(t|{'|'.join(KINDS)})_(.+)", name)
    if match is None or (units is None and match[1] != "angle"):
        return None
    kind, unit = KINDS.get(match[1], "time"), match[2].replace("_", "/")
    second = 1.0 if units is None else units.time
    natural = {"angle": 1.0, "spin": second, "time": second**-1}[kind]
    with suppress(ValueError):
        return match[1], unit, quantity(f"1 {unit}", kind) * natural
    return None


def unwrapped(t: Floats, angle: Floats) -> Floats:
    """Remove jumps by half turns from the angle of an axis, extrapolating the previous
    rows.
    """
    found, rows = angle.copy(), np.flatnonzero(np.isfinite(angle))
    for i in range(1, len(rows)):
        first, last, row = rows[max(0, i - 21)], rows[i - 1], rows[i]
        spin = 0.0 if i == 1 else (found[last] - found[first]) / (t[last] - t[first])
        ahead = found[last] + spin * (t[row] - t[last])
        found[row] += math.pi * round((ahead - found[row]) / math.pi)
    return found


@dataclass(frozen=True)
class Fit:
    """The result of a fit: best parameters in the units of the body, angles in radians.

    Only `psi_deg` is in degrees; `in_si` has degrees, rpm and SI units.  `intervals`
    are 95 % intervals; `launch` holds launch and dissipation as arguments of
    ``rs.trajectory``; `noise` is the standard deviation of a measured value, in
    `noise_unit`; `remarks` name what the data cannot determine or the model not
    describe.
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

    @property
    def in_si(self) -> dict[str, tuple[float, float, float, str]]:
        """Value, interval and unit of each parameter that is an angle or has an SI
        unit.
        """
        sizes = {"rad": (180 / math.pi, "deg")}
        if units := self.body.units:
            sizes |= units.sizes | {"sqrt(g/a)": (30 / math.pi / units.time, "rpm")}
        found = {}
        for name, value in self.values.items():
            size, unit = sizes.get(PARAMETERS[name][0], (1.0, ""))
            if unit:
                low, high = self.intervals[name]
                found[name] = size * value, size * low, size * high, unit
        return found

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw data, fit and residuals, and write the figure to a file if `path` is
        given.
        """
        from rattlesweep.analysis import style
        from rattlesweep.analysis.onerun.figure import shown

        data = self._data
        (t_unit, t_size), (unit, size) = data.units
        t, value, expected = data.t / t_size, data.value / size, self._expected / size
        label = style.label("time", t_unit)
        line: dict[str, Any] = {
            "color": style.VERMILION,
            "linewidth": 1.2,
            "label": "fit",
        }
        if data.kind == "reversal":  # single times, which no line joins
            t, label = np.arange(1.0, len(t) + 1), "number of the reversal"
            line |= {"linestyle": "none", "marker": "x"}
        dots: dict[str, Any] = {
            "color": style.BLUE,
            "linestyle": "none",
            "markersize": 2.5,
            "marker": "." if len(t) > 30 else "o",
        }
        with style.styled():
            figure = style.new_figure(7.2, 4.6)
            top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
            top.plot(t, value, label="measured", **dots)
            top.plot(t, expected, **line)
            bottom.plot(t, value - expected, **dots)
            bottom.axhline(0, color=style.VERMILION, linewidth=1.0)
            top.set_ylabel(style.label(data.kind, unit))
            bottom.set(ylabel=style.label("residual", unit), xlabel=label)
            top.legend(loc="best")
            if data.kind == "reversal":
                bottom.set_xticks(t)
            for axes in (top, bottom):
                style.light_grid(axes)
            figure.align_ylabels([top, bottom])
            return shown(figure, path)


def _follow(launch: Launch, kind: str, times: Floats) -> tuple[Floats, list[float]]:
    """Return the quantity `kind` of a run at some times, and the times of its
    reversals.
    """
    names = ["yaw", "u_x", "u_y", "u_z"] if kind in ("angle", "spin") else ["n"]
    course = Course(PreparedRun.of(launch), names, times=times)
    columns = course.columns()
    found = columns[names[0]]
    if course.follower.status != Status.OK or not len(found):
        raise ConfigError(
            f"the run failed: {course.follower.status.meaning}; check the body"
        )
    if len(names) > 1:
        # Add the angle from the x axis, whose direction is "yaw", to the long axis.
        x, y = -math.sin(launch.body.xi), math.cos(launch.body.xi)
        u_x, u_y, u_z = (columns[name] for name in names[1:])
        found = found + np.unwrap(np.arctan2(y * u_z, x - (x * u_x + y * u_y) * u_x))
    # A body that has come to rest keeps its last value.
    found = np.pad(found, (0, len(times) - len(found)), mode="edge")
    return np.gradient(found, times) if kind == "spin" else found, course.reversals


@dataclass(frozen=True)
class Problem:
    """Residuals as a function of ``x``, the free parameters divided by their scales."""

    launch: Launch
    data: Data
    scales: dict[str, float]

    @property
    def freedom(self) -> int:
        """Number of values less the parameters and, for angles, the unknown first
        direction.
        """
        return (
            int(self.data.known.sum()) - len(self.scales) - (self.data.kind == "angle")
        )

    def until(self, share: float) -> Problem:
        """Return the problem of the first part of the data."""
        data, first = self.data, self.data.t <= share * self.data.t[-1]
        part = replace(data, t=data.t[first], value=data.value[first])
        return replace(
            self, data=part, launch=replace(self.launch, t_end=float(part.t[-1]) or 1.0)
        )

    def scaled(self, values: dict[str, float]) -> Floats:
        """Return ``x``; the oscillation enters by its logarithm, as its magnitude is
        unknown.
        """
        return np.array(
            [
                math.log(values[name]) if name == "omega_xy0" else values[name] / scale
                for name, scale in self.scales.items()
            ]
        )

    def values(self, x: Floats) -> dict[str, float]:
        """Return the parameters at ``x``."""
        places = zip(self.scales.items(), x.tolist(), strict=True)
        return {
            name: math.exp(place) if name == "omega_xy0" else place * scale
            for (name, scale), place in places
        }

    def launched(self, x: Floats) -> Launch:
        """Return the run with the parameters at ``x``; raise a ValueError if there is
        none.
        """
        changes: dict[str, Any] = self.values(x)
        if "skew" in changes:
            changes["xi"] = -changes.pop("skew")
        if "psi_deg" in changes:
            changes["psi"] = changes.pop("psi_deg")
        own = {name: changes.pop(name) for name in (*BODY, "c") if name in changes}
        return replace(self.launch, body=self.launch.body.replace(**own), **changes)

    def expected(self, x: Floats) -> Floats:
        """Return the values without noise; angles start from the best first
        direction.
        """
        data, launch = self.data, self.launched(x)
        if data.kind == "reversal":
            found = _follow(launch, "n", np.zeros(1))[1][: len(data.t)]
            return np.array(found + [launch.t_end] * (len(data.t) - len(found)), float)
        run, _ = _follow(launch, data.kind, data.t)
        return run + np.nanmean(data.value - run) if data.kind == "angle" else run

    def residuals(self, x: Floats) -> Floats:
        """Return the residuals, large ones if no such run exists."""
        value, known = self.data.value, self.data.known
        try:
            return (value - self.expected(x))[known]
        except ValueError:
            return np.full(known.sum(), 10 * np.abs(value[known]).max())

    def limits(self) -> tuple[Floats, Floats]:
        """Return the lowest and the highest ``x``."""
        low = self.scaled({name: PARAMETERS[name][1] for name in self.scales})
        return low, self.scaled({name: PARAMETERS[name][2] for name in self.scales})

    def slopes(self, x: Floats) -> Floats:
        """Return the Jacobian of the residuals by central differences."""
        limits, columns = self.limits(), []
        for step in np.diag(np.full(len(x), STEP)):
            low, high = np.clip(x - step, *limits), np.clip(x + step, *limits)
            columns.append(
                (self.residuals(high) - self.residuals(low)) / (high - low).sum()
            )
        return np.stack(columns, axis=1)

    def search(self, x: Floats, accuracy: float, steps: int) -> Any:
        """Minimise the sum of squares from ``x`` on, and return SciPy's result."""
        from scipy.optimize import least_squares

        # The method "trf" is slow where two parameters are strongly correlated.
        return least_squares(
            self.residuals,
            np.clip(x, *self.limits()),
            self.slopes,
            self.limits(),
            "dogbox",
            x_scale="jac",
            ftol=accuracy,
            max_nfev=steps,
        )


def check_free(launch: Launch, free: Iterable[str]) -> list[str]:
    """Return the names of free parameters; raise a ConfigError if they do not fit the
    run.
    """
    names = list(dict.fromkeys(free))
    if not names:
        raise ConfigError(
            f"free: no parameter is given; choose from {', '.join(PARAMETERS)}"
        )
    for name in names:
        if name not in PARAMETERS:
            raise ConfigError(f"free: {not_one_of(name, PARAMETERS)}")
    if {"skew", "xi"} <= {*names}:
        raise ConfigError("free: skew is -xi; keep one of them")
    if "c" in names and launch.body.c is None:
        raise ConfigError("free: only an ellipsoid has c, and the body is a paraboloid")
    if launch.omega is not None and {"n_i", "omega_xy0", "psi_deg"} & {*names}:
        raise ConfigError("free: a full state has no n_i, omega_xy0 and psi_deg")
    return names


def fit_run(launch: Launch, data: Data, free: list[str]) -> Fit:
    """Fit parameters by least squares, first to the beginning of the data, then to all
    of them.
    """
    from scipy.stats import t as student

    series = data.kind != "reversal"
    launch = replace(launch, t_end=float(data.t[-1]) * (1.0 if series else 1.5))
    if Problem(launch, data, dict.fromkeys(free, 1.0)).freedom < 1:
        found, parameters = (
            counted(data.known.sum(), "value"),
            counted(len(free), "parameter"),
        )
        raise ConfigError(
            f"{found} cannot determine {parameters} and the noise; give more rows "
            "or free fewer parameters"
        )
    firsts = _first_values(launch, data, free)
    scales = {name: max(map(abs, values)) for name, values in firsts.items()}
    problem = Problem(launch, data, scales)
    starts = [
        problem.scaled(dict(zip(firsts, x, strict=True)))
        for x in product(*firsts.values())
    ]
    problem.expected(starts[0])  # raises if body or launch are invalid
    begun = problem.until(SHARES[0]) if series else problem
    starts.sort(key=lambda x: float((begun.residuals(x) ** 2).sum()))
    limit, fits = max(CORRELATED, 4 / math.sqrt(data.known.sum())), []
    for x, shares in (
        product(starts[:2], (SHARES, FINE)) if series else product(starts[:6], [()])
    ):
        for part in map(problem.until, shares):
            if part.freedom > 10 * len(free):
                x = part.search(x, 1e-3, 10).x
        fits.append(problem.search(x, 1e-8, STEPS))
        if series and _correlation(fits[-1].fun) < limit:
            break
    best = min(fits, key=lambda one: float(one.cost))

    noise = math.sqrt(2 * best.cost / problem.freedom)
    # Standard errors for noise of size 1, from the Jacobian with columns of length 1.
    sizes = np.linalg.norm(best.jac, axis=0)
    unit_jacobian = best.jac / np.where(sizes > 0, sizes, 1.0)
    _, singular, directions = np.linalg.svd(unit_jacobian, full_matrices=False)
    spread = directions.T / np.maximum(singular, 1e-12)
    lengths = np.linalg.norm(spread, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        width = lengths / sizes * noise * float(student.ppf(0.975, problem.freedom))
    low, high = (
        problem.values(np.clip(best.x + side * width, *problem.limits()))
        for side in (-1, 1)
    )
    remarks = []
    # The absolute error of a logarithm is the relative error of its number.
    large = np.where([name == "omega_xy0" for name in free], 1.0, np.abs(best.x))
    vague = ~(width <= 0.5 * large) | (np.abs(directions[-1]) > 0.1) * (
        singular[-1] < SINGULAR
    )
    alike = np.abs(spread @ spread.T) > ALIKE * np.outer(lengths, lengths)
    pairs = np.argwhere(np.triu(alike & (vague | vague[:, None]), 1))
    for i, j in pairs:
        remarks.append(
            f"the data cannot tell {free[i]} and {free[j]} apart: fix one of them"
        )
    if alone := [free[i] for i in np.flatnonzero(vague) if i not in pairs]:
        remarks.append(
            f"the data hardly tell {' and '.join(alone)}: fix what is known otherwise"
        )
    if best.status == 0:
        remarks.append(
            f"the search did not settle within {STEPS} steps; give a better launch"
        )
    if series and _correlation(best.fun) > limit:
        remarks.append(
            "neighbouring residuals are correlated: the model does not describe the "
            "data within their noise, or they were smoothed, and the intervals are too "
            "narrow"
        )
    final = problem.launched(best.x)
    names = ("n_i", "omega_xy0", "psi", "omega", "u", "sigma", "rolling")
    kept = {name: v for name in names if (v := getattr(final, name)) is not None}
    intervals, (unit, size) = (
        {name: (low[name], high[name]) for name in free},
        data.units[1],
    )
    return Fit(
        problem.values(best.x),
        intervals,
        final.body,
        kept,
        noise / size,
        unit,
        int(data.known.sum()),
        remarks,
        data,
        problem.expected(best.x),
    )


def _first_values(
    launch: Launch, data: Data, free: list[str]
) -> dict[str, list[float]]:
    """Return values of each free parameter from which the search may begin."""
    body, few = (
        launch.body,
        np.flatnonzero(data.known)[: max(10, data.known.sum() // 50)],
    )
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
        "sigma": [share * decay for share in (0.03, 0.1, 0.3)],
        "rolling": [1e-4, 1e-3],
        "skew": [-body.xi],
    }
    given = {
        name: getattr(launch, name, None) or getattr(body, name, None) for name in free
    }
    return {name: [value] if value else guesses[name] for name, value in given.items()}


def _correlation(residual: Floats) -> float:
    """Return the correlation of neighbouring residuals."""
    return float((residual[1:] * residual[:-1]).sum() / (residual**2).sum())
