"""Which rows a trajectory has."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError


@dataclass(frozen=True)
class EvenTimes:
    """``start + step * k / parts`` for ``k`` from 0 to ``count - 1``, made as they are sliced out.

    None of them is after ``last``, by rounding.
    """

    count: int
    step: float
    parts: int = 1
    start: float = 0.0
    last: float = math.inf

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, part: slice) -> Floats:
        k = np.arange(*part.indices(self.count), dtype=float)
        # One division, of exact whole numbers: the last of N points is the horizon itself.
        return np.minimum(self.start + self.step * (k / self.parts), self.last)


Times: TypeAlias = EvenTimes | Floats


@dataclass(frozen=True)
class Rows:
    """One way to choose the rows; without any, so many in a period of the pitch.

    Times are in ``sqrt(a/g)``.
    """

    points: int | None = None  # so many, evenly from 0 to the horizon
    dt: float | None = None  # one every dt
    steps: bool = False  # one per accepted step
    times: Any = None  # increasing times from 0 to the horizon
    from_time: float | None = None  # of the first row where they are even; none is before
    # Without any of these: rows in a period of the pitch, and how many at least and at most.
    per_period: int = 20
    least: int = 2001
    most: int | None = None

    def up_to(self, t_end: float, periods: float) -> Times | None:
        """Times of the rows up to a horizon, in ``sqrt(a/g)``; None for the accepted steps.

        ``periods`` are those of the pitch up to there, 0 for a model without them.  Refuses more
        than one way, and what makes no increasing times.
        """
        ways = {"points": self.points, "dt": self.dt, "steps": self.steps or None,
                "times": self.times}  # fmt: skip
        given = [name for name, value in ways.items() if value is not None]
        if len(given) > 1:
            raise ConfigError(f"{' and '.join(given)} are both given; keep one of them")
        start = float(self.from_time or 0.0)
        if not 0 <= start < t_end:
            raise ConfigError(
                f"from_time {start:g}: rows begin at 0 or later, before t_end = {t_end:g}"
            )
        if self.steps:
            return None
        if self.times is not None:
            if self.from_time is not None:
                raise ConfigError("times and from_time are both given; keep one of them")
            return _checked(self.times, t_end)
        if self.dt is not None:
            return _spaced(self.dt, start, t_end)
        points = self.points
        if points is None:
            periods *= (t_end - start) / t_end
            points = max(self.least, math.ceil(periods * self.per_period) + 1)
            points = points if self.most is None else min(points, self.most)
        if points < 2:
            raise ConfigError(f"points {points}: at least 2 are wanted, the first and the last")
        return EvenTimes(points, t_end - start, points - 1, start, t_end)


def _checked(times: Any, t_end: float) -> Floats:
    array = np.array(times, dtype=float, ndmin=1)
    if array.ndim != 1 or not array.size or not np.all(np.isfinite(array)):
        raise ConfigError("times: a list of finite numbers is needed")
    if array[0] < 0 or array[-1] > t_end or np.any(np.diff(array) <= 0):
        raise ConfigError(f"times: they must increase, from 0 at least to t_end = {t_end:g}")
    return array


def _spaced(dt: float, start: float, t_end: float) -> EvenTimes:
    if not (math.isfinite(dt) and dt > 0):
        raise ConfigError(f"dt {dt:g}: the distance of two rows must be positive")
    # A last row at the horizon, also where rounding has dt * k just above it.
    count = math.floor((t_end - start) / dt * (1 + 1e-15)) + 1
    while start + dt * (count - 1) > t_end:
        count -= 1
    return EvenTimes(count, dt, start=start)
