"""Meshes of stones with bars, and files of them as programs for printers write them."""

import zipfile

import numpy as np

from rattlesweep.physics.mesh.shapes import half_ellipsoid_solid

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
RELATIONS = "http://schemas.openxmlformats.org/package/2006/relationships"


def stone(fineness=24):
    """Return vertices in mm and triangles of a half ellipsoid."""
    solid = half_ellipsoid_solid(120, 30, 12, fineness)
    return solid.vertices, solid.faces


def box(low, high, inwards=False):
    """Return vertices and triangles of a box between two corners."""
    low, high = np.array(low, float), np.array(high, float)
    places = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    faces = np.array(
        [
            *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
            *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
        ]
    )
    return low + places * (high - low), faces[:, ::-1] if inwards else faces


def bars(depth=0.0):
    """Return two bars on the flat side, opposite to each other, sunk by a depth."""
    return (
        box((36, -6, -depth), (46, -1, 4)),
        box((-46, 1, -depth), (-36, 6, 4)),
    )


def joined(*meshes):
    """Return several meshes as one."""
    faces = []
    count = 0
    for vertices, triangles in meshes:
        faces.append(triangles + count)
        count += len(vertices)
    return np.vstack([vertices for vertices, _ in meshes]), np.vstack(faces)


def binary_stl(mesh, count=None, tail=b"", head=b""):
    """Return the bytes of a binary STL, whose count may be another."""
    vertices, faces = mesh
    records = np.zeros(
        len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("last", "<u2")]
    )
    records["corners"] = vertices[faces]
    number = np.uint32(len(faces) if count is None else count)
    return head.ljust(80, b"\0") + number.tobytes() + records.tobytes() + tail


def text_stl(meshes, end="\n"):
    """Return the bytes of a text, with a solid for each mesh."""
    lines = []
    for vertices, faces in meshes:
        lines.append("solid part")
        for corners in vertices[faces]:
            lines += ["facet normal 0 0 0", "  outer loop"]
            lines += [f"    vertex {x!r} {y!r} {z!r}" for x, y, z in corners.tolist()]
            lines += ["  endloop", "endfacet"]
        lines.append("endsolid part")
    return (end.join(lines) + end).encode()


def shifted(x, y, z):
    """Return the transform of a shift, in the words of 3MF."""
    return f'transform="1 0 0 0 1 0 0 0 1 {x} {y} {z}"'


def mesh_object(number, mesh, more=""):
    """Return an object of 3MF that is a mesh."""
    vertices, faces = mesh
    places = [
        f'<vertex x="{x!r}" y="{y!r}" z="{z!r}"/>' for x, y, z in vertices.tolist()
    ]
    corners = [f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces.tolist()]
    return (
        f'<object id="{number}" {more}><mesh><vertices>{"".join(places)}</vertices>'
        f"<triangles>{''.join(corners)}</triangles></mesh></object>"
    )


def group(number, components):
    """Return an object of 3MF that has components, each the attributes of one."""
    listed = "".join(f"<component {each}/>" for each in components)
    return f'<object id="{number}"><components>{listed}</components></object>'


def write_3mf(path, objects, items, unit="millimeter", parts=None, others=None):
    """Write a 3MF file of objects and items, with further parts and files."""

    def model(resources, build):
        listed = "".join(f"<item {each}/>" for each in build)
        return (
            f'<?xml version="1.0"?><model unit="{unit}" xmlns="{CORE}" '
            f'xmlns:p="{PRODUCTION}"><resources>{"".join(resources)}</resources>'
            f"<build>{listed}</build></model>"
        )

    relation = (
        f'<Relationships xmlns="{RELATIONS}"><Relationship Target="/3D/3dmodel.model" '
        'Id="r" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
        "</Relationships>"
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("_rels/.rels", relation)
        archive.writestr("3D/3dmodel.model", model(objects, items))
        for name, resources in (parts or {}).items():
            archive.writestr(name, model(resources, []))
        for name, content in (others or {}).items():
            archive.writestr(name, content)
