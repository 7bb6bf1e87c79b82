"""Slow and simple oracles from Kondo & Nakanishi (2017), in NumPy and SciPy.

This module does not import `rattlesweep`.  Units M = a = g = 1.  A *body* is a mapping
or an object with ``alpha, beta, gamma, theta, phi, xi`` (xi in radians); the state is
``y = (u, omega)``, six numbers in the body-fixed principal axes, ``z`` pointing down at
rest.  Equations are numbered as in the paper.
"""

import math
from collections.abc import Mapping
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.integrate import DOP853, solve_ivp
from scipy.optimize import brentq, minimize_scalar

GH = {
    "alpha": 13.04,
    "beta": 1.522,
    "gamma": 12.28,
    "theta": 0.6429,
    "phi": 0.0360,
    "xi": -math.radians(1.72),
}

PARAMETERS = tuple(GH)
EPS = np.array([[0.0, 1.0], [-1.0, 0.0]])  # Eq. 16


def cross(a, b):
    """Return the vector product; NumPy's own takes ten times as long."""
    a0, a1, a2 = a.tolist()
    b0, b1, b2 = b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def matrix_of(v):
    """Return the matrix of ``v x``."""
    x, y, z = v.tolist()
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def get(body, name):
    """Return one parameter of a body, which is a mapping or an object."""
    return float(body[name] if isinstance(body, Mapping) else getattr(body, name))


def rotation(angle):
    """Return R(xi)."""
    c = math.cos(angle)
    s = math.sin(angle)
    return np.array([[c, -s], [s, c]])


@cache
def _matrices(alpha, beta, gamma, theta, phi, xi):
    r = rotation(xi)
    return (
        r @ np.diag([theta, phi]) @ r.T,
        r @ np.diag([1.0 / theta, 1.0 / phi]) @ r.T,
        np.diag([alpha - 1.0, beta - 1.0, gamma]),
    )


def matrices(body):
    """Return R Theta R^-1, R Theta^-1 R^-1 and the inertia I about G.

    The second is made of the principal radii.

    I is in units of M a^2: Eq. 14 solved for I_xx, I_yy, I_zz.
    """
    return _matrices(*(get(body, name) for name in PARAMETERS))


def contact_point(u, body):
    """Return the vector r from G to the contact point C: Eqs. 4 and 8."""
    curvature, radii, _ = matrices(body)
    rp = radii @ u[:2] / u[2]
    return np.array([rp[0], rp[1], 1.0 - 0.5 * (rp @ curvature @ rp)])


def contact_point_dot(u, du, body):
    """Return the dotted (body-frame) derivative of `contact_point` along du."""
    curvature, radii, _ = matrices(body)
    rp = radii @ u[:2] / u[2]
    drp = radii @ (du[:2] / u[2] - u[:2] * du[2] / u[2] ** 2)
    return np.array([drp[0], drp[1], -(rp @ curvature @ drp)])


def rhs(t, y, body):
    """Return the dotted derivatives of (u, omega), real or complex: Eqs. 10 and 11."""
    u = y[:3]
    w = y[3:]
    du = -cross(w, u)
    r = contact_point(u, body)
    dr = contact_point_dot(u, du, body)
    _, _, inert = matrices(body)
    rx = matrix_of(r)
    left = inert - rx @ rx  # the matrix of  dw -> I dw - r x (r x dw)
    right = (
        -cross(w, inert @ w)
        + cross(r, cross(dr, w) + cross(w, cross(r, w)))
        + cross(r, u)
    )
    return np.concatenate([du, np.linalg.solve(left, right)])


def spin(y):
    """Return the spin n = u . omega."""
    return float(y[:3] @ y[3:])


def spin_rate(y, body):
    """Return dn/dt = u . domega (the term du . omega = (u x omega) . omega is zero)."""
    return float(y[:3] @ rhs(0.0, y, body)[3:])


def energy(y, body):
    """Return the energy, with the potential zero at u = (0, 0, -1)."""
    u = y[:3]
    w = y[3:]
    r = contact_point(u, body)
    v = cross(r, w)
    return float(0.5 * (v @ v) + 0.5 * (w @ matrices(body)[2] @ w) + (-(r @ u) - 1.0))


def contact_force(y, body):
    """Return F of Eq. 1, F = dv/dt + u with v = r x omega, in body components."""
    u = y[:3]
    w = y[3:]
    dy = rhs(0.0, y, body)
    r = contact_point(u, body)
    dr = contact_point_dot(u, dy[:3], body)
    v = cross(r, w)
    vdot = cross(dr, w) + cross(r, dy[3:])
    return vdot + cross(w, v) + u


def force_components(y, body):
    """Return (F_par, F_perp) of the paper's footnote on friction."""
    f = contact_force(y, body)
    u = y[:3]
    par = float(f @ u)
    return par, float(np.linalg.norm(f - par * u))


def launch(body, n_i, omega_xy0, psi):
    """Return y(0): Eqs. 68 and 69."""
    return np.array(
        [
            0.0,
            0.0,
            -1.0,
            omega_xy0 * math.cos(psi),
            omega_xy0 * math.sin(psi),
            -float(n_i),
        ]
    )


def h_matrix(body):
    """Return H of Eq. 22."""
    r = rotation(get(body, "xi") + 0.5 * math.pi)
    gam = r @ np.diag([1.0 / get(body, "theta"), 1.0 / get(body, "phi")]) @ r.T
    jm = np.diag([get(body, "alpha") ** -0.5, get(body, "beta") ** -0.5])
    return jm @ (gam - np.eye(2)) @ jm


def modes(body):
    """Return the modes by `eigh`, K_p and K_r by Eqs. 33, 35, psi in (-pi/2, pi/2]."""
    alpha = get(body, "alpha")
    beta = get(body, "beta")
    jp = np.diag([alpha**0.5, beta**0.5])
    jm = np.diag([alpha**-0.5, beta**-0.5])
    h = h_matrix(body)
    h = 0.5 * (h + h.T)
    lam, vec = np.linalg.eigh(h)  # ascending: roll, pitch
    out = {}
    for name, col in (("r", 0), ("p", 1)):
        ket = vec[:, col]
        bracket = (ket @ jm @ EPS @ jp @ h @ ket) / (ket @ ket)
        x, y = jm @ ket  # |omega> = J^-1/2 |tilde omega>
        if x < 0.0 or (x == 0.0 and y < 0.0):
            x = -x
            y = -y
        out["omega_" + name] = math.sqrt(lam[col])
        out["psi_" + name] = math.atan2(y, x)
        out["K_" + name] = float(bracket if name == "p" else -bracket)
    return out


def relevant_psi(body, n_i):
    """Return psi of Eq. 70."""
    return modes(body)["psi_p" if n_i > 0 else "psi_r"]


def advance(body, y0, dt, rtol=1e-12, atol=1e-15):
    """Return the state a short dt after y0, in at least four steps."""
    if dt == 0.0:
        return np.array(y0, dtype=float)
    sol = solve_ivp(
        rhs,
        (0.0, dt),
        y0,
        "DOP853",
        args=(body,),
        rtol=rtol,
        atol=atol,
        max_step=abs(dt) / 4,
    )
    assert sol.success, sol.message
    return sol.y[:, -1]


def _first_bracket(ts, s, sign, rate, value):
    """Return (a, b) around the first zero of a function with samples s at ts, or None.

    Two zeros may lie between two samples that are within ten second differences of
    zero: if the function turns back there, its sign at the extremum decides, a zero of
    the derivative ``rate``.
    """
    near = 10.0 * np.max(np.abs(np.diff(s, 2))) + 1e-15
    for k in range(len(ts) - 1):
        if sign * s[k + 1] <= 0.0:
            return ts[k], ts[k + 1]
        if min(abs(s[k]), abs(s[k + 1])) <= near:
            ra = sign * rate(ts[k])
            rb = sign * rate(ts[k + 1])
            if ra < 0.0 < rb:
                te = brentq(rate, ts[k], ts[k + 1], xtol=1e-15, rtol=1e-14)
                if sign * value(te) <= 0.0:
                    return ts[k], te
    return None


def first_reversal(
    body, n_i, omega_xy0, psi, t_end, rtol=1e-12, atol=1e-15, samples=64
):
    """Return `first_zero` of a launch."""
    return first_zero(
        body, launch(body, n_i, omega_xy0, psi), t_end, rtol, atol, samples
    )


def first_zero(body, y0, t_end, rtol=1e-12, atol=1e-15, samples=64):
    """Return ``(t_r, y(t_r))`` at the spin's first zero, or ``(None, y(t_end))``."""
    sign = math.copysign(1.0, spin(y0))
    solver = DOP853(
        lambda t, y: rhs(t, y, body),
        0.0,
        np.array(y0, dtype=float),
        t_end,
        rtol=rtol,
        atol=atol,
    )
    while solver.status == "running":
        y_old = solver.y.copy()
        message = solver.step()
        assert solver.status != "failed", message
        t_old = solver.t_old
        t_new = solver.t
        dense = solver.dense_output()
        ts = np.linspace(t_old, t_new, samples + 1)
        ys = dense(ts)
        s = np.sum(ys[:3] * ys[3:], axis=0)

        def value(t, dense=dense):
            return spin(dense(t))

        def state(t, t_old=t_old, y_old=y_old):
            return advance(body, y_old, t - t_old, rtol, atol)

        bracket = _first_bracket(
            ts, s, sign, lambda t, d=dense: spin_rate(d(t), body), value
        )
        if bracket is not None:
            a, b = bracket
            exact = spin(state(a)) * sign > 0.0 >= spin(state(b)) * sign
            of = (lambda t, state=state: spin(state(t))) if exact else value
            t_r = b if of(b) == 0.0 else brentq(of, a, b, xtol=1e-15, rtol=1e-15)
            return t_r, state(t_r)
    return None, solver.y


def jacobian_spin(body, n):
    """Return the Jacobian in (u_x, u_y, omega_x, omega_y) at a steady spin.

    It is taken by a complex step.
    """
    y0 = np.array([0.0, 0.0, -1.0, 0.0, 0.0, -float(n)], dtype=complex)
    which = [0, 1, 3, 4]
    h = 1e-40
    jac = np.empty((4, 4))
    for col, index in enumerate(which):
        y = y0.copy()
        y[index] += 1j * h
        jac[:, col] = rhs(0.0, y, body)[which].imag / h
    return jac


def reduced_C_I(y, K_p, K_r):
    """Return the Casimir invariant, Eq. 51."""
    return math.log(y[1]) / K_p + math.log(y[2]) / K_r


def extremes_of_contact(body, y0, t_end, samples=16):
    """Return the largest ratio of the contact forces, and the least normal force.

    Each is sought in the dense solution around its extreme sample, and evaluated in a
    state that is integrated to that time.
    """

    def solve(y, t, **options):
        return solve_ivp(
            rhs, (0.0, t), y, "DOP853", args=(body,), rtol=1e-13, atol=1e-15, **options
        )

    solved = solve(y0, t_end, dense_output=True)
    times = np.unique(
        np.concatenate([np.linspace(*pair, samples) for pair in pairwise(solved.t)])
    )

    def ratio(y):
        normal, tangential = force_components(y, body)
        return -tangential / normal

    def normal(y):
        return force_components(y, body)[0]

    found = []
    for function in (ratio, normal):
        values = np.array([function(y) for y in solved.sol(times).T])
        k = int(np.clip(values.argmin(), 1, len(times) - 2))
        best = minimize_scalar(
            lambda t, function=function: function(solved.sol(t)),
            bounds=(times[k - 1], times[k + 1]),
            method="bounded",
            options={"xatol": 1e-10},
        )
        step = int(np.searchsorted(solved.t, best.x)) - 1
        begin = solved.t[step]
        state = solve(solved.y[:, step], best.x - begin).y[:, -1]
        found.append(min(values[[0, -1]].min(), function(state)))
    return -found[0], found[1]
