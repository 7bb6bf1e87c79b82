"""A mesh from a file, with units and a mass, at rest."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.physics import si
from rattlesweep.physics.mesh.shells import one_piece
from rattlesweep.physics.mesh.solid import Solid
from rattlesweep.physics.mesh.standing import Standing, stand
from rattlesweep.physics.mesh.stl import read_stl
from rattlesweep.physics.mesh.threemf import read_3mf
from rattlesweep.system.files import as_path, open_regular, reason
from rattlesweep.words.defaults import MESH_UNIT
from rattlesweep.words.errors import ConfigError, one_line
from rattlesweep.words.units import quantities, quantity

MESH_FORMATS = (".stl", ".obj", ".ply", ".3mf")
USUAL_SIZES = 1e-3, 3.0  # of the longest side in m
# A number for a place that is this share of the mesh may be in m instead of its unit.
TINY_PLACE = 2e-3


def read_standing(
    path: str | os.PathLike[str],
    unit: str = MESH_UNIT,
    mass: float | str | None = None,
    density: float | str | None = None,
    points: Sequence[Any] = (),
    up: Sequence[float] | None = None,
    gravity: float | str = si.GRAVITY,
) -> Standing:
    """Return the solid of a file at rest; see :meth:`Rattleback.from_mesh`."""
    scale = _scale(unit)
    if (mass is None) == (density is None):
        raise ConfigError(
            "mass or density: give one of them, the weighed mass or that of the "
            "material"
        )
    place = as_path(path, "mesh")
    name = one_line(str(path), 100)
    g = si.size(gravity, "acceleration", "gravity")
    direction = None
    if up is not None:
        direction = _direction(up)
    try:
        solid = read_solid(place, unit)
        extent = float(np.ptp(solid.vertices, axis=0).max())
        _check_size(extent, unit)
        if mass is not None:
            weighed = solid.mass(mass=si.size(mass, "mass", "mass"))
        else:
            weighed = solid.mass(
                density=si.number(density or 0.0, "density", "density")
            )
        si.check_density(weighed.mass, solid.volume)
        weights = [_point(each, scale, unit, solid) for each in points]
        return stand(solid, weighed.with_points(weights), direction, g)
    except OSError as error:
        raise ConfigError(f"{name}: {reason(error)}") from None
    except ValueError as error:
        raise ConfigError(f"{name}: {error}") from None


def _scale(unit: str) -> float:
    try:
        return quantity(f"1 {unit}", "length")
    except ValueError as error:
        raise ConfigError(f"unit: {one_line(str(unit))!r} {error}") from None


def read_solid(path: Path, unit: str) -> Solid:
    """Return the solid of a file; a file that has not changed is read once."""
    state = os.stat(path)
    return _solid(path, _scale(unit), unit, (state.st_mtime_ns, state.st_size))


def import_trimesh() -> ModuleType:
    """Return the library that reads and writes meshes, which may be missing."""
    require_trimesh()
    import trimesh

    return trimesh


def require_trimesh() -> None:
    """Raise a ConfigError if the library is missing, without importing it."""
    if find_spec("trimesh") is None:
        raise ConfigError(
            "meshes need trimesh; install it by pip install 'rattlesweep[mesh]'"
        )


@lru_cache(maxsize=16)
def _solid(place: Path, scale: float, unit: str, state: tuple[int, int]) -> Solid:
    """Return the solid of a file, which has not changed if its `state` is the same."""
    kind = place.suffix.lower()
    if kind not in MESH_FORMATS:
        raise ValueError(
            f"{kind or 'a name without an ending'} is no format of a mesh that is "
            f"read; give one of {', '.join(MESH_FORMATS)}"
        )
    # One rule for all formats, also for the one that NumPy reads.
    require_trimesh()
    with open_regular(place) as file:
        if kind == ".3mf":
            solid = read_3mf(file, scale, unit)
        else:
            remarks: tuple[str, ...] = ()
            if kind == ".stl":
                vertices, faces, remarks = read_stl(file.read())
            else:
                vertices, faces = _from_library(file, kind[1:])
            solid = replace(Solid.of(vertices * scale, faces), remarks=remarks)
    return one_piece(solid)


def _from_library(file: BinaryIO, kind: str) -> tuple[Floats, Integers]:
    """Return vertices and triangles of a file of any format."""
    trimesh = import_trimesh()
    content = file.read()
    if kind == "obj":
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    try:
        # Pictures on the surface are no part of the solid.
        mesh = trimesh.load_mesh(
            BytesIO(content), file_type=kind, process=False, skip_materials=True
        )
    except OSError:
        raise
    except Exception as error:
        # Its readers raise whatever a damaged file leads to.
        text = one_line(reason(error), 100)
        raise ValueError(f"cannot be read as {kind.upper()} ({text})") from None
    if not len(getattr(mesh, "faces", ())):
        raise ValueError(
            f"cannot be read as {kind.upper()}, or has no triangles, as a cloud of "
            "points; export the stone as a closed mesh"
        )
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces)


def _check_size(extent: float, unit: str) -> None:
    """Refuse a mesh in another unit than it is said to be."""
    low, high = USUAL_SIZES
    if low <= extent <= high:
        return
    raise ValueError(
        f"the mesh is {extent:.4g} m long if its unit is {unit}; from {low:g} to "
        f"{high:g} m is allowed; give its unit, such as mm, cm, inch or m"
    )


def _direction(up: Sequence[float]) -> Floats:
    try:
        direction = np.asarray(up, float)
    except (TypeError, ValueError):
        direction = np.zeros(0)
    if direction.shape != (3,) or not 0 < np.linalg.norm(direction) < np.inf:
        shown = one_line(repr(up))
        raise ConfigError(f"up: {shown} is no direction; give one such as [0, 0, 1]")
    return direction


def _point(each: Any, scale: float, unit: str, solid: Solid) -> tuple[float, Floats]:
    """Return mass and place of a point; plain numbers of a place are in `unit`."""
    shown = one_line(repr(each), 60)
    # A mapping of two keys would unpack to their names.
    if not isinstance(each, list | tuple) or len(each) != 2:
        raise ValueError(
            f"points: {shown} is no point; give mass and place, as in "
            "[7.5 g, [45, -9, 12]]"
        )
    mass, place = each
    weight = si.size(mass, "mass", "points")
    if isinstance(place, str):
        try:
            lengths = quantities(place, "length", 3)
        except ValueError as error:
            raise ValueError(f"points: {place!r} {error}") from None
    else:
        if np.ndim(place) != 1 or len(place) != 3:
            raise ValueError(f"points: {shown} has no place of three lengths")
        lengths = []
        for coordinate in place:
            if isinstance(coordinate, str):
                lengths.append(si.number(coordinate, "length", "points"))
            else:
                lengths.append(float(coordinate) * scale)
        plain = not any(isinstance(coordinate, str) for coordinate in place)
        largest = max(map(abs, lengths))
        if plain and 0 < largest < TINY_PLACE * np.ptp(solid.vertices, axis=0).max():
            raise ValueError(
                f"points: {shown} is within {largest * 1e3:.2g} mm of the origin, as "
                f"its numbers are in {unit}, the unit of the mesh; if m is meant, "
                "write so, as in '45 mm'"
            )
    found = np.array(lengths)
    low = solid.vertices.min(axis=0)
    high = solid.vertices.max(axis=0)
    slack = (high - low).max() / 2
    if not ((found >= low - slack) & (found <= high + slack)).all():
        listed = ", ".join(f"{length * 1e3:.4g}" for length in found)
        raise ValueError(
            f"points: ({listed}) mm is far outside of the mesh; give places in {unit}, "
            "the unit of the mesh, or with units"
        )
    return weight, found
