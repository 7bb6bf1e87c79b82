"""The least-squares problem of a fit: parameters, trial runs, residuals, slopes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from rattlesweep.analysis.fit.film import Film
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.status import Status
from rattlesweep.physics.body import PARAMETERS as BODY
from rattlesweep.quantities import LOSSES
from rattlesweep.sweeps.launches import Launch

LEAST = 1e-3  # of parameters that must be above zero
STEP = 3e-6  # of the central differences, relative to the scale of a parameter


class Parameter(NamedTuple):
    """A parameter that can be fitted."""

    unit: str
    low: float
    high: float
    description: str


PARAMETERS = {
    "n_i": Parameter("sqrt(g/a)", -10, 10, "initial spin"),
    "omega_xy0": Parameter("sqrt(g/a)", 1e-9, 10, "initial oscillation"),
    "psi_deg": Parameter("deg", -360, 360, "direction of the initial oscillation"),
    **{
        name: Parameter(
            loss.unit,
            # A limit that is excluded is not reached.
            loss.low + LEAST * loss.is_open,
            loss.most_fitted,
            loss.meaning,
        )
        for name, loss in LOSSES.items()
    },
    "skew": Parameter("rad", -math.pi / 2, math.pi / 2, "skew angle, -xi"),
    "xi": Parameter("rad", -math.pi / 2, math.pi / 2, "skew angle"),
    "theta": Parameter("1", 0, 1, "larger curvature"),
    "phi": Parameter("1", 0, 1, "smaller curvature"),
    "alpha": Parameter("1", 1, 1e6, "I_xx + 1"),
    "beta": Parameter("1", 1, 1e6, "I_yy + 1"),
    "gamma": Parameter("1", 0, 1e6, "I_zz"),
    "c": Parameter("a", 0, 1e6, "vertical semi-axis of the ellipsoid"),
}


def follow(launch: Launch, kind: str, times: Floats) -> tuple[Floats, list[float]]:
    """Return the quantity `kind` of a run at some times, and its times of reversals.

    Raises a ConfigError if the integration fails.
    """
    names = ["n"]
    if kind in ("angle", "spin"):
        names = ["yaw", "u_x", "u_y", "u_z"]
    course = Course(PreparedRun.of(launch), names, times=times)
    columns = course.columns()
    status = course.follower.status
    values = columns[names[0]]
    if status != Status.OK or not len(values):
        raise ConfigError(f"the run failed: {status.meaning}")
    if names[0] == "yaw":
        # Add the angle from the x axis, whose direction is "yaw", to the long axis.
        x = -math.sin(launch.body.xi)
        y = math.cos(launch.body.xi)
        u_x = columns["u_x"]
        tilted = y * columns["u_z"]
        values = values + np.unwrap(
            np.arctan2(tilted, x - (x * u_x + y * columns["u_y"]) * u_x)
        )
    # A body that has come to rest keeps its last value.
    values = np.pad(values, (0, len(times) - len(values)), mode="edge")
    if kind == "spin":
        values = np.gradient(values, times)
    return values, course.reversals


@dataclass(frozen=True)
class Problem:
    """Residuals as a function of ``x``, the free parameters divided by their scales."""

    launch: Launch
    film: Film
    scales: dict[str, float]
    # Called before each trial run, for progress.
    trial: Callable[[], None] = field(default=lambda: None)

    @property
    def freedom(self) -> int:
        """Number of values less the parameters and, for angles, the first direction."""
        unknowns = len(self.scales) + int(self.film.kind == "angle")
        return int(self.film.known.sum()) - unknowns

    def until(self, share: float) -> Problem:
        """Return the problem of the first part of the data."""
        early = self.film.t <= share * self.film.t[-1]
        film = replace(self.film, t=self.film.t[early], value=self.film.value[early])
        launch = replace(self.launch, t_end=float(film.t[-1]) or 1.0)
        return replace(self, film=film, launch=launch)

    def scaled(self, values: dict[str, float]) -> Floats:
        """Return ``x``; the oscillation, of unknown size, enters by its logarithm."""
        x = []
        for name, scale in self.scales.items():
            if name == "omega_xy0":
                x.append(math.log(values[name]))
            else:
                x.append(values[name] / scale)
        return np.array(x)

    def values(self, x: Floats) -> dict[str, float]:
        """Return the parameters at ``x``."""
        values = {}
        for (name, scale), place in zip(self.scales.items(), x.tolist(), strict=True):
            if name == "omega_xy0":
                values[name] = math.exp(place)
            else:
                values[name] = place * scale
        return values

    def launched(self, x: Floats) -> Launch:
        """Return the run with the parameters at ``x``; or raise a ValueError."""
        changes: dict[str, Any] = self.values(x)
        if "skew" in changes:
            changes["xi"] = -changes.pop("skew")
        if "psi_deg" in changes:
            changes["psi"] = changes.pop("psi_deg")
        of_body = {name: changes.pop(name) for name in (*BODY, "c") if name in changes}
        body = self.launch.body.replace(**of_body)
        losses = {name: changes.pop(name) for name in LOSSES if name in changes}
        losses = {**self.launch.losses, **losses}
        return replace(self.launch, body=body, losses=losses, **changes)

    def expected(self, x: Floats) -> Floats:
        """Return the values without noise; angles start from the best first direction.

        Raises a ValueError if no such run exists or its integration fails.
        """
        self.trial()
        film = self.film
        launch = self.launched(x)
        if film.kind == "reversal":
            _, reversals = follow(launch, "n", np.zeros(1))
            # A run with fewer reversals has the others at its end at the earliest.
            times = np.full(len(film.t), launch.t_end or 0.0)
            count = min(len(film.t), len(reversals))
            times[:count] = reversals[:count]
            return times
        values, _ = follow(launch, film.kind, film.t)
        if film.kind == "angle":
            values = values + np.nanmean(film.value - values)
        return values

    def residuals(self, x: Floats) -> Floats:
        """Return the residuals; infinite ones if the run does not exist or fails.

        SciPy's search takes an infinite residual as a step that was too long.
        """
        known = self.film.known
        try:
            return (self.film.value - self.expected(x))[known]
        except ValueError:
            return np.full(int(known.sum()), np.inf)

    def succeeds(self, x: Floats) -> bool:
        """Return whether the run at ``x`` exists and is integrated to its end."""
        return bool(np.isfinite(self.residuals(x)).all())

    def limits(self) -> tuple[Floats, Floats]:
        """Return the lowest and the highest ``x``."""
        low = self.scaled({name: PARAMETERS[name].low for name in self.scales})
        high = self.scaled({name: PARAMETERS[name].high for name in self.scales})
        return low, high

    def slopes(self, x: Floats) -> Floats:
        """Return the Jacobian of the residuals by central differences."""
        limits = self.limits()
        columns = []
        for step in np.diag(np.full(len(x), STEP)):
            low = np.clip(x - step, *limits)
            high = np.clip(x + step, *limits)
            below = self.residuals(low)
            above = self.residuals(high)
            # Next to a run that fails, the difference is taken on the other side.
            if not np.isfinite(below).all():
                low = x
                below = self.residuals(x)
            if not np.isfinite(above).all():
                high = x
                above = self.residuals(x)
            width = (high - low).sum()
            if width > 0:
                columns.append((above - below) / width)
            else:
                columns.append(np.zeros_like(below))
        return np.stack(columns, axis=1)
