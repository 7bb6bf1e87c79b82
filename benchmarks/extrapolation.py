"""Reference for the extremes: the extrapolated midpoint rule for the paper's six
variables.

The equations are those of tests/helpers/reference.py.  The method is that of Gragg,
Bulirsch and Stoer with a fixed number of columns and no error control: its error is
below the change that halving all steps makes.  It computes in longdoubles or with
mpmath.
"""

from dataclasses import dataclass

import numpy as np
import oracle
from mpmath import mp
from reference import (
    PARAMETERS,
    constants,
    contact,
    cross,
    real,
    rhs,
    step,
    trigonometry,
)

# Step, in radians of `pace`, and number of points at which the spin is evaluated in a
# step.
ANGLE = 1.0
POINTS = 16


def launch(n_i, omega_xy0, psi, exact=False):
    """Return the initial states (Eqs. 68 to 70), of shape (6, cases)."""
    n_i, omega_xy0, psi = (real(x, exact) for x in (n_i, omega_xy0, psi))
    c, s = trigonometry(psi, exact)
    zero = 0 * n_i
    return np.stack([zero, zero, zero - 1, omega_xy0 * c, omega_xy0 * s, -n_i])


def spin(y):
    """The spin u . omega."""
    return y[0] * y[3] + y[1] * y[4] + y[2] * y[5]


def spin_rate(y, q):
    """The rate of the spin, u . domega."""
    d = rhs(y, q)
    return y[0] * d[3] + y[1] * d[4] + y[2] * d[5]


def fastest(row, n_i, omega_xy0):
    """Bound on the frequencies of a launch, from the linear motion at its spin and at
    rest.
    """
    body = dict(zip(PARAMETERS, row, strict=True))
    spins = n_i, 0.5 * n_i, 0.0
    found = [
        np.abs(np.linalg.eigvals(oracle.jacobian_spin(body, n))).max() for n in spins
    ]
    return max(*found, abs(n_i), abs(omega_xy0))


@dataclass
class Reference:
    """First zero (NaN without one by the horizon), the spin at the end and the state
    there.
    """

    t_r: np.ndarray
    n_end: np.ndarray
    y_end: np.ndarray


def _first_zero(y, h, q, sign):
    """First zero of the spin of one case in the step ``h`` from ``y``, or None.

    The spin is evaluated at POINTS points, each reached by a separate step from ``y``.
    Where it falls at one point and rises at the next, its minimum is searched for.
    """
    exact = y.dtype == object
    cells = q[:, None], y[:, None]

    def look(times):
        times = np.atleast_1d(times)
        many = [np.repeat(c, len(times), axis=1) for c in cells]
        ends = step(many[1], times, many[0])
        return sign * spin(ends), sign * spin_rate(ends, many[0]), ends

    grid = h * real(np.arange(POINTS + 1), exact) / POINTS
    s, r, _ = look(grid)
    for k in range(POINTS):
        low, high = grid[k], grid[k + 1]
        if s[k + 1] > 0:
            if not r[k] < 0 < r[k + 1]:
                continue
            # A convex curve lies above its tangents.  Wide margin: the curve may not be
            # convex.
            if min(s[k], s[k + 1]) > 2 * (high - low) * max(-r[k], r[k + 1]):
                continue
            a, b, high = low, high, None
            for _ in range(80 if not exact else 200):
                middle = (a + b) / 2
                if middle in (a, b):
                    break
                value, rate, _ = look(middle)
                if value[0] <= 0:
                    high = middle
                    break
                a, b = (middle, b) if rate[0] < 0 else (a, middle)
            if high is None:
                continue
        # Bisection with Newton's method inside.
        t = (low + high) / 2
        for _ in range(200):
            value, rate, _ = look(t)
            low, high = (t, high) if value[0] > 0 else (low, t)
            new = t - value[0] / rate[0] if rate[0] != 0 else low
            if not low < new < high:
                new = (low + high) / 2
            if new == t or abs(new - t) <= abs(h) * (
                1e-19 if not exact else mp.mpf(10) ** -40
            ):
                break
            t = new
        return t, look(t)[2][:, 0]
    return None


def pace(y, q, fast):
    """Rate that sets the step: the sum of those of oscillation, rotation and contact
    point.

    A long body that rolls far changes its inertia about the contact point within a
    fraction of a period.  The rate depends on the state alone, so that halving
    ``angle`` halves every step.
    """
    y, q = y.astype(float), q.astype(float)
    u, w = y[:3], y[3:]
    _, (dx, dy, _) = contact(u, cross(u, w), q)
    return fast + np.sqrt((w**2).sum(axis=0)) + np.hypot(dx, dy)


def integrate(parameters, n_i, omega_xy0, psi, t_end, angle=ANGLE, exact=False):
    """Integrate cases, rows of PARAMETERS, to their first reversal or their horizon.

    `angle` is the step times :func:`pace`; `exact` is in mpmath's numbers, at its
    present precision, instead of longdoubles.
    """
    parameters = np.asarray(parameters, dtype=float)
    fast = np.array(
        [fastest(*row) for row in zip(parameters, n_i, omega_xy0, strict=True)],
        dtype=float,
    )
    angle = np.broadcast_to(np.asarray(angle, dtype=float), fast.shape)
    horizon = real(t_end, exact)
    q, y = constants(parameters, exact), launch(n_i, omega_xy0, psi, exact)
    sign = np.sign(np.asarray(n_i, dtype=float))
    t = 0 * horizon
    t_r = np.full(len(fast), np.nan, dtype=y.dtype)
    ends = y.copy()
    active = np.arange(len(fast))
    n = spin(y)
    largest = np.abs(spin_rate(y, q))
    fresh = True
    while active.size:
        h = real(angle[active] / pace(y, q, fast[active]), exact)
        left = horizon[active] - t
        over = h >= left
        h = np.where(over, left, h)
        new = step(y, h, q)
        n1 = spin(new)
        largest = np.maximum(largest * 9 / 10, np.abs(spin_rate(new, q)))
        near = (np.abs(n) + np.abs(n1) < 4 * h * largest) | (n * n1 <= 0)
        for k in np.flatnonzero(near | fresh):
            case = active[k]
            found = _first_zero(y[:, k], h[k], q[:, k], sign[case])
            if found is not None:
                t_r[case] = t[k] + found[0]
                new[:, k], over[k] = found[1], True
        fresh = False
        t = t + h
        ends[:, active] = new
        y, n = new, n1
        if over.any():
            keep = ~over
            active, t, n, largest = active[keep], t[keep], n[keep], largest[keep]
            y, q = y[:, keep], q[:, keep]
    return Reference(t_r, spin(ends), ends)
