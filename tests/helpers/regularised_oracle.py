"""Sliding by a regularised law, in the frame of the plane.

This module shares no code with `rattlesweep` nor with `contact_mechanics`.  A body is a
rotation matrix from the body to the plane, the position and the velocity of its centre
of mass, and the angular momentum about it, all in the frame of the plane with z up.
The friction is ``-mu N v / sqrt(v^2 + eps^2)`` with the velocity ``v`` of the body's
material at the contact point, so that the body never quite rolls.  M = a = g = 1.
"""

import numpy as np
from scipy.integrate import solve_ivp

UP = np.array([0.0, 0.0, 1.0])


def turned(angle):
    """Return the rotation about the body's z axis, which curvatures are turned by."""
    c = np.cos(angle)
    s = np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def quadric(body):
    """Return the matrices of curvatures ``(x, y) -> z`` and of the ellipsoid."""
    turn = turned(body.xi)
    curvatures = turn @ np.diag([body.theta, body.phi, 0.0]) @ turn.T
    if getattr(body, "c", None) is None:
        return curvatures, None
    axes = [body.c / body.theta, body.c / body.phi, body.c**2]
    return curvatures, turn @ np.diag(axes) @ turn.T


def lowest(body, up):
    """Return the contact point in the body frame, where the outward normal is -up."""
    curvatures, ellipsoid = quadric(body)
    if ellipsoid is None:
        # On the graph z = 1 - x.C x / 2 the normal is along (C x, 1).
        flat = np.linalg.solve(curvatures[:2, :2], up[:2] / up[2])
        return np.array([*flat, 1 - 0.5 * flat @ curvatures[:2, :2] @ flat])
    image = ellipsoid @ up
    return np.array([0, 0, 1 - body.c]) - image / np.sqrt(up @ image)


def contact_speed(body, up, rate, step=1e-30):
    """Return the rate of `lowest` in the body frame, by a complex step."""
    return lowest(body, up + 1j * step * rate).imag / step


def pack(turn, place, velocity, momentum):
    return np.concatenate([turn.ravel(), place, velocity, momentum])


def unpack(y):
    return y[:9].reshape(3, 3), y[9:12], y[12:15], y[15:18]


def start(body, u, omega):
    """Return the state of a body that rolls, from components in the body frame."""
    # Rows are the plane's axes seen from the body.
    first = np.cross([0.0, 1.0, 0.0], u)
    first /= np.linalg.norm(first)
    turn = np.array([first, np.cross(u, first), u])
    r = turn @ lowest(body, np.asarray(u, float))
    inertia = np.diag([body.alpha - 1, body.beta - 1, body.gamma])
    momentum = turn @ inertia @ omega
    velocity = np.cross(r, turn @ omega)
    return pack(turn, np.array([0.0, 0.0, -r[2]]), velocity, momentum)


def rates(body, y, mu, eps, sigma):
    """Return the rates and the normal force."""
    turn, _, velocity, momentum = unpack(y)
    inverse = (
        turn
        @ np.diag([1 / (body.alpha - 1), 1 / (body.beta - 1), 1 / body.gamma])
        @ turn.T
    )
    omega = inverse @ momentum
    spinning = np.array(
        [
            [0.0, -omega[2], omega[1]],
            [omega[2], 0.0, -omega[0]],
            [-omega[1], omega[0], 0.0],
        ]
    )
    up = turn.T @ UP
    r = turn @ lowest(body, up)
    # The plane's normal turns in the body with minus omega.
    shift = turn @ contact_speed(body, up, -np.cross(turn.T @ omega, up))
    slip = velocity + np.cross(omega, r)
    slip[2] = 0.0
    # The acceleration of the material at the contact point is linear in the force: from
    # two forces one finds the normal force with which it has no vertical part.
    force_of_one = UP - mu * slip / np.sqrt(slip @ slip + eps * eps)

    def pull(size):
        force = size * force_of_one
        couple = np.cross(r, force) - sigma * omega
        turning = inverse @ (couple - np.cross(omega, momentum))
        return (
            force
            - UP
            + np.cross(turning, r)
            + np.cross(omega, shift + np.cross(omega, r))
        ), couple

    at_none = pull(0.0)[0][2]
    at_one = pull(1.0)[0][2]
    normal = at_none / (at_none - at_one)
    force = normal * force_of_one
    couple = pull(normal)[1]
    return pack(spinning @ turn, velocity, force - UP, couple), normal


def reversal(body, u, omega, t_end, mu, eps, sigma=0.0, tol=1e-9):
    """Return the time of the first reversal, or None."""

    def equations(t, y):
        return rates(body, y, mu, eps, sigma)[0]

    def spin(t, y):
        turn, _, _, momentum = unpack(y)
        inertia = [body.alpha - 1, body.beta - 1, body.gamma]
        return ((turn.T @ momentum) / inertia) @ (turn.T @ UP)

    spin.terminal = True
    # The rates do not depend on the place, and SciPy widens its differences for it.
    with np.errstate(over="ignore"):
        run = solve_ivp(
            equations,
            (0, t_end),
            start(body, u, omega),
            "Radau",
            rtol=tol,
            atol=1e-2 * tol,
            events=spin,
        )
    return float(run.t_events[0][0]) if run.t_events[0].size else None
