"""Meshes on the command line, in configs and in stone files, and files for printers."""

import json
import math
import re
import sys

import numpy as np
import pytest
from click.testing import CliRunner

import rattlesweep as rs
from rattlesweep.analysis.fit.measured import measured_body
from rattlesweep.cli import main
from rattlesweep.physics.mesh import shapes
from rattlesweep.physics.mesh.solid import Solid
from rattlesweep.physics.mesh.standing import stand
from rattlesweep.words.errors import ConfigWarning

pytest.importorskip("trimesh")
NAMES = ("alpha", "beta", "gamma", "theta", "phi", "xi", "c", "rim")


def call(*args):
    return CliRunner().invoke(main, [*map(str, args)])


@pytest.fixture(scope="module")
def stones(tmp_path_factory):
    """A folder with half ellipsoids of two skews."""
    folder = tmp_path_factory.mktemp("stones")
    for skew in (3, 6):
        made = call(
            "stl", "--half-ellipsoid", "12cm,3cm,12mm", "--skew", f"{skew}deg",
            "--fineness", 32, "--output", folder / f"s{skew}.stl",
        )  # fmt: skip
        assert made.exit_code == 0, made.stderr
        assert "closed" in made.stderr
        assert "as a body: alpha 13." in made.stderr
        _, more = made.stderr.split("its beta is ")
        expected = {3: 0.82, 6: 3.3}[skew]
        assert float(more.split()[0]) == pytest.approx(expected, abs=0.2)
        _, found = re.split("read back: skew ", made.stderr)
        assert float(found.split()[0]) == pytest.approx(skew, rel=0.015)
    return folder


def twisted(turned_by):
    """Return inertia over mass of a twisted half ellipsoid, by quadrature of outlines.

    The outline at a depth `s` has the area `(1 - s^2)`, its axes `sqrt(1 - s^2)`.
    """
    nodes, weights = np.polynomial.legendre.leggauss(60)
    s = (nodes + 1) / 2
    weights = weights * (1 - s**2)
    weights /= weights.sum()
    angle = turned_by * (1 - (1 - s) ** 3)
    wide = 0.06**2 * (1 - s**2) / 4
    narrow = 0.015**2 * (1 - s**2) / 4
    xx = weights @ (wide * np.cos(angle) ** 2 + narrow * np.sin(angle) ** 2)
    yy = weights @ (wide * np.sin(angle) ** 2 + narrow * np.cos(angle) ** 2)
    xy = weights @ ((wide - narrow) * np.sin(angle) * np.cos(angle))
    z = 0.012 * s
    zz = weights @ z**2 - (weights @ z) ** 2
    return np.array([[yy + zz, -xy, 0], [-xy, xx + zz, 0], [0, 0, xx + yy]])


def test_a_twist_makes_the_skew():
    skew = math.radians(5)
    solid = shapes.half_ellipsoid_solid(0.12, 0.03, 0.012, 64, skew)
    turned_by = shapes.twist_of(skew, 4)
    mass = solid.mass(1.0)
    assert mass.inertia == pytest.approx(twisted(turned_by), rel=1e-3, abs=1e-9)
    _, axes = np.linalg.eigh(mass.inertia)
    along = abs(math.atan(axes[1, 0] / axes[0, 0]) - turned_by)
    assert along == pytest.approx(skew, rel=1e-3)
    found = stand(solid, mass).parameters
    exact = rs.Rattleback.half_ellipsoid(
        length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew=skew
    )
    # Its moments are those of the outlines, so that they are not those of a half
    # ellipsoid whose axes are turned: the twist makes the smallest one larger.
    moments = np.linalg.eigvalsh(twisted(turned_by)[:2, :2]) / 0.0075**2
    assert found["beta"] == pytest.approx(1 + moments[0], rel=4e-4)
    assert found["alpha"] == pytest.approx(1 + moments[1], rel=4e-4)
    # The fit of the bottom sees a part of the twist.
    allowed = dict.fromkeys(NAMES, 4e-3) | {"beta": 0.03, "xi": 0.015}
    for name in NAMES:
        assert found[name] == pytest.approx(getattr(exact, name), rel=allowed[name])


def test_pockets_are_holes_of_their_size():
    plain = shapes.half_ellipsoid_solid(0.12, 0.04, 0.015, 24)
    pockets = shapes.pockets_at((0.03, -0.005), (0.01, 0.004))
    solid = shapes.half_ellipsoid_solid(0.12, 0.04, 0.015, 24, pockets=pockets)
    corners = shapes.POCKET_CORNERS
    circle = corners / 2 * math.sin(2 * math.pi / corners) * 0.005**2
    assert plain.volume - solid.volume == pytest.approx(2 * circle * 0.004, rel=1e-9)
    # Weights that fill the pockets give the inertia of the solid without them.
    mass = solid.mass(density=1000)
    whole = plain.mass(density=1000)
    filling = 1000 * circle * 0.004
    places = [np.array([0.03, -0.005, -0.002]), np.array([-0.03, 0.005, -0.002])]
    filled = mass.with_points([(filling, place) for place in places])
    assert filled.mass == pytest.approx(whole.mass, rel=1e-9)
    assert filled.centre == pytest.approx(whole.centre, abs=1e-10)
    assert filled.inertia == pytest.approx(whole.inertia, rel=2e-3, abs=1e-9)
    with pytest.raises(ValueError, match="of wall; make it smaller"):
        shapes.half_ellipsoid_solid(
            0.12, 0.03, 0.012, 24, pockets=shapes.pockets_at((0.05, 0), (0.02, 0.002))
        )


def test_the_command_body_and_its_figure(stones):
    figure = stones / "fit.png"
    done = call(
        "body", "--mesh", stones / "s3.stl", "--mass", "60g", "--n-i", "60rpm",
        "--figure", figure, "--json",
    )  # fmt: skip
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["xi"] == pytest.approx(-0.0524, rel=0.015)
    assert figure.read_bytes().startswith(b"\x89PNG")
    refused = call("body", "--preset", "GH", "--figure", figure)
    assert refused.exit_code == 2
    assert "--figure shows a mesh; add --mesh" in refused.stderr


def test_a_stone_file_with_a_mesh(stones):
    values = {
        "mesh": str(stones / "s3.stl"),
        "mass": "60 g",
        "points": [["7.5 g", [30, -5, 0]], ["7.5 g", [-30, 5, 0]]],
    }
    body = measured_body(values).body
    assert body.units.mass == pytest.approx(0.075)
    with pytest.raises(rs.ConfigError, match="mass"):
        measured_body(values | {"mass": 60})


def test_a_sweep_of_two_meshes(stones, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = tmp_path / "twists.yaml"
    config.write_text(
        f"bodies:\n  source: mesh\n  path: [{stones}/s3.stl, {stones}/s6.stl]\n"
        "  mass: 60 g\nspin: {n_i: 60 rpm, omega_xy0: 6 rpm}\nmodel: gh\n"
    )
    first = call("run", config, "--output", "out")
    assert first.exit_code == 0, first.stderr
    rows = rs.load("out").read()
    assert [*rows["case"]] == [0, 1]
    assert [path.rsplit("/")[-1] for path in rows["mesh"]] == ["s3.stl", "s6.stl"]
    assert np.degrees(-rows["xi"].to_numpy()) == pytest.approx([3, 6], rel=0.02)
    again = call("run", config, "--output", "out")
    assert "0 of them done now" in again.stderr


def test_radii_that_change_with_the_range_are_told(stones, tmp_path):
    """A bottom that becomes steeper beside its foot has no one curvature."""
    solid = shapes.half_ellipsoid_solid(120, 30, 12, 32)
    x, y, z = solid.vertices.T
    rise = 1 + z / 12
    steeper = rise * (1 + 0.3 * np.tanh((rise / 0.1) ** 2))
    bent = np.column_stack([x, y, 12 * steeper])
    path = tmp_path / "bent.stl"
    write_stl(Solid.of(bent, solid.faces), path)
    done = call(
        "body",
        "--mesh",
        path,
        "--mass",
        "60g",
        "--mass-points",
        "5g@30,-5,0;5g@-30,5,0",
    )
    assert done.exit_code == 0, done.stderr
    assert "warning: the radii change by" in done.stderr
    with pytest.warns(
        ConfigWarning, match=r"the radii change by .* with the range that is fitted"
    ):
        rs.Rattleback.from_mesh(
            path, mass="60 g", points=[("5 g", (30, -5, 0)), ("5 g", (-30, 5, 0))]
        )


def write_stl(solid, path):
    import trimesh

    trimesh.Trimesh(solid.vertices, solid.faces, process=False).export(path)


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "3mf"])
def test_a_text_that_is_no_mesh(ending, tmp_path):
    path = tmp_path / f"notes.{ending}"
    path.write_text("the stone is on my desk\n")
    done = call("body", "--mesh", path, "--mass", "60g")
    assert done.exit_code == 2, done.exception
    assert len(done.stderr.strip().splitlines()) == 1
    assert "cannot be read as" in done.stderr


def test_a_missing_extra_is_one_sentence(stones, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    done = call("stl", "--half-ellipsoid", "12cm,3cm,12mm", "-o", stones / "none.stl")
    other = call("body", "--mesh", stones / "s6.stl", "--mass", "61g", "--unit", "cm")
    for result in (done, other):
        assert result.exit_code == 2, result.exception
        [line] = result.stderr.strip().splitlines()
        assert "meshes need trimesh; install it by pip install" in line
    assert not (stones / "none.stl").exists()
