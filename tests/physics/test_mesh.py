"""Bodies of meshes against closed forms, turned meshes, and a printed stone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rattlesweep as rs
from rattlesweep.physics.mesh.bottom import MOST_POINTS
from rattlesweep.physics.mesh.shapes import bowl, half_ellipsoid_solid
from rattlesweep.physics.mesh.solid import MassProperties, Solid
from rattlesweep.physics.mesh.standing import stand, stand_on
from rattlesweep.physics.mesh.stl import read_stl

SIZES = (0.12, 0.03, 0.012)
COINS = [(0.0075, np.array([0.045, -0.009, 0])), (0.0075, np.array([-0.045, 0.009, 0]))]
NAMES = ("alpha", "beta", "gamma", "theta", "phi", "xi", "c", "rim")


def closed_form():
    return rs.Rattleback.half_ellipsoid(
        length="12 cm", width="3 cm", height="12 mm", mass="60 g", weights="7.5 g",
        at="45, -9 mm",
    )  # fmt: skip


def standing_of(solid, coins=COINS, **others):
    return stand(solid, solid.mass(0.06).with_points(coins), **others)


def errors(parameters):
    exact = closed_form()
    return np.array([parameters[name] / getattr(exact, name) - 1 for name in NAMES])


def test_half_ellipsoids_converge_at_second_order_in_the_facets():
    coarse, fine = (
        errors(standing_of(half_ellipsoid_solid(*SIZES, n)).parameters)
        for n in (24, 48)
    )
    assert np.abs(fine).max() < 3e-4
    assert coarse / fine == pytest.approx(4, rel=0.03)


def test_a_turned_and_shifted_mesh_is_the_same_body():
    solid = half_ellipsoid_solid(*SIZES, 24)
    plain = standing_of(solid).parameters
    for seed in range(3):
        turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
        shift = np.array([0.3, -0.1, 0.2])
        moved = Solid.of(solid.vertices @ turn.T + shift, solid.faces)
        coins = [(mass, turn @ place + shift) for mass, place in COINS]
        assert standing_of(moved, coins).parameters == pytest.approx(plain, rel=1e-7)
    tilted = standing_of(solid, up=np.array([0.3, 0.2, 1.0])).parameters
    assert tilted == pytest.approx(plain, rel=1e-8)


def full_ellipsoid(axes):
    lower, faces = bowl(axes, 16, 64)
    count = len(lower)
    upper = lower * [1, 1, -1]
    number = np.arange(count)
    ring = count - 64
    shared = np.where(number >= ring, number, number + count)
    return Solid.of(
        np.vstack([lower, upper]), np.vstack([faces, shared[faces][:, ::-1]])
    )


def test_random_ellipsoids_with_points_stand_where_the_formula_says():
    """The foot of an ellipsoid is the stationary point of its support height."""
    from scipy.optimize import minimize

    rng = np.random.default_rng(47)
    for _ in range(30):
        axes = np.array([rng.uniform(0.04, 0.07), rng.uniform(0.012, 0.02), 0.01])
        solid = full_ellipsoid(axes)
        points = [
            (rng.uniform(0, 1e-4), rng.uniform(-0.5, 0.5, 3) * axes) for _ in range(2)
        ]
        mass = solid.mass(density=1000).with_points(points)

        def support(tangent, axes=axes, mass=mass):
            up = np.array([*tangent, 1.0])
            up /= np.linalg.norm(up)
            return mass.centre @ up + np.linalg.norm(axes * up)

        found = minimize(
            support, [0.0, 0.0], method="Nelder-Mead",
            options={"xatol": 1e-10, "fatol": 1e-16},
        )  # fmt: skip
        up = np.array([*found.x, 1.0])
        up /= np.linalg.norm(up)
        # Second derivatives of the support function are the radii of curvature.
        size = np.linalg.norm(axes * up)
        hessian = (
            np.diag(axes**2) / size - np.outer(axes**2 * up, axes**2 * up) / size**3
        )
        radii = np.sort(np.linalg.eigvalsh(hessian))[1:]
        standing = stand(solid, mass)
        assert standing.axes[2] == pytest.approx(up, abs=3e-7)
        assert standing.surface.radii == pytest.approx(radii, rel=1e-5)
        assert standing.height == pytest.approx(found.fun, rel=1e-7)


def test_the_printed_stone_of_a_student_project():
    """UIS, Colombia, 2025: fitted bottom and inertia give radii 164 and 9.65 mm."""
    x, y = np.meshgrid(np.linspace(-2, 2, 81), np.linspace(-0.7, 0.7, 61))
    down = 0.6240 - 0.03336 * x**2 - 0.5154 * y**2 + 0.07464 * x * y
    # Their z axis points from the centre of mass to the table.
    points = np.column_stack([x.ravel(), -y.ravel(), -down.ravel()]) * 1e-2
    inertia = np.diag([3.57335703, 53.9837801, 56.1479905])
    inertia[0, 1] = inertia[1, 0] = 1.52444531
    mass = MassProperties(13.2931e-3, np.zeros(3), inertia * 1e-7)
    up = np.array([0.0, 0.0, 1.0])
    standing = stand_on(points, mass, up, up)
    assert standing.surface.radii * 1e3 == pytest.approx([9.647, 164.0], rel=1e-3)
    body = standing.parameters
    assert body["alpha"] == pytest.approx(11.4390, rel=5e-3)
    assert body["beta"] == pytest.approx(1.6815, rel=0.01)
    assert body["gamma"] == pytest.approx(10.8483, rel=0.01)
    assert body["theta"] == pytest.approx(0.6468, rel=1e-3)
    assert body["phi"] == pytest.approx(0.03805, rel=1e-3)
    assert np.degrees(body["xi"]) == pytest.approx(2.67, abs=0.01)


def test_layers_of_a_tenth_of_a_millimetre():
    """Printed outlines are those of the middle of each layer."""
    length, width, height = SIZES
    layers = np.arange(0, height, 1e-4)
    turn = np.linspace(0, 2 * np.pi, 160, endpoint=False)
    rings = []
    for low in layers:
        depth = (height - low - 5e-5) / height
        wide = np.sqrt(1 - depth**2)
        ring = [length / 2 * wide * np.cos(turn), width / 2 * wide * np.sin(turn)]
        rings.append(np.column_stack([*ring, np.full(160, low - height)]))
    solid = half_ellipsoid_solid(*SIZES, 48)
    mass = solid.mass(0.06).with_points(COINS)
    up = np.array([0.0, 0.0, 1.0])
    standing = stand_on(np.vstack(rings) - mass.centre, mass, up, up)
    assert standing.surface.radii * 1e3 == pytest.approx([18.75, 300], rel=0.02)
    assert standing.height == pytest.approx(0.0084, abs=1e-4)


def test_many_vertices_are_thinned_without_a_loss():
    """Of 66,000 low vertices some thousands are fitted, and the foot is the same."""
    solid = half_ellipsoid_solid(*SIZES, 130)
    assert len(solid.faces) > 130_000
    standing = standing_of(solid)
    assert np.abs(errors(standing.parameters)).max() < 5e-5
    assert len(standing.surface.fitted) == MOST_POINTS
    assert standing.flat < 0.05
    tilted = standing_of(solid, up=np.array([0.3, 0.2, 1.0])).parameters
    assert tilted == pytest.approx(standing.parameters, rel=1e-6)


def test_binary_stl_is_read_as_the_library_reads_it(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    solid = half_ellipsoid_solid(120, 30, 12, 24)
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    content = mesh.export(file_type="stl")
    vertices, faces, remarks = read_stl(content)
    assert not remarks
    path = tmp_path / "stone.stl"
    path.write_bytes(content)
    theirs = trimesh.load_mesh(path, process=False)
    assert np.array_equal(vertices[faces], theirs.vertices[theirs.faces])
    text = mesh.export(file_type="stl_ascii").encode()
    again, _, _ = read_stl(text)
    assert again == pytest.approx(vertices, rel=1e-6)


def test_meshes_that_are_no_body():
    solid = half_ellipsoid_solid(*SIZES, 24)
    with pytest.raises(ValueError, match="open: 3 edges"):
        Solid.of(solid.vertices, solid.faces[1:])
    turned = solid.faces.copy()
    turned[0] = turned[0, ::-1]
    with pytest.raises(ValueError, match="not turned alike: 3 edges"):
        Solid.of(solid.vertices, turned)
    with pytest.raises(ValueError, match="inside out"):
        Solid.of(solid.vertices, solid.faces[:, ::-1])
    with pytest.raises(ValueError, match="flat side"):
        standing_of(solid, up=np.array([0, 0, -1.0]))
    with pytest.raises(ValueError, match="third principal axis leans by"):
        standing_of(solid, coins=[(0.02, np.array([0.0, 0.012, 0]))])


def test_files_units_and_points(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    solid = half_ellipsoid_solid(120, 30, 12, 32)
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    points = [("7.5 g", (45, -9, 0)), ("7.5 g", ("-45 mm", "9 mm", 0))]
    for ending in ("3mf", "obj", "ply", "stl"):
        path = tmp_path / f"stone.{ending}"
        mesh.export(path)
        body = rs.Rattleback.from_mesh(path, mass="60 g", points=points)
        assert np.abs(errors(vars(body))).max() < 1e-3
        assert body.units.mass == pytest.approx(0.075)
    wrong = [
        ({"unit": "m"}, "120 m long"),
        ({"mass": "60 kg"}, "density"),
        ({"mass": None}, "mass or density"),
        ({"points": [("7.5 g", (0.045, -0.009, 0))]}, "if m is meant"),
        ({"points": [{"mass": "7.5 g", "at": (45, -9, 0)}]}, "give mass and place"),
        ({"path": tmp_path / "none.stl"}, "No such file"),
    ]
    for change, words in wrong:
        with pytest.raises(ValueError, match=words):
            rs.Rattleback.from_mesh(**{"path": path, "mass": "60 g"} | change)
