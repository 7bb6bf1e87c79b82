"""Shells of a mesh: where they overlap, and whether they are one piece.

A shell is a closed part of a mesh that shares no edge with the rest.  A solid may have
several: a cavity is one that is turned inwards, and a part may touch another.  Sums
over triangles are exact for these, and count twice what lies in two shells.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from importlib.util import find_spec
from typing import Any

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.physics.mesh.sheets import sheets_at
from rattlesweep.physics.mesh.solid import Solid, edge_keys, wrong_edges
from rattlesweep.system.console import shortened
from rattlesweep.words.errors import ConfigError

# Shells in single precision that touch may overlap by a rounding of a place.
SHELL_ROUNDING = 1e-6  # of the volume
INSIDE = 1e-3  # of a shell, that may reach out of the one around it
FLAT_SHELL = 1e-9  # of the volume; a shell below it has none
SHELLS_APART = 0.01  # of the longest side, between shells of two bodies
ONE_SOLID = (
    "make one solid of them in the program they come from (union, group, merge), or "
    "turn the normals of a shell inwards if it is a cavity"
)
# Beyond so many shells, boxes alone tell how far they are apart.
MOST_SHELLS = 200


class Shell(Solid):
    """A closed part of a mesh, which has all of its own vertices and no others."""

    @cached_property
    def box(self) -> tuple[Floats, Floats]:
        """The lowest and the highest coordinates."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    @cached_property
    def filled(self) -> Any:
        """What it encloses, turned outwards, for the library of Booleans."""
        import manifold3d

        faces = self.faces
        if self.volume < 0:
            faces = faces[:, ::-1]
        mesh = manifold3d.Mesh64(
            np.ascontiguousarray(self.vertices),
            np.ascontiguousarray(faces, dtype=np.uint64),
        )
        filled = manifold3d.Manifold(mesh)
        if filled.status() != manifold3d.Error.NoError:
            raise ValueError(
                f"a shell of the mesh, of {_cubic(self.volume)}, is no solid "
                f"({filled.status().name}); repair it in a program for meshes"
            )
        return filled

    def may_have(self, other: Shell, slack: float) -> bool:
        """Whether the box of another shell is in its own."""
        low, high = self.box
        other_low, other_high = other.box
        return bool(
            (other_low >= low - slack).all() and (other_high <= high + slack).all()
        )


def one_piece(solid: Solid) -> Solid:
    """Return a solid, each of whose triangles counts once.

    Raises a ValueError if its shells overlap, or are two bodies, or one of them is
    inside out.
    """
    solid = _without_doubles(solid)
    shells = shells_of(solid)
    if len(shells) == 1:
        return solid
    twice = 0.0
    for group in _groups(shells):
        excess = _counted_twice(group)
        if excess > SHELL_ROUNDING * solid.volume:
            twice += excess
    if twice:
        raise ValueError(
            f"some of the {len(shells)} shells of the mesh overlap, so that "
            f"{_cubic(twice)} ({100 * twice / solid.volume:.2g} %) would count twice; "
            f"{ONE_SOLID}"
        )
    _check_apart(shells, float(np.ptp(solid.vertices, axis=0).max()))
    return solid


def without(solid: Solid, taken: Solid) -> Solid:
    """Return a solid less another one."""
    _require_library("a part that is cut out of another")
    whole = _filled(shells_of(solid))
    return _solid_of(whole - _filled(shells_of(taken)))


def shells_of(solid: Solid) -> list[Shell]:
    """Return the shells of a closed mesh."""
    label = _labels(solid)
    if not label.any():
        return [Shell(solid.vertices, solid.faces)]
    order = np.argsort(label, kind="stable")
    ends = np.cumsum(np.bincount(label))[:-1]
    shells = []
    for which in np.split(solid.faces[order], ends):
        used, faces = np.unique(which, return_inverse=True)
        shells.append(Shell(solid.vertices[used], faces.reshape(-1, 3)))
    return shells


def _without_doubles(solid: Solid) -> Solid:
    """Return a solid without triangles that are stored more than once."""
    faces = solid.faces
    # The same triangle, turned alike, begins with its smallest corner.
    first = np.argmin(faces, axis=1)[:, None]
    alike = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    count = len(solid.vertices)
    keys = (alike[:, 0] * count + alike[:, 1]) * count + alike[:, 2]
    if count > 2_000_000:  # beyond which keys would overflow
        _, kept = np.unique(alike, axis=0, return_index=True)
    else:
        _, kept = np.unique(keys, return_index=True)
    n_double = len(faces) - len(kept)
    if not n_double:
        return solid
    fewer = faces[np.sort(kept)]
    if any(wrong_edges(fewer, count)):
        _labels(solid)  # says so if they are those of shells that overlap
        raise ValueError(
            f"{n_double} triangles of the mesh are stored twice, and it is open "
            "without them; repair it in a program for meshes"
        )
    remark = (
        f"{n_double} of {len(faces)} triangles of the mesh are stored twice; each "
        "counts once"
    )
    return Solid(solid.vertices, fewer, (*solid.remarks, remark))


def _labels(solid: Solid) -> Integers:
    """Return the number of the shell of each triangle.

    Raises a ValueError if shells overlap along edges that they share.
    """
    faces = solid.faces
    keys, is_forward = edge_keys(faces, len(solid.vertices))
    order = np.argsort(keys)
    owner = order // 3
    is_new = np.diff(keys[order], prepend=-1) != 0
    begins = np.flatnonzero(is_new)
    times = np.diff(begins, append=len(keys))
    twice = begins[times == 2]
    label = _joined(len(faces), owner[twice], owner[twice + 1])
    if (times == 2).all():
        return label
    # Where shells touch along an edge, it has four triangles.  A part that is not
    # closed without such edges goes on across them.
    edge = np.cumsum(is_new) - 1
    pair = edge * (label.max() + 1) + label[owner]
    _, which = np.unique(pair, return_inverse=True)
    balance = np.bincount(which, weights=np.where(is_forward[order], 1, -1))
    is_open = np.zeros(label.max() + 1, dtype=bool)
    is_open[label[owner[balance[which] != 0]]] = True
    crossing = np.flatnonzero((times[edge] > 2) & is_open[label[owner]])
    corners = order[crossing]
    sheets = sheets_at(
        solid.vertices, faces, corners, edge[crossing], is_forward[corners]
    )
    if sheets.twice > SHELL_ROUNDING * solid.volume:
        raise ValueError(
            "some shells of the mesh overlap beside edges that they share, so that a "
            f"part of them would count twice; {ONE_SOLID}"
        )
    return _joined(
        len(faces),
        np.concatenate([owner[twice], sheets.first]),
        np.concatenate([owner[twice + 1], sheets.second]),
    )


def _joined(count: int, first: Integers, second: Integers) -> Integers:
    """Return the number of the set of each thing, from pairs that are in one set."""
    # SciPy takes long to import.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(first), bool), (first, second)), (count, count))
    _, label = connected_components(links, directed=False)
    return np.asarray(label, dtype=np.int64)


def _groups(shells: Sequence[Shell]) -> Iterator[list[Shell]]:
    """Yield shells in sets whose boxes meet."""
    first, second = _near(shells, 0.0)
    label = _joined(len(shells), first, second)
    for number in range(label.max() + 1):
        yield [shells[int(place)] for place in np.flatnonzero(label == number)]


def _near(shells: Sequence[Shell], gap: float) -> tuple[Integers, Integers]:
    """Return pairs of shells whose boxes are at most a gap apart."""
    low = np.array([shell.box[0] for shell in shells])
    high = np.array([shell.box[1] for shell in shells])
    firsts = []
    seconds = []
    for place in range(len(shells)):
        # From here on, so that a pair is found once.
        is_near = (low[place] <= high[place + 1 :] + gap).all(axis=1)
        is_near &= (low[place + 1 :] <= high[place] + gap).all(axis=1)
        found = place + 1 + np.flatnonzero(is_near)
        firsts.append(np.full(len(found), place))
        seconds.append(found)
    return np.concatenate(firsts), np.concatenate(seconds)


def _counted_twice(shells: list[Shell]) -> float:
    """Return by how much volumes of shells miss that of the solid they make together.

    A cavity is cut out of the smallest shell around it.
    """
    # A sheet that is stored from both sides encloses nothing.
    least = FLAT_SHELL * max(abs(shell.volume) for shell in shells)
    solids = [shell for shell in shells if shell.volume > least]
    cavities = [shell for shell in shells if shell.volume < -least]
    if len(solids) < 2 and not cavities:
        return 0.0
    _require_library(f"a mesh of {len(shells)} shells")
    import manifold3d

    add = manifold3d.OpType.Add
    holes: list[list[Any]] = [[] for _ in solids]
    for cavity in cavities:
        for place in _around(cavity, solids):
            holes[place].append(cavity.filled)
    parts = []
    for shell, cut in zip(solids, holes, strict=True):
        part = shell.filled
        if cut:
            part = part - manifold3d.Manifold.batch_boolean(cut, add)
        parts.append(part)
    together = manifold3d.Manifold.batch_boolean(parts, add)
    return abs(sum(shell.volume for shell in shells) - float(together.volume()))


def _around(cavity: Shell, solids: Sequence[Shell]) -> list[int]:
    """Return which solids a cavity is cut out of: the smallest one around it."""
    size = -cavity.volume
    slack = INSIDE * float(np.ptp(cavity.box))
    around = []
    left = cavity.filled
    cut = []
    for place in sorted(range(len(solids)), key=lambda each: solids[each].volume):
        shell = solids[place]
        if shell.may_have(cavity, slack):
            common = (shell.filled ^ cavity.filled).volume()
            if common >= (1 - INSIDE) * size:
                return [place]
        cut.append(place)
    for place in cut:
        rest = left - solids[place].filled
        if rest.volume() < left.volume():
            around.append(place)
        left = rest
    if left.volume() > INSIDE * size:
        raise ValueError(
            f"a shell of the mesh, of {_cubic(size)}, is inside out and does not lie "
            "in another one, as a cavity does; turn its normals outwards"
        )
    return around


def _check_apart(shells: Sequence[Shell], longest: float) -> None:
    """Raise a ValueError if shells are two bodies, which do not even touch."""
    gap = SHELLS_APART * longest
    first, second = _near(shells, gap)
    label = _joined(len(shells), first, second)
    if len(shells) <= MOST_SHELLS and find_spec("manifold3d") is not None:
        label = np.arange(len(shells))
        for one, other in zip(first, second, strict=True):
            if label[one] == label[other]:
                continue
            if shells[one].filled.min_gap(shells[other].filled, gap) < gap:
                label[label == label[other]] = label[one]
    volumes = np.bincount(label, weights=[shell.volume for shell in shells])
    # Specks and crumbs are no bodies.
    volumes = np.sort(volumes[volumes > SHELLS_APART * volumes.sum()])[::-1]
    if len(volumes) < 2:
        return
    listed = shortened([f"{volume * 1e6:.4g}" for volume in volumes], 4)
    raise ValueError(
        f"the file has {len(volumes)} bodies that do not touch, of {listed} cm^3, as "
        "stones on a plate, or supports; export one stone alone"
    )


def _filled(shells: Sequence[Shell]) -> Any:
    """Return what shells enclose together, for the library of Booleans."""
    import manifold3d

    add = manifold3d.OpType.Add
    solids = [shell.filled for shell in shells if shell.volume > 0]
    cavities = [shell.filled for shell in shells if shell.volume < 0]
    filled = manifold3d.Manifold.batch_boolean(solids, add)
    if cavities:
        filled = filled - manifold3d.Manifold.batch_boolean(cavities, add)
    return filled


def _solid_of(filled: Any) -> Solid:
    mesh = filled.to_mesh64()
    vertices = np.array(mesh.vert_properties[:, :3], float)
    return Solid.of(vertices, np.array(mesh.tri_verts, np.int64))


def _require_library(what: str) -> None:
    if find_spec("manifold3d") is None:
        raise ConfigError(
            f"{what} needs manifold3d, which tells where they overlap; install it by "
            "pip install 'rattlesweep[mesh]'"
        )


def _cubic(volume: float) -> str:
    return f"{abs(volume) * 1e6:.3g} cm^3"
