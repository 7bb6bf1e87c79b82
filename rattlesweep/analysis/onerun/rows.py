"""Choose the rows of a trajectory."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError


@dataclass(frozen=True)
class EvenTimes:
    """Times ``start + step * k / parts`` for ``k`` from 0 to ``count - 1``, made when sliced.

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
    """One way to choose the rows; by default so many in a period of the pitch.

    Times are in ``sqrt(a/g)``.
    """

    points: int | None = None  # so many, evenly from 0 to the horizon
    dt: float | None = None  # one every dt
    steps: bool = False  # one per accepted step
    times: Any = None  # increasing times from 0 to the horizon
    from_time: float | None = None  # the first row where they are even; none is before
    # Without any of these: rows in a period of the pitch, and how many at least and at most.
    per_period: int = 20
    least: int = 2001
    most: int | None = None

    def up_to(self, t_end: float, periods: float) -> Times | None:
        """Return the times of the rows up to a horizon; None for the accepted steps.

        `periods` are those of the pitch up to there, 0 for a model without them.
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
            times = np.array(self.times, dtype=float, ndmin=1)
            good = times.ndim == 1 and times.size and np.isfinite(times).all()
            if not good or times[0] < 0 or times[-1] > t_end or np.any(np.diff(times) <= 0):
                raise ConfigError(f"times: a list that increases from 0 at least to t_end = "
                                  f"{t_end:g} is needed")  # fmt: skip
            return times
        if self.dt is not None:
            if not (math.isfinite(self.dt) and self.dt > 0):
                raise ConfigError(f"dt {self.dt:g}: the distance of two rows must be positive")
            # A last row at the horizon, also where rounding has dt * k just above it.
            count = math.floor((t_end - start) / self.dt * (1 + 1e-15)) + 1
            while start + self.dt * (count - 1) > t_end:
                count -= 1
            return EvenTimes(count, self.dt, start=start)
        points = self.points
        if points is None:
            periods *= (t_end - start) / t_end
            points = max(self.least, math.ceil(periods * self.per_period) + 1)
            points = points if self.most is None else min(points, self.most)
        if points < 2:
            raise ConfigError(f"points {points}: at least 2 are wanted, the first and the last")
        return EvenTimes(points, t_end - start, points - 1, start, t_end)
