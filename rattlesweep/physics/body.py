"""Bodies: six parameters, the shell-dumbbell map, the preset GH, the mirror image."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from rattlesweep.physics import shapes, si
from rattlesweep.physics.si import Units
from rattlesweep.units import quantities

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import ArrayLike, NDArray

    from rattlesweep.arrays import Floats

T = TypeVar("T", float, "Floats")

PARAMETERS = ("alpha", "beta", "gamma", "theta", "phi", "xi")

# Relative; the shell-dumbbell bodies have I_zz = I_xx + I_yy exactly, but for rounding.
_TRIANGLE = 1e-12


@dataclass(frozen=True)
class Rattleback:
    """A rattleback (Eqs. def-abg, def-z); units M = a = g = 1.

    Parameters
    ----------
    alpha, beta, gamma : float
        ``I_xx + 1``, ``I_yy + 1`` and ``I_zz`` in ``M a^2``; ``alpha > beta > 1``.
    theta, phi : float
        Principal curvatures at the bottom, in ``1/a``; ``0 < phi < theta < 1``.
    xi : float
        Skew angle in radians, in (-pi/2, 0); positive for the mirror image.
    c : float, optional
        Vertical semi-axis of the ellipsoid below, in ``a``, above ``theta``; None for a paraboloid.
    units : Units, optional
        What the units are in SI units, of a body that was given in them; it is equal to one
        without.

    Raises
    ------
    ValueError
        If a parameter is out of its range, or if no body has such an inertia.
    """

    alpha: float
    beta: float
    gamma: float
    theta: float
    phi: float
    xi: float
    c: float | None = None
    units: Units | None = field(default=None, compare=False, repr=False, kw_only=True)

    def __post_init__(self) -> None:
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.compare}
        for name, value in values.items():
            absent = value is None and name == "c"
            if isinstance(value, bool) or not (absent or isinstance(value, Real)):
                raise ValueError(f"{name}: {str(value)[:40]} ({type(value).__name__}) is no number")
        for _, sentence in violations(**values):
            raise ValueError(sentence)

    @classmethod
    def gh(cls) -> Rattleback:
        """The body of Garcia and Hubbard (1988), Table I."""
        return cls(13.04, 1.522, 12.28, 0.6429, 0.0360, -math.radians(1.72))

    @classmethod
    def kl(cls) -> Rattleback:
        """The body of Kane and Levinson (1982), an ellipsoid.

        Semi-axes 20, 3 and 2 cm, centre of mass 1 cm below the centre, 1 kg; moments of inertia
        2, 16 and 17 and product -0.2 kg cm^2 along the ellipsoid's axes.
        """
        along, across, product = 2.0, 16.0, -0.2
        mean, half = (across + along) / 2, math.hypot((across - along) / 2, product)
        xi = 0.5 * math.atan2(2 * product, across - along)
        alpha, beta, size = mean + half + 1, mean - half + 1, Units(mass=1.0, length=0.01)
        return cls(alpha, beta, 17.0, 2 / 3**2, 2 / 20**2, xi, c=2.0, units=size)

    @classmethod
    def shell_dumbbell(
        cls, *, gamma: float, f_sd: float, theta: float, phi: float, xi: float
    ) -> Rattleback:
        """A light shell with two dumbbells; ``f_sd = I_yy / I_zz`` in (0, 0.5)."""
        if not 0 < f_sd < 0.5:
            raise ValueError(f"f_sd is {f_sd:g}; it must lie between 0 and 0.5")
        return cls(*shell_dumbbell(gamma, f_sd), gamma, theta, phi, xi)

    @classmethod
    def from_si(
        cls,
        *,
        mass: float | str,
        inertia: Sequence[float] | Sequence[Sequence[float]],
        height: float | str,
        radii: Sequence[float | str] | str,
        axes_angle: float | str = 0.0,
        c: float | str | None = None,
        gravity: float | str = si.GRAVITY,
        z_up: bool = False,
    ) -> Rattleback:
        """A body from its mass, its lengths and its inertia in SI units, which it keeps in `units`.

        Parameters
        ----------
        mass : float
            In kg; this and the other numbers may be texts with a unit, such as ``"85 g"``.
        inertia : 3 x 3 matrix or sequence
            Tensor of inertia about the centre of mass in kg m^2: the matrix, or its entries ``(ixx,
            iyy, izz, ixy, ixz, iyz)``, of which the last three may be left out.  Off the diagonal
            stands ``ixy = -sum(m x y)``.  The z axis is vertical, x and y are any.
        height : float
            Of the centre of mass over the point of contact, ``a``, in m.
        radii : two floats
            Principal radii of curvature at the bottom, in m, or as in ``"50, 1.5 cm"``; those of an
            ellipsoid with horizontal semi-axes ``p, q`` and vertical one ``c`` are ``p^2/c,
            q^2/c``.
        axes_angle : float
            Angle in radians from the x axis towards the y axis to the direction along which the
            surface bends by the first of them.
        c : float, optional
            Vertical semi-axis of an ellipsoid, in m; without it the bottom is a paraboloid.
        gravity : float
            In m/s^2.
        z_up : bool
            Whether the z axis points up, as CAD programs have it; here it points down, so that
            seen from above y is clockwise from x.

        Raises
        ------
        ValueError
            If no rigid body is so, or it cannot stand.

        Examples
        --------
        >>> import rattlesweep as rs
        >>> stone = rs.Rattleback.from_si(
        ...     mass=0.085, height=0.01, radii=(0.5, 0.015), axes_angle=0.03,
        ...     inertia=(6.0e-6, 9.0e-5, 9.2e-5),
        ... )
        >>> round(stone.alpha, 2), round(stone.xi, 2), round(stone.units.time, 4)
        (11.59, 0.03, 0.0319)
        """
        measured = {
            name: si.number(value, kind, name)
            for name, value, kind in (
                ("mass", mass, "mass"),
                ("height", height, "length"),
                ("gravity", gravity, "acceleration"),
            )
        }
        for name, value in measured.items():
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} is {value:g}; it must be positive")
        if isinstance(radii, str):
            try:
                radii = quantities(radii, "length", 2)
            except ValueError as error:
                raise ValueError(f"radii: {radii!r} {error}") from None
        if len(radii) != 2:
            raise ValueError(f"radii: two are needed, and not {len(radii)}")
        lengths = [si.number(radius, "length", "radii") for radius in radii]
        for radius in lengths:
            if not (math.isfinite(radius) and radius > measured["height"]):
                raise ValueError(
                    f"radii: {radius:g} m is not above the height {measured['height']:g} m, so "
                    "the body would tip over"
                )
        tensor = np.array(si.components(inertia))
        angle = si.number(axes_angle, "angle", "axes_angle")
        if z_up:
            # Seen from the other side.
            tensor[3], angle = -tensor[3], -angle
        found = si.parameters(measured["mass"], tensor, measured["height"], lengths, angle)
        values: dict[str, Any] = {name: float(value) for name, value in found.items()}
        if c is not None:
            values["c"] = si.number(c, "length", "c") / measured["height"]
        units = Units(measured["mass"], measured["height"], measured["gravity"])
        return cls(**values, units=units)

    @classmethod
    def half_ellipsoid(
        cls,
        *,
        length: float | str,
        width: float | str,
        height: float | str,
        mass: float | str,
        skew: float | str = 0.0,
        weights: float | str | None = None,
        at: Sequence[float | str] | str | None = None,
        gravity: float | str = si.GRAVITY,
    ) -> Rattleback:
        """A solid half ellipsoid with its flat side up, as a ruler and a scale measure it.

        Parameters
        ----------
        length, width, height : float
            Of the flat side, and from the lowest point up to it, in m; these and the other numbers
            may be texts with a unit, such as ``"12 cm"``.
        mass : float
            In kg, without the weights.
        skew : float
            Angle in radians by which the axes of inertia are turned against those of the surface,
            clockwise seen from above, of a body whose base is cut at an angle; ``xi = -skew``.
        weights : float, optional
            Mass in kg of each of two equal weights on the flat side, such as coins, which turn the
            axes of inertia too.  They count as points.
        at : two floats, optional
            Place of one weight in m from the middle of the flat side, seen from above: to the right
            along the length, and away across it; or as in ``"45, -9 mm"``.  The other one lies
            opposite.
        gravity : float
            In m/s^2.

        Raises
        ------
        ValueError
            If the body cannot stand, or has no skew.

        Notes
        -----
        See :func:`rattlesweep.physics.shapes.half_ellipsoid`.  The surface is the ellipsoid's.

        Examples
        --------
        >>> import rattlesweep as rs
        >>> stone = rs.Rattleback.half_ellipsoid(
        ...     length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg"
        ... )
        >>> round(stone.alpha, 2), round(stone.theta, 2), round(stone.xi, 4)
        (13.95, 0.4, -0.0524)
        """
        values, units = shapes.measured(
            length=length, width=width, height=height, mass=mass, skew=skew, weights=weights,
            at=at, gravity=gravity,
        )  # fmt: skip
        return cls(**values, units=units)

    def replace(self, **parameters: Any) -> Rattleback:
        """Return the body with other values of some parameters, such as ``theta=0.82``.

        Raises
        ------
        ValueError
            If a name is no parameter, or if no such body exists.
        """
        names = [f.name for f in fields(self)]
        for name in parameters:
            if name not in names:
                raise ValueError(f"{name}: is no parameter of a body; there are {', '.join(names)}")
        return replace(self, **parameters)

    def mirrored(self) -> Rattleback:
        """Reflection in the x-z plane: the steady and the unsteady direction change places."""
        return replace(self, xi=-self.xi)


PRESETS: dict[str, Callable[[], Rattleback]] = {"GH": Rattleback.gh, "KL": Rattleback.kl}
"""Bodies of the literature."""


MAX_INERTIA = 1e6
"""Moments of inertia in ``M a^2`` are at most this: the body is then 1000 times as wide as high."""


def shell_dumbbell(gamma: T, f_sd: T) -> tuple[T, T]:
    """``alpha`` and ``beta`` of shell-dumbbell bodies; the sampler compiles it for scalars."""
    return (1 - f_sd) * gamma + 1, f_sd * gamma + 1


def violations(
    alpha: ArrayLike,
    beta: ArrayLike,
    gamma: ArrayLike,
    theta: ArrayLike,
    phi: ArrayLike,
    xi: ArrayLike,
    c: ArrayLike | None = None,
) -> Iterator[tuple[int, str]]:
    """What is wrong with bodies: the first offender of each rule, as (place, sentence).

    ``c`` is NaN, or None for all of them, where the surface is a paraboloid.
    """
    alpha, beta, gamma, theta, phi, xi = (
        np.atleast_1d(np.asarray(x, float)) for x in (alpha, beta, gamma, theta, phi, xi)
    )
    c = np.broadcast_to(np.asarray(np.nan if c is None else c, float), alpha.shape)
    i_xx, i_yy = alpha - 1, beta - 1
    slack = _TRIANGLE * (alpha + gamma)
    both = "0 < phi < theta < 1 is needed"
    rules: tuple[tuple[NDArray[np.bool_], Callable[[int], str]], ...] = (
        (np.isfinite(alpha + beta + gamma + theta + phi + xi),
         lambda i: "a parameter is not a finite number"),
        (np.maximum(alpha, gamma) <= MAX_INERTIA,
         lambda i: f"the moment of inertia {max(alpha[i], gamma[i]):g} M a^2 is out of range; "
                   f"at most {MAX_INERTIA:g} is allowed"),
        (phi > 0, lambda i: f"phi is {phi[i]:g}; {both}"),
        (theta < 1, lambda i: f"theta is {theta[i]:g}; {both}"),
        (phi < theta, lambda i: f"phi {phi[i]:g} is not below theta {theta[i]:g}; {both}"),
        (beta > 1, lambda i: f"beta is {beta[i]:g}; alpha > beta > 1 is needed"),
        (alpha > beta,
         lambda i: f"alpha {alpha[i]:g} is not above beta {beta[i]:g}; alpha > beta > 1 is needed"),
        (gamma > 0, lambda i: f"gamma is {gamma[i]:g}; it must be positive"),
        ((xi != 0) & (np.abs(xi) < np.pi / 2),
         lambda i: f"xi is {xi[i]:g} rad; -pi/2 < xi < 0 is needed, or xi > 0 for a mirror image"),
        (i_xx <= i_yy + gamma + slack,
         lambda i: f"no body has this inertia: I_xx = alpha - 1 = {i_xx[i]:g} exceeds "
                   f"I_yy + I_zz = {i_yy[i] + gamma[i]:g}"),
        (gamma <= i_xx + i_yy + slack,
         lambda i: f"no body has this inertia: I_zz = gamma = {gamma[i]:g} exceeds "
                   f"I_xx + I_yy = {i_xx[i] + i_yy[i]:g}"),
        (~(c <= 0) & (c < np.inf) | np.isnan(c),
         lambda i: f"c is {c[i]:g}; the vertical semi-axis must be positive and finite"),
        # Lying on its side, its centre of mass is at the height sqrt(c/theta).
        (~(c <= theta),
         lambda i: f"c {c[i]:g} is not above theta {theta[i]:g}: the ellipsoid's horizontal "
                   f"semi-axis sqrt(c/theta) = {np.sqrt(max(c[i], 0) / theta[i]):g} must exceed "
                   "the height 1 of the centre of mass, or the body would rather lie on its side"),
    )  # fmt: skip
    for good, sentence in rules:
        bad = np.flatnonzero(~good)
        if bad.size:
            place = int(bad[0])
            yield place, sentence(place)
