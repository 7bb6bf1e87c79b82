"""One periodic orbit: a Newton method for its closure, its multipliers and its kind.

At fixed parameters periodic orbits come in families over the energy, so that the
equations are the closure, the energy and a phase condition.  They are more than the
unknowns, and are solved by least squares.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.analysis.orbits.flow import LOOSE, Arrival, Flow
from rattlesweep.arrays import Floats
from rattlesweep.design.launch import Launch
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.full import N_STATE, TINY, from_vectors, to_vectors
from rattlesweep.words.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PERIOD, PARAMETER = N_STATE, N_STATE + 1  # places in the unknowns after the state
_ITERATIONS = 20
_HALVINGS = 5
_AROUND = 0.2  # part of a period about it in which the nearest return is searched
_SHORTEST_WAY = 1 / 64  # part of the way to another energy
_CLOSED = 1e-9  # distance of a state from its return, in an orbit
# A period's part of these numbers may be an orbit's whole one.
_PARTS = (2, 3, 5, 7, 11, 13, 17, 19, 23)
_SAME = 1e-7  # distance after a part of the period that is an error
_NO_MOTION = 1e-5  # period times speed, in which a body only spins upright
_FLAT = 0.05  # share of the parameter in the direction of a family near a fold
_ON_CIRCLE = 1e-6  # distance of a multiplier from the unit circle that is an error
STABILITIES = {
    "stable": "all multipliers lie inside the unit circle",
    "saddle": "the largest multiplier is real and above 1",
    "doubling": "the largest multiplier is real and below -1",
    "torus": "the largest multipliers are a complex pair outside the unit circle",
    "repelling": "all multipliers lie outside: it is stable in reversed time",
    "neutral": "none lies outside the unit circle, but some lie on it",
}
"""Kinds of orbits, with what they mean."""


@dataclass(frozen=True)
class Family:
    """Equations of orbits that depend on one parameter: the energy, or one of the body.

    The unknowns are the five variables of the state, the period and the parameter.
    """

    flow: Flow
    along: str = "energy"
    energy: float = 0.0  # where the parameter is another

    def flow_at(self, x: Floats) -> Flow:
        """Return the flow of the body that some unknowns have."""
        if self.along == "energy":
            return self.flow
        return self.flow.with_parameter(self.along, float(x[PARAMETER]))

    def arrival(self, x: Floats) -> Arrival:
        """Return where the flow leads in a period."""
        return self.flow_at(x)(x[:N_STATE], float(x[PERIOD]))

    def equations(self, x: Floats, anchor: Solution) -> tuple[Floats, Floats, Arrival]:
        """Return the residuals of closure, phase and energy, with their derivative.

        The state lies in the plane through that of the `anchor`, normal to its rate.
        """
        flow = self.flow_at(x)
        y = x[:N_STATE]
        arrival = flow(y, float(x[PERIOD]))
        normal = anchor.arrival.rate_before
        normal = normal / (np.linalg.norm(normal) + TINY)
        residuals = np.zeros(N_STATE + 2)
        matrix = np.zeros((N_STATE + 2, N_STATE + 2))
        residuals[:N_STATE] = arrival.state - y
        matrix[:N_STATE, :N_STATE] = arrival.derivative - np.eye(N_STATE)
        matrix[:N_STATE, PERIOD] = arrival.rate
        residuals[PERIOD] = normal @ (y - anchor.x[:N_STATE])
        matrix[PERIOD, :N_STATE] = normal
        matrix[PARAMETER, :N_STATE] = arrival.gradient
        if self.along == "energy":
            residuals[PARAMETER] = arrival.energy - x[PARAMETER]
            matrix[PARAMETER, PARAMETER] = -1.0
        else:
            residuals[PARAMETER] = arrival.energy - self.energy
            by_parameter = flow.by_parameter(self.along, y, float(x[PERIOD]))
            matrix[:N_STATE, PARAMETER], matrix[PARAMETER, PARAMETER] = by_parameter
        return residuals, matrix, arrival

    def solve(
        self, x: Floats, anchor: Solution, row: Floats, value: float
    ) -> tuple[Solution, int] | None:
        """Return the orbit near some unknowns with ``row . x = value``.

        The second value is the number of iterations.  None is returned if Newton's
        method does not converge.
        """
        x = x.copy()
        residuals, matrix, arrival = self._with_row(x, anchor, row, value)
        size = np.linalg.norm(residuals)
        for iteration in range(_ITERATIONS):
            if not np.isfinite(size) or not np.isfinite(matrix).all():
                return None
            step = np.linalg.lstsq(matrix, -residuals)[0]
            # A period changes by a fifth at most, and does not become negative.
            step *= min(1.0, 0.2 * x[PERIOD] / (abs(step[PERIOD]) + 1e-300))
            for _ in range(_HALVINGS):
                trial = x + step
                found = self._with_row(trial, anchor, row, value)
                smaller = np.linalg.norm(found[0])
                if smaller < size or smaller < 1e-11:
                    break
                step = step / 2
            else:
                return None
            x = trial
            residuals, matrix, arrival = found
            size = smaller
            # The last step is as small as rounding lets it be.
            if np.linalg.norm(step) < 1e-9 * (1 + np.linalg.norm(x)) and size < _CLOSED:
                return Solution(x, arrival, matrix[:-1]), iteration + 1
        return None

    def _with_row(
        self, x: Floats, anchor: Solution, row: Floats, value: float
    ) -> tuple[Floats, Floats, Arrival]:
        residuals, matrix, arrival = self.equations(x, anchor)
        residuals = np.append(residuals, row @ x - value)
        return residuals, np.vstack([matrix, row]), arrival


@dataclass(frozen=True)
class Solution:
    """A solution of the equations of a family, or the begin of a search for one."""

    x: Floats  # state, period, parameter
    arrival: Arrival
    matrix: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    @cached_property
    def transverse(self) -> Floats:
        """An orthonormal basis of the states of equal energy, across the flow; (5, 3).

        Of the derivative over a period, the multipliers of the flow and of the energy,
        which are 1, are left out exactly: it maps the flow to itself, and keeps the
        gradient of the energy.
        """
        fixed = np.stack([self.arrival.rate_before, self.arrival.gradient])
        return np.linalg.svd(fixed)[2][2:].T

    @cached_property
    def monodromy(self) -> Floats:
        """The derivative over a period across the flow at constant energy, (3, 3)."""
        across = self.transverse
        return across.T @ self.arrival.derivative @ across

    @cached_property
    def multipliers(self) -> Floats:
        """Its eigenvalues, the largest first."""
        values: Floats = np.linalg.eigvals(self.monodromy)  # type: ignore[assignment]
        order = np.lexsort((-values.imag, -np.abs(values).round(12)))
        return values[order]

    @cached_property
    def tangent(self) -> Floats:
        """The direction of the family: what the equations do not change."""
        return np.linalg.svd(self.matrix)[2][-1]


@dataclass(frozen=True, repr=False)
class Orbit:
    """A periodic orbit of a body without friction.

    It is periodic in ``u`` and ``omega``: after a `period` the body has the same
    motion, turned about the vertical by `turn` and moved on the plane.  `omega` and `u`
    are one of its states, along the body's axes.  `multipliers` are the three that
    belong neither to the flow nor to the energy, the largest first; the other two are
    1.  `errors` are those of the multipliers, `period_error` and `state_error` those of
    the others: the difference from the orbit at a tolerance that is a hundred times as
    large.  `closure` is the distance of the state from its return, `n_mean` the mean
    spin, and `volume_rate` the mean rate of the phase volume, whose growth over a
    period is the product of the multipliers.  Units are those of the body.

    Stability: stable.
    """

    body: Rattleback
    omega: tuple[float, float, float]
    u: tuple[float, float, float]
    period: float
    energy: float
    multipliers: Floats
    errors: Floats
    period_error: float
    state_error: float
    closure: float
    n_mean: float
    volume_rate: float
    turn: float  # in degrees, seen from above

    @property
    def kind(self) -> str:
        """A word for its stability: see :data:`STABILITIES`."""
        return kind_of_multipliers(self.multipliers)

    @property
    def state(self) -> Floats:
        """Its state in the variables of the equations, shape (5,)."""
        return from_vectors(self.u, self.omega)

    def rows(self) -> list[tuple[str, str]]:
        """Return names and values of what is known of it."""
        vectors = {
            name: ", ".join(f"{component:.12g}" for component in vector)
            for name, vector in (("omega", self.omega), ("u", self.u))
        }
        values = zip(self.multipliers, self.errors, strict=True)
        return [
            ("kind", f"{self.kind}: {STABILITIES[self.kind]}"),
            ("energy", f"{self.energy:.12g}"),
            ("period", f"{self.period:.12g} +- {self.period_error:.1g}"),
            *vectors.items(),
            *(("multiplier", f"{value:.9g} +- {error:.1g}") for value, error in values),
            ("closure", f"{self.closure:.1g}"),
            ("n_mean", f"{self.n_mean:.9g}"),
            ("volume_rate", f"{self.volume_rate:.9g}"),
            ("turn", f"{self.turn:.6g} degrees a period"),
        ]

    def __repr__(self) -> str:
        lines = [f"{name:<12} {value}" for name, value in self.rows()]
        return "\n".join(["Periodic orbit", *lines])

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw one period over time, and write the figure to a `path`."""
        from rattlesweep.analysis.orbits.drawing import draw_period

        run = Launch(self.body, omega=self.omega, u=self.u, t_end=self.period)
        return draw_period(run, path)


def kind_of_multipliers(multipliers: Floats) -> str:
    """Return the word for the stability of an orbit with three multipliers."""
    sizes = np.abs(multipliers)
    outside = sizes > 1 + _ON_CIRCLE
    if (sizes < 1 - _ON_CIRCLE).all():
        return "stable"
    if not outside.any():
        return "neutral"
    if outside.all():
        return "repelling"
    largest = multipliers[sizes.argmax()]
    if abs(largest.imag) > 0:
        return "torus"
    return "saddle" if largest.real > 0 else "doubling"


def flow_of(body: Rattleback) -> Flow:
    """Return the flow of a body."""
    values = tuple(float(getattr(body, name)) for name in PARAMETERS)
    return Flow(values, 0.0 if body.c is None else 1.0 / body.c)


def find_orbit(
    body: Rattleback,
    state: Floats,
    period: float,
    energy: float | None = None,
    *,
    nearly: bool = False,
) -> Orbit:
    """Return the orbit near a state, by default at its energy.

    A state that `nearly` returns needs no search for its return.  Raises a ConfigError
    if there is no orbit.
    """
    family = Family(flow_of(body))
    arrival = family.flow(state, period)
    if not np.isfinite(arrival.state).all():
        raise ConfigError(
            f"period {period:g}: the body falls on its side before; give another state "
            "or a shorter period"
        )
    start = Solution(np.array([*state, period, arrival.energy]), arrival)
    point = solved_at(family, start)
    if point is None and not nearly:
        point = solved_at(family, _nearest_return(family, start))
    found = point
    if energy is not None and energy != arrival.energy:
        if point is not None:
            point = _carried_to(family, point, energy)
        if point is None:
            x = np.array([*state, period, energy])
            point = solved_at(family, replace(start, x=x))
    if point is None and found is not None and not _is_at_rest(found):
        raise ConfigError(
            f"energy {energy:g}: the orbit near the state, at {arrival.energy:.6g}, "
            "has none of its family there; follow the family with branch to see where "
            "it turns back"
        )
    if point is None or _is_at_rest(point):
        end = "no orbit" if point is None else "a steady spin, not an orbit"
        distance = np.linalg.norm(arrival.state - state)
        raise ConfigError(
            f"the state leads to {end}: after {period:g} it is {distance:.2g} away "
            "from where it began; give a state and a period that nearly close, as a "
            "search finds them"
        )
    return orbit_at(body, family, _least(family, point))


def _nearest_return(family: Family, start: Solution) -> Solution:
    """Return a start with the period of the nearest return about its own."""
    x = start.x.copy()
    shares = np.linspace(1 - _AROUND, 1 + _AROUND, 41)
    ends = [family.flow(x[:N_STATE], share * x[PERIOD]).state for share in shares]
    distances = np.linalg.norm(np.array(ends) - x[:N_STATE], axis=1)
    # Where a body falls on its side the distance is NaN.
    x[PERIOD] *= shares[np.nan_to_num(distances, nan=np.inf).argmin()]
    return Solution(x, family.arrival(x))


def _carried_to(family: Family, point: Solution, parameter: float) -> Solution | None:
    """Return the orbit of the same family at another parameter, without folds."""
    step = way = parameter - point.x[PARAMETER]
    while point.x[PARAMETER] != parameter:
        left = parameter - point.x[PARAMETER]
        if abs(step) > abs(left):
            step = left
        steep = point.tangent[PARAMETER]
        following = None
        if abs(steep) > _FLAT / 10:
            x = point.x + step / steep * point.tangent
            x[PARAMETER] = parameter if step == left else x[PARAMETER]
            following = solved_at(family, replace(point, x=x))
        if following is not None:
            point = following
        elif abs(step) < _SHORTEST_WAY * abs(way):
            return None
        else:
            step /= 2
    return point


def solved_at(family: Family, start: Solution) -> Solution | None:
    """Return the orbit near a point of a family, at its parameter."""
    row = np.eye(N_STATE + 2)[PARAMETER]
    found = family.solve(start.x, start, row, float(start.x[PARAMETER]))
    return None if found is None else found[0]


def _is_at_rest(point: Solution) -> bool:
    """Return whether a body only spins upright, or its period shrank to nothing."""
    speed = np.linalg.norm(point.arrival.rate_before)
    return bool(speed * point.x[PERIOD] < _NO_MOTION)


def _least(family: Family, point: Solution) -> Solution:
    """Return an orbit with its least period."""
    for part in _PARTS:
        while True:
            x = point.x.copy()
            x[PERIOD] /= part
            arrival = family.arrival(x)
            distance = np.linalg.norm(arrival.state - x[:N_STATE])
            if not distance < _SAME * (1 + np.linalg.norm(x[:N_STATE])):
                break
            shorter = solved_at(family, Solution(x, arrival))
            if shorter is None or _is_at_rest(shorter):
                break
            point = shorter
    return point


def orbit_at(body: Rattleback, family: Family, point: Solution) -> Orbit:
    """Return a point of a family as an orbit, with errors from a second tolerance."""
    looser = replace(family, flow=replace(family.flow, tol=LOOSE))
    # At a fold there may be none at the same parameter.
    row = np.eye(N_STATE + 2)[PARAMETER]
    if abs(point.tangent[PARAMETER]) < _FLAT:
        row = point.tangent
    found = looser.solve(point.x, point, row, float(row @ point.x))
    if found is None:
        raise ConfigError("the orbit is lost at a looser tolerance; it is too unstable")
    body = body_at(body, family, point.x)
    return as_orbit(body, point, found[0])


def body_at(body: Rattleback, family: Family, x: Floats) -> Rattleback:
    """Return the body that some unknowns of a family have."""
    if family.along == "energy":
        return body
    changed: dict[str, Any] = {family.along: float(x[PARAMETER])}
    return replace(body, **changed)


def as_orbit(body: Rattleback, point: Solution, again: Solution | None = None) -> Orbit:
    """Return an orbit of a body, with errors from another solution if there is one."""
    period = float(point.x[PERIOD])
    state = point.x[:N_STATE]
    u, omega = to_vectors(state)
    arrival = point.arrival
    orbit = Orbit(
        body=body,
        omega=(float(omega[0]), float(omega[1]), float(omega[2])),
        u=(float(u[0]), float(u[1]), float(u[2])),
        period=period,
        energy=arrival.energy,
        multipliers=point.multipliers,
        errors=np.full(3, np.nan),
        period_error=np.nan,
        state_error=np.nan,
        closure=float(np.abs(arrival.state - state).max()),
        n_mean=arrival.spin / period,
        volume_rate=arrival.volume / period,
        turn=float(np.degrees(arrival.turn)),
    )
    if again is None:
        return orbit
    return replace(
        orbit,
        errors=np.array(
            [np.abs(again.multipliers - x).min() for x in point.multipliers]
        ),
        period_error=abs(period - float(again.x[PERIOD])),
        state_error=float(np.abs(state - again.x[:N_STATE]).max()),
    )


def find_symmetric(body: Rattleback, u: Floats, period: float) -> Orbit:
    """Return the symmetric orbit near a body at rest in a position.

    The reversor ``(u, omega) -> (u, -omega)`` maps such an orbit to itself, so that the
    body is at rest twice in a period, half of it apart.  Three conditions for three
    unknowns, the position and the half: such orbits are isolated, and the energy is not
    free.
    """
    flow = flow_of(body)
    found = _at_rest_again(
        flow, np.append(from_vectors(u, np.zeros(3))[:2], period / 2)
    )
    again = None
    if found is not None:
        again = _at_rest_again(replace(flow, tol=LOOSE), found)
    if found is None or again is None:
        raise ConfigError(
            f"the position leads to no symmetric orbit: at rest at the begin, the body "
            f"does not come to rest near {period / 2:g}, half of the period; give "
            "another position or period"
        )
    both = [_closed(flow, half) for half in (found, again)]
    if _is_at_rest(both[0]):
        raise ConfigError(
            "the position leads to the upright body at rest; tilt it more"
        )
    return as_orbit(body, *both)


def _at_rest_again(flow: Flow, x: Floats) -> Floats | None:
    """Return slope and time from rest to rest, near those given; None without any."""
    for _ in range(_ITERATIONS):
        state = np.append(x[:2], np.zeros(3))
        arrival = flow(state, float(x[2]))
        if not np.isfinite(arrival.state).all():
            return None
        matrix = np.column_stack([arrival.derivative[2:, :2], arrival.rate[2:]])
        step = np.linalg.lstsq(matrix, -arrival.state[2:])[0]
        step *= min(1.0, 0.2 * x[2] / (abs(step[2]) + 1e-300))
        x = x + step
        if np.linalg.norm(step) < 1e-10 * (1 + np.linalg.norm(x)):
            return x
    return None


def _closed(flow: Flow, half: Floats) -> Solution:
    """Return an orbit from rest to rest and back."""
    x = np.array([*half[:2], 0.0, 0.0, 0.0, 2 * half[2], 0.0])
    arrival = flow(x[:N_STATE], float(x[PERIOD]))
    x[PARAMETER] = arrival.energy
    return Solution(x, arrival)


def row_of(orbit: Orbit) -> Mapping[str, float]:
    """Return the numbers of an orbit as a row of a table."""
    row = {
        "energy": orbit.energy,
        "period": orbit.period,
        "n_mean": orbit.n_mean,
        "turn_deg": orbit.turn,
    }
    for name, vector in (("omega", orbit.omega), ("u", orbit.u)):
        row |= {f"{name}_{axis}": x for axis, x in zip("xyz", vector, strict=True)}
    for k, multiplier in enumerate(orbit.multipliers, 1):
        row[f"modulus_{k}"] = float(np.abs(multiplier))
        row[f"angle_{k}"] = float(np.angle(multiplier))
    if orbit.body.units is not None:
        row["period_s"] = orbit.period * float(orbit.body.units.time)
    return row | {"closure": orbit.closure}
