"""Laws to which rubbing is a limit: regularised torque, the whole law of the patch.

This module does not import `rattlesweep`; the mechanics are `contact_mechanics`.
"""

import math
from dataclasses import dataclass

import numpy as np
from contact_mechanics import (
    contact_of,
    cross,
    dot,
    plus,
    rolling_forces,
    rolling_rates,
    sliding_forces,
    spin,
    stone_of,
    times,
)
from hertz_patch import sliding_share, turning_share
from scipy.integrate import solve_ivp


def zeros_of_regularised(body, u, omega, t_end, pivot, eps, rtol=1e-11):
    """Return the zeros of a spin under ``-l N n / sqrt(n^2 + eps^2)``, and the end.

    The body rolls; nothing is held.
    """
    stone = stone_of(body, pivot=pivot)

    def rates(t, y):
        y = y.tolist()
        n = dot(y[:3], y[3:6])
        lever = -pivot * n / math.sqrt(n * n + eps * eps)
        forces = rolling_forces(stone, tuple(y[:3]), tuple(y[3:6]), lever)
        return rolling_rates(stone, y, forces)

    def zero(t, y):
        return spin(y)

    start = np.array([*u, *omega, 0.0, 0.0, 0.0])
    followed = solve_ivp(
        rates, (0, t_end), start, "DOP853", rtol=rtol, atol=1e-3 * rtol, events=zero
    )
    assert followed.success, followed.message
    return followed.t_events[0], followed.y[:, -1]


@dataclass(frozen=True)
class Crept:
    """A run under the whole law of the patch."""

    t_r: float | None
    fastest: float  # speed of the foot
    energy_error: float


def patch_rates(stone, smoothest=0.0, has_torque=True):
    """Return the rates of ``(u, omega, v, work)`` under the whole law of the patch.

    Coulomb's law holds at each point of the circle.  Force and torque are those of the
    closed form; the foot creeps at the velocity ``v`` and nothing sticks.  A spin ``n``
    counts as the root of its square and that of `smoothest`; a spin that the patch
    holds is then a multiple of it.
    """
    mu = stone.mu

    def rates(t, y):
        u = tuple(y[:3].tolist())
        omega = tuple(y[3:6].tolist())
        v = tuple(y[6:9].tolist())
        contact = contact_of(stone, u, omega)
        n = dot(u, omega)
        size = math.hypot(n, smoothest)
        speed = math.sqrt(dot(v, v))
        reach = stone.patch * size
        if speed <= reach:
            x = speed / reach
            per_speed = 3 * math.pi / 32 * (4 - x * x) / reach  # F / (mu N v)
            turning = turning_share(x)
        elif n == 0:
            per_speed = 1 / speed
            turning = 0.0
        else:
            per_speed = sliding_share(speed / reach) / speed
            turning = turning_share(speed / reach)
        # The sliding force is mu F_hat towards -v; s = F_hat v/|v| is shorter than one.
        s = times(per_speed, v)
        lever = 0.0
        if has_torque and n != 0:
            lever = -mu * stone.patch * turning * n / size
        forces, pull, _ = sliding_forces(stone, contact, u, omega, s, lever)
        work = forces.torque * n - mu * forces.normal * dot(s, v)
        turned = plus(pull, times(-1, cross(omega, v)))
        return [*contact.du, *forces.turn, *turned, work]

    return rates


def growth_under_patch(body, n_i, pivot, mu, has_torque=True):
    """Return the growth rates of roll and pitch about an upright spin.

    They are the real parts of the eigenvalues of what is horizontal, from central
    differences of :func:`patch_rates`, with the spin as it is.
    """
    rates = patch_rates(stone_of(body, mu, pivot=pivot), has_torque=has_torque)
    upright = np.array([0.0, 0.0, -1.0, 0.0, 0.0, -n_i, 0.0, 0.0, 0.0, 0.0])
    horizontal = [0, 1, 3, 4, 6, 7]
    columns = []
    for place in horizontal:
        step = np.zeros(10)
        step[place] = 1e-6
        change = np.subtract(rates(0, upright + step), rates(0, upright - step))
        columns.append(change[horizontal] / 2e-6)
    values = np.linalg.eigvals(np.transpose(columns))
    swings = values[values.imag > 0]
    roll, pitch = swings[np.argsort(swings.imag)].real
    return float(roll), float(pitch)


def crept(body, u, omega, t_end, mu, patch, rtol=1e-9, method="Radau"):
    """Return what becomes of a launch under the law of Hertz's patch, radius ``patch``.

    It ends at the first zero of the spin.
    """
    stone = stone_of(body, mu, pivot=3 * math.pi / 16 * mu * patch)
    rates = patch_rates(stone)

    def total(y):
        u = tuple(y[:3])
        omega = tuple(y[3:6])
        r = contact_of(stone, u, omega).r
        drift = plus(tuple(y[6:9]), cross(r, omega))
        turning = sum(stone.inertia[i] * omega[i] ** 2 for i in range(3))
        return (turning + dot(drift, drift)) / 2 - dot(r, u) - 1

    def zero(t, y):
        return dot(y[:3], y[3:6])

    zero.terminal = True
    start = np.array([*u, *omega, 0.0, 0.0, 0.0, 0.0])
    # The rates do not depend on the work, and SciPy widens its differences for it.
    with np.errstate(over="ignore"):
        followed = solve_ivp(
            rates, (0, t_end), start, method, rtol=rtol, atol=1e-3 * rtol, events=zero
        )
    assert followed.success, followed.message
    speeds = np.linalg.norm(followed.y[6:9], axis=0)
    t_r = float(followed.t_events[0][0]) if followed.t_events[0].size else None
    end = followed.y[:, -1]
    error = float((total(end) - end[9]) / total(start) - 1)
    return Crept(t_r, float(speeds.max()), error)
