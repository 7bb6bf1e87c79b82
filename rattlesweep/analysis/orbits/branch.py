"""Families of orbits by continuation in the pseudo-arclength, through folds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.analysis.orbits.flow import LOOSE
from rattlesweep.analysis.orbits.orbit import (
    PARAMETER,
    PERIOD,
    Family,
    Orbit,
    Solution,
    as_orbit,
    body_at,
    flow_of,
    kind_of_multipliers,
    orbit_at,
    row_of,
    solved_at,
)
from rattlesweep.analysis.orbits.tabulated import save_orbits, with_units
from rattlesweep.arrays import Floats
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.full import N_STATE
from rattlesweep.words.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FEW, _MANY = 3, 6  # iterations after which steps grow or shrink
_TURNED = 0.9  # least cosine between the directions of two points
_SHORTEST = 1e-9  # step of a family that ends
_LONGEST = 4.0  # of the first step
_SMALLEST = 1e-3  # period times speed of an orbit that shrinks to a steady spin
_HALVED = 1e-3  # distance after half a period where a doubled family begins
_ONE_POINT = 1e-5  # distance of two special points that are one
# Where an interval that holds a special point is cut; what is tried in turn.
_PARTS = (0.5, 0.4, 0.6, 0.25, 0.75)
# Of the first orbit of a doubled family, over the state; what is tried in turn.
_AMPLITUDES = (0.005, 0.02, 0.001)


def _determinant(sign: float) -> Callable[[Solution], float]:
    def test(point: Solution) -> float:
        return float(np.linalg.det(point.monodromy + sign * np.eye(3)))

    return test


def _fold(point: Solution) -> float:
    """Return a number that changes its sign where the parameter turns back."""
    return float(point.tangent[PARAMETER])


def _torus(point: Solution) -> float:
    """Return a number that changes its sign where a pair of multipliers has product 1.

    It is zero, too, where two real multipliers have the product 1, which is nothing
    special.
    """
    first, second, third = point.multipliers
    pairs = (first * second - 1) * (first * third - 1) * (second * third - 1)
    return float(pairs.real)


# The points of a family at which a multiplier crosses the unit circle, which
# docs/orbits.md explains, by the numbers that are zero there.
CROSSINGS = {
    "fold": _fold,
    "doubling": _determinant(1.0),
    "torus": _torus,
    "branching": _determinant(-1.0),
}


class _NoOrbit(Exception):
    """No orbit was found at a point of a family."""


@dataclass(frozen=True)
class Member:
    """An orbit of a branch, and what is special about it."""

    point: Solution
    name: str | None = None  # of CROSSINGS
    accuracy: float = np.nan  # of the parameter at a special point


@dataclass(frozen=True, repr=False)
class Branch:
    """A family of orbits along one parameter.

    The DataFrame `table` has a row for each orbit, in the order of the family, with
    units in ``attrs``.  The column `point` names special points, `accuracy` is the
    error of the parameter there.

    Stability: stable.
    """

    body: Rattleback
    family: Family
    points: tuple[Member, ...]
    end: str  # why it ends, as a sentence

    @cached_property
    def table(self) -> pd.DataFrame:
        """The orbits, a row each."""
        import pandas as pd

        return with_units(pd.DataFrame([self._row(row) for row in self.points]))

    def _row(self, row: Member) -> dict[str, Any]:
        point = row.point
        orbit = as_orbit(body_at(self.body, self.family, point.x), point)
        found: dict[str, Any] = dict(row_of(orbit))
        along = self.family.along
        if along != "energy":
            found = {along: float(point.x[PARAMETER]), **found}
        found["kind"] = kind_of_multipliers(point.multipliers)
        found["point"] = row.name
        found["accuracy"] = row.accuracy
        return found

    def orbit(self, row: int) -> Orbit:
        """Return the orbit of a row, with its errors."""
        if not 0 <= row < len(self.points):
            raise ConfigError(
                f"row {row}: the branch has the rows 0 to {len(self.points) - 1}"
            )
        return orbit_at(self.body, self.family, self.points[row].point)

    def doubled(self, row: int | None = None) -> Orbit:
        """Return an orbit of the doubled family that begins at a row.

        By default it is the first doubling of the branch.
        """
        doublings = [k for k, each in enumerate(self.points) if each.name == "doubling"]
        if not doublings:
            raise ConfigError("doubled: the branch has no doubling; follow it further")
        if row is None:
            row = doublings[0]
        if row not in doublings:
            raise ConfigError(
                f"doubled: row {row} is no doubling; choose one of {doublings}"
            )
        point = self.points[row].point
        return orbit_at(self.body, self.family, doubled_from(self.family, point))

    def plot(
        self,
        path: str | Path | None = None,
        *,
        y: str = "period",
        ax: Axes | None = None,
    ) -> Figure:
        """Draw the family, and write the figure to a `path`.

        `y` is a column of the table, such as ``period`` or ``n_mean``.  Stable orbits
        are solid, others dashed, and special points are marked.  The figure is that of
        `ax`, if these axes are given.
        """
        from rattlesweep.analysis.orbits.drawing import draw_family

        return draw_family(self.table, self.family.along, y, path, ax)

    def save(self, path: str | Path) -> None:
        """Write the table to a .parquet file, with units, or to a .csv file."""
        save_orbits(self.table, path)

    def __repr__(self) -> str:
        along = self.family.along
        first = self.points[0].point.x[PARAMETER]
        last = self.points[-1].point.x[PARAMETER]
        lines = [
            f"{len(self.points)} orbits along {along} from {first:.6g} to {last:.6g}; "
            f"{self.end}"
        ]
        for k, row in enumerate(self.points):
            if row.name is not None:
                x = row.point.x
                lines.append(
                    f"{row.name} at {along} {x[PARAMETER]:.12g} +- {row.accuracy:.1g}, "
                    f"period {x[PERIOD]:.10g} (row {k})"
                )
        return "\n".join(lines)


def follow_branch(
    orbit: Orbit, along: str, to: float, steps: int, report: Callable[[int], Any]
) -> Branch:
    """Return the family of an orbit along a parameter.

    It begins towards `to`, and ends there or after some steps.
    """
    family = Family(flow_of(orbit.body), along, orbit.energy)
    begin = orbit.energy if along == "energy" else float(getattr(orbit.body, along))
    if to == begin:
        raise ConfigError(f"to {to:g}: the orbit is there already; give another value")
    x = np.array([*orbit.state, orbit.period, begin])
    start = Solution(x, family.arrival(x))
    start = replace(start, matrix=family.equations(x, start)[1])
    # Its length is kept, as at a fold there may be none at the same parameter.
    found = family.solve(x, start, start.tangent, float(start.tangent @ x))
    if found is None:
        raise ConfigError("orbit: it does not return; take one that rs.orbit returns")
    first = found[0]
    direction = first.tangent
    if direction[PARAMETER] * (to - begin) < 0:
        direction = -direction
    steep = max(abs(direction[PARAMETER]), 0.05)
    step = abs(to - begin) / steps / steep
    rows = [Member(first)]
    walk = Walk(family, to, np.sign(to - begin), step, steps)
    for row in walk.rows(replace_tangent(first, direction)):
        rows.append(row)
        report(len(rows))
    return Branch(orbit.body, family, tuple(rows), walk.end)


def replace_tangent(point: Solution, tangent: Floats) -> Solution:
    """Return a point with another sense of its tangent."""
    oriented = replace(point)
    oriented.__dict__["tangent"] = tangent
    return oriented


@dataclass
class Walk:
    """A walk along a family in steps of adapted length."""

    family: Family
    to: float
    sense: float  # of the parameter at the begin
    step: float
    steps: int
    end: str = ""

    def rows(self, point: Solution) -> Iterator[Member]:
        """Yield orbits after a first one, with special points between them."""
        longest = _LONGEST * self.step
        first = point
        step = self.step
        taken = 0
        while taken < self.steps:
            found = self._next(point, step)
            if found is None:
                step /= 2
                if step < _SHORTEST:
                    self.end = "it ends where no next orbit was found"
                    return
                continue
            new, iterations = found
            taken += 1
            if self._is_beyond(new):
                row = np.eye(N_STATE + 2)[PARAMETER]
                last = self.family.solve(new.x, point, row, self.to)
                if last is not None:
                    new = oriented(last[0], point)
                yield from self._special(point, new)
                yield Member(new)
                self.end = f"it has reached {self.to:g}"
                return
            for member in self._special(point, new):
                if member.name == "fold" and self._is_halved(member.point):
                    yield replace(member, name=None, accuracy=np.nan)
                    self.end = "it ends at the orbit of half its period, a doubling"
                    return
                yield member
            closed = self._closing(first, point, new)
            if closed is not None:
                yield Member(closed)
                self.end = "it closes on itself"
                return
            yield Member(new)
            speed = np.linalg.norm(new.arrival.rate_before)
            if speed * new.x[PERIOD] < _SMALLEST:
                self.end = "it shrinks to a steady spin"
                return
            if iterations <= _FEW:
                step = min(1.5 * step, longest)
            if iterations >= _MANY:
                step /= 2
            point = new
        self.end = f"it has taken {self.steps} steps"

    def _closing(
        self, first: Solution, before: Solution, after: Solution
    ) -> Solution | None:
        """Return the first orbit if it lies between two, None if it does not.

        It may come back at another phase, or turned by half a turn about its z axis,
        which is the same orbit of the same body.
        """
        begin = first.x[PARAMETER]
        passed = before.x[PARAMETER] - begin, after.x[PARAMETER] - begin
        is_passed = self.sense * passed[0] < 0 <= self.sense * passed[1]
        if not is_passed:
            return None
        share = passed[0] / (passed[0] - passed[1])
        x = before.x + share * (after.x - before.x)
        x[PARAMETER] = begin
        found = solved_at(self.family, replace(before, x=x))
        if found is None:
            return None
        own = np.array([found.x[PERIOD], found.arrival.spin])
        same = np.array([first.x[PERIOD], first.arrival.spin])
        return found if np.abs(own - same).max() < _ONE_POINT else None

    def _is_halved(self, point: Solution) -> bool:
        """Return whether an orbit is one of half its period, run through twice.

        A doubled family turns back where it begins, and goes on at another phase.
        """
        x = point.x.copy()
        x[PERIOD] /= 2
        distance = np.linalg.norm(self.family.arrival(x).state - x[:N_STATE])
        return bool(distance < _HALVED * (1 + np.linalg.norm(x[:N_STATE])))

    def _next(self, point: Solution, step: float) -> tuple[Solution, int] | None:
        """Return the orbit a step further, None if the step is too long."""
        tangent = point.tangent
        predicted = point.x + step * tangent
        if not self._is_possible(predicted):
            return None
        found = self.family.solve(predicted, point, tangent, float(tangent @ predicted))
        if found is None:
            return None
        new = oriented(found[0], point)
        is_near = np.linalg.norm(new.x - predicted) < 0.5 * step
        if not is_near or new.tangent @ tangent < _TURNED:
            return None
        return new, found[1]

    def _is_possible(self, x: Floats) -> bool:
        """Return whether there is a body with a parameter."""
        if self.family.along == "energy":
            return True
        values: dict[str, Any] = dict(
            zip(PARAMETERS, self.family.flow.parameters, strict=True)
        )
        values[self.family.along] = float(x[PARAMETER])
        try:
            Rattleback(**values)
        except ValueError:
            return False
        return True

    def _is_beyond(self, point: Solution) -> bool:
        return bool(self.sense * (point.x[PARAMETER] - self.to) >= 0)

    def _special(self, before: Solution, after: Solution) -> Iterator[Member]:
        """Yield the special points between two orbits, in their order."""
        found = []
        for name, test in CROSSINGS.items():
            if test(before) * test(after) < 0:
                row = self._located(name, before, after)
                if row is not None:
                    found.append(row)
        kept: list[Member] = []
        for row in found:
            # At a fold a multiplier is 1, too, and at a symmetric one they all are.
            if not any(_is_near(row.point, other.point) for other in kept):
                kept.append(row)
        yield from sorted(kept, key=lambda row: float(before.tangent @ row.point.x))

    def _located(self, name: str, before: Solution, after: Solution) -> Member | None:
        """Return the point between two orbits at which a test is zero."""
        from scipy.optimize import brentq

        tangent = before.tangent
        begin = float(tangent @ before.x)
        length = float(tangent @ after.x) - begin
        points = []
        for tol in (self.family.flow.tol, LOOSE):
            flow = replace(self.family.flow, tol=tol)
            family = replace(self.family, flow=flow)

            def on_way(share: float, family: Family = family) -> Solution:
                guess = before.x + share * (after.x - before.x)
                value = begin + share * length
                solved = family.solve(guess, before, tangent, value)
                if solved is None:
                    raise _NoOrbit
                return oriented(solved[0], before)

            try:
                share = brentq(
                    lambda s: CROSSINGS[name](on_way(s)),
                    0.0,
                    1.0,
                    xtol=1e-13,
                    rtol=1e-13,
                )
            except _NoOrbit:
                # Where two families meet, equations have no single solution.
                points = _narrowed(CROSSINGS[name], on_way, before, after)
                break
            points.append(on_way(share))
        point = points[0]
        if name == "torus" and not np.iscomplex(point.multipliers).any():
            return None
        accuracy = abs(float(point.x[PARAMETER] - points[1].x[PARAMETER]))
        return Member(point, name, accuracy)


def _narrowed(
    test: Callable[[Solution], float],
    on_way: Callable[[float], Solution],
    before: Solution,
    after: Solution,
) -> list[Solution]:
    """Return two orbits that are near to each other, with a zero of a test between.

    The way between `before` (share 0) and `after` (share 1) is halved where there are
    orbits; where there is none, another point of it is tried.
    """
    low, high = 0.0, 1.0
    first, last = before, after
    while high - low > _ONE_POINT:
        for part in _PARTS:
            share = low + part * (high - low)
            try:
                found = on_way(share)
            except _NoOrbit:
                continue
            break
        else:
            break
        if test(found) * test(first) > 0:
            low, first = share, found
        else:
            high, last = share, found
    return [last, first]


def _is_near(point: Solution, other: Solution) -> bool:
    return bool(np.linalg.norm(point.x - other.x) < _ONE_POINT)


def oriented(point: Solution, before: Solution) -> Solution:
    """Return a point whose tangent goes on in the direction of the one before."""
    if point.tangent @ before.tangent < 0:
        return replace_tangent(point, -point.tangent)
    return point


def doubled_from(family: Family, point: Solution) -> Solution:
    """Return an orbit of twice the period beside a doubling."""
    values, vectors = np.linalg.eig(point.monodromy)
    nearest = np.abs(values + 1).argmin()
    across = point.transverse @ vectors[:, nearest].real
    row = np.zeros(N_STATE + 2)
    row[:N_STATE] = across / np.linalg.norm(across)
    # The family itself, whose orbits close after two periods as well, is across this.
    row -= (row @ point.tangent) * point.tangent
    x = point.x.copy()
    x[PERIOD] *= 2
    anchor = Solution(x, family.arrival(x))
    size = float(np.linalg.norm(x[:N_STATE]))
    for amplitude in _AMPLITUDES:
        guess = x + amplitude * size * row
        found = family.solve(guess, anchor, row, float(row @ guess))
        if found is not None:
            return found[0]
    raise ConfigError("doubled: no orbit of twice the period was found beside it")
