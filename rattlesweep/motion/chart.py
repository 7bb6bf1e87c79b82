"""Charts: how a state places a body, and what of it steps and searches observe.

In the slopes quantities that are small near the steady spin are small numbers; the
other chart is valid in any position.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from rattlesweep.physics import averaging, full, vectors
from rattlesweep.physics.full import TINY, scalar
from rattlesweep.physics.surface import Formula

# The error of the spin is scaled as if the oscillation held at least this fraction of
# the spin's energy.
SPIN_KNOWN = 1e-14
# The square of an oscillation that counts as none.  Steps let a smaller one decay no
# further, and so keep squares, which every step has, from becoming subnormal numbers:
# processors take many times as long for these.  It changes no other result.
STILL = 1e-100


@dataclass(frozen=True, eq=False)
class Chart:
    """How a state places a body: formulas of the state ``y`` and the ``constants``."""

    name: str
    place: tuple[str, ...]  # the components: the position and omega
    # locate(contact, y, shape): rates of the position, u, omega, r, w, and what
    # `accelerate` needs
    locate: Formula
    # accelerate(y, located, inertia, torque, weight): domega/dt, and the inverse used
    accelerate: Formula
    turned: Formula  # turned(y, u, rate): y with omega changed by rate u
    spin: Formula  # spin(y)
    spin_rate: Formula  # spin_rate(y, dy)
    amplitude: Formula  # as in `model.Model`
    error: Formula  # as in `model.Model`, where nothing acts
    error_of_actions: Formula  # as in `model.Model`
    mode_energies: Formula  # as in `model.Model`
    # Slope beyond which the state says too little about the contact for a slide to
    # begin, where another chart takes over.
    steepest: float = 0.0


# Slopes and angular velocity


@scalar
def locate_on(contact, y, shape):
    """Return where a body with a slope is: see :class:`Chart`."""
    p, q, a, b, c = y[:5]
    dp, dq, m = full.slope_rate(y)
    touch = contact(y, (dp, dq, m), shape)
    _, w, uz = touch
    u = p * uz, q * uz, uz
    return (dp, dq), u, (a, b, c), full.contact_point(y, touch), w, touch


@scalar
def accelerate_on(y, located, inertia, torque, weight):
    """Return ``domega/dt`` of a body with a slope."""
    return full.acceleration(y, inertia, torque, located[5], weight)


@scalar
def turned_on(y, u, rate):
    """Return a state of a slope with ``omega`` changed by ``rate u``."""
    p, q, a, b, c = y[:5]
    x, y_, z = u
    return (p, q, a + rate * x, b + rate * y_, c + rate * z) + y[5:]  # noqa: RUF005


@scalar
def squared_amplitude(y, probe):
    """Return the square of the amplitude of the mode that a probe tells."""
    p, q, a, b = y[:4]
    p0, q0, a0, b0, p1, q1, a1, b1 = probe
    real = p0 * p + q0 * q + a0 * a + b0 * b
    imag = p1 * p + q1 * q + a1 * a + b1 * b
    return real * real + imag * imag


@scalar
def error_of_motion(e, y, constants):
    """Return the squares of an error and of the oscillation, without actions."""
    ec = e[4]
    size = full.oscillation(y, constants) + STILL
    return full.oscillation(e, constants) + constants[2] * ec * ec, size


@scalar
def weighted_error(e, y, constants):
    """Return the squares of an error and of the oscillation.

    Actions change the spin in every step; rounding errors of the spin must not reject a
    step.
    """
    c = y[4]
    ec = e[4]
    iz = constants[2]
    size = full.oscillation(y, constants) + STILL
    weight = min(1.0, size / (SPIN_KNOWN * iz * c * c + TINY))
    return full.oscillation(e, constants) + weight * iz * ec * ec, size


@scalar
def energies_on(y, constants):
    """Return the energies of pitch and roll of a body with a slope."""
    p, q, a, b, c = y[:5]
    uz = -1.0 / sqrt(1.0 + p * p + q * q)
    n = uz * (p * a + q * b + c)
    rate = a - n * p * uz, b - n * q * uz
    return averaging.energies_of_modes((p, q), rate, constants)


SLOPES = Chart(
    "slopes",
    ("p", "q", "a", "b", "c"),
    locate=locate_on,
    accelerate=accelerate_on,
    turned=turned_on,
    spin=full.spin,
    spin_rate=full.spin_rate,
    amplitude=squared_amplitude,
    error=error_of_motion,
    error_of_actions=weighted_error,
    mode_energies=energies_on,
    steepest=100.0,
)


# A vector along the vertical and angular velocity


@scalar
def locate_under(contact, y, shape):
    """Return where a body in any position is: see :class:`Chart`."""
    u, omega = vectors.position(y)
    r, rho = contact(u, shape)
    w = vectors.moving(u, omega, r, rho, shape)
    return vectors.vertical_rate(y), u, omega, r, w, 0.0


@scalar
def accelerate_under(y, located, inertia, torque, weight):
    """Return ``domega/dt`` of a body in any position."""
    _, u, omega, r, w, _ = located
    return vectors.acceleration_at(u, omega, r, w, inertia, torque, weight)


@scalar
def turned_under(y, u, rate):
    """Return a state of any position with ``omega`` changed by ``rate u``."""
    vx, vy, vz, a, b, c = y[:6]
    x, y_, z = u
    turned = a + rate * x, b + rate * y_, c + rate * z
    return (vx, vy, vz) + turned + y[6:]  # noqa: RUF005


@scalar
def amplitude_under(y, probe):
    """Return what :func:`squared_amplitude` does, for any position."""
    # Near the upright position the slopes are -u_x and -u_y.
    vx, vy, _, a, b = y[:5]
    return squared_amplitude((-vx, -vy, a, b), probe)


@scalar
def error_under(e, y, constants):
    """Return what :func:`weighted_error` does, for any position."""
    ex, ey, ez, ea, eb, ec = e[:6]
    vx, vy, _, a, b, c = y[:6]
    error = ex, ey, ea, eb, ec
    step, size = weighted_error(error, (vx, vy, a, b, c), constants)
    return step + ez * ez, size


@scalar
def energies_under(y, constants):
    """Return what :func:`energies_on` does, for any position."""
    u, omega = vectors.position(y)
    n = u[0] * omega[0] + u[1] * omega[1] + u[2] * omega[2]
    slope = u[0] / u[2], u[1] / u[2]
    rate = omega[0] - n * u[0], omega[1] - n * u[1]
    return averaging.energies_of_modes(slope, rate, constants)


ANYWHERE = Chart(
    "vectors",
    ("v_x", "v_y", "v_z", "a", "b", "c"),
    locate=locate_under,
    accelerate=accelerate_under,
    turned=turned_under,
    spin=vectors.spin,
    spin_rate=vectors.spin_rate,
    amplitude=amplitude_under,
    error=error_under,
    error_of_actions=error_under,
    mode_energies=energies_under,
)
