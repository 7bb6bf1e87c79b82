"""Ellipsoids in any position, and the rate at which the flow changes phase volume.

An ellipsoid that rolls onto its side leaves the slopes of
:mod:`rattlesweep.physics.full`.  Here the state is ``(v_x, v_y, v_z, a, b, c, work)``:
a vector along the vertical, of any length, the angular velocity and the work of
friction.  With ``u = v/|v|``, ``B = 1 + C`` and ``k = 1/c`` the ellipsoid of
:mod:`rattlesweep.physics.stone` touches the plane at

    r = (-B (u_x, u_y) / rho, 1 - (1 + u_z/rho) / k),    rho^2 = u_z^2 + k s,
    s = (u_x, u_y).B (u_x, u_y),

and for ``k = 0`` and ``u_z < 0`` so does the paraboloid.  The constants are those with
friction.

Phase volume is the product of the volumes of ``u``, which only turns, and of ``omega``.
It changes at the relative rate ``tr d(J^-1 T)/domega`` with ``J`` and ``T``, the right
side of Eq. 11, as in :func:`rattlesweep.physics.full.solve_rates`.  With ``w = W
omega`` and the gyroscopic and viscous part ``G``,

    dT/domega = G + (r.w) 1 - w r^T + omega (W^T r)^T - (r.omega) W,
    J^-1 = ivol (diag(dyz, dzx, dxy) + along s s^T),    s = (x dyz, y dzx, z dxy).

``solved`` stands for ``(dyz, dzx, dxy, along, ivol)``.
"""

# mypy: disable-error-code="no-untyped-def"
from math import sqrt

from rattlesweep.physics.full import acceleration, scalar
from rattlesweep.physics.stone import (
    dot,
    force_at,
    horizontal,
    resistance,
    solve_again,
    triple,
)

N_PLACE = 6  # components without the work of friction
# Rotation and path since the start of a step, which single steps add to the state.
N_EXTRA = 7


@scalar
def unit(v):
    """Return the unit vector along a vector."""
    vx, vy, vz = v
    length = sqrt(vx * vx + vy * vy + vz * vz)
    return vx / length, vy / length, vz / length


@scalar
def position(y):
    """Return the vertical unit vector and the angular velocity of a state."""
    return unit(y[:3]), y[3:6]


@scalar
def contact_under(u, shape):
    """Return the contact point ``r`` and ``rho``."""
    ux, uy, uz = u
    cxx, cxy, cyy, k = shape
    bx = ux + cxx * ux + cxy * uy
    by = uy + cxy * ux + cyy * uy
    s = bx * ux + by * uy
    rho = sqrt(uz * uz + k * s)
    # Nothing cancels in the first form if u_z < 0, also for k = 0, nor in the second
    # otherwise.
    if uz < 0.0:
        rise = s / (rho * (rho - uz))
    else:
        rise = (1.0 + uz / rho) / k
    return (-bx / rho, -by / rho, 1.0 - rise), rho


@scalar
def moving(u, omega, r, rho, shape):
    """Return ``w = r x omega - dr/dt``, which is linear in ``omega``."""
    cxx, cxy, cyy, k = shape
    ux, uy, uz = u
    a, b, c = omega
    x, y, z = r
    du = uy * c - uz * b
    dv = uz * a - ux * c
    dw = ux * b - uy * a
    bx = du + cxx * du + cxy * dv
    by = dv + cxy * du + cyy * dv
    # Half the derivative of s, and the logarithmic derivative of rho.
    g = ux * bx + uy * by
    fall = (uz * dw + k * g) / (rho * rho)
    # Minus the derivative of the third component of r, without dividing by k.
    sink = (uz * g + (x * ux + y * uy) * rho * dw) / (rho * rho * rho)
    return (
        y * c - z * b + bx / rho + x * fall,
        z * a - x * c + by / rho + y * fall,
        x * b - y * a - sink,
    )


@scalar
def acceleration_at(u, omega, r, w, inertia, torque, weight=1.0):
    """Return ``domega/dt`` under a further torque, and the inverse used."""
    ux, uy, uz = u
    a, b, c = omega
    x, y, z = r
    lx, ly, lz = torque
    # At slope zero gravity acts along z only; the torque r x (u_x, u_y, 0) of the rest
    # is added.
    x_pull, y_pull = weight * ux, weight * uy
    tilting = lx - z * y_pull, ly + z * x_pull, lz + x * y_pull - y * x_pull
    touch = (x, y, 1.0 - z), w, uz
    return acceleration((0.0, 0.0, a, b, c), inertia, tilting, touch, weight)


@scalar
def smooth_rates(u, omega, r, rho, shape, inertia, sigma):
    """Return ``domega/dt`` without rolling resistance, ``F_n, w`` and ``solved``."""
    a, b, c = omega
    w = moving(u, omega, r, rho, shape)
    torque = -sigma * a, -sigma * b, -sigma * c
    rates, solved = acceleration_at(u, omega, r, w, inertia, torque)
    normal, _ = force_at(u, omega, rates, r, w)
    return rates, normal, w, solved


@scalar
def vertical_rate(y):
    """Return the derivative of the vector along the vertical."""
    vx, vy, vz, a, b, c = y[:6]
    return vy * c - vz * b, vz * a - vx * c, vx * b - vy * a


@scalar
def rolling_rhs(contact, y, inertia, shape, loss):
    """Return the time derivative of the state (Eqs. 10 and 11, with friction).

    ``contact`` is :func:`contact_under`.
    """
    u, omega = position(y)
    a, b, c = omega
    sigma, lever, eps = loss
    r, rho = contact(u, shape)
    rates, normal, _, solved = smooth_rates(u, omega, r, rho, shape, inertia, sigma)
    da, db, dc = rates
    ra, rb, rc, loss = resistance(u, omega, r, normal, lever, eps, solved)
    power = -sigma * (a * a + b * b + c * c) - loss
    return vertical_rate(y) + (da - ra, db - rb, dc - rc, power)  # noqa: RUF005


@scalar
def spin(y):
    """Return the spin ``n = u . omega`` (Eq. 46), in ``sqrt(g/a)``."""
    vx, vy, vz, a, b, c = y[:6]
    return (vx * a + vy * b + vz * c) / sqrt(vx * vx + vy * vy + vz * vz)


@scalar
def spin_rate(y, dy):
    """Return ``dn/dt``, as `physics.full.spin_rate` does."""
    return spin(y[:3] + dy[3:6])


@scalar
def energy(y, constants):
    """Return the energy in ``M g a``, which is zero upright at rest."""
    u, (a, b, c) = position(y)
    ix, iy, iz = constants[:3]
    (x, y_, z), _ = contact_under(u, constants[3:7])
    # The velocity of the centre of mass, r x omega.
    px, py, pz = y_ * c - z * b, z * a - x * c, x * b - y_ * a
    twice_kinetic = ix * a * a + iy * b * b + iz * c * c + px * px + py * py + pz * pz
    ux, uy, uz = u
    return 0.5 * twice_kinetic - (x * ux + y_ * uy + z * uz) - 1.0


@scalar
def contact_force(y, dy, constants):
    """Return the contact force in ``M g``, as :func:`full.force` does."""
    u, omega = position(y)
    shape = constants[3:7]
    r, rho = contact_under(u, shape)
    w = moving(u, omega, r, rho, shape)
    return force_at(u, omega, dy[3:6], r, w)


@scalar
def rise(y, constants):
    """Return the height of the contact over the lowest point of the body."""
    (_, _, z), _ = contact_under(unit(y[:3]), constants[3:7])
    return 1.0 - z


@scalar
def smooth_volume(y, inertia, shape, sigma):
    """Return the rate of phase volume without rolling resistance, in ``sqrt(g/a)``."""
    u, omega = position(y)
    a, b, c = omega
    ix, iy, iz = inertia
    r, rho = contact_under(u, shape)
    x, y_, z = r
    _, _, w, solved = smooth_rates(u, omega, r, rho, shape, inertia, sigma)
    dyz, dzx, dxy, along, ivol = solved
    s = sx, sy, sz = x * dyz, y_ * dzx, z * dxy
    # W times s, W times diag(dyz, dzx, dxy) omega, and the diagonal of W.
    ws = moving(u, s, r, rho, shape)
    wd = moving(u, (dyz * a, dzx * b, dxy * c), r, rho, shape)
    wxx, _, _ = moving(u, (1.0, 0.0, 0.0), r, rho, shape)
    _, wyy, _ = moving(u, (0.0, 1.0, 0.0), r, rho, shape)
    _, _, wzz = moving(u, (0.0, 0.0, 1.0), r, rho, shape)
    gain = dot(r, w) - sigma
    rolled = dot(r, omega)
    diagonal = gain * (dyz + dzx + dxy) - dot(w, s) + dot(r, wd)
    diagonal = diagonal - rolled * (dyz * wxx + dzx * wyy + dxy * wzz)
    rank_one = (
        (iy - iz) * sx * (sy * c + sz * b)
        + (iz - ix) * sy * (sz * a + sx * c)
        + (ix - iy) * sz * (sx * b + sy * a)
        + gain * dot(s, s)
        - dot(w, s) * dot(r, s)
        + dot(s, omega) * dot(r, ws)
        - rolled * dot(s, ws)
    )
    return ivol * (diagonal + along * rank_one)


@scalar
def frictionless_volume(y, inertia, shape, loss):
    """Return the rate of phase volume without friction; ``loss`` is empty."""
    return smooth_volume(y, inertia, shape, 0.0)


@scalar
def viscous_volume(y, inertia, shape, loss):
    """Return the rate of phase volume with the torque ``-sigma omega``."""
    return smooth_volume(y, inertia, shape, loss[0])


@scalar
def rolling_volume(y, inertia, shape, loss):
    """Return the rate of phase volume with the resistance ``share J^-1 h``."""
    u, omega = position(y)
    a, b, c = omega
    sigma, lever, eps = loss
    r, rho = contact_under(u, shape)
    x, y_, z = r
    _, normal, _, solved = smooth_rates(u, omega, r, rho, shape, inertia, sigma)
    dyz, dzx, dxy, along, ivol = solved
    h = horizontal(u, omega)
    j = ja, jb, jc = solve_again(r, h, solved)
    root = sqrt(dot(h, h) + eps * eps)
    below = root + lever * triple(u, r, j)
    share = lever * normal / below
    # The normal force is quadratic in omega, so its central difference along j is
    # exact.
    more = (a + ja, b + jb, c + jc)
    less = (a - ja, b - jb, c - jc)
    _, ahead, _, _ = smooth_rates(u, more, r, rho, shape, inertia, sigma)
    _, behind, _, _ = smooth_rates(u, less, r, rho, shape, inertia, sigma)
    g = horizontal(u, j)
    wider = dot(h, g) / root + lever * triple(u, r, solve_again(r, g, solved))
    s = x * dyz, y_ * dzx, z * dxy
    flat = (
        dyz * (1.0 - u[0] * u[0])
        + dzx * (1.0 - u[1] * u[1])
        + dxy * (1.0 - u[2] * u[2])
    )
    trace = ivol * (flat + along * dot(s, horizontal(u, s)))
    lost = share * trace + (0.5 * lever * (ahead - behind) - share * wider) / below
    return smooth_volume(y, inertia, shape, sigma) - (lost if share > 0.0 else 0.0)


@scalar
def rolled(u, omega, shape):
    """Return the velocity of the contact point of a rolling body, in its own axes."""
    a, b, c = omega
    r, rho = contact_under(u, shape)
    x, y, z = r
    wx, wy, wz = moving(u, omega, r, rho, shape)
    # dr/dt = r x omega - w
    return y * c - z * b - wx, z * a - x * c - wy, x * b - y * a - wz


@scalar
def carried_on(rotation, omega, velocity):
    """Return the rates of the rotation and the path since the start of a step.

    The rotation is a unit quaternion less 1, so that it starts at zero.  The path has
    the axes of the body at the start.
    """
    less, x, y, z = rotation
    w = 1.0 + less
    a, b, c = omega
    vx, vy, vz = velocity
    # The velocity turned by the quaternion: v + 2 q x (q x v + w v).
    tx = y * vz - z * vy + w * vx
    ty = z * vx - x * vz + w * vy
    tz = x * vy - y * vx + w * vz
    return (
        -0.5 * (x * a + y * b + z * c),
        0.5 * (w * a + y * c - z * b),
        0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y * a),
        vx + 2.0 * (y * tz - z * ty),
        vy + 2.0 * (z * tx - x * tz),
        vz + 2.0 * (x * ty - y * tx),
    )
