"""Python files that run a case in a physics engine."""

import ast
import math
import sys
import types
from importlib.resources import files

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sweeping import ROOT, invoke

import rattlesweep as rs
from rattlesweep.analysis.engines.adapters import frame
from rattlesweep.analysis.engines.case import EngineCase, _plane
from rattlesweep.analysis.engines.formats import EXPORTED
from rattlesweep.analysis.engines.script import HERE, numbers_of, to_script
from rattlesweep.api.single import prepare_launch
from rattlesweep.physics.si import Units
from rattlesweep.words.engines import ENGINES
from rattlesweep.words.names import EXPORT_FORMATS

FOLDER = ROOT / "benchmarks" / "engines"
ELLIPSOID = rs.Rattleback.gh().replace(c=2.0)
LAUNCH = {"n_i": 0.1, "omega_xy0": 0.01, "length": "1 cm", "t_end": 120}


def reference(name):
    """Return a reference case."""
    return EngineCase.model_validate_json((FOLDER / f"{name}.json").read_text())


def world(position, quaternion, omega):
    """Return a rotation and an angular velocity along the world's axes."""
    w, *xyz = quaternion
    turn = Rotation.from_quat([*xyz, w])
    return np.array(position), turn.as_matrix(), turn.apply(omega)


@pytest.mark.parametrize("name", ENGINES)
def test_a_file_stands_alone(name):
    text = to_script(reference("printed-steady"), name)
    tree = ast.parse(text)
    imported = {
        alias.name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    imported |= {
        node.module.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
    }
    assert "rattlesweep" not in imported
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert functions >= {"build", "advance", "look", "main"}
    assert f"pip install {ENGINES[name].installs} " in ast.get_docstring(tree)


def test_each_format_has_its_entry_in_the_table():
    assert EXPORTED.keys() == {*EXPORT_FORMATS}


def test_every_engine_has_an_adapter():
    adapters = {path.name.removesuffix(".py") for path in files(HERE).iterdir()}
    assert {*ENGINES} <= adapters


@pytest.mark.parametrize("name", ["demo-clockwise", "printed-steady", "kane-levinson"])
def test_a_launch_touches_the_plane_and_rolls(name):
    case = reference(name)
    numbers = numbers_of(case)
    position, turn, omega = world(
        numbers["position"], numbers["quaternion"], numbers["omega"]
    )
    spin, energy, gap, slip = frame.look_of(
        numbers, position, turn, np.array(numbers["velocity"]), omega
    )
    assert spin == pytest.approx(numbers["spin"], rel=1e-14)
    assert energy == pytest.approx(case.expected.energy, rel=1e-10)
    assert gap == pytest.approx(0, abs=1e-15)
    assert slip == pytest.approx(0, abs=1e-13)


def test_a_pose_on_the_way_has_the_energy_and_the_spin_that_the_case_says():
    case = reference("printed-unsteady")
    numbers = numbers_of(case)
    pose = case.expected.poses[4]
    _, turn, omega = world((0, 0, 0), pose.quaternion, pose.omega)
    # The place and the velocity with which it rolls follow from the lowest point.
    _, _, gap, _ = frame.look_of(numbers, np.zeros(3), turn, np.zeros(3), omega)
    position = np.array([0, 0, -gap])
    slips = [
        frame.look_of(numbers, position, turn, np.array(velocity), omega)[3]
        for velocity in ((0, 0, 0), (1, 0, 0), (0, 1, 0))
    ]
    # Three lengths of v_c + (0, e_x, e_y) give v_c, up to its vertical part.
    still, along, across = np.square(slips)
    velocity = -np.array([along - still - 1, across - still - 1, 0]) / 2
    *_, slip = frame.look_of(numbers, position, turn, velocity, omega)
    assert slip == pytest.approx(0, abs=1e-9)
    spin = frame.look_of(numbers, position, turn, velocity, omega)[0]
    assert spin == pytest.approx(pose.spin, rel=1e-12)


def swinging(rate, amplitude):
    """Return an engine whose body spins at `amplitude cos(rate t)`, upright."""

    def build(case, step):
        return {"t": 0.0, "step": step, "case": case}

    def advance(scene):
        scene["t"] += scene["step"]

    def look(scene):
        spin = amplitude * math.cos(rate * scene["t"])
        position = np.array(scene["case"]["position"])
        return position, np.eye(3), np.zeros(3), np.array([0, 0, spin]), 1

    return types.SimpleNamespace(build=build, advance=advance, look=look)


def test_the_frame_finds_the_first_zero_between_steps():
    case = {
        **numbers_of(reference("demo-clockwise")),
        "position": [0.0, 0.0, 0.03],
        "spin": 2.0,
    }
    expected = math.pi / 2 / 1.1
    case["first_reversal"] = expected
    found = frame.run(swinging(1.1, 2.0), case, 1e-3)
    assert found["reversal, s"] == pytest.approx(expected, rel=1e-6)
    assert found["slip, mm/s"] == pytest.approx(0, abs=1e-12)
    assert found["contacts"] == 1
    case["first_reversal"] = 0.5 * expected
    assert math.isnan(frame.run(swinging(1.1, 2.0), case, 1e-3)["reversal, s"])


def test_a_tap_counts_its_zeros_after_it_has_spun():
    case = {**numbers_of(reference("kane-levinson-tap")), "position": [0, 0, 0.0]}
    assert case["counts_above"] > 0
    case["first_reversal"] = 3.0
    small = swinging(1.0, 0.5 * case["counts_above"])
    assert math.isnan(frame.run(small, case, 1e-3)["reversal, s"])


@pytest.mark.parametrize(
    ("body", "more", "sentence"),
    [
        (rs.Rattleback.gh(), {}, "^body: Drake has no paraboloid; give the vertical"),
        (ELLIPSOID, {"sigma": 0.1}, "^sigma: Drake has no such friction; leave it out"),
        (ELLIPSOID, {"pivot": 0.001}, "^pivot: Drake has no such friction"),
        (ELLIPSOID, {"engine": "havok"}, "^engine: .*havok.*mujoco"),
        (ELLIPSOID, {"path": "run.xml"}, "^path run.xml: a file of drake ends in .py"),
        (ELLIPSOID, {"path": "drake.py"}, "hides the package.*call it drake_run.py"),
    ],
)
def test_what_an_engine_cannot_have_is_refused(body, more, sentence):
    with pytest.raises(rs.ConfigError, match=sentence):
        rs.export(body, **{"engine": "drake", **LAUNCH, **more})


@pytest.mark.parametrize("form", [{"engine": "mujoco"}, {}, {"format": "json"}])
@pytest.mark.parametrize("along", [{}, {"direction": "horizontal"}])
def test_no_export_has_a_plane_that_shakes(form, along):
    drive = {"frequency": 2.0, "acceleration": 0.1} | along
    with pytest.raises(rs.ConfigError, match="no format has a plane that shakes"):
        rs.export(ELLIPSOID, sigma=0.01, base=drive, **LAUNCH, **form)


@pytest.mark.parametrize(
    ("losses", "value", "unit"),
    [
        ({"pivot": 0.01, "creep": 0.3}, 0.3, "1"),
        ({"viscous": 2.0}, 2.0 * math.sqrt(9.81 / 0.01), "N s/m"),
    ],
)
def test_a_case_has_the_constants_of_every_law(losses, value, unit):
    *_, name = losses
    run = prepare_launch(ELLIPSOID, n_i=0.1, omega_xy0=0.01, **losses)
    found = _plane(run, Units(1.0, 0.01)).losses
    assert found.keys() == losses.keys()
    assert (found[name].value, found[name].unit) == (pytest.approx(value), unit)


def test_a_form_and_an_engine_exclude_each_other():
    result = invoke(
        *("export", "--preset", "GH", "--c", "2", "--length", "1cm"),
        *("--n-i", "0.1", "--omega-xy0", "0.01"),
        *("--format", "json", "--engine", "drake"),
    )
    assert result.exit_code == 2
    assert "--engine: its file has its own form; leave --format out" in result.stderr


def test_a_file_of_mujoco_finds_the_reversal(tmp_path, monkeypatch, capsys):
    pytest.importorskip("mujoco")
    path = tmp_path / "case.py"
    path.write_text(to_script(reference("demo-clockwise"), "mujoco"))
    monkeypatch.setattr(sys, "argv", [str(path), "--step", "5e-4"])
    names = {"__name__": "__main__"}
    module = types.ModuleType("__main__")
    monkeypatch.setitem(sys.modules, "__main__", module)
    module.__dict__.update(names)
    exec(compile(path.read_text(), str(path), "exec"), module.__dict__)
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("extrapolated to a step of 0: 1.37")
    assert abs(float(last.split()[-2])) < 0.05
