"""A mesh with fewer triangles, for pictures of it."""

from __future__ import annotations

import math

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.physics.mesh.solid import Solid, packed

_WIDER = 1.08  # step of the size of a cell


def with_fewer_faces(solid: Solid, most: int) -> Solid:
    """Return a mesh with at most so many triangles, which may be open.

    All vertices in one cell of a cubic lattice become one of them: the one where the
    mesh has the sharpest edge, so that outlines stay where they are.
    """
    if len(solid.faces) <= most:
        return solid
    sharpest_first = np.argsort(-_sharpness(solid), kind="stable")
    low = solid.vertices.min(axis=0)
    a, b, c = solid.corners
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
    # Two triangles fill the square of a cell.
    cell = math.sqrt(2 * area / most)
    faces = solid.faces
    kept = sharpest_first
    while True:
        keys = packed(solid.vertices[sharpest_first], low, cell)
        _, first, which = np.unique(keys, return_index=True, return_inverse=True)
        cell_of = np.empty(len(which), dtype=np.int64)
        cell_of[sharpest_first] = which
        faces = cell_of[solid.faces]
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]
        kept = sharpest_first[first]
        if len(faces) <= most:
            return Solid(solid.vertices[kept], faces)
        cell *= _WIDER


def _sharpness(solid: Solid) -> Floats:
    """Return how far the triangles of a vertex are from one plane, 0 to 2."""
    a, b, c = solid.corners
    normals = np.cross(b - a, c - a)
    sums = np.zeros_like(solid.vertices)
    for corner in range(3):
        np.add.at(sums, solid.faces[:, corner], normals)
    sums /= np.maximum(np.linalg.norm(sums, axis=1), 1e-300)[:, None]
    sizes = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    least = np.ones(len(solid.vertices))
    for corner in range(3):
        owner: Integers = solid.faces[:, corner]
        cosine = np.einsum("ij,ij->i", normals, sums[owner]) / sizes
        np.minimum.at(least, owner, cosine)
    # Coarse steps, so that a smooth part has no favourites.
    return np.round(1 - least, 2)
