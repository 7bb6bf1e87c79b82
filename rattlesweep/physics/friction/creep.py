"""Creep: a patch of contact that spins also gives way to the force that rolls the body.

A patch that turns slides in each of its points.  A further force in the plane, however
small, therefore moves it.  With Coulomb's law in each point of a circular patch under
Hertz's pressure, of the radius ``e = 16 l / (3 pi mu)``, and with ``x = v / (e |n|)``,

    F_t = (3 pi / 32) (4 x - x^3) mu F_n,    torque = l F_n (1 - x^2 + 3 x^4 / 8)

up to ``x = 1`` (see :mod:`rattlesweep.physics.friction.pivoting`).  So the contact
point drifts at ``v`` against the force ``F_t`` that would keep the body rolling.

Nothing gets stiff if the drift is a correction.  The angular momentum about the contact
point, ``J omega - r x v``, changes at a rate without the derivative of ``v``.  The
state has ``omega_0``, the angular velocity of the rolling body with the same angular
momentum.  The body turns at ``omega = omega_0 + J^-1 (r x v)``, its centre of mass
moves at ``r x omega + v``, and with ``D`` as the rate in space

    D(J omega_0) = r x u - D(r) x (r x omega + v) + T u,    D(r) = -w.

The force ``F_t`` is that of the body that rolls with ``omega_0``.  The error is of
second order in ``v``, as is that of the energy ``omega_0 . J omega_0 / 2 - r . u``.
Where the spin is zero, the drift is, too.
"""

# mypy: disable-error-code="no-untyped-def"
from math import pi, sqrt

from rattlesweep.physics.friction.sliding import cross
from rattlesweep.physics.full import NO_FORCE, TINY, scalar
from rattlesweep.physics.stone import adjugate, dot, horizontal, multiplied

# Where the force is larger than that at x = 1, .88 mu F_n, the foot drifts at x = 1.
MOST_DRIFT = 0.75
# The law is Hertz's and Coulomb's for a patch that slides in all its points.  It is in
# doubt where the force is larger than this share of mu F_n, and where the body rolls
# faster than this many times |n| / mu, so that the patch sticks in part.
DOUBTFUL_SHARE = 0.28
DOUBTFUL_ROLLING = 2.0


@scalar
def drift_of_patch(share):
    """Return ``x``, the drift over the speed of the rim of the turning patch.

    ``share`` is that of the force, ``F_t / (mu F_n)``.
    """
    # x - x^3 / 4 = level, by three steps of Newton's method from the series of x.
    level = min((8.0 / (3.0 * pi)) * share, MOST_DRIFT)
    square = level * level
    x = level * (1.0 + square * (0.25 + square * (0.1875 + 0.1875 * square)))
    for _ in range(3):
        x = x - (x - 0.25 * x * x * x - level) / (1.0 - 0.75 * x * x)
    return x


@scalar
def rolling_force(u, omega, rates, r, w, applied=NO_FORCE):
    """Return the force in the plane on a body that rolls with ``omega``.

    The force ``applied`` acts at its centre of mass.
    """
    ax, ay, az = cross(r, rates)
    bx, by, bz = cross(omega, w)
    px, py, pz = applied
    force = u[0] + ax + bx - px, u[1] + ay + by - py, u[2] + az + bz - pz
    return horizontal(u, force)


@scalar
def drift(u, omega, rates, r, w, normal, lever, mu, applied=NO_FORCE):
    """Return the velocity ``v`` of the contact point, ``x``, and whether it is sure.

    The body would roll with ``omega`` and its ``rates``, with the normal force
    ``normal`` and the force ``applied`` at its centre of mass.
    """
    fx, fy, fz = rolling_force(u, omega, rates, r, w, applied)
    size = sqrt(fx * fx + fy * fy + fz * fz)
    n = dot(u, omega)
    # Where the plane would have to pull there is no friction that slows the drift.
    pressed = 0.5 * (normal + abs(normal))
    share = size / (mu * pressed + TINY)
    x = drift_of_patch(share)
    radius = (16.0 / (3.0 * pi)) * lever / mu
    part = -radius * abs(n) * x / (size + TINY)
    flat = horizontal(u, omega)
    rolls = mu * mu * dot(flat, flat) < DOUBTFUL_ROLLING * DOUBTFUL_ROLLING * n * n
    is_sure = 1.0 if rolls and share < DOUBTFUL_SHARE else 0.0
    return (part * fx, part * fy, part * fz), x, is_sure


@scalar
def share_of_torque(x):
    """Return the torque of a patch that drifts over that of one that does not."""
    square = x * x
    return 1.0 - square + 0.375 * square * square


@scalar
def turned_by(r, v, inertia):
    """Return ``omega - omega_0``, and the adjugate and the determinant of ``J``."""
    solver, det = adjugate(r, inertia)
    a, b, c = multiplied(solver, cross(r, v))
    return (a / det, b / det, c / det), solver, det


@scalar
def changed_rates(u, omega, r, w, rolled, v, more, torque, inertia, solver, det):
    """Return what the drift adds to ``domega_0/dt``, and to the power of friction.

    ``omega`` is ``omega_0``; ``rolled`` are ``r``'s rate and ``w`` of the body that
    rolls with it, ``w`` that of the body that turns with ``omega_0 + more``, and
    ``torque`` is added along ``u``.
    """
    r_rate, w_rolled = rolled
    ix, iy, iz = inertia
    turning = omega[0] + more[0], omega[1] + more[1], omega[2] + more[2]
    vx, vy, vz = cross(r, turning)
    r_now = vx - w[0], vy - w[1], vz - w[2]
    velocity = vx + v[0], vy + v[1], vz + v[2]
    # Change of the couple w x (velocity of the centre of mass).
    cx, cy, cz = cross(w, velocity)
    dx, dy, dz = cross(w_rolled, cross(r, omega))
    # J omega_0, and the gyroscopic couple of what is added to omega.
    rolls = dot(r, omega)
    far = dot(r, r)
    ax = (ix + far) * omega[0] - rolls * r[0]
    ay = (iy + far) * omega[1] - rolls * r[1]
    az = (iz + far) * omega[2] - rolls * r[2]
    gx, gy, gz = cross(more, (ax, ay, az))
    # Change of (dJ/dt) omega_0 with that of dr/dt.
    e = ex, ey, ez = r_now[0] - r_rate[0], r_now[1] - r_rate[1], r_now[2] - r_rate[2]
    twice = 2.0 * dot(r, e)
    along = dot(e, omega)
    jx = twice * omega[0] - ex * rolls - r[0] * along
    jy = twice * omega[1] - ey * rolls - r[1] * along
    jz = twice * omega[2] - ez * rolls - r[2] * along
    couple = (
        cx - dx - gx - jx + torque * u[0],
        cy - dy - gy - jy + torque * u[1],
        cz - dz - gz - jz + torque * u[2],
    )
    sx, sy, sz = multiplied(solver, couple)
    kinetic = dot(omega, couple) + 0.5 * dot(omega, (jx, jy, jz))
    power = kinetic - dot(r, cross(u, more))
    return (sx / det, sy / det, sz / det), power


@scalar
def no_rate(place, own):
    """Return the rate of the work in doubt where the foot does not drift: none."""
    return (0.0,)
