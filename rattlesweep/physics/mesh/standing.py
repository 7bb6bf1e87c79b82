"""A solid at rest on the table: where it stands, and on which curvature.

Stable poses of a polyhedron are of no use here, as each facet of a fine mesh may be
one.  So the body first rolls downhill over the support height of its vertices, by steps
that are longer than facets.  Then it is turned until the smooth surface that is fitted
to its lowest points has a normal through the centre of mass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics import si
from rattlesweep.physics.mesh.bottom import LEAST_POINTS, Quadric, fit_quadric, foot
from rattlesweep.physics.mesh.solid import MassProperties, Solid, basis

# A launch whose energy, all in an oscillation, tells how far the bottom is fitted.
TYPICAL_SPIN = 2 * math.pi  # one turn a second
DOWNHILL_STEPS = np.radians([8.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.1])  # of the way downhill
FINE_STEP = math.radians(0.4)  # such steps look at all vertices, wider ones at fewer
MANY_VERTICES = 12_000  # more than these tell nothing more
FOOT = 0.01  # of the height of a solid, around its foot
ROUNDS = 60  # of turning the body and fitting its bottom
MOST_TILT = math.radians(3.0)  # of the third principal axis
MOST_FLAT = 0.5  # of the fitted slope, on a flat facet
MOST_WEIGHT = 0.2  # of a remedy, in masses of the body
RANGES = (0.25, 2.25)  # of the height that is fitted: half and 1.5 times the slope


@dataclass(frozen=True)
class Standing:
    """A body at rest, in m and kg, with z upwards along the third row of `axes`."""

    mass: MassProperties  # in the frame of the mesh
    axes: Floats  # shape (3, 3); rows: along the long axis of inertia, across, up
    points: Floats  # lowest points of the hull from the centre of mass, along `axes`
    weights: Floats
    surface: Quadric  # at the foot, where it is level
    others: tuple[Quadric | None, ...]  # the same, fitted within `RANGES`
    rim: float | None  # height of the flat side over the foot
    flat: float  # slope of the surface at the edge of the lowest facet over the largest
    turned: float  # angle between the direction `up` that was given and that at rest
    remarks: tuple[str, ...] = ()  # sentences on how the file was understood

    @property
    def height(self) -> float:
        """The height of the centre of mass over the table."""
        return -self.surface.z0

    @property
    def inertia(self) -> Floats:
        """The inertia tensor along `axes`."""
        return self.axes @ self.mass.inertia @ self.axes.T

    @property
    def tilt(self) -> float:
        """The angle between the vertical and a principal axis of inertia."""
        return si.axis_tilt(self.inertia)

    @property
    def slopes(self) -> Floats:
        """The slopes up to which the bottom is fitted, of the smaller radius first."""
        return np.sqrt(2 * self.surface.reach / self.surface.radii)

    @property
    def semi_axis(self) -> float | None:
        """The vertical semi-axis of the ellipsoid below; None: a paraboloid."""
        k = self.surface.k
        # The term is told from zero, by its error and by what it does.
        if k > 3 * self.surface.k_error and k * self.surface.reach > 2e-3:
            return float(1 / k)
        return None

    @property
    def change(self) -> float:
        """The largest relative change of a radius with the fitted range."""
        radii = self.surface.radii
        changes = [0.0]
        for other in self.others:
            if other is not None:
                changes.append(float(np.abs(other.radii / radii - 1).max()))
        return max(changes)

    @cached_property
    def parameters(self) -> dict[str, float]:
        """The parameters of the body, with ``c`` and ``rim`` in units of its height."""
        inertia = self.inertia
        curvatures, directions = np.linalg.eigh(self.surface.curvature)
        along = directions[:, 1]  # of the smaller radius
        # The frame of the paper has z downwards, which reverses the sense of angles.
        found = si.parameters(
            self.mass.mass,
            [inertia[0, 0], inertia[1, 1], inertia[2, 2], -inertia[0, 1]],
            self.height,
            1 / curvatures[::-1],
            -math.atan2(along[1], along[0]),
        )
        values = {name: float(value) for name, value in found.items()}
        if self.semi_axis is not None:
            values["c"] = self.semi_axis / self.height
        if self.rim is not None:
            values["rim"] = self.rim / self.height
        return values

    @property
    def remedy(self) -> str:
        """Which weight would make the third principal axis vertical."""
        place, weight = self.weight_against_tilt
        if not weight < MOST_WEIGHT * self.mass.mass:
            return "move its weights closer to the middle or opposite to each other"
        x, y, z = place * 1e3
        return (
            f"add about {weight * 1e3:.2g} g at ({x:.3g}, {y:.3g}, {z:.3g}) mm of the "
            "mesh, or shave as much on the other side"
        )

    @property
    def weight_against_tilt(self) -> tuple[Floats, float]:
        """The place in the mesh, and the mass, of a weight that would make the third
        principal axis vertical, to first order.

        A weight ``dm`` at ``(r, z)`` adds ``-dm z r`` to the products of inertia ``P``
        with the vertical.  It also moves the foot, which turns the vertical by ``g = K
        (1 - a K)^-1 dm r / M``, and so adds ``(I_zz - I) g``.
        """
        inertia = self.inertia
        top = self.rim
        if top is None:
            top = 2 * self.height
        z = top - self.height
        curvature = self.surface.curvature
        turn = curvature @ np.linalg.inv(np.eye(2) - self.height * curvature)
        apart = inertia[2, 2] * np.eye(2) - inertia[:2, :2]
        change = apart @ turn / self.mass.mass - z * np.eye(2)
        moment = np.linalg.solve(change, -inertia[:2, 2])
        direction = moment / np.linalg.norm(moment)
        # As far out as the fitted part of the bottom goes.
        out = float((self.points[self.surface.fitted, :2] @ direction).max())
        place = self.mass.centre + np.array([*(out * direction), z]) @ self.axes
        return place, float(np.linalg.norm(moment) / out)


def stand(
    solid: Solid,
    mass: MassProperties,
    up: Floats | None = None,
    gravity: float = si.GRAVITY,
) -> Standing:
    """Return a solid with a mass at rest; raise a ValueError if it has no point foot.

    `up` is a direction of the mesh that is nearly vertical; without it, the outward
    normal of a large flat side, or the z axis of the mesh.
    """
    side = solid.flat_side()
    if up is None:
        up = np.array([0.0, 0.0, 1.0])
        if side is not None:
            up = side[0]
    given = up / np.linalg.norm(up)
    arms = solid.vertices - mass.centre
    up = _downhill(arms, given)
    rim: Floats | None = None
    if side is not None and side[0] @ up > 0.5:
        rim = side[1] - mass.centre
    standing = stand_on(_lowest(arms, up), mass, up, given, rim, gravity)
    return replace(standing, remarks=solid.remarks)


def stand_on(
    points: Floats,
    mass: MassProperties,
    up: Floats,
    given: Floats,
    rim: Floats | None = None,
    gravity: float = si.GRAVITY,
) -> Standing:
    """Return a body at rest whose lowest points, from the centre of mass, are known.

    `rim` are the corners of its flat side, from the centre of mass, shape (n, 3).
    """
    points, weights, planes = _hull(points, up)
    most = float(np.ptp(points @ up))
    if rim is not None:
        most = 0.6 * float((rim @ up).min() - (points @ up).min())
    if most < 1e-6 * np.ptp(points, axis=0).max():
        raise ValueError("the body comes to rest on its flat side; give `up`")
    reach = 0.25 * most
    along = np.linalg.eigh(mass.inertia)[1][:, 0]
    for _ in range(ROUNDS):
        axes = basis(up, along)
        local = points @ axes.T
        surface = fit_quadric(local, weights, reach)
        if surface is None:
            raise ValueError(
                "the body comes to rest on a flat side or on facets that are too "
                f"coarse: fewer than {LEAST_POINTS} points of the mesh lie in the "
                f"lowest {reach * 1e3:.2g} mm, or all on one curve; it needs a round "
                "bottom in fine facets"
            )
        place = foot(surface, -surface.z0)
        if place is None:
            smaller, larger = surface.radii * 1e3
            raise ValueError(
                f"the body has no stable rest on one point: its radii of curvature "
                f"are {smaller:.4g} and {larger:.4g} mm, and the centre of mass lies "
                f"{-surface.z0 * 1e3:.4g} mm high; both must be above that"
            )
        slope = surface.slope + surface.curvature @ place
        turn = np.array([*-slope, 1.0]) @ axes
        up = turn / np.linalg.norm(turn)
        # The rise of the centre of mass at the turning point of an oscillation.
        spinning = up @ mass.inertia @ up / mass.mass
        rise = spinning * TYPICAL_SPIN**2 / (2 * gravity)
        share = 1 + surface.z0 / surface.radii[0]
        wanted = min(max(rise / share, 0.02 * most), most)
        settled = abs(wanted / reach - 1) < 1e-9
        if settled and np.abs(slope).max() < 1e-10:
            break
        if abs(wanted / reach - 1) < 0.01:
            reach = wanted
        else:
            reach = math.sqrt(reach * wanted)
    else:
        raise ValueError(
            f"the body does not come to rest in {ROUNDS} rounds of turning it and "
            "fitting its bottom; its surface near the foot may be rough: export a "
            "finer or smoother mesh"
        )
    axes = basis(up, along)
    local = points @ axes.T
    others: list[Quadric | None] = []
    for share in RANGES:
        if share * reach <= 1.5 * most:
            others.append(fit_quadric(local, weights, share * reach))
        else:
            others.append(None)
    height_of_rim = None
    if rim is not None:
        height_of_rim = float((rim @ up).min() - surface.z0)
    standing = Standing(
        mass=mass,
        axes=axes,
        points=local,
        weights=weights,
        surface=surface,
        others=tuple(others),
        rim=height_of_rim,
        flat=_flat_share(points, planes, axes, surface),
        turned=math.acos(min(1.0, float(up @ given))),
    )
    _refuse(standing)
    return standing


def _refuse(standing: Standing) -> None:
    """Raise a ValueError if the foot is no point, or an axis of inertia is tilted."""
    if standing.flat > MOST_FLAT:
        raise ValueError(
            f"the body stands on a flat facet over {100 * standing.flat:.2g} % of the "
            "slope that is fitted, so not on one point; it needs a round bottom in "
            "fine facets"
        )
    if standing.tilt > MOST_TILT:
        raise ValueError(
            f"the third principal axis leans by {math.degrees(standing.tilt):.3g} deg "
            f"from the vertical, and at most {math.degrees(MOST_TILT):.2g} deg is "
            f"allowed; {standing.remedy}"
        )


def _downhill(arms: Floats, up: Floats) -> Floats:
    """Return a direction near `up` in which the centre of mass is lowest."""
    turns = np.linspace(0, 2 * math.pi, 8, endpoint=False)
    circle = np.column_stack([np.cos(turns), np.sin(turns)])
    everything = arms
    if len(arms) > MANY_VERTICES:
        arms = arms[np.random.default_rng(0).integers(len(arms), size=MANY_VERTICES)]
    height = -(arms @ up).min()
    for step in DOWNHILL_STEPS:
        if step < FINE_STEP and arms is not everything:
            arms = everything
            height = -(arms @ up).min()
        while True:
            across = circle @ basis(up)[:2]
            around = math.cos(step) * up + math.sin(step) * across
            heights = -(arms @ around.T).min(axis=0)
            best = int(np.argmin(heights))
            if heights[best] >= height:
                break
            height = heights[best]
            up = around[best]
    return up


def _lowest(arms: Floats, up: Floats) -> Floats:
    """Return the lower part of the vertices, which has the foot and its surroundings.

    The convex hull of all would take longer than everything else together.
    """
    heights = arms @ up
    low = heights.min()
    # Down from the widest part, where the outline is no longer the bottom.
    rises = (heights - low) / np.ptp(heights)
    part: Floats = arms[rises <= 0.5]
    if len(part) <= MANY_VERTICES:
        return part
    # All around the foot, where the facet below it is told from others.
    rises = rises[rises <= 0.5]
    share = MANY_VERTICES / len(part)
    is_kept = np.random.default_rng(0).random(len(part)) < share
    return part[is_kept | (rises <= FOOT)]


def _hull(points: Floats, up: Floats) -> tuple[Floats, Floats, Floats]:
    """Return vertices of the convex hull, the areas around them, and its planes.

    A plane has the outward normal and the offset of Qhull, shape (planes, 4).
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        raise ValueError(
            "the body comes to rest on a flat side; it needs a round bottom"
        ) from None
    is_low = hull.equations[:, :3] @ up < -1e-9
    simplices = hull.simplices[is_low]
    a, b, c = points[simplices.T]
    # Projected on the table.
    areas = np.abs(np.cross(b - a, c - a) @ up) / 2
    weights = np.zeros(len(points))
    np.add.at(weights, simplices.ravel(), np.repeat(areas / 3, 3))
    kept = np.flatnonzero(weights > 0)
    # In no order, so that the first ones are spread over the bottom.
    kept = np.random.default_rng(0).permutation(kept)
    return points[kept], weights[kept], hull.equations[is_low]


def _flat_share(
    points: Floats, planes: Floats, axes: Floats, surface: Quadric
) -> float:
    """Return the slope at the edge of the lowest facet over that of the fitted edge.

    The lowest facet is the one below the centre of mass.
    """
    heights = -planes[:, 3] / (planes[:, :3] @ axes[2])
    *normal, offset = planes[np.argmax(heights)]
    distances = np.abs(points @ normal + offset)
    facet = points[distances <= 3e-7 * np.ptp(points, axis=0).max()] @ axes[:2].T
    rise = np.einsum("ij,jk,ik->i", facet, surface.curvature, facet) / 2
    return float(np.sqrt(rise.max() / surface.reach))
