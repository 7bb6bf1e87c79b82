"""Where a mesh is in the frame of the body that was made of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics.mesh.standing import Standing

# From a frame with z upwards to one with z downwards, by half a turn about x.
_OVER = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class MeshPose:
    """The file of a mesh, and the way from its frame to that of its body.

    The frame of the body has its centre of mass as the origin, z downwards, x along the
    axis of ``alpha``, and the height of the centre of mass as the unit.
    """

    path: Path
    unit: str
    centre: Floats  # of mass, in m
    turn: Floats  # shape (3, 3)

    @classmethod
    def of(cls, path: Path, unit: str, standing: Standing) -> MeshPose:
        """Return the pose of a mesh at rest."""
        over = _OVER @ standing.axes
        inertia = over @ standing.mass.inertia @ over.T
        # alpha is the larger one of the two horizontal moments.
        angle = math.atan2(2 * inertia[0, 1], inertia[0, 0] - inertia[1, 1]) / 2
        cos = math.cos(angle)
        sin = math.sin(angle)
        along = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        turn: Floats = along @ over / standing.height
        return cls(path, unit, standing.mass.centre, turn)

    def placed(self, vertices: Floats) -> Floats:
        """Return places of the mesh in m, shape (n, 3), in the frame of the body."""
        return (vertices - self.centre) @ self.turn.T

    def places_in_mesh(self, placed: Floats) -> Floats:
        """Return places in m of the mesh, from those in the frame of the body."""
        return placed @ np.linalg.inv(self.turn).T + self.centre
