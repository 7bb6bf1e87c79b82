"""The motion of a body that slides, in one state: what steps of slides evaluate."""

# mypy: ignore-errors
from typing import NamedTuple

from rattlesweep.compiling.intrinsics import moved
from rattlesweep.kernel.state.fields import Slip
from rattlesweep.motion.slides import Placed
from rattlesweep.physics.friction.pivoting import slope_of_torque
from rattlesweep.physics.friction.sliding import contact_at, push, spun
from rattlesweep.physics.full import TINY, scalar

LEAST_MOBILITY = 1e-3  # below it the normal force grows without bound


@scalar
def contact_of(model, y, slip, mu, constants):
    """Return the contact of a body, ``I^-1 g``, and what `Slide.place` returns."""
    at = model.slide.place(y, slip, mu, constants)
    contact, own = contact_while_sliding(at, at.drag)
    return contact, own, at


@scalar
def contact_while_sliding(at, drag):
    """Return the contact of a body in a place, and ``I^-1 g``.

    ``drag`` is its torque per unit of the normal force.
    """
    return contact_at(
        at.u,
        at.omega,
        at.r,
        at.w,
        at.inertia,
        at.torque,
        drag,
        1.0 + at.weight,
        at.force,
    )


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
    return motion_under(model, y, slip, mu, constants, contact, own, at)


@scalar
def motion_under(model, y, slip, mu, constants, contact, own, at):
    """Return the :class:`Motion` of a body in a state, whose contact is known."""
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
    """Return the numbers of a :class:`Motion` in the order of the rows of a rack.

    The last constant is ``mu``.
    """
    motion = motion_at(model, y, slip, constants[-1], constants[:-1])
    return stage_numbers(motion, slip)


@scalar
def stage_numbers(motion, slip):
    """Return the numbers of a :class:`Motion` in the order of the rows of a rack."""
    # The motion ends before the mobility is zero, so beyond there is no solution.
    least = min(slip.speed, motion.mobility)
    rates = motion.slip.speed, motion.slip.angle, motion.slip.work
    return motion.f + rates + (motion.stiffness, least, motion.normal, motion.margin)


@scalar
def with_drag(at, drag):
    """Return a place in which the torque per unit of the normal force is another."""
    return Placed(
        at.rates,
        at.u,
        at.omega,
        at.r,
        at.w,
        at.inertia,
        at.torque,
        drag,
        at.force,
        at.weight,
        at.velocity,
    )


@scalar
def patch_rates(model, y, slip, constants):
    """Return what :func:`stage_rates` does of a patch that turns, and its response.

    These are further numbers: how all rates change with the spin through the torque of
    the patch; the ratio of spin and speed, at which this torque stays; and how the
    rates of the spin and of the speed change with the spin.
    """
    mu = constants[-1]
    own_constants = constants[:-1]
    lever = own_constants[-2]
    least = own_constants[-1]
    contact, own, at = contact_of(model, y, slip, mu, own_constants)
    motion = motion_under(model, y, slip, mu, own_constants, contact, own, at)
    # With the whole torque of the patch more:
    drag = moved(at.drag, at.u, lever)
    turned = with_drag(at, drag)
    contact, own = contact_while_sliding(turned, drag)
    more = motion_under(model, y, slip, mu, own_constants, contact, own, turned)
    n = model.spin(y)
    creep = mu * slip.speed
    slope = slope_of_torque(n, lever, creep, least) / (lever + TINY)
    change = moved(more.f, motion.f, -1.0)
    speed = more.slip.speed - motion.slip.speed
    angle = more.slip.angle - motion.slip.angle
    work = more.slip.work - motion.slip.work
    ratio = n * mu * creep / (creep * creep + least * least + TINY)
    turning = model.spin_rate(y, change)
    # A spin that does not settle to the ratio is not stiff.
    slope = slope if slope * (turning - ratio * speed) < 0.0 else 0.0
    whole = change + (speed, angle, work)  # noqa: RUF005
    none = moved(whole, whole, -1.0)
    response = moved(none, whole, slope)
    settling = ratio, slope * turning, slope * speed
    return stage_numbers(motion, slip) + response + settling
