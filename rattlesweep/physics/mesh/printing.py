"""Meshes of shapes as files for a 3D printer, read back as bodies."""

from __future__ import annotations

import io
import math
from pathlib import Path

from rattlesweep.physics import si
from rattlesweep.physics.mesh.reading import import_trimesh, read_standing
from rattlesweep.physics.mesh.solid import Solid
from rattlesweep.physics.mesh.standing import Standing
from rattlesweep.system.files import replace_file


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


def told_of_body(
    standing: Standing, sizes: tuple[float, float, float], skew: float
) -> list[str]:
    """Return what body a printed solid is, and how it differs from one without a twist.

    `sizes` are length, width and height in m of a half ellipsoid, whose axes of inertia
    alone are turned by `skew`.
    """
    found = standing.parameters
    shown = []
    for name, value in found.items():
        if name == "xi":
            shown.append(f"xi {math.degrees(value):.4g} deg")
        elif name != "rim":
            shown.append(f"{name} {value:.4g}")
    lines = [f"as a body: {', '.join(shown)}"]
    if skew != 0:
        plain = si.half_ellipsoid(*sizes, 1.0, skew)
        beta = float(plain["beta"])
        lines.append(
            f"its beta is {100 * (found['beta'] / beta - 1):.2g} % larger than that of "
            f"--half-ellipsoid with --skew, {beta:.4g}: a twist turns parts of the "
            "solid out of its axis; describe the print by --mesh"
        )
    return lines
