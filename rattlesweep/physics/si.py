"""Bodies in SI units: from a measured inertia tensor, or as a half ellipsoid."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rattlesweep.arrays import (
    Floats,
    refuse_foreign_units,
    unmasked,
    with_plain_numbers,
)
from rattlesweep.words.errors import ConfigError, one_line
from rattlesweep.words.units import (
    KINDS,
    NATURAL,
    in_si,
    is_measured,
    quantities,
    quantity,
    split,
)

GRAVITY = 9.81  # on Earth, in m/s^2
# angle between the z axis and a principal axis, in radians, for rounded inputs
MAX_TILT = 1e-3
MOST_RPM = 3000  # of a body with a size
LIGHT = 100.0  # kg/m^3, half of the density of cork
LARGE_SKEW = np.radians(60)  # beyond it, axes may be exchanged
LIMITS = {
    "mass": (1e-9, 1e9, "kg"),
    "length": (1e-9, 1e6, "m"),
    "acceleration": (1e-6, 1e6, "m/s^2"),
    "angle": (-1.57, 1.57, "rad"),
    "modulus": (1e3, 1e13, "Pa"),
    # From foam to osmium.
    "density": (5.0, 23_000.0, "kg/m^3"),
}
"""Smallest and largest accepted value of each kind; products of these do not overflow.
"""


@dataclass(frozen=True)
class Units:
    """Units of a body: ``M`` in kg, ``a`` (height of the centre of mass) in m, ``g`` in
    m/s^2.

    Each is a number, or an array with one for each of several bodies; a mass may be
    NaN, unknown.
    """

    mass: Any
    length: Any
    gravity: Any = GRAVITY

    def __post_init__(self) -> None:
        with_plain_numbers(self)

    @property
    def time(self) -> Any:
        """Return ``sqrt(a/g)`` in s."""
        time = np.sqrt(self.length / self.gravity)
        if np.ndim(time) == 0:
            return float(time)
        return time

    def natural(self, value: float | Floats, kind: str) -> Floats:
        """Return SI quantities of a kind of `units.KINDS` in these units."""
        if kind in ("spin", "frequency"):
            return np.asarray(value * self.time)
        return np.asarray(value / self.sizes[NATURAL[kind]][0])

    @property
    def sizes(self) -> dict[str, tuple[Any, str]]:
        """Return the size and the SI unit of each unit that rattlesweep writes."""
        m, a, g, t = self.mass, self.length, self.gravity, self.time
        return {
            "sqrt(a/g)": (t, "s"),
            "sqrt(g/a)": (1 / t, "rad/s"),
            "a": (a, "m"),
            "sqrt(g a)": (a / t, "m/s"),
            "M g": (m * g, "N"),
            "M g / a^2": (m * g / (a * a), "Pa"),
            "M g a": (m * g * a, "J"),
            "M a^2": (m * (a * a), "kg m^2"),
            "M a^2 sqrt(g/a)": (m * (a * a) / t, "N m s"),
            "M sqrt(g/a)": (m / t, "N s/m"),
        }


def plain(name: str, value: Any, kind: str) -> Any:
    """Return a value without Pint's unit, in SI units, and without NumPy's mask.

    Raise ValueError, with the `name` of the value, if the unit is not of the `kind`, or
    an entry is masked.
    """
    if is_measured(value):
        try:
            value = in_si(value, kind)
        except ValueError as error:
            raise ValueError(f"{name}: {one_line(str(value))} {error}") from None
    refuse_foreign_units(name, value)
    return unmasked(name, value)


def number(value: float | str, kind: str, name: str) -> float:
    """Return a number in SI units, given as such or as a text such as ``"85 g"``.

    A quantity of Pint is like a text.  Raise ValueError, with the `name` of the value,
    if the unit is not one of a `kind` of `units.KINDS`.
    """
    value = plain(name, value, kind)
    try:
        if isinstance(value, str):
            return quantity(value, kind)
        return float(value)
    except TypeError:
        wanted = f"give a number or a text such as {KINDS[kind][1]}"
        raise ValueError(f"{name}: {value!r} is given; {wanted}") from None
    except ValueError as error:
        raise ValueError(f"{name}: {value!r} {error}") from None


def size(value: float | str, kind: str, name: str) -> float:
    """Return a :func:`number`; raise ValueError unless it is within its `LIMITS`."""
    size_in_si = number(value, kind, name)
    text = getattr(value, "text", value)
    if not isinstance(text, str):
        text = None
    problem = outside(size_in_si, kind, text)
    if problem is not None:
        shown = text or f"{size_in_si:g}"
        raise ValueError(f"{name} is {shown}; {problem}")
    return size_in_si


def outside(size_in_si: float, kind: str, text: str | None = None) -> str | None:
    """Return which sizes of a kind are allowed, None if this one is.

    They are in the unit of the text, if one is given.
    """
    low, high, unit = LIMITS[kind]
    if low <= size_in_si <= high:
        return None
    if text is not None:
        unit = split(text)[1]
        unit_in_si = quantity(f"1 {unit}", kind)
        low /= unit_in_si
        high /= unit_in_si
    return f"from {low:.4g} to {high:.4g} {unit} is allowed"


def check_density(mass: ArrayLike, volume: ArrayLike) -> None:
    """Raise a ValueError if a mass does not go with a volume, of the first body."""
    densities = np.atleast_1d(np.divide(mass, volume))
    low, high, unit = LIMITS["density"]
    wrong = np.flatnonzero(~((densities >= low) & (densities <= high)))
    if wrong.size:
        raise ValueError(
            f"the density is {densities[wrong[0]]:,.4g} {unit}; from {low:g} (foam) to "
            f"{high:,.0f} (osmium) is allowed; check the mass and the sizes"
        )


def half_ellipsoid_volume(
    length: ArrayLike, width: ArrayLike, height: ArrayLike, wall: ArrayLike = np.inf
) -> Floats:
    """Return the volumes of half ellipsoids, solid or with a wall."""
    outer = np.stack(np.broadcast_arrays(*map(np.asarray, (length, width, height))))
    axes = outer * np.array([0.5, 0.5, 1.0]).reshape(3, *[1] * (outer.ndim - 1))
    inner = np.maximum(axes - wall, 0.0)
    volume: Floats = 2 / 3 * np.pi * (axes.prod(axis=0) - inner.prod(axis=0))
    return volume


def check_spins(name: str, spins: Floats, units: Units) -> None:
    """Raise a ConfigError if a spin in units of the body is faster than any stone."""
    try:
        rpm = np.ravel(np.abs(spins) / units.time) * (30 / np.pi)
    except ValueError:
        return  # shapes that do not broadcast are refused later
    fast = np.flatnonzero(rpm > MOST_RPM)
    if fast.size:
        raise ConfigError(
            f"{name}: {rpm[fast[0]]:,.0f} rpm is faster than a stone spins; up to "
            f"{MOST_RPM:,} rpm is allowed"
        )


def doubts(units: Units, gamma: ArrayLike, xi: ArrayLike) -> Iterator[str]:
    """Yield what is doubtful about bodies with a size, each for the first such body.

    A half ellipsoid with the moment of inertia ``gamma M a^2`` about the vertical and a
    centre of mass at the height ``a`` has at most the volume ``8 pi/3 gamma a^3``, if
    it is as wide as long.
    """
    skews = np.atleast_1d(np.asarray(xi, float))
    turned = np.flatnonzero(np.abs(skews) > LARGE_SKEW)
    if turned.size:
        yield (
            f"the skew angle is {np.degrees(skews[turned[0]]):.4g} deg; are the radii "
            "exchanged against the inertia, or the axes of the inertia?"
        )
    low, high, unit = LIMITS["density"]
    masses, length, gammas = np.broadcast_arrays(units.mass, units.length, gamma)
    mass = np.ravel(masses)
    densities = mass / np.ravel(8 * np.pi / 3 * gammas * length**3)
    # An unknown mass is NaN.
    wrong = np.flatnonzero((densities < low) | (densities > high))
    if wrong.size:
        first = wrong[0]
        yield (
            f"a stone of {mass[first]:g} kg with this inertia and height has "
            f"a density of about {densities[first]:.2g} {unit}; from {low:g} (foam) to "
            f"{high:,.0f} (osmium) is likely; check the units of mass and inertia"
        )
        return
    # An inertia per mass is a length squared, which is no moment of inertia.
    per_mass = densities / mass
    wrong = np.flatnonzero((densities < LIGHT) & (per_mass > 3 * LIGHT))
    if wrong.size:
        first = wrong[0]
        yield (
            f"a stone of {mass[first]:g} kg with this inertia and height has "
            f"a density of about {densities[first]:.2g} {unit}, less than cork; if the "
            "inertia is per mass, in m^2, multiply it by the mass"
        )


def two_lengths(value: str | Sequence[float | str], name: str) -> list[float]:
    """Return two lengths in m, from numbers, texts, or one text ``"45, -9 mm"``."""
    try:
        if isinstance(value, str):
            return quantities(value, "length", 2)
    except ValueError as error:
        raise ValueError(f"{name}: {value!r} {error}") from None
    lengths: Any = plain(name, value, "length")
    if isinstance(lengths, np.ndarray):
        lengths = lengths.tolist()
    if not isinstance(lengths, list | tuple) or len(lengths) != 2:
        raise ValueError(f"{name}: {value!r} is given; two lengths are needed")
    return [number(each, "length", name) for each in lengths]


def parameters(
    mass: ArrayLike,
    inertia: ArrayLike,
    height: ArrayLike,
    radii: ArrayLike,
    axes_angle: ArrayLike,
) -> dict[str, Floats]:
    """Return ``alpha, beta, gamma, theta, phi, xi`` of bodies, shape (...).

    Arguments are in SI units: `inertia` holds ``I_xx, I_yy, I_zz, I_xy``, shape (...,
    4), and `radii` two radii of curvature, shape (..., 2), the first in the direction
    `axes_angle`.
    """
    mass, height, radii = (np.asarray(x, float) for x in (mass, height, radii))
    xx, yy, zz, xy = np.moveaxis(np.asarray(inertia, float), -1, 0)
    mean = (xx + yy) / 2
    half = np.hypot((xx - yy) / 2, xy)
    axis_of_alpha = np.arctan2(2 * xy, xx - yy) / 2
    # theta belongs to the smaller radius; the second one is a right angle further.
    turned = np.where(radii[..., 0] <= radii[..., 1], 0.0, np.pi / 2)
    xi = np.remainder(np.asarray(axes_angle, float) + turned - axis_of_alpha, np.pi)
    unit = mass * height**2
    return {
        "alpha": (mean + half) / unit + 1,
        "beta": (mean - half) / unit + 1,
        "gamma": zz / unit,
        "theta": height / radii.min(axis=-1),
        "phi": height / radii.max(axis=-1),
        "xi": np.where(xi > np.pi / 2, xi - np.pi, xi),
    }


def components(
    inertia: Sequence[float] | Sequence[Sequence[float]] | str,
) -> tuple[float, ...]:
    """Return ``I_xx, I_yy, I_zz, I_xy`` of a matrix or of three to six numbers."""
    inertia = plain("inertia", inertia, "moment of inertia")
    try:
        if isinstance(inertia, str):
            inertia = quantities(inertia, "moment of inertia", 3, 4, 5, 6)
        tensor = np.asarray(inertia, float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"inertia: {str(inertia)[:60]!r} {error}") from None
    if tensor.ndim == 1 and 3 <= tensor.size <= 6:
        xx, yy, zz, xy, xz, yz = np.pad(tensor, (0, 6 - tensor.size))
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    slack = 1e-6 * np.abs(tensor).max(initial=0)
    if tensor.shape != (3, 3) or not np.abs(tensor - tensor.T).max() <= slack < np.inf:
        raise ValueError(
            "inertia: a finite symmetric 3 x 3 matrix is needed, or (ixx, iyy, izz, "
            "ixy, ixz, iyz), of which the last three may be left out"
        )
    moments = np.linalg.eigvalsh(tensor)
    if moments[0] <= 0 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
        listed = ", ".join(f"{moment:g}" for moment in moments)
        condition = "all must be positive, and none above the sum of the other two"
        raise ValueError(
            f"inertia: no body has the principal moments {listed} kg m^2; {condition}"
        )
    tilt = axis_tilt(tensor)
    if tilt > MAX_TILT:
        raise ValueError(
            f"inertia: the z axis is off a principal axis by {tilt:.2g} rad"
        )
    return tuple(float(tensor[place]) for place in ((0, 0), (1, 1), (2, 2), (0, 1)))


def axis_tilt(tensor: Floats) -> float:
    """Return the angle between the z axis and the nearest principal axis, in radians.

    A product of inertia turns two axes into each other by the more, the closer their
    moments are.  So each product counts against the difference of its own two moments.
    """
    moments, axes = np.linalg.eigh(tensor[:2, :2])
    products = np.abs(axes.T @ tensor[:2, 2])
    # Products that are rounding errors turn nothing, however close the moments are.
    products[products < 1e-12 * np.abs(tensor).max()] = 0.0
    apart = np.abs(tensor[2, 2] - moments)
    return float(np.hypot(*np.arctan2(2 * products, apart) / 2))


def half_ellipsoid(
    length: ArrayLike,
    width: ArrayLike,
    height: ArrayLike,
    mass: ArrayLike,
    skew: ArrayLike = 0.0,
    *,
    weights: ArrayLike = 0.0,
    x: ArrayLike = 0.0,
    y: ArrayLike = 0.0,
    wall: ArrayLike = np.inf,
) -> dict[str, Floats]:
    """Return parameters, ``c``, total ``mass`` and ``height`` of half ellipsoids.

    The height is ``a``, that of the centre of mass over the contact.  Arguments are
    those of :meth:`rattlesweep.physics.body.Rattleback.half_ellipsoid` in SI units,
    with ``at = (x, y)``; an infinite ``wall`` stands for a solid.
    """
    sizes = (length, width, height, mass, skew, weights, x, y, wall)
    length, width, height, mass, skew, weights, x, y, wall = np.broadcast_arrays(
        *(np.asarray(size, float) for size in sizes)
    )
    outer = np.stack([length / 2, width / 2, height])
    inner = np.maximum(outer - wall, 0.0)
    hollow = (inner / outer).prod(axis=0)  # share of the volume
    both = 2 * weights
    total = mass + both
    # Moments about the middle of the flat side, of a solid less its cavity: depth of
    # the centre of mass, then inertia along axes to the right, towards the viewer and
    # down.
    depth = mean = difference = vertical = np.zeros(total.shape)
    for (p, q, h), share in ((outer, 1.0), (inner, -hollow)):
        m = mass * share / (1 - hollow)
        depth = depth + 3 / 8 * m * h
        mean = mean + m * ((p**2 + q**2) / 10 + h**2 / 5)
        difference = difference + m * (q**2 - p**2) / 10
        vertical = vertical + m * (p**2 + q**2) / 5
    depth = depth / total
    a = height - depth
    # The weights lie on the flat side, whose axes of inertia are turned by the skew.
    mean = mean + both * (x**2 + y**2) / 2 - total * depth**2
    half = difference * np.cos(2 * skew) + both * (y**2 - x**2) / 2
    product = difference * np.sin(2 * skew) + both * x * y
    vertical = vertical + both * (x**2 + y**2)
    inertia = np.stack([mean + half, mean - half, vertical, product], axis=-1)
    radii = np.moveaxis(outer[:2] ** 2 / height, 0, -1)
    body = parameters(total, inertia, a, radii, np.zeros(a.shape))
    return {**body, "c": height / a, "mass": total, "height": a}
