"""Cases for physics engines: what they say, who is refused, and one run by MuJoCo."""

import importlib.resources
import json
import re
import xml.etree.ElementTree as ET

import jsonschema
import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation
from sweeping import ROOT, invoke

import rattlesweep as rs
from rattlesweep.analysis.engines.case import EngineCase
from rattlesweep.analysis.engines.mjcf import to_mjcf
from rattlesweep.words.errors import ConfigError, printable

FOLDER = ROOT / "benchmarks" / "engines"
GH = rs.Rattleback.gh()
ELLIPSOID = GH.replace(c=2.0)
HALF = rs.Rattleback.half_ellipsoid(
    length="12 cm", width="3 cm", height="1.2 cm", mass="60 g", skew="8 deg"
)
LAUNCH = {"n_i": 0.1, "omega_xy0": 0.01, "t_end": 120}


def test_a_document_obeys_its_schema_and_scales_with_the_size():
    schema = json.loads(invoke("schema", "--case").stdout)
    small = json.loads(rs.export(GH, format="json", length=0.01, **LAUNCH))
    large = json.loads(rs.export(GH, format="json", length="4 cm", **LAUNCH))
    jsonschema.validate(small, schema)
    zeros = [each["expected"]["first_reversal"]["time"] for each in (small, large)]
    assert zeros[1] == pytest.approx(2 * zeros[0], rel=1e-14)
    t_r = rs.simulate(GH, n_i=0.1, omega_xy0=0.01, tol=1e-12).t_r
    assert zeros[0] == pytest.approx(t_r * np.sqrt(0.01 / 9.81), rel=1e-8)
    assert small["expected"]["poses"][-1]["spin"] == pytest.approx(0, abs=1e-9)


def test_a_model_has_the_body_and_a_launch_that_rolls():
    text = rs.export(ELLIPSOID, length="1 cm", **LAUNCH)
    assert "mass of 1 kg are chosen" in text
    root = ET.fromstring(text)
    key = root.find("keyframe/key")
    qpos = np.array(key.get("qpos").split(), float)
    qvel = np.array(key.get("qvel").split(), float)
    # Upright, the body's axes are the world's: v = omega x (0, 0, height).
    assert qvel[:3] == pytest.approx(np.cross(qvel[3:], [0, 0, qpos[2]]), abs=1e-15)
    assert qvel[5] > 0


@pytest.mark.parametrize(
    ("body", "more", "sentence"),
    [
        (GH, {}, "no paraboloid"),
        (ELLIPSOID, {"sigma": 0.1}, "^sigma: MuJoCo has no such friction"),
        (ELLIPSOID, {}, "length: the body has no size"),
        (ELLIPSOID, {"length": "4 s"}, "length"),
        (ELLIPSOID, {"format": "urdf"}, "format"),
        (ELLIPSOID, {"tol": 1e-9}, "leave tol out"),
        (
            rs.Rattleback.kl(),
            {
                "length": "4 cm",
                "n_i": "60 rpm",
                "omega_xy0": "6 rpm",
                "t_end": "5 s",
            },
            "has a size already",
        ),
    ],
)
def test_what_cannot_be_exported_is_refused(body, more, sentence):
    with pytest.raises(ConfigError, match=sentence):
        rs.export(body, **{**LAUNCH, **more})


def reference(name):
    """Return a reference case as an object."""
    return EngineCase.model_validate_json((FOLDER / f"{name}.json").read_text())


def test_the_models_of_the_cases_are_up_to_date():
    source = importlib.resources.files("rattlesweep.analysis.engines") / "cases.yaml"
    cases = YAML(typ="safe").load(source.read_text("utf-8"))
    assert sorted(cases) == sorted(path.stem for path in FOLDER.glob("*.xml"))
    for name, keys in cases.items():
        model = (FOLDER / f"{name}.xml").read_text()
        assert to_mjcf(reference(name), keys.get("one_percent")) == model


def test_the_comment_of_a_model_has_the_launch_in_the_axes_of_the_world():
    case = reference("printed-steady")
    # Tilt the launch, so that the axes differ.
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 1.0])
    x, y, z, w = turn.as_quat()
    launch = case.launch.model_copy(update={"quaternion": (w, x, y, z)})
    text = to_mjcf(case.model_copy(update={"launch": launch}))
    rows = dict(
        re.findall(r"^  (quaternion|the same|angular velocity) +(.*?) [r(]", text, re.M)
    )
    vectors = {name: np.array(row.split(), float) for name, row in rows.items()}
    assert vectors["quaternion"] == pytest.approx([w, x, y, z], rel=1e-15)
    assert vectors["the same"] == pytest.approx([x, y, z, w], rel=1e-15)
    omega = turn.as_matrix() @ case.launch.omega
    assert vectors["angular velocity"] == pytest.approx(omega, rel=1e-13)


def test_a_portable_model_keeps_to_what_most_readers_know():
    model = ET.fromstring(to_mjcf(reference("demo-pivots"), portable=True))
    assert model.find("option").get("integrator") == "Euler"
    joint = model.find(".//body/joint")
    assert (joint.get("name"), joint.get("type")) == ("free", "free")
    assert model.find(".//freejoint") is None
    assert float(model.find("default/geom").get("friction").split()[0]) == 2
    size = np.array(model.find(".//geom[@type='plane']").get("size").split(), float)
    assert np.all(size > 0)
    ordinary = ET.fromstring(to_mjcf(reference("demo-pivots")))
    assert float(ordinary.find("default/geom").get("friction").split()[0]) == 4
    # What a run does not need is not asked of the engine; what it needs is kept.
    slides = ET.fromstring(to_mjcf(reference("demo-slides"), portable=True))
    assert float(slides.find("default/geom").get("friction").split()[0]) == 0.3
    steep = reference("sensitive")
    contact = steep.expected.contact.model_copy(update={"friction": 2.5})
    expected = steep.expected.model_copy(update={"contact": contact})
    with pytest.raises(ConfigError, match=r"^portable: the run needs a .* 2\.5"):
        to_mjcf(steep.model_copy(update={"expected": expected}), portable=True)
    with pytest.raises(ConfigError, match=r"^portable: only a model"):
        rs.export(ELLIPSOID, length="1 cm", portable=True, format="json", **LAUNCH)


def test_pivoting_friction_is_torsional_friction_with_the_lever_in_metres():
    text = (FOLDER / "demo-pivots.xml").read_text()
    surfaces = ET.fromstring(text).find("default/geom")
    sliding, torsional, rolling = map(float, surfaces.get("friction").split())
    case = reference("demo-pivots")
    assert surfaces.get("condim") == "4"
    assert torsional == case.plane.losses["pivot"].value == pytest.approx(0.25e-3)
    assert rolling == 0
    used = case.expected.contact.friction / sliding
    assert used <= 0.1
    assert f"leaves {100 * np.sqrt(1 - used**2):.1f} % of it" in text


@pytest.mark.parametrize(
    "name", ["2 --> 3", "run--2-", "bell\a", "a\n--\x1b\ufffe", "<&>"]
)
def test_any_name_leaves_a_model_that_is_xml(name):
    case = reference("cabinet").model_copy(update={"name": name, "about": name})
    model = ET.fromstring(to_mjcf(case))
    assert model.get("model") == printable(name)


def test_a_model_of_a_half_ellipsoid_says_that_its_geom_goes_on():
    whole = reference("cabinet")
    surface = whole.body.surface.model_copy(update={"rim": 0.012})
    body = whole.body.model_copy(update={"surface": surface})
    half = whole.model_copy(update={"body": body})
    models = [ET.fromstring(to_mjcf(case)) for case in (whole, half)]
    assert ET.tostring(models[0]) == ET.tostring(models[1])
    assert "run does not reach that rim" in to_mjcf(half)


@pytest.mark.slow
def test_a_half_ellipsoid_is_exported_with_its_zeros():
    launch = {"n_i": "60 rpm", "omega_xy0": "6 rpm", "t_end": "1 s"}
    case = json.loads(rs.export(HALF, format="json", **launch))
    jsonschema.validate(case, json.loads((FOLDER / "schema.json").read_text()))
    expected = case["expected"]
    assert expected["zeros"][0] == expected["first_reversal"]
    cabinet = reference("cabinet").expected.first_reversal.time
    assert expected["first_reversal"]["time"] == pytest.approx(cabinet, rel=1e-10)
    assert case["body"]["surface"]["rim"] == pytest.approx(0.012)
    surface = ET.fromstring(rs.export(HALF, **launch)).find(".//body/geom")
    semi_axes = np.array(surface.get("size").split(), float)
    assert semi_axes == pytest.approx([0.015, 0.06, 0.012])


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    arguments = ["export", "--preset", "GH", "--n-i", "0.1", "--length", "1cm"]
    arguments.append("--output")
    done = invoke(*arguments, str(tmp_path / "gh.xml"))
    assert done.exit_code == 2
    assert not list(tmp_path.iterdir())
    assert invoke(*arguments, str(tmp_path / "gh.json")).exit_code == 0
    both = invoke("export", "--cases", str(tmp_path / "cases"), "--preset", "GH")
    assert both.exit_code == 2
    assert "--preset" in both.stderr


@pytest.mark.slow
def test_mujoco_reverses_within_a_percent(monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import engines

    case = json.loads((FOLDER / "demo-clockwise.json").read_text())
    expected = case["expected"]["first_reversal"]["time"]
    assert expected == pytest.approx(1.37219, abs=1e-5)
    found = engines.mujoco_run(case).first_reversal
    assert found == pytest.approx(expected, rel=0.01)
    # At first order in the time constant of the contact.
    errors = [
        expected - engines.mujoco_run(case, share).first_reversal
        for share in (0.01, 0.005)
    ]
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "setting", "within"),
    [
        ("demo-pivots", {}, 1e-3),
        # A contact pair that damps slip more than the default: 11 % off without.
        ("kane-levinson", {"share": 0.01, "grip": 1.8}, 0.005),
    ],
)
def test_mujoco_with_other_frictions(monkeypatch, name, setting, within):
    pytest.importorskip("mujoco")
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import engines

    case = json.loads((FOLDER / f"{name}.json").read_text())
    expected = case["expected"]["first_reversal"]["time"]
    found = engines.mujoco_run(case, **setting).first_reversal
    assert found == pytest.approx(expected, rel=within)


@pytest.mark.slow
def test_an_independent_program_finds_the_same(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import engines

    for name in ("demo-clockwise", "demo-slides", "demo-pivots", "cabinet"):
        case = json.loads((FOLDER / f"{name}.json").read_text())
        expected = case["expected"]["first_reversal"]["time"]
        assert engines.independent(case) == pytest.approx(expected, rel=1e-9)
