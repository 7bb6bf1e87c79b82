"""Bodies in SI units: from a CAD program, from a scale and a ruler, or half an ellipsoid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.units import quantities, quantity

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rattlesweep.arrays import Floats

GRAVITY = 9.81  # on Earth, in m/s^2
MAX_TILT = 1e-3  # angle by which the principal axis may be off the vertical, for rounded inputs
LIMITS = {"mass": (1e-9, 1e9, "kg"), "length": (1e-9, 1e6, "m"),
          "acceleration": (1e-6, 1e6, "m/s^2")}  # fmt: skip
"""Smallest and largest size of a quantity by its kind: beyond them products leave no digits."""


@dataclass(frozen=True)
class Units:
    """The units of a body: ``M`` in kg, ``a`` in m (height of the centre of mass), gravity."""

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
            "sqrt(a/g)": (t, "s"), "sqrt(g/a)": (1 / t, "rad/s"), "a": (a, "m"),
            "M g": (m * g, "N"), "M g a": (m * g * a, "J"),
            "M a^2 sqrt(g/a)": (m * a**2 / t, "N m s"),
        }  # fmt: skip


def number(value: float | str, kind: str, name: str) -> float:
    """Return a number in SI units, given as that or as text of a kind of `units.KINDS`."""
    try:
        return quantity(value, kind) if isinstance(value, str) else float(value)
    except ValueError as error:
        raise ValueError(f"{name}: {value!r} {error}") from None


def size(value: float | str, kind: str, name: str) -> float:
    """Return a :func:`number` that is positive and within the `LIMITS` of its kind."""
    found = number(value, kind, name)
    low, high, unit = LIMITS[kind]
    if not low <= found <= high:
        raise ValueError(f"{name} is {found:g}; from {low:g} to {high:g} {unit} is allowed")
    return found


def two_lengths(value: str | Sequence[float | str], name: str) -> list[float]:
    """Return two lengths in m, given as numbers, texts, or a text such as ``"45, -9 mm"``."""
    try:
        if isinstance(value, str):
            return quantities(value, "length", 2)
    except ValueError as error:
        raise ValueError(f"{name}: {value!r} {error}") from None
    if len(value) != 2:
        raise ValueError(f"{name}: two lengths are needed, and not {len(value)}")
    return [number(each, "length", name) for each in value]


def parameters(
    mass: ArrayLike, inertia: ArrayLike, height: ArrayLike, radii: ArrayLike, axes_angle: ArrayLike
) -> dict[str, Floats]:
    """Return ``alpha, beta, gamma, theta, phi, xi`` of bodies.

    `inertia` are ``I_xx, I_yy, I_zz, I_xy``, shape (..., 4), and `axes_angle` goes from the x axis
    to the direction along which the first of the radii of curvature, (..., 2), bends.
    """
    mass, height, radii = (np.asarray(x, float) for x in (mass, height, radii))
    xx, yy, zz, xy = np.moveaxis(np.asarray(inertia, float), -1, 0)
    mean, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    larger = np.arctan2(2 * xy, xx - yy) / 2
    # If the second radius is the smaller one, its direction is a right angle further.
    turned = np.where(radii[..., 0] <= radii[..., 1], 0.0, np.pi / 2)
    xi = np.remainder(np.asarray(axes_angle, float) + turned - larger, np.pi)
    unit = mass * height**2
    return {
        "alpha": (mean + half) / unit + 1, "beta": (mean - half) / unit + 1, "gamma": zz / unit,
        "theta": height / radii.min(axis=-1), "phi": height / radii.max(axis=-1),
        "xi": np.where(xi > np.pi / 2, xi - np.pi, xi),
    }  # fmt: skip


def components(inertia: Sequence[float] | Sequence[Sequence[float]]) -> tuple[float, ...]:
    """Return ``I_xx, I_yy, I_zz, I_xy`` of a tensor, given as a matrix or three to six numbers."""
    tensor = np.asarray(inertia, float)
    if tensor.ndim == 1 and 3 <= tensor.size <= 6:
        xx, yy, zz, xy, xz, yz = np.pad(tensor, (0, 6 - tensor.size))
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    slack = 1e-6 * np.abs(tensor).max(initial=0)
    if tensor.shape != (3, 3) or not np.abs(tensor - tensor.T).max() <= slack < np.inf:
        raise ValueError("inertia: a finite symmetric 3 x 3 matrix is needed, or (ixx, iyy, izz, "
                         "ixy, ixz, iyz), of which the last three may be left out")  # fmt: skip
    moments = np.linalg.eigvalsh(tensor)
    if moments[0] <= 0 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
        told = ", ".join(f"{moment:g}" for moment in moments)
        raise ValueError(f"inertia: no body has the principal moments {told} kg m^2")
    xx, yy, zz = np.diag(tensor)
    # To first order the angle by which the vertical is off a principal axis.
    coupling = np.hypot(tensor[0, 2], tensor[1, 2])
    tilt = coupling / max(abs(zz - xx), abs(zz - yy), 1e-300)
    if tilt > MAX_TILT:
        raise ValueError(f"inertia: the z axis is off a principal axis by {tilt:.2g} rad")
    return float(xx), float(yy), float(zz), float(tensor[0, 1])


def half_ellipsoid(
    length: ArrayLike, width: ArrayLike, height: ArrayLike, mass: ArrayLike,
    skew: ArrayLike = 0.0, *, weights: ArrayLike = 0.0, x: ArrayLike = 0.0, y: ArrayLike = 0.0,
) -> dict[str, Floats]:  # fmt: skip
    """Return the parameters and ``c`` of solid half ellipsoids with their flat side up.

    Arguments as for :meth:`rattlesweep.physics.body.Rattleback.half_ellipsoid`, with
    ``at = (x, y)``.  Also ``mass`` and ``height`` of the centre of mass, with the weights.
    """
    length, width, height, mass, skew, weights, x, y = np.broadcast_arrays(
        *(np.asarray(v, float) for v in (length, width, height, mass, skew, weights, x, y))
    )
    p, q = length / 2, width / 2
    both = 2 * weights
    total = mass + both
    a = height * (5 / 8 * mass + both) / total
    # About the centre of mass of all, along axes to the right and towards the observer.
    flat = 19 / 320 * height**2 + (a - 5 / 8 * height) ** 2
    mean = mass * ((p**2 + q**2) / 10 + flat) + both * ((x**2 + y**2) / 2 + (height - a) ** 2)
    own, added = mass * (q**2 - p**2) / 10, both * (y**2 - x**2) / 2
    half = own * np.cos(2 * skew) + added
    vertical = mass * (p**2 + q**2) / 5 + both * (x**2 + y**2)
    inertia = [mean + half, mean - half, vertical, own * np.sin(2 * skew) + both * x * y]
    radii = np.stack([p**2 / height, q**2 / height], axis=-1)
    found = parameters(total, np.stack(inertia, axis=-1), a, radii, np.zeros(a.shape))
    return {**found, "c": height / a, "mass": total, "height": a}
