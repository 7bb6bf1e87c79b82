"""Equations of bodies whose patch of contact drifts while it spins.

They correct those of any set of actions that pivots, on any surface and in any chart
(:mod:`rattlesweep.physics.friction.creep`).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from rattlesweep.motion.action import Whereabouts
from rattlesweep.motion.chart import Chart
from rattlesweep.motion.sums import ActionSum
from rattlesweep.physics import stone
from rattlesweep.physics.friction import creep
from rattlesweep.physics.friction.sliding import cross
from rattlesweep.physics.full import scalar
from rattlesweep.physics.stone import dot
from rattlesweep.physics.surface import Formula

N_BODY = len(stone.CONSTANTS)  # constants before those of actions


def force_without_drift(
    chart: Chart,
    parts: Formula,
    contact: Formula,
    place_of_mu: int,
    others: ActionSum,
) -> Formula:
    """Return the contact force as `model.Model.force`, from the parts without creep.

    It is the force under which the foot drifts, and beyond which it slides: that of
    the body that rolls with the same angular momentum about the contact point, under
    the sum of the other actions.
    """
    locate = chart.locate
    after = place_of_mu + 1
    force_of = others.force
    weight_of = others.weight

    @scalar
    def force(y, dy, constants):
        loss = constants[N_BODY:]
        shape = constants[3:N_BODY]
        without = loss[:place_of_mu] + loss[after:]
        _, turned, _, _, _, _ = parts(contact, y, constants[:3], shape, without)
        _, u, omega, r, w, _ = locate(contact, y, shape)
        place = Whereabouts(u, omega, r, w, cross(r, omega), 0.0, (0.0, 0.0))
        weight = 1.0 + weight_of(place, y, constants)
        applied = force_of(place, y, constants)
        return stone.force_at(u, omega, turned, r, w, weight, applied)

    return force  # type: ignore[no-any-return]


def drifting_parts(
    chart: Chart, parts: Formula, place_of_mu: int, others: ActionSum
) -> Formula:
    """Return the parts of a motion with creep from those without.

    They are a formula ``(contact, y, inertia, shape, loss)``, where ``loss`` has the
    coefficient of friction of the patch at `place_of_mu`, and the lever and the sense
    at its end.  `others` is the sum of the other actions.  Values: rates of the
    position, ``domega/dt``, the torque against pivoting, the normal force that holds a
    spin, the power of all other actions, that of the torque, that of creep, the part of
    this that is in doubt, the normal force itself, and what the drift adds to
    ``omega``.
    """
    locate = chart.locate
    turned_by = chart.turned
    after = place_of_mu + 1
    force_of = others.force

    @scalar
    def drifting(contact, y, inertia, shape, loss):
        mu = loss[place_of_mu]
        without = loss[:place_of_mu] + loss[after:]
        lever, sense = loss[-2:]
        rates, turned, torque, normal, power, taken = parts(
            contact, y, inertia, shape, without
        )
        _, u, omega, r, w, _ = locate(contact, y, shape)
        rolled_at = cross(r, omega)
        place = Whereabouts(u, omega, r, w, rolled_at, 0.0, (0.0, 0.0))
        applied = force_of(place, y, inertia + shape[:4] + loss)
        v, x, is_sure = creep.drift(u, omega, turned, r, w, normal, lever, mu, applied)
        share = creep.share_of_torque(x)
        # The plane holds a spin with any torque up to that of the patch.
        less = 0.0
        if sense != 0.0:
            less = torque * (share - 1.0)
        more, solver, det = creep.turned_by(r, v, inertia)
        there = turned_by(y, more, 1.0)
        rates, _, _, _, w_now, _ = locate(contact, there, shape)
        vx, vy, vz = rolled_at
        rolled = (vx - w[0], vy - w[1], vz - w[2]), w
        (ax, ay, az), lost = creep.changed_rates(
            u, omega, r, w_now, rolled, v, more, less, inertia, solver, det
        )
        turned = turned[0] + ax, turned[1] + ay, turned[2] + az
        pivoted = less * dot(u, omega)
        crept = lost - pivoted
        doubtful = crept * (1.0 - is_sure)
        return (
            rates,
            turned,
            torque + less,
            share * normal,
            power,
            taken + pivoted,
            crept,
            doubtful,
            normal,
            more,
        )

    return drifting  # type: ignore[no-any-return]
