"""A slow oracle for all five Lyapunov exponents, in NumPy and SciPy.

This module does not import `rattlesweep`.  It solves the equations of Borisov and
Mamaev (2003) for the angular momentum ``M`` about the contact point and the vertical
``u``, in the units and axes of Kondo and Nakanishi (M = a = g = 1, z down at rest):

    M' = M x omega + r' x (omega x r) + r x u,    u' = u x omega,    M = A omega,

with ``A = I + r^2 - r r^T`` and the contact point ``r(u)`` of a paraboloid.  The state
has six components and the constraint ``|u| = 1``, so a tangent has five.

What the finite-time exponents depend on
----------------------------------------
Let ``Phi`` take tangents at the launch to tangents at ``t_end``, in the co-ordinates
``(p, q, omega)`` with ``p = u_x/u_z`` and ``q = u_y/u_z``.  The exponents are
``log(R_ii) / t_end`` where ``Phi W = Q R``, with ``Q`` orthonormal at the end and ``R``
triangular.  They depend on the frame ``W`` and on the inner product at the end, and on
nothing in between: orthogonalising on the way, in whatever inner product, multiplies
``R`` by triangular matrices.

By default the inner product is the energy norm ``B_ij s_i s_j + alpha a^2 + beta b^2 +
gamma c^2`` of a tangent ``(s, a, b, c)``, with ``B = R(xi) Theta^-1 R^-1(xi)``, and
``W`` has the directions p, q, omega_x, omega_y, omega_z made orthonormal in this order.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

RTOL = 1e-11
ATOL = 1e-13
# Long enough that restarts cost little, short enough that no column is lost: the rates
# of the paper's bodies stay below 1.
INTERVAL = 5.0
UNIT = np.eye(3)


class Spectrum(NamedTuple):
    """Exponents and mean divergence in ``sqrt(g/a)``, and the state at the end."""

    exponents: np.ndarray
    divergence: float
    omega: np.ndarray
    u: np.ndarray


class Body(NamedTuple):
    """Moments of inertia about the centre of mass, and ``B``."""

    inertia: np.ndarray
    radii: np.ndarray


def body_of(alpha, beta, gamma, theta, phi, xi):
    """Return the matrices of a body (Eqs. 6 and 14 of Kondo and Nakanishi)."""
    cosine = np.cos(xi)
    sine = np.sin(xi)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    radii = turn @ np.diag([1.0 / theta, 1.0 / phi]) @ turn.T
    return Body(np.diag([alpha - 1.0, beta - 1.0, gamma]), radii)


def cross_matrix(v):
    """Return the matrix of ``v x``."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def contact(u, radii):
    """Return the contact point ``r(u)`` and its derivative, a symmetric matrix."""
    slope = u[:2] / u[2]
    point = radii @ slope
    along = slope @ point
    derivative = np.empty((3, 3))
    derivative[:2, :2] = radii
    derivative[:2, 2] = -point
    derivative[2, :2] = -point
    derivative[2, 2] = along
    return np.array([*point, 1.0 - 0.5 * along]), derivative / u[2]


def derivative_of_rate(u, v, rate, radii):
    """Return the derivative over ``u`` of ``rate = dr/du v``, with ``v`` constant."""
    slope = u[:2] / u[2]
    point = radii @ slope
    square = u[2] * u[2]
    lowest = (2.0 * v[2] * point - radii @ v[:2]) / square
    result = np.empty((3, 3))
    result[:2, :2] = -v[2] / square * radii
    result[:2, 2] = v[2] / square * point - rate[:2] / u[2]
    result[2, :2] = lowest
    result[2, 2] = -rate[2] / u[2] - lowest @ slope
    return result


def inertia_at(r, body):
    """Return ``A``, the inertia about the contact point."""
    return body.inertia + (r @ r) * UNIT - np.multiply.outer(r, r)


def momentum_by_contact(r, omega):
    """Return the derivative of ``A omega`` over ``r``, with ``omega`` constant."""
    along = np.multiply.outer(omega, r)
    return 2.0 * along - along.T - (r @ omega) * UNIT


def slopes_of_omega(u, omega, body):
    """Return the derivatives of ``omega(M, u)`` over ``M`` and over ``u``."""
    r, by_u = contact(u, body.radii)
    by_momentum = np.linalg.inv(inertia_at(r, body))
    return by_momentum, -by_momentum @ momentum_by_contact(r, omega) @ by_u


def rates(state, body):
    """Return the time derivative of ``(M, u)``."""
    momentum = state[:3]
    u = state[3:]
    r, by_u = contact(u, body.radii)
    omega = np.linalg.solve(inertia_at(r, body), momentum)
    u_rate = np.cross(u, omega)
    r_rate = by_u @ u_rate
    gyroscopic = np.cross(momentum, omega)
    rolling = np.cross(r_rate, np.cross(omega, r))
    momentum_rate = gyroscopic + rolling + np.cross(r, u)
    return np.concatenate([momentum_rate, u_rate])


def rates_and_jacobian(state, body):
    """Return :func:`rates` and their derivative over the six components."""
    momentum = state[:3]
    u = state[3:]
    r, by_u = contact(u, body.radii)
    by_momentum = np.linalg.inv(inertia_at(r, body))
    omega = by_momentum @ momentum
    omega_by_u = -by_momentum @ momentum_by_contact(r, omega) @ by_u
    cross_u = cross_matrix(u)
    cross_r = cross_matrix(r)
    cross_omega = cross_matrix(omega)
    cross_momentum = cross_matrix(momentum)
    u_rate = cross_u @ omega
    r_rate = by_u @ u_rate
    velocity = cross_omega @ r
    cross_r_rate = cross_matrix(r_rate)
    cross_velocity = cross_matrix(velocity)

    # How M' depends on omega and, at constant omega, on u.
    through_omega = (
        cross_momentum - cross_r_rate @ cross_r - cross_velocity @ by_u @ cross_u
    )
    turning = derivative_of_rate(u, u_rate, r_rate, body.radii)
    through_u = (
        cross_velocity @ (by_u @ cross_omega - turning)
        + (cross_r_rate @ cross_omega - cross_u) @ by_u
        + cross_r
    )
    jacobian = np.empty((6, 6))
    jacobian[:3, :3] = through_omega @ by_momentum - cross_omega
    jacobian[:3, 3:] = through_omega @ omega_by_u + through_u
    jacobian[3:, :3] = cross_u @ by_momentum
    jacobian[3:, 3:] = cross_u @ omega_by_u - cross_omega
    momentum_rate = cross_momentum @ omega + cross_r_rate @ velocity + cross_r @ u
    return np.concatenate([momentum_rate, u_rate]), jacobian


def energy_norm(alpha, beta, gamma, theta, phi, xi):
    """Return the matrix of the default inner product."""
    matrix = np.zeros((5, 5))
    matrix[:2, :2] = body_of(alpha, beta, gamma, theta, phi, xi).radii
    matrix[2, 2] = alpha
    matrix[3, 3] = beta
    matrix[4, 4] = gamma
    return matrix


def to_momentum(tangents, u, omega, body):
    """Return tangents ``(p, q, omega)`` as tangents ``(M, u)``, in columns."""
    r, by_u = contact(u, body.radii)
    slope = u[:2] / u[2]
    u_z = -(u[2] ** 3) * (slope @ tangents[:2])
    u_tangents = np.vstack([u[2] * tangents[:2] + np.outer(slope, u_z), u_z])
    shift = momentum_by_contact(r, omega) @ by_u @ u_tangents
    momentum = inertia_at(r, body) @ tangents[2:] + shift
    return np.vstack([momentum, u_tangents])


def to_slope(tangents, u, omega, body):
    """Return tangents ``(M, u)`` as tangents ``(p, q, omega)``, in columns."""
    slope = u[:2] / u[2]
    slopes = (tangents[3:5] - np.outer(slope, tangents[5])) / u[2]
    by_momentum, by_u = slopes_of_omega(u, omega, body)
    return np.vstack([slopes, by_momentum @ tangents[:3] + by_u @ tangents[3:]])


def on_sphere(tangents, state):
    """Return tangents without their part along ``u``, which is rounding.

    That part neither grows nor decays, so it would replace the columns that decay.
    """
    u = state[3:]
    parts = tangents.copy()
    parts[3:] -= np.outer(u, u @ tangents[3:]) / (u @ u)
    return parts


def log_volume(state, body):
    """Return the logarithm of a volume of ``(M, u)`` over that of ``(p, q, omega)``."""
    u = state[3:]
    r, _ = contact(u, body.radii)
    return np.log(np.linalg.det(inertia_at(r, body)) * abs(u[2]) ** 3)


def spectrum(body_parameters, omega, u, t_end, *, inner_product=None, frame=None):
    """Return the finite-time exponents of a launch, in the order of the QR.

    Parameters
    ----------
    body_parameters : sequence of float
        ``alpha, beta, gamma, theta, phi, xi``.
    omega, u : array_like
        The launch; ``u`` is normalised.
    inner_product : array_like, optional
        Symmetric matrix, (5, 5), for tangents ``(p, q, omega)``.
    frame : array_like, optional
        The five initial tangents in columns.  Unless they are orthonormal, the sum of
        the exponents is not the mean divergence.
    """
    body = body_of(*body_parameters)
    if inner_product is None:
        inner_product = energy_norm(*body_parameters)
    root = np.linalg.cholesky(np.asarray(inner_product, float)).T
    if frame is None:
        frame = np.linalg.inv(root)

    u = np.array(u, float) / np.linalg.norm(u)
    omega = np.array(omega, float)
    r, _ = contact(u, body.radii)
    state = np.concatenate([inertia_at(r, body) @ omega, u])
    tangents = to_momentum(np.asarray(frame, float), u, omega, body)
    volume_at_start = log_volume(state, body)

    def derivative(_, y):
        rate, jacobian = rates_and_jacobian(y[:6], body)
        return np.concatenate(
            [rate, (jacobian @ y[6:36].reshape(6, 5)).ravel(), [np.trace(jacobian)]]
        )

    logs = np.zeros(5)
    log_growth = 0.0
    pieces = max(1, int(np.ceil(t_end / INTERVAL)))
    first_step = None
    for _ in range(pieces):
        solution = solve_ivp(
            derivative,
            (0.0, t_end / pieces),
            np.concatenate([state, tangents.ravel(), [0.0]]),
            "DOP853",
            rtol=RTOL,
            atol=ATOL,
            first_step=first_step,
        )
        assert solution.success, solution.message
        # The last step is cut off at the end of the piece.
        if solution.t.size > 2:
            first_step = solution.t[-2] - solution.t[-3]
        final = solution.y[:, -1]
        state = final[:6]
        log_growth += final[36]
        tangents, triangle = np.linalg.qr(on_sphere(final[6:36].reshape(6, 5), state))
        logs += np.log(np.abs(np.diag(triangle)))

    u = state[3:]
    r, _ = contact(u, body.radii)
    omega = np.linalg.solve(inertia_at(r, body), state[:3])
    last = np.linalg.qr(root @ to_slope(tangents, u, omega, body), mode="r")
    logs += np.log(np.abs(np.diag(last)))
    log_growth -= log_volume(state, body) - volume_at_start
    return Spectrum(logs / t_end, log_growth / t_end, omega, u)
