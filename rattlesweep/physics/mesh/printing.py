"""Meshes of shapes as files for a 3D printer, read back as bodies."""

from __future__ import annotations

import io
from pathlib import Path

from rattlesweep.files import replace_file
from rattlesweep.physics.mesh.reading import import_trimesh, read_standing
from rattlesweep.physics.mesh.solid import Solid
from rattlesweep.physics.mesh.standing import Standing


def write(solid: Solid, path: Path) -> Standing:
    """Write a solid in mm, and return it at rest as the file has it.

    The ending of the name is the format.  Its density is that of water, which changes
    none of the parameters of the body.
    """
    trimesh = import_trimesh()
    mesh = trimesh.Trimesh(solid.vertices * 1e3, solid.faces, process=False)
    content = io.BytesIO()
    mesh.export(content, file_type=path.suffix[1:].lower())
    replace_file(path, content.getvalue())
    return read_standing(path, "mm", density=1000.0)
