"""The least-squares problem of a fit: parameters, trial runs, residuals, slopes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from rattlesweep.analysis.fit.film import Film
from rattlesweep.analysis.fit.measured import MeasuredBody, Prior
from rattlesweep.analysis.fit.trials import RunKey, Trials
from rattlesweep.arrays import Floats
from rattlesweep.design.launch import Launch
from rattlesweep.physics.body import PARAMETERS as BODY
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.si import Units
from rattlesweep.words.quantities import ACTING, RATE, TIME

MOST_KNOWN = 512  # runs that are remembered, those of a profile and more
_STEP = 3e-6  # of the central differences, relative to the scale of a parameter


class Parameter(NamedTuple):
    """A parameter that can be fitted."""

    unit: str
    low: float
    high: float
    description: str


# Quantities that a body is made from and does not keep.
SIZES = {
    "length": Parameter("m", 1e-9, 1e6, "length of the flat side"),
    "width": Parameter("m", 1e-9, 1e6, "width of the flat side"),
    "height": Parameter("m", 1e-9, 1e6, "height"),
    "mass": Parameter("kg", 1e-9, 1e9, "mass"),
    "weights": Parameter("kg", 1e-9, 1e9, "mass of each weight"),
    "wall": Parameter("m", 1e-9, 1e6, "thickness of the shell"),
    "axes_angle": Parameter("rad", -1.57, 1.57, "angle of the first radius"),
    "f_sd": Parameter("1", 0, 0.5, "I_yy / I_zz"),
}
FITTABLE = {
    "n_i": Parameter("sqrt(g/a)", -10, 10, "initial spin"),
    "omega_xy0": Parameter("sqrt(g/a)", 1e-9, 10, "initial oscillation"),
    "psi_deg": Parameter("deg", -360, 360, "direction of the initial oscillation"),
    **{
        name: Parameter(
            constant.unit,
            max(constant.low, constant.least_fitted),
            constant.most_fitted,
            constant.meaning,
        )
        for name, constant in ACTING.items()
        if constant.most_fitted
    },
    "skew": Parameter("rad", -math.pi / 2, math.pi / 2, "skew angle"),
    "xi": Parameter("rad", -math.pi / 2, math.pi / 2, "skew angle"),
    "theta": Parameter("1", 0, 1, "larger curvature"),
    "phi": Parameter("1", 0, 1, "smaller curvature"),
    "alpha": Parameter("1", 1, 1e6, "I_xx + 1"),
    "beta": Parameter("1", 1, 1e6, "I_yy + 1"),
    "gamma": Parameter("1", 0, 1e6, "I_zz"),
    "c": Parameter("a", 0, 1e6, "vertical semi-axis of the ellipsoid"),
    **SIZES,
}

OF_BODY = (*BODY, "c", "skew", *SIZES)


def ratio(unit: str, old: Units | None, new: Units | None) -> float:
    """Return the size of a unit of one body over its size for another body.

    It is 1 for units that are the same for all bodies, such as kg.
    """
    if old is None or new is None or unit not in old.sizes:
        return 1.0
    return float(old.sizes[unit][0] / new.sizes[unit][0])


def carried_over(launch: Launch, body: Rattleback) -> Launch:
    """Return the same launch in SI units for another body.

    A spin of 60 rpm is another number in the units of a body of another height.
    """
    old = launch.body.units
    new = body.units
    if old == new:
        return replace(launch, body=body)
    rate = ratio(RATE, old, new)
    changes: dict[str, Any] = {}
    for name in ("n_i", "omega_xy0"):
        value = getattr(launch, name)
        if value is not None:
            changes[name] = rate * value
    if launch.omega is not None:
        changes["omega"] = [rate * component for component in launch.omega]
    if launch.t_end is not None:
        changes["t_end"] = ratio(TIME, old, new) * launch.t_end
    losses = {
        name: ratio(ACTING[name].unit, old, new) * value
        for name, value in launch.losses.items()
    }
    return replace(launch, body=body, losses=losses, **changes)


@dataclass(frozen=True)
class FitProblem:
    """Residuals as a function of ``x``, the free parameters divided by their scales.

    Film, launch, scales and priors are in the units of the body that is given, also
    where ``x`` changes its size and so the units of the run.
    """

    launch: Launch
    film: Film
    scales: dict[str, float]
    # Called before each trial run, for progress.
    trial: Callable[[], None] = field(default=lambda: None)
    stone: MeasuredBody | None = None
    # Measured values of free parameters with their standard errors.
    priors: Mapping[str, Prior] = field(default_factory=dict)
    # What the residuals are divided by if the film has no standard errors.
    noise: float = 1.0
    trials: Trials = field(default_factory=Trials)

    @property
    def unknowns(self) -> int:
        """Number of parameters, with the first direction of angles."""
        return len(self.scales) + int(self.film.kind == "angle")

    @property
    def rows(self) -> int:
        """Number of values of the film, whose residuals precede those of the priors."""
        return int(self.film.known.sum())

    @property
    def freedom(self) -> int:
        """Number of values, of film and priors, less the unknowns."""
        return self.rows + len(self.priors) - self.unknowns

    def until(self, share: float) -> FitProblem:
        """Return the problem of the first part of the data."""
        film = self.film.until(share)
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

    def body(self, values: dict[str, float]) -> Rattleback:
        """Return the body with some parameters; or raise a ValueError."""
        sizes = {}
        changes = dict(values)
        body = self.launch.body
        if self.stone is not None:
            for name in values:
                # Without a prior, the parameter of the finished body is meant.
                if name in SIZES or name in self.stone.priors:
                    sizes[name] = changes.pop(name)
            if sizes:
                body = self.stone.remade(sizes)
        if "skew" in changes:
            changes["xi"] = -changes.pop("skew")
        return body.replace(**changes)

    def launched(self, x: Floats) -> Launch:
        """Return the run with the parameters at ``x``; or raise a ValueError."""
        changes: dict[str, Any] = self.values(x)
        if "psi_deg" in changes:
            changes["psi"] = changes.pop("psi_deg")
        of_body = {name: changes.pop(name) for name in OF_BODY if name in changes}
        losses = {name: changes.pop(name) for name in ACTING if name in changes}
        losses = {**self.launch.losses, **losses}
        launch = replace(self.launch, losses=losses, **changes)
        return carried_over(launch, self.body(of_body))

    def expected(self, x: Floats) -> Floats:
        """Return the values without noise; angles start from the best first direction.

        Raises a ValueError if no such run exists or its integration fails.
        """
        (values,) = self.expected_at([x])
        if isinstance(values, ValueError):
            raise values
        return values

    def expected_at(self, places: Sequence[Floats]) -> list[Floats | ValueError]:
        """Return what :meth:`expected` does at several ``x``, or why there is none."""
        film = self.film
        known = self.trials.known
        keys = [self._key(x) for x in places]
        launches: dict[RunKey, Launch] = {}
        # Searches begin and end where others have been.
        for key, x in zip(keys, places, strict=True):
            if key in known or key in launches:
                continue
            self.trial()
            try:
                launches[key] = self.launched(x)
            except ValueError as error:
                known[key] = error
        runs = [*launches.values()]
        # From units of the body that is given to those of the bodies of the runs.
        given = self.launch.body.units
        sizes = [ratio(TIME, given, run.body.units) for run in runs]
        if film.kind == "reversal":
            found = self.trials.reversal_times(runs, len(film.t))
        else:
            times = [film.t * size for size in sizes]
            found = self.trials.follow(runs, film.kind, times)
        for key, size, values in zip(launches, sizes, found, strict=True):
            if isinstance(values, ValueError):
                known[key] = values
            elif film.kind == "reversal":
                known[key] = values / size
            elif film.kind == "angle":
                known[key] = values
            else:
                known[key] = values * size
        answers = [known[key] for key in keys]
        while len(known) > MOST_KNOWN:
            del known[next(iter(known))]
        for place, angles in enumerate(answers):
            if film.kind == "angle" and not isinstance(angles, ValueError):
                direction = self.first_direction(film.value - angles)
                answers[place] = angles + direction
        return answers

    def _key(self, x: Floats) -> RunKey:
        """Return what the run at ``x`` and its times depend on, in a fit."""
        return (*self.values(x).values(), self.launch.t_end, len(self.film.t))

    def first_direction(self, angles: Floats) -> float:
        """Return the mean of some angles, weighted by the errors of the film."""
        if self.film.error is None:
            return float(np.nanmean(angles))
        weights = self.film.error[self.film.known] ** -2.0
        return float(np.average(angles[self.film.known], weights=weights))

    @property
    def errors(self) -> Floats:
        """Standard errors of the rows that have a value."""
        if self.film.error is None:
            return np.full(self.rows, self.noise)
        return self.film.error[self.film.known]

    def residuals(self, x: Floats) -> Floats:
        """Return the residuals over their standard errors, those of the priors last.

        They are infinite if the run does not exist or fails, which SciPy's search takes
        as a step that was too long.
        """
        (residuals,) = self.residuals_at([x])
        return residuals

    def residuals_at(self, places: Sequence[Floats]) -> list[Floats]:
        """Return the residuals at several ``x``, as :meth:`residuals` does at one."""
        return [
            self._residuals_of(x, expected)
            for x, expected in zip(places, self.expected_at(places), strict=True)
        ]

    def _residuals_of(self, x: Floats, expected: Floats | ValueError) -> Floats:
        if isinstance(expected, ValueError):
            return np.full(self.rows + len(self.priors), np.inf)
        rows = (self.film.value - expected)[self.film.known] / self.errors
        values = self.values(x)
        pulls = [
            (values[name] - prior.value) / prior.error
            for name, prior in self.priors.items()
        ]
        return np.concatenate([rows, pulls])

    def succeeds(self, x: Floats) -> bool:
        """Return whether the run at ``x`` exists and is integrated to its end."""
        return bool(np.isfinite(self.residuals(x)).all())

    def limits(self) -> tuple[Floats, Floats]:
        """Return the lowest and the highest ``x``."""
        low = self.scaled({name: FITTABLE[name].low for name in self.scales})
        high = self.scaled({name: FITTABLE[name].high for name in self.scales})
        return low, high

    def slopes(self, x: Floats) -> Floats:
        """Return the Jacobian of the residuals by central differences."""
        limits = self.limits()
        steps = np.diag(np.full(len(x), _STEP))
        lows = [np.clip(x - step, *limits) for step in steps]
        highs = [np.clip(x + step, *limits) for step in steps]
        residuals = self.residuals_at([*lows, *highs])
        columns = []
        for place, (low, high) in enumerate(zip(lows, highs, strict=True)):
            below = residuals[place]
            above = residuals[place + len(lows)]
            # Next to a run that fails, the difference is taken on the other side.
            if not np.isfinite(below).all():
                low = x
                below = self.residuals(x)
            if not np.isfinite(above).all():
                high = x
                above = self.residuals(x)
            columns.append(_slope(below, above, (high - low).sum()))
        return np.stack(columns, axis=1)

    def rough_slopes(self, x: Floats, here: Floats, places: Sequence[int]) -> Floats:
        """Return the columns of the Jacobian at `places` by differences on one side.

        The residuals at ``x`` are known, `here`.
        """
        moved = [*self._beside(x)[places]]
        columns = []
        for to, there in zip(moved, self.residuals_at(moved), strict=True):
            if not np.isfinite(there).all():
                to = np.clip(x - (to - x), *self.limits())
                there = self.residuals(to)
            columns.append(_slope(here, there, (to - x).sum()))
        return np.stack(columns, axis=1)

    def _beside(self, x: Floats) -> Floats:
        """Return ``x`` after a small step along each parameter."""
        low, high = self.limits()
        steps = np.diag(np.full(len(x), _STEP))
        # From a limit there is one way only.
        ways = np.where((x + steps <= high).all(axis=1), 1.0, -1.0)
        return np.asarray(np.clip(x + ways[:, None] * steps, low, high))

    def look_ahead(self, starts: Sequence[Floats]) -> list[Floats]:
        """Make the first runs of searches side by side; return the starts that succeed.

        The searches find these runs known.
        """
        begun = [
            x
            for x, residuals in zip(starts, self.residuals_at(starts), strict=True)
            if np.isfinite(residuals).all()
        ]
        self.residuals_at([beside for x in begun for beside in self._beside(x)])
        return begun


def _slope(below: Floats, above: Floats, width: float) -> Floats:
    """Return the slope of residuals; where a side fails, nothing is known of it."""
    if width == 0:
        return np.zeros_like(below)
    slope = (above - below) / width
    return np.where(np.isfinite(slope), slope, 0.0)
