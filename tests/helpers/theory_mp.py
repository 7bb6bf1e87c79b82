"""Theory of Kondo & Nakanishi (2017) in mpmath, in the paper's own form.

Inputs are doubles (or mpf) and count as exact.  It computes with 120 digits, because
n_0 - |n_i| can be tiny, and rounds to 50.  Units M = a = g = 1.  This module does not
import `rattlesweep`.
"""

from mpmath import mp

WORK = 120
OUT = 50


def _rounded(value):
    if value is None:
        return None
    with mp.workdps(OUT):
        return +value


def _rotation(angle):
    c = mp.cos(angle)
    s = mp.sin(angle)
    return mp.matrix([[c, -s], [s, c]])


def _exact(*values):
    return [mp.mpf(v) for v in values]


def n_c1_squared(alpha, beta, gamma, theta, phi):
    """Return n_c1 squared (Eq. 73), which may be negative; None for a zero divisor."""
    with mp.workdps(WORK):
        a, b, c, th, ph = _exact(alpha, beta, gamma, theta, phi)
        den = 2 - (th + ph) - (a + b - c) * (th + ph - 2 * th * ph)
        return None if den == 0 else -(1 - th) * (1 - ph) / den


def reference(alpha, beta, gamma, theta, phi, xi, n_i, omega_xy0):
    """Return all quantities for a launch along the relevant mode, as mpf or None.

    ``t_rgh`` follows the paper's formula and so is negative where K < 0; psi is in
    (-pi/2, pi/2].
    """
    with mp.workdps(WORK):
        a, b, c, th, ph, x, n, w = _exact(
            alpha, beta, gamma, theta, phi, xi, n_i, omega_xy0
        )
        eps = mp.matrix([[0, 1], [-1, 0]])
        jp = mp.diag([mp.sqrt(a), mp.sqrt(b)])
        jm = mp.diag([1 / mp.sqrt(a), 1 / mp.sqrt(b)])
        rot = _rotation(x + mp.pi / 2)
        gam = rot * mp.diag([1 / th, 1 / ph]) * rot.T  # Gamma, below Eq. 19
        h = jm * (gam - mp.eye(2)) * jm  # Eq. 22
        h = (h + h.T) / 2
        # Eq. 24
        root = mp.sqrt((h[0, 0] - h[1, 1]) ** 2 + 4 * h[0, 1] ** 2)
        om2 = {
            "p": (h[0, 0] + h[1, 1] + root) / 2,
            "r": (h[0, 0] + h[1, 1] - root) / 2,
        }
        _, vectors = mp.eigsy(h)  # ascending eigenvalues
        psi = {}
        k = {}
        for mode, col in (("p", 1), ("r", 0)):
            ket = vectors[:, col]
            rest = mp.norm(h * ket - om2[mode] * ket)
            assert rest < mp.mpf(10) ** (20 - WORK) * mp.norm(h)
            omega = jm * ket  # |omega> = J^-1/2 |tilde omega>
            if omega[0] < 0 or (omega[0] == 0 and omega[1] < 0):
                omega = -omega
            psi[mode] = mp.atan2(omega[1], omega[0])
            # Eqs. 33 and 35
            bracket = (ket.T * jm * eps * jp * h * ket)[0] / (ket.T * ket)[0]
            k[mode] = bracket if mode == "p" else -bracket
        relevant = "p" if n > 0 else "r"
        wx = w * mp.cos(psi[relevant])
        wy = w * mp.sin(psi[relevant])
        n_0 = mp.sqrt((a * wx**2 + b * wy**2 + c * n**2) / c)  # Eq. 72, omega_z = -n_i
        # Eqs. 56 and 58
        if k[relevant] == 0 or n_0 == abs(n):
            t_rgh = mp.inf
        else:
            t_rgh = mp.log((n_0 + abs(n)) / (n_0 - abs(n))) / (n_0 * k[relevant])
        square = n_c1_squared(alpha, beta, gamma, theta, phi)
        out = {
            "omega_p": mp.sqrt(om2["p"]),
            "omega_r": mp.sqrt(om2["r"]),
            "psi_p": psi["p"],
            "psi_r": psi["r"],
            "omega_p0": mp.sqrt((1 / ph - 1) / a),  # Eq. 28
            "omega_r0": mp.sqrt((1 / th - 1) / b),  # Eq. 29
            "K_p": k["p"],
            "K_r": k["r"],
            "n_0": n_0,
            "t_rgh": t_rgh,
            "n_c1": -mp.sqrt(square) if square is not None and square > 0 else None,
            "growth_pitch": n * k["p"] / 2,
            "growth_roll": -n * k["r"] / 2,
        }
    return {name: _rounded(value) for name, value in out.items()}


def spin_matrix(alpha, beta, gamma, theta, phi, xi, n):
    """Return the matrix of the equations linearised about the steady spin.

    It is u = (0, 0, -1), omega = (0, 0, -n).

    In (u_x, u_y, omega_x, omega_y), with B = R Theta^-1 R^-1 and r_perp = -B u_perp:

        du = eps (omega - n u)
        J domega = n [[0, gamma - beta], [alpha - gamma, 0]] omega
                   + n B eps (omega - n u) + n^2 eps B u - eps (1 - B) u
    """
    with mp.workdps(WORK):
        a, b, c, th, ph, x, n = _exact(alpha, beta, gamma, theta, phi, xi, n)
        eps = mp.matrix([[0, 1], [-1, 0]])
        unity = mp.eye(2)
        ball = _rotation(x) * mp.diag([1 / th, 1 / ph]) * _rotation(x).T
        jinv = mp.diag([1 / a, 1 / b])
        uu = -n * eps
        uw = eps
        gyro = mp.matrix([[0, c - b], [a - c, 0]])
        wu = jinv * (-(n**2) * ball * eps + n**2 * eps * ball - eps * (unity - ball))
        ww = jinv * (n * gyro + n * ball * eps)
        return _blocks(uu, uw, wu, ww)


def _eigenvalues(matrix):
    values, _ = mp.eig(matrix)
    for i, value in enumerate(values):
        # Remove rounding errors from imaginary parts that are zero.
        if abs(value.imag) < mp.mpf(10) ** -40 * abs(value):
            values[i] = mp.mpc(value.real, 0)
    values.sort(key=lambda value: (-mp.im(value), -mp.re(value)))
    return [_rounded(mp.mpc(value)) for value in values]


def _blocks(uu, uw, wu, ww):
    """Return the 4x4 matrix made of four 2x2 blocks."""
    m = mp.zeros(4)
    for i in range(2):
        for j in range(2):
            m[i, j] = uu[i, j]
            m[i, j + 2] = uw[i, j]
            m[i + 2, j] = wu[i, j]
            m[i + 2, j + 2] = ww[i, j]
    return m


def steady_eigenvalues(constants, n, sigma=0.0):
    """Return the four eigenvalues of a steady spin, by decreasing imaginary part.

    ``constants`` are those of `full.constants`.  The torque ``-sigma omega`` makes the
    spin fall at the rate ``sigma n / gamma``.
    """
    with mp.workdps(WORK):
        ix, iy, iz, cxx, cxy, cyy, n, sigma = _exact(
            *(float(x) for x in (*constants, n, sigma))
        )
        c = -n
        fall = sigma * n / iz
        curved = mp.matrix([[cxx, cxy], [cxy, cyy]])
        turn = mp.matrix([[0, 1], [-1, 0]])
        # For the slope s and the horizontal omega: ds/dt = c turn s - turn omega, f = C
        # s, w = c turn f - C ds/dt, and J domega/dt as below.
        su = c * turn
        sw = -turn
        wu = c * turn * curved - curved * su
        ww = -curved * sw
        gyro = mp.matrix([[0, c * (iy - iz)], [c * (iz - ix), 0]])
        inverse = mp.diag([1 / (ix + 1), 1 / (iy + 1)])
        au = inverse * (-c * wu - turn * curved + fall * (mp.eye(2) + curved))
        aw = inverse * (gyro - c * ww - sigma * mp.eye(2))
        return _eigenvalues(_blocks(su, sw, au, aw))
