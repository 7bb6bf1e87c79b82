"""One body from a mapping, and numbers without a unit where a body has a size."""

import re

import pytest
from refusal import assert_refused
from sweeping import invoke

import rattlesweep as rs
from rattlesweep.design.bodies.making import body_from
from rattlesweep.words.errors import ConfigError

HALF = {
    "shape": "half_ellipsoid",
    "length": "12 cm",
    "width": "3 cm",
    "height": "12 mm",
    "mass": "60 g",
    "skew": "3 deg",
}
MEASURED = {
    "mass": "85 g",
    "height": "1 cm",
    "inertia": "60, 900, 920, -20 g cm^2",
    "radii": "50, 1.5 cm",
    "axes_angle": "1 deg",
}
SHELL = {"gamma": 10, "f_sd": 0.1, "theta": 0.8, "phi": 0.05}


def test_each_way_gives_the_body_of_its_function():
    half = {name: value for name, value in HALF.items() if name != "shape"}
    assert body_from(HALF) == rs.Rattleback.half_ellipsoid(**half)
    assert body_from(HALF).units == rs.Rattleback.half_ellipsoid(**half).units
    assert body_from(MEASURED) == rs.Rattleback.from_si(**MEASURED)
    shell = rs.Rattleback.shell_dumbbell(**SHELL, xi=-0.05)
    assert body_from(SHELL | {"xi": -0.05}) == shell
    assert body_from(SHELL | {"xi": -0.05, "c": 2.0}) == shell.replace(c=2.0)
    assert body_from({"preset": "KL"}) == rs.Rattleback.kl()
    gh = rs.Rattleback.gh()
    assert body_from({"preset": "GH", "theta": 0.82}) == gh.replace(theta=0.82)
    plain = {name: getattr(gh, name) for name in ("alpha", "beta", "gamma", "theta")}
    assert body_from(plain | {"phi": gh.phi, "xi": gh.xi}) == gh


def test_degrees_and_their_mirror_image():
    turned = body_from(SHELL | {"xi_deg": -3})
    assert turned == body_from(SHELL | {"minus_xi_deg": 3})
    assert turned.mirrored() == body_from(SHELL | {"xi_deg": 3})


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ({}, "alpha is missing; add it, or give preset, shape, mesh, mass or f_sd"),
        ({"mass": "1 kg"}, "inertia is missing; add it"),
        ({"shape": "cube"}, 'shape: "cube" is not one of half_ellipsoid; choose'),
        ({"preset": "XY"}, 'preset: "XY" is not one of GH, KL; choose one of them'),
        ({"preset": "GH", "thta": 1}, '"thta" is not one of alpha, beta, gamma,'),
        ({"preset": "GH", "theta": "a"}, "theta: a (str) is not a number"),
        (SHELL | {"xi": -1, "xi_deg": -3}, "xi and xi_deg exclude each other; keep"),
        (SHELL | {"xi_deg": "3"}, "xi_deg: '3' is not a number; give degrees"),
        (HALF | {"mass": 60}, "mass: 60 has no unit, and the body has a size; give a"),
        (HALF | {"length": 12}, "length: 12 has no unit, and the body has a size"),
        (HALF | {"skew": 0.05}, "skew: 0.05 has no unit, and the body has a size"),
        (HALF | {"weights": "7 g", "at": [45, -9]}, "at: 45 has no unit, and"),
        (MEASURED | {"radii": ["50 cm", 1.5]}, "radii: 1.5 has no unit, and the"),
        (MEASURED | {"inertia": [[1, 0, 0]]}, "inertia: 1 has no unit, and the body"),
        (MEASURED | {"gravity": 9.81}, "gravity: 9.81 has no unit, and the body has"),
    ],
)
def test_what_describes_no_body_is_refused(body, sentence):
    with pytest.raises(ConfigError, match=f"^{re.escape(sentence)}"):
        body_from(body)


def test_zero_needs_no_unit_and_python_takes_numbers_in_si_units():
    plain = rs.Rattleback.from_si(
        mass=0.085, height=0.01, inertia=(6e-6, 9e-5, 9.2e-5, -2e-6), radii=(0.5, 0.015)
    )
    body = body_from(MEASURED | {"axes_angle": 0})
    assert (body.alpha, body.xi) == pytest.approx((plain.alpha, plain.xi))


STONE = (
    "body: {shape: half_ellipsoid, length: 12 cm, width: 3 cm, height: 12 mm, "
    "mass: 60 g, skew: 3 deg}\nlaunch: {n_i: 100 rpm}\n"
    "dissipation: {rolling: 0}\nfree: [n_i]\n"
)


@pytest.mark.parametrize(
    ("with_unit", "without", "sentence"),
    [
        ("mass: 60 g", "mass: 60", "stone.yaml:1: body: mass: 60 has no unit"),
        ("length: 12 cm", "length: 12", "stone.yaml:1: body: length: 12 has no unit"),
        ("n_i: 100 rpm", "n_i: 100", "stone.yaml:2: launch: n_i: 100 has no unit"),
        (
            "rolling: 0",
            "sigma: 1.0e-4",
            "stone.yaml:3: dissipation: sigma: 0.0001 has no unit",
        ),
    ],
)
def test_a_stone_with_a_number_without_a_unit_is_refused(
    with_unit, without, sentence, tmp_path
):
    stone = tmp_path / "stone.yaml"
    stone.write_text(STONE.replace(with_unit, without))
    data = tmp_path / "data.csv"
    data.write_text("t_s,spin_rpm\n0,100\n1,90\n")
    assert_refused(invoke("fit", stone, data), 2, sentence)
