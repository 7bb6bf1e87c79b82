"""Files of meshes as programs write them: shells, 3MF of slicers, odd STL files."""

import math
import warnings

import numpy as np
import pytest
from mesh_files import (
    bars,
    binary_stl,
    box,
    group,
    joined,
    mesh_object,
    shifted,
    stone,
    text_stl,
    write_3mf,
)

import rattlesweep as rs
from rattlesweep.physics.mesh import archive, standing
from rattlesweep.physics.mesh.reading import read_solid
from rattlesweep.words.errors import ConfigWarning

pytest.importorskip("trimesh")
pytest.importorskip("manifold3d")

BAR = box((-5, -2.5, 0), (5, 2.5, 4))
HOLE = ((-5, -5, -6), (5, 5, -2))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "stone.stl"


@pytest.fixture
def archive_path(tmp_path):
    return tmp_path / "stone.3mf"


def moments(path, unit="mm"):
    """Return volume and second moments, and what is remarked."""
    solid = read_solid(path, unit)
    mass = solid.mass(density=1000.0)
    return [mass.mass, *mass.inertia.ravel()], solid.remarks


def exact(*meshes, hole=None):
    """Return the same of meshes that do not overlap, less a hole, by their sums."""
    from rattlesweep.physics.mesh.solid import Solid

    shells = [*meshes]
    if hole is not None:
        shells.append(box(*hole, inwards=True))
    vertices, faces = joined(*shells)
    mass = Solid.of(vertices * 1e-3, faces).mass(density=1000.0)
    return [mass.mass, *mass.inertia.ravel()]


def close(expected, rel=1e-6):
    return pytest.approx(expected, rel=rel, abs=1e-12)


def refusal(path, **others):
    with pytest.raises(rs.ConfigError) as caught:
        rs.Rattleback.from_mesh(path, **{"mass": "60 g"} | others)
    [message] = caught.value.messages
    return message


# --- shells ---------------------------------------------------------------------------


def test_shells_that_touch_and_cavities_stay_as_they_are(path):
    path.write_bytes(binary_stl(joined(stone(), *bars())))
    assert moments(path) == (close(exact(stone(), *bars())), ())
    hollow = joined(stone(), *bars(), box(*HOLE, inwards=True))
    path.write_bytes(binary_stl(hollow))
    assert moments(path) == (close(exact(stone(), *bars(), hole=HOLE)), ())


def test_shells_that_overlap_are_refused_with_what_counts_twice(path):
    path.write_bytes(binary_stl(joined(stone(), *bars(2.0))))
    message = refusal(path)
    assert "some of the 3 shells of the mesh overlap" in message
    assert "0.2 cm^3 (0.8" in message  # two times 10 by 5 by 2 mm
    assert "make one solid of them" in message
    # A shell inside another that is not turned inwards.
    path.write_bytes(binary_stl(joined(stone(), *bars(), box(*HOLE))))
    message = refusal(path)
    assert "0.4 cm^3" in message
    assert "inwards if it is a cavity" in message


def test_a_shell_that_is_inside_out_is_no_cavity(path):
    low, high = (36, -6, 0), (46, -1, 4)
    path.write_bytes(binary_stl(joined(stone(), box(low, high, inwards=True))))
    assert "0.2 cm^3, is inside out" in refusal(path)


def test_triangles_that_are_stored_twice_count_once(path):
    vertices, faces = joined(stone(), *bars())
    path.write_bytes(binary_stl((vertices, np.vstack([faces, faces]))))
    found, [remark] = moments(path)
    assert found == close(exact(stone(), *bars()))
    assert f"{len(faces)} of {2 * len(faces)} triangles" in remark


def test_shells_that_share_an_edge_are_told_apart(path):
    """Two boxes that touch along an edge, which has four triangles."""
    from rattlesweep.physics.mesh.shells import shells_of
    from rattlesweep.physics.mesh.solid import Solid

    solid = Solid.of(*joined(box((0, 0, 0), (1, 1, 1)), box((1, 1, 0), (2, 2, 1))))
    assert len(solid.vertices) == 14
    assert [shell.volume for shell in shells_of(solid)] == pytest.approx([1, 1])


def other_diagonals(low, high):
    """Return a box whose sides are cut along the other diagonals."""
    vertices, _ = box(low, high)
    sides = [
        *([0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1]),
        *([2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]),
    ]
    faces = [[b, c, d] for _, b, c, d in sides] + [[b, d, a] for a, b, _, d in sides]
    return vertices, np.array(faces)


@pytest.mark.parametrize("make", [box, other_diagonals])
def test_shells_that_touch_in_a_side_are_told_apart(make):
    """All edges of the wall between them have four triangles."""
    from rattlesweep.physics.mesh.shells import one_piece, shells_of
    from rattlesweep.physics.mesh.solid import Solid

    two = [box((0, 0, 0), (1, 1, 1)), make((1, 0, 0), (2, 1, 1))]
    solid = Solid.of(*joined(*two))
    assert [shell.volume for shell in shells_of(solid)] == pytest.approx([1, 1])
    assert one_piece(solid).volume == pytest.approx(2)
    # A third one that overlaps both.
    solid = Solid.of(*joined(*two, box((0.5, 0.5, 0.5), (1.5, 2, 0.8))))
    with pytest.raises(ValueError, match=r"1.5e[+]05 cm.3 .* would count twice"):
        one_piece(solid)


@pytest.mark.parametrize("make", [box, other_diagonals])
def test_shells_that_overlap_beside_edges_that_they_share_are_refused(path, make):
    """The lower of two boxes on one base was counted twice, without a word."""
    base = joined(box((-20, -5, 0), (20, 5, 8)), make((-20, -5, 0), (20, 5, 4)))
    path.write_bytes(binary_stl(base))
    message = refusal(path)
    assert "overlap beside edges that they share" in message
    assert "make one solid of them" in message


def test_a_cavity_that_reaches_the_surface_is_cut_out(path):
    """It shares edges, or a part of the surface, with the solid around it."""
    from rattlesweep.physics.mesh.shells import one_piece
    from rattlesweep.physics.mesh.solid import Solid

    solid = box((0, 0, 0), (2, 2, 2))
    for high, left in (((1, 1, 2), 6), ((1, 2, 2), 4)):
        cut = Solid.of(*joined(solid, box((0, 0, 0), high, inwards=True)))
        assert one_piece(cut).volume == pytest.approx(left)


def test_two_stones_on_a_plate(path):
    vertices, faces = stone()
    path.write_bytes(binary_stl(joined((vertices, faces), (vertices + 50, faces))))
    assert "2 bodies that do not touch, of 22.5" in refusal(path)


# --- 3MF ------------------------------------------------------------------------------


def objects_of(path="", size=1.0):
    """Return an object of three components, as slicers write parts of a stone."""
    where = f'p:path="{path}" ' if path else ""
    return group(
        4,
        [
            f'{where}objectid="1"',
            f'{where}objectid="2" {shifted(41 * size, -3.5 * size, 0)}',
            f'{where}objectid="2" {shifted(-41 * size, 3.5 * size, 0)}',
        ],
    )


def test_parts_of_3mf_in_one_file_and_in_two(archive_path):
    expected = exact(stone(), *bars())
    meshes = [mesh_object(1, stone()), mesh_object(2, BAR)]
    write_3mf(archive_path, [*meshes, objects_of()], ['objectid="4"'])
    assert moments(archive_path) == (close(expected), ())
    # All meshes in one part of the archive, as Bambu Studio and Orca have them.
    write_3mf(
        archive_path,
        [objects_of("/3D/Objects/o.model")],
        ['objectid="4"'],
        parts={"3D/Objects/o.model": meshes},
    )
    assert moments(archive_path) == (close(expected), ())
    # The same number in two parts.
    bar = 'p:path="/3D/b.model" objectid="1"'
    components = [
        'p:path="/3D/a.model" objectid="1"',
        f"{bar} {shifted(41, -3.5, 0)}",
        f"{bar} {shifted(-41, 3.5, 0)}",
    ]
    write_3mf(
        archive_path,
        [group(1, components)],
        ['objectid="1"'],
        parts={
            "3D/a.model": [mesh_object(1, stone())],
            "3D/b.model": [mesh_object(1, BAR)],
        },
    )
    assert moments(archive_path) == (close(expected), ())


def test_items_of_3mf_and_those_that_are_not_printed(archive_path):
    items = [
        'objectid="1"',
        f'objectid="2" {shifted(41, -3.5, 0)}',
        f'objectid="2" {shifted(-41, 3.5, 0)}',
        f'objectid="1" printable="0" {shifted(0, 80, 0)}',
        f'objectid="3" {shifted(80, 0, 0)}',
    ]
    objects = [
        mesh_object(1, stone()),
        mesh_object(2, BAR),
        mesh_object(3, BAR, 'type="support" name="tree"'),
    ]
    write_3mf(archive_path, objects, items)
    found, [remark] = moments(archive_path)
    assert found == close(exact(stone(), *bars()))
    assert "'object 1' (not printable), 'tree' (support)" in remark


def test_a_mirrored_item_of_3mf_is_turned_outwards(archive_path):
    meshes = [mesh_object(1, joined(stone(), *bars()))]
    mirror = 'objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"'
    write_3mf(archive_path, meshes, [mirror])
    vertices, faces = joined(stone(), *bars())
    mirrored = exact((vertices * [-1, 1, 1], faces[:, ::-1]))
    assert moments(archive_path)[0] == close(mirrored)


def test_the_unit_of_3mf(archive_path):
    size = 1 / 25.4
    meshes = [
        mesh_object(number, (vertices * size, faces))
        for number, (vertices, faces) in ((1, stone()), (2, BAR))
    ]
    meshes.append(objects_of(size=size))
    write_3mf(archive_path, meshes, ['objectid="4"'], unit="inch")
    assert moments(archive_path, "inch")[0] == close(exact(stone(), *bars()))
    assert "says that its unit is inch" in refusal(archive_path)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("modifier_part", r"'cube' \(modifier\); weight that a modifier adds"),
        ("support_enforcer", r"'cube' \(support\)"),
        ("support_blocker", r"'cube' \(support blocker\)"),
        ("negative_part", "the negative part 'cube' is cut out"),
    ],
)
def test_parts_that_are_no_plastic_in_bambu_studio(archive_path, kind, words):
    components = [f'p:path="/3D/o.model" objectid="{number}"' for number in (1, 2)]
    notes = (
        '<config><object id="4"><part id="1" subtype="normal_part"/>'
        f'<part id="2" subtype="{kind}"><metadata key="name" value="cube"/></part>'
        "</object></config>"
    )
    parts = [mesh_object(1, stone()), mesh_object(2, box(*HOLE))]
    write_3mf(
        archive_path,
        [group(4, components)],
        ['objectid="4"'],
        parts={"3D/o.model": parts},
        others={"Metadata/model_settings.config": notes},
    )
    found, _ = moments(archive_path)
    hole = HOLE if kind == "negative_part" else None
    assert found == close(exact(stone(), hole=hole))
    with pytest.warns(ConfigWarning, match=words):
        rs.Rattleback.from_mesh(
            archive_path,
            mass="60 g",
            points=[("7.5 g", (45, -9, 0)), ("7.5 g", (-45, 9, 0))],
        )


@pytest.mark.parametrize("kind", ["ParameterModifier", "NegativeVolume", "Odd"])
def test_parts_that_are_no_plastic_in_prusaslicer(archive_path, kind):
    mesh = joined(stone(), box(*HOLE))
    last = len(mesh[1]) - 1
    notes = (
        f'<config><object id="1"><volume firstid="0" lastid="{last - 12}">'
        '<metadata key="volume_type" value="ModelPart"/></volume>'
        f'<volume firstid="{last - 11}" lastid="{last}"><metadata key="name" '
        f'value="cube"/><metadata key="volume_type" value="{kind}"/></volume>'
        "</object></config>"
    )
    write_3mf(
        archive_path,
        [mesh_object(1, mesh)],
        ['objectid="1"'],
        others={"Metadata/Slic3r_PE_model.config": notes},
    )
    if kind == "Odd":
        assert "its part 'cube' is of the kind 'Odd'" in refusal(archive_path)
        return
    hole = HOLE if kind == "NegativeVolume" else None
    found, [remark] = moments(archive_path)
    assert found == close(exact(stone(), hole=hole))
    assert "'cube'" in remark


def test_archives_beyond_limits(archive_path, monkeypatch):
    write_3mf(archive_path, [mesh_object(1, stone())], ['objectid="1"'])
    monkeypatch.setattr(archive, "MOST_BYTES", 10_000)
    assert "the archive unpacks to" in refusal(archive_path)
    monkeypatch.setattr(archive, "MOST_PACKED", 1)
    assert "the archive has 2 files" in refusal(archive_path)
    monkeypatch.undo()
    chain = [mesh_object(1, BAR)]
    chain += [group(n, [f'objectid="{n - 1}"']) for n in range(2, 60)]
    write_3mf(archive_path, chain, ['objectid="59"'])
    assert "components are more than 32 deep" in refusal(archive_path)


def test_3mf_without_a_mesh_to_print(archive_path):
    write_3mf(archive_path, [], [], others={"Metadata/plate_1.gcode": "G28"})
    assert "the file is a sliced plate" in refusal(archive_path)
    write_3mf(archive_path, [mesh_object(1, BAR)], [])
    assert "no item to be built" in refusal(archive_path)
    archive_path.write_bytes(archive_path.read_bytes()[:-30])
    assert "an archive of ZIP" in refusal(archive_path)


# --- STL, PLY -------------------------------------------------------------------------


def test_odd_stl_files_are_read_with_a_remark(path):
    mesh = joined(stone(), *bars())
    expected = close(exact(mesh))
    path.write_bytes(binary_stl(mesh, tail=b"xyz", head=b"solid of some program"))
    found, [remark] = moments(path)
    assert found == expected
    assert "3 bytes after the last of the" in remark
    path.write_bytes(binary_stl(mesh, count=0))
    found, [remark] = moments(path)
    assert found == expected
    assert "says that it has 0 triangles" in remark
    for end in ("\n", "\r\n", "\r"):
        path.write_bytes(text_stl([stone(), *bars()], end))
        assert moments(path) == (expected, ())
        path.write_bytes(text_stl([stone(), *bars()], end).upper())
        assert moments(path) == (expected, ())


def test_damaged_stl_files_are_named(path):
    content = binary_stl(stone())
    path.write_bytes(content[:-60])
    assert "cut short: it says that it has" in refusal(path)
    path.write_bytes(content[:80] + bytes(4))
    assert "has no triangles" in refusal(path)
    text = text_stl([stone()])
    path.write_bytes(text[: len(text) // 2])
    assert "cut short: it has" in refusal(path)
    path.write_bytes(text.replace(b".", b","))
    assert "no three numbers, with a point for decimals" in refusal(path)


def test_a_ply_with_a_picture_says_nothing_of_it(tmp_path, capfd):
    vertices, faces = stone()
    lines = ["ply", "format ascii 1.0", "comment TextureFile none.png"]
    lines += [f"element vertex {len(vertices)}"]
    lines += [f"property float {name}" for name in "xyzst"]
    lines += [f"element face {len(faces)}"]
    lines += ["property list uchar int vertex_indices", "end_header"]
    lines += [f"{x!r} {y!r} {z!r} 0 0" for x, y, z in vertices.tolist()]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    path = tmp_path / "stone.ply"
    path.write_text("\n".join(lines) + "\n")
    assert moments(path) == (close(exact(stone())), ())
    assert capfd.readouterr() == ("", "")


# --- results --------------------------------------------------------------------------


def test_numbers_of_bodies_are_shown_as_numbers(path):
    path.write_bytes(binary_stl(joined(stone(), *bars())))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConfigWarning)
        body = rs.Rattleback.from_mesh(path, mass="60 g")
    numbers = np.array([13.04, 1.522, 12.28, 0.6429, 0.036, -math.radians(1.72)])
    assert body.c is not None
    patch = rs.contact_patch(body, ["steel", "steel"])
    for shown in (body, body.units, rs.Rattleback(*numbers), patch):
        assert "np." not in repr(shown)
    assert rs.Rattleback(*numbers) == rs.Rattleback.gh()


def test_a_body_that_does_not_settle_is_refused(path, monkeypatch):
    path.write_bytes(binary_stl(joined(stone(), *bars())))
    monkeypatch.setattr(standing, "ROUNDS", 3)
    assert "does not come to rest in 3 rounds" in refusal(path)
