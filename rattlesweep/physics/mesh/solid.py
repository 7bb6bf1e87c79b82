"""Closed meshes of triangles, and their mass, centre and inertia."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Floats, Integers

# Vertices closer than this share of the longest side are one: a mesh in STL repeats
# each vertex in all of its triangles, in single precision.
MERGED = 2.0**-20
# The flat side, in shares of the longest side of the mesh.
SAME_PLANE = 2e-4  # between normals, and heights, of triangles in one plane
LEAST_OF_PLANE = np.array([-1.0, -1.0, -1.0, -4.0])  # of a normal and a height
FLAT_SIDE = 1e-4  # of what lies in a plane
LINE = 1e-6  # a side that is not wider is a line
LEAST_SIDE = 1 / 3  # of the rectangle of the two longest sides
MOST_SIDES = 24  # planes that are looked at, the largest first


@dataclass(frozen=True)
class MassProperties:
    """Mass in kg, centre of mass in m, and inertia tensor about it in kg m^2."""

    mass: float
    centre: Floats  # shape (3,)
    inertia: Floats  # shape (3, 3)

    def with_points(self, points: Iterable[tuple[float, Floats]]) -> MassProperties:
        """Return the mass with further points, each a mass and a place, shape (3,)."""
        parts = [(self.mass, self.centre), *points]
        total = float(sum(mass for mass, _ in parts))
        weighted = [mass * place for mass, place in parts]
        centre: Floats = np.sum(weighted, axis=0) / total
        inertia = self.inertia.copy()
        for mass, place in parts:
            arm = place - centre
            inertia += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return MassProperties(total, centre, inertia)


@dataclass(frozen=True)
class Solid:
    """A closed mesh: vertices in m, shape (n, 3), and triangles, shape (faces, 3).

    Corners of a triangle go counterclockwise when seen from outside.
    """

    vertices: Floats
    faces: Integers
    remarks: tuple[str, ...] = ()  # sentences on how the file was understood

    @classmethod
    def of(cls, vertices: Floats, faces: Integers) -> Solid:
        """Return the solid of a mesh; raise a ValueError if it encloses none."""
        vertices, faces = _merged(np.asarray(vertices, float), np.asarray(faces))
        if not len(faces):
            raise ValueError("the mesh has no triangles")
        gaps, turned = wrong_edges(faces, len(vertices))
        if gaps:
            raise ValueError(
                f"the mesh is open: {_edges(gaps)} on an odd number of triangles, and "
                "each belongs to two in a closed mesh; close the holes"
            )
        if turned:
            raise ValueError(
                f"the triangles are not turned alike: {_edges(turned)} between one "
                "seen from outside and one seen from inside; make the normals point "
                "outwards"
            )
        solid = cls(vertices, faces)
        if solid.volume <= 0:
            count = 3 * len(faces) // 2
            raise ValueError(
                f"the mesh is inside out, with all of its {count} edges: its volume "
                f"is {solid.volume * 1e6:.4g} cm^3; turn its normals around"
            )
        return solid

    @property
    def corners(self) -> Floats:
        """The corners of the triangles, shape (3, faces, 3)."""
        return self.vertices[self.faces.T]

    @cached_property
    def volume(self) -> float:
        """The volume in m^3; negative if it is turned inwards."""
        return float(self._moments()[0])

    def _moments(self) -> tuple[Any, Floats, Floats]:
        """Return volume, first and second moments about the middle of the vertices.

        They are sums over tetrahedra with the tip in the middle, whose volume is
        negative where their base is seen from inside.  For a tetrahedron with the
        corners 0, a, b and c the second moment is its volume over 20 times ``a aT + b
        bT + c cT + s sT`` with ``s = a + b + c``.
        """
        corners = self.corners - self.vertices.mean(axis=0)
        a, b, c = corners
        volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
        total = a + b + c
        first = volumes @ total / 4
        second = np.zeros((3, 3))
        for part in (a, b, c, total):
            second += (part.T * volumes) @ part / 20
        return volumes.sum(), first, second

    def mass(
        self, mass: float | None = None, density: float | None = None
    ) -> MassProperties:
        """Return the mass of the solid, of uniform density, by its mass or density."""
        volume, first, second = self._moments()
        if mass is None:
            mass = float(volume * density)
        offset = first / volume
        second = second / volume - np.outer(offset, offset)
        inertia = mass * (np.trace(second) * np.eye(3) - second)
        return MassProperties(mass, self.vertices.mean(axis=0) + offset, inertia)

    def flat_side(self) -> tuple[Floats, Floats] | None:
        """Return the outward normal of the largest flat side, and its corners.

        All of the mesh lies on one side of it, and its convex outline fills at least
        a third of the rectangle of the two longest sides of the mesh.  None if there
        is no such side.
        """
        from scipy.spatial import ConvexHull

        middle_of_all = self.vertices.mean(axis=0)
        a, b, c = self.corners - middle_of_all
        areas = np.cross(b - a, c - a) / 2
        sizes = np.linalg.norm(areas, axis=1)
        kept = sizes > 0
        normals = areas[kept] / sizes[kept, None]
        heights = np.einsum("ij,ij->i", normals, a[kept])
        extent = np.ptp(self.vertices, axis=0)
        _, middle, longest = np.sort(extent)
        # Triangles of one plane have normal and height in common.
        planes = np.column_stack([normals, heights / longest])
        keys = packed(planes, LEAST_OF_PLANE, SAME_PLANE)
        _, first, which = np.unique(keys, return_index=True, return_inverse=True)
        area_of = np.bincount(which, weights=sizes[kept])
        best: tuple[Floats, Floats] | None = None
        best_area = LEAST_SIDE * middle * longest
        for plane in np.argsort(area_of)[::-1][:MOST_SIDES]:
            normal = normals[first[plane]]
            along = (self.vertices - middle_of_all) @ normal
            if along.max() - heights[first[plane]] > FLAT_SIDE * longest:
                continue  # something of the mesh is above it
            outline = self.vertices[along >= along.max() - FLAT_SIDE * longest]
            flat = (outline - outline[0]) @ basis(normal)[:2].T
            is_line = np.linalg.matrix_rank(flat, LINE * longest) < 2
            if len(flat) < 3 or is_line:
                continue
            hull = ConvexHull(flat)
            if hull.volume > best_area:  # of a plane figure: its area
                best = normal, outline[hull.vertices]
                best_area = hull.volume
        return best


def basis(up: Floats, along: Floats | None = None) -> Floats:
    """Return a right-handed basis with `up` as its third row, shape (3, 3).

    The first row is `along` without its part in the direction of `up`.
    """
    if along is None:
        along = np.eye(3)[np.argmin(np.abs(up))]
    first = along - (along @ up) * up
    first = first / np.linalg.norm(first)
    return np.array([first, np.cross(up, first), up])


def packed(rows: Floats, low: Floats, step: float) -> NDArray[np.int64]:
    """Return rows of up to four numbers, rounded to steps, as one integer each."""
    cells = np.rint((rows - low) / step).astype(np.int64)
    keys = np.zeros(len(rows), dtype=np.int64)
    for column in cells.T:
        keys = keys * (cells.max() + 2) + column
    return keys


def _merged(vertices: Floats, faces: Integers) -> tuple[Floats, Integers]:
    """Return a mesh in which equal vertices are one, without triangles of no area."""
    if not len(vertices) or not np.isfinite(vertices).all():
        raise ValueError("the mesh has no vertices, or one that is not finite")
    low = vertices.min(axis=0)
    step = MERGED * (vertices.max(axis=0) - low).max()
    if step == 0:
        raise ValueError("all vertices of the mesh are one point")
    keys = packed(vertices, low, step)
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    faces = which[faces]
    a, b, c = faces.T
    kept = (a != b) & (b != c) & (c != a)
    faces = faces[kept]
    used, places = np.unique(faces, return_inverse=True)
    return vertices[first[used]], places.reshape(faces.shape)


def edge_keys(
    faces: Integers, count: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return a number for the edge behind each corner, row by row, and its direction.

    Both directions of an edge have one number.  `count` is that of the vertices.
    """
    starts = faces.ravel()
    ends = np.roll(faces, -1, axis=1).ravel()
    is_forward = starts < ends
    return np.minimum(starts, ends) * count + np.maximum(starts, ends), is_forward


def wrong_edges(faces: Integers, count: int) -> tuple[int, int]:
    """Return how many edges have an odd number of triangles, and how many have as many
    triangles, but not as many in each direction.
    """
    keys, is_forward = edge_keys(faces, count)
    _, which = np.unique(keys, return_inverse=True)
    times = np.bincount(which)
    balance = np.bincount(which, weights=np.where(is_forward, 1, -1))
    is_open = times % 2 == 1
    return int(is_open.sum()), int((~is_open & (balance != 0)).sum())


def _edges(count: int) -> str:
    if count == 1:
        return "1 edge lies"
    return f"{count} edges lie"
