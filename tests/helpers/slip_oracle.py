"""Viscous slip of the contact from the laws of mechanics, in NumPy and SciPy.

This module does not import `rattlesweep`.  The state has nine variables, the vertical
``u``, the angular velocity and the velocity of the centre of mass, all along the body's
axes, and the work of the friction.  The unknowns are the two accelerations and the
normal force: Newton's law, Euler's law, and that the contact point stays on the plane.
"""

import numpy as np
import oracle
import stone_oracle
from oracle import cross, matrix_of
from scipy.integrate import solve_ivp
from scipy.linalg import eig


def contact_velocity(y, body):
    """Return the velocity of the contact point."""
    r, _ = stone_oracle.contact(y[:3], np.zeros(3), body)
    return y[6:9] + cross(y[3:6], r)


def foot_velocity(y, body):
    """Return the velocity of the place of contact on the plane."""
    u = y[:3]
    _, dr = stone_oracle.contact(u, cross(u, y[3:6]), body)
    return contact_velocity(y, body) + dr


def rhs(t, y, body, k):
    """Return the rates of ``u, omega, v`` and the work."""
    u = y[:3]
    w = y[3:6]
    v = y[6:9]
    du = cross(u, w)
    r, dr = stone_oracle.contact(u, du, body)
    inertia = oracle.matrices(body)[2]
    slip = v + cross(w, r)
    slip = slip - (u @ slip) * u
    left = np.zeros((7, 7))
    right = np.zeros(7)
    # dv/dt + omega x v = F - u and I domega/dt + omega x I omega = r x F, with F = N u
    # - k slip
    left[:3, :3] = np.eye(3)
    left[:3, 6] = -u
    right[:3] = -k * slip - u - cross(w, v)
    left[3:6, 3:6] = inertia
    left[3:6, 6] = -cross(r, u)
    right[3:6] = -k * cross(r, slip) - cross(w, inertia @ w)
    # u . d/dt (v + omega x r) = 0 in space
    left[6, :3] = u
    left[6, 3:6] = -(u @ matrix_of(r))
    right[6] = -(u @ (cross(w, v) + cross(w, dr + cross(w, r))))
    rates = np.linalg.solve(left, right)
    return np.concatenate([du, rates[3:6], rates[:3], [-k * (slip @ slip)]])


def launch(body, n_i, push, psi):
    """Return the state of a launch without slip."""
    place = oracle.launch(body, n_i, push, psi)
    r, _ = stone_oracle.contact(place[:3], np.zeros(3), body)
    return np.concatenate([place, cross(r, place[3:6]), [0.0]])


def follow(body, k, y0, t_end, tol=1e-10):
    """Return SciPy's solution from a state, with its zeros of the spin."""

    def spin(t, y, body, k):
        return y[:3] @ y[3:6]

    return solve_ivp(
        rhs,
        (0, t_end),
        y0,
        "DOP853",
        events=spin,
        dense_output=True,
        rtol=tol,
        atol=1e-3 * tol,
        args=(body, k),
    )


def growth_rates(body, k, n, step=1e-6):
    """Return the growth rates of roll and pitch about an upright spin, ascending.

    They are real parts of eigenvalues of the linear equations, by differences.
    """
    upright = launch(body, n, 0.0, 0.0)[:9]
    columns = []
    for direction in np.eye(9):
        ahead = rhs(0.0, np.append(upright + step * direction, 0.0), body, k)
        behind = rhs(0.0, np.append(upright - step * direction, 0.0), body, k)
        columns.append((ahead - behind)[:9] / (2 * step))
    values, _ = eig(np.transpose(columns))
    swings = values[values.imag > 0.2]
    return np.sort(swings[np.argsort(abs(swings.real))][:2].real)
