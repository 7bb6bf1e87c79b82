"""The flow of a body over a time, with its derivative: one compiled call.

The method is one of the tables of the package.  Its steps are those of the state alone,
and the tangents take the same steps.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import UNFUSED, first_of
from rattlesweep.compiling.loading import Kernel, load_kernels
from rattlesweep.kernel import recipes
from rattlesweep.kernel.method.tableau import VERNER98
from rattlesweep.motion.model import FULL_ELLIPSOID, Model, find_model
from rattlesweep.physics import full
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.physics.full import N_STATE, scalar

TIGHT = 1e-13
"""Error of a step, relative to the oscillation."""
LOOSE = 1e-11
"""The second tolerance, at which a result is computed again for its error."""
_MOST_STEPS = 1_000_000
# Rows of what is integrated: the state, its tangents, then means over the time.
_MEANS = N_STATE + 1
_ROWS = N_STATE + 2
# Steps of differences of fourth order: of states and of parameters.
_NUDGE = 1e-3
# A spin is known to so many digits; its rounding rejects no step.
_ROUNDING = 1e-15


class Arrival(NamedTuple):
    """Where the flow leads from a state in a time, and what it passes."""

    state: Floats  # shape (5,)
    derivative: Floats  # of the end by the begin, shape (5, 5)
    rate_before: Floats  # of the state, at the begin
    rate: Floats  # at the end
    energy: float  # at the begin, in M g a
    gradient: Floats  # of the energy, at the begin
    spin: float  # integral of n
    volume: float  # integral of the rate of phase volume
    turn: float  # angle by which the body turns about the vertical, in radians


@dataclass(frozen=True)
class Flow:
    """The flow of bodies without friction, at a tolerance.

    The six parameters of a body, and the inverse of its semi-axis if it has one, are
    numbers without limits here, so that they can be varied.
    """

    parameters: tuple[float, ...]  # alpha, beta, gamma, theta, phi, xi
    inverse_semi_axis: float = 0.0
    tol: float = TIGHT

    def with_parameter(self, name: str, value: float) -> Flow:
        """Return the flow of a body with another value of one parameter."""
        values = list(self.parameters)
        values[PARAMETERS.index(name)] = value
        return replace(self, parameters=tuple(values))

    @cached_property
    def _constants(self) -> Floats:
        constants = full.constants(*self.parameters)
        if self.inverse_semi_axis:
            return np.append(constants, self.inverse_semi_axis)
        return constants

    @cached_property
    def _kernel(self) -> tuple[Callable[..., Any], Any]:
        ellipsoid = self.inverse_semi_axis > 0.0
        (kernel,) = load_kernels((flow_recipe, ellipsoid))
        return kernel, recipes.problem_of(_model_of(ellipsoid))

    def __call__(self, state: Floats, time: float) -> Arrival:
        """Return where a state arrives after a time; NaN where it cannot be followed.

        A body that falls on its side leaves the slopes, its variables.
        """
        table = np.zeros((_ROWS, N_STATE))
        table[0] = state
        table[1:_MEANS] = np.eye(N_STATE)
        ends = np.zeros((3, N_STATE))
        kernel, problem = self._kernel
        energy = kernel(
            problem, table, time, self._constants, self.tol, *_COEFFICIENTS, ends
        )
        spin, volume, turn = table[_MEANS, :3]
        return Arrival(
            state=table[0],
            derivative=table[1:_MEANS].T.copy(),
            rate_before=ends[0],
            rate=ends[1],
            energy=energy,
            gradient=ends[2],
            spin=spin,
            volume=volume,
            turn=turn,
        )

    def by_parameter(
        self, name: str, state: Floats, time: float
    ) -> tuple[Floats, float]:
        """Return the derivatives of the end and of the energy by a parameter."""
        value = self.parameters[PARAMETERS.index(name)]
        end = np.zeros(N_STATE)
        energy = 0.0
        for nudges, weight in ((1, 8 / 12), (-1, -8 / 12), (2, -1 / 12), (-2, 1 / 12)):
            beside = self.with_parameter(name, value + nudges * _NUDGE)
            arrival = beside(state, time)
            end = end + weight / _NUDGE * arrival.state
            energy += weight / _NUDGE * arrival.energy
        return end, energy


def carry(problem, table, time, constants, tol, a, b, errors, ends):
    """Move states and tangents by a time, and return the energy at its begin.

    ``ends`` gets the rates at the begin and at the end, and the gradient of the energy
    at the begin.
    """
    model = problem.model
    q = first_of(constants, model.n_constants)
    stages = a.shape[0]
    rates = np.zeros((stages + 1, *table.shape))
    stage = np.zeros(table.shape)
    e = np.zeros(table.shape[1])
    y = first_of(table[0], 5)
    energy = model.energy(y, q)
    for i in range(5):
        ends[2, i] = _slope_of_energy(problem, y, q, i)
    _derive(problem, table, q, rates[0])
    ends[0] = rates[0, 0]
    t = 0.0
    h = 0.02
    for _ in range(_MOST_STEPS):
        if not t < time:
            break
        h = min(h, time - t)
        for i in range(1, stages):
            _add(table, h, a[i, :i], rates, stage)
            _derive(problem, stage, q, rates[i])
        _add(table, h, b, rates, stage)
        _derive(problem, stage, q, rates[stages])
        e[:] = 0.0
        for j in range(stages + 1):
            e += h * errors[j] * rates[j, 0]
        y = first_of(stage[0], 5)
        wrong, size = model.error(first_of(e, 5), y, q)
        allowed = tol * tol * size + _ROUNDING**2 * q[2] * y[4] * y[4]
        ratio = wrong / allowed
        if not isfinite(ratio):
            break
        if ratio <= 1.0:
            t = time if h == time - t else t + h
            table[:] = stage
            rates[0] = rates[stages]
        h *= min(5.0, max(0.2, 0.9 * (ratio + 1e-30) ** (-1.0 / 18.0)))
    ends[1] = rates[0, 0]
    if t < time:
        table[:] = np.nan
    return energy


@njit(error_model="numpy", forceinline=False, fastmath={"contract", "reassoc"})
def _add(table, h, weights, rates, out):
    """Write a table plus a step along weighted rates."""
    for r in range(table.shape[0]):
        for c in range(table.shape[1]):
            total = 0.0
            for j in range(weights.size):
                total += weights[j] * rates[j, r, c]
            out[r, c] = table[r, c] + h * total


# Not inlined, as the rates would be compiled at each place of a call.
@njit(error_model="numpy", **UNFUSED)
def _derive(problem, table, q, out):
    """Write the rates of a state, of its tangents and of the integrals of means."""
    model = problem.model
    y = first_of(table[0], 5)
    f = model.rhs(y, q)
    for c, component in enumerate(f):
        out[0, c] = component
    for i in range(1, 6):
        for c, component in enumerate(model.rate(y, f, first_of(table[i], 5), q)):
            out[i, c] = component
    p, slope, _, b, c_ = y
    out[6, 0] = model.spin(y)
    out[6, 1] = model.volume(y, q)
    # The rate of the heading, as in `full.track_at`.
    out[6, 2] = (
        -(slope * b + c_) * sqrt(1.0 + p * p + slope * slope) / (1.0 + slope * slope)
    )


@njit(error_model="numpy", **UNFUSED)
def _slope_of_energy(problem, y, q, i):
    """Return the derivative of the energy by a component of the state."""
    energy = problem.model.energy
    total = 0.0
    for nudges, weight in ((1.0, 8.0), (-1.0, -8.0), (2.0, -1.0), (-2.0, 1.0)):
        h = nudges * _NUDGE
        beside = (
            y[0] + (h if i == 0 else 0.0),
            y[1] + (h if i == 1 else 0.0),
            y[2] + (h if i == 2 else 0.0),
            y[3] + (h if i == 3 else 0.0),
            y[4] + (h if i == 4 else 0.0),
        )
        total += weight * energy(beside, q)
    return total / (12.0 * _NUDGE)


def _rate_by_differences(rhs: Callable[..., Any]) -> Callable[..., Any]:
    """Return the derivative of a tangent, where its formula is not known."""

    @scalar
    def rate(y, dy, v, q):
        size = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + v[3] * v[3] + v[4] * v[4])
        h = _NUDGE / (size + full.TINY)
        one = rhs(_beside(y, v, h), q)
        back = rhs(_beside(y, v, -h), q)
        two = rhs(_beside(y, v, 2.0 * h), q)
        back_two = rhs(_beside(y, v, -2.0 * h), q)
        w = 1.0 / (12.0 * h)
        return (
            w * (8.0 * (one[0] - back[0]) - (two[0] - back_two[0])),
            w * (8.0 * (one[1] - back[1]) - (two[1] - back_two[1])),
            w * (8.0 * (one[2] - back[2]) - (two[2] - back_two[2])),
            w * (8.0 * (one[3] - back[3]) - (two[3] - back_two[3])),
            w * (8.0 * (one[4] - back[4]) - (two[4] - back_two[4])),
        )

    return rate


@scalar
def _beside(y, v, h):
    return (
        y[0] + h * v[0],
        y[1] + h * v[1],
        y[2] + h * v[2],
        y[3] + h * v[3],
        y[4] + h * v[4],
    )


def _model_of(ellipsoid: bool) -> Model:
    """Return the equations with the rate of one tangent."""
    if ellipsoid:
        return replace(
            FULL_ELLIPSOID, rate=_rate_by_differences(FULL_ELLIPSOID.rhs), n_carried=0
        )
    return find_model("full_tangent")


def flow_recipe(ellipsoid: bool) -> Kernel:
    """Return :func:`carry` for paraboloids or ellipsoids."""
    problem = recipes.problem_of(_model_of(ellipsoid))
    number = np.zeros(1)
    arguments = problem, np.zeros((7, 5)), 1.0, number, 1.0, np.zeros((1, 1)), number
    options = {"nogil": True, "error_model": "numpy"}
    return Kernel(carry, (*arguments, number, np.zeros((3, 5))), options, (__file__,))


def _coefficients() -> tuple[Floats, Floats, Floats]:
    """Return the method as arrays: coefficients, weights, and those of the error."""
    method = VERNER98
    a = np.zeros((method.stages, method.stages))
    for i, row in enumerate(method.a):
        for j, value in row.items():
            a[i, j] = value
    weights = np.zeros(method.stages)
    errors = np.zeros(method.stages + 1)
    for place, value in method.b.items():
        weights[place] = value
    (row,) = method.errors
    for place, value in row.items():
        errors[place] = value
    return a, weights, errors


_COEFFICIENTS = _coefficients()
