"""Equations of bodies whose patch of contact drifts while it spins.

They correct those of any set of actions that pivots, on any surface and in any chart
(:mod:`rattlesweep.physics.creep`).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from rattlesweep.motion.chart import Chart
from rattlesweep.physics import creep
from rattlesweep.physics.full import scalar
from rattlesweep.physics.sliding import cross
from rattlesweep.physics.stone import dot
from rattlesweep.physics.surface import Formula


def drifting_parts(chart: Chart, parts: Formula, place_of_mu: int) -> Formula:
    """Return the parts of a motion with creep from those without.

    They are a formula ``(contact, y, inertia, shape, loss)``, where ``loss`` has the
    coefficient of friction of the patch at `place_of_mu`, and the lever and the sense
    at its end.  Values: rates of the position, ``domega/dt``, the torque against
    pivoting, the normal force that holds a spin, the power of all other actions, that
    of the torque, that of creep, and the part of this that is in doubt.
    """
    locate = chart.locate
    turned_by = chart.turned
    after = place_of_mu + 1

    @scalar
    def drifting(contact, y, inertia, shape, loss):
        mu = loss[place_of_mu]
        without = loss[:place_of_mu] + loss[after:]
        lever, sense = loss[-2:]
        rates, turned, torque, normal, power, taken = parts(
            contact, y, inertia, shape, without
        )
        _, u, omega, r, w, _ = locate(contact, y, shape)
        v, x, is_sure = creep.drift(u, omega, turned, r, w, normal, lever, mu)
        share = creep.share_of_torque(x)
        # The plane holds a spin with any torque up to that of the patch.
        less = torque * (share - 1.0) if sense != 0.0 else 0.0
        more, solver, det = creep.turned_by(r, v, inertia)
        there = turned_by(y, more, 1.0)
        rates, _, _, _, w_now, _ = locate(contact, there, shape)
        vx, vy, vz = cross(r, omega)
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
        )

    return drifting  # type: ignore[no-any-return]
