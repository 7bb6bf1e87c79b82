"""The motion of a body that slides, in one state: what steps of slides evaluate."""

# mypy: ignore-errors
from typing import NamedTuple

from rattlesweep.kernel.state.fields import Slip
from rattlesweep.physics.full import scalar
from rattlesweep.physics.sliding import contact_at, push, spun

LEAST_MOBILITY = 1e-3  # below it the normal force grows without bound


@scalar
def contact_of(model, y, slip, mu, constants):
    """Return the contact of a body, ``I^-1 g``, and what `Slide.place` returns."""
    at = model.slide.place(y, slip, mu, constants)
    contact, own = contact_at(
        at.u,
        at.omega,
        at.r,
        at.w,
        at.inertia,
        at.torque,
        at.drag,
        1.0 + at.weight,
        at.force,
    )
    return contact, own, at


class Motion(NamedTuple):
    """What a step needs of a sliding body in one state."""

    f: tuple[float, ...]  # derivative of the state
    slip: Slip  # derivative of the slip
    stiffness: float  # derivative of the angle's rate with respect to the angle
    normal: float  # normal force
    mobility: float  # of the contact along the force
    margin: float  # positive where the body can go on sliding


@scalar
def motion_at(model, y, slip, mu, constants):
    """Return the :class:`Motion` of a body in a state."""
    contact, own, at = contact_of(model, y, slip, mu, constants)
    normal, mobility, along, across, slope = push(contact, mu, slip.angle)
    turned = spun(own, at.u, at.r, at.inertia, at.drag, mu, slip.angle, normal)
    f = model.slide.derivative(y, slip, at, turned, normal, constants)
    inverse = 1.0 / slip.speed
    turning = across * inverse - contact.turn
    rate = Slip(along, turning, -mu * normal * slip.speed)
    margin = min(contact.need, mobility - LEAST_MOBILITY)
    return Motion(f, rate, slope * inverse, normal, mobility, margin)


@scalar
def stage_rates(model, y, slip, constants):
    """Return the numbers of a :class:`Motion` in the order of the rows of a block.

    The last constant is ``mu``.
    """
    motion = motion_at(model, y, slip, constants[-1], constants[:-1])
    # The motion ends before the mobility is zero, so beyond there is no solution.
    least = min(slip.speed, motion.mobility)
    rates = motion.slip.speed, motion.slip.angle, motion.slip.work
    return motion.f + rates + (motion.stiffness, least, motion.normal, motion.margin)
