"""Equations of bodies whose contact point slips under viscous friction.

They take the place of those of a body that rolls, for any other actions that do not
pivot, on any surface and in any chart (:mod:`rattlesweep.physics.friction.slip`).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from rattlesweep.motion.action import Action, Whereabouts
from rattlesweep.motion.chart import Chart
from rattlesweep.motion.sums import ActionSum, Numbering, power_formula
from rattlesweep.physics.friction import slip
from rattlesweep.physics.friction.sliding import cross
from rattlesweep.physics.full import scalar
from rattlesweep.physics.surface import Formula


def slipping_parts(
    chart: Chart, acting: ActionSum, slipping: Action, layout: Numbering
) -> Formula:
    """Return what `sums.summed_parts` does, of a body that slips by an action."""
    locate = chart.locate
    torque_of = acting.torque
    grip_of = acting.grip
    force_of = acting.force
    weight_of = acting.weight
    power_of = power_formula(acting)
    place_of_k = layout.constants.index(slipping.strength)
    begin = layout.components.index(slipping.components[0])
    end = begin + 2

    @scalar
    def parts(contact, y, inertia, shape, loss):
        constants = inertia + shape[:4] + loss
        k = constants[place_of_k]
        v = y[begin:end]
        rates, u, omega, r, w, _ = locate(contact, y, shape)
        x, y_, z = cross(r, omega)
        sx, sy, sz = slip.along(u, v[0], v[1])
        velocity = x + sx, y_ + sy, z + sz
        there = Whereabouts(u, omega, r, w, velocity, 0.0, (0.0, 0.0))
        torque = torque_of(there, y, constants)
        grip = grip_of(there, y, constants)
        force = force_of(there, y, constants)
        more = weight_of(there, y, constants)
        slip_rates, turned, normal = slip.motion(
            u, omega, r, w, inertia, torque, grip, 1.0 + more, force, k, v
        )
        place = Whereabouts(u, omega, r, w, velocity, 0.0, slip_rates)
        gripped = max(0.0, normal)
        power = power_of(torque, grip, force, more, gripped, omega, velocity, u)
        return rates, turned, 0.0, normal, power + slip.power(k, v), 0.0, place

    return parts  # type: ignore[no-any-return]


def stiffness_of(chart: Chart, slipping: Action, layout: Numbering) -> Formula:
    """Return `slip.stiffness` as a formula ``(contact, y, constants)``."""
    locate = chart.locate
    place_of_k = layout.constants.index(slipping.strength)

    @scalar
    def stiffness(contact, y, constants):
        _, u, omega, r, w, _ = locate(contact, y, constants[3:7])
        return slip.stiffness(u, omega, r, w, constants[:3], constants[place_of_k])

    return stiffness  # type: ignore[no-any-return]


def rates_of_place(chart: Chart) -> Formula:
    """Return the rates of the position as a formula ``(contact, y, constants)``."""
    locate = chart.locate

    @scalar
    def moved(contact, y, constants):
        rates, _, _, _, _, _ = locate(contact, y, constants[3:7])
        return rates

    return moved  # type: ignore[no-any-return]


def velocity_of(slipping: Action, layout: Numbering) -> Formula:
    """Return the components of the velocity of slip as a formula of the state."""
    begin = layout.components.index(slipping.components[0])
    end = begin + 2

    @scalar
    def velocity(y):
        return y[begin:end]

    return velocity  # type: ignore[no-any-return]
