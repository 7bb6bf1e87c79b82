"""Rattlebacks: their parameters, where these come from, and what they must satisfy.

Stability: stable.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rattlesweep.arrays import Floats, with_plain_numbers
from rattlesweep.physics import si
from rattlesweep.physics.mesh.oddities import doubts_of
from rattlesweep.physics.mesh.pose import MeshPose
from rattlesweep.physics.mesh.reading import read_standing
from rattlesweep.physics.mesh.standing import Standing
from rattlesweep.physics.si import Units
from rattlesweep.system.files import as_path
from rattlesweep.words.defaults import MESH_UNIT
from rattlesweep.words.errors import ConfigWarning
from rattlesweep.words.quantities import MAX_INERTIA
from rattlesweep.words.units import InSI, require_unit

_T = TypeVar("_T", float, Floats)
PARAMETERS = ("alpha", "beta", "gamma", "theta", "phi", "xi")


@dataclass(frozen=True)
class Rattleback:
    """A rattleback in the units M = a = g = 1 (Eqs. 4-6 and 14).

    Stability: stable.

    Parameters
    ----------
    alpha, beta, gamma : float
        ``I_xx + 1``, ``I_yy + 1`` and ``I_zz`` in ``M a^2``; ``alpha > beta > 1``.
    theta, phi : float
        Principal curvatures at the bottom, in ``1/a``; ``0 < phi < theta < 1``.
    xi : float
        Skew angle in radians, in (-pi/2, 0); in (0, pi/2) for a mirror image.
    c : float, optional
        Vertical semi-axis of an ellipsoid, in ``a``, above ``theta``; the default is a
        paraboloid.
    rim : float, optional
        Height of the rim above the lowest point, in ``a``, where the surface ends, as
        at the flat side of a half ellipsoid; the default is a surface without an end.
    units : Units, optional
        SI size of the units, for bodies given in SI units.  Comparison ignores it.
    pose : Pose, optional
        Where the mesh is of which the body was made, so that ``show`` can draw it.

    Raises
    ------
    ValueError
        If a parameter is not a number or out of range, or if no mass distribution has
        this inertia.
    """

    alpha: float
    beta: float
    gamma: float
    theta: float
    phi: float
    xi: float
    c: float | None = None
    rim: float | None = field(default=None, repr=False, kw_only=True)
    units: Units | None = field(default=None, compare=False, repr=False, kw_only=True)
    pose: MeshPose | None = field(default=None, compare=False, repr=False, kw_only=True)

    def __post_init__(self) -> None:
        with_plain_numbers(self)
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.compare}
        for name, value in values.items():
            if name in PARAMETERS or value is not None:
                _require_number(name, value)
        rim = values.pop("rim")
        if rim is not None and not 0 < rim < math.inf:
            raise ValueError(f"rim is {rim:g}; it must be positive and finite")
        if not isinstance(self.units, Units | None):
            raise ValueError(
                f"units: {str(self.units)[:40]} is not a Units; see from_si"
            )
        for _, sentence in violations(**values):
            raise ValueError(sentence)

    @classmethod
    def gh(cls) -> Rattleback:
        """Return the body of Garcia and Hubbard (1988), GH in Table I of the paper."""
        return cls(13.04, 1.522, 12.28, 0.6429, 0.0360, -math.radians(1.72))

    @classmethod
    def kl(cls) -> Rattleback:
        """Return Kane and Levinson's ellipsoid (1982): semi-axes 20, 3, 2 cm; 1 kg."""
        # Moments of inertia about the long and the short axis of the surface, and their
        # product.
        along, across, product = 2.0, 16.0, -0.2
        mean = (across + along) / 2
        half = math.hypot((across - along) / 2, product)
        return cls(
            alpha=mean + half + 1,
            beta=mean - half + 1,
            gamma=17.0,
            theta=2 / 3**2,
            phi=2 / 20**2,
            xi=0.5 * math.atan2(2 * product, across - along),
            c=2.0,
            units=Units(mass=1.0, length=0.01),
        )

    @overload
    @classmethod
    def shell_dumbbell(
        cls, *, gamma: float, f_sd: float, theta: float, phi: float, xi: float
    ) -> Rattleback: ...

    @overload
    @classmethod
    def shell_dumbbell(
        cls,
        *,
        gamma: ArrayLike,
        f_sd: ArrayLike,
        theta: ArrayLike,
        phi: ArrayLike,
        xi: ArrayLike,
    ) -> NDArray[np.object_]: ...

    @classmethod
    def shell_dumbbell(
        cls, *, gamma: Any, f_sd: Any, theta: Any, phi: Any, xi: Any
    ) -> Rattleback | NDArray[np.object_]:
        """Return a shell-dumbbell body (Eqs. 62-67), or an array of them for arrays.

        Arrays are broadcast by NumPy's rules.  Raise ValueError unless ``0 < f_sd <
        0.5``.
        """
        arguments = {"gamma": gamma, "f_sd": f_sd, "theta": theta, "phi": phi, "xi": xi}
        given: dict[str, Any] = {}
        for name, value in arguments.items():
            kind = "angle" if name == "xi" else ""
            given[name] = si.plain(name, value, kind)
        if all(np.ndim(value) == 0 for value in given.values()):
            for name in ("gamma", "f_sd"):
                _require_number(name, given[name])
            share = given["f_sd"]
            if not 0 < share < 0.5:
                raise ValueError(f"f_sd is {share:g}; it must lie between 0 and 0.5")
            alpha, beta = shell_dumbbell(given["gamma"], share)
            shape = {name: given[name] for name in ("gamma", "theta", "phi", "xi")}
            return cls(alpha, beta, **shape)
        columns = np.broadcast_arrays(*given.values())
        bodies = np.empty(columns[0].shape, dtype=object)
        for place in np.ndindex(bodies.shape):
            values = (column[place] for column in columns)
            bodies[place] = cls.shell_dumbbell(**dict(zip(given, values, strict=True)))
        return bodies

    @classmethod
    def from_si(
        cls,
        *,
        mass: float | str,
        inertia: Sequence[float] | Sequence[Sequence[float]] | str,
        height: float | str,
        radii: Sequence[float | str] | str,
        axes_angle: float | str = 0.0,
        c: float | str | None = None,
        gravity: float | str = si.GRAVITY,
        z_up: bool = False,
    ) -> Rattleback:
        """Return a body given in SI units.

        Every quantity may be a number in SI units or a text such as ``"85 g"``.

        Parameters
        ----------
        mass, height, gravity : float or str
            In kg, m and m/s^2; ``height`` is ``a``, from the contact up to the centre
            of mass.
        inertia : sequence of float, or str
            Inertia tensor about the centre of mass in kg m^2, with z vertical: a 3 x 3
            matrix, or ``(ixx, iyy, izz, ixy, ixz, iyz)`` with ``ixy = -sum(m x y)``, of
            which the last three may be left out, also as a text such as ``"60, 900, 920
            g cm^2"``.
        radii : two floats or str
            Principal radii of curvature at the bottom, in m, or a text such as ``"50,
            1.5 cm"``.
        axes_angle : float or str
            Angle in radians, from the x axis towards the y axis, of the direction in
            which the surface has the first radius.
        c : float or str, optional
            Vertical semi-axis of an ellipsoid, in m.  Without it the surface is a
            paraboloid.
        z_up : bool
            Whether the z axis points up, as in CAD programs.  It points down otherwise,
            so that the y axis is clockwise from the x axis when seen from above.

        Raises
        ------
        ValueError
            If a value is not of the kind needed or is out of range, the z axis is not a
            principal axis, or no body has such parameters.

        Examples
        --------
        >>> import rattlesweep as rs
        >>> moments = (6.0e-6, 9.0e-5, 9.2e-5)
        >>> stone = rs.Rattleback.from_si(
        ...     mass="85 g", height="1 cm", radii="50, 1.5 cm", axes_angle=0.03,
        ...     inertia=moments)
        >>> round(stone.alpha, 2), round(stone.xi, 2), round(stone.units.time, 4)
        (11.59, 0.03, 0.0319)
        """
        m = si.size(mass, "mass", "mass")
        a = si.size(height, "length", "height")
        lengths = [
            si.size(x, "length", "radii") for x in si.two_lengths(radii, "radii")
        ]
        if not a < min(lengths):
            raise ValueError(
                f"radii: {min(lengths):g} m is not above the height {a:g} m"
            )
        tensor = np.array(si.components(inertia))
        angle = si.number(axes_angle, "angle", "axes_angle")
        if z_up:  # a downward z axis reverses the sense of angles
            tensor[3] = -tensor[3]
            angle = -angle
        body = si.parameters(m, tensor, a, lengths, angle)
        semi_axis = None
        if c is not None:
            semi_axis = si.number(c, "length", "c") / a
        units = Units(m, a, si.size(gravity, "acceleration", "gravity"))
        values = {name: float(value) for name, value in body.items()}
        made = cls(**values, c=semi_axis, units=units, pose=None)
        for doubt in si.doubts(units, values["gamma"], values["xi"]):
            warnings.warn(doubt, ConfigWarning, stacklevel=2)
        return made

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
        wall: float | str | None = None,
        gravity: float | str = si.GRAVITY,
    ) -> Rattleback:
        """Return a half ellipsoid of uniform density, solid or hollow, flat side up.

        A run ends with the status ``rim`` where it rolls past the edge of that side.
        A quantity is a text such as ``"12 cm"``, or one of Pint; a number needs a unit.

        Parameters
        ----------
        length, width, height : str
            Axes of the flat side, and its height above the lowest point.
        mass, gravity : str
            Mass without the weights, and gravity.
        skew : float or str
            Angle by which the axes of inertia are turned against those of the surface,
            clockwise when seen from above; a number is in radians.  Without weights
            ``xi = -skew``.
        weights : str, optional
            Mass of each of two equal point weights on the flat side.
        at : two of str, or str, optional
            Position of one weight on the flat side, as ``"45, -9 mm"``: to the right
            along the length, then away from the viewer.  The other weight lies
            opposite.
        wall : str, optional
            Thickness of an open shell, whose cavity is a half ellipsoid with axes
            shorter by this.  Without it the body is solid.

        Raises
        ------
        ValueError
            If a value is not of the kind needed or is out of range, a weight lies off
            the flat side, or no body has such parameters.

        Examples
        --------
        >>> import rattlesweep as rs
        >>> stone = rs.Rattleback.half_ellipsoid(
        ...     length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg")
        >>> round(stone.alpha, 2), round(stone.theta, 2), round(stone.xi, 4)
        (13.95, 0.4, -0.0524)
        """
        given = {"length": length, "width": width, "height": height, "wall": wall}
        for name, value in given.items():
            require_unit(name, value, "length", of_size=True)
        for name, value in {"mass": mass, "weights": weights}.items():
            require_unit(name, value, "mass", of_size=True)
        require_unit("at", at, "length", of_size=True)
        require_unit("gravity", _of_earth(gravity), "acceleration", of_size=True)
        sizes = {
            "length": si.size(length, "length", "length"),
            "width": si.size(width, "length", "width"),
            "height": si.size(height, "length", "height"),
            "mass": si.size(mass, "mass", "mass"),
            "skew": si.size(skew, "angle", "skew"),
        }
        if (weights is None) != (at is None):
            raise ValueError("weights and at belong together")
        if weights is not None and at is not None:
            x, y = si.two_lengths(at, "at")
            if not (2 * x / sizes["length"]) ** 2 + (2 * y / sizes["width"]) ** 2 <= 1:
                raise ValueError(
                    f"at: ({x:g} m, {y:g} m) is beyond the edge of the flat side"
                )
            sizes["weights"] = si.size(weights, "mass", "weights")
            sizes |= {"x": x, "y": y}
        outside = {name: sizes[name] for name in ("length", "width", "height")}
        if wall is not None:
            sizes["wall"] = outside["wall"] = si.size(wall, "length", "wall")
            thinnest = min(sizes["length"] / 2, sizes["width"] / 2, sizes["height"])
            if sizes["wall"] >= thinnest:
                raise ValueError(
                    f"wall: {1e3 * sizes['wall']:g} mm is not thinner than the stone, "
                    f"which has {1e3 * thinnest:g} mm from its middle to its surface; "
                    "leave wall out if it is solid"
                )
        si.check_density(sizes["mass"], si.half_ellipsoid_volume(**outside))
        body = {
            name: float(value) for name, value in si.half_ellipsoid(**sizes).items()
        }
        if not body["theta"] < 1:
            raise ValueError(
                "height: the body tips over; make it lower, or longer and wider"
            )
        if body["xi"] == 0:
            raise ValueError("skew: both directions are alike; give a skew or weights")
        g = si.size(gravity, "acceleration", "gravity")
        units = Units(body.pop("mass"), body.pop("height"), g)
        return cls(**body, rim=body["c"], units=units, pose=None)

    @classmethod
    def from_mesh(
        cls,
        path: str | os.PathLike[str],
        unit: str = MESH_UNIT,
        *,
        mass: float | str | None = None,
        density: float | str | None = None,
        points: Sequence[tuple[float | str, Sequence[float | str] | str]] = (),
        up: Sequence[float] | None = None,
        gravity: float | str = si.GRAVITY,
    ) -> Rattleback:
        """Return the body of a closed mesh, such as one for a 3D printer.

        Mass, centre and inertia are those of a solid of uniform density.  The body
        rests where its centre of mass is lowest, and a quadric through the lowest
        points of its convex hull gives the radii, their axes and the ellipsoid.  If it
        has a large flat side, a run ends with the status ``rim`` where it rolls past
        its edge.

        Parameters
        ----------
        path : str or path
            STL, OBJ, PLY or 3MF file; needs ``pip install 'rattlesweep[mesh]'``.
        unit : str
            Unit of the file.
        mass, density : str
            Weighed mass without the points, or else density, with units.
        points : sequence of (mass, (x, y, z))
            Point masses with units, such as coins.  Numbers of a place are in the
            `unit` and the frame of the mesh.
        up : three floats, optional
            Direction of the mesh that is up, roughly.  Without it, that of the largest
            flat side, or else the z axis.
        gravity : str
            Gravity.

        Raises
        ------
        ValueError
            If the file cannot be read, the mesh is open or inside out, its shells
            overlap or are two bodies, its size or density is absurd, it rests on no
            point, or no principal axis of inertia is vertical to within 3 degrees.

        Warns
        -----
        ConfigWarning
            If the radii change by more than 5 % with the part of the bottom that is
            fitted, parts of the file are left out or cut out, or the body may differ
            from the real one in another way.

        Examples
        --------
        >>> stone = rs.Rattleback.from_mesh(
        ...     "stone.stl", mass="60 g", points=[("7.5 g", (45, -9, 0))]
        ... )  # doctest: +SKIP
        """
        require_unit("mass", mass, "mass", of_size=True)
        require_unit("density", density, "density", of_size=True)
        require_unit("gravity", _of_earth(gravity), "acceleration", of_size=True)
        for point in points:
            if isinstance(point, list | tuple) and point:
                require_unit("points", point[0], "mass", of_size=True)
        standing = read_standing(path, unit, mass, density, points, up, gravity)
        for doubt in doubts_of(standing):
            warnings.warn(doubt, ConfigWarning, stacklevel=2)
        pose = MeshPose.of(as_path(path, "mesh"), unit, standing)
        g = si.number(gravity, "acceleration", "gravity")
        return cls.of_standing(standing, g, pose)

    @classmethod
    def of_standing(
        cls,
        standing: Standing,
        gravity: float = si.GRAVITY,
        pose: MeshPose | None = None,
    ) -> Rattleback:
        """Return the body of a solid that stands on the table."""
        units = Units(standing.mass.mass, standing.height, gravity)
        return cls(**standing.parameters, units=units, pose=pose)

    def replace(self, **parameters: Any) -> Rattleback:
        """Return the body with some parameters changed, such as ``theta=0.82``."""
        return replace(self, pose=None, **parameters)

    def mirrored(self) -> Rattleback:
        """Return the mirror image, whose steady and unsteady spins are exchanged."""
        return replace(self, pose=None, xi=-self.xi)


PRESETS: dict[str, Callable[[], Rattleback]] = {
    "GH": Rattleback.gh,
    "KL": Rattleback.kl,
}


def _of_earth(gravity: float | str) -> object:
    """Return a gravity, or its default as a number in SI units."""
    if gravity == si.GRAVITY:
        return InSI(gravity)
    return gravity


def _require_number(name: str, value: Any) -> None:
    if not isinstance(value, Real):
        raise ValueError(
            f"{name}: {str(value)[:40]} ({type(value).__name__}) is not a number"
        )


def shell_dumbbell(gamma: _T, f_sd: _T) -> tuple[_T, _T]:
    """Return ``alpha`` and ``beta`` of shell-dumbbell bodies (Eq. 67)."""
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
    """Yield the place of the first body that breaks a rule, and a message, by rule.

    Arguments are numbers or arrays over bodies; ``c`` is NaN, or None for all, for a
    paraboloid.
    """
    alpha, beta, gamma, theta, phi, xi = (
        np.atleast_1d(np.asarray(x, float))
        for x in (alpha, beta, gamma, theta, phi, xi)
    )
    c = np.broadcast_to(np.asarray(np.nan if c is None else c, float), alpha.shape)
    i_xx = alpha - 1
    i_yy = beta - 1
    # Shell-dumbbell bodies have I_zz = I_xx + I_yy, and half of them exceed it by
    # rounding.
    slack = 1e-12 * (alpha + gamma)
    values = {
        "alpha": alpha,
        "beta": beta,
        "gamma": gamma,
        "theta": theta,
        "phi": phi,
        "xi": xi,
        "c": c,
        "xi_deg": np.degrees(xi),
        "i_xx": i_xx,
        "yy_zz": i_yy + gamma,
        "xx_yy": i_xx + i_yy,
    }
    rules = (
        *(
            (np.isfinite(values[name]), f"{name} is not a finite number")
            for name in PARAMETERS
        ),
        (~np.isinf(c), "c is not a finite number"),
        (
            np.maximum(alpha, gamma) <= MAX_INERTIA,
            f"a moment of inertia is out of range; at most {MAX_INERTIA:g} M a^2 is "
            "allowed",
        ),
        (
            (phi > 0) & (theta < 1),
            "theta is {theta:g} and phi {phi:g}; 0 < phi < theta < 1 is needed, or it "
            "tips over",
        ),
        (
            phi < theta,
            "phi {phi:g} is not below theta {theta:g}; 0 < phi < theta < 1 is needed",
        ),
        (beta > 1, "beta is {beta:g}; alpha > beta > 1 is needed"),
        (
            alpha > beta,
            "alpha {alpha:g} is not above beta {beta:g}; alpha > beta > 1 is needed",
        ),
        (gamma > 0, "gamma is {gamma:g}; it must be positive"),
        (
            xi != 0,
            "the skew angle xi is 0 rad; -pi/2 < xi < 0 is needed, or xi > 0 for a "
            "mirror image",
        ),
        (
            np.abs(xi) < np.pi / 2,
            "the skew angle xi is {xi:g} rad ({xi_deg:g} deg); above -90 deg and below "
            "90 deg is needed; at 90 deg, the radii of curvature may be exchanged",
        ),
        (
            i_xx <= i_yy + gamma + slack,
            "no body has this inertia: I_xx = alpha - 1 = {i_xx:{digits}g} "
            "exceeds I_yy + I_zz = {yy_zz:{digits}g}",
        ),
        (
            gamma <= i_xx + i_yy + slack,
            "no body has this inertia: I_zz = gamma = {gamma:{digits}g} "
            "exceeds I_xx + I_yy = {xx_yy:{digits}g}",
        ),
        # Lying on its side, the ellipsoid has its centre of mass at the height
        # sqrt(c/theta).
        (
            ~(c <= theta),
            "c {c:g} is not above theta {theta:g}: the ellipsoid would tip onto its "
            "side",
        ),
    )
    for is_kept, message in rules:
        broken = np.flatnonzero(~is_kept)
        if broken.size:
            first = int(broken[0])
            numbers = {name: column[first] for name, column in values.items()}
            text = message.format(**numbers, digits=".6")
            if not is_told_apart(text):
                # Moments that differ beyond the digits that are usual.
                text = message.format(**numbers, digits=".16")
            yield first, text


def is_told_apart(sentence: str) -> bool:
    """Return whether a sentence on a number that exceeds another shows two numbers."""
    larger, _, smaller = sentence.partition(" exceeds ")
    return larger.rpartition(" = ")[2] != smaller.rpartition(" = ")[2] or not smaller
