"""The page of a body from a mesh: the mesh itself is drawn, and stands on the plane."""

from __future__ import annotations

import base64
import json
import math

import numpy as np
import pytest
from browser import needs_browser, window
from sweeping import invoke

import rattlesweep as rs
from rattlesweep.analysis.onerun.solids import MOST_TRIANGLES
from rattlesweep.physics.mesh import shapes
from rattlesweep.physics.mesh.solid import Solid
from rattlesweep.physics.mesh.thinning import with_fewer_faces

pytest.importorskip("trimesh")
SIZES = "12cm,3cm,12mm"
COINS = [("7.5 g", (45, -9, 0)), ("7.5 g", (-45, 9, 0))]


@pytest.fixture(scope="module")
def stone(tmp_path_factory):
    """A mesh of 24,576 triangles."""
    path = tmp_path_factory.mktemp("mesh") / "stone.stl"
    made = invoke(
        "stl", "--half-ellipsoid", SIZES, "--fineness", 56, "--output", path, "-q"
    )
    assert made.exit_code == 0, made.stderr
    return path


@pytest.fixture(scope="module")
def page(stone):
    path = stone.with_suffix(".html")
    done = invoke(
        "show", "--mesh", stone, "--mass", "60g",
        "--mass-points", "7.5g@45,-9,0; 7.5g@-45,9,0",
        "--n-i", "60rpm", "--omega-xy0", "6rpm", "--t-end", "1s", "--output", path,
    )  # fmt: skip
    assert done.exit_code == 0, done.stderr
    assert "0.8 MB" in done.stderr
    return path


def drawn(path):
    data = json.loads(
        path.read_text().split('<script type="application/json" id="data">')[1]
        .split("</")[0]
    )  # fmt: skip
    solid = data["solid"]
    vertices = np.frombuffer(base64.b64decode(solid["vertices"]), "<f4")
    faces = np.frombuffer(base64.b64decode(solid["faces"]), "<u2")
    return data, vertices.reshape(-1, 3).astype(float), faces.reshape(-1, 3)


def test_the_page_has_the_mesh_in_the_frame_of_its_body(stone, page):
    data, vertices, faces = drawn(page)
    assert 0.5 * MOST_TRIANGLES < len(faces) <= MOST_TRIANGLES
    [told] = [text for name, text in data["facts"] if name == "mesh"]
    assert told == f"stone.stl, 25,088 triangles, drawn with {len(faces):,}"
    # The bottom is the body's ellipsoid, whose foot is at (0, 0, 1).
    body = rs.Rattleback.from_mesh(stone, mass="60 g", points=COINS)
    x, y, z = vertices[vertices[:, 2] > 0].T
    cos = math.cos(body.xi)
    sin = math.sin(body.xi)
    along = cos * x + sin * y
    across = cos * y - sin * x
    rise = (1 - z) - (1 - z) ** 2 / (2 * body.c)
    assert (body.theta * along**2 + body.phi * across**2) / 2 == pytest.approx(
        rise, abs=1e-5
    )
    assert z.max() == pytest.approx(1, abs=1e-3)
    # With its coins it has the moments of the body, in M a^2, along the axes.
    pose = body.pose
    places = [(1.0, pose.placed(np.array([at]) * 1e-3)[0]) for _, at in COINS]
    solid = shapes.half_ellipsoid_solid(0.12, 0.03, 0.012, 56)
    turned = Solid(pose.placed(solid.vertices), solid.faces)
    mass = turned.mass(8.0).with_points(places)
    assert mass.centre == pytest.approx(0, abs=1e-7)
    moments = np.diag([body.alpha - 1, body.beta - 1, body.gamma])
    assert mass.inertia / mass.mass == pytest.approx(moments, rel=1e-6, abs=1e-6)


def test_outlines_of_a_thinned_mesh_stay():
    solid = shapes.half_ellipsoid_solid(0.12, 0.03, 0.012, 40)
    coarse = with_fewer_faces(solid, 4000)
    assert len(coarse.faces) <= 4000
    assert with_fewer_faces(solid, 10**6) is solid
    # What is left are vertices of the mesh, and the edge of the flat side among them.
    rim = coarse.vertices[np.abs(coarse.vertices[:, 2]) < 1e-12]
    shape = (rim[:, 0] / 0.06) ** 2 + (rim[:, 1] / 0.015) ** 2
    assert (shape > 0.999).sum() > 60
    assert np.ptp(coarse.vertices, axis=0) == pytest.approx(
        np.ptp(solid.vertices, axis=0), rel=2e-3
    )
    # A mesh that is not closed any more has nearly the same volume.
    assert coarse.volume == pytest.approx(solid.volume, rel=0.02)


def test_a_changed_body_has_no_mesh(stone):
    body = rs.Rattleback.from_mesh(stone, mass="60 g", points=COINS)
    assert body.pose is not None
    assert body.replace(theta=0.5).pose is None
    assert body.mirrored().pose is None
    body = rs.Rattleback.from_mesh(stone, mass="60 g", points=COINS)
    stone.rename(stone.with_suffix(".away"))
    try:
        with pytest.raises(rs.ConfigError, match="No such file"):
            rs.show(body, n_i="60 rpm", omega_xy0="6 rpm", t_end="0.1 s")
    finally:
        stone.with_suffix(".away").rename(stone)


def test_a_stone_file_is_shown(stone, tmp_path):
    file = tmp_path / "stone.yaml"
    file.write_text(
        f"body: {{mesh: {stone}, mass: 60 g, points: [[7.5 g, [45, -9, 0]], "
        "[7.5 g, [-45, 9, 0]]]}\n"
        "launch: {n_i: 60 +- 1 rpm}\nfree: [sigma]\n"
    )
    path = tmp_path / "stone.html"
    launch = ["--omega-xy0", "6rpm", "--t-end", "0.2s"]
    done = invoke("show", file, *launch, "--output", path)
    assert done.exit_code == 0, done.stderr
    text = path.read_text()
    assert "<h1>stone</h1>" in text
    assert "n_i 60 rpm, ω_xy0 6 rpm" in text
    for wrong, words in (
        (["--mass", "60g"], "--mass: a stone file has its own"),
        (["--case", 0, "--sample", 0], "--case: a stone file has no stored runs"),
        (["--n-i", 60], "--n-i: 60 has no unit"),
    ):
        refused = invoke("show", file, *wrong, "--output", path)
        assert refused.exit_code == 2
        assert words in refused.stderr


@pytest.mark.slow
@needs_browser
def test_the_mesh_rolls_on_the_plane(page, chromium):
    with window(chromium) as it:
        it.open(page)
        lowest = []
        for t in np.linspace(0, 35, 8):
            it.run(f"show.goTo({t})")
            it.frame()
            lowest.append(
                it.run(
                    "(() => { const { solid, lower } = show.scene; "
                    "solid.updateMatrixWorld(true); const p = lower.geometry"
                    ".attributes.position, v = lower.position.clone(); let low = 9; "
                    "for (let k = 0; k < p.count; k++) { v.fromBufferAttribute(p, k)"
                    ".applyMatrix4(lower.matrixWorld); low = Math.min(low, v.z); } "
                    "return low; })()"
                )
            )
        assert it.console == []
    # Facets are above the surface between their corners; nothing is below the plane.
    assert min(lowest) > -1e-4
    assert max(lowest) < 3e-3
