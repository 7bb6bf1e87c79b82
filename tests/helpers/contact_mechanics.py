"""Newton and Euler at a contact that rolls, is held, slides or rubs, in Python.

This module does not import `rattlesweep`.  With the contact point ``r`` from the centre
of mass, the velocity ``V`` of the centre of mass and the velocity ``v = V + omega x r``
of the body's material at the contact point, all in the body frame (M = a = g = 1),

    dV/dt + omega x V = F - u,
    I domega/dt + omega x I omega = r x F + T u + N d - sigma omega,
    du/dt = u x omega,

so that ``dv/dt + omega x v = W F + K``, where ``W`` is the inverse of the mass that the
contact point feels and ``K`` its acceleration without a force.  A body that rolls has
``v = 0`` and ``W F = -K``; a body that slides has ``F = N (u - mu v/|v|)`` with ``N``
from ``u . (W F + K) = 0``.  ``N d`` is the couple of rolling resistance.  The size of
the torque ``T u`` depends on the normal force ``N``:

- A body that rolls and spins has ``T = -l N sign(n)``, with ``n = u . omega``.
- A body that rolls with ``n = 0`` is *held* if the torque that keeps ``n = 0`` has
  ``|T| <= l N``.
- A foot that slides at the speed ``v`` has ``T = -l N q(y)`` with ``y = e n / v`` and
  ``q = sign(n) M(|1/y|) / M(0)``; ``e = 16 l / (3 pi mu)`` is the radius of a circular
  patch of Hertz's with the lever ``l`` (`hertz_patch`).  The sliding force keeps the
  size ``mu N``.

The functions of the equations take any numbers: floats, complex numbers, arrays, and
mpf where there is no rubbing.  A state that rolls is ``(u, omega, friction, couple,
pivot)``, two vectors and three works; one that slides is ``(u, omega, friction, couple,
pivot, n, s, ln |v|)`` with ``v = |v| s``.  It has ``n`` by itself, since ``n`` and
``v`` may be far below the rounding errors of ``omega``.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from hertz_patch import rubbing_of

SMOOTHING = 1e-4  # of rolling resistance
FRICTION, COUPLE, PIVOT, SPIN = range(6, 10)
N_ROLLING = 9
DIRECTION = slice(10, 13)
LOG_SPEED = 13
N_SLIDING = 14
SLOWEST = -200.0  # ln |v| in trial steps that fail
HELD = 0  # a side of zero, beside 1 and -1


@dataclass(frozen=True)
class Body:
    """The parameters of a body, as `rs.Rattleback` has them."""

    alpha: float
    beta: float
    gamma: float
    theta: float
    phi: float
    xi: float
    c: float | None = None


@dataclass(frozen=True)
class Stone:
    """A body: its moments of inertia, surface, and friction.

    The matrix ``B`` of the principal radii at the bottom is ``(bxx, bxy, byy)``; ``c``
    is the vertical semi-axis of an ellipsoid, or None for a paraboloid.  ``pivot`` and
    ``rolling`` are the levers of rubbing and of rolling resistance.
    """

    inertia: tuple
    radii: tuple
    c: float | None = None
    mu: float = math.inf
    sigma: float = 0.0
    pivot: float = 0.0
    rolling: float = 0.0

    @property
    def patch(self):
        """The radius of the patch."""
        return 16 * self.pivot / (3 * math.pi * self.mu)


def stone_of(body, mu=math.inf, sigma=0.0, pivot=0.0, rolling=0.0):
    """Return the stone with the parameters of an object such as `rs.Rattleback`."""
    cosine = math.cos(body.xi)
    sine = math.sin(body.xi)
    long = 1 / body.theta
    short = 1 / body.phi
    radii = (
        cosine**2 * long + sine**2 * short,
        sine * cosine * (long - short),
        sine**2 * long + cosine**2 * short,
    )
    inertia = (body.alpha - 1, body.beta - 1, body.gamma)
    c = getattr(body, "c", None)
    return Stone(inertia, radii, c, mu, sigma, pivot, rolling)


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def times(k, a):
    return k * a[0], k * a[1], k * a[2]


def root(x):
    return x**0.5


def contact_point(stone, u, du):
    """Return the lowest point of the surface and its rate in the body frame."""
    bxx, bxy, byy = stone.radii
    ux, uy, uz = u
    dx, dy, dz = du
    if stone.c is None:
        # The paraboloid z = 1 - (x, y).B^-1 (x, y) / 2, whose normal is along u.
        p = ux / uz
        q = uy / uz
        dp = (dx - p * dz) / uz
        dq = (dy - q * dz) / uz
        x = bxx * p + bxy * q
        y = bxy * p + byy * q
        rate = bxx * dp + bxy * dq, bxy * dp + byy * dq, -(x * dp + y * dq)
        return (x, y, 1 - (x * p + y * q) / 2), rate
    # The ellipsoid x.E^-1 x = 1 about the point (0, 0, 1 - c); its lowest point is -E u
    # / sqrt(u.E u) from there.
    c = stone.c
    e = c * (bxx * ux + bxy * uy), c * (bxy * ux + byy * uy), c * c * uz
    de = c * (bxx * dx + bxy * dy), c * (bxy * dx + byy * dy), c * c * dz
    length = root(dot(u, e))
    fall = dot(u, de) / length**2
    r = -e[0] / length, -e[1] / length, 1 - c - e[2] / length
    rate = tuple((fall * e[i] - de[i]) / length for i in range(3))
    return r, rate


@dataclass(frozen=True)
class Contact:
    """What Newton and Euler say about the contact point, before the force is known."""

    r: tuple
    du: tuple
    free_turn: tuple  # domega/dt without a contact force
    free: tuple  # K
    inverse_mass: tuple  # W: xx, yy, zz, xy, xz, yz
    inertia: tuple

    def applied(self, f):
        """Return ``W f``."""
        wxx, wyy, wzz, wxy, wxz, wyz = self.inverse_mass
        return (
            wxx * f[0] + wxy * f[1] + wxz * f[2],
            wxy * f[0] + wyy * f[1] + wyz * f[2],
            wxz * f[0] + wyz * f[1] + wzz * f[2],
        )

    def turn(self, f):
        """Return ``domega/dt`` under a contact force."""
        torque = cross(self.r, f)
        return tuple(self.free_turn[i] + torque[i] / self.inertia[i] for i in range(3))


def contact_of(stone, u, omega):
    """Return the `Contact` of a state."""
    du = cross(u, omega)
    r, rate = contact_point(stone, u, du)
    ix, iy, iz = stone.inertia
    spun = cross((ix * omega[0], iy * omega[1], iz * omega[2]), omega)
    free_turn = tuple(
        (spun[i] - stone.sigma * omega[i]) / stone.inertia[i] for i in range(3)
    )
    moving = plus(rate, cross(omega, r))
    free = plus(plus(cross(free_turn, r), cross(omega, moving)), times(-1, u))
    x, y, z = r
    inverse_mass = (
        1 + z * z / iy + y * y / iz,
        1 + z * z / ix + x * x / iz,
        1 + y * y / ix + x * x / iy,
        -x * y / iz,
        -x * z / iy,
        -y * z / ix,
    )
    return Contact(r, du, free_turn, free, inverse_mass, stone.inertia)


def holding_force(contact):
    """Return the force under which the contact point keeps its velocity (rolling)."""
    wxx, wyy, wzz, wxy, wxz, wyz = contact.inverse_mass
    kx, ky, kz = contact.free
    axx = wyy * wzz - wyz * wyz
    axy = wxz * wyz - wxy * wzz
    axz = wxy * wyz - wxz * wyy
    ayy = wxx * wzz - wxz * wxz
    ayz = wxy * wxz - wxx * wyz
    azz = wxx * wyy - wxy * wxy
    det = wxx * axx + wxy * axy + wxz * axz
    return (
        -(axx * kx + axy * ky + axz * kz) / det,
        -(axy * kx + ayy * ky + ayz * kz) / det,
        -(axz * kx + ayz * ky + azz * kz) / det,
    )


def parts(u, force):
    """Return ``F . u`` and the part of ``F`` in the plane."""
    normal = dot(force, u)
    return normal, plus(force, times(-normal, u))


@dataclass(frozen=True)
class Forces:
    """Forces on a foot: a contact, the force, and the torque about the vertical."""

    contact: Contact
    force: tuple
    normal: float
    torque: float
    turn: tuple  # domega/dt
    power: float  # of all couples but the torque


def resistance(stone, u, omega):
    """Return the couple of rolling resistance for a normal force of one."""
    across = plus(omega, times(-dot(u, omega), u))
    size = root(dot(across, across) + SMOOTHING**2)
    return times(-stone.rolling / size, across)


def over(a, inertia):
    """Return ``I^-1 a``."""
    return a[0] / inertia[0], a[1] / inertia[1], a[2] / inertia[2]


def answer(contact, acceleration):
    """Return the force that makes up for an acceleration of the foot."""
    return holding_force(replace(contact, free=acceleration))


def is_bare(stone, lever):
    """Return whether no couple depends on the normal force."""
    return stone.rolling == 0 and isinstance(lever, int | float) and lever == 0


def assembled(stone, contact, u, omega, force, normal, lever):
    """Return `Forces` with all that follows from the force and the torque's lever."""
    turn = contact.turn(force)
    power = -stone.sigma * dot(omega, omega)
    torque = lever * normal
    if not is_bare(stone, lever):
        drag = resistance(stone, u, omega)
        couple = plus(times(torque, u), times(normal, drag))
        turn = plus(turn, over(couple, stone.inertia))
        power += normal * dot(drag, omega)
    return Forces(contact, force, normal, torque, turn, power)


def rolling_forces(stone, u, omega, lever):
    """Return the forces of a body that rolls, with the torque ``lever N``."""
    contact = contact_of(stone, u, omega)
    force = holding_force(contact)
    normal = dot(u, force)
    if not is_bare(stone, lever):
        couple = plus(times(lever, u), resistance(stone, u, omega))
        by_couple = answer(contact, cross(over(couple, stone.inertia), contact.r))
        normal = normal / (1 - dot(u, by_couple))
        force = plus(force, times(normal, by_couple))
    return assembled(stone, contact, u, omega, force, normal, lever)


def holding_torque(stone, u, omega):
    """Return the forces of a body that rolls while the plane keeps ``dn/dt = 0``.

    Two linear equations for the normal force and the torque: the force's part along
    ``u`` is the normal force, and ``u . domega/dt`` vanishes.
    """
    contact = contact_of(stone, u, omega)
    inertia = stone.inertia
    drag = over(resistance(stone, u, omega), inertia)
    pivoting = over(u, inertia)
    by_none = holding_force(contact)
    by_normal = answer(contact, cross(drag, contact.r))
    by_torque = answer(contact, cross(pivoting, contact.r))

    def spun(force):
        return dot(u, over(cross(contact.r, force), inertia))

    a = 1 - dot(u, by_normal)
    b = -dot(u, by_torque)
    c = spun(by_normal) + dot(u, drag)
    d = spun(by_torque) + dot(u, pivoting)
    e = dot(u, by_none)
    f = -dot(u, contact.free_turn) - spun(by_none)
    normal = (e * d - b * f) / (a * d - b * c)
    torque = (a * f - c * e) / (a * d - b * c)
    force = plus(by_none, plus(times(normal, by_normal), times(torque, by_torque)))
    return assembled(stone, contact, u, omega, force, normal, torque / normal)


def forces_on_side(stone, y, side):
    """Return the forces of a body that rolls with the spin on a side, or held."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    if side == HELD:
        return holding_torque(stone, u, omega)
    return rolling_forces(stone, u, omega, -stone.pivot * side)


def sliding_forces(stone, contact, u, omega, s, lever):
    """Return the forces of a foot that slides towards ``s``, its pull, the denominator.

    The torque is ``lever N``; the denominator must be positive.
    """
    leaning = plus(u, times(-stone.mu, s))
    answered = contact.applied(leaning)
    if not is_bare(stone, lever):
        couple = plus(times(lever, u), resistance(stone, u, omega))
        answered = plus(answered, cross(over(couple, stone.inertia), contact.r))
    below = dot(u, answered)
    normal = -dot(u, contact.free) / below
    force = times(normal, leaning)
    forces = assembled(stone, contact, u, omega, force, normal, lever)
    return forces, plus(times(normal, answered), contact.free), below


def sliding_in_place(stone, u, omega, s):
    """Return `sliding_forces` with the torque that keeps ``dn/dt = 0``."""
    contact = contact_of(stone, u, omega)

    def spun(lever):
        forces, _, _ = sliding_forces(stone, contact, u, omega, s, lever)
        return dot(u, forces.turn) / forces.normal

    # Over N, dn/dt is linear in the lever, as 1/N is.
    at_none = spun(0.0)
    lever = at_none / (at_none - spun(1.0))
    return sliding_forces(stone, contact, u, omega, s, lever)


def rolling_rates(stone, y, forces):
    """Return the rates of a state that rolls under forces."""
    if math.isinf(stone.mu) and np.ndim(forces.normal) == 0 and forces.normal <= 0:
        raise ArithmeticError("a plane cannot pull, and then it does not rub")
    power = forces.torque * dot(y[:3], y[3:6])
    return [*forces.contact.du, *forces.turn, 0 * y[0], forces.power, power]


def slip(stone, y, exp):
    """Return `sliding_forces` of a state that slides, and its speed."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    log = y[LOG_SPEED]
    speed = exp(max(log, SLOWEST) if isinstance(log, float) else log)
    lever = 0
    if stone.pivot:
        lever = -stone.pivot * rubbing_of(stone.patch * y[SPIN] / speed)
    contact = contact_of(stone, u, omega)
    slipping = sliding_forces(stone, contact, u, omega, tuple(y[DIRECTION]), lever)
    return *slipping, speed


def sliding_rates(stone, y, exp=math.exp):
    """Return the rates of a state that slides, times the speed, and the speed."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    s = tuple(y[DIRECTION])
    forces, pull, _, speed = slip(stone, y, exp)
    rates = [*times(speed, forces.contact.du), *times(speed, forces.turn)]
    rates += [-stone.mu * forces.normal * speed * speed]
    rates += [forces.power * speed, forces.torque * y[SPIN] * speed]
    rates += [dot(u, forces.turn) * speed]
    across = cross(u, s)
    rates += plus(times(dot(pull, across), across), times(speed, cross(s, omega)))
    rates += [dot(pull, s)]
    return rates, speed


def rates_in_time(stone, y, exp=math.exp):
    """Return the rates of a state that slides."""
    rates, speed = sliding_rates(stone, y, exp)
    return [rate / speed for rate in rates]


def energy(stone, y):
    """Return the energy, which is zero upright at rest."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    r = contact_of(stone, u, omega).r
    drift = cross(r, omega)
    if len(y) == N_SLIDING:
        drift = plus(times(math.exp(y[LOG_SPEED]), tuple(y[DIRECTION])), drift)
    turning = sum(stone.inertia[i] * omega[i] ** 2 for i in range(3))
    return float((turning + dot(drift, drift)) / 2 - dot(r, u) - 1)


def spin(y):
    """Return ``n = u . omega``, as it was integrated in a slide."""
    return y[SPIN] if len(y) >= N_SLIDING else dot(y[:3], y[3:6])


def with_spin(y, n):
    """Return a state that rolls, with another spin."""
    u = np.array(y[:3])
    u /= np.linalg.norm(u)
    omega = y[3:6] + (n - u @ y[3:6]) * u
    return np.array([*u, *omega, *y[6:N_ROLLING]])


def grip(stone, y, side):
    """Return ``N - |F_t|/mu`` of a body that rolls; below zero it slides."""
    normal, along = parts(tuple(y[:3]), forces_on_side(stone, y, side).force)
    return normal - root(dot(along, along)) / stone.mu
