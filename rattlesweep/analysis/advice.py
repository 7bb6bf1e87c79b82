"""What to change of a stone for a larger skew."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.mesh.pose import MeshPose
from rattlesweep.physics.mesh.reading import read_solid

WEIGHT_SHARE = 0.04  # of the mass of the body, for each of two weights
INWARDS = 0.85  # of the way from the middle to the edge of the upper side
TOP = 0.03  # of the height of a mesh, which counts as its upper side
SKEWED_ENOUGH = math.radians(40)  # beyond it, more skew makes the stone no livelier


@dataclass(frozen=True)
class TwoWeights:
    """Two equal weights opposite to each other on the upper side, and their skew."""

    mass: float  # of each in kg
    place: Floats  # in m, of the first one
    other: Floats
    is_of_mesh: bool  # whether places are those of a mesh, or on a flat side
    skew: float  # with them, in radians
    before: float
    at: Floats  # the first one in the frame of the body, in a

    @property
    def sentence(self) -> str:
        """The advice in words."""
        places = [
            "(" + ", ".join(f"{round(1e3 * x, 1) + 0:g}" for x in place) + ")"
            for place in (self.place, self.other)
        ]
        where = "mm of the mesh" if self.is_of_mesh else "mm on the flat side"
        return (
            f"for a larger skew: two weights of {1e3 * self.mass:.2g} g at "
            f"{' and '.join(places)} {where} make it {math.degrees(self.skew):.3g} deg "
            f"instead of {math.degrees(self.before):.3g}"
        )


def weights_for_skew(body: Rattleback) -> TwoWeights | None:
    """Return two light weights that enlarge the skew most; None without an upper side.

    Two weights at ``(x, y)`` and ``(-x, -y)`` add ``-2 m x y`` to the product of
    inertia, and move the centre of mass only upwards.  So they turn the axes of
    inertia, and not those of the surface.
    """
    if body.units is None or abs(body.xi) > SKEWED_ENOUGH:
        return None
    edge = _edge(body)
    if edge is None:
        return None
    digits = math.floor(math.log10(WEIGHT_SHARE * body.units.mass))
    mass = round(WEIGHT_SHARE * body.units.mass, -digits)
    x, y, _ = edge.T
    twice = 2 * mass / body.units.mass
    apart = body.alpha - body.beta + twice * (y**2 - x**2)
    turned = np.arctan2(-2 * twice * x * y, apart) / 2
    skews = (body.xi - turned) * math.copysign(1.0, body.xi)
    best = int(np.argmax(skews))
    if skews[best] <= abs(body.xi):
        return None
    place = edge[best]
    opposite = place * [-1, -1, 1]
    if body.pose is not None:
        places = body.pose.places_in_mesh(np.array([place, opposite]))
    else:
        along = np.array([-math.sin(body.xi), math.cos(body.xi)])
        across = np.array([math.cos(body.xi), math.sin(body.xi)])
        # Seen from above, to the right along the length and away from the viewer.
        axes = np.array([along, across])
        places = np.array([place[:2], opposite[:2]]) @ axes.T * body.units.length
    return TwoWeights(
        mass=mass,
        place=places[0],
        other=places[1],
        is_of_mesh=body.pose is not None,
        skew=float(skews[best]),
        before=abs(body.xi),
        at=place,
    )


def with_weights(body: Rattleback, weights: TwoWeights) -> Rattleback:
    """Return a body of known size with two weights on it."""
    units = body.units
    assert units is not None
    each = weights.mass / units.mass
    x, y, z = weights.at  # z counts downwards
    total = 1 + 2 * each
    # The contact is 1 below the old centre of mass, and so much below the new one.
    height = 1 - 2 * each * z / total
    risen = total * (1 - height) ** 2
    ixx = body.alpha - 1 + 2 * each * (y**2 + z**2) - risen
    iyy = body.beta - 1 + 2 * each * (x**2 + z**2) - risen
    izz = body.gamma + 2 * each * (x**2 + y**2)
    half = math.hypot((ixx - iyy) / 2, 2 * each * x * y)
    size = total * height**2
    return body.replace(
        alpha=((ixx + iyy) / 2 + half) / size + 1,
        beta=((ixx + iyy) / 2 - half) / size + 1,
        gamma=izz / size,
        theta=body.theta * height,
        phi=body.phi * height,
        xi=math.copysign(weights.skew, body.xi),
        c=None if body.c is None else body.c / height,
        rim=None if body.rim is None else body.rim / height,
        units=replace(units, mass=units.mass * total, length=units.length * height),
    )


def _edge(body: Rattleback) -> Floats | None:
    """Return places near the edge of the upper side in the frame of the body."""
    if body.pose is not None:
        return _edge_of_mesh(body.pose)
    if body.rim is None:
        return None
    # Of the quadric at the height of the rim.
    square = 2 * body.rim - (0.0 if body.c is None else body.rim**2 / body.c)
    turn = np.linspace(0, 2 * math.pi, 181)[:-1]
    across = math.sqrt(square / body.theta) * np.cos(turn)
    along = math.sqrt(square / body.phi) * np.sin(turn)
    cos = math.cos(body.xi)
    sin = math.sin(body.xi)
    edge = [cos * across - sin * along, sin * across + cos * along]
    height = np.full(len(turn), 1 - body.rim)
    return np.column_stack([INWARDS * edge[0], INWARDS * edge[1], height])


def _edge_of_mesh(pose: MeshPose) -> Floats | None:
    """Return places whose opposite places are on the upper side of a mesh, too."""
    from scipy.spatial import ConvexHull, QhullError

    vertices = pose.placed(read_solid(pose.path, pose.unit).vertices)
    height = vertices[:, 2]  # counts downwards
    top = vertices[height <= height.min() + TOP * np.ptp(height)]
    try:
        hull = ConvexHull(top[:, :2])
    except QhullError:
        return None
    places = INWARDS * top[hull.vertices]
    places[:, 2] = height.min()
    normals = hull.equations[:, :2]
    is_on_it = (normals @ -places[:, :2].T + hull.equations[:, 2:] <= 0).all(axis=0)
    return places[is_on_it] if is_on_it.any() else None
