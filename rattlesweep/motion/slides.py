"""What bodies need that slide: where they are, what acts on them, and its work."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import NamedTuple

from rattlesweep.motion.action import (
    Action,
    Vector3,
    Whereabouts,
)
from rattlesweep.motion.chart import Chart
from rattlesweep.motion.sums import (
    ActionSum,
    Numbering,
    own_rates,
    power_formula,
)
from rattlesweep.physics.friction import sliding
from rattlesweep.physics.friction.sliding import cross
from rattlesweep.physics.full import scalar
from rattlesweep.physics.surface import (
    Formula,
)


class Placed(NamedTuple):
    """Where a sliding body is, and what acts on it beside the contact force."""

    rates: tuple[float, ...]  # of the position
    u: Vector3
    omega: Vector3
    r: Vector3
    w: Vector3
    inertia: Vector3
    torque: Vector3
    drag: Vector3  # torque per unit of the normal force
    force: Vector3  # at the centre of mass
    weight: float  # beyond 1
    velocity: Vector3  # of the centre of mass


@dataclass(frozen=True)
class Slide:
    """What a model needs for sliding.

    Formulas take tuples as those of `model.Model` do.  The coefficient of friction is
    a further constant of a run, after ``constants``.
    """

    # place(y, slip, mu, constants): where the body is, as `Placed`
    place: Formula
    # derivative(y, slip, placed, domega/dt, normal force, constants): dy
    derivative: Formula
    # turned(y, u, rate): y with the angular velocity changed by rate u
    turned: Formula
    # Slope beyond which the state says too little about the contact for a slide to
    # begin; such a run is integrated again in the variables of `Model.anywhere`.
    steepest: float = inf


# Sliding, where friction cannot hold the contact point.


def slide_of(
    chart: Chart, contact: Formula, actions: tuple[Action, ...], layout: Numbering
) -> Slide:
    """Return what bodies need that slide under actions."""
    locate = chart.locate
    acting = ActionSum.of(actions, layout)
    torque_of = acting.torque
    grip_of = acting.grip
    force_of = acting.force
    weight_of = acting.weight

    @scalar
    def place(y, slip, mu, constants):
        rates, u, omega, r, w, _ = locate(contact, y, constants[3:7])
        x, y_, z = cross(r, omega)
        ex, ey, ez = sliding.slip_direction(u, slip.angle)
        speed = slip.speed
        velocity = x + speed * ex, y_ + speed * ey, z + speed * ez
        at = Whereabouts(u, omega, r, w, velocity, mu * speed, (0.0, 0.0))
        return Placed(
            rates,
            u,
            omega,
            r,
            w,
            constants[:3],
            torque_of(at, y, constants),
            grip_of(at, y, constants),
            force_of(at, y, constants),
            weight_of(at, y, constants),
            velocity,
        )

    derivative = _without_work
    if actions:
        derivative = _slid_works(actions, acting, layout)
    return Slide(place, derivative, chart.turned)


@scalar
def _without_work(y, slip, placed, omega_rate, normal, constants):
    return placed.rates + omega_rate


def _slid_works(
    actions: tuple[Action, ...], acting: ActionSum, layout: Numbering
) -> Formula:
    """Return the derivative of the state of a body that slides, as `Slide`."""
    power_of = power_formula(acting)

    @scalar
    def with_work(y, slip, placed, omega_rate, normal, constants):
        power = power_of(
            placed.torque,
            placed.drag,
            placed.force,
            placed.weight,
            normal,
            placed.omega,
            placed.velocity,
            placed.u,
        )
        return placed.rates + omega_rate + (power,)

    derivative: Formula = with_work
    for action in actions:
        if action.slid_power is not None:
            derivative = _with_slid_power(derivative, action.slid_power)
    further = own_rates(acting, layout)
    if further is not None:
        derivative = _with_slid_rates(derivative, further)
    return derivative


def _with_slid_power(before: Formula, power: Formula) -> Formula:
    @scalar
    def derivative(y, slip, placed, omega_rate, normal, constants):
        f = before(y, slip, placed, omega_rate, normal, constants)
        return f + (power(placed, normal),)  # noqa: RUF005

    return derivative  # type: ignore[no-any-return]


def _with_slid_rates(before: Formula, further: Formula) -> Formula:
    @scalar
    def derivative(y, slip, placed, omega_rate, normal, constants):
        f = before(y, slip, placed, omega_rate, normal, constants)
        at = Whereabouts(
            placed.u,
            placed.omega,
            placed.r,
            placed.w,
            placed.velocity,
            0.0,
            (0.0, 0.0),
        )
        return f + further(at, normal, y, constants)

    return derivative  # type: ignore[no-any-return]
