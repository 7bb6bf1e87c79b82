"""A body on a plane that shakes, from the laws of mechanics, with SciPy.

This module does not import `rattlesweep`.  As in `stone_oracle`, the unknowns are the
angular acceleration and the contact force, and the laws of Newton and Euler and the
rolling condition are six linear equations for them.  They hold in a frame at rest: the
contact point has the velocity of the plane, which is accelerated by ``eps cos(Omega t +
phase)`` upwards, or along itself.  Units M = a = g = 1; the state is ``(u, omega, work
of all, work of the plane, work at the contact point, attitude)``.  Vectors are in the
body's axes.  The first two works are those in the frame of the plane, the third is that
of the contact force at rest.  The attitude is a quaternion, scalar last, from the
body's axes to those of the plane, which are ``h_1`` at launch, ``u x h_1`` and ``u``.
"""

from dataclasses import dataclass

import numpy as np
import oracle
from oracle import cross, matrix_of
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from stone_oracle import SMOOTHING, contact


@dataclass(frozen=True)
class Shaken:
    """A drive, and the losses beside it."""

    frequency: float
    acceleration: float
    phase: float = 0.0
    sigma: float = 0.0
    rolling: float = 0.0
    pivot: float = 0.0
    azimuth: float | None = None  # of a plane that shakes along itself

    @property
    def direction(self):
        """The direction in which the plane shakes, in its own axes."""
        if self.azimuth is None:
            return np.array([0.0, 0.0, 1.0])
        return np.array([np.cos(self.azimuth), np.sin(self.azimuth), 0.0])

    def acceleration_at(self, t):
        """Return the acceleration of the plane along the direction."""
        return self.acceleration * np.cos(self.frequency * t + self.phase)

    def velocity_at(self, t):
        """Return the velocity of the plane along the direction."""
        along = np.sin(self.frequency * t + self.phase)
        return self.acceleration / self.frequency * along


def attitude(u):
    """Return the quaternion of a body at launch."""
    first = np.array([1.0, 0.0, 0.0]) - u[0] * u
    first = first / np.linalg.norm(first)
    return Rotation.from_matrix([first, np.cross(u, first), u]).as_quat()


def launched(u, omega):
    """Return the state of a launch."""
    return np.concatenate([u, omega, np.zeros(3), attitude(u)])


def motion(t, y, body, drive):
    """Return the angular acceleration, the contact force and the three powers."""
    u = y[:3]
    w = y[3:6]
    direction = Rotation.from_quat(y[9:]).inv().apply(drive.direction)
    shaken = drive.acceleration_at(t) * direction
    r, dr = contact(u, cross(u, w), body)
    inertia = oracle.matrices(body)[2]
    across = w - (u @ w) * u
    rubbing = drive.rolling * across / np.sqrt(across @ across + SMOOTHING**2)
    rubbing = rubbing + drive.pivot * np.sign(u @ w) * u
    left = np.zeros((6, 6))
    right = np.zeros(6)
    # dv/dt in space is F - u, and v - r x omega is the velocity of the plane.
    left[:3, :3] = matrix_of(r)
    left[:3, 3:] = -np.eye(3)
    right[:3] = -u - shaken - cross(dr, w) - cross(w, cross(r, w))
    # I domega/dt + omega x I omega = r x F - sigma omega - (F.u) rubbing
    left[3:, :3] = inertia
    left[3:, 3:] = -matrix_of(r) + np.outer(rubbing, u)
    right[3:] = -cross(w, inertia @ w) - drive.sigma * w
    solution = np.linalg.solve(left, right)
    force = solution[3:]
    plane = -shaken @ cross(r, w)
    lost = -drive.sigma * (w @ w) - (force @ u) * (rubbing @ w)
    at_rest = drive.velocity_at(t) * (force @ direction)
    return solution[:3], force, (plane + lost, plane, at_rest)


def rhs(t, y, body, drive):
    """Return the rates of the state."""
    acceleration, _, powers = motion(t, y, body, drive)
    w = y[3:6]
    v = y[9:12]
    turning = np.append(y[12] * w + cross(v, w), -v @ w) / 2
    return np.concatenate([cross(y[:3], w), acceleration, powers, turning])


def normal_force(t, y, body, drive):
    """Return the normal force."""
    return motion(t, y, body, drive)[1] @ y[:3]


def follow(body, u, omega, t_end, drive, tol=1e-12):
    """Return SciPy's solution from a state; it ends where the body lifts off."""

    def lifts(t, y):
        return normal_force(t, y, body, drive)

    lifts.terminal = True
    return solve_ivp(
        lambda t, y: rhs(t, y, body, drive),
        (0, t_end),
        launched(u, omega),
        "DOP853",
        dense_output=True,
        events=lifts,
        rtol=tol,
        atol=1e-4 * tol,
        # A run at rest must notice the drive.
        max_step=0.25 * 2 * np.pi / max(drive.frequency, 1.0),
    )


def first_zero(found, samples=40_000):
    """Return the first zero of the spin after the launch, or None."""
    times = np.linspace(0, found.t[-1], samples)[1:]
    y = found.sol(times)
    n = (y[:3] * y[3:6]).sum(axis=0)
    changes = np.flatnonzero(n[1:] * n[:-1] < 0)
    if not changes.size:
        return None

    def spin(t):
        at = found.sol(t)
        return at[:3] @ at[3:6]

    return brentq(spin, times[changes[0]], times[changes[0] + 1], xtol=1e-14)
