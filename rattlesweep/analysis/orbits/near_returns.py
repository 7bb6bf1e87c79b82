"""Starts of orbits: rows of a section of a run that nearly return."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rattlesweep.analysis.onerun.channels import VARIABLES, View
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.analysis.onerun.section import Section
from rattlesweep.analysis.orbits.orbit import Orbit, find_orbit
from rattlesweep.arrays import Floats
from rattlesweep.design.launch import Launch
from rattlesweep.design.models import model_of
from rattlesweep.kernel.follow import Follower
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.full import from_vectors
from rattlesweep.system.console import counted
from rattlesweep.words.errors import ConfigError

_MOST_CROSSINGS = 24  # of an orbit with the section
_LATE = 400.0  # length of the part of a run that is searched
_MOST_STARTS = 8  # the nearest returns, each of them tried
_SETTLED = 1e-4  # distance of a return, likewise, that is none
_NEAR = 0.2  # distance of a return, over the spread of the rows
_SAME_PERIOD = 1e-6  # relative difference of two orbits that are one


@dataclass(frozen=True)
class Return:
    """A state that nearly returns."""

    state: Floats
    period: float
    distance: float


def orbits_near(
    run: PreparedRun, section: str, from_time: float | None = None
) -> list[Orbit]:
    """Return the orbits near the late part of a run, without repetitions.

    A row of the section that nearly returns after some more crossings is a start: the
    nearest one for each number of crossings.  The part begins at `from_time`, by
    default at most 400 before the end and not in the first half.  Raises a ConfigError
    if no row leads to an orbit.
    """
    if run.model != "full" or run.losses:
        raise ConfigError(
            "orbits are those of model: full without friction, under which no motion "
            "returns; leave friction out"
        )
    if from_time is None:
        from_time = max(run.t_end / 2, run.t_end - _LATE)
    if not 0 <= from_time < run.t_end:
        raise ConfigError(
            f"from_time {from_time:g}: must be from 0 to t_end = {run.t_end:g}"
        )
    values: dict[str, Any] = dict(run.body)
    body = Rattleback(**values, units=run.units)
    states, times = _crossings(run, body, section, from_time)
    found: list[Orbit] = []
    starts = near_returns(states, times)
    for start in starts:
        if any(_is_multiple(start.period, other.period) for other in found):
            continue
        try:
            orbit = find_orbit(body, start.state, start.period, nearly=True)
        except ConfigError:
            continue
        if not any(_is_same(orbit, other) for other in found):
            found.append(orbit)
    if not found:
        raise ConfigError(
            f"section {section}: of {counted(len(states), 'crossing')} from t = "
            f"{from_time:g} on, {len(starts)} nearly return and none leads to an "
            "orbit; give a longer t_end, another section, or another launch"
        )
    return found


def _crossings(
    run: PreparedRun, body: Rattleback, section: str, from_time: float
) -> tuple[Floats, Floats]:
    """Return states, shape (crossings, 5), and times of the late part of a run."""
    plane = Section.parse(section, run.model, run.units)
    vector = VARIABLES["full"][1:]
    if from_time > 0.0:
        u, omega = _state_at(run, from_time)
        left = run.t_end - from_time
        run = PreparedRun.of(Launch(body, omega=omega, u=u, t_end=left))
    columns = Course(run, vector, section=plane).columns()
    states = np.stack([columns[name] for name in vector])
    return from_vectors(states[3:], states[:3]).T, columns["t"]


def _state_at(run: PreparedRun, time: float) -> tuple[list[float], list[float]]:
    """Return ``u`` and ``omega`` at a time, without a look at what is before it."""
    assert run.batch is not None
    setting = run.integrator
    tableau = METHODS[setting.pop("method")]
    follower = Follower(run.batch, tableau, model_of(run.config), **setting)
    samples = follower.at(np.array([time]))
    if not len(samples.t):
        raise ConfigError(
            f"from_time {time:g}: the run ends before, as {follower.status.meaning}"
        )
    u, omega = View(run.launches, follower, samples, None).vectors
    return u[:, 0].tolist(), omega[:, 0].tolist()


def near_returns(states: Floats, times: Floats) -> list[Return]:
    """Return the rows that nearly return, one for each number of crossings.

    Of many the nearest are kept, in the order of their periods.
    """
    found: list[Return] = []
    if len(states) < 2:
        return found
    spread = float(np.linalg.norm(states.std(axis=0)))
    # Of an orbit all crossings are the same, and nothing is spread but the scale.
    scale = max(spread, 1e-3 * float(np.linalg.norm(states, axis=1).mean()))
    for lag in range(1, min(_MOST_CROSSINGS, len(states) - 1) + 1):
        distances = np.linalg.norm(states[lag:] - states[:-lag], axis=1)
        k = int(distances.argmin())
        if distances[k] < _NEAR * scale:
            period = float(times[k + lag] - times[k])
            found.append(Return(states[k], period, float(distances[k])))
    # Where a run has settled, all returns are near, and the first is the orbit.
    found.sort(key=lambda each: max(each.distance, _SETTLED * scale))
    return sorted(found[:_MOST_STARTS], key=lambda each: each.period)


def _is_multiple(period: float, of: float) -> bool:
    """Return whether a period is several times another, so that nothing is new."""
    times = round(period / of)
    return times > 0 and abs(period / (times * of) - 1) < _SAME_PERIOD


def _is_same(orbit: Orbit, other: Orbit) -> bool:
    """Return whether two orbits of a body are one, or mirror images of one."""
    shifted = abs(orbit.period / other.period - 1)
    return bool(
        shifted < _SAME_PERIOD
        and np.allclose(orbit.multipliers, other.multipliers, rtol=1e-4, atol=1e-4)
        and np.isclose(orbit.n_mean, other.n_mean, rtol=1e-5, atol=1e-7)
    )
