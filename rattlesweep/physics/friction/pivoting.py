"""Pivoting friction: the patch of contact rubs as the body turns about a vertical.

While the body rolls with the spin ``n``, the torque along the vertical ``u`` is ``-l
F_n sign(n)``, with the lever ``l`` and the normal force ``F_n``.  The sign is constant
between two zeros of the spin: the ``sense``.  At a zero the plane may hold
the spin, as long as the torque that keeps it at zero is at most ``l F_n``; the sense is
then 0.  The torque changes ``F_n`` itself.

While the contact point slides at the speed ``v``, the torque is smaller.  For Coulomb's
law in each point of a circular patch under Hertz's pressure, with the radius ``e = 16 l
/ (3 pi mu)`` and ``x = v / (e |n|)``, it is ``-l F_n m(x) sign(n)`` with the ``m`` of
:func:`share_of_lever` (from the potential of Hertz's pressure; compare Zhuravlev 1998).
"""

# mypy: disable-error-code="no-untyped-def"
from math import asin, pi, sqrt

from rattlesweep.physics import vectors
from rattlesweep.physics.full import TINY, scalar
from rattlesweep.physics.stone import (
    dot,
    multiplied,
    resisted,
    rolling_resistance,
    solve_again,
    triple,
    without_grip,
)

# Rate, in sqrt(g/a), at which rounding errors of a spin that is held decay.
RETURN = 1.0
# Where spin and speed of sliding are small, the decay of the spin is stiff.  So the
# creep, ``mu`` times this speed, counts as the root of its square and that of a least
# creep, which is the last constant of a body that slides.  This is the largest.
LEAST_CREEP = 1e-13
# Largest `slip_of_patch` of a foot that is about to slide.  To the square of it, the
# torque is the one without sliding.
LEAST_SLIP = 1e-5


@scalar
def share_of_lever(x):
    """Return ``m(x)``, the torque of a sliding patch over the one without sliding."""
    square = x * x
    if x <= 1.0:
        return 1.0 - square + 0.375 * square * square
    if x > 30.0:
        # The terms of the closed form cancel; the next one is 0.009 / x^6.
        far = 1.0 + (1.0 + 0.25 / square) / (14.0 * square)
        return 16.0 / (15.0 * pi) * far / x
    angle = asin(1.0 / x)
    root = sqrt(square - 1.0)
    whole = (2.0 - 2.0 * square + 0.75 * square * square) * angle
    return (whole + 0.25 * root * (6.0 - 3.0 * square)) / pi


@scalar
def slip_of_patch(n, lever, creep):
    """Return ``x``, the speed of sliding over that at the rim of the turning patch.

    ``creep`` is ``mu`` times the speed of sliding.
    """
    size = abs(n) + TINY
    return creep * (3.0 * pi / 16.0) / (lever * size + TINY)


@scalar
def least_creep(n, lever):
    """Return the least creep of a body that begins to slide with the spin ``n``."""
    unit_slip = (16.0 / (3.0 * pi)) * lever * abs(n)
    return min(LEAST_CREEP, LEAST_SLIP * unit_slip)


@scalar
def sliding_drag(u, n, lever, creep, least):
    """Return the torque of pivoting per normal force of a body that slides.

    ``creep`` is ``mu`` times the speed of sliding, ``least`` that of the least speed.
    """
    smooth = sqrt(creep * creep + least * least)
    share = -lever * share_of_lever(slip_of_patch(n, lever, smooth))
    if n < 0.0:
        share = -share
    if n == 0.0:
        share = 0.0
    return share * u[0], share * u[1], share * u[2]


@scalar
def slope_of_share(x):
    """Return the derivative of ``m`` with respect to ``1/x``, spin over speed."""
    square = x * x
    if x <= 1.0:
        return (2.0 - 1.5 * square) * square * x
    if x > 30.0:
        return 16.0 / (15.0 * pi) * (1.0 + (3.0 + 1.25 / square) / (14.0 * square))
    angle = asin(1.0 / x)
    root = sqrt(square - 1.0)
    return (
        (root * (3.0 * square - 2.0) - (3.0 * square - 4.0) * square * angle) * x / pi
    )


@scalar
def slope_of_torque(n, lever, creep, least):
    """Return the derivative of the torque per normal force with respect to the spin.

    The arguments are those of :func:`sliding_drag`.
    """
    smooth = sqrt(creep * creep + least * least)
    slope = slope_of_share(slip_of_patch(n, lever, smooth))
    return -slope * lever * lever * (16.0 / (3.0 * pi)) / (smooth + TINY)


@scalar
def patch_torque(place, own):
    """Return what :func:`sliding_drag` does, for an action; ``least`` is its sense."""
    lever, least = own
    return sliding_drag(place.u, dot(place.u, place.omega), lever, place.creep, least)


@scalar
def sliding_power(placed, normal):
    """Return the power of pivoting while the body slides.

    Of all torques in proportion to the normal force, it has the part along the
    vertical.
    """
    return normal * dot(placed.drag, placed.u) * dot(placed.u, placed.omega)


@scalar
def with_torque(u, omega, rates, normal, j, lift, lever, sense):
    """Return ``domega/dt`` with the torque along ``u``, it, and the normal force.

    ``rates`` and ``normal`` are those without the torque; it changes them by ``j`` and
    ``lift`` per unit.
    """
    if sense == 0.0:
        # The spin rests: its rate is u . domega/dt.
        above = -(dot(u, rates) + RETURN * dot(u, omega))
        below = dot(u, j)
    else:
        above = -lever * sense * (0.5 * (normal + abs(normal)))
        below = 1.0 + lever * sense * lift
    torque = above / below
    da, db, dc = rates
    jx, jy, jz = j
    changed = da + torque * jx, db + torque * jy, dc + torque * jz
    return changed, torque, normal + torque * lift


@scalar
def normal_of(u, omega, r, w, rates):
    """Return the normal force: ``F = u + r x domega/dt + omega x w`` along ``u``."""
    return 1.0 + triple(u, r, rates) + triple(u, omega, w)


@scalar
def rolling_and_pivoting(u, omega, r, w, rates, solved, loss):
    """Return what :func:`with_torque` does, and the power of rolling resistance.

    The resistance and the torque both depend on the normal force, and change it.
    """
    _, rolling, eps, lever, sense = loss
    normal = normal_of(u, omega, r, w, rates)
    drag = rolling_resistance(u, omega, rolling, eps)
    roll = a1, b1, c1 = solve_again(r, drag, solved)
    # With the resistance: the normal force and the rates it causes.
    kept = 1.0 - triple(u, r, roll)
    normal = normal / kept
    normal = 0.5 * (normal + abs(normal))
    da, db, dc = rates
    rates = da + normal * a1, db + normal * b1, dc + normal * c1
    # The torque lifts the body, which changes the resistance.
    j = jx, jy, jz = solve_again(r, u, solved)
    lift = triple(u, r, j) / kept
    j = jx + lift * a1, jy + lift * b1, jz + lift * c1
    changed, torque, normal = with_torque(
        u, omega, rates, normal, j, lift, lever, sense
    )
    return changed, torque, normal, normal * dot(drag, omega)


@scalar
def pivoting_parts(contact, y, inertia, shape, loss):
    """Return rates and forces of a body that rolls with the torque alone.

    They are the rates of the position, ``domega/dt``, the torque, the normal force, the
    power of the other friction, and that of the torque.
    """
    p, q, a, b, c = y[:5]
    sigma, lever, sense = loss
    place, power, root, det, solver, g, sink, rates = without_grip(
        contact, y, inertia, shape, sigma
    )
    gx, gy, gz = g
    sa, sb, sc = rates
    e = p, q, 1.0
    turn = p * a + q * b + c
    scale = root * det
    j = ja, jb, jc = multiplied(solver, e)
    # The torque of a held spin keeps its rate, e . domega/dt, at zero.
    is_held = sense == 0.0
    v = p if is_held else gx, q if is_held else gy, 1.0 if is_held else gz
    known = (turn if is_held else -sink) * scale + dot(v, rates)
    normal = root * scale + known
    # There is no torque where the plane would have to pull.
    normal = normal if normal > 0.0 else 0.0
    grip = lever * sense
    lift = dot(v, j)
    above = known if is_held else grip * normal
    below = lift if is_held else grip * lift - root * scale
    torque = above / below
    inv = 1.0 / scale
    changed = (
        (sa - torque * ja) * inv,
        (sb - torque * jb) * inv,
        (sc - torque * jc) * inv,
    )
    part = inv * det
    normal = 1.0 - (sink - dot(g, changed)) / root
    return place, changed, torque, normal, power, -torque * (turn * part)


@scalar
def rolling_parts(contact, y, inertia, shape, loss):
    """Return what :func:`pivoting_parts` does, with rolling resistance."""
    p, q, a, b, c = y[:5]
    sigma, rolling, eps, lever, sense = loss
    (dp, dq), power, root, det, solver, g, sink, rates = without_grip(
        contact, y, inertia, shape, sigma
    )
    sa, sb, sc = rates
    e = p, q, 1.0
    turn = p * a + q * b + c
    scale = root * det
    part = 1.0 / root
    inv = part / det
    h, square, smoothed = resisted(p, q, dp, dq, root, eps)
    hx, hy, hz = rolled = multiplied(solver, h)
    jx, jy, jz = j = multiplied(solver, e)
    resistance = rolling * root / smoothed
    # The torque is ``held + grip F_n``.
    inverse = 1.0 / dot(e, j)
    is_held = sense == 0.0
    held = (dot(e, rates) + turn * scale) * inverse if is_held else 0.0
    # The sense of a held spin is zero.  Were the lever read under a condition, code for
    # AVX2 would mask the load.
    grip = -lever * sense
    grip += -resistance * dot(e, rolled) * inverse if is_held else 0.0
    lift = dot(g, j)
    above = root * scale + dot(g, rates) - sink * scale - held * lift
    normal = above / (root * scale + resistance * dot(g, rolled) + grip * lift)
    # There is no friction where the plane would have to pull.
    normal = normal if normal > 0.0 else 0.0
    torque = held + grip * normal
    share = resistance * normal
    changed = (
        (sa - torque * jx - share * hx) * inv,
        (sb - torque * jy - share * hy) * inv,
        (sc - torque * jz - share * hz) * inv,
    )
    normal = 1.0 - (sink - dot(g, changed)) * part
    power = power - share * (square * (part * (part * part)))
    return (dp, dq), changed, torque, normal, power, -torque * (turn * part)


@scalar
def parts_anywhere(contact, y, inertia, shape, loss):
    """Return what :func:`rolling_parts` does, for a body in any position."""
    u, omega = vectors.position(y)
    sigma = loss[0]
    r, rho = contact(u, shape)
    rates, _, w, solved = vectors.smooth_rates(u, omega, r, rho, shape, inertia, sigma)
    changed, torque, normal, rolled = rolling_and_pivoting(
        u, omega, r, w, rates, solved, loss
    )
    power = rolled - sigma * dot(omega, omega)
    taken = torque * dot(u, omega)
    return vectors.vertical_rate(y), changed, torque, normal, power, taken


@scalar
def rates_of(parts):
    """Return the derivative of the state, the work and the work of pivoting."""
    place, changed, _, _, power, taken = parts
    return place + changed + (power + taken, taken)


@scalar
def pivoting_rhs(contact, y, inertia, shape, loss):
    """Return the derivative of the state and both works with the torque alone."""
    return rates_of(pivoting_parts(contact, y, inertia, shape, loss))


@scalar
def rolling_rhs(contact, y, inertia, shape, loss):
    """Return what :func:`pivoting_rhs` does, with rolling resistance."""
    return rates_of(rolling_parts(contact, y, inertia, shape, loss))


@scalar
def rhs_anywhere(contact, y, inertia, shape, loss):
    """Return what :func:`rolling_rhs` does, for a body in any position."""
    return rates_of(parts_anywhere(contact, y, inertia, shape, loss))
