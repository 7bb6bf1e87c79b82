"""The mesh of a body as a page draws it."""

from __future__ import annotations

from rattlesweep.arrays import Floats, Integers
from rattlesweep.physics.mesh.pose import MeshPose
from rattlesweep.physics.mesh.reading import read_solid
from rattlesweep.physics.mesh.thinning import with_fewer_faces
from rattlesweep.system.files import reason
from rattlesweep.words.errors import ConfigError

MOST_TRIANGLES = 12_000  # 200 kB of a page


def solid_of_page(pose: MeshPose) -> tuple[dict[str, Floats | Integers], str]:
    """Return what a page needs of a mesh, and how many of its triangles are drawn.

    Places are in the frame of the body.
    """
    try:
        whole = read_solid(pose.path, pose.unit)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{pose.path}: {reason(error)}") from None
    drawn = with_fewer_faces(whole, MOST_TRIANGLES)
    content: dict[str, Floats | Integers] = {
        "vertices": pose.placed(drawn.vertices),
        "faces": drawn.faces,
    }
    text = f"{pose.path.name}, {len(whole.faces):,} triangles"
    if len(drawn.faces) < len(whole.faces):
        text += f", drawn with {len(drawn.faces):,}"
    return content, text
