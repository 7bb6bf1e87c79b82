"""Bodies in SI units, from a CAD program or from a scale and a ruler."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.units import quantity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from rattlesweep.arrays import Floats

GRAVITY = 9.81
"""Gravity on Earth, in m/s^2."""
MAX_TILT = 1e-3
"""Angle in radians by which the principal axis may be off the vertical, for rounded inputs."""
LIMITS = {
    "mass": (1e-9, 1e9, "kg"), "length": (1e-9, 1e6, "m"), "acceleration": (1e-6, 1e6, "m/s^2"),
}  # fmt: skip
"""Smallest and largest size of a quantity by its kind: beyond them products leave no digits."""


@dataclass(frozen=True)
class Units:
    """The units of mass, length and time of a body, in SI units.

    Attributes
    ----------
    mass : float
        ``M``, in kg.
    length : float
        ``a``, the height of the centre of mass over the contact, in m.
    gravity : float
        ``g``, in m/s^2.
    """

    mass: float
    length: float
    gravity: float = GRAVITY

    @property
    def time(self) -> float:
        """``sqrt(a/g)``, in s."""
        return math.sqrt(self.length / self.gravity)

    @property
    def sizes(self) -> dict[str, tuple[float, str]]:
        """Size of each unit that rattlesweep writes, and the SI unit of that size."""
        m, a, g, t = self.mass, self.length, self.gravity, self.time
        return {
            "sqrt(a/g)": (t, "s"),
            "sqrt(g/a)": (1 / t, "rad/s"),
            "a": (a, "m"),
            "M g": (m * g, "N"),
            "M g a": (m * g * a, "J"),
            "M a^2 sqrt(g/a)": (m * a**2 / t, "N m s"),
        }


def number(value: float | str, kind: str, name: str) -> float:
    """Return a number in SI units, given as that or as text with a unit.

    Parameters
    ----------
    value : float or str
        The number, or a text such as ``"12 mm"``.
    kind : str
        One of :data:`rattlesweep.units.KINDS`.
    name : str
        What an error calls it.

    Raises
    ------
    ValueError
        If the text is no quantity of this kind, or the number is beyond its limits.
    """
    try:
        found = quantity(value, kind) if isinstance(value, str) else float(value)
    except ValueError as error:
        raise ValueError(f"{name}: {value!r} {error}") from None
    if sentence := beyond(found, kind):
        raise ValueError(f"{name}: {found:g} {sentence}")
    return found


def beyond(value: float, kind: str) -> str:
    """Return what is wrong with the size of a quantity, or "": zero and its sign do not matter."""
    low, high, unit = LIMITS.get(kind, (0.0, math.inf, ""))
    if value == 0 or not math.isfinite(value) or low <= abs(value) <= high:
        return ""
    return f"{unit} is out of range; from {low:g} to {high:g} {unit} is allowed"


def principal(
    inertia: Floats, radii: Floats, axes_angle: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the principal moments, and the angle from their axes to those of curvature.

    Parameters
    ----------
    inertia : ndarray, shape (..., 4)
        ``I_xx, I_yy, I_zz, I_xy``.
    radii : ndarray, shape (..., 2)
        Radii of curvature at the bottom.
    axes_angle : ndarray
        Angle from the x axis to the direction along which the surface bends by the first of them.

    Returns
    -------
    larger, smaller, vertical : ndarray
        Moments of inertia.
    xi : ndarray
        Skew angle from the axis of the larger moment to that of the smaller radius, in
        ``(-pi/2, pi/2]``.
    """
    xx, yy, zz, xy = np.moveaxis(inertia, -1, 0)
    mean, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    larger = np.arctan2(2 * xy, xx - yy) / 2
    # If the second radius is the smaller one, its direction is a right angle further.
    smaller = axes_angle + np.where(radii[..., 0] <= radii[..., 1], 0.0, np.pi / 2)
    xi = np.remainder(smaller - larger, np.pi)
    return mean + half, mean - half, zz, np.where(xi > np.pi / 2, xi - np.pi, xi)


def parameters(
    mass: ArrayLike, inertia: ArrayLike, height: ArrayLike, radii: ArrayLike, axes_angle: ArrayLike
) -> dict[str, Floats]:
    """Return ``alpha, beta, gamma, theta, phi, xi``; arguments as for :func:`principal`."""
    mass, height, radii = (np.asarray(x, float) for x in (mass, height, radii))
    found = principal(np.asarray(inertia, float), radii, np.asarray(axes_angle, float))
    larger, smaller, vertical, xi = found
    unit = mass * height**2
    return {
        "alpha": larger / unit + 1,
        "beta": smaller / unit + 1,
        "gamma": vertical / unit,
        "theta": height / radii.min(axis=-1),
        "phi": height / radii.max(axis=-1),
        "xi": xi,
    }


def components(inertia: Sequence[float] | Sequence[Sequence[float]]) -> tuple[float, ...]:
    """Return ``I_xx, I_yy, I_zz, I_xy`` of a tensor, given as a matrix or three to six numbers.

    Raises
    ------
    ValueError
        If no body that can spin upright has this tensor.
    """
    tensor = np.asarray(inertia, float)
    if tensor.ndim == 1 and 3 <= tensor.size <= 6:
        xx, yy, zz, xy, xz, yz = np.pad(tensor, (0, 6 - tensor.size))
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if tensor.shape != (3, 3):
        raise ValueError(
            "inertia: a matrix of 3 x 3 is needed, or (ixx, iyy, izz, ixy, ixz, iyz), of which the "
            "last three may be left out"
        )
    if not np.isfinite(tensor).all():
        raise ValueError("inertia: it has an entry that is no finite number")
    if np.abs(tensor - tensor.T).max() > 1e-6 * np.abs(tensor).max():
        raise ValueError("inertia: the matrix is not symmetric; ixy and iyx are one number")
    moments = np.linalg.eigvalsh(tensor)
    if not moments[0] > 0:
        raise ValueError(
            f"inertia: a principal moment is {moments[0]:g} kg m^2, and all must be positive"
        )
    if moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
        raise ValueError(
            f"inertia: no mass distribution has it, as the principal moment {moments[2]:g} kg m^2 "
            f"exceeds the sum of the others, {moments[0] + moments[1]:g}"
        )
    xx, yy, zz = np.diag(tensor)
    # To first order the angle by which the vertical is off a principal axis.
    coupling = np.hypot(tensor[0, 2], tensor[1, 2])
    tilt = coupling / max(abs(zz - xx), abs(zz - yy), 1e-300)
    if tilt > MAX_TILT:
        raise ValueError(
            f"inertia: the vertical is no principal axis: ixz and iyz turn it by {tilt:.2g} rad; "
            "give the inertia in axes of which z is one"
        )
    return float(xx), float(yy), float(zz), float(tensor[0, 1])
