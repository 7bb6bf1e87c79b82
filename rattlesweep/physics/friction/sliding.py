"""A body that slides on the plane under Coulomb's law, and where rolling ends.

The contact point has a velocity ``s e`` in the plane, with the speed ``s > 0``, and
the plane exerts the force ``F_n (u - mu e)``.  With ``w = r x omega - dr/dt`` and the
torque ``g`` of everything but the contact force, Newton's and Euler's equations are

    D(s e) = F - u - r x domega/dt - omega x w,    I domega/dt = r x F + g,

with ``D`` the derivative in space.  As the body stays on the plane, ``u . D(s e)``
vanishes, which determines ``F_n = N / d``: ``N`` is the normal force that a massless
contact would need, and ``d``, the mobility of the contact along the force, must be
positive (Painleve).  A rolling resistance is a torque proportional to ``F_n``.

Vectors in the plane have components along ``h_1``, the horizontal part of the body's x
axis, and ``h_2 = u x h_1``.  The direction of sliding is ``e = cos(angle) h_1 +
sin(angle) h_2``.  Its rate grows as ``1/s``: near ``s = 0`` the angle is stiff.
"""

# mypy: disable-error-code="no-untyped-def"
from math import atan2, cos, sqrt
from typing import NamedTuple

from rattlesweep.physics.full import NO_FORCE, scalar, track_at
from rattlesweep.physics.stone import dot, triple


class Contact(NamedTuple):
    """What the contact force does to the motion, for any direction of sliding.

    The mobility ``k`` is the acceleration of the contact point by a unit force, with
    components along ``u, h_1, h_2``.
    """

    need: float  # N
    free1: float  # acceleration of the contact point without a contact force
    free2: float
    turn: float  # rate at which h_1 turns about u
    kuu: float
    ku1: float
    ku2: float
    k11: float
    k12: float
    k22: float
    # Acceleration of the contact point by the rolling resistance, per normal force.
    tu: float
    t1: float
    t2: float


@scalar
def cross(v, w):
    """Return ``v x w``."""
    return (
        v[1] * w[2] - v[2] * w[1],
        v[2] * w[0] - v[0] * w[2],
        v[0] * w[1] - v[1] * w[0],
    )


@scalar
def axes(u):
    """Return ``h_1`` and ``h_2 = u x h_1``."""
    ux, uy, uz = u
    square = uy * uy + uz * uz
    root = sqrt(square)
    inverse = 1.0 / root
    y = uy * inverse
    z = uz * inverse
    return (root, -ux * y, -ux * z), (0.0, z, -y)


ROUND = 1.5 * 2.0**52  # added and subtracted, it leaves an integer
PER_QUARTER = 0.6366197723675814
# A quarter of a turn in two parts, the first of 33 bits.
QUARTER = 1.57079632673412561417
QUARTER_REST = 6.07710050650619224932e-11


@scalar
def cos_sin(angle):
    """Return cosine and sine of an angle of at most thousands, by sums alone.

    Unlike those of a library, they can be computed for several angles at once.  The
    polynomials are those of fdlibm.
    """
    quarters = (angle * PER_QUARTER + ROUND) - ROUND
    x = (angle - quarters * QUARTER) - quarters * QUARTER_REST
    z = x * x
    s = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    s = 2.75573137070700676789e-06 + z * s
    s = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * s)
    s = x + x * z * (-1.66666666666666324348e-01 + z * s)
    c = 2.08757232129817482790e-09 - z * 1.13596475577881948265e-11
    c = 2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * c)
    c = 4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * c)
    c = 1.0 - 0.5 * z + z * z * c
    # The quarter in which the angle is: -2, -1, 0, 1 or 2.
    turned = quarters - 4.0 * ((0.25 * quarters + ROUND) - ROUND)
    odd = (turned == 1.0) | (turned == -1.0)
    cosine = s if odd else c
    sine = c if odd else s
    cosine = -cosine if (turned == 1.0) | (abs(turned) == 2.0) else cosine
    sine = -sine if (turned == -1.0) | (abs(turned) == 2.0) else sine
    return cosine, sine


@scalar
def slip_direction(u, angle):
    """Return the unit vector ``e`` of a direction in the plane."""
    (x1, y1, z1), (x2, y2, z2) = axes(u)
    c, s = cos_sin(angle)
    return c * x1 + s * x2, c * y1 + s * y2, c * z1 + s * z2


@scalar
def divided(v, inertia):
    """Return ``I^-1 v``."""
    # Compilers compute the reciprocals once for all vectors.
    x = 1.0 / inertia[0]
    y = 1.0 / inertia[1]
    z = 1.0 / inertia[2]
    return v[0] * x, v[1] * y, v[2] * z


@scalar
def contact_at(u, omega, r, w, inertia, torque, drag, weight=1.0, force=NO_FORCE):
    """Return the :class:`Contact`, and ``I^-1 g`` with the gyroscopic torque in ``g``.

    ``torque + F_n drag`` is the torque of all but the contact force, and ``force`` is
    what acts at the centre of mass beside the ``weight``.
    """
    ix, iy, iz = inertia
    a, b, c = omega
    first, second = axes(u)
    inverse = 1.0 / first[0]
    gyro = (
        (iy - iz) * b * c + torque[0],
        (iz - ix) * c * a + torque[1],
        (ix - iy) * a * b + torque[2],
    )
    own = divided(gyro, inertia)
    # Minus the acceleration of the contact point at a constant angular velocity.
    cx, cy, cz = cross(omega, w)
    fx, fy, fz = force
    curl = cx - fx, cy - fy, cz - fz
    lever_u = cross(r, u)
    lever_1 = cross(r, first)
    lever_2 = cross(r, second)
    turned_u = divided(lever_u, inertia)
    turned_1 = divided(lever_1, inertia)
    turned_2 = divided(lever_2, inertia)
    _, uy, uz = u
    contact = Contact(
        weight + dot(u, curl) - dot(lever_u, own),
        dot(lever_1, own) - dot(first, curl),
        dot(lever_2, own) - dot(second, curl),
        (uy * b + uz * c) * (inverse * inverse),
        1.0 + dot(lever_u, turned_u),
        dot(lever_u, turned_1),
        dot(lever_u, turned_2),
        1.0 + dot(lever_1, turned_1),
        dot(lever_1, turned_2),
        1.0 + dot(lever_2, turned_2),
        dot(drag, turned_u),
        dot(drag, turned_1),
        dot(drag, turned_2),
    )
    return contact, own


@scalar
def push(contact, mu, angle):
    """Return what the contact force does in a direction of sliding.

    The values are the normal force, the denominator ``d``, the rate of the speed, the
    speed times the rate of the direction in space, and the derivative of the last with
    respect to the angle.
    """
    c, s = cos_sin(angle)
    # Acceleration of the contact point per unit of normal force, and its derivative.
    per_u = contact.kuu + contact.tu - mu * (contact.ku1 * c + contact.ku2 * s)
    per_1 = contact.ku1 + contact.t1 - mu * (contact.k11 * c + contact.k12 * s)
    per_2 = contact.ku2 + contact.t2 - mu * (contact.k12 * c + contact.k22 * s)
    turned_u = mu * (contact.ku1 * s - contact.ku2 * c)
    turned_1 = mu * (contact.k11 * s - contact.k12 * c)
    turned_2 = mu * (contact.k12 * s - contact.k22 * c)
    inverse = 1.0 / per_u
    normal = contact.need * inverse
    normal_rate = -normal * turned_u * inverse
    x = contact.free1 + normal * per_1
    y = contact.free2 + normal * per_2
    x_rate = normal_rate * per_1 + normal * turned_1
    y_rate = normal_rate * per_2 + normal * turned_2
    along = c * x + s * y
    across = c * y - s * x
    return normal, per_u, along, across, (c * y_rate - s * x_rate) - along


@scalar
def spun(own, u, r, inertia, drag, mu, angle, normal):
    """Return ``domega/dt`` under the contact force ``normal (u - mu e)``."""
    ex, ey, ez = slip_direction(u, angle)
    ux, uy, uz = u
    lever = cross(r, (ux - mu * ex, uy - mu * ey, uz - mu * ez))
    torque = lever[0] + drag[0], lever[1] + drag[1], lever[2] + drag[2]
    ax, ay, az = divided(torque, inertia)
    return own[0] + normal * ax, own[1] + normal * ay, own[2] + normal * az


@scalar
def holding_force(contact):
    """Return the forces along ``u, h_1, h_2`` that keep a body rolling.

    They solve three linear equations: the contact point is not accelerated.
    """
    by_normal = (
        contact.kuu + contact.tu,
        contact.ku1 + contact.t1,
        contact.ku2 + contact.t2,
    )
    by_first = contact.ku1, contact.k11, contact.k12
    by_second = contact.ku2, contact.k12, contact.k22
    wanted = contact.need, -contact.free1, -contact.free2
    # Cramer's rule
    whole = triple(by_normal, by_first, by_second)
    normal = triple(wanted, by_first, by_second) / whole
    first = triple(by_normal, wanted, by_second) / whole
    second = triple(by_normal, by_first, wanted) / whole
    return normal, first, second


SCAN = 64  # directions between which others are searched
HALVINGS = 40
FINE_SCAN = 720
TWO_PI = 6.283185307179586
LEAST_RATE = -1e-6  # of the speed of a body that begins to slide


@scalar
def settled_direction(contact, mu, angle):
    """Return the stable direction of sliding near ``angle``, by Newton's method.

    There the direction stays while the speed is small and does not fall, and the
    mobility is positive.  The second value tells whether one was found.
    """
    for _ in range(30):
        _, mobility, along, across, slope = push(contact, mu, angle)
        if slope >= 0.0:
            break
        step = -across / slope
        angle += min(0.3, max(-0.3, step))
        if abs(step) < 1e-14:
            return angle, along >= LEAST_RATE and mobility > 0.0
    return angle, False


@scalar
def turning(contact, mu, angle):
    """Return the mobility times the rate of the direction times the speed.

    It has no poles: it is a sum of sines and cosines of the angle and of twice it.
    """
    _, mobility, _, across, _ = push(contact, mu, angle)
    return mobility * across


@scalar
def direction_between(contact, mu, low, high):
    """Return the settled direction between two, at which slides turn to each other."""
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if turning(contact, mu, middle) > 0.0:
            low = middle
        else:
            high = middle
    return settled_direction(contact, mu, 0.5 * (low + high))


@scalar
def outgoing(contact, mu):
    """Return the direction in which a body at rest on the plane begins to slide.

    The second value tells whether there is one.  Where the force that would keep it
    rolling is just ``mu`` times the normal force, sliding begins opposite to it.  If
    Newton's method finds no direction from there, the one nearest to it is taken.
    """
    _, first, second = holding_force(contact)
    opposite = atan2(-second, -first)
    found, sure = settled_direction(contact, mu, opposite)
    if sure:
        return found, True
    nearest = -2.0
    before = turning(contact, mu, opposite)
    for k in range(1, SCAN + 1):
        high = opposite + k * (TWO_PI / SCAN)
        after = turning(contact, mu, high)
        if before > 0.0 and after <= 0.0:
            low = high - TWO_PI / SCAN
            way, is_way = direction_between(contact, mu, low, high)
            if is_way and cos(way - opposite) > nearest:
                nearest = cos(way - opposite)
                found = way
        before = after
    return found, nearest > -2.0


@scalar
def meets_singularity(contact, mu, angle):
    """Return whether the mobility vanishes before a direction of sliding settles.

    At a small speed nothing but the direction changes, until it settles.
    """
    sense = 1.0 if turning(contact, mu, angle) > 0.0 else -1.0
    for k in range(1, FINE_SCAN + 1):
        ahead = angle + sense * k * (TWO_PI / FINE_SCAN)
        _, mobility, _, across, _ = push(contact, mu, ahead)
        if mobility <= 0.0:
            return True
        if sense * across <= 0.0:
            return False
    return False


@scalar
def slip_energy(u, omega, r, speed, angle):
    """Return the kinetic energy of a sliding body beyond that of a rolling one."""
    e = slip_direction(u, angle)
    return speed * dot(e, cross(r, omega)) + 0.5 * speed * speed


@scalar
def track(u, omega, r, w, speed, angle, heading):
    """Return what :func:`rattlesweep.physics.full.track_at` does, with sliding."""
    turn, x, y = track_at(u, omega, r, w, heading)
    # The direction of sliding is measured from the x axis, as the heading is.
    c, s = cos_sin(heading + angle)
    return turn, x + speed * c, y + speed * s
