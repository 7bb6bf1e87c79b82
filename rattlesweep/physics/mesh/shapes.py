"""Meshes of half ellipsoids, for printing and for checks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.physics.mesh.solid import Solid
from rattlesweep.words.defaults import FINENESS

POCKET_CORNERS = 96
LEAST_WALL = 0.4e-3  # around a pocket, in m: one line of a printer
MOST_SKEW = math.radians(12.0)
_T = TypeVar("_T", float, Floats)


@dataclass(frozen=True)
class Pocket:
    """A round blind hole in the flat side, in m, for a coin or a weight."""

    x: float
    y: float
    diameter: float
    depth: float

    def circle(self, corners: int) -> Floats:
        """Return points around the edge, counterclockwise, shape (corners, 2)."""
        turn = np.arange(corners) * (2 * math.pi / corners)
        around = np.column_stack([np.cos(turn), np.sin(turn)])
        return np.array([self.x, self.y]) + self.diameter / 2 * around


def pockets_at(place: Sequence[float], size: Sequence[float]) -> list[Pocket]:
    """Return a pocket at a place, and one opposite, from diameter and depth in m."""
    x, y = place
    diameter, depth = size
    if not np.hypot(x, y) > diameter / 2:
        raise ValueError("pocket: the two overlap in the middle; move them apart")
    if not min(size) > 0:
        raise ValueError("pocket: diameter and depth must be positive")
    return [Pocket(x, y, diameter, depth), Pocket(-x, -y, diameter, depth)]


def half_ellipsoid_solid(
    length: float,
    width: float,
    height: float,
    fineness: int = FINENESS,
    skew: float = 0.0,
    pockets: Sequence[Pocket] = (),
) -> Solid:
    """Return a half ellipsoid, flat side up at z = 0, with the length along x.

    A `skew` twists it about the vertical: the base is turned counterclockwise as seen
    from above, so that the axes of inertia of the solid, without its pockets, differ by
    this angle from those of the curvature at the foot.  `fineness` is the number of
    rings from the lowest point to the flat side.
    """
    outer = np.array([length / 2, width / 2, height])
    around = 4 * fineness
    vertices, faces = bowl(outer, fineness, around)
    turned_by = twist_of(skew, length / width)
    vertices[:, :2] = _turned(
        vertices[:, :2], twist(-vertices[:, 2] / height, turned_by)
    )
    for pocket in pockets:
        _check_pocket(pocket, outer, turned_by)
    edge = np.arange(len(vertices) - around, len(vertices))
    if not pockets:
        # The flat side, around its middle.
        middle = np.full(around, len(vertices))
        lid = np.column_stack([middle, edge, np.roll(edge, -1)])
        vertices = np.vstack([vertices, np.zeros((1, 3))])
    else:
        vertices, lid = _lid(vertices, edge, pockets)
    return Solid.of(vertices, np.vstack([faces, lid]))


def twist(depth: _T, turned_by: float) -> _T:
    """Return the angle of the outline at a depth, from 0 at the flat side to 1.

    It does not change near the foot, where the outline has the axes of curvature.
    """
    return turned_by * (1 - (1 - depth) ** 3)


def twist_of(skew: float, slenderness: float) -> float:
    """Return by how much the base must be turned against the flat side for a skew.

    An outline at the depth ``s`` counts by ``(1 - s^2)^2`` in the moments of inertia.
    Raises a ValueError if no twist gives such a skew.
    """
    from scipy.optimize import brentq

    if skew == 0:
        return 0.0
    nodes, shares = np.polynomial.legendre.leggauss(40)
    depth = (nodes + 1) / 2
    shares = shares * (1 - depth**2) ** 2

    def excess(turned_by: float) -> float:
        behind = 2 * (turned_by - twist(depth, turned_by))
        return math.atan2(shares @ np.sin(behind), shares @ np.cos(behind)) / 2 - abs(
            skew
        )

    if not abs(skew) <= MOST_SKEW:
        raise ValueError(
            f"skew: {math.degrees(skew):.4g} deg is out of range; at most "
            f"{math.degrees(MOST_SKEW):.0f} deg can be made by a twist"
        )
    return math.copysign(brentq(excess, 0.0, math.pi / 2), skew)


def _turned(places: Floats, angle: Floats) -> Floats:
    """Return places turned counterclockwise, each by its angle."""
    x, y = places.T
    cos = np.cos(angle)
    sin = np.sin(angle)
    return np.column_stack([x * cos - y * sin, x * sin + y * cos])


def _check_pocket(pocket: Pocket, outer: Floats, turned_by: float) -> None:
    """Raise a ValueError if a pocket leaves less than `LEAST_WALL` around it."""
    grown = replace(pocket, diameter=pocket.diameter + 2 * LEAST_WALL)
    circle = grown.circle(POCKET_CORNERS)
    for depth in np.linspace(0, pocket.depth + LEAST_WALL, 9) / outer[2]:
        places = _turned(circle, np.full(len(circle), -twist(depth, turned_by)))
        if depth >= 1 or ((places / outer[:2]) ** 2).sum(axis=1).max() > 1 - depth**2:
            raise ValueError(
                f"pocket: {pocket.diameter * 1e3:.4g} mm wide and "
                f"{pocket.depth * 1e3:.4g} mm deep at ({pocket.x * 1e3:.4g}, "
                f"{pocket.y * 1e3:.4g}) mm leaves less than {LEAST_WALL * 1e3:g} mm of "
                "wall; make it smaller, or move it to the middle"
            )


def _lid(
    vertices: Floats, edge: Integers, pockets: Sequence[Pocket]
) -> tuple[Floats, Integers]:
    """Return vertices with those of pockets, and the triangles above the bottom.

    Neighbours on a circle that has no point inside are neighbours in the triangulation
    of Delaunay, so that each pocket is a hole in it.
    """
    from scipy.spatial import Delaunay

    places = [vertices[edge, :2]]
    # Which pocket a point of the flat side belongs to; -1: to its edge.
    owner = [np.full(len(edge), -1)]
    number = [edge]
    faces = []
    for which, pocket in enumerate(pockets):
        circle = pocket.circle(POCKET_CORNERS)
        above = len(vertices) + np.arange(POCKET_CORNERS)
        below = above + POCKET_CORNERS
        middle = np.full(POCKET_CORNERS, len(vertices) + 2 * POCKET_CORNERS)
        floor = np.vstack([circle, [[pocket.x, pocket.y]]])
        vertices = np.vstack(
            [
                vertices,
                np.column_stack([circle, np.zeros(POCKET_CORNERS)]),
                np.column_stack([floor, np.full(len(floor), -pocket.depth)]),
            ]
        )
        above_next = np.roll(above, -1)
        below_next = np.roll(below, -1)
        faces.append(np.column_stack([above, above_next, below]))
        faces.append(np.column_stack([above_next, below_next, below]))
        faces.append(np.column_stack([middle, below, below_next]))
        places.append(circle)
        owner.append(np.full(POCKET_CORNERS, which))
        number.append(above)
    flat = np.vstack(places)
    corners = Delaunay(flat).simplices
    owners = np.concatenate(owner)[corners]
    is_hole = (owners[:, 0] >= 0) & (np.ptp(owners, axis=1) == 0)
    corners = corners[~is_hole]
    a, b, c = np.moveaxis(flat[corners], 1, 0)
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (
        c[:, 0] - a[:, 0]
    )
    corners[area < 0] = corners[area < 0][:, ::-1]
    faces.append(np.concatenate(number)[corners])
    return vertices, np.vstack(faces)


def bowl(axes: Floats, rings: int, around: int) -> tuple[Floats, Integers]:
    """Return the lower half of an ellipsoid, without its flat side, seen from below.

    Vertices are the lowest point, then rings upwards with `around` points each; every
    other ring is turned by half a gap, so that triangles are alike.
    """
    depth = np.linspace(0, math.pi / 2, rings + 1)[1:]
    turn = np.arange(around) * (2 * math.pi / around)
    shift = (np.arange(rings) % 2) * (math.pi / around)
    angle = turn + shift[:, None]
    wide = np.sin(depth)[:, None]
    unit = np.stack(
        [
            wide * np.cos(angle),
            wide * np.sin(angle),
            np.broadcast_to(-np.cos(depth)[:, None], angle.shape),
        ],
        axis=-1,
    )
    unit[-1, :, 2] = 0.0
    vertices = np.vstack([[[0.0, 0.0, -1.0]], unit.reshape(-1, 3)]) * axes
    number = 1 + np.arange(rings * around).reshape(rings, around)
    following = np.roll(number, -1, axis=1)
    faces = [np.column_stack([np.zeros(around, int), following[0], number[0]])]
    for ring in range(rings - 1):
        low, high = number[ring], number[ring + 1]
        low_next, high_next = following[ring], following[ring + 1]
        if ring % 2:
            # The lower ring is turned forwards, so a point of it lies behind one above.
            faces.append(np.column_stack([low, low_next, high_next]))
            faces.append(np.column_stack([low, high_next, high]))
        else:
            faces.append(np.column_stack([low, low_next, high]))
            faces.append(np.column_stack([low_next, high_next, high]))
    return vertices, np.vstack(faces)
