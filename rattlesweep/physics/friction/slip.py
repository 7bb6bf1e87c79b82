"""Viscous slip: the contact point slips against a force in proportion to its velocity.

The plane exerts the force ``N u - k v`` on a contact point that slips at ``v``, at all
times (Magnus, Karapetyan, Takano).  Newton's and Euler's equations are those of
:mod:`rattlesweep.physics.friction.sliding`,

    D v = N u - k v - u - r x domega/dt - omega x w,    I domega/dt = r x F + g,

and ``N`` follows from ``u . D v = 0``.  The components of ``v`` are along ``h_1`` and
``h_2``.  They decay at rates of about ``k``, while everything else moves at the pace of
the oscillation.  So steps are implicit in the friction (`kernel.step.implicit`).
"""

# mypy: disable-error-code="no-untyped-def"
from math import sqrt

from rattlesweep.physics.friction.sliding import axes, contact_at, cross, divided
from rattlesweep.physics.full import NO_FORCE, scalar
from rattlesweep.physics.stone import dot

NO_LENGTH = 1e-30  # where all directions are alike, one is chosen


@scalar
def along(u, first, second):
    """Return the vector with components along ``h_1`` and ``h_2``."""
    (x1, y1, z1), (x2, y2, z2) = axes(u)
    return (
        first * x1 + second * x2,
        first * y1 + second * y2,
        first * z1 + second * z2,
    )


@scalar
def motion(u, omega, r, w, inertia, torque, drag, weight, force, k, v):
    """Return the rates of ``v`` and ``omega``, and the normal force.

    ``torque + N drag`` is the torque of all but the contact force, and ``force`` acts
    at the centre of mass beside the ``weight``.  The friction is known, so that one
    equation for ``N`` is left.
    """
    ix, iy, iz = inertia
    a, b, c = omega
    first, second = v
    ahead, aside = axes(u)
    pull = fx, fy, fz = along(u, -k * first, -k * second)
    lx, ly, lz = cross(r, pull)
    own = o0, o1, o2 = divided(
        (
            (iy - iz) * b * c + torque[0] + lx,
            (iz - ix) * c * a + torque[1] + ly,
            (ix - iy) * a * b + torque[2] + lz,
        ),
        inertia,
    )
    cx, cy, cz = cross(omega, w)
    # Minus the acceleration of the contact point at a constant angular velocity.
    curl = cx - force[0], cy - force[1], cz - force[2]
    lever = cross(r, u)
    lift = weight + dot(u, curl) - dot(lever, own)
    # There is no drag where the plane would have to pull.
    dragged = 1.0 if lift > 0.0 else 0.0
    whole = (
        lever[0] + dragged * drag[0],
        lever[1] + dragged * drag[1],
        lever[2] + dragged * drag[2],
    )
    turned = t0, t1, t2 = divided(whole, inertia)
    normal = lift / (1.0 + dot(lever, turned))
    rates = o0 + normal * t0, o1 + normal * t1, o2 + normal * t2
    ax, ay, az = cross(r, rates)
    lacking = fx - ax - curl[0], fy - ay - curl[1], fz - az - curl[2]
    # The rate at which h_1 turns about u.
    inverse = 1.0 / ahead[0]
    turn = (u[1] * b + u[2] * c) * (inverse * inverse)
    x = dot(ahead, lacking) + turn * second
    y = dot(aside, lacking) - turn * first
    return (x, y), rates, normal


@scalar
def stiffness(u, omega, r, w, inertia, k):
    """Return the rates at which the friction ends a slip, and what turns with it.

    A slip along one of two directions ``e`` in the plane, at right angles to each
    other, decays at a rate ``k tau``, where ``tau`` is the mobility of a contact point
    that stays on the plane.  The values are both rates, the components of the first
    ``e`` along ``h_1`` and ``h_2``, and for either ``e`` the change of ``omega`` while
    a slip of size 1 ends.
    """
    touch, _ = contact_at(u, omega, r, w, inertia, NO_FORCE, NO_FORCE)
    inverse = 1.0 / touch.kuu
    m11 = touch.k11 - touch.ku1 * touch.ku1 * inverse
    m12 = touch.k12 - touch.ku1 * touch.ku2 * inverse
    m22 = touch.k22 - touch.ku2 * touch.ku2 * inverse
    mean = 0.5 * (m11 + m22)
    half = 0.5 * (m11 - m22)
    root = sqrt(half * half + m12 * m12)
    # The longer of two forms of the eigenvector.
    x = half + root + NO_LENGTH if half >= 0.0 else m12
    y = m12 if half >= 0.0 else root - half
    length = sqrt(x * x + y * y)
    c = x / length
    s = y / length
    low = mean - root
    high = mean + root
    first = _turned_by(u, r, inertia, touch, c, s, high)
    second = _turned_by(u, r, inertia, touch, -s, c, low)
    return k * high, k * low, c, s, first, second


@scalar
def _turned_by(u, r, inertia, touch, x, y, mobility):
    """Return the change of ``omega`` while a slip along ``(x, y)`` of size 1 ends."""
    normal = -(touch.ku1 * x + touch.ku2 * y) / touch.kuu
    ux, uy, uz = u
    ex, ey, ez = along(u, x, y)
    lever = cross(r, (ex + normal * ux, ey + normal * uy, ez + normal * uz))
    ax, ay, az = divided(lever, inertia)
    share = -1.0 / mobility
    return share * ax, share * ay, share * az


@scalar
def power(k, v):
    """Return the power of the friction."""
    first, second = v
    return -k * (first * first + second * second)


@scalar
def rates(place, own):
    """Return the rates of the components: of the velocity of slip, and the power."""
    k, first, second, _ = own
    x, y = place.slip_rates
    return x, y, power(k, (first, second))


@scalar
def energy(place, own):
    """Return the kinetic energy beyond that of a body that rolls."""
    _, first, second, _ = own
    v = along(place.u, first, second)
    return dot(v, cross(place.r, place.omega)) + 0.5 * dot(v, v)


@scalar
def squared_force(place, own):
    """Return the square of the tangential force."""
    k, first, second, _ = own
    return k * k * (first * first + second * second)


@scalar
def squared_slip_error(e, components):
    """Return the squared error of the velocity of slip, as twice an energy."""
    first, second, _ = e
    return first * first + second * second
